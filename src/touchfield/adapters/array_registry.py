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

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.adapters.check import Check
    from touchfield.devices import Device
    from touchfield.render.array_device import ArrayDevice


__all__ = ["ArrayKind", "array_device", "array_kinds", "drives_of", "is_array_device", "steps_of"]

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


def drives_of(profile: Device, drives: NDArray[np.float32]) -> NDArray[np.float64]:
    """Drives from 0 to 1, float64 [panels, rows, columns]; one that is no number is 0.

    Raises
    ------
    InvalidArgument
        If there are not as many as the profile has actuators.
    """
    columns, rows, _ = profile.lattice
    shape = (profile.panels, rows, columns)
    if np.shape(drives) != shape:
        raise InvalidArgument(f"drives of {profile.name}", f"shape {np.shape(drives)}", f"{shape}")
    return np.clip(np.nan_to_num(np.asarray(drives, np.float64), nan=0.0), 0.0, 1.0)


def steps_of(profile: Device, drives: NDArray[np.float32], levels: int) -> NDArray[np.int64]:
    """The nearest of so many levels, 0 to levels - 1, int64 [panels, rows, columns]; halves go up."""
    return np.floor(drives_of(profile, drives) * (levels - 1) + 0.5).astype(np.int64)
