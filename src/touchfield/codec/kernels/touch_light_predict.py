"""What the light models of coder `touch` expect at a voxel, from the neighbours decoded before it."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.touch_lattice import LIMIT
from touchfield.codec.kernels.touch_light_cells import held
from touchfield.codec.kernels.touch_light_coder import lean

__all__ = [
    "CLASSES",
    "FEATURES",
    "FITTED",
    "FLOOR",
    "LEAST",
    "MIX",
    "RATE",
    "SATURATED",
    "USUAL",
    "gather",
    "predict",
]

FEATURES = 13
CLASSES = 16
"""Which of the neighbours at (-1, 0, 0), (0, -1, 0), (0, 0, -1) and of the reference are there."""

SATURATED = (1 << 16) - (1 << 10)
"""An amplitude from here on is at the top: it tells nothing of the law."""

LEAST, USUAL, MIX, FITTED, FLOOR, RATE = 6, 7, 8, 9, 10, 11
"""Places in the law, int64 [12], behind the slopes and components of the axes: the least amplitude that is
followed, units; the way of the frame; how much of the blend is in it, 1/64; whether there are weights; and floor and
rate of the lattice."""


@lean
def _value(cells, at, w, sums):
    """Add the weighted vector of a cell, zeros where it holds none, and the weight where it does."""
    c = np.uint64(at * 8)
    if cells[c + np.uint64(3)] == 0:
        w = np.int64(0)
    return (
        sums[0] + w * cells[c],
        sums[1] + w * cells[c + np.uint64(1)],
        sums[2] + w * cells[c + np.uint64(2)],
        sums[3] + w,
    )


@lean
def _change(cells, at, other, w, sums):
    """Add the weighted difference of two cells, nothing where one holds none."""
    c = np.uint64(at * 8)
    b = np.uint64(other * 8)
    w *= np.int64(cells[c + np.uint64(3)] > 0) & np.int64(cells[b + np.uint64(3)] > 0)
    return (
        sums[0] + w * (cells[c] - cells[b]),
        sums[1] + w * (cells[c + np.uint64(1)] - cells[b + np.uint64(1)]),
        sums[2] + w * (cells[c + np.uint64(2)] - cells[b + np.uint64(2)]),
        sums[3],
    )


@lean
def _since(cells, old, at, sums):
    """Add how a cell differs from the reference, nothing where one holds none, and the count of those."""
    c = np.uint64(at * 8)
    b = np.uint64(at * 4)
    held = np.int64(cells[c + np.uint64(3)] > 0) & np.int64(old[b + np.uint64(3)] > 0)
    return (
        sums[0] + held * (cells[c] - old[b]),
        sums[1] + held * (cells[c + np.uint64(1)] - old[b + np.uint64(1)]),
        sums[2] + held * (cells[c + np.uint64(2)] - old[b + np.uint64(2)]),
        sums[3] + held,
    )


@lean
def _edge(cells, old, here, up, deep, deep_up, deep_down, last):
    """What to begin with where no neighbour across a face is there."""
    r = np.uint64(here * 4)
    if old[r + np.uint64(3)] > 0:
        return np.int64(old[r]), np.int64(old[r + np.uint64(1)]), np.int64(old[r + np.uint64(2)])
    for at in (deep_up, deep_down, deep + 1, deep - 1, up + 1, up - 1):
        c = np.uint64(at * 8)
        if cells[c + np.uint64(3)] > 0:
            return np.int64(cells[c]), np.int64(cells[c + np.uint64(1)]), np.int64(cells[c + np.uint64(2)])
    return last[0], last[1], last[2]


@lean
def _at_top(cells, first, axis_1, second, axis_2, a):
    """What neighbours make of a sample beside one at the top of amplitude `a`: it stays, or comes down by theirs."""
    count = total = np.int64(0)
    for n in range(2):
        at = np.uint64((first if n == 0 else second) * 8)
        b = np.int64(cells[at + np.uint64(3)])
        if b > 0:
            count += 1
            ahead = np.int64(cells[at + np.uint64(5 + (axis_1 if n == 0 else axis_2))])
            total += b if b >= SATURATED else ahead
    return total // count if count > 0 and total < count * (SATURATED - 1024) else a


@lean
def _off(cells, old, at, law):
    """Whether the reference is more than a step off at a cell."""
    c = np.uint64(at * 8)
    r = np.uint64(at * 4)
    a = np.int64(cells[c + np.uint64(3)])
    if a == 0 or old[r + np.uint64(3)] == 0:
        return False
    square = np.int64(0)
    for k in range(3):
        square += (np.int64(cells[c + np.uint64(k)]) - np.int64(old[r + np.uint64(k)])) ** 2
    step = max(law[FLOOR], (a * law[RATE]) >> 16)
    return square > step * step


@lean
def _follow(cells, old, here, up, deep, way, law, out):
    """What the law makes of one neighbour, or the reference as it is; False where nothing is to follow."""
    if way == 0:
        r = np.uint64(here * 4)
        if old[r + np.uint64(3)] > 0 and not _off(cells, old, deep, law):
            for k in range(3):
                out[k] = out[3 + k] = np.int64(old[r + np.uint64(k)])
            out[7] = -1
            return True
        way = law[USUAL]
    axis = way - 1
    at = deep if axis == 0 else (up if axis == 1 else here - 1)
    if held(cells, at) == 0:
        axis = np.int64(0)
        at = deep
        if held(cells, at) == 0:
            axis = np.int64(1)
            at = up
        if held(cells, at) == 0:
            axis = np.int64(2)
            at = here - 1
        if held(cells, at) == 0:
            return False
    c = np.uint64(at * 8)
    a = np.int64(cells[c + np.uint64(3)])
    if a < SATURATED:
        length = np.int64(cells[c + np.uint64(5 + axis)])
    elif axis == 0:
        length = _at_top(cells, up, 1, here - 1, 2, a)
    elif axis == 1:
        length = _at_top(cells, deep, 0, here - 1, 2, a)
    else:
        length = _at_top(cells, deep, 0, up, 1, a)
    length = max(length, a >> 3, law[LEAST])
    ratio = np.int64(16384)
    if length != a:
        ratio = min((length << 14) // a, np.int64(1) << 17)
    for k in range(3):
        v = (np.int64(cells[c + np.uint64(k)]) * ratio + 8192) >> 14
        out[k] = out[3 + k] = min(max(v, -LIMIT), LIMIT)
    out[7] = at
    return True


@lean
def predict(cells, old, here, up, deep, deep_up, deep_down, deeper, last, weights, way, law, out):
    """The expected vector: from one neighbour, from the blend of all, or from both.

    Parameters
    ----------
    cells, old : int32
        Cells of this frame (8 numbers each) and of the reference (4 each: vector and size).
    here, up, deep, deep_up, deep_down, deeper : int
        Cells of the voxel itself and of its neighbours (0, -1, 0), (-1, 0, 0), (-1, -1, 0), (-1, 1, 0), (-2, 0, 0).
    last : int64 [3]
        The vector decoded last.
    weights : int64 [16 * 13]
        1/64.
    way : int
        0 the reference, 1 to 3 along that axis of the scan, -1 the blend alone.
    law : int64 [12]
    out : int64 [16]
        Takes the expected vector, the one that the blend corrects, the class, the cell that is followed or -1, the
        blend, and whether anything, be it the reference, was followed.
    """
    c0 = c1 = c2 = np.int64(0)
    mix = np.int64(64)
    if way >= 0 and _follow(cells, old, here, up, deep, way, law, out):
        mix = law[MIX] if out[7] >= 0 else np.int64(0)
        c0, c1, c2 = out[0], out[1], out[2]
    else:
        out[7] = -1
    none = (np.int64(0), np.int64(0), np.int64(0), np.int64(0))
    one = np.int64(1)
    face = _value(cells, here - 1, one, _value(cells, up, one, _value(cells, deep, one, none)))
    kind = held(cells, deep) | held(cells, up) << 1 | held(cells, here - 1) << 2
    in_r = np.int64(old[np.uint64(here * 4 + 3)] > 0)
    if kind:
        total = ahead = np.int64(0)
        for way, at in ((0, deep), (1, up), (2, here - 1)):
            a = np.int64(cells[np.uint64(at * 8 + 3)])
            total += a
            ahead += max(np.int64(cells[np.uint64(at * 8 + 5 + way)]), a >> 3)  # 0 where nothing is
        scale = min(np.int64((np.uint64(ahead) << np.uint64(16)) // np.uint64(total * face[3])), np.int64(1 << 18))
        base = ((face[0] * scale + 32768) >> 16, (face[1] * scale + 32768) >> 16, (face[2] * scale + 32768) >> 16)
    else:
        base = _edge(cells, old, here, up, deep, deep_up, deep_down, last)
    if law[FITTED] == 0:
        out[0] = min(max(base[0], -LIMIT), LIMIT)  # a blend may be longer than any force
        out[1] = min(max(base[1], -LIMIT), LIMIT)
        out[2] = min(max(base[2], -LIMIT), LIMIT)
        out[3], out[4], out[5] = base
        out[8], out[9], out[10], out[11] = out[0], out[1], out[2], np.int64(mix < 64)
        if mix < 64:
            out[0] = c0 + (((out[0] - c0) * mix) >> 6)
            out[1] = c1 + (((out[1] - c1) * mix) >> 6)
            out[2] = c2 + (((out[2] - c2) * mix) >> 6)
        out[3], out[4], out[5] = base
        return
    kind |= in_r << 3
    w = np.uint64(kind * 13)
    sums = (np.int64(32), np.int64(32), np.int64(32), np.int64(0))
    sums = _value(cells, deep, weights[w], sums)
    sums = _value(cells, up, weights[w + np.uint64(1)], sums)
    sums = _value(cells, here - 1, weights[w + np.uint64(2)], sums)
    sums = _value(cells, deep_down, weights[w + np.uint64(3)], sums)
    sums = _value(cells, deep + 1, weights[w + np.uint64(4)], sums)
    sums = _value(cells, up + 1, weights[w + np.uint64(5)], sums)
    sums = _change(cells, deep, deeper, weights[w + np.uint64(6)], sums)
    sums = _change(cells, up, deep_up, weights[w + np.uint64(7)], sums)
    sums = _change(cells, here - 1, deep - 1, weights[w + np.uint64(8)], sums)
    sums = _change(cells, here - 1, up - 1, weights[w + np.uint64(9)], sums)
    sums = _change(cells, up, up - 1, weights[w + np.uint64(10)], sums)
    s0, s1, s2, s3 = sums
    if in_r:
        v = weights[w + np.uint64(11)]
        r = np.uint64(here * 4)
        s0 += v * old[r]
        s1 += v * old[r + np.uint64(1)]
        s2 += v * old[r + np.uint64(2)]
        s3 += v
        moved = _since(cells, old, here - 1, _since(cells, old, up, _since(cells, old, deep, none)))
        if moved[3] > 0:
            share = weights[w + np.uint64(12)] * (np.int64(64) // moved[3])
            s0 += (moved[0] * share) >> 6
            s1 += (moved[1] * share) >> 6
            s2 += (moved[2] * share) >> 6
    out[0] = min(max(base[0] + ((s0 - s3 * base[0]) >> 6), -LIMIT), LIMIT)
    out[1] = min(max(base[1] + ((s1 - s3 * base[1]) >> 6), -LIMIT), LIMIT)
    out[2] = min(max(base[2] + ((s2 - s3 * base[2]) >> 6), -LIMIT), LIMIT)
    out[3], out[4], out[5] = base
    out[8], out[9], out[10], out[11] = out[0], out[1], out[2], np.int64(mix < 64)
    out[6] = kind
    if mix < 64:
        out[0] = c0 + (((out[0] - c0) * mix) >> 6)
        out[1] = c1 + (((out[1] - c1) * mix) >> 6)
        out[2] = c2 + (((out[2] - c2) * mix) >> 6)


@lean
def gather(cells, old, here, up, deep, deep_up, deep_down, deeper, last, probes, f, step, sums, out, feature, law):
    """Add a voxel to the normal equations of its class; `probes` [13, 16 * 13] sets each weight to one in turn."""
    for n in range(FEATURES):
        predict(cells, old, here, up, deep, deep_up, deep_down, deeper, last, probes[n], np.int64(-1), law, out)
        for c in range(3):
            feature[n, c] = (out[c] - out[3 + c]) / step
    kind = out[6]
    for c in range(3):
        target = (f[c] - out[3 + c]) / step
        for n in range(FEATURES):
            if feature[n, c] != 0:
                for m in range(n + 1):
                    sums[kind, n, m] += feature[n, c] * feature[m, c]
                sums[kind, FEATURES, n] += feature[n, c] * target
    for n in range(FEATURES):
        if feature[n, 0] != 0 or feature[n, 1] != 0 or feature[n, 2] != 0:
            sums[kind, n, FEATURES] += 1
    sums[kind, FEATURES, FEATURES] += 1
