"""The compiled core of `touchfield.filters.resample`: three passes over each output brick.

Each is made alone, in a fixed order of additions, so that the result does not depend on the number of threads.
Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Bools, Float32s, Int32s, Int64s
from touchfield.lean import entry, inlined, lean
from touchfield.medium.budget import zero_forces
from touchfield.medium.kernels import first_at_least
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from collections.abc import Sequence


@entry
def reached(spans, brick_shape, out):
    """Into `out` the keys of the bricks of each box, `spans` int64 [n, 3, 2] being their begins and ends."""
    count = 0
    for n in range(spans.shape[0]):
        for i in range(spans[n, 0, 0], spans[n, 0, 1]):
            for j in range(spans[n, 1, 0], spans[n, 1, 1]):
                for k in range(spans[n, 2, 0], spans[n, 2, 1]):
                    out[count] = (i * brick_shape[1] + j) * brick_shape[2] + k
                    count += 1


@inlined
def _pass_x(forces, slot, span, low, first, weights, n0, n1, tmp):
    """Add what one input brick gives to the first pass; `span` holds its sample ranges x0, x1, y0, y1, z0, z1."""
    run = (span[5] - span[4]) * 3
    at = (span[4] - low[2]) * 3
    start = (span[4] & 7) * 3
    for i in range(n0, n1):
        for t in range(max(0, span[0] - first[i]), min(weights.shape[1], span[1] - first[i])):
            w = weights[i, t]
            if w != 0:
                x = (first[i] + t) & 7
                for y in range(span[2], span[3]):
                    source = forces[slot, x, y & 7, start : start + run]
                    target = tmp[i - n0, y - low[1], at : at + run]
                    for r in range(run):
                        target[r] += w * source[r]


@inlined
def _pass_y(tmp, low, high, first, weights, n0, n1, run, out):
    for i in range(8):
        for j in range(n0, n1):
            target = out[i, j - n0]
            for r in range(run):
                target[r] = 0
            for t in range(max(0, low - first[j]), min(weights.shape[1], high - first[j])):
                w = weights[j, t]
                if w != 0:
                    source = tmp[i, first[j] + t - low]
                    for r in range(run):
                        target[r] += w * source[r]


@inlined
def _pass_z(tmp, rows, columns, low, high, first, weights, n0, n1, n, out):
    held = False
    for i in range(rows):
        for j in range(columns):
            line = tmp[i, j]
            for k in range(n0, n1):
                a = np.float32(0)
                b = np.float32(0)
                c = np.float32(0)
                for t in range(max(0, low - first[k]), min(weights.shape[1], high - first[k])):
                    w = weights[k, t]
                    force = line[first[k] + t - low]
                    a += w * force[0]
                    b += w * force[1]
                    c += w * force[2]
                target = out[n, i, j, k - n0]
                target[0], target[1], target[2] = a, b, c
                held |= a != 0 or b != 0 or c != 0
    return held


@inlined
def _cleared(tmp):
    for i in range(tmp.shape[0]):
        for j in range(tmp.shape[1]):
            line = tmp[i, j]
            for k in range(line.shape[0]):
                line[k] = 0


@lean
def _footprint(first, taps, brick, source_count):
    """Target samples of one output brick along one axis, and the source samples that they need."""
    n0 = brick * 8
    n1 = min(n0 + 8, first.shape[0])
    return n0, n1, max(0, first[n0]), min(source_count, first[n1 - 1] + taps)


@entry
def _resampled(begin, end, source, x, y, z, scratch, out, held):
    """Make output bricks; `scratch` holds two passes, the second flat and as vectors, and ranges of samples."""
    bricks, keys, forces, shape = source
    x_first, x_w = x
    y_first, y_w = y
    z_first, z_w = z
    tmp, tmp2, tmp2_vectors, low, span = scratch
    bricks_y, bricks_z = (shape[1] + 7) >> 3, (shape[2] + 7) >> 3
    for n in range(begin, end):
        i0, i1, low[0], high_x = _footprint(x_first, x_w.shape[1], bricks[n, 0], shape[0])
        j0, j1, low[1], high_y = _footprint(y_first, y_w.shape[1], bricks[n, 1], shape[1])
        k0, k1, low[2], high_z = _footprint(z_first, z_w.shape[1], bricks[n, 2], shape[2])
        _cleared(tmp)
        any_source = False
        for a in range(low[0] >> 3, (high_x + 7) >> 3):
            span[0], span[1] = max(low[0], a * 8), min(high_x, a * 8 + 8)
            for b in range(low[1] >> 3, (high_y + 7) >> 3):
                span[2], span[3] = max(low[1], b * 8), min(high_y, b * 8 + 8)
                row = (a * bricks_y + b) * bricks_z
                slot = first_at_least(keys, row + (low[2] >> 3))
                last = row + ((high_z - 1) >> 3)
                while slot < keys.shape[0] and keys[slot] <= last:
                    c = keys[slot] - row
                    span[4], span[5] = max(low[2], c * 8), min(high_z, c * 8 + 8)
                    _pass_x(forces, slot, span, low, x_first, x_w, i0, i1, tmp)
                    any_source = True
                    slot += 1
        if any_source:
            _pass_y(tmp, low[1], high_y, y_first, y_w, j0, j1, (high_z - low[2]) * 3, tmp2)
            held[n] = _pass_z(tmp2_vectors, i1 - i0, j1 - j0, low[2], high_z, z_first, z_w, k0, k1, n, out)


def resampled(
    bricks: Int32s,
    source_shape: tuple[int, int, int],
    keys: Int64s,
    forces_n: Float32s,
    weights: Sequence[tuple[Int64s, Float32s]],
) -> tuple[Float32s, Bools]:
    """The forces of output bricks int32 [n, 3], float32 [n, 8, 8, 8, 3], and which of them hold one, bool [n].

    source_shape : (int, int, int); samples of the input grid.
    keys, forces_n : int64 [m], float32 [m, 8, 8, 8, 3]; the input bricks, ascending.
    weights : `AxisWeights` of each axis.
    """
    across, deep = (_widest(*weights[axis], source_shape[axis]) for axis in (1, 2))
    x, y, z = (tuple(axis) for axis in weights)
    out = zero_forces(len(bricks))
    held = np.zeros(len(bricks), np.bool_)
    source = bricks, keys, forces_n.reshape(len(forces_n), 8, 8, 24), np.array(source_shape)

    def piece(begin: int, end: int) -> None:
        vectors = np.zeros((8, 8, deep, 3), np.float32)
        passes = np.zeros((8, across, 3 * deep), np.float32), vectors.reshape(8, 8, -1), vectors
        _resampled(begin, end, source, x, y, z, (*passes, np.zeros(3, np.int64), np.zeros(6, np.int64)), out, held)

    for_chunks(piece, len(bricks), chunk=16)
    return out, held


def _widest(first: Int64s, weights: Float32s, source_count: int) -> int:
    """The most source samples that an output brick needs along one axis."""
    last = first[np.minimum(np.arange(7, len(first) + 7, 8), len(first) - 1)]
    return min(source_count, int((last + weights.shape[1] - first[::8]).max()))
