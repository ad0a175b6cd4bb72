"""Materials of surfaces: a small table of friction, stick-slip and vibration by speed and force (section
6.4).

A field tells how hard a surface pushes, not how it feels to slide along it. A `Material` tells that, for the
whole field, a box or an object: mu, stick-slip, and the rms of the vibration in thirds of an octave at some
speeds of the hand and some forces that it presses with. Tables are JSON::

    {"bands_hz": [31.6, ..., 1000], "materials": [
        {"name": "wood", "friction": 0.4, "object": "table", "speeds_m_s": [0.05, 0.1], "forces_n": [1],
         "texture_rms_n": [[[0.001, ...]], [[0.002, ...]]]}]}

They lie in a file of their own, or travel with a medium: as the entry ``materials.json`` of its provenance,
which every reader of the format allows and only the renderer looks at. A medium without it is the same to the
last byte.
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
from touchfield.errors import InvalidArgument, SourceError, blamed_on, require_ending
from touchfield.files import json_of, read_bytes
from touchfield.medium.field import numbers_of
from touchfield.perception.vibrotactile import BANDS_HZ
from touchfield.render.block import words as W

if TYPE_CHECKING:
    from touchfield.render.block import Memory
Levels = tuple[tuple[tuple[float, ...], ...], ...]


KEY: Final = "materials.json"  # Of a medium's provenance
MOST_MATERIALS: Final = 64
MOST_LEVELS: Final = 32  # Speeds, and forces, of one material
_MOST_BYTES: Final = 1 << 22
_MOST_STORED: Final = 4096
_EVERYWHERE: Final = ((-math.inf,) * 3, (math.inf,) * 3)
_SINES: Final = W.MATERIAL_SINES // len(BANDS_HZ)


@dataclass(frozen=True)
class Material:
    """Material of a surface.

    Raises `InvalidArgument` if a number is out of range or not finite, or the table is no [speeds, forces,
    16].
    """

    name: str
    friction: float | None = None  # mu of a hand that slides, 0 or more; None: that of the medium
    static_friction: float | None = (
        None  # mu just before it gives way, `friction` or more; None: no stick-slip
    )
    slip_length_m: float = 0.001  # way of the hand from one slip to the next, positive
    object: str | None = None  # of a scene of objects, the one that is made of it; None: any
    box_m: tuple[tuple[float, ...], tuple[float, ...]] | None = (
        None  # least and greatest x, y, z; None: everywhere
    )
    speeds_m_s: tuple[float, ...] = ()  # of the table, rising from above 0
    forces_n: tuple[float, ...] = ()  # that press, likewise
    # [speeds, forces, 16], newtons rms in each of `perception.vibrotactile.BANDS_HZ`
    texture_rms_n: Levels = ()

    def __post_init__(self) -> None:
        whose = f"material {self.name!r} "
        for name, low in (("friction", 0.0), ("static_friction", self.friction or 0.0)):
            value = getattr(self, name)
            if value is not None and not low <= value < math.inf:
                raise InvalidArgument(whose + name, repr(value), f"a finite number, {low:g} or more")
        if self.static_friction is not None and self.friction is None:
            raise InvalidArgument(whose + "static_friction", "it alone", "friction beside it")
        if not 1e-6 <= self.slip_length_m < math.inf:
            raise InvalidArgument(whose + "slip_length_m", repr(self.slip_length_m), "metres, 1e-6 or more")
        box = None if self.box_m is None else np.array(self.box_m, np.float64)
        if box is not None and (box.shape != (2, 3) or not (box[0] <= box[1]).all()):
            raise InvalidArgument(
                whose + "box_m", repr(self.box_m), "[[x, y, z], [x, y, z]], least and greatest"
            )
        for name in ("speeds_m_s", "forces_n"):
            row = np.array(getattr(self, name), np.float64)
            if (
                len(row) > MOST_LEVELS
                or not (np.diff(row, prepend=0.0) > 0).all()
                or not np.isfinite(row).all()
            ):
                raise InvalidArgument(
                    whose + name, repr(getattr(self, name)), "rising numbers above 0, at most 32"
                )
        shape = len(self.speeds_m_s), len(self.forces_n), len(BANDS_HZ)
        levels = self.levels_n
        if levels.shape != (shape if levels.size else (0,)) or (not levels.size and shape[0] + shape[1]):
            raise InvalidArgument(
                whose + "texture_rms_n", f"shape {levels.shape}", f"{shape}, speeds, forces, bands"
            )
        if not (np.isfinite(levels) & (levels >= 0)).all():
            raise InvalidArgument(
                whose + "texture_rms_n", "a number below 0 or not finite", "newtons rms, 0 or more"
            )

    @property
    def levels_n(self) -> Float64s:
        """The table, newtons rms, float64 [speeds, forces, 16]; [0] where there is none."""
        return numbers_of(f"material {self.name!r} texture_rms_n", self.texture_rms_n)


def materials_json(materials: Iterable[Material]) -> str:
    """The table as JSON, levels to four digits; what is as by default is left out."""
    usual, entries = Material(""), []
    for one in materials:
        own = {
            f.name: getattr(one, f.name)
            for f in fields(one)
            if getattr(one, f.name) != getattr(usual, f.name)
        }
        if one.texture_rms_n:
            own["texture_rms_n"] = [
                [[float(f"{v:.4g}") for v in row] for row in rows] for rows in one.texture_rms_n
            ]
        entries.append(own)
    bands = [float(f"{hz:.4g}") for hz in BANDS_HZ]
    return json.dumps({"bands_hz": bands, "materials": entries}, separators=(",", ":"), allow_nan=False)


def _materials_of(text: str, where: str) -> tuple[Material, ...]:
    """The materials of a table; SourceError that names the place if it is none."""
    try:
        table = json_of(text)
        bands, rows = table["bands_hz"], table["materials"]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        said = f"what is no table of materials ({error})"
        raise SourceError(where, said, 'JSON: {"bands_hz": [...], "materials": [...]}') from None
    if not isinstance(bands, list) or [f"{b:.3g}" if isinstance(b, float | int) else b for b in bands] != [
        f"{hz:.3g}" for hz in BANDS_HZ
    ]:
        expected = f"thirds of an octave from {BANDS_HZ[0]:.3g} to {BANDS_HZ[-1]:g} Hz"
        raise SourceError(f"{where} bands_hz", repr(bands)[:80], expected)
    if not isinstance(rows, list) or len(rows) > MOST_MATERIALS:
        raise SourceError(f"{where} materials", repr(rows)[:80], f"a list of at most {MOST_MATERIALS}")
    return tuple(_material_of(row, f"{where} materials[{n}]") for n, row in enumerate(rows))


def _material_of(row: Any, where: str) -> Material:
    known = [f.name for f in fields(Material)]
    if (
        not isinstance(row, dict)
        or not isinstance(row.get("name"), str)
        or not isinstance(row.get("object", ""), str)
    ):
        raise SourceError(where, repr(row)[:80], 'an object with a "name"; "object" is a name, too')
    stray = [key for key in row if key not in known]
    if stray:
        raise SourceError(where, repr(stray[0])[:80], f"{', '.join(known)}", "Take it out.")
    with blamed_on(f"{where} "):
        try:
            return Material(**{key: _plain(value) for key, value in row.items()})
        except (TypeError, ValueError) as error:
            if isinstance(error, InvalidArgument):
                raise
            raise SourceError(
                where, f"a value of another kind ({error})", "numbers, and rows of numbers"
            ) from None


def _plain(value: Any) -> Any:
    """Rows as tuples."""
    return tuple(_plain(one) for one in value) if isinstance(value, list) else value


def read_materials(path: str | Path) -> tuple[Material, ...]:
    """Read a table of materials, JSON as above; `SourceError` that names file and field if it is none."""
    what = "a table of materials, JSON, as touchfield texture makes one of a recording"
    try:
        return _materials_of(read_bytes(path, _MOST_BYTES, what).decode("utf-8-sig"), str(path))
    except UnicodeDecodeError:
        raise SourceError(str(path), "what is no text", what) from None


def write_table(path: str | Path, materials: Iterable[Material]) -> None:
    """Write a table of materials as JSON, whole or not at all; `SourceError` if the system refuses."""
    require_ending(path, "TABLE.json")
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(materials_json(materials) + "\n", encoding="utf-8")


def stored_materials(provenance: Mapping[str, str]) -> tuple[Material, ...]:
    """The materials that travel with a medium; none where there is no such entry, `SourceError` if it is
    damaged.
    """
    return _materials_of(provenance[KEY], f"provenance, {KEY}") if KEY in provenance else ()


def stored_json(materials: Iterable[Material]) -> str:
    """`materials_json` as it fits into the provenance of a file; `InvalidArgument` where it is too long."""
    text = materials_json(materials)
    if len(text) > _MOST_STORED:
        mend = "Give it beside the file: touchfield play --materials FILE.json."
        raise InvalidArgument("materials", f"a table of {len(text)} letters", f"at most {_MOST_STORED}", mend)
    return text


def material_words(materials: Sequence[Material]) -> int:
    """Words of the block that materials take."""
    if not materials:
        return 0
    rows = sum(W.MATERIAL_WORDS + len(m.speeds_m_s) + len(m.forces_n) + m.levels_n.size for m in materials)
    return W.MATERIAL_ROWS + rows


def write_materials(
    memory: Memory,
    at: int,
    materials: Sequence[Material],
    objects: Sequence[str] = (),
    own_friction: bool = True,
) -> tuple[str, ...]:
    """Write materials at word `at`, with silent sines; notes for the user.

    `objects` are the names of the parts of each frame. With `own_friction` false mu is that of the field
    everywhere. `InvalidArgument` if a material is that of an object that is not there.
    """
    i8, f8 = memory.i8, memory.f8
    i8[W.MATERIAL], i8[W.MATERIAL_COUNT] = at, len(materials)
    if not materials:
        return ()
    n = np.arange(W.MATERIAL_SINES)
    centres = np.repeat(BANDS_HZ, _SINES)
    f8[at + n] = 2 * np.pi * centres * 10 ** (0.1 * ((n % _SINES + 0.5) / _SINES - 0.5))
    f8[at + W.MATERIAL_SINES + n] = 2 * np.pi * (n * 0.6180339887498949 % 1)  # so that no two begin together
    row = at + W.MATERIAL_ROWS
    place = row + W.MATERIAL_WORDS * len(materials)
    for one in materials:
        if one.object is not None and one.object not in objects:
            expected = (
                f"one of {', '.join(objects)}" if objects else "none: this medium is a field, not objects"
            )
            raise InvalidArgument(f"material {one.name!r} object", repr(one.object), expected)
        mu = one.friction if own_friction and one.friction is not None else math.nan
        f8[row + W.MATERIAL_FRICTION], f8[row + W.MATERIAL_SLIP] = mu, one.slip_length_m
        f8[row + W.MATERIAL_STATIC] = one.static_friction or 0.0
        i8[row + W.MATERIAL_OBJECT] = -1 if one.object is None else list(objects).index(one.object)
        f8[row + W.MATERIAL_BOX : row + W.MATERIAL_BOX + 6] = np.ravel(one.box_m or _EVERYWHERE)
        for head, values in ((W.MATERIAL_SPEEDS, one.speeds_m_s), (W.MATERIAL_FORCES, one.forces_n)):
            i8[row + head], i8[row + head + 1] = len(values), place
            f8[place : place + len(values)] = values
            place += len(values)
        i8[row + W.MATERIAL_LEVELS], levels = place, one.levels_n.ravel()
        f8[place : place + len(levels)] = levels
        place, row = place + len(levels), row + W.MATERIAL_WORDS
    return _notes(materials, float(f8[W.RATE_HZ]), float(f8[W.SLEW] / f8[W.FORCE_SCALE]))


def _notes(materials: Sequence[Material], rate_hz: float, slew_n_per_s: float) -> tuple[str, ...]:
    """Rendered part of a material, and what of it the loop or the device cannot show."""
    notes, bands = [f"materials: {', '.join(one.name for one in materials)}"], np.array(BANDS_HZ)
    shown = 2 * 10**0.05 * bands < rate_hz
    for one in (one for one in materials if one.texture_rms_n):
        change = (
            W.MATERIAL_CREST
            * np.sqrt(((2 * np.pi * bands * one.levels_n) ** 2)[..., shown].sum(axis=-1)).max()
        )
        if change > slew_n_per_s:
            weaker = f"up to {20 * math.log10(change / slew_n_per_s):.1f} dB"
            notes.append(
                f"{one.name} is weaker by {weaker} than its table, for the slew limit of {slew_n_per_s:g} N/s"
            )
        if one.levels_n[..., ~shown].any():
            most = f"{bands[shown][-1]:.0f} Hz" if shown.any() else "0 Hz"
            notes.append(f"what {one.name} does above {most} needs more than {rate_hz:g} ticks a second")
    return tuple(notes)
