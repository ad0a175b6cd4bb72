"""Profiles of haptic devices, read from TOML files: workspace, greatest force, resolution and number of
actuators of each (paper sections 3.1 and 5.1).

Type 1 is a point that the hand moves through the field; type 2 is a fixed array of N x M actuators. Every
value of a profile has the source that it was taken from, "unverified" if none was found.

Departure from the paper, which has one workspace: a profile has two boxes. `workspace_mm` is the nominal one
of the data sheet, used by the device filter; `physical_mm` is what the arm can reach. Both are along x right,
y up, z towards the user, whatever the axes of the device's driver (`axes`).

The magnitude of an array is relative (a motor's drive, a pin's height): its `force_max_n` is the force of the
field that drives an actuator fully, and therefore a choice.

A new device is one more file in ``devices/profiles``; a user's own profile is given by the path of its TOML
file. OWO (10 electrical zones) and Woojer (6 transducers) are not included: their actuators lie on no regular
lattice, so that neither a pitch nor the cut-off of the paper's section 3.2 can be stated for them. Ultrasound
arrays are not included because they have no open interface.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from touchfield.arrays import Picklable
from touchfield.errors import DeviceError, InvalidArgument, SourceError, is_finite
from touchfield.files import read_bytes

MAX_SAMPLES_PER_AXIS: Final = 1 << 20
MAX_NUMBER: Final = 1e6
MAX_PROFILE_BYTES: Final = 1 << 16
MAX_PER_SIDE: Final = 1 << 10
MAX_ACTUATORS: Final = 1 << 14
"""An array's frame is filtered on 64 samples for each actuator, times the depth that its law needs."""


class _Rule(NamedTuple):
    """Form of a value in a profile: the types that need or allow it, and its format."""

    needed: tuple[int, ...] = ()
    allowed: tuple[int, ...] = (1, 2)
    size: int = 1
    is_integer: bool = False
    is_text: bool = False


_POINT: Final = {"rule": _Rule(allowed=(1,))}
_POINT_NEEDS: Final = {"rule": _Rule((1,), (1,))}
_POINT_BOX: Final = {"rule": _Rule(allowed=(1,), size=3)}
_ARRAY_COUNT: Final = {"rule": _Rule(allowed=(2,), is_integer=True)}
_ARRAY_NEEDS: Final = {"rule": _Rule((2,), (2,))}

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Device(Picklable):
    """A haptic display; unknown values are None.

    A field with a rule is a key of a profile. Units are in the names. Boxes are along x right, y up, z
    towards the user, whatever the `axes` of the driver; `lattice` is the number of samples along the nominal
    box. For an array, `force_max_n` is the force that drives an actuator fully.
    """

    name: str  # what ``--device`` takes
    title: str  # maker and model
    type: int  # 1 (point) or 2 (array)
    axes: str = field(metadata={"rule": _Rule((1, 2), is_text=True)})  # axes of its driver
    # nominal box; for an array columns * pitch, rows * pitch, and the depth over which the field is pooled
    workspace_mm: Triple = field(metadata={"rule": _Rule((1,), (1,), size=3)})
    lattice: tuple[int, int, int]  # of an array (columns, rows, 1)
    force_max_n: float = field(metadata={"rule": _Rule((1, 2))})  # peak
    force_continuous_n: float | None = field(default=None, metadata=_POINT)  # continuous
    rate_hz: float | None = field(default=None, metadata={"rule": _Rule((1,))})  # of updates
    resolution_mm: float | None = field(default=None, metadata=_POINT_NEEDS)  # of the position
    physical_mm: Triple | None = field(default=None, metadata=_POINT_BOX)  # the box that the arm can reach
    # largest stiffness that it can show along x, y, z
    stiffness_n_per_m: Triple | None = field(default=None, metadata=_POINT_BOX)
    pitch_mm: float | None = field(default=None, metadata=_ARRAY_NEEDS)  # between neighbours of an array
    levels: int | None = field(default=None, metadata=_ARRAY_COUNT)  # steps of one actuator, zero included
    # "force", or "height" for pins
    shows: str = field(default="force", metadata={"rule": _Rule(allowed=(2,), is_text=True)})
    # number of such arrays, for example front and back; the filter fills one
    panels: int = field(default=1, metadata=_ARRAY_COUNT)
    torque_max_nm: float | None = field(default=None, metadata=_POINT)
    torque_continuous_nm: float | None = field(default=None, metadata=_POINT)
    # `render.spec` assumes the worst case for those of these four that are unknown
    inertia_kg: float | None = field(default=None, metadata=_POINT)  # apparent mass at the tip
    damping_n_s_per_m: float | None = field(default=None, metadata=_POINT)  # viscous
    friction_n: float | None = field(default=None, metadata=_POINT)
    # from a reported position to the resulting force, without sampling and hold
    delay_ms: float | None = field(default=None, metadata=_POINT)
    # source of each value
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


_RULES: Final[Mapping[str, _Rule]] = {
    **{one.name: one.metadata["rule"] for one in fields(Device) if "rule" in one.metadata},
    "nominal_lattice": _Rule((1,), (1,), size=3, is_integer=True),
    **dict.fromkeys(("columns", "rows"), _Rule((2,), (2,), is_integer=True)),
    "depth_mm": _Rule((2,), (2,)),
}


def parse_table(table: Mapping[str, Any], where: str) -> Device:
    """Return the device that a parsed profile describes.

    `where` names the file in messages.

    Raises `DeviceError` if a key is unknown or missing, a value has no source or is out of range, or the
    nominal lattice contradicts the workspace and the resolution.
    """
    kind = table.get("type")
    if isinstance(kind, bool) or kind not in (1, 2):
        raise DeviceError(f"{where}: type", repr(kind), "1 (point) or 2 (array)")
    allowed = {"name", "title", "type", *(key for key, f in _RULES.items() if kind in f.allowed)}
    for key in table:
        if key not in allowed:
            raise DeviceError(f"{where}: {key}", "an unknown key", f"one of {', '.join(sorted(allowed))}")
    values: dict[str, Any] = {}
    sources: dict[str, str] = {}
    for key, rule in _RULES.items():
        if key in table:
            values[key], sources[key] = _value(table[key], rule, f"{where}: {key}")
        elif kind in rule.needed:
            raise DeviceError(
                f"{where}: {key}", "nothing", f"a value and its source in a type {kind} profile"
            )
    name, title = (_text(table.get(key), f"{where}: {key}") for key in ("name", "title"))
    if kind == 1:
        ratios = [extent / values["resolution_mm"] for extent in values["workspace_mm"]]
        computed = tuple(round(min(ratio, 1e9)) for ratio in ratios)  # a ratio may be infinite
        values["lattice"] = stated = values.pop("nominal_lattice")
        if stated != computed:
            expected = f"{computed}, workspace_mm over resolution_mm, rounded"
            raise DeviceError(f"{where}: nominal_lattice", f"{stated}", expected)
    else:
        columns, rows, depth = (values.pop(key) for key in ("columns", "rows", "depth_mm"))
        if max(columns, rows) > MAX_PER_SIDE or columns * rows > MAX_ACTUATORS:
            expected = f"{MAX_PER_SIDE} on a side and {MAX_ACTUATORS} in all at most"
            hint = "Describe a part of the array, or one actuator for several."
            raise DeviceError(f"{where}: columns and rows", f"{columns} x {rows} actuators", expected, hint)
        values["workspace_mm"] = (columns * values["pitch_mm"], rows * values["pitch_mm"], depth)
        values["lattice"] = (columns, rows, 1)
        if values.get("shows", "force") not in ("force", "height"):
            raise DeviceError(f"{where}: shows.value", repr(values["shows"]), "force, or height of pins")
    return Device(name=name, title=title, type=kind, sources=sources, **values)


def _text(value: object, where: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise DeviceError(where, repr(value), "some text")
    return value.strip()


def _value(entry: object, rule: _Rule, where: str) -> tuple[Any, str]:
    """Return the checked value of one entry, and its source."""
    if not isinstance(entry, dict):
        raise DeviceError(where, repr(entry)[:80], "a table with value and source")
    for key in entry:
        if key not in ("value", "source"):
            raise DeviceError(f"{where}.{key}", "an unknown key", "value and source")
    source = _text(entry.get("source"), f"{where}.source")
    value: Any = entry.get("value")
    where += ".value"
    if rule.is_text:
        return _text(value, where), source
    numbers = value if isinstance(value, list) and rule.size > 1 else [value]
    if len(numbers) != rule.size:
        raise DeviceError(where, repr(value)[:80], f"a list of {rule.size} numbers")
    kinds, limit = (int, MAX_SAMPLES_PER_AXIS) if rule.is_integer else ((int, float), MAX_NUMBER)
    for number in numbers:
        is_number = isinstance(number, kinds) and not isinstance(number, bool)
        if not (is_number and is_finite(number) and 0 < number <= limit):
            expected = f"a positive {'whole ' if rule.is_integer else ''}number up to {limit:.0f}"
            raise DeviceError(where, repr(number)[:80], expected)
    checked = tuple(int(number) if rule.is_integer else float(number) for number in numbers)
    return (checked if rule.size > 1 else checked[0]), source


@cache
def devices() -> tuple[Device, ...]:
    """Return all devices included in touchfield, sorted by name."""
    profiles = (resources.files("touchfield.devices") / "profiles").iterdir()
    return tuple(
        sorted(
            (_parse(profile.read_bytes(), profile.name) for profile in profiles),
            key=lambda device: device.name,
        )
    )


def device_names() -> tuple[str, ...]:
    """Return the names that `device` accepts, sorted."""
    return tuple(profile.name for profile in devices())


def device(name_or_path: str | Path) -> Device:
    """Return the device with a name, or that of a TOML profile at a path.

    Raises `InvalidArgument` if it is neither; `DeviceError` if the profile cannot be read or is invalid.
    """
    text = str(name_or_path)
    names = device_names()
    if text in names:
        return devices()[names.index(text)]
    if text.endswith(".toml") or Path(text).name != text:
        return _parse(_file_bytes(Path(text)), text)
    matches = difflib.get_close_matches(text.lower(), names, n=1, cutoff=0.4)
    hint = f"Did you mean {matches[0]}?" if matches else "Or give the path of a TOML profile."
    raise InvalidArgument("device", repr(text), f"one of {', '.join(names)}", hint)


def _file_bytes(path: Path) -> bytes:
    try:
        return read_bytes(path, MAX_PROFILE_BYTES, "a TOML profile")
    except SourceError as error:
        raise DeviceError(error.where, error.found, error.expected, error.hint) from error


def _parse(data: bytes, where: str) -> Device:
    try:
        table = tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:  # ValueError: also an integer of thousands of digits
        raise DeviceError(where, f"no TOML ({error})", "a TOML profile") from error
    return parse_table(table, where)
