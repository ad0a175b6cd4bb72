"""Finds and opens the driver for what a user gives to `play --device` (such as `haply:HOST:PORT`), and
reports which libraries each driver needs.

    sim   haply:HOST:PORT/ID   openhaptics:NAME   forcedimension:SERIAL        a point (type 1)
    bhaptics:HOST:PORT   osc:HOST:PORT   pins:/dev/ttyUSB0   pins:HOST:PORT    an array of actuators (type 2)

A new device is a `DeviceKind`: ``KIND`` of a module in `MODULES` in this package, or an entry point of the
group ``touchfield.drivers`` in another distribution. A module is imported when its kind is used, or all kinds
are listed. It must be cheap to import: libraries and drivers are loaded when a device is opened.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata, util
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.plugins import plugins
from touchfield.render.point_device import PointDevice
from touchfield.render.readiness import Readiness

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.medium.trace import Trace
    from touchfield.render.array_player import ArrayDevice


MODULES = {
    "sim": "simulated",
    "haply": "haply",
    "openhaptics": "openhaptics",
    "forcedimension": "forcedimension",
    "bhaptics": "bhaptics",
    "osc": "osc",
    "pins": "pins",
}
"""The module of each built-in kind, by the kind's name."""

Opener = Callable[[], PointDevice]
"""Makes a point device, not yet open, in the servo's process; can be pickled."""


@dataclass(frozen=True)
class Check:
    """One requirement of a device or a format: what was found, and how to fix it."""

    what: str
    is_there: bool
    found: str
    mend: str = ""


def library_check(name: str, extra: str = "", module: str = "", purpose: str = "") -> Check:
    """Check that a library is installed.

    Parameters
    ----------
    name : str
        Name of its distribution.
    extra : str
        Extra of touchfield that installs it; "" for the core.
    module : str
        Module to import, if it differs from the name.
    purpose : str
        What it is for, if that is not plain from the device.
    """
    subject = f"{name}, for {purpose}" if purpose else f"library {name}"
    if util.find_spec(module or name) is None:
        package = f"touchfield[{extra}]" if extra else "touchfield"
        return Check(subject, False, "not installed", f'pip install "{package}"')
    try:
        return Check(subject, True, metadata.version(name))
    except metadata.PackageNotFoundError:
        return Check(subject, True, "of unknown version")


@dataclass(frozen=True)
class DeviceSetting:
    """A setting of a kind of device: its name, the form of its value, and one line for the user."""

    name: str
    form: str
    summary: str


@dataclass(frozen=True)
class DeviceKind:
    """One kind of device.

    For a point ``make(rest, trajectory)`` returns an `Opener`, for an array ``make(rest, profile)`` an
    `ArrayDevice`; `rest` is the text after the colon, or "". Raises `InvalidArgument`.
    """

    name: str  # for ``--device``, before the colon
    form: str  # syntax for the user, such as "bhaptics[:HOST:PORT]"
    summary: str  # one line for the user
    profile: str | None  # name of the default profile; None for that of the stream
    make: Callable[[str, Any], Any]
    checks: Callable[[], list[Check]]  # checks its requirements; quick, and never raises
    # accepts an array of any profile; that of a stream is used if it shows the same as the default one
    takes_any: bool = False
    is_simulated: bool = False  # a point that takes a trajectory, in the axes and metres of the field
    is_array: bool = False  # type 2
    # finds the units that are connected and reads their state, without a force; `rest` as for `make`. Raises
    # `TouchfieldError`. None for a device without identity
    find_units: Callable[[str], list[Readiness]] | None = None
    # settings of a point; ``configure(opener, values)`` returns an opener with some of them, texts
    # by name, or raises `InvalidArgument`
    settings: tuple[DeviceSetting, ...] = ()
    configure: Callable[[Opener, Mapping[str, str]], Opener] | None = None


class PointChoice(NamedTuple):
    """The point device that a user named; other fields as in its `DeviceKind`."""

    name: str
    opener: Opener
    profile: str | None
    is_simulated: bool


@cache
def device_kinds() -> tuple[DeviceKind, ...]:
    """Return all kinds of devices, those of plug-ins last."""
    return (*map(_built_in_kind, MODULES), *plugins("touchfield.drivers", DeviceKind).values())


def _built_in_kind(name: str) -> DeviceKind:
    kind: DeviceKind = import_module(f"touchfield.devices.drivers.{MODULES[name]}").KIND
    return kind


def point_kinds() -> tuple[DeviceKind, ...]:
    """Return all kinds of type 1 devices."""
    return tuple(kind for kind in device_kinds() if not kind.is_array)


def array_kinds() -> tuple[DeviceKind, ...]:
    """Return all kinds of type 2 devices."""
    return tuple(kind for kind in device_kinds() if kind.is_array)


def _find_kind(name: str, is_array: bool) -> DeviceKind | None:
    """Return the kind with this name and type; None if there is none.

    For a built-in name neither other modules nor plug-ins are imported.
    """
    kinds = (_built_in_kind(name),) if name in MODULES else device_kinds()
    return next((kind for kind in kinds if kind.name == name and kind.is_array == is_array), None)


def _require_kind(text: str, name: str, is_array: bool) -> DeviceKind:
    kind = _find_kind(name, is_array)
    if kind is not None:
        return kind
    kinds = array_kinds() if is_array else point_kinds()
    matches = difflib.get_close_matches(name.lower(), [kind.name for kind in kinds], n=1, cutoff=0.5)
    forms = ", ".join(kind.form for kind in (*point_kinds(), *array_kinds()))
    raise InvalidArgument(
        "--device", repr(text[:80]), forms, f"Did you mean {matches[0]}?" if matches else ""
    )


def point_device(text: str, trajectory: Trace | None = None, settings: str = "") -> PointChoice:
    """Return the point device named by `text`, such as "haply:127.0.0.1:10001".

    `settings` are "NAME=VALUE", with commas between them. The device is not opened. Raises InvalidArgument if
    there is no such kind, the text after the colon or a setting is invalid, or a trajectory is given for a
    device that a hand moves.
    """
    name, _, rest = text.strip().partition(":")
    kind = _require_kind(text, name.lower(), is_array=False)
    if trajectory is not None and not kind.is_simulated:
        raise InvalidArgument(
            "trajectory", f"one for {kind.name}", "none: there a hand moves", "Take --device sim."
        )
    opener: Opener = kind.make(rest, trajectory)
    values = settings_of(kind, settings)
    if values and kind.configure is not None:
        opener = kind.configure(opener, values)
    return PointChoice(kind.name, opener, kind.profile, kind.is_simulated)


def settings_of(kind: DeviceKind, text: str) -> dict[str, str]:
    """Parse settings such as "gravity=off,handedness=left"; raises InvalidArgument for one not of `kind`."""
    names = {setting.name: setting for setting in kind.settings}
    expected = ", ".join(f"{setting.name}={setting.form}" for setting in kind.settings)
    values: dict[str, str] = {}
    for part in text.split(",") if text.strip() else ():
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if name not in names or not equals or not value or name in values:
            raise InvalidArgument(
                "--settings", repr(text[:80]), expected or f"none: {kind.name} has no settings"
            )
        values[name] = value
    return values


def on_or_off(name: str, value: str) -> bool:
    """Parse the setting "on" or "off"; raises InvalidArgument for another text."""
    if value not in ("on", "off"):
        raise InvalidArgument(f"--settings {name}", repr(value[:40]), "on or off")
    return value == "on"


def positive_number(name: str, value: str, largest: float) -> float:
    """Parse a setting, a number above 0 and up to `largest`; raises InvalidArgument for another text."""
    try:
        number = float(value)
    except ValueError:
        number = 0.0
    if not 0.0 < number <= largest:
        raise InvalidArgument(f"--settings {name}", repr(value[:40]), f"a number above 0, up to {largest:g}")
    return number


def is_array_device(text: str) -> bool:
    """Return True if `text` names an array, even if the rest of it is invalid."""
    return _find_kind(text.strip().partition(":")[0].lower(), is_array=True) is not None


def array_device(
    text: str, profile: Device | None = None, stream_profile: Device | None = None
) -> ArrayDevice:
    """Return the array named by `text`, such as "osc:127.0.0.1:9000", with a profile.

    The profile is `profile` if given. Else, if the kind takes any, it is `stream_profile`, for which a stream
    was made; else the kind's default. Raises InvalidArgument if there is no such device, its address is
    invalid, or the profile does not fit it.
    """
    from touchfield.devices import device

    name, _, rest = text.strip().partition(":")
    kind = _require_kind(text, name.lower(), is_array=True)
    default = device(str(kind.profile))
    if (
        kind.takes_any
        and stream_profile is not None
        and stream_profile.is_array
        and stream_profile.shows == default.shows
    ):
        default = stream_profile
    selected = profile or default
    if not selected.is_array:
        raise InvalidArgument(
            f"profile of {name}", f"{selected.name}, a point", "an array of actuators (type 2)"
        )
    array: ArrayDevice = kind.make(rest, selected)
    return array


def require_device(text: str, settings: str = "") -> None:
    """Raise InvalidArgument unless `text` names a device, with an address and settings that it takes.

    Nothing is opened; a stream for the device may take a minute to open, and is not needed for this check.
    """
    if is_array_device(text):
        array_device(text)
    else:
        point_device(text, settings=settings)


def drives_of(profile: Device, drives: Float32s) -> Float64s:
    """Return drives clipped to 0..1, float64 [panels, rows, columns]; NaN becomes 0.

    Raises InvalidArgument if the shape is wrong.
    """
    columns, rows, _ = profile.lattice
    shape = (profile.panels, rows, columns)
    if np.shape(drives) != shape:
        raise InvalidArgument(f"drives of {profile.name}", f"shape {np.shape(drives)}", f"{shape}")
    return np.clip(np.nan_to_num(np.asarray(drives, np.float64), nan=0.0), 0.0, 1.0)


def steps_of(profile: Device, drives: Float32s, levels: int) -> Int64s:
    """Quantise drives to the nearest of `levels` levels, int64 [panels, rows, columns].

    Levels count from 0; halves round up.
    """
    return np.floor(drives_of(profile, drives) * (levels - 1) + 0.5).astype(np.int64)
