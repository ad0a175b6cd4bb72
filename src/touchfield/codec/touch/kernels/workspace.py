"""Room of a pass: what a frame is walked by, the law it follows, and the window over it in scan order.

A frame is kept in the coordinates of its scan: axis 0 is the slowest, and the scan runs along each axis the
way the force points, so from deep to shallow; components are turned alike. A cell has eight numbers: the
vector, its length (0: no force), the length that the force law makes likely one step on along each axis, and
the sizes of its residual. A cell of the reference has four: the vector and its length. The window holds 12
cells an axis, the brick's own from `LOW` on, so that all that predicts a voxel is found at fixed distances,
also across the brick's faces; what is not known yet has length 0.

The geometry of residuals is of whole numbers only, the same on every machine. A residual (r0, r1, r2) is a
step along the prediction, in a warped amplitude, and two across it. Vectors have 18 bits and a sign, their
squares 37; no intermediate reaches 2^53, so that doubles of JavaScript hold them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchfield.arrays import Int32s, Int64s
from touchfield.compute.coder_jit import entry, inlined, lean

FEATURES = 13  # differences of neighbours that the blend is made of
# sets of weights of the blend: which neighbours across a face hold a force, and whether the reference does
CLASSES = 16
ALTERNATIVES = (
    4  # other predictions, of which the contexts of a residual know how far they lie from its centre
)
_CELLS = 12**3

EXPECTED, BLEND, BASE, LAST, OTHER, APART, CENTRE, AXES, STEPS, VECTOR, SIDES, FEATURE = (
    0, 1, 2, 3, 4, 5, 6, 7, 10, 11, 12, 12 + ALTERNATIVES,
)  # fmt: skip
ROWS = FEATURE + FEATURES
"""Rows of a workspace, three whole numbers each, units: the two opinions; what the weights correct; the
vector decoded last; room for another one; from what is taken to the other opinion; what the residual is
about; its three axes, 1/16384; the residual, and the vector that it makes; classes of the distances of other
predictions from the centre along the axes; and the features of the blend, 1/256 steps."""


class Scan(NamedTuple):
    """Bricks of a frame in the order and the coordinates of its scan."""

    near: Int64s  # [n, 13]; slots of the bricks around that come before, -1 for none
    # [n, 27]; slots of the reference's bricks here and around, -1 for none; [0, 27] without a reference
    around: Int64s
    low: Int64s  # low, high: [n, 3]; samples within the grid, from low to below high
    high: Int64s
    reference: Int32s  # [m, 512, 4]; cells of the reference, units
    cells: Int32s  # [n, 512, 8]; takes what is decoded, as said above


class Law(NamedTuple):
    """The force law of a frame, and its lattice."""

    # [3]; units that the length loses in a step along each axis of the scan where the force points along it
    slope: Int64s
    floor: int  # floor, rate, cross_floor, cross_rate: see `touchfield.codec.touch.lattice.Lattice`
    rate: int
    cross_floor: int
    cross_rate: int
    border: Int64s  # the table of warped lengths (`touchfield.codec.touch.lattice.warp_of`)


class Work(NamedTuple):
    """Room to work in, and the weights of the blend."""

    window: Int32s  # [12 * 12 * 12 * 8]
    old: Int32s  # [12 * 12 * 12 * 4]; the window's cells of the reference
    weights: Int64s  # [CLASSES, FEATURES]; of the blend, 1/65536; kept from frame to frame of a segment
    rows: Int64s  # [ROWS, 3]; vectors, by the names above
    of: Int64s  # [16]; numbers, by the names in `residual` and `predict`


def fresh_work(weights: Int64s) -> Work:
    """Room for a pass that goes on from these weights, and changes them."""
    cells = np.zeros(_CELLS * 8, np.int32), np.zeros(_CELLS * 4, np.int32)
    return Work(*cells, weights, np.zeros((ROWS, 3), np.int64), np.zeros(16, np.int64))


SIDE, LOW = 12, 2
DEEP, UP, LEFT = SIDE * SIDE, SIDE, 1  # distances of the voxels before, along the three axes of the scan
WIDTH = 8
LENGTH, AHEAD, SIZES = (
    3,
    4,
    7,
)  # places in a cell: the length, the three lengths ahead, the sizes of the residual


@lean
def root(n):
    """floor(sqrt(n)) of 0 <= n < 2^52: the root of IEEE 754 is rounded to the nearest, never up to a whole
    number.
    """
    return np.int64(np.sqrt(np.float64(n)))


@lean
def length_of(v0, v1, v2):
    """|v| in whole units, at least 1."""
    return max(root(v0 * v0 + v1 * v1 + v2 * v2), np.int64(1))


@lean
def store(window, at, vector, a, sizes, slope):
    """Fill a cell: moving along the force by a sample a penalty field loses `slope` of its length."""
    c, inverse = at * WIDTH, (np.int64(1) << 28) // a
    for k in range(3):
        window[c + k] = vector[k]
        window[c + AHEAD + k] = a - ((((vector[k] * inverse) >> 14) * slope[k]) >> 14)
    window[c + LENGTH], window[c + SIZES] = a, sizes


@inlined
def load(window, width, cells, around, n, back):
    """Brick n and what is around it, `back` cells deep before it and one behind; a cell has `width` numbers.

    `around` are the slots of the bricks in `cells`, in raster order up to some place, below 0 for none.
    """
    for at in range(_CELLS):
        window[at * width + LENGTH] = 0
    for s in range(around.shape[1]):
        dx, dy, dz, slot = s // 9 - 1, s // 3 % 3 - 1, s % 3 - 1, around[n, s]
        if slot < 0:
            continue
        for x in range(8 - back if dx < 0 else 0, 1 if dx > 0 else 8):
            for y in range(8 - back if dy < 0 else 0, 1 if dy > 0 else 8):
                for z in range(8 - back if dz < 0 else 0, 1 if dz > 0 else 8):
                    to = (((x + 8 * dx + LOW) * SIDE + y + 8 * dy + LOW) * SIDE + z + 8 * dz + LOW) * width
                    for q in range(width):
                        window[to + q] = cells[slot, (x * 8 + y) * 8 + z, q]


@lean
def keep(window, cells, n):
    """The brick's own cells that hold a force out of the window; the others are zero."""
    for at in range(512):
        c = (((at >> 6) + LOW) * SIDE + (at >> 3 & 7) + LOW) * SIDE + (at & 7) + LOW
        if window[c * WIDTH + LENGTH] > 0:
            for q in range(WIDTH):
                cells[n, at, q] = window[c * WIDTH + q]


@lean
def copy_reference(window, old, slope):
    """The brick as the reference has it."""
    for n in range(512):
        at = (((n >> 6) + LOW) * SIDE + (n >> 3 & 7) + LOW) * SIDE + (n & 7) + LOW
        a = np.int64(old[at * 4 + 3])
        if a > 0:
            vector = np.int64(old[at * 4]), np.int64(old[at * 4 + 1]), np.int64(old[at * 4 + 2])
            store(window, at, vector, a, np.int64(0), slope)


LIMIT = (1 << 17) - 1  # no component of a decoded vector is beyond it, units


@lean
def bounded(value, most):
    """The number nearest to a value from -`most` to `most`."""
    return min(max(value, -most), most)


@lean
def level_of(a, border):
    """The warped amplitude of `a` units (0 <= a < 2^18), in 1/256 steps."""
    x = np.int64(a) << 8
    low, high = np.int64(0), np.int64(border.shape[0] - 1)
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
def axes_along(rows, length):
    """Three unit vectors, 1/16384, along the row `CENTRE` of a length >= 1 and across, into rows from `AXES`
    on.
    """
    e, h = rows[AXES], rows[AXES + 1]
    inverse = (np.int64(1) << 44) // length
    for k in range(3):
        e[k] = (rows[CENTRE, k] * inverse + (1 << 29)) >> 30
    if abs(e[2]) < 14746:
        h[0], h[1], h[2] = -e[1], e[0], 0
    else:
        h[0], h[1], h[2] = 0, -e[2], e[1]
    inverse = (np.int64(1) << 44) // max(np.int64(1), root(h[0] * h[0] + h[1] * h[1] + h[2] * h[2]))
    for k in range(3):
        h[k] = (h[k] * inverse + (1 << 29)) >> 30
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        rows[AXES + 2, k] = (e[i] * h[j] - e[j] * h[i]) >> 14


@lean
def rebuild(along, s1, s2, rows):
    """The row `VECTOR` = along e + s1 h + s2 k in units, rounded, each component kept within `LIMIT`."""
    for c in range(3):
        x = along * rows[AXES, c] + s1 * rows[AXES + 1, c] + s2 * rows[AXES + 2, c]
        rows[VECTOR, c] = bounded((x + 8192) >> 14, np.int64(LIMIT))


@entry
def turned(vectors, slots, axes, down, scale, out):
    """``out[slots[n]]`` is brick n of the grid in a scan, or back, times `scale`; `axes` and `down` tell the
    way.
    """
    for n in range(slots.shape[0]):
        for at in range(512):
            place = 0
            for i in range(3):
                c = at >> 6 - 3 * i & 7
                place += (7 - c if down[i] else c) << 6 - 3 * axes[i]
            for i in range(3):
                v = vectors[n, at, i] * scale
                out[slots[n], place, axes[i]] = -v if down[i] else v
