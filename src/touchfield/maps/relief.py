"""Relief beneath a map: the height of the land under each pin, and lines of equal height.

The elevation model is in degrees of WGS 84, as the map is, or of a system that agrees with it within some
metres; it is not reprojected. Under a pin lies the mean of the heights around it, smoothed over its
neighbours, so that a contour line is as simple as a finger can follow at each scale. One interval holds for
every scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError, import_extra
from touchfield.maps.features import Feature, MapSource
from touchfield.maps.guidelines import guidelines
from touchfield.maps.pins import Window
from touchfield.maps.reader import metres_of_degree
from touchfield.maps.symbols import RELIEF
from touchfield.sources.terrain.height_files import read_heights
from touchfield.sources.terrain.height_map import GeoReference, stated_heights

WGS84_CODES: Final = (4326, 4979, 4258, 4937, 4269, 4283, 7844, 4167, 4612, 6668, 4674, 4490)
"""EPSG codes of systems in degrees that agree with WGS 84 within some metres: less than a pin."""
MAX_HEIGHTS: Final = 64
"""Different heights of contour lines in a view."""
MAX_LINES: Final = 256
"""Contour lines in a view, the longest; a display has room for far fewer."""
_SMOOTHING_PINS: Final = 1.0
_MARGIN_PINS: Final = 4
"""Around a view, so that lines of overlapping views agree."""
_MARGIN_FRACTION: Final = 0.25
"""Of the size of the map around it: views reach beyond it by an eighth at most."""
_ABOVE: Final = 0.01
"""Of the interval, by which a line lies above its height: a lake at that height has a shore, and no noise."""
_KEPT_MEANS: Final = 8


@dataclass(frozen=True)
class SampleLattice:
    """Positions of a map on the samples of an elevation model: (row, column) = matrix (x, y) + offset.

    matrix : float64 [2, 2]; offset : float64 [2]
    """

    matrix: Float64s
    offset: Float64s

    def rows_and_columns(self, points: Float64s) -> Float64s:
        """Return (row, column) of points (x, y), float64 [..., 2]."""
        return np.asarray(points @ self.matrix.T + self.offset)


class Relief:
    """The land beneath a map.

    heights_m : float64 [rows, columns]; NaN where unknown.
    lattice : SampleLattice; Of the heights.
    low_m, high_m : float; Lowest and highest point under the pins of the whole map.
    known_fraction : float; Fraction of these pins with a known height.
    interval_m : float; Difference in height of neighbouring contour lines.
    steep_views : int; Views without contour lines, because more than `MAX_HEIGHTS` would cross them.
    """

    def __init__(self, heights_m: Float64s, lattice: SampleLattice, window: Window) -> None:
        """Measure the land under the pins of `window`, the whole map.

        Raises `SourceError` if no height is known there.
        """
        self.heights_m, self.lattice, self.steep_views = heights_m, lattice, 0
        self._reduced = lru_cache(_KEPT_MEANS)(self._means)
        under_m = self.under_m(window)
        known_m = under_m[np.isfinite(under_m)]
        if not known_m.size:
            raise SourceError("relief", "no known height on the map", "heights in a part of it at least")
        self.known_fraction = known_m.size / under_m.size
        self.low_m, self.high_m = float(known_m.min()), float(known_m.max())
        least_m = (self.high_m - self.low_m) / float(guidelines()["max_contours"].value)
        self.interval_m = _usual_above(max(least_m, float(guidelines()["min_interval_m"].value)))

    def use_interval(self, interval_m: float) -> None:
        """Set the interval of contour lines; raises `InvalidArgument` if `MAX_HEIGHTS` are too few for it."""
        range_m = self.high_m - self.low_m
        if not (math.isfinite(interval_m) and interval_m > 0 and range_m <= MAX_HEIGHTS * interval_m):
            found = f"{interval_m:g} m for heights of {self.low_m:.6g} to {self.high_m:.6g} m"
            least_m = max(range_m / MAX_HEIGHTS, 0.001)
            raise InvalidArgument("--interval-m", found, f"metres, at least {least_m:.2g}")
        self.interval_m = interval_m

    # -- heights -------------------------------------------------------------------------------------------
    def under_m(self, window: Window) -> Float64s:
        """Return the height under each pin of a window, metres, NaN where unknown, [rows, columns]."""
        inner = np.s_[_MARGIN_PINS:-_MARGIN_PINS, _MARGIN_PINS:-_MARGIN_PINS]
        return self._smooth_m(_widened(window))[inner]

    def _smooth_m(self, window: Window) -> Float64s:
        columns, rows = np.meshgrid(np.arange(window.columns), np.arange(window.rows))
        points = np.stack([window.west + window.step * columns, window.north - window.step * rows], axis=-1)
        samples = np.abs(self.lattice.matrix).sum(axis=1) * window.step  # from pin to pin
        factors = tuple(int(np.clip(n // 2, 1, side)) for n, side in zip(samples, self.heights_m.shape))
        at = (self.lattice.rows_and_columns(points) + 0.5) / factors - 0.5
        return _smoothed(_interpolated(self._reduced(*factors), at))

    def _means(self, by_row: int, by_column: int) -> Float64s:
        """Return the means of the known heights among so many samples."""
        if by_row == by_column == 1:
            return self.heights_m
        rows, columns = self.heights_m.shape
        starts = np.arange(0, rows, by_row), np.arange(0, columns, by_column)
        known = np.isfinite(self.heights_m)
        sums = np.add.reduceat(np.where(known, self.heights_m, 0.0), starts[0], axis=0)
        counts = np.add.reduceat(known, starts[0], axis=0, dtype=np.int32)
        sums, counts = (np.add.reduceat(part, starts[1], axis=1) for part in (sums, counts))
        return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)

    # -- contour lines -------------------------------------------------------------------------------------
    def contours(self, window: Window) -> list[Feature]:
        """Return the contour lines of a window, the longest first, at most `MAX_LINES`; named by height.

        Raises `MissingExtra` without contourpy.
        """
        contourpy = import_extra("contourpy", "contour lines of a relief", "contourpy", "map")
        wide = _widened(window)
        heights_m = self._smooth_m(wide)
        if not np.isfinite(heights_m).any():
            return []
        first = math.ceil(np.nanmin(heights_m) / self.interval_m)
        last = math.floor(np.nanmax(heights_m) / self.interval_m)
        if last - first >= MAX_HEIGHTS:
            self.steep_views += 1
            return []
        generator = contourpy.contour_generator(z=np.ma.masked_invalid(heights_m), line_type="Separate")
        found: list[tuple[float, Feature]] = []
        for n in range(first, last + 1):
            for line in generator.lines((n + _ABOVE) * self.interval_m):
                length = float(np.hypot(*np.diff(line, axis=0).T).sum())
                points = (wide.west, wide.north) + line * (wide.step, -wide.step)
                found.append((length, Feature(RELIEF, "line", (points,), _height_name(n * self.interval_m))))
        found.sort(key=lambda item: -item[0])
        return [feature for _, feature in found[:MAX_LINES]]


def _height_name(height_m: float) -> str:
    return f"{height_m:.6g} m"


def _usual_above(least_m: float) -> float:
    """Return the least of 1, 2, 5, 10, 20 and so on that is not below a length."""
    decade = 10.0 ** math.floor(math.log10(least_m))
    return next(step * decade for step in (1, 2, 5, 10, 20) if step * decade >= least_m * (1 - 1e-9))


def _widened(window: Window) -> Window:
    west, north = window.west - window.step * _MARGIN_PINS, window.north + window.step * _MARGIN_PINS
    rows, columns = window.rows + 2 * _MARGIN_PINS, window.columns + 2 * _MARGIN_PINS
    return Window(west, north, window.step, rows, columns)


def _interpolated(heights_m: Float64s, at: Float64s) -> Float64s:
    """Interpolate bilinearly at (row, column), [..., 2]; NaN where less than half of the weight is known."""
    size = np.array(heights_m.shape)
    is_inside = ((at >= -0.5) & (at <= size - 0.5)).all(axis=-1)
    at = np.clip(at, 0, size - 1)
    low = np.minimum(at.astype(np.int64), np.maximum(size - 2, 0))
    high, part = np.minimum(low + 1, size - 1), at - low
    sums, weights = np.zeros(at.shape[:-1]), np.zeros(at.shape[:-1])
    for row, row_weight in ((low[..., 0], 1 - part[..., 0]), (high[..., 0], part[..., 0])):
        for column, column_weight in ((low[..., 1], 1 - part[..., 1]), (high[..., 1], part[..., 1])):
            corner = heights_m[row, column]
            weight = np.where(np.isfinite(corner), row_weight * column_weight, 0.0)
            sums += weight * np.nan_to_num(corner)
            weights += weight
    is_known = is_inside & (weights >= 0.5)
    return np.where(is_known, sums / np.where(is_known, weights, 1.0), np.nan)


def _smoothed(heights_m: Float64s) -> Float64s:
    """Smooth over neighbouring pins; what is unknown stays so and has no weight."""
    known = np.isfinite(heights_m)
    sums = ndimage.gaussian_filter(np.where(known, heights_m, 0.0), _SMOOTHING_PINS, mode="constant")
    weights = ndimage.gaussian_filter(known.astype(np.float64), _SMOOTHING_PINS, mode="constant")
    return np.where(known, sums / np.where(known, weights, 1.0), np.nan)


# -- reading -----------------------------------------------------------------------------------------------
def read_relief(path: str | Path, source: MapSource, window: Window) -> tuple[Relief, tuple[str, ...]]:
    """Read the part of an elevation model beneath a map; returns it and notes on what was found.

    `window` shows the whole map. Raises `SourceError` for a drawing, which has no place on the earth, heights
    in other coordinates than degrees of `WGS84_CODES`, several maps, or none beneath the map; `MissingExtra`
    if a library that reads the file is missing.
    """
    path = Path(path)
    if source.origin_deg is None:
        found = "a drawing, which has no place on the earth, above the relief"
        raise SourceError(str(path), found, "a map in degrees: .geojson, .osm or .osm.pbf")
    values, reference = read_heights(path)
    if values.ndim != 2:
        found = f"{values.shape[0]} maps of heights"
        raise SourceError(str(path), found, "one map", "Write one of them as a GeoTIFF.")
    notes = _require_degrees(path, reference)
    lattice = _lattice(path, source.origin_deg, values, reference)
    rows, columns = _beneath(path, source.origin_deg, values, lattice, window)
    stated_m, height_notes = stated_heights(path, values[rows, columns], reference)
    heights_m = stated_m.astype(np.float64, copy=False)
    start = np.array([rows.start, columns.start])
    try:
        relief = Relief(heights_m, SampleLattice(lattice.matrix, lattice.offset - start), window)
    except SourceError as error:
        raise SourceError(str(path), error.found, error.expected) from None
    return relief, (*reference.notes, *notes, *height_notes, *_reduction_notes(reference))


def _require_degrees(path: Path, reference: GeoReference) -> tuple[str, ...]:
    """Raise for a coordinate system other than WGS 84; return a note if the file names none."""
    code = f"EPSG:{reference.epsg}" if reference.epsg else "without an EPSG code"
    expected = "degrees of WGS 84 (EPSG:4326), as the map has"
    hint = f"Convert it first: gdalwarp -t_srs EPSG:4326 {path.name} OUT.tif"
    if reference.affine is None or not np.isfinite(reference.affine).all():
        raise SourceError(str(path), "heights without positions", expected, hint)
    if reference.is_degrees is False:
        raise SourceError(str(path), f"heights in a projected system ({code})", expected, hint)
    if reference.epsg is not None and reference.epsg not in WGS84_CODES:
        raise SourceError(str(path), f"heights in degrees of another system ({code})", expected, hint)
    if reference.epsg is None:
        return ("The relief names no coordinate system: degrees of WGS 84 are assumed.",)
    return ()


def _lattice(
    path: Path, origin_deg: tuple[float, float], values: NDArray[Any], reference: GeoReference
) -> SampleLattice:
    """Return where the map, metres around its origin, lies on the samples that were read."""
    a, b, c, d, e, f = reference.affine or (0.0,) * 6
    to_degrees = np.array([[a, b], [d, e]]) * reference.factor[::-1]  # of (column, row), in samples as read
    if not abs(np.linalg.det(to_degrees)) > 0:
        raise SourceError(str(path), "cells without an extent", "positions of the heights")
    middle_deg = float((to_degrees @ np.array(values.shape[::-1]) / 2)[0] + c)
    turn_deg = 360 * round((middle_deg - origin_deg[0]) / 360)  # longitudes of 0 to 360 degrees
    inverse = np.linalg.inv(to_degrees)[::-1]  # to (row, column)
    offset = inverse @ (origin_deg[0] + turn_deg - c, origin_deg[1] - f) - 0.5
    return SampleLattice(inverse / metres_of_degree(origin_deg[1]), offset)


def _beneath(
    path: Path, origin_deg: tuple[float, float], values: NDArray[Any], lattice: SampleLattice, window: Window
) -> tuple[slice, slice]:
    """Return the rows and columns of the samples beneath a map and around it."""
    size = np.array([window.columns - 1, window.rows - 1]) * window.step
    margin = _MARGIN_FRACTION * size + 2 * _MARGIN_PINS * window.step
    low = np.array([window.west, window.north - size[1]])
    signs = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])

    def samples(low: Float64s, size: Float64s) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        corners = lattice.rows_and_columns(low + signs * size)
        first = np.clip(np.floor(corners.min(axis=0)), 0, values.shape)
        stop = np.clip(np.ceil(corners.max(axis=0)) + 1, 0, values.shape)
        return first.astype(np.int64), stop.astype(np.int64)

    first, stop = samples(low, size)
    if (stop <= first).any():
        raise _elsewhere(path, origin_deg, values, lattice, low, size)
    first, stop = samples(low - margin, size + 2 * margin)
    return slice(int(first[0]), int(stop[0])), slice(int(first[1]), int(stop[1]))


def _elsewhere(
    path: Path,
    origin_deg: tuple[float, float],
    values: NDArray[Any],
    lattice: SampleLattice,
    low: Float64s,
    size: Float64s,
) -> SourceError:
    """Return the error of a relief that does not overlap the map, with the boxes of both."""
    rows, columns = np.array(values.shape) - 0.5
    corners = np.array([[-0.5, -0.5], [-0.5, columns], [rows, -0.5], [rows, columns]])
    points = (corners - lattice.offset) @ np.linalg.inv(lattice.matrix).T

    def box(points: Float64s) -> str:
        degrees = points / metres_of_degree(origin_deg[1]) + origin_deg
        return ",".join(f"{value:.7g}" for value in (*degrees.min(axis=0), *degrees.max(axis=0)))

    found = f"heights of {box(points)} (west, south, east, north)"
    expected = f"heights beneath the map, {box(np.array([low, low + size]))}"
    return SourceError(str(path), found, expected, "Give the elevation model of this place.")


def _reduction_notes(reference: GeoReference) -> tuple[str, ...]:
    if reference.reduction is None:
        return ()
    rows, columns = reference.reduction.shape
    by_row, by_column = reference.factor
    return (
        f"The relief of {rows} x {columns} samples is read with one of {by_row:.3g} x {by_column:.3g}: for "
        "more detail cut out the part beneath the map first, with gdal_translate -projwin.",
    )
