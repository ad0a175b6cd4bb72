"""Where things that move were last, and which directions they may have reached since.

What moves leaves two errors in a memory when it leaves the picture: a surface where it is no longer, and free
space where it is by now. Both are unknown: the surfaces of the columns where it was, and the directions that
it may have reached since, at `SPEED_M_S`.

The samples of a fused world count as changed where a surface appeared in free space. Some do so at the edges
of things that stand, because of errors of the poses; so a neighbourhood decides, and no single sample.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int64s
from touchfield.guidance.directions import BIN_DEG, BINS

SPEED_M_S: Final = 1.5
"""How fast what moves may go on outside of the picture: a person in a hurry."""
_RADIUS_M: Final = 0.3
_NEIGHBOURS: Final = 7  # columns of a neighbourhood along each axis
_TRAIL: Final = 13  # columns, along each axis, that are left behind by what was in the middle one: 1 m
_MIN_CHANGED, _MIN_CHANGED_FRACTION = 3, 0.15
"""Samples of a neighbourhood. In corridors 57 % of those of people who walk changed (median), and 0 to 7 % of
those of poles, boxes, walls and people who stand."""


class Movers:
    """Things that move, in the columns of a lattice of `shape` (x, z) columns.

    `last_s` float64 [x, z] is when something that moves was last in a column; -inf if never, or if the column
    was seen without it since.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.last_s: Float64s = np.full(shape, -np.inf)
        self._is_trail: Bools = np.zeros(shape, np.bool_)

    def update(self, columns: Int64s, has_changed: Bools, is_seen: Bools, now_s: float) -> None:
        """Find what moves.

        `columns` int64 [n, 2] are the columns of the samples of surfaces, `has_changed` bool [n] which of
        these changed, and `is_seen` bool [x, z] the columns that are in the picture.
        """
        from scipy.ndimage import maximum_filter, uniform_filter

        shape = self.last_s.shape
        flat = np.ravel_multi_index(tuple(columns.T), shape)
        counts = (np.bincount(c, minlength=self.last_s.size) for c in (flat, flat[has_changed]))
        total, changed = (
            _NEIGHBOURS**2 * uniform_filter(c.reshape(shape).astype(np.float64), _NEIGHBOURS, mode="constant")
            for c in counts
        )
        is_mover = (changed > _MIN_CHANGED - 0.5) & (changed >= _MIN_CHANGED_FRACTION * total)
        self._is_trail = np.asarray(maximum_filter(is_mover, _TRAIL, mode="constant"))
        self.last_s[is_seen] = np.where(is_mover[is_seen], now_s, -np.inf)

    def has_moved(self, columns: Int64s) -> Bools:
        """Return which samples belong to things that move; `columns` are as in `update`, bool [n]."""
        return np.asarray(self._is_trail[columns[:, 0], columns[:, 1]])

    def reached_bins(self, places: Float32s, now_s: float, warn_m: float) -> Bools:
        """Return the directions of 5 degrees that what left the picture may have reached, bool [72].

        `places` float32 [x z, 3] are the columns in the wearer's frame. Only ways of up to `warn_m` count.
        """
        age_s = now_s - self.last_s.reshape(-1)
        is_gone = np.isfinite(age_s) & (age_s > 0)
        reach_m = _RADIUS_M + SPEED_M_S * age_s[is_gone]
        x, z = places[is_gone, 0], places[is_gone, 2]
        distance_m = np.hypot(x, z)
        is_near = distance_m - reach_m < warn_m
        ratio = np.clip(reach_m / np.maximum(distance_m, 1e-6), 0.0, 1.0)
        half_deg = np.where(reach_m >= distance_m, 180.0, np.degrees(np.arcsin(ratio)))[is_near]
        middles = (np.arange(BINS) + 0.5) * BIN_DEG - 180.0
        away_deg = np.abs((middles[:, None] - np.degrees(np.arctan2(x, z))[is_near] + 180.0) % 360.0 - 180.0)
        return np.asarray((away_deg <= half_deg + BIN_DEG / 2).any(axis=1))
