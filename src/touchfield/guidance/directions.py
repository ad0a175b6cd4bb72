"""The nearest surface in each of eight directions around the wearer, and which directions are seen.

Direction i is the sector of 45 degrees that starts at -180 + 45 i degrees; 0 degrees is forward, and angles
increase to the right. These are the eight columns of a vest with four columns in front and four behind.

A surface counts where enough points lie within 20 cm of distance: single points are noise of the sensor, or
lie at the edge between a near and a far surface.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s, Int64s

DIRECTIONS: Final = (
    "back left", "left back", "left front", "front left", "front right", "right front", "right back",
    "back right",
)  # fmt: skip
"""Name of each direction, clockwise from behind as seen from above."""
SECTOR_DEG: Final = 45.0
BIN_DEG: Final = 5.0
BINS: Final = 72
BINS_PER_SECTOR: Final = 9

BESIDE_DEG: Final = 6.0
"""Distance of neighbouring samples of the memory, 8 cm, at 0.8 m."""

MIN_HEIGHT_M: Final = 0.18
"""Lower surfaces are ground, or a step (`steps`)."""
_NOISE_PER_M: Final = 0.006  # of height, times the square of the distance
RANGE_M: Final = 5.0
_CELL_M: Final = 0.1
_CELLS: Final = round(RANGE_M / _CELL_M)
_OWN_BODY_M: Final = 0.2

MIN_BODY_M: Final = 0.25
"""Lower surfaces are not remembered as obstacles: a raised floor, and an error of the height."""
MIN_SAMPLES: Final = np.full(_CELLS, 3.0)
"""Least number of samples of a remembered surface, at any distance (`nearest_m`)."""


def azimuths_deg(points: Float32s) -> Float32s:
    """Return the directions of points or rays [n, 3] in the wearer's frame, float32 [n]."""
    return np.degrees(np.arctan2(points[:, 0], points[:, 2])).astype(np.float32)


def bins_of(azimuth_deg: NDArray[np.floating]) -> Int64s:
    """Return the bins of 5 degrees of directions, int64, 0 to 71; nine consecutive ones are a sector."""
    return np.asarray(np.floor((azimuth_deg + 180.0) / BIN_DEG).astype(np.int64) % BINS)


def in_the_way(points: Float32s, head_m: float) -> Bools:
    """Return which points [n, 3] of the wearer's frame stand above the ground and below the head."""
    squared = points[:, 0] ** 2 + points[:, 2] ** 2
    is_above = points[:, 1] > MIN_HEIGHT_M + _NOISE_PER_M * squared
    return is_above & (points[:, 1] < head_m) & (squared > _OWN_BODY_M**2) & (squared < RANGE_M**2)


def nearest_m(points: Float32s, min_points: Float64s, turn_deg: float = 0.0) -> Float64s:
    """Return the distance of the nearest surface in each direction, metres, float64 [8]; inf without one.

    The directions are turned to the right by `turn_deg`.

    `points` float32 [n, 3] are those `in_the_way`. `min_points` float64 [50] is the least number of points of
    a surface by its distance, in steps of 10 cm (`min_points_of`).
    """
    distances = np.hypot(points[:, 0], points[:, 2])
    sectors = bins_of(azimuths_deg(points) - turn_deg) // BINS_PER_SECTOR
    cells = np.minimum((distances / _CELL_M).astype(np.int64), _CELLS - 1)
    counts = np.bincount(sectors * _CELLS + cells, minlength=8 * _CELLS).reshape(8, _CELLS)
    pairs = counts.copy()
    pairs[:, :-1] += counts[:, 1:]
    nearest = np.full(8, np.inf)
    for sector, cell in enumerate(np.argmax(pairs >= min_points, axis=1).tolist()):
        if pairs[sector, cell] < min_points[cell]:
            continue
        near = distances[(sectors == sector) & (cells >= cell) & (cells <= cell + 1)]
        nearest[sector] = float(np.partition(near, min(2, len(near) - 1))[min(2, len(near) - 1)])
    return nearest


def nearest_beside_m(points: Float32s, min_points: Float64s, seen: Bools) -> Float64s:
    """Return the distance of the nearest surface up to `BESIDE_DEG` beside each direction, float64 [8].

    What ends at the border of a direction may reach into it, unless the 5 degrees at the border are `seen`,
    bool [72]. The other parameters are those of `nearest_m`.
    """
    borders = seen.reshape(8, BINS_PER_SECTOR)
    left, right = (nearest_m(points, min_points, turn_deg) for turn_deg in (-BESIDE_DEG, BESIDE_DEG))
    left[borders[:, 0]], right[borders[:, -1]] = np.inf, np.inf
    return np.minimum(left, right)


def min_points_of(focal_px: float) -> Float64s:
    """Return the least number of pixels of a surface by its distance, float64 [50].

    It is a tenth of the pixels of 10 x 50 cm, between 5 and 40. `focal_px` is the focal length in pixels.
    """
    middles_m = (np.arange(_CELLS) + 0.5) * _CELL_M
    return np.asarray(np.clip(0.1 * 0.1 * 0.5 * (focal_px / middles_m) ** 2, 5.0, 40.0))


def seen_bins(azimuth_deg: Float32s, is_known: Bools, is_useful: Bools) -> Bools:
    """Return the bins of 5 degrees that a picture sees, bool [72].

    At least half of the useful pixels of a bin have a depth. A sensor returns none for what is too near, too
    far, dark or shiny; such a bin is not seen, and never free.
    """
    bins = bins_of(azimuth_deg[is_useful])
    rays = np.bincount(bins, minlength=BINS)
    known = np.bincount(bins[is_known[is_useful]], minlength=BINS)
    return (rays >= 5) & (known >= 0.5 * rays)


def seen_fraction(bins: Bools) -> Float64s:
    """Return the fraction of each direction that is seen, float64 [8]."""
    return np.asarray(bins.reshape(8, BINS_PER_SECTOR).mean(axis=1))
