"""Compiled loops of the spline guess: the code of its nodes, and the forces that they stand for.

Whole numbers throughout: of a coefficient of 2^23 units no intermediate reaches 2^62.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numba import njit

from touchfield.codec.kernels.bits import READING, TASK, code, even
from touchfield.codec.kernels.lean import entry, inlined, lean
from touchfield.codec.touch.kernels.lattice import root

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CONTEXTS", "PAD", "REACH", "Nodes", "Potential", "code_nodes", "fill_bricks", "needed_nodes", "weights"]

PAD: Final = 2
"""Nodes laid out before the first one along each axis, all unknown: a prediction looks back as far."""

REACH: Final = 1 << 23
"""No coefficient is beyond it, units."""

_CLASSES: Final = 10
_LENGTHS: Final = 24
_SIGN: Final = _CLASSES * _LENGTHS
_SECOND: Final = _SIGN + 27
CONTEXTS: Final = _SECOND + _LENGTHS

_FULL_SLOPE: Final = 1 << 15
_STEEP: Final = 1 << 20


class Nodes(NamedTuple):
    """Nodes of a box, and `PAD` more before them along each axis.

    Attributes
    ----------
    wanted : uint8 [x, y, z]
        1 for those that are told.
    values : int64 [x, y, z]
        Coefficients, units; a writer's are replaced by what a reader will have.
    residuals : int64 [x, y, z]
        In steps.
    """

    wanted: NDArray[np.uint8]
    values: NDArray[np.int64]
    residuals: NDArray[np.int64]


class Potential(NamedTuple):
    """What forces are made of.

    Attributes
    ----------
    values : int64 [x, y, z]
        Of `Nodes`.
    low : int64 [3]
        The first node that is not before the box.
    shifts : int64 [3]
        Nodes lie 2^shift samples apart.
    tables : three of int64 [2, 2^shift, 4]
        `weights`.
    scales : int64 [3]
        Make slopes of derivatives.
    shape : int64 [3]
        Samples of the grid.
    """

    values: NDArray[np.int64]
    low: NDArray[np.int64]
    shifts: NDArray[np.int64]
    tables: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]
    scales: NDArray[np.int64]
    shape: NDArray[np.int64]


@entry
def needed_nodes(bricks, low, shifts, wanted):
    """Mark the nodes that samples of `bricks`, int32 [n, 3], lie within the reach of; `low` is the first node."""
    for n in range(bricks.shape[0]):
        a, b, c = bricks[n, 0] * 8, bricks[n, 1] * 8, bricks[n, 2] * 8
        for i in range((a >> shifts[0]) - 1, ((a + 7) >> shifts[0]) + 3):
            for j in range((b >> shifts[1]) - 1, ((b + 7) >> shifts[1]) + 3):
                for k in range((c >> shifts[2]) - 1, ((c + 7) >> shifts[2]) + 3):
                    wanted[i - low[0] + PAD, j - low[1] + PAD, k - low[2] + PAD] = 1


@inlined
def _expected(nodes, i, j, k):
    """What the nodes told before say: the mean of all straight lines and flat faces through them."""
    wanted, values = nodes.wanted, nodes.values
    x, y, z = np.int64(wanted[i - 1, j, k]), np.int64(wanted[i, j - 1, k]), np.int64(wanted[i, j, k - 1])
    a, b, c = values[i - 1, j, k], values[i, j - 1, k], values[i, j, k - 1]
    total, count = np.int64(0), np.int64(0)
    if x and wanted[i - 2, j, k]:
        total += 2 * a - values[i - 2, j, k]
        count += 1
    if y and wanted[i, j - 2, k]:
        total += 2 * b - values[i, j - 2, k]
        count += 1
    if z and wanted[i, j, k - 2]:
        total += 2 * c - values[i, j, k - 2]
        count += 1
    if x and y and wanted[i - 1, j - 1, k]:
        total += a + b - values[i - 1, j - 1, k]
        count += 1
    if x and z and wanted[i - 1, j, k - 1]:
        total += a + c - values[i - 1, j, k - 1]
        count += 1
    if y and z and wanted[i, j - 1, k - 1]:
        total += b + c - values[i, j - 1, k - 1]
        count += 1
    if count == 0:
        total, count = x * a + y * b + z * c, max(np.int64(1), x + y + z)
    return (2 * total + count) // (2 * count)


@lean
def _length(n):
    digits = np.int64(0)
    while n >> digits:
        digits += 1
    return digits


@inlined
def _residual(bits, at, near, signs, r):
    """A residual: the length of its size, its sign, and the digits behind the first one."""
    size = abs(r)
    wanted = _length(size)
    length = np.int64(0)
    while length < _LENGTHS and code(bits, at + near * _LENGTHS + length, np.int64(wanted > length)):
        length += 1
    if length == 0:
        return np.int64(0)
    negative = code(bits, at + _SIGN + signs, np.int64(r < 0))
    out = np.int64(1)
    if length > 1:
        out = 2 + code(bits, at + _SECOND + length - 2, (size >> (length - 2)) & 1)
    if length > 2:
        out = (out << (length - 2)) | even(bits, size & ((np.int64(1) << (length - 2)) - 1), length - 2)
    return -out if negative else out


@entry
def code_nodes(bits, at, nodes, step):
    """Tell all wanted nodes in raster order (x slowest), in multiples of `step` from what is expected."""
    wanted, values, residuals = nodes.wanted, nodes.values, nodes.residuals
    for i in range(PAD, wanted.shape[0]):
        for j in range(PAD, wanted.shape[1]):
            for k in range(PAD, wanted.shape[2]):
                if not wanted[i, j, k]:
                    continue
                a, b, c = residuals[i - 1, j, k], residuals[i, j - 1, k], residuals[i, j, k - 1]
                near = min(_length(abs(a) + abs(b) + abs(c)), np.int64(_CLASSES - 1))
                signs = np.int64((np.sign(a) + 1) * 9 + (np.sign(b) + 1) * 3 + np.sign(c) + 1)
                expected = _expected(nodes, i, j, k)
                r = np.int64(0)
                if bits.state[TASK] != READING:
                    r = (2 * (values[i, j, k] - expected) + step) // (2 * step)
                r = _residual(bits, at, near, signs, r)
                residuals[i, j, k] = r
                values[i, j, k] = min(max(expected + r * step, np.int64(-REACH)), np.int64(REACH))


@njit(cache=True, nogil=True)
def weights(shift):
    """Of the four nodes around a sample, by its phase: those of the value, and those of the derivative.

    Returns
    -------
    int64 [2, 2^shift, 4]
        Of sum 6 h^3 and 0, h = 2^shift; in the derivative 2 h^3 is a growth of one a sample.
    """
    h = np.int64(1) << shift
    out = np.zeros((2, h, 4), np.int64)
    for p in range(h):
        q = h - p
        out[0, p, 0], out[0, p, 3] = q * q * q, p * p * p
        out[0, p, 1] = 4 * h * h * h - 6 * h * p * p + 3 * p * p * p
        out[0, p, 2] = 4 * h * h * h - 6 * h * q * q + 3 * q * q * q
        out[1, p, 0], out[1, p, 3] = -q * q, p * p
        out[1, p, 1], out[1, p, 2] = 3 * p * p - 4 * h * p, h * h + 2 * h * p - 3 * p * p
    return out


@lean
def _sum(source, table, kind, sample, shift, of):
    """Weigh the four nodes of a sample along the first axis, at place `of` of the others; rounded."""
    phase = sample & ((1 << shift) - 1)
    cell = sample >> shift
    total = np.int64(0)
    for n in range(4):
        total += table[kind, phase, n] * source[cell + n, of]
    return (total + (np.int64(1) << (3 * shift) >> 1)) >> (3 * shift)


@inlined
def _force(value, slopes, top, out):
    """The force of a potential of `value` units that grows by `slopes`, in 1/32768 of the stiffness."""
    square = slopes[0] * slopes[0] + slopes[1] * slopes[1] + slopes[2] * slopes[2]
    steep = max(root(square), np.int64(_FULL_SLOPE >> 1))
    size = min(value, top)
    for c in range(3):
        out[c] = (steep - 2 * size * slopes[c]) // (2 * steep)


@njit(cache=True, nogil=True)
def fill_bricks(begin, end, bricks, potential, top, out):
    """Forces of bricks begin to end - 1: ``out[n, i, j, k, component]``, int32, zero before and beyond the grid."""
    shifts, tables, shape = potential.shifts, potential.tables, potential.shape
    lattice = np.zeros((7, 49), np.int64)
    along_x = np.zeros((2, 7, 7), np.int64)  # value, derivative; z first, for one x
    along_y = np.zeros((3, 7, 1), np.int64)  # value, by x, by y
    slopes = np.zeros(3, np.int64)
    force = np.zeros(3, np.int64)
    counts = np.zeros(3, np.int64)
    first = np.zeros(3, np.int64)
    for c in range(3):
        counts[c] = (8 >> shifts[c]) + 3
    for n in range(begin, end):
        for c in range(3):
            first[c] = (bricks[n, c] * 8 >> shifts[c]) - 1 - potential.low[c] + PAD
        for a in range(counts[0]):
            for b in range(counts[1]):
                for c in range(counts[2]):
                    lattice[a, b * 7 + c] = potential.values[first[0] + a, first[1] + b, first[2] + c] << 4
        for i in range(min(8, shape[0] - bricks[n, 0] * 8)):
            for b in range(counts[1]):
                for c in range(counts[2]):
                    for kind in range(2):
                        along_x[kind, b, c] = _sum(lattice, tables[0], kind, i, shifts[0], b * 7 + c)
            for j in range(min(8, shape[1] - bricks[n, 1] * 8)):
                for c in range(counts[2]):
                    along_y[0, c, 0] = _sum(along_x[0], tables[1], 0, j, shifts[1], c)
                    along_y[1, c, 0] = _sum(along_x[1], tables[1], 0, j, shifts[1], c)
                    along_y[2, c, 0] = _sum(along_x[0], tables[1], 1, j, shifts[1], c)
                for k in range(min(8, shape[2] - bricks[n, 2] * 8)):
                    value = _sum(along_y[0], tables[2], 0, k, shifts[2], 0)
                    if value <= 0:
                        continue
                    slopes[0] = _sum(along_y[1], tables[2], 0, k, shifts[2], 0)
                    slopes[1] = _sum(along_y[2], tables[2], 0, k, shifts[2], 0)
                    slopes[2] = _sum(along_y[0], tables[2], 1, k, shifts[2], 0)
                    for c in range(3):
                        slope = slopes[c] * potential.scales[c] >> 20
                        slopes[c] = min(max(slope, np.int64(-_STEEP)), np.int64(_STEEP))
                    _force((value + 1728) // 3456, slopes, top, force)
                    for c in range(3):
                        out[n, i, j, k, c] = force[c]
