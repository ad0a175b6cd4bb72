"""`HEAD.coder_parameters` of the coder `touch`: what was promised, for people and programs.

The decoder itself needs of it only whether the mode is "lossless".
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from typing import Final

from touchfield.codec.touch.spec import EFFORTS, MODES, SUPPORTS, TouchSpec
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion

__all__ = ["read_parameters", "write_parameters"]

_VERSION: Final = 1
_NUMBERS: Final = {
    "mask": ("k", "f0_n"),
    "mask-direction": ("k", "f0_n", "direction_jnd_deg"),
    "nmse": ("step_n",),
    "lossless": (),
}


def write_parameters(spec: TouchSpec) -> bytes:
    """The parameters of what was asked for."""
    asked = MODES.index(spec.mode) | SUPPORTS.index(spec.support) << 2 | EFFORTS.index(spec.effort) << 3
    numbers = [getattr(spec, name) for name in _NUMBERS[spec.mode]]
    return struct.pack(f"<BB{len(numbers)}d", _VERSION, asked, *numbers)


def read_parameters(data: bytes, where: str) -> TouchSpec:
    """Spec that was asked for, as far as a file tells.

    Raises
    ------
    UnsupportedVersion
        If a newer touchfield wrote them.
    CorruptFile
        If they contradict themselves.
    """
    if len(data) < 2:
        raise CorruptFile(where, f"{len(data)} bytes", "2 or more")
    if data[0] != _VERSION:
        raise UnsupportedVersion(where, f"version {data[0]}", f"version {_VERSION}", "A newer touchfield reads it.")
    mode, support, effort = data[1] & 3, data[1] >> 2 & 1, data[1] >> 3
    if effort >= len(EFFORTS):
        raise CorruptFile(where, f"{data[1]:#x} for mode, support and effort", "an effort of 0 to 2")
    names = _NUMBERS[MODES[mode]]
    if len(data) != 2 + 8 * len(names):
        raise CorruptFile(where, f"{len(data)} bytes", f"{2 + 8 * len(names)} bytes of mode {MODES[mode]}")
    numbers = dict(zip(names, struct.unpack_from(f"<{len(names)}d", data, 2), strict=True))
    if not all(map(math.isfinite, numbers.values())):
        raise CorruptFile(where, repr(numbers), "finite numbers")
    spec = TouchSpec(mode=MODES[mode], support=SUPPORTS[support], effort=EFFORTS[effort])
    try:
        return replace(spec, **numbers)
    except InvalidArgument as error:
        raise CorruptFile(where, f"{error.where} = {error.found}", error.expected) from None
