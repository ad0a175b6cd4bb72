"""Describes where a medium is touched, whichever way it is turned and whatever its size: the power of the
spherical harmonics of its skin in spherical shells (paper sections 4 and 5.1).

The paper names no descriptor. The energies of harmonics in shells are those of M. Kazhdan, T. Funkhouser and
S. Rusinkiewicz, Rotation invariant spherical harmonic representation of 3D shape descriptors, Symposium on
Geometry Processing, 2003. A rotation mixes only harmonics of one degree, and leaves the sum of their squares.

Two departures: a voxel has the weight exp(-|F| / `SKIN_N`), so that the skin of a body counts and its inside,
which a sensor does not see, hardly does; and the weight of a voxel is shared between the two nearest shells,
so that it changes little when a voxel crosses the border between them. The shells lie around the mean of the
skin, and their radii are relative to its root mean square distance from there.

A body and its mirror image have the same numbers.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s

SHELLS: Final = 6
DEGREE: Final = 6
REACH: Final = 1.6
"""Radius of the outermost shell over the root mean square distance of the skin.

That shell also takes what lies beyond.
"""

SKIN_N: Final = 1.0
"""Force at which the weight of a voxel falls to 1/e, newtons.

A wall of 500 N/m reaches it at a depth of 2 mm.
"""


def shell_power(positions_m: ArrayLike, amplitudes_n: ArrayLike) -> Float64s:
    """Return the square roots of the power by shell and degree, float64 [SHELLS, DEGREE + 1].

    `positions_m` float [n, 3]: metres, n at least 1. `amplitudes_n` float [n]: |F|, newtons. The numbers are
    0 to 1: sqrt(4 pi sum_m a_lm^2 / (2 DEGREE + 1)), where a_lm are the coefficients of a shell for a total
    weight of 1. For degree 0 they are the fraction of the weight in the shell over sqrt(2 DEGREE + 1).
    """
    from touchfield.measure.kernels import sums_by_shell

    points, amplitudes = np.asarray(positions_m, np.float64), np.asarray(amplitudes_n, np.float64)
    weights = np.exp((amplitudes.min() - amplitudes) / SKIN_N)  # the weakest is 1, lest all of them underflow
    weights /= weights.sum()
    centred = points - weights @ points
    radius_m = math.sqrt(float(weights @ np.einsum("ij,ij->i", centred, centred)))
    shells_per_m = SHELLS / (REACH * radius_m) if radius_m > 0 else 0.0
    sums = sums_by_shell(centred, weights, shells_per_m, SHELLS, harmonic_norms(DEGREE))
    power = np.add.reduceat(sums**2, np.arange(DEGREE + 1) ** 2, axis=1)
    numbers: Float64s = np.sqrt(4 * math.pi / (2 * DEGREE + 1) * power)
    return np.minimum(numbers, 1.0)


@cache
def harmonic_norms(degree: int) -> Float64s:
    """Return the norms of the real spherical harmonics by l and m, float64 [degree + 1, degree + 1]."""
    norms = np.zeros((degree + 1, degree + 1))
    for order in range(degree + 1):
        for m in range(order + 1):
            ratio = math.factorial(order - m) / math.factorial(order + m)
            norms[order, m] = math.sqrt((2 * order + 1) / (4 * math.pi) * ratio * (2 if m else 1))
    return norms
