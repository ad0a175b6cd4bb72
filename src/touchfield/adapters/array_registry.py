"""The type 2 devices: which there are, and how what a user wrote becomes one.

    bhaptics   bhaptics:HOST:PORT   osc:HOST:PORT   pins:/dev/ttyUSB0   pins:HOST:PORT

A new device is one new module that ends in ``KIND = ArrayKind(...)`` and one line in `MODULES`. The modules must be
cheap to import: libraries are imported, and devices looked for, when the device is opened.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from touchfield.adapters.check import Check
    from touchfield.devices import Device
    from touchfield.render.array_device import ArrayDevice

__all__ = ["ArrayKind", "array_device", "array_kinds", "is_array_device"]

MODULES = ("bhaptics", "osc", "pins")


@dataclass(frozen=True)
class ArrayKind:
    """One kind of type 2 device.

    Parameters
    ----------
    name : str
        What ``--device`` takes, before the colon.
    form : str
        The same as a user may write it, such as "bhaptics[:HOST:PORT]".
    summary : str
        One line for the user.
    profile : str
        Name of the profile in `touchfield.devices` that holds unless another is named.
    make : callable
        ``make(rest, profile) -> ArrayDevice``, `rest` what stands behind the colon, or ""; raises `InvalidArgument`.
    checks : callable
        ``checks() -> list[Check]``: what is there of what it needs; quick, and never raises.
    """

    name: str
    form: str
    summary: str
    profile: str
    make: Callable[[str, Device], ArrayDevice]
    checks: Callable[[], list[Check]]


@cache
def array_kinds() -> tuple[ArrayKind, ...]:
    """All kinds, in their order."""
    return tuple(import_module(f"touchfield.adapters.{name}").KIND for name in MODULES)


def is_array_device(words: str) -> bool:
    """Whether these words name one of them, rightly written or not."""
    return words.partition(":")[0] in [kind.name for kind in array_kinds()]


def array_device(words: str, profile: Device | None = None) -> ArrayDevice:
    """The device of what a user wrote; it is found by its `open`.

    Parameters
    ----------
    words : str
        Such as "osc:127.0.0.1:9000".
    profile : Device, optional
        Of type 2; None takes the usual one of the kind.

    Raises
    ------
    InvalidArgument
        If there is no such device, its address is no address, or the profile does not fit it.
    """
    from touchfield.devices import device

    name, _, rest = words.partition(":")
    chosen = next((kind for kind in array_kinds() if kind.name == name), None)
    if chosen is None:
        near = difflib.get_close_matches(name.lower(), [kind.name for kind in array_kinds()], n=1, cutoff=0.5)
        forms = ", ".join(kind.form for kind in array_kinds())
        raise InvalidArgument("device", repr(words), forms, f"Did you mean {near[0]}?" if near else "")
    taken = profile or device(chosen.profile)
    if not taken.is_array:
        raise InvalidArgument(f"profile of {name}", f"{taken.name}, a point", "an array of actuators (type 2)")
    return chosen.make(rest, taken)
