"""Compiled fits of the column guess: which surface, or two, a column of forces speaks for (floats)."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from touchfield.lean import lean

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Fits", "fit_one", "fit_two"]

_STEEP = 0.05  # no direction is less outward


class Fits(NamedTuple):
    """Evidence of the columns of a row that can be told.

    Attributes
    ----------
    places : int64 [n]
        In the row, ascending.
    forces : float32 [n, depth, 4]
        Across, across, outward, and the length, units, from outside to inside.
    spans : int64 [n, 2]
        The first sample with a force, and that from which on it is constant.
    surfaces : float64 [n, 3, 4]
        X, Y, Z, A of the one surface, and of two; A is 0 where it cannot be told.
    mask, ramp : float64 [2]
        k, and F_0 in units; the force deep inside, units, and the growth of its share from sample to sample.
    weights, one, two, rest : float64 [depth], [3], [3], [depth, 3]
        Room for what the samples weigh, directions, and what the first of two surfaces leaves.
    """

    places: NDArray[np.int64]
    forces: NDArray[np.float32]
    spans: NDArray[np.int64]
    surfaces: NDArray[np.float64]
    mask: NDArray[np.float64]
    ramp: NDArray[np.float64]
    weights: NDArray[np.float64]
    one: NDArray[np.float64]
    two: NDArray[np.float64]
    rest: NDArray[np.float64]


@lean
def _normalised(u):
    length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for c in range(3):
        u[c] /= max(length, 1e-9)
    return length


@lean
def _direction(d, begin, end, weights, u):
    """The direction of samples begin to end - 1."""
    for c in range(3):
        u[c] = 0.0
        for t in range(begin, end):
            u[c] += weights[t] * d[t, c]
    return _normalised(u)


@lean
def _along(d, u):
    return d[0] * u[0] + d[1] * u[1] + d[2] * u[2]


@lean
def _start(d, u, amplitude, slope, begin, end, weights):
    """Where the ramp of samples begin to end - 1 starts, samples."""
    total = weight = 0.0
    for t in range(begin, end):
        share = _along(d[t], u) / amplitude
        if 0.0 < share < 0.97:
            total += weights[t] * (t - share / slope)
            weight += weights[t]
    return total / weight if weight > 0.0 else begin - 0.5


@lean
def _tell(u, z, amplitude, out):
    out[0] = 16384.0 * u[0] / (1.0 + u[2])
    out[1] = 16384.0 * u[1] / (1.0 + u[2])
    out[2] = 256.0 * z
    out[3] = amplitude


@lean
def fit_two(fits, n):
    """Two surfaces one behind the other, where they miss least; False if there are none."""
    weights, u, v, rest = fits.weights, fits.one, fits.two, fits.rest
    d, out = fits.forces[n], fits.surfaces[n]
    first, flat = fits.spans[n, 0], fits.spans[n, 1]
    top, ramp = fits.ramp[0], fits.ramp[1]
    depth = d.shape[0]
    best = 1e18
    for cut in range(first + 3, flat, max(1, (flat - first) // 24)):
        _direction(d, first, cut, weights, u)
        growth = (_along(d[cut - 1], u) - _along(d[first + 1], u)) / (cut - first - 2)
        amplitude = growth / (ramp * u[2]) if u[2] > _STEEP else 0.0
        if amplitude < 0.01 * top or amplitude > 1.5 * top:
            continue
        z = _start(d, u, amplitude, ramp * u[2], first, cut, weights)
        for t in range(first, depth):
            size = amplitude * min(1.0, max(0.0, (t - z) * ramp * u[2]))
            for c in range(3):
                rest[t, c] = d[t, c] - size * u[c]
        behind = _direction(rest, depth - 1 if flat < depth else cut, depth, weights, v)
        behind = behind / weights[depth - 1] if flat < depth else top - amplitude
        if v[2] <= _STEEP or behind < 0.01 * top:
            continue
        z2 = _start(rest, v, behind, ramp * v[2], cut, flat, weights)
        cost = 0.0
        for t in range(first, flat):
            size = behind * min(1.0, max(0.0, (t - z2) * ramp * v[2]))
            error = 0.0
            for c in range(3):
                error += (rest[t, c] - size * v[c]) ** 2
            cost += min(error * weights[t], 4.0)
        if cost < best:
            best = cost
            _tell(u, z, amplitude, out[1])
            _tell(v, z2, behind, out[2])
    return best < 1e18


@lean
def fit_one(fits, n):
    """The span of a column, the weights of its samples, and the one surface."""
    weights, u, d = fits.weights, fits.one, fits.forces[n]
    k, f0, top, ramp = fits.mask[0], fits.mask[1], fits.ramp[0], fits.ramp[1]
    first = depth = d.shape[0]
    while first > 0 and d[first - 1, 3] > 0.0:
        first -= 1
        weights[first] = 1.0 / max(f0, k * d[first, 3]) ** 2
    flat = depth - 1
    while flat > first:
        apart = 0.0
        for c in range(3):
            apart += (d[flat - 1, c] - d[depth - 1, c]) ** 2
        if apart > 1e-4 * d[depth - 1, 3] ** 2:
            break
        flat -= 1
    if flat == depth - 1:
        flat = depth
    fits.spans[n, 0], fits.spans[n, 1] = first, flat
    _direction(d, first, depth, weights, u)
    u[2] = max(u[2], _STEEP)
    amplitude = np.float64(d[depth - 1, 3]) if flat < depth else top
    z = _start(d, u, amplitude, ramp * u[2], first, flat, weights)
    _tell(u, z, amplitude if flat < depth else 0.0, fits.surfaces[n, 0])
