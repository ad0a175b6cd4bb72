"""Compiled geometry of the coder `touch`: whole numbers only, the same on every machine.

A residual (r0, r1, r2) is a step along the prediction, in a warped amplitude, and two across it. Widths: vectors have
18 bits and a sign, their squares 37; no intermediate reaches 2^53, so that doubles of JavaScript hold them.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.touch.kernels.workspace import AXES, VECTOR, root
from touchfield.codec.touch.lattice import BUCKET
from touchfield.lean import entry, lean

LIMIT = (1 << 17) - 1  # no component of a decoded vector is beyond it, units


@lean
def level_of(a, border, first):
    """The warped amplitude of `a` units (0 <= a < 2^18), in 1/256 steps."""
    x = np.int64(a) << 8
    low = first[a >> BUCKET]
    high = first[(a >> BUCKET) + 1] + 1
    while high - low > 1:
        middle = (low + high) >> 1
        if border[middle] <= x:
            low = middle
        else:
            high = middle
    return (low << 4) + ((x - border[low]) << 4) // (border[low + 1] - border[low])


@lean
def amplitude_of(level, border):
    """The amplitude in units of a warped one; odd: a level below zero is a force the other way."""
    size = min(abs(level), ((border.shape[0] - 1) << 4) - 1)
    i = size >> 4
    a = (border[i] + (((border[i + 1] - border[i]) * (size & 15)) >> 4) + 128) >> 8
    return a if level >= 0 else -a


@lean
def step_at(a, floor, rate):
    """The step across a force of `a` units."""
    return max(np.int64(floor), (a * rate) >> 16)


@lean
def axes_along(p0, p1, p2, a, rows):
    """Three unit vectors, 1/16384, along (p0, p1, p2) of length a >= 1 and across, into rows from `AXES` on."""
    inverse = (np.int64(1) << 44) // a
    e0 = (p0 * inverse + (1 << 29)) >> 30
    e1 = (p1 * inverse + (1 << 29)) >> 30
    e2 = (p2 * inverse + (1 << 29)) >> 30
    if abs(e2) < 14746:
        h0, h1, h2 = -e1, e0, np.int64(0)
    else:
        h0, h1, h2 = np.int64(0), -e2, e1
    inverse = (np.int64(1) << 44) // max(np.int64(1), root(h0 * h0 + h1 * h1 + h2 * h2))
    h0 = (h0 * inverse + (1 << 29)) >> 30
    h1 = (h1 * inverse + (1 << 29)) >> 30
    h2 = (h2 * inverse + (1 << 29)) >> 30
    rows[AXES + 0, 0], rows[AXES + 0, 1], rows[AXES + 0, 2] = e0, e1, e2
    rows[AXES + 1, 0], rows[AXES + 1, 1], rows[AXES + 1, 2] = h0, h1, h2
    rows[AXES + 2, 0] = (e1 * h2 - e2 * h1) >> 14
    rows[AXES + 2, 1] = (e2 * h0 - e0 * h2) >> 14
    rows[AXES + 2, 2] = (e0 * h1 - e1 * h0) >> 14


@lean
def rebuild(along, s1, s2, rows):
    """The row `VECTOR` = along e + s1 h + s2 k in units, rounded, each component kept within `LIMIT`."""
    for c in range(3):
        x = (along * rows[AXES, c] + s1 * rows[AXES + 1, c] + s2 * rows[AXES + 2, c] + 8192) >> 14
        rows[VECTOR, c] = min(max(x, -LIMIT), LIMIT)


@lean
def _place_of(x, y, z, axes, down):
    """Sample of the grid that sample (x, y, z) of a scan is."""
    place = 0
    for i in range(3):
        c = x if i == 0 else (y if i == 1 else z)
        if down[i]:
            c = 7 - c
        place += c * (64 >> (3 * axes[i]))
    return place


@entry
def turned(vectors, slots, axes, down, scale, out):
    """``out[n, sample, component]`` in a scan of ``vectors[slots[n]]`` in the grid, times `scale`."""
    for n in range(slots.shape[0]):
        for at in range(512):
            place = _place_of(at >> 6, at >> 3 & 7, at & 7, axes, down)
            for i in range(3):
                v = vectors[slots[n], place, axes[i]] * scale
                out[n, at, i] = -v if down[i] else v


@entry
def turned_back(cells, slots, axes, down, out):
    """Vectors ``out[slots[n]]`` in the grid, of cells of a scan; zeros where a cell holds no force."""
    for n in range(slots.shape[0]):
        for at in range(512):
            place = _place_of(at >> 6, at >> 3 & 7, at & 7, axes, down)
            for i in range(3):
                v = cells[n, at, i] if cells[n, at, 3] > 0 else 0
                out[slots[n], place, axes[i]] = -v if down[i] else v


_BRICK = 512 * 3


@entry
def newtons(vectors, unit_n, forces, held):
    """`forces`, float32, of `vectors`, int32, both flat: a float32 product each; which bricks hold any, bool [n]."""
    for n in range(held.shape[0]):
        any_set = np.int32(0)
        for at in range(n * _BRICK, (n + 1) * _BRICK):
            v = vectors[at]
            any_set |= v
            forces[at] = np.float32(v) * unit_n
        held[n] = any_set != 0
