"""Compiled kernels of perception: deadbands, and the sum over neighbours of `mask`; imported only when first needed.

The gates along a scan run in one thread, because each sample depends on what was sent before it. Products and
sums are in float64; a comparison is written so that a NaN would be sent, not held.

The sum over neighbours goes brick by brick, in three passes. No weight is negative and the sample itself is never
added and taken off again, so that the sum rises with every amplitude to the last bit. Each brick is made alone, in a
fixed order of additions: the same bits for any number of threads.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.medium.kernels import first_at_least
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Bools = NDArray[np.bool_]
    Float64s = NDArray[np.float64]


@njit(cache=True, nogil=True)
def gate_closed(vectors, decoded, fraction, sent):
    """The closed loop along a scan, float32 [L, 3] twice into bool [L]; `fraction` is k'."""
    squared = fraction * fraction
    rx, ry, rz = 0.0, 0.0, 0.0
    limit = -1.0  # the first sample is always sent
    for i in range(vectors.shape[0]):
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        held = dx * dx + dy * dy + dz * dz <= limit
        sent[i] = not held
        if not held:
            rx, ry, rz = np.float64(decoded[i, 0]), np.float64(decoded[i, 1]), np.float64(decoded[i, 2])
            limit = squared * (rx * rx + ry * ry + rz * rz)


_PREVIOUS, _ZERO = 0, 1  # of the amplitude readings; "last-sent" is 2


@njit(cache=True, nogil=True)
def gate_amplitudes(vectors, k, reading, sent):
    """The amplitude readings of eq. 8 along a scan, float32 [L, 3] into bool [L]."""
    low, high = 1.0, 0.0  # an empty interval: the first sample is always sent
    for i in range(vectors.shape[0]):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        amplitude = math.sqrt(x * x + y * y + z * z)
        held = low < amplitude and amplitude < high
        sent[i] = not held
        if reading == _PREVIOUS or not held:
            low, high = amplitude - k * amplitude, amplitude + k * amplitude
        elif reading == _ZERO:
            low, high = 0.0, 0.0


@njit(cache=True, nogil=True)
def gate_in_time(begin, end, vectors, reference, fraction, sent):
    """Where |x - reference| > `fraction` |reference|, float32 [L, 3] twice into bool [L]."""
    squared = fraction * fraction
    for i in range(begin, end):
        rx, ry, rz = np.float64(reference[i, 0]), np.float64(reference[i, 1]), np.float64(reference[i, 2])
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        sent[i] = not dx * dx + dy * dy + dz * dz <= squared * (rx * rx + ry * ry + rz * rz)


@njit(cache=True, nogil=True)
def held_values(sent, decoded, out):
    """The last sent value at each place, bool [L] and float32 [L, 3] into float32 [L, 3]."""
    x, y, z = np.float32(0), np.float32(0), np.float32(0)
    for i in range(sent.shape[0]):
        if sent[i]:
            x, y, z = decoded[i, 0], decoded[i, 1], decoded[i, 2]
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = z


@njit(cache=True, nogil=True)
def _along_x(slot, corner, reach, weights, levels, full, rest):
    """Add one brick, whose first sample lies at `corner` of the middle one, to the sums along x."""
    y0, y1 = max(0, -reach[1] - corner[1]), min(8, 8 + reach[1] - corner[1])
    z0, z1 = max(0, -reach[2] - corner[2]), min(8, 8 + reach[2] - corner[2])
    j, k = corner[1] + reach[1], corner[2] + reach[2]
    beside = corner[1] == 0 and corner[2] == 0
    for x in range(8):
        at = corner[0] + x
        for i in range(max(0, at - reach[0]), min(8, at + reach[0] + 1)):
            w = weights[0, abs(at - i)]
            for y in range(y0, y1):
                for z in range(z0, z1):
                    full[i, j + y, k + z] += w * levels[slot, x, y, z]
            if beside and at != i:
                for y in range(8):
                    for z in range(8):
                        rest[i, y, z] += w * levels[slot, x, y, z]


@njit(cache=True, nogil=True)
def _along_y_and_z(reach, weights, full, rest, along, out):
    """The sums along y, then along z; `rest` is what the line along x gave without the sample itself."""
    for i in range(8):
        for j in range(8):
            for k in range(8 + 2 * reach[2]):
                others = 0.0
                for t in range(j, j + 2 * reach[1] + 1):
                    if t != j + reach[1]:
                        others += weights[1, abs(t - j - reach[1])] * full[i, t, k]
                along[k] = full[i, j + reach[1], k] + others
                if 0 <= k - reach[2] < 8:
                    rest[i, j, k - reach[2]] += others
            for k in range(8):
                others = rest[i, j, k]
                for t in range(k, k + 2 * reach[2] + 1):
                    if t != k + reach[2]:
                        others += weights[2, abs(t - k - reach[2])] * along[t]
                out[i, j, k] = others


@njit(cache=True, nogil=True)
def _neighbour_sums(begin, end, bricks, keys, brick_shape, levels, reach, weights, wanted, out):
    full = np.zeros((8, 8 + 2 * reach[1], 8 + 2 * reach[2]))
    rest, along, corner = np.zeros((8, 8, 8)), np.zeros(8 + 2 * reach[2]), np.zeros(3, np.int64)
    for n in range(begin, end):
        a, b, c = bricks[wanted + n, 0], bricks[wanted + n, 1], bricks[wanted + n, 2]
        for i in range(8):
            for j in range(8 + 2 * reach[1]):
                for k in range(8 + 2 * reach[2]):
                    full[i, j, k] = 0.0
            for j in range(8):
                for k in range(8):
                    rest[i, j, k] = 0.0
        over_x, over_y, over_z = (reach[0] + 7) >> 3, (reach[1] + 7) >> 3, (reach[2] + 7) >> 3
        for p in range(max(0, a - over_x), min(brick_shape[0], a + over_x + 1)):
            for q in range(max(0, b - over_y), min(brick_shape[1], b + over_y + 1)):
                row = (p * brick_shape[1] + q) * brick_shape[2]
                slot = first_at_least(keys, row + max(0, c - over_z))
                last = row + min(brick_shape[2] - 1, c + over_z)
                while slot < keys.shape[0] and keys[slot] <= last:
                    corner[0], corner[1], corner[2] = (p - a) * 8, (q - b) * 8, (keys[slot] - row - c) * 8
                    _along_x(slot, corner, reach, weights, levels, full, rest)
                    slot += 1
        _along_y_and_z(reach, weights, full, rest, along, out[n])


def neighbour_sums(
    lattice: tuple[NDArray[np.int32], NDArray[np.int64], tuple[int, int, int]],
    levels: Float64s,
    reach: tuple[int, int, int],
    weights: Float64s,
    span: tuple[int, int],
) -> Float64s:
    """sum_j w_ij levels_j at the samples of the bricks `span`, float64 [m, 8, 8, 8].

    lattice : (int32 [n, 3], int64 [n], (int, int, int)); the bricks, their keys in ascending order, and the bricks
        along each axis.
    levels : float64 [n, 8, 8, 8]; not negative; zero beyond the grid.
    reach : (int, int, int); samples on each side.
    weights : float64 [3, r + 1]; the factor of w at distances 0 .. reach of each axis, 1 at 0; w_ii is left out.
    span : (int, int); the first brick wanted and the one after the last.
    """
    bricks, keys, brick_shape = lattice
    begin, end = span
    out = np.empty((end - begin, 8, 8, 8))
    for_chunks(_neighbour_sums, end - begin, bricks, keys, brick_shape, levels, reach, weights, begin, out, chunk=4)
    return out
