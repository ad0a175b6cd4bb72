"""Where an ellipsoid is nearest: the root of Eberly's equation for many points (see `Ellipsoid`)."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

__all__ = ["greatest_roots"]

_MOST_STEPS: Final = 60
"""Of Newton's iteration; where it is slowest, beside the focal ellipse, about ten are needed."""


@njit(cache=True, nogil=True)
def greatest_roots(scaled, ratio):
    """u >= 0 with sum (r_i z_i / (u + r_i - 1))^2 = 1, float64 [n]; 0 where the sum is below 1 everywhere.

    `scaled` float64 [n, 3]: z_i = |p_i| / e_i; `ratio` float64 [3]: r_i = (e_i / e_min)^2.
    """
    roots = np.empty(len(scaled))
    for k in range(len(scaled)):
        root = 0.0
        for i in range(3):  # no term may exceed 1 at the root
            root = max(root, ratio[i] * scaled[k, i] - (ratio[i] - 1.0))
        for _ in range(_MOST_STEPS):
            square = fall = 0.0
            for i in range(3):
                denominator = root + (ratio[i] - 1.0)
                if denominator > 0.0:
                    term = (ratio[i] * scaled[k, i] / denominator) ** 2
                    square += term
                    fall += term / denominator
            if square <= 1.0:
                break
            after = root + square * (math.sqrt(square) - 1.0) / fall
            if after <= root * (1.0 + 4e-16):
                break
            root = after
        roots[k] = root
    return roots
