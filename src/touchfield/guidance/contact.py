"""Time to contact by direction, from the change of the distance over the last frames.

The speed is the median of the slopes between all pairs of the last distances (Theil 1950, Sen 1968), which an
outlier does not change, and a low-pass of the first order. A jump of the distance is another surface, whose
speed is not known yet.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import combinations
from typing import Final

import numpy as np

from touchfield.arrays import Float64s

_FRAMES: Final = 8
_MIN_FRAMES: Final = 4
_JUMP_M: Final = 0.3
_TIME_CONSTANT_S: Final = 0.15
_MIN_SPEED_M_S: Final = 0.15  # slower is noise, or a wearer who stands
_MAX_GAP_S: Final = 0.5


class ContactTimer:
    """Time to contact of one direction."""

    def __init__(self) -> None:
        self._history: deque[tuple[float, float]] = deque(maxlen=_FRAMES)
        self._speed_m_s = 0.0

    def update(self, now_s: float, distance_m: float) -> float:
        """Add a distance, inf if there is no surface; return the time to contact, seconds, or inf."""
        if not math.isfinite(distance_m):
            self._history.clear()
            return math.inf
        if self._history:
            last_s, last_m = self._history[-1]
            if now_s <= last_s or now_s - last_s > _MAX_GAP_S or abs(distance_m - last_m) > _JUMP_M:
                self._history.clear()
        self._history.append((now_s, distance_m))
        if len(self._history) < _MIN_FRAMES:
            self._speed_m_s = 0.0
            return math.inf
        slopes = [(d0 - d1) / (t1 - t0) for (t0, d0), (t1, d1) in combinations(self._history, 2)]
        weight = 1.0 - math.exp(-(now_s - self._history[-2][0]) / _TIME_CONSTANT_S)
        self._speed_m_s += weight * (float(np.median(slopes)) - self._speed_m_s)
        return distance_m / self._speed_m_s if self._speed_m_s > _MIN_SPEED_M_S else math.inf


def times_to_contact(timers: list[ContactTimer], now_s: float, distances_m: Float64s) -> Float64s:
    """Update the timers of all directions; return the times to contact, seconds, float64 [8]."""
    return np.array([timer.update(now_s, float(d)) for timer, d in zip(timers, distances_m, strict=True)])
