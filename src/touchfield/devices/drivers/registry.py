"""Devices: which there are, how what a user wrote becomes one, and what each needs of the machine.

    sim   sim:spring   haply:HOST:PORT   openhaptics:NAME   forcedimension     a point (type 1)
    bhaptics:HOST:PORT   osc:HOST:PORT   pins:/dev/ttyUSB0   pins:HOST:PORT    an array of actuators (type 2)

A new device is a `DeviceKind`: of this package ``KIND`` of a module in `MODULES`, of other distributions an
entry point of the group ``touchfield.drivers``. The modules must be cheap to import: libraries and drivers
are looked for when a device is opened.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata, util
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.plugins import plugins
from touchfield.render.point_device import PointDevice

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium.trace import Trace
    from touchfield.render.array_player import ArrayDevice


MODULES = ("simulated", "haply", "openhaptics", "forcedimension", "bhaptics", "osc", "pins")

Opener = Callable[[], PointDevice]
"""Makes a point, in the servo's process: it can be pickled. `PointDevice.open` then finds the device."""


@dataclass(frozen=True)
class Check:
    """One thing that a device or a format needs, what was found of it, and one line on how to mend it."""

    what: str
    is_there: bool
    found: str
    mend: str = ""


def library_check(name: str, extra: str = "", module: str = "", purpose: str = "") -> Check:
    """Check that a library is installed; how to get it if not.

    Parameters
    ----------
    name : str
        Of its distribution.
    extra : str
        Of touchfield, which brings it; "" for the core.
    module : str
        To import, where it has not the distribution's name.
    purpose : str
        Told where it is not plain from the device.
    """
    what = f"{name}, for {purpose}" if purpose else f"library {name}"
    if util.find_spec(module or name) is None:
        wanted = f"touchfield[{extra}]" if extra else "touchfield"
        return Check(what, False, "not installed", f'pip install "{wanted}"')
    try:
        return Check(what, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(what, True, "of unknown version")


@dataclass(frozen=True)
class DeviceKind:
    """One kind of device.

    Of a point ``make(rest, trajectory)`` gives an `Opener`, of an array ``make(rest, profile)`` an
    `ArrayDevice`; `rest` stands behind the colon, or is "". Raises `InvalidArgument`.
    """

    name: str  # for ``--device``, before the colon
    form: str  # the same as a user may write it, such as "bhaptics[:HOST:PORT]"
    summary: str  # one line for the user
    profile: str | None  # name of the one that holds unless another is named; None for that of the stream
    make: Callable[[str, Any], Any]
    checks: Callable[[], list[Check]]  # what is there of what it needs; quick, and never raises
    takes_any: bool = (
        False  # an array of any profile: that of a stream holds where it shows what the usual one does
    )
    is_simulated: bool = False  # a point that takes a trajectory, and whose axes and metres are the field's
    is_array: bool = False  # type 2


class PointChoice(NamedTuple):
    """The point that a user named; the rest as of its `DeviceKind`."""

    name: str
    opener: Opener
    profile: str | None
    is_simulated: bool


@cache
def device_kinds() -> tuple[DeviceKind, ...]:
    """All kinds of devices, those of plug-ins last."""
    built_in = tuple(import_module(f"touchfield.devices.drivers.{name}").KIND for name in MODULES)
    return (*built_in, *plugins("touchfield.drivers", DeviceKind).values())


def point_kinds() -> tuple[DeviceKind, ...]:
    """All kinds of type 1 devices."""
    return tuple(kind for kind in device_kinds() if not kind.is_array)


def array_kinds() -> tuple[DeviceKind, ...]:
    """All kinds of type 2 devices."""
    return tuple(kind for kind in device_kinds() if kind.is_array)


def _kind(words: str, name: str, kinds: tuple[DeviceKind, ...]) -> DeviceKind:
    for kind in kinds:
        if kind.name == name:
            return kind
    near = difflib.get_close_matches(name.lower(), [kind.name for kind in kinds], n=1, cutoff=0.5)
    forms = ", ".join(kind.form for kind in (*point_kinds(), *array_kinds()))
    raise InvalidArgument("--device", repr(words[:80]), forms, f"Did you mean {near[0]}?" if near else "")


def point_device(words: str, trajectory: Trace | None = None) -> PointChoice:
    """The point that `words` name, such as "sim", "haply:127.0.0.1:10001"; nothing is opened.

    Raises InvalidArgument if there is no such kind, what stands behind the colon is wrong, or a device that a
    hand moves was given a trajectory.
    """
    name, _, rest = words.strip().partition(":")
    kind = _kind(words, name.lower(), point_kinds())
    if trajectory is not None and not kind.is_simulated:
        raise InvalidArgument(
            "trajectory", f"one for {kind.name}", "none: there a hand moves", "Take --device sim."
        )
    return PointChoice(kind.name, kind.make(rest, trajectory), kind.profile, kind.is_simulated)


def is_array_device(words: str) -> bool:
    """True if these words name an array, rightly written or not."""
    return words.strip().partition(":")[0].lower() in {kind.name for kind in array_kinds()}


def array_device(words: str, profile: Device | None = None, own: Device | None = None) -> ArrayDevice:
    """The array that `words` name, such as "osc:127.0.0.1:9000", of the kind's usual profile unless one is
    given.

    Where the kind takes any, `own`, for which a stream was made, comes before the usual one.

    Raises InvalidArgument if there is no such device, its address is no address, or the profile does not fit
    it.
    """
    from touchfield.devices import device

    name, _, rest = words.strip().partition(":")
    kind = _kind(words, name.lower(), array_kinds())
    usual = device(str(kind.profile))
    if kind.takes_any and own is not None and own.is_array and own.shows == usual.shows:
        usual = own
    chosen = profile or usual
    if not chosen.is_array:
        raise InvalidArgument(
            f"profile of {name}", f"{chosen.name}, a point", "an array of actuators (type 2)"
        )
    array: ArrayDevice = kind.make(rest, chosen)
    return array


def drives_of(profile: Device, drives: Float32s) -> Float64s:
    """Drives from 0 to 1, float64 [panels, rows, columns], a NaN as 0; InvalidArgument if of another shape."""
    columns, rows, _ = profile.lattice
    shape = (profile.panels, rows, columns)
    if np.shape(drives) != shape:
        raise InvalidArgument(f"drives of {profile.name}", f"shape {np.shape(drives)}", f"{shape}")
    return np.clip(np.nan_to_num(np.asarray(drives, np.float64), nan=0.0), 0.0, 1.0)


def steps_of(profile: Device, drives: Float32s, levels: int) -> Int64s:
    """The nearest of so many levels, 0 to levels - 1, int64 [panels, rows, columns]; halves go up."""
    return np.floor(drives_of(profile, drives) * (levels - 1) + 0.5).astype(np.int64)
