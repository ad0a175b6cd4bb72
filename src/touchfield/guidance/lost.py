"""Surfaces that left the picture of a camera without poses: what is beside the picture may still be there.

A camera sees two thirds of each direction in front. Once a surface has left the rest through the edge of the
picture, the direction looks free, and is not known to be.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Bools, Float64s

HOLD_S: Final = 2.0
"""How long a surface is expected that left the picture: a person who turns the head looks back by then."""
_SPEED_M_S: Final = 1.0  # of a wearer who walks towards it
_JUMP_M: Final = 0.3  # a distance that grows by more is another surface


class LostSurfaces:
    """The nearest surface of each direction that left the picture, and when."""

    def __init__(self) -> None:
        self._last_m: Float64s = np.full(8, np.inf)
        self._lost_m: Float64s = np.full(8, np.inf)
        self._lost_s: Float64s = np.zeros(8)

    def update(self, distances_m: Float64s, now_s: float, warn_m: float) -> Bools:
        """Return the directions in which a lost surface may be nearer than `warn_m`, bool [8].

        `distances_m` float64 [8] are those of the nearest surfaces of the picture, inf without one.
        """
        is_back = distances_m < self._lost_m + _JUMP_M
        self._lost_m[is_back | (now_s - self._lost_s > HOLD_S)] = np.inf
        nearest_m = np.minimum(self._last_m, self._lost_m - _SPEED_M_S * (now_s - self._lost_s))
        is_lost = (distances_m > self._last_m + _JUMP_M) & (self._last_m <= nearest_m)
        self._lost_m[is_lost], self._lost_s[is_lost] = self._last_m[is_lost], now_s
        self._last_m = distances_m.copy()
        return np.asarray(self._lost_m - _SPEED_M_S * (now_s - self._lost_s) < warn_m)
