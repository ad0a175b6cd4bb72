"""A height map read from a file: its values, what the file states about them, and the scene made of both.

Readers return the values as stored and a `GeoReference`; `scene_of` applies it: gaps, scale and offset,
directions, units. Missing values are assumed, with a note: one metre between samples, one metre a unit; for a
picture without a scale, a relief of a fifth of its shorter side. Degrees are converted to metres on the
ellipsoid WGS 84 (NGA.STND.0036) at the central latitude of the map: one scale for the whole map, no
projection.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, as_source_error
from touchfield.sources.options import SourceOptions
from touchfield.sources.terrain.height_scene import HeightScene

GAP_HEIGHTS: Final = (-9999.0, 9999.0, -32767.0, 32767.0, -32768.0, 32768.0, -99999.0, 99999.0)
"""Values that elevation models use for unknown heights."""
MAX_HEIGHT: Final = 1e15
"""Larger numbers, such as the lowest float32 or 1e20, are no heights in any unit."""
ISOLATION: Final = 0.1
"""Distance of a stand-in from all other heights, relative to their range, at which it is taken for a gap."""
LATITUDE_LIMIT_DEG: Final = 89.0
"""Nearer to a pole the width of cells in degrees of longitude varies too much."""
PICTURE_RELIEF: Final = 0.2  # of a picture without a scale, relative to its shorter side
UPRIGHT: Final = "gdalwarp IN.tif OUT.tif makes a map with rows from west to east"

_MAX_SHEAR: Final = 1e-3  # cosine between the directions of rows and columns
_MIN_TURN_DEG: Final = 0.01
_MAX_UNEVEN: Final = 0.1  # of a step; degrees in float32 deviate by up to 0.04 of an arc second
_WGS84_AXIS_M: Final = 6378137.0
_WGS84_E2: Final = 0.00669437999014

Pair = tuple[float, float]
Affine = tuple[float, float, float, float, float, float]
"""a, b, c, d, e, f of x = a column + b row + c and y = d column + e row + f, as rasterio orders them.

c and f are NaN if only the directions and lengths of cells are known."""
Heights = NDArray[np.floating[Any]]


class Reduction(NamedTuple):
    """How a map was reduced while it was read (`large_maps`).

    `shape` is that of the map in the file, rows and columns; `factor` the number of its samples along a side
    of one that is read, by rows and by columns; `mean_side` the side of the means that were taken; `left_out`
    the last rows and columns that fill no whole cell.
    """

    shape: tuple[int, int]
    factor: Pair
    mean_side: int
    is_of_overview: bool
    left_out: tuple[int, int]


class GeoReference(NamedTuple):
    """Positions and units of samples as stated in a file; None where the file does not state them.

    `affine` maps columns and rows to x and y, units of the map: x east, y north. Without it, `cell` is (dy,
    dx), row 0 is north and column 0 west, and `middle` is y and x of the centre. Units of the map are
    `unit_m` metres unless they are degrees. A height is (value * scale + offset) units of `vertical_unit_m`
    metres; `nodata` are values that mark gaps. `is_elevation` is False for a picture without any of these.
    `affine` and `cell` are those of the file also where a `reduction` left fewer samples, with gaps as NaN.
    `epsg` is the code of the coordinate system, where it has one.
    """

    affine: Affine | None = None
    cell: Pair | None = None
    middle: Pair | None = None
    is_degrees: bool | None = None
    unit_m: float = 1.0
    vertical_unit_m: float = 1.0
    scale: float = 1.0
    offset: float = 0.0
    nodata: tuple[float, ...] = ()
    is_elevation: bool = True
    notes: tuple[str, ...] = ()
    reduction: Reduction | None = None
    epsg: int | None = None

    @property
    def factor(self) -> Pair:
        """Samples of the file along a side of one that is read, by rows and by columns."""
        return self.reduction.factor if self.reduction else (1.0, 1.0)

    def transposed(self) -> GeoReference:
        """Return the reference of the transposed samples; what it states of x and y remains."""
        found = self.reduction
        if found is None:
            return self
        swapped = Reduction(
            found.shape[::-1], found.factor[::-1], found.mean_side, found.is_of_overview, found.left_out[::-1]
        )
        return self._replace(reduction=swapped)


def scene_of(
    path: Path, values: NDArray[Any], reference: GeoReference, options: SourceOptions
) -> HeightScene:
    """Return the scene of a map, [rows, cols] or [frames, rows, cols], with its assumptions in the notes.

    Raises `SourceError`, which names `path`, if no height is known, the map is sheared or lies at a pole.
    """
    heights = as_heights(values)
    for value in reference.nodata:
        heights[is_marked_gap(heights, value)] = np.nan
    has_stand_ins = reference.is_elevation and reference.reduction is None
    gap_notes = leave_out_stand_ins(heights) if has_stand_ins else ()
    if not np.isfinite(heights).any():
        raise SourceError(str(path), "no known height", "at least one")
    turned = upright(path, heights, reference)
    cell_m, cell_notes = _cell_m(path, turned, options)
    heights, height_notes = _in_metres(turned, cell_m, options)
    notes = (*turned.notes, *gap_notes, *cell_notes, *height_notes, *_reduction_notes(turned, cell_m))
    rate_hz, factor = options.rate_hz or 30.0, options.exaggeration
    with as_source_error(f"{path}, "):
        return HeightScene(heights, cell_m, exaggeration=factor, rate_hz=rate_hz, notes=notes, name=str(path))


def stated_heights(
    path: Path, values: NDArray[Any], reference: GeoReference
) -> tuple[Heights, tuple[str, ...]]:
    """Return the heights that a file states, metres, in its own directions and NaN in gaps; and notes.

    Raises `SourceError`, which names `path`, for a picture without a scale of heights.
    """
    if not reference.is_elevation:
        mend = "Write the heights as a GeoTIFF."
        raise SourceError(str(path), "a picture without a scale of heights", "an elevation model", mend)
    heights = as_heights(values)
    for value in reference.nodata:
        heights[is_marked_gap(heights, value)] = np.nan
    notes = leave_out_stand_ins(heights) if reference.reduction is None else ()
    scale, offset = reference.scale, reference.offset
    if scale != 1 or offset != 0:
        notes += (f"Heights are stored values times {scale:g} plus {offset:g}, as the file states.",)
    return (heights.astype(np.float64) * scale + offset) * reference.vertical_unit_m, notes


def as_heights(values: NDArray[Any]) -> Heights:
    """Convert to floating point, NaN if not finite."""
    with np.errstate(invalid="ignore"):  # a signalling NaN
        heights: Heights = values.astype(np.float64 if values.dtype.itemsize > 2 else np.float32)
    heights[~np.isfinite(heights)] = np.nan
    return heights


def is_marked_gap(heights: Heights, nodata: float) -> NDArray[np.bool_]:
    """Return where heights are the value that marks a gap."""
    with np.errstate(over="ignore"):  # a text states more digits than the nearest float32 has
        return np.asarray((heights == nodata) | (heights == np.float64(np.float32(nodata))))


def _reduction_notes(upright_map: UprightMap, cell_m: Pair) -> tuple[str, ...]:
    """Return a note on how a large map was reduced."""
    reduction = upright_map.reference.reduction
    if reduction is None:
        return ()
    factor = reduction.factor[::-1] if upright_map.is_quarter_turned else reduction.factor
    rows, cols = upright_map.heights.shape[-2:]
    stored = reduction.shape[::-1] if upright_map.is_quarter_turned else reduction.shape
    (dy, dx), (y, x) = cell_m, (cell / side for cell, side in zip(cell_m, factor, strict=True))
    side = reduction.mean_side
    how = "an overview in the file" if reduction.is_of_overview else ""
    means = f"means of the known heights among {side} x {side} samples" if side > 1 else ""
    notes: tuple[str, ...] = (
        f"The map of {stored[0]} x {stored[1]} samples, {y:.4g} x {x:.4g} m apart, is read as {rows} x "
        f"{cols}, {dy:.4g} x {dx:.4g} m apart: {', '.join(filter(None, (how, means)))}.",
    )
    if any(reduction.left_out):
        a, b = reduction.left_out
        notes += (f"The last {a} rows and {b} columns of the file, which fill no whole cell, are left out.",)
    return notes


# -- gaps that no tag marks --------------------------------------------------------------------------------
def leave_out_stand_ins(heights: Heights) -> tuple[str, ...]:
    """Set heights that can only mark a gap to NaN, in place; returns notes.

    They are numbers beyond `MAX_HEIGHT`, and a usual stand-in (`GAP_HEIGHTS`) that is the lowest or highest
    value and far from all others.
    """
    notes: tuple[str, ...] = ()
    with np.errstate(invalid="ignore"):
        is_beyond = np.abs(heights) > MAX_HEIGHT
    if is_beyond.any():
        notes += (_gap_note(float(heights[is_beyond][0]), int(is_beyond.sum()), heights.size),)
        heights[is_beyond] = np.nan
    known = heights[np.isfinite(heights)]
    counts = {}
    for value in GAP_HEIGHTS:
        if count := int(np.count_nonzero(known == value)):
            counts[value], known = count, known[known != value]
    low, high = (float(known.min()), float(known.max())) if known.size else (math.inf, -math.inf)
    gaps, further = split_stand_ins(low, high, counts, heights.size)
    for value in gaps:
        heights[heights == value] = np.nan
    return notes + further


def split_stand_ins(
    low: float, high: float, counts: Mapping[float, int], total: int
) -> tuple[list[float], tuple[str, ...]]:
    """Return which values mark gaps, and notes.

    `counts` has the number of each value that is beyond `MAX_HEIGHT` or one of `GAP_HEIGHTS`, among `total`
    samples; all other heights are between `low` and `high`.
    """
    gaps = [value for value in counts if abs(value) > MAX_HEIGHT]
    left = {value for value in counts if value not in gaps}
    while left:
        known = left | ({low, high} if low <= high else set())
        extremes = [value for value in (min(known), max(known)) if value in left]
        isolated = [value for value in extremes if _is_isolated(value, known - {value})]
        if not isolated:
            notes = tuple(
                f"{value:g} is taken for a height: where it marks what is not known, write NaN there."
                for value in dict.fromkeys(extremes)
                if value < 0
            )
            break
        gaps.append(isolated[0])
        left.discard(isolated[0])
    else:
        notes = ()
    return gaps, (*(_gap_note(value, counts[value], total) for value in gaps), *notes)


def _is_isolated(value: float, others: Collection[float]) -> bool:
    if not others:
        return False
    low, high = min(others), max(others)
    return min(abs(value - low), abs(value - high)) > ISOLATION * (high - low)


def _gap_note(value: float, count: int, total: int) -> str:
    return (
        f"{value:g} in {count} of {total} samples is taken for a gap, although the file does not mark "
        "it as one; no other height is near. Where it is a height, change it slightly."
    )


# -- directions --------------------------------------------------------------------------------------------
class UprightMap(NamedTuple):
    """Heights with row 0 north and column 0 west, and what remains of their reference."""

    heights: Heights
    cell: Pair | None
    middle: Pair | None
    reference: GeoReference
    notes: tuple[str, ...]
    is_quarter_turned: bool = False


def upright(path: Path, heights: Heights, reference: GeoReference) -> UprightMap:
    """Mirror and turn heights by quarters so that rows run from west to east, north first.

    A smaller turn that remains is reported. Raises `SourceError` for sheared cells.
    """
    (by_row, by_col), cell = reference.factor, reference.cell
    if reference.affine is None:
        cell = cell and (cell[0] * by_row, cell[1] * by_col)
        return UprightMap(heights, cell, reference.middle, reference, reference.notes)
    a, b, c, d, e, f = reference.affine
    a, b, d, e = a * by_col, b * by_row, d * by_col, e * by_row
    dx, dy = math.hypot(a, d), math.hypot(b, e)
    if not (0 < dx < math.inf and 0 < dy < math.inf):
        note = f"The positions in the file are not used: its cells are {dx:g} x {dy:g}."
        return UprightMap(heights, None, None, reference, (*reference.notes, note))
    cosine = (a / dx) * (b / dy) + (d / dx) * (e / dy)
    if abs(cosine) > _MAX_SHEAR:
        found = f"sheared cells: rows and columns meet at {math.degrees(math.acos(cosine)):.4g} degrees"
        raise SourceError(str(path), found, "90 degrees", UPRIGHT + ".")
    rows, cols = heights.shape[-2:]
    position = d * cols / 2 + e * rows / 2 + f, a * cols / 2 + b * rows / 2 + c
    middle: Pair | None = position if all(map(math.isfinite, position)) else None
    notes = reference.notes
    if a * e - b * d > 0:
        heights = np.flip(heights, -2)
    angle_deg = math.degrees(math.atan2(d, a))
    quarters = round(angle_deg / 90)
    rest_deg = angle_deg - 90 * quarters
    if quarters:
        heights = np.rot90(heights, quarters, axes=(-2, -1))
    if abs(rest_deg) > _MIN_TURN_DEG:
        notes += (
            f"The map is turned by {rest_deg:.4g} degrees from east towards north: x and y follow its rows "
            f"and columns; {UPRIGHT}.",
        )
    is_turned = bool(quarters % 2)
    return UprightMap(heights, (dx, dy) if is_turned else (dy, dx), middle, reference, notes, is_turned)


# -- metres ------------------------------------------------------------------------------------------------
def _cell_m(path: Path, upright_map: UprightMap, options: SourceOptions) -> tuple[Pair, tuple[str, ...]]:
    """Return the distances of rows and columns in metres, and notes."""
    cell, reference = upright_map.cell, upright_map.reference
    latitude, longitude = upright_map.middle or (0.0, 0.0)
    is_degrees = reference.is_degrees
    if is_degrees is None and cell is not None and upright_map.middle is not None:
        is_degrees = abs(latitude) <= 90 and abs(longitude) <= 180 and max(cell) < 0.1 * max(reference.factor)
    if is_degrees and abs(latitude) > LATITUDE_LIMIT_DEG:
        raise SourceError(
            str(path), f"the latitude {latitude:.4g}", f"at most {LATITUDE_LIMIT_DEG} either way"
        )
    factor = reference.factor[::-1] if upright_map.is_quarter_turned else reference.factor
    if options.cell_size_m is not None:
        return (options.cell_size_m * factor[0], options.cell_size_m * factor[1]), ()
    if cell is None:
        note = (
            "The distance of samples is not given: one metre is assumed (--cell-size-m; in .npz dx and dy)."
        )
        return factor, (note,)
    dy, dx = cell
    if not is_degrees:
        return (dy * reference.unit_m, dx * reference.unit_m), ()
    along, across = degree_m(latitude)
    cell_m = dy * along, dx * across
    lengths = f"{cell_m[1]:.4g} m east, {cell_m[0]:.4g} m north"
    return cell_m, (f"Degrees are taken as metres at latitude {latitude:.2f}: {lengths}.",)


def _in_metres(
    upright_map: UprightMap, cell_m: Pair, options: SourceOptions
) -> tuple[Heights, tuple[str, ...]]:
    """Return heights in metres, and notes. An option replaces scale and unit of the file."""
    heights, reference = upright_map.heights, upright_map.reference
    scale, offset, notes = reference.scale, reference.offset, tuple[str, ...]()
    unit_m = reference.vertical_unit_m
    if options.height_scale is not None:
        unit_m, offset, scale = options.height_scale, offset / scale, 1.0
    elif not reference.is_elevation:
        span = float(np.nanmax(heights)) - float(np.nanmin(heights))
        side = min(n * d for n, d in zip(heights.shape[-2:], cell_m, strict=True))
        unit_m = PICTURE_RELIEF * side / span if span > 0 else 1.0
        relief = f"{unit_m:.4g} m a unit is assumed, a relief of {span * unit_m:.3g} m"
        notes += (f"The picture gives no scale of heights (--height-scale): {relief}.",)
    if scale != 1 or offset != 0:
        heights = heights.astype(np.float64) * scale + offset
        if options.height_scale is None:
            notes += (f"Heights are stored values times {scale:g} plus {offset:g}, as the file states.",)
    if unit_m != 1:
        heights = heights.astype(np.float64) * unit_m
    return heights, notes


def degree_m(latitude_deg: float) -> Pair:
    """Return the metres of one degree of latitude and of longitude, on WGS 84."""
    sine2 = math.sin(math.radians(latitude_deg)) ** 2
    across = _WGS84_AXIS_M / math.sqrt(1 - _WGS84_E2 * sine2)
    along = across * (1 - _WGS84_E2) / (1 - _WGS84_E2 * sine2)
    return math.radians(along), math.radians(across * math.cos(math.radians(latitude_deg)))


# -- names of units ----------------------------------------------------------------------------------------
_UNITS: Final = {
    "m": 1.0, "metre": 1.0, "meter": 1.0, "metres": 1.0, "meters": 1.0, "km": 1000.0, "kilometre": 1000.0,
    "kilometer": 1000.0, "cm": 0.01, "centimetre": 0.01, "centimeter": 0.01, "dm": 0.1, "mm": 0.001,
    "millimetre": 0.001, "millimeter": 0.001, "ft": 0.3048, "foot": 0.3048, "feet": 0.3048,
    "international foot": 0.3048, "us survey foot": 1200 / 3937, "us survey feet": 1200 / 3937,
    "us-ft": 1200 / 3937, "foot_us": 1200 / 3937, "ftus": 1200 / 3937, "yd": 0.9144, "yard": 0.9144,
    "fathom": 1.8288,
}  # fmt: skip


def unit_of(name: str, what: str) -> tuple[float, tuple[str, ...]]:
    """Return the metres of a unit of length by its name, and a note if the name is unknown."""
    unit_m = _UNITS.get(name.strip().lower())
    if unit_m is not None:
        return unit_m, ()
    return 1.0, (
        f"The unit {name.strip()[:40]!r} of {what} is unknown: metres are assumed (--height-scale).",
    )


def affine_of_axes(path: Path, x: Float64s, y: Float64s) -> Affine:
    """Return the affine of samples at x[col], y[row]; `SourceError` unless both have equal steps."""
    steps = []
    for name, values in (("x", x), ("y", y)):
        step = (values[-1] - values[0]) / (len(values) - 1)
        deviation = np.abs(values - (values[0] + step * np.arange(len(values)))).max()
        if not (np.isfinite(step) and step != 0 and deviation <= _MAX_UNEVEN * abs(step)):
            low, high = np.diff(values).min(), np.diff(values).max()
            raise SourceError(
                f"{path}, {name}",
                f"steps from {low:.6g} to {high:.6g}",
                "equal steps, not zero",
                "Resample the map on an even lattice, or omit the positions and give --cell-size-m.",
            )
        steps.append(float(step))
    dx, dy = steps
    return dx, 0.0, float(x[0]) - dx / 2, 0.0, dy, float(y[0]) - dy / 2
