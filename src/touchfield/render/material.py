"""Materials of surfaces: the friction, the stick-slip and the vibration that a hand feels when it slides
along a surface (paper section 6.4). This file reads and writes tables of them.

A field defines how hard a surface pushes, but not how it feels to slide along it. A `Material` defines that,
for the whole field, a box or an object: mu, stick-slip, and the rms of the vibration in thirds of an octave,
tabulated over the speed of the hand and the force that it presses with. Tables are JSON::

    {"bands_hz": [31.6, ..., 1000], "materials": [
        {"name": "wood", "friction": 0.4, "object": "table", "speeds_m_s": [0.05, 0.1], "forces_n": [1],
         "texture_rms_n": [[[0.001, ...]], [[0.002, ...]]]}]}

A table is a separate file, or is stored with a medium as the entry ``materials.json`` of its provenance.
Every reader of the format allows this entry, and only the renderer uses it. A medium without the entry is
unchanged, byte for byte.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.atomic import atomic_path
from touchfield.errors import CorruptFile, InvalidArgument, SourceError, as_source_error, require_ending
from touchfield.files import json_of, read_bytes
from touchfield.medium.field import numbers_of
from touchfield.perception.vibrotactile import BANDS_HZ
from touchfield.render.block import layout

if TYPE_CHECKING:
    from touchfield.render.block import Memory
Levels = tuple[tuple[tuple[float, ...], ...], ...]


KEY: Final = "materials.json"  # key in the provenance of a medium
MAX_MATERIALS: Final = 64
MAX_LEVELS: Final = 32  # maximum number of speeds, and of forces, of one material
_MAX_BYTES: Final = 1 << 22
_MAX_STORED_LENGTH: Final = 4096
_EVERYWHERE: Final = ((-math.inf,) * 3, (math.inf,) * 3)
_SINES_PER_BAND: Final = layout.SINE_COUNT // len(BANDS_HZ)


@dataclass(frozen=True)
class Material:
    """Material of a surface.

    Raises `InvalidArgument` if a number is out of range or not finite, or the shape of the table is not
    [speeds, forces, 16].
    """

    name: str
    # mu of a sliding hand, 0 or more; None: that of the medium
    friction: float | None = None
    # mu just before it slips, `friction` or more; None: no stick-slip
    static_friction: float | None = None
    # distance that the hand moves from one slip to the next, positive
    slip_length_m: float = 0.001
    # name of the object in a scene that has this material; None: any
    object: str | None = None
    # minimum and maximum of x, y, z; None: everywhere
    box_m: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    # axes of the table: speeds of the hand and normal forces, each rising from above 0
    speeds_m_s: tuple[float, ...] = ()
    forces_n: tuple[float, ...] = ()
    # [speeds, forces, 16], newtons rms in each of `perception.vibrotactile.BANDS_HZ`
    texture_rms_n: Levels = ()

    def __post_init__(self) -> None:
        prefix = f"material {self.name!r} "
        for name, low in (("friction", 0.0), ("static_friction", self.friction or 0.0)):
            value = getattr(self, name)
            if value is not None and not low <= value < math.inf:
                raise InvalidArgument(prefix + name, repr(value), f"a finite number, {low:g} or more")
        if self.static_friction is not None and self.friction is None:
            raise InvalidArgument(prefix + "static_friction", "a value without friction", "both of them")
        if not 1e-6 <= self.slip_length_m < math.inf:
            raise InvalidArgument(prefix + "slip_length_m", repr(self.slip_length_m), "metres, 1e-6 or more")
        box = None if self.box_m is None else np.array(self.box_m, np.float64)
        if box is not None and (box.shape != (2, 3) or not (box[0] <= box[1]).all()):
            raise InvalidArgument(
                prefix + "box_m", repr(self.box_m), "[[x, y, z], [x, y, z]], minimum and maximum"
            )
        for name in ("speeds_m_s", "forces_n"):
            row = np.array(getattr(self, name), np.float64)
            if (
                len(row) > MAX_LEVELS
                or not np.isfinite(row).all()
                or not (np.diff(row, prepend=0.0) > 0).all()
            ):
                raise InvalidArgument(
                    prefix + name, repr(getattr(self, name)), "rising numbers above 0, at most 32"
                )
        shape = len(self.speeds_m_s), len(self.forces_n), len(BANDS_HZ)
        levels = self.levels_n
        if levels.shape != (shape if levels.size else (0,)) or (not levels.size and shape[0] + shape[1]):
            raise InvalidArgument(
                prefix + "texture_rms_n", f"shape {levels.shape}", f"{shape}, speeds, forces, bands"
            )
        if not (np.isfinite(levels) & (levels >= 0)).all():
            raise InvalidArgument(
                prefix + "texture_rms_n", "a number below 0 or not finite", "newtons rms, 0 or more"
            )

    @property
    def levels_n(self) -> Float64s:
        """The table, newtons rms, float64 [speeds, forces, 16]; [0] if there is none."""
        return numbers_of(f"material {self.name!r} texture_rms_n", self.texture_rms_n)


def materials_json(materials: Iterable[Material]) -> str:
    """Return the table as JSON.

    Levels have four digits; values equal to the default are left out.
    """
    default, entries = Material(""), []
    for material in materials:
        entry = {
            f.name: getattr(material, f.name)
            for f in fields(material)
            if getattr(material, f.name) != getattr(default, f.name)
        }
        if material.texture_rms_n:
            entry["texture_rms_n"] = [
                [[float(f"{v:.4g}") for v in row] for row in rows] for rows in material.texture_rms_n
            ]
        entries.append(entry)
    bands = [float(f"{hz:.4g}") for hz in BANDS_HZ]
    return json.dumps({"bands_hz": bands, "materials": entries}, separators=(",", ":"), allow_nan=False)


def _parse_materials(text: str, where: str) -> tuple[Material, ...]:
    """Parse the materials of a JSON table; `SourceError` names the entry if it is invalid."""
    try:
        table = json_of(text)
        bands, rows = table["bands_hz"], table["materials"]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        found = f"text that is no table of materials ({error})"
        raise SourceError(where, found, 'JSON: {"bands_hz": [...], "materials": [...]}') from None
    if not _are_expected_bands(bands):
        expected = f"thirds of an octave from {BANDS_HZ[0]:.3g} to {BANDS_HZ[-1]:g} Hz"
        raise SourceError(f"{where} bands_hz", repr(bands)[:80], expected)
    if not isinstance(rows, list) or len(rows) > MAX_MATERIALS:
        raise SourceError(f"{where} materials", repr(rows)[:80], f"a list of at most {MAX_MATERIALS}")
    return tuple(_parse_material(row, f"{where} materials[{n}]") for n, row in enumerate(rows))


def _are_expected_bands(bands: Any) -> bool:
    """Return True for the list of `BANDS_HZ`, to three digits."""
    if not isinstance(bands, list):
        return False
    rounded = [f"{band_hz:.3g}" if isinstance(band_hz, float | int) else band_hz for band_hz in bands]
    return rounded == [f"{band_hz:.3g}" for band_hz in BANDS_HZ]


def _parse_material(row: Any, where: str) -> Material:
    keys = [f.name for f in fields(Material)]
    is_named = isinstance(row, dict) and isinstance(row.get("name"), str)
    if not is_named or not isinstance(row.get("object", ""), str):
        raise SourceError(where, repr(row)[:80], 'an object with a "name"; "object" is a name, too')
    unknown = [key for key in row if key not in keys]
    if unknown:
        raise SourceError(where, repr(unknown[0])[:80], f"{', '.join(keys)}", "Take it out.")
    with as_source_error(f"{where} "):
        try:
            return Material(**{key: _as_tuples(value) for key, value in row.items()})
        except (TypeError, ValueError) as error:
            if isinstance(error, InvalidArgument):
                raise
            raise SourceError(
                where, f"a value of the wrong type ({error})", "numbers, and rows of numbers"
            ) from None


def _as_tuples(value: Any) -> Any:
    """Convert nested lists to nested tuples."""
    return tuple(_as_tuples(item) for item in value) if isinstance(value, list) else value


def read_materials(path: str | Path) -> tuple[Material, ...]:
    """Read a table of materials; `SourceError` names the file and field if it is invalid."""
    description = "a table of materials, JSON, as touchfield texture makes one of a recording"
    try:
        return _parse_materials(read_bytes(path, _MAX_BYTES, description).decode("utf-8-sig"), str(path))
    except UnicodeDecodeError:
        raise SourceError(str(path), "a file that is not text", description) from None


def write_table(path: str | Path, materials: Iterable[Material]) -> None:
    """Write a table of materials as JSON, atomically.

    Raises `SourceError` if the file cannot be written.
    """
    require_ending(path, "TABLE.json")
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(materials_json(materials) + "\n", encoding="utf-8")


def stored_materials(provenance: Mapping[str, str]) -> tuple[Material, ...]:
    """Return the materials stored with a medium; none if there is no such entry.

    Raises `CorruptFile` if the entry is damaged.
    """
    if KEY not in provenance:
        return ()
    try:
        return _parse_materials(provenance[KEY], f"PROV {KEY}")
    except SourceError as error:  # the file at fault is the stream
        raise CorruptFile(error.where, error.found, error.expected, error.hint) from None


def stored_json(materials: Iterable[Material]) -> str:
    """Return `materials_json` for the provenance of a file.

    Raises `InvalidArgument` if it is too long.
    """
    text = materials_json(materials)
    if len(text) > _MAX_STORED_LENGTH:
        found, expected = f"a table of {len(text)} characters", f"at most {_MAX_STORED_LENGTH}"
        hint = "Give it separately: touchfield play --materials FILE.json."
        raise InvalidArgument("materials", found, expected, hint)
    return text


def material_bytes(materials: Sequence[Material]) -> int:
    """Return the size of materials in the memory of a receiver, bytes."""
    if not materials:
        return 0
    numbers = sum(len(m.speeds_m_s) + len(m.forces_n) + m.levels_n.size for m in materials)
    tables = layout.MATERIAL_SINES.itemsize + layout.MATERIAL.itemsize * len(materials)
    return tables + np.dtype(np.float64).itemsize * numbers


def write_materials(
    memory: Memory,
    offset: int,
    materials: Sequence[Material],
    objects: Sequence[str] = (),
    has_friction: bool = True,
) -> tuple[str, ...]:
    """Write materials at an offset, with their sines at rest; return notes for the user.

    `objects` are the names of the bodies of each frame. If `has_friction` is false, mu is that of the field
    everywhere. Raises `InvalidArgument` if a material belongs to an object that does not exist.
    """
    settings = memory.receiver["settings"]
    settings["material_offset"], settings["material_count"] = offset, len(materials)
    if not materials:
        return ()
    n = np.arange(layout.SINE_COUNT)
    centres = np.repeat(BANDS_HZ, _SINES_PER_BAND)
    sines = memory.view(layout.MATERIAL_SINES, offset)
    octave_thirds = (n % _SINES_PER_BAND + 0.5) / _SINES_PER_BAND - 0.5
    sines["frequency_rad_s"] = 2 * np.pi * centres * 10 ** (0.1 * octave_thirds)
    sines["phase_rad"] = 2 * np.pi * (n * 0.6180339887498949 % 1)  # distinct phases
    offset += layout.MATERIAL_SINES.itemsize
    rows = memory.array(layout.MATERIAL, offset, len(materials))
    offset += rows.nbytes
    for row, material in zip(rows, materials, strict=True):
        if material.object is not None and material.object not in objects:
            expected = (
                f"one of {', '.join(objects)}" if objects else "none: this medium is a field, not objects"
            )
            raise InvalidArgument(f"material {material.name!r} object", repr(material.object), expected)
        mu = material.friction if has_friction and material.friction is not None else math.nan
        row["friction"], row["slip_m"] = mu, material.slip_length_m
        row["static_friction"] = material.static_friction or 0.0
        row["body"] = -1 if material.object is None else list(objects).index(material.object)
        row["low_m"], row["high_m"] = material.box_m or _EVERYWHERE
        for name, values in (("speed", material.speeds_m_s), ("force", material.forces_n)):
            row[f"{name}_count"], row[f"{name}_offset"] = len(values), offset
            memory.array(np.float64, offset, len(values))[:] = values
            offset += np.dtype(np.float64).itemsize * len(values)
        levels = material.levels_n.ravel()
        row["level_offset"] = offset
        memory.array(np.float64, offset, len(levels))[:] = levels
        offset += levels.nbytes
    limit_n_per_s = settings["force_limits"]["slew_per_s"] / settings["force_scale"]
    return _notes(materials, float(settings["rate_hz"]), float(limit_n_per_s))


def _notes(materials: Sequence[Material], rate_hz: float, slew_n_per_s: float) -> tuple[str, ...]:
    """Return notes on the materials, and on the parts that the loop or the device cannot render."""
    notes = [f"materials: {', '.join(material.name for material in materials)}"]
    bands = np.array(BANDS_HZ)
    rendered = 2 * 10**0.05 * bands < rate_hz
    for material in (material for material in materials if material.texture_rms_n):
        slews_n_per_s = np.sqrt(((2 * np.pi * bands * material.levels_n) ** 2)[..., rendered].sum(axis=-1))
        max_slew_n_per_s = layout.MATERIAL_CREST * slews_n_per_s.max()
        if max_slew_n_per_s > slew_n_per_s:
            loss_db = 20 * math.log10(max_slew_n_per_s / slew_n_per_s)
            notes.append(
                f"{material.name} is weaker by up to {loss_db:.1f} dB than its table, because of the slew "
                f"limit of {slew_n_per_s:g} N/s"
            )
        if material.levels_n[..., ~rendered].any():
            max_hz = f"{bands[rendered][-1]:.0f}" if rendered.any() else "0"
            notes.append(
                f"the texture of {material.name} above {max_hz} Hz needs more than {rate_hz:g} ticks a second"
            )
    return tuple(notes)
