"""Steps and holes of the ground ahead, within the width of the wearer.

A *step up* is a surface from the least height of a step to `MAX_STEP_M` above the ground. A *drop* (a step
down, a kerb, a hole) is seen where the ray of a pixel goes through the plane of the ground and meets
something lower: there the ground is missing.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float32s, Int64s
from touchfield.guidance.ground import Ground

HALF_WIDTH_M: Final = 0.35
RANGE_M: Final = 3.0
MAX_STEP_M: Final = 0.35
"""Higher surfaces are obstacles only."""
_CELL_M: Final = 0.1
_CELLS: Final = round(RANGE_M / _CELL_M)
_SIDE_CELLS: Final = 4
_NOISE_PER_M: Final = 0.006  # of height, times the square of the distance
_MIN_POINTS: Final = 3
_MIN_WIDE: Final = 2  # columns of the four across the way that a step or a drop takes


class GroundAhead(NamedTuple):
    """Distances of the nearest step up and drop ahead, metres; inf if there is none."""

    step_m: float = math.inf
    drop_m: float = math.inf


def ground_ahead(
    ground: Ground, rays: Float32s, depth_m: Float32s, points: Float32s, step_m: float
) -> GroundAhead:
    """Return the steps of the ground ahead.

    `rays` float32 [n, 3] and `depth_m` float32 [n] are those of the known pixels in camera axes, and `points`
    float32 [n, 3] their points in the wearer's frame. `step_m` is the least height.
    """
    if not ground.is_seen:
        return GroundAhead()
    is_ahead = (np.abs(points[:, 0]) < HALF_WIDTH_M) & (points[:, 2] > 0.2) & (points[:, 2] < RANGE_M)
    margin_m = step_m + _NOISE_PER_M * points[:, 2] ** 2
    is_step = is_ahead & (points[:, 1] > margin_m) & (points[:, 1] < MAX_STEP_M)
    is_tall = is_ahead & (points[:, 1] >= MAX_STEP_M) & (points[:, 1] < 2.0)
    return GroundAhead(
        _nearest_m(points, is_step, _cells(points, is_tall)),
        _drop_m(ground, rays, depth_m, points, step_m),
    )


def _drop_m(ground: Ground, rays: Float32s, depth_m: Float32s, points: Float32s, step_m: float) -> float:
    """Return the distance at which the ground is missing."""
    directions = rays @ ground.wearer_from_camera.T.astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing_m = np.where(directions[:, 1] < 0, -ground.height_m / directions[:, 1], np.inf)
        crossings = directions * crossing_m[:, None].astype(np.float32)
        is_ahead = (np.abs(crossings[:, 0]) < HALF_WIDTH_M) & (crossings[:, 2] > 0.2)
        is_ahead &= crossings[:, 2] < RANGE_M
        is_below = points[:, 1] < -(step_m + _NOISE_PER_M * np.minimum(points[:, 2], 5.0) ** 2)
    through = is_ahead & is_below & (depth_m > crossing_m)
    return _nearest_m(crossings, through, np.zeros((_CELLS, _SIDE_CELLS), np.int64))


def _cells(points: Float32s, is_selected: Bools) -> Int64s:
    """Count points in cells of 10 cm ahead and four columns across the way, int64 [30, 4]."""
    selected = points[is_selected]
    ahead = np.clip((selected[:, 2] / _CELL_M).astype(np.int64), 0, _CELLS - 1)
    across = ((selected[:, 0] / HALF_WIDTH_M + 1.0) * (_SIDE_CELLS / 2)).astype(np.int64)
    cells = ahead * _SIDE_CELLS + np.clip(across, 0, _SIDE_CELLS - 1)
    return np.bincount(cells, minlength=_CELLS * _SIDE_CELLS).reshape(_CELLS, _SIDE_CELLS)


def _nearest_m(points: Float32s, is_selected: Bools, excluded: Int64s) -> float:
    """Return the distance of the nearest cells that are wide enough and below nothing tall."""
    counts = _cells(points, is_selected)
    counts[:-1] += counts[1:]
    tall = np.pad(excluded, 1)
    beside = sum(tall[i : i + _CELLS, j : j + _SIDE_CELLS] for i in range(3) for j in range(3))
    is_there = (counts >= _MIN_POINTS) & (beside < _MIN_POINTS)
    rows = np.flatnonzero(is_there.sum(axis=1) >= _MIN_WIDE)
    return float(rows[0] * _CELL_M + _CELL_M / 2) if len(rows) else math.inf
