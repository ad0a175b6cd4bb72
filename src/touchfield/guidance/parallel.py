"""The common normal of the level surfaces in a picture: a floor, a raised floor, a hole, the top of a box.

A single plane through a floor and a step tilts across the edge, since it passes near the points of both. Two
parallel planes do not, so a tilt is scored by the two of its planes that have the most points.

Heights are those of the camera above a plane. Points are float64 [n, 3], camera axes.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Float64s

_BIN_M: Final = 0.015
_BINS: Final = 121  # up to 0.9 m above and below
_MIDDLE: Final = _BINS // 2
_APART_BINS: Final = 4  # between two planes: less than the least height of a step
_MIN_POINTS: Final = 40
_MIN_SPREAD_M: Final = 0.12
_TOLERANCE_M, _NOISE_PER_M = 0.015, 0.003


def parallel_scores(points: Float64s, ups: Float64s, heights_m: Float64s) -> Float64s:
    """Return the weight of the points in each plane and in its best parallel one, float64 [planes].

    `ups` float64 [planes, 3] are unit normals and `heights_m` float64 [planes] the heights. The weight of a
    point is the inverse of its distance.
    """
    windows = _histograms(points @ ups.T + heights_m, 1 / points[:, 2])
    own = windows[:, _MIDDLE].copy()
    _exclude(windows, _MIDDLE)
    return np.asarray(own + windows.max(axis=1))


def parallel_normal(points: Float64s, up: Float64s) -> Float64s | None:
    """Return the common normal, float64 [3], of the two largest planes near the unit normal `up`.

    It is a least squares fit of the points of both. None if these do not determine it.
    """
    for _ in range(2):
        groups = _largest_groups(points, up)
        if not groups:
            return None
        centred = np.concatenate([group - group.mean(axis=0) for group in groups])
        values, vectors = np.linalg.eigh(centred.T @ centred / len(centred))
        if values[1] < _MIN_SPREAD_M**2:  # points on a line, such as a skirting board
            return None
        up = vectors[:, 0] * np.sign(vectors[:, 0] @ up)
    return up


def plane_height_m(
    points: Float64s, up: Float64s, expected_m: float, range_m: float, min_points: float
) -> float | None:
    """Return the height of the largest plane with the normal `up` within `range_m` of `expected_m`, or None.

    It has at least `min_points` points.
    """
    heights = -(points @ up)
    windows = _histograms((heights - expected_m)[:, None], 1 / points[:, 2])[0]
    offsets = (np.arange(_BINS) - _MIDDLE) * _BIN_M
    windows[np.abs(offsets) > range_m] = 0
    is_inlier = np.abs(heights - expected_m - offsets[np.argmax(windows)]) < tolerance_m(points)
    if np.count_nonzero(is_inlier) < min_points:
        return None
    height_m = float(heights[is_inlier].mean())
    return height_m if abs(height_m - expected_m) <= range_m else None


def tolerance_m(points: Float64s) -> Float64s:
    """Return how far a point may lie from its plane: the noise grows with the square of the distance."""
    return np.asarray(_TOLERANCE_M + _NOISE_PER_M * points[:, 2] ** 2)


def _largest_groups(points: Float64s, up: Float64s) -> list[Float64s]:
    """Return the points of the two largest planes with the normal `up`, without those that have few."""
    heights = -(points @ up)
    middle_m = float(np.median(heights))
    windows = _histograms((heights - middle_m)[:, None], 1 / points[:, 2])
    groups = []
    for _ in range(2):
        best = int(np.argmax(windows))
        offsets_m = heights - middle_m - (best - _MIDDLE) * _BIN_M
        groups.append(points[np.abs(offsets_m) < tolerance_m(points)])
        _exclude(windows, best)
    return [group for group in groups if len(group) >= _MIN_POINTS]


def _exclude(windows: Float64s, middle: int) -> None:
    """Clear the windows [planes, bins] of the plane in the bin `middle`."""
    windows[:, max(0, middle - _APART_BINS + 1) : middle + _APART_BINS] = 0


def _histograms(offsets_m: Float64s, weights: Float64s) -> Float64s:
    """Return the weight within one bin around each offset, float64 [planes, bins], of offsets [n, planes]."""
    planes = offsets_m.shape[1]
    bins = np.floor(offsets_m / _BIN_M + _BINS / 2).astype(np.int64)
    is_inside = (bins >= 0) & (bins < _BINS)
    flat = (bins + np.arange(planes) * _BINS)[is_inside]
    counted = np.broadcast_to(weights[:, None], bins.shape)[is_inside]
    counts = np.bincount(flat, counted, minlength=planes * _BINS).reshape(planes, _BINS)
    padded = np.pad(counts, ((0, 0), (1, 1)))
    return np.asarray(padded[:, :-2] + padded[:, 1:-1] + padded[:, 2:])
