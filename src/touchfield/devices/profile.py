"""Abilities of a haptic display (paper sections 3.1 and 5.1): `Device`, and its reading from a TOML profile.

Type 1 is a point that the hand moves through the field; type 2 is a fixed array of N x M actuators. Every
value of a profile carries the source that it was taken from, "unverified" where none was seen.

Departure from the paper: it speaks of "the" workspace; a profile has two boxes. `workspace_mm` is the nominal
one of the data sheet, which the device filter uses; `physical_mm` is what the arm can reach. Both are given
along x right, y up, z towards the user, whatever the axes of the device's own driver (`axes`).

The magnitude of an array is relative (a motor's drive, a pin's height): its `force_max_n` is the force of the
field that drives an actuator fully, and therefore a choice.

A new device is one more file in ``devices/profiles``; a user's own is named by the path of its TOML file.
OWO (10 electrical zones) and Woojer (6 transducers) are left out: their actuators lie on no regular lattice,
so that neither a pitch nor the cut-off of the paper's section 3.2 can be stated for them. Ultrasound arrays
are left out because they have no open interface.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from touchfield.arrays import Travels
from touchfield.errors import DeviceError, InvalidArgument, SourceError
from touchfield.files import require_plain

MAX_SAMPLES_PER_AXIS: Final = 1 << 20
LARGEST: Final = 1e6
MAX_PROFILE_BYTES: Final = 1 << 16


@dataclass(frozen=True)
class Device(Travels):
    """A haptic display; a value that is not known is None.

    Attributes
    ----------
    name, title : str
        What ``--device`` takes; maker and model.
    type : int
        1 (point) or 2 (array).
    axes : str
        Axes of the device's own driver; the boxes below always lie along x right, y up, z towards the user.
    workspace_mm, physical_mm : (float, float, float)
        Nominal box, of an array (columns * pitch, rows * pitch, depth that is pooled); the box that is reached.
    lattice : (int, int, int)
        Samples along the box; of an array (columns, rows, 1).
    force_max_n, force_continuous_n, torque_max_nm, torque_continuous_nm : float
        Peak and continuous force (of an array the force that drives an actuator fully) and torque.
    rate_hz, resolution_mm, stiffness_n_per_m
        Update rate, position resolution, and the stiffness that it can show along x, y, z.
    pitch_mm, levels, panels
        Of an array: distance between neighbours, steps of one actuator, zero included, and how many such arrays there
        are, as front and back of a vest; the filter fills one.
    inertia_kg, damping_n_s_per_m, friction_n, delay_ms : float
        Apparent mass at the tip, viscous damping, friction, and the time from a place that is told to a force that
        acts, beside sampling and holding; `render.walls` assumes the worst of what is not known.
    sources : mapping of str to str
        Where each value comes from.
    """

    name: str
    title: str
    type: int
    axes: str
    workspace_mm: tuple[float, float, float]
    lattice: tuple[int, int, int]
    force_max_n: float
    force_continuous_n: float | None = None
    rate_hz: float | None = None
    resolution_mm: float | None = None
    physical_mm: tuple[float, float, float] | None = None
    stiffness_n_per_m: tuple[float, float, float] | None = None
    pitch_mm: float | None = None
    levels: int | None = None
    panels: int = 1
    torque_max_nm: float | None = None
    torque_continuous_nm: float | None = None
    inertia_kg: float | None = None
    damping_n_s_per_m: float | None = None
    friction_n: float | None = None
    delay_ms: float | None = None
    sources: Mapping[str, str] = field(default_factory=dict, repr=False, hash=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sources", MappingProxyType(dict(self.sources)))

    @property
    def is_array(self) -> bool:
        """True for a type 2 device."""
        return self.type == 2

    @property
    def workspace_m(self) -> tuple[float, float, float]:
        """The nominal box, metres, along x right, y up, z towards the user."""
        x, y, z = self.workspace_mm
        return (x / 1000, y / 1000, z / 1000)


@dataclass(frozen=True)
class _Field:
    """Form of one field of a profile: whole numbers or not, how many, and for which types."""

    count: int = 1
    whole: bool = False
    needed: tuple[int, ...] = ()
    allowed: tuple[int, ...] = (1, 2)
    text: bool = False


_FIELDS: Final[Mapping[str, _Field]] = {
    "axes": _Field(text=True, needed=(1, 2)),
    "workspace_mm": _Field(count=3, needed=(1,), allowed=(1,)),
    "physical_mm": _Field(count=3, allowed=(1,)),
    "resolution_mm": _Field(needed=(1,), allowed=(1,)),
    "nominal_lattice": _Field(count=3, whole=True, needed=(1,), allowed=(1,)),
    "force_max_n": _Field(needed=(1, 2)),
    "force_continuous_n": _Field(allowed=(1,)),
    "stiffness_n_per_m": _Field(count=3, allowed=(1,)),
    "rate_hz": _Field(needed=(1,)),
    **dict.fromkeys(("columns", "rows"), _Field(whole=True, needed=(2,), allowed=(2,))),
    **dict.fromkeys(("pitch_mm", "depth_mm"), _Field(needed=(2,), allowed=(2,))),
    **dict.fromkeys(("levels", "panels"), _Field(whole=True, allowed=(2,))),
    **dict.fromkeys(("torque_max_nm", "torque_continuous_nm", "inertia_kg"), _Field(allowed=(1,))),
    **dict.fromkeys(("damping_n_s_per_m", "friction_n", "delay_ms"), _Field(allowed=(1,))),
}


def device_of_table(table: Mapping[str, Any], where: str) -> Device:
    """The device that a parsed profile describes; `where` names the file in messages.

    `DeviceError` if a key is unknown or missing, a value has no source or is out of range, or the nominal lattice
    contradicts the workspace and the resolution.
    """
    kind = table.get("type")
    if isinstance(kind, bool) or kind not in (1, 2):
        raise DeviceError(f"{where}: type", repr(kind), "1 (point) or 2 (array)")
    known = {"name", "title", "type", *(key for key, f in _FIELDS.items() if kind in f.allowed)}
    for key in table:
        if key not in known:
            raise DeviceError(f"{where}: {key}", "an unknown key", f"one of {', '.join(sorted(known))}")
    values: dict[str, Any] = {}
    sources: dict[str, str] = {}
    for key, rule in _FIELDS.items():
        if key in table:
            values[key], sources[key] = _value(table[key], rule, f"{where}: {key}")
        elif kind in rule.needed:
            raise DeviceError(f"{where}: {key}", "nothing", f"a value and its source in a type {kind} profile")
    name, title = (_text(table.get(key), f"{where}: {key}") for key in ("name", "title"))
    if kind == 1:
        computed = tuple(round(extent / values["resolution_mm"]) for extent in values["workspace_mm"])
        values["lattice"] = stated = values.pop("nominal_lattice")
        if stated != computed:
            expected = f"{computed}, workspace_mm over resolution_mm, rounded"
            raise DeviceError(f"{where}: nominal_lattice", f"{stated}", expected)
    else:
        columns, rows, depth = (values.pop(key) for key in ("columns", "rows", "depth_mm"))
        values["workspace_mm"] = (columns * values["pitch_mm"], rows * values["pitch_mm"], depth)
        values["lattice"] = (columns, rows, 1)
    return Device(name=name, title=title, type=kind, sources=sources, **values)


def _text(value: object, where: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise DeviceError(where, repr(value), "some text")
    return value.strip()


def _value(entry: object, rule: _Field, where: str) -> tuple[Any, str]:
    """The checked value of one entry, and its source."""
    if not isinstance(entry, dict):
        raise DeviceError(where, repr(entry)[:80], "a table with value and source")
    for key in entry:
        if key not in ("value", "source"):
            raise DeviceError(f"{where}.{key}", "an unknown key", "value and source")
    source = _text(entry.get("source"), f"{where}.source")
    value: Any = entry.get("value")
    where += ".value"
    if rule.text:
        return _text(value, where), source
    numbers = value if isinstance(value, list) and rule.count > 1 else [value]
    if len(numbers) != rule.count:
        raise DeviceError(where, repr(value)[:80], f"a list of {rule.count} numbers")
    kinds, limit = (int, MAX_SAMPLES_PER_AXIS) if rule.whole else ((int, float), LARGEST)
    for number in numbers:
        is_number = isinstance(number, kinds) and not isinstance(number, bool)
        if not (is_number and math.isfinite(number) and 0 < number <= limit):
            expected = f"a positive {'whole ' if rule.whole else ''}number up to {limit:.0f}"
            raise DeviceError(where, repr(number)[:80], expected)
    checked = tuple(int(number) if rule.whole else float(number) for number in numbers)
    return (checked if rule.count > 1 else checked[0]), source


@cache
def device_names() -> tuple[str, ...]:
    """The names that `device` takes, sorted."""
    folder = resources.files("touchfield.devices") / "profiles"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml")))


@cache
def devices() -> tuple[Device, ...]:
    """All devices that come with touchfield, sorted by name."""
    return tuple(_shipped(name) for name in device_names())


def device(name_or_path: str | Path) -> Device:
    """The device of a name, or of the path of a TOML profile.

    `InvalidArgument` if it is neither; `DeviceError` if the profile cannot be read or is unusable.
    """
    text = str(name_or_path)
    if text in device_names():
        return _shipped(text)
    if text.endswith(".toml") or Path(text).name != text:
        return _parsed(_file_bytes(Path(text)), text)
    names = device_names()
    near = difflib.get_close_matches(text.lower(), names, n=1, cutoff=0.4)
    mend = f"Did you mean {near[0]}?" if near else "Or give the path of a TOML profile."
    raise InvalidArgument("device", repr(text), f"one of {', '.join(names)}", mend)


@cache
def _shipped(name: str) -> Device:
    profile = resources.files("touchfield.devices") / "profiles" / f"{name}.toml"
    return _parsed(profile.read_bytes(), profile.name)


def _file_bytes(path: Path) -> bytes:
    try:
        require_plain(path, "a TOML profile")
        with path.open("rb") as file:
            data = file.read(MAX_PROFILE_BYTES + 1)
    except SourceError as error:
        raise DeviceError(error.where, error.found, error.expected) from error
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL in it
        raise DeviceError(str(path), f"a file that cannot be read ({error})", "a TOML profile") from error
    if len(data) > MAX_PROFILE_BYTES:
        raise DeviceError(str(path), f"more than {MAX_PROFILE_BYTES} bytes", "a TOML profile of a few kilobytes")
    return data


def _parsed(data: bytes, where: str) -> Device:
    try:
        table = tomllib.loads(data.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise DeviceError(where, f"no TOML ({error})", "a TOML profile") from error
    return device_of_table(table, where)
