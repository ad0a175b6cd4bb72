"""Reduces height maps of more than `MAX_PIXELS` samples while they are read, so that memory is bounded.

A sample of the reduced map is the mean of the known heights among f x f of the file; it is a gap if none of
them is known. f is the smallest whole number that leaves at most `REDUCED_SAMPLES`, four times the finest
lattice of a workspace (1024) along a side. Gaps are left out before the means are taken, also those that the
file does not mark (`height_map.split_stand_ins`): a mean with -9999 in it is a wrong height.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import SourceError
from touchfield.sources.images.pictures import MAX_EXPANSION, MAX_PIXELS
from touchfield.sources.terrain.height_map import (
    GAP_HEIGHTS,
    MAX_HEIGHT,
    GeoReference,
    Pair,
    Reduction,
    is_marked_gap,
    split_stand_ins,
)

REDUCED_SAMPLES: Final = 1 << 24
"""Samples of a reduced map, 4096 x 4096."""
MAX_SAMPLES: Final = 1 << 32
"""Samples of the largest map that is read, 65536 x 65536."""
_MAX_SIDE: Final = 1 << 20
BAND_SAMPLES: Final = 1 << 22
"""Samples of a band of rows, where the file leaves the choice."""

Bands = Iterable[NDArray[Any]]
"""The rows of a map in order, [n, cols] at a time."""


def bound_samples(path: Path, rows: int, cols: int) -> None:
    """Raise `SourceError` for a map that is empty, too large, or more than its bytes can encode."""
    found, size = f"a map of {rows} x {cols} samples", path.stat().st_size
    if min(rows, cols) < 1:
        raise SourceError(str(path), found, "at least one sample")
    if rows * cols > MAX_SAMPLES or max(rows, cols) > _MAX_SIDE:
        expected = f"at most {MAX_SAMPLES}, and {_MAX_SIDE} along a side"
        raise SourceError(str(path), found, expected, "Give a part of the map.")
    if rows * cols > MAX_EXPANSION * size:
        raise SourceError(str(path), f"{found} in {size} bytes", "a whole map", "Copy the file again.")


def is_large(shape: tuple[int, ...]) -> bool:
    """Return True if a map, or a series of maps, has to be reduced."""
    return math.prod(shape) > MAX_PIXELS


def bands_of(read_rows: Callable[[int, int], NDArray[Any]], rows: int, cols: int, unit: int = 1) -> Bands:
    """Yield ``read_rows(start, stop)`` for all rows, a multiple of `unit` rows at a time where that is short.

    `unit` is the number of rows that the file stores as one piece.
    """
    step = max(1, BAND_SAMPLES // cols)
    if unit * cols <= MAX_PIXELS:
        step = max(1, step // unit) * unit
    for start in range(0, rows, step):
        yield read_rows(start, min(start + step, rows))


def reduce_map(
    path: Path,
    bands: Bands,
    shape: tuple[int, int],
    reference: GeoReference,
    *,
    frame_count: int = 1,
    overview_of: tuple[int, int] | None = None,
) -> tuple[Float64s, GeoReference]:
    """Return the means of a map of this shape, [rows, cols], NaN in gaps, and its reference.

    `frame_count` is the number of maps of a series, which share `MAX_PIXELS`. `overview_of` is the shape of
    the map in the file if the bands are those of a smaller copy of it.
    """
    rows, cols = shape
    factor = _factor(path, rows, cols, frame_count)
    means = _Means(rows // factor, cols // factor, factor, reference)
    for band in bands:
        means.add(band)
    heights, notes = means.result()
    stored = overview_of or shape
    per_side: Pair = factor * stored[0] / rows, factor * stored[1] / cols
    reduction = Reduction(stored, per_side, factor, overview_of is not None, (rows % factor, cols % factor))
    return heights, reference._replace(reduction=reduction, nodata=(), notes=(*reference.notes, *notes))


def _factor(path: Path, rows: int, cols: int, frame_count: int) -> int:
    limit = min(REDUCED_SAMPLES, MAX_PIXELS // frame_count)
    factor = max(1, min(math.ceil(math.sqrt(rows * cols / max(limit, 1))), rows // 2, cols // 2))
    if frame_count * (rows // factor) * (cols // factor) > MAX_PIXELS:
        found = f"{frame_count} maps of {rows} x {cols} samples"
        mend = "Give fewer frames, or a part of the map."
        raise SourceError(str(path), found, f"at most {MAX_PIXELS} samples, reduced", mend)
    return factor


class _Means:
    """Means of the known heights in cells of `factor` x `factor` samples; bands are added in order.

    Rows and columns that fill no whole cell are left out: their mean would lie off the lattice.
    """

    def __init__(self, rows: int, cols: int, factor: int, reference: GeoReference) -> None:
        self._factor, self._reference = factor, reference
        self._sums = np.zeros((rows, cols))
        self._counts = np.zeros((rows, cols), np.int32)
        self._stand_ins: dict[float, NDArray[np.int32]] = {}
        self._low, self._high = math.inf, -math.inf
        self._beyond, self._beyond_value, self._row = 0, 0.0, 0

    def add(self, band: NDArray[Any]) -> None:
        """Add the next rows, [n, cols]; gaps are NaN or values that the file marks."""
        step = max(1, BAND_SAMPLES // max(band.shape[1], 1))
        for start in range(0, len(band), step):
            self._add(band[start : start + step])

    def _add(self, band: NDArray[Any]) -> None:
        stop = min(self._row + len(band), len(self._sums) * self._factor)
        band = band[: max(stop - self._row, 0), : self._sums.shape[1] * self._factor]
        if not len(band):
            return
        heights = band.astype(np.float64)
        is_known = np.isfinite(heights)
        for value in self._reference.nodata:
            is_known &= ~is_marked_gap(heights, value)
        if self._reference.is_elevation:
            self._leave_out_stand_ins(heights, is_known)
        if is_known.any():
            known = heights if is_known.all() else heights[is_known]
            self._low = min(self._low, float(known.min()))
            self._high = max(self._high, float(known.max()))
        heights[~is_known] = 0.0
        first, sums = self._cells(heights, np.float64)
        self._sums[first : first + len(sums)] += sums
        self._counts[first : first + len(sums)] += self._cells(is_known, np.int32)[1]
        self._row = stop

    def _leave_out_stand_ins(self, heights: Float64s, is_known: NDArray[np.bool_]) -> None:
        """Count numbers beyond all heights, and values that may mark gaps, apart from the heights."""
        with np.errstate(invalid="ignore"):
            is_beyond = is_known & (np.abs(heights) > MAX_HEIGHT)
        if is_beyond.any():
            self._beyond += int(is_beyond.sum())
            self._beyond_value = float(heights[is_beyond][0])
            is_known &= ~is_beyond
        if not is_known.any():
            return
        known = heights[is_known]
        low, high = float(known.min()), float(known.max())
        for value in GAP_HEIGHTS:
            if low <= value <= high:
                is_value = is_known & (heights == value)
                if is_value.any():
                    first, counts = self._cells(is_value, np.int32)
                    total = self._stand_ins.setdefault(value, np.zeros_like(self._counts))
                    total[first : first + len(counts)] += counts
                    is_known &= ~is_value

    def _cells(self, values: NDArray[Any], kind: Any) -> tuple[int, NDArray[Any]]:
        """Return the first row of cells that a band touches, and its sums in them."""
        factor, first = self._factor, self._row // self._factor
        starts = np.arange(first * factor, self._row + len(values), factor) - self._row
        rows = np.add.reduceat(values, np.maximum(starts, 0), axis=0, dtype=kind)
        return first, np.add.reduceat(rows, np.arange(0, rows.shape[1], factor), axis=1, dtype=kind)

    def result(self) -> tuple[Float64s, tuple[str, ...]]:
        """Return the means, NaN where nothing is known, and notes on values taken for gaps."""
        total = self._sums.size * self._factor**2
        counts = {value: int(cells.sum()) for value, cells in self._stand_ins.items()}
        if self._beyond:
            counts[self._beyond_value] = self._beyond
        gaps, notes = split_stand_ins(self._low, self._high, counts, total)
        for value, cells in self._stand_ins.items():
            if value not in gaps:
                self._sums += value * cells
                self._counts += cells
        with np.errstate(invalid="ignore", divide="ignore"):
            np.divide(self._sums, self._counts, out=self._sums)
        return self._sums, notes


class RowQueue:
    """The rows of bands, a given number at a time."""

    def __init__(self, bands: Iterator[NDArray[Any]]) -> None:
        self._bands, self._left = bands, np.empty((0, 0))

    def take(self, count: int) -> NDArray[Any]:
        """Return the next `count` rows; fewer at the end."""
        parts, missing = [self._left[:count]] if len(self._left) else [], count - len(self._left)
        self._left = self._left[count:]
        while missing > 0 and (band := next(self._bands, None)) is not None:
            parts.append(band[:missing])
            self._left = band[missing:]
            missing -= len(band)
        return np.concatenate(parts)
