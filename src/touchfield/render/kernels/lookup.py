"""Compiled: one field of the block at a point of its own frame (layout: `frame_block`).

A coordinate that is not finite, or out of all bounds, fails the test of the field's box and gives zero.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.lean import UNCOUNTED
from touchfield.medium.kernels.cell import CELLS, GOLDEN, XY, XYZ, XZ, YZ, X, Y, Z
from touchfield.render.frame_block import (
    FIELD_BOX,
    FIELD_CELLS,
    FIELD_CORNER,
    FIELD_HELD,
    FIELD_INVERSE,
    FIELD_SHIFT,
    FIELD_TABLE,
)

__all__ = ["NONE", "ON_PLANE", "locate", "on_axis", "slopes", "slot_of"]

NONE = np.uint64(0xFFFFFFFFFFFFFFFF)
"""The corner of a cell that is zero."""

ON_PLANE = 1e-9
"""Samples: a point so near to a plane of the lattice lies on it, whatever the rounding of its metres says."""

_1, _2 = np.uint64(1), np.uint64(2)

_BX, _BY, _BZ = np.uint64(FIELD_BOX), np.uint64(FIELD_BOX + 1), np.uint64(FIELD_BOX + 2)
_CX, _CY, _CZ = np.uint64(FIELD_CORNER), np.uint64(FIELD_CORNER + 1), np.uint64(FIELD_CORNER + 2)
_IX, _IY, _IZ = np.uint64(FIELD_INVERSE), np.uint64(FIELD_INVERSE + 1), np.uint64(FIELD_INVERSE + 2)


@njit(**UNCOUNTED, forceinline=True)
def on_axis(x):
    """Which cell along one axis, and how far into it; x is not negative."""
    i = np.int64(x + ON_PLANE)
    f = x - i
    return i, (f if f > ON_PLANE else 0.0)


@njit(**UNCOUNTED, forceinline=True)
def slot_of(i8, table, shift, key):
    """The slot of a brick of cells, -1 where there is none; the table begins at word `table`."""
    mask = (_1 << np.uint64(64 - shift)) - _1
    h = (np.uint64(key) * GOLDEN) >> np.uint64(shift)
    while True:
        at = np.uint64(table) + h + h
        found = i8[at]
        if found == key:
            return i8[at + _1]
        if found < 0:
            return np.int64(-1)
        h = (h + _1) & mask


@njit(**UNCOUNTED, forceinline=True)
def corner_of(i8, u8, field, i, j, k):
    """Where in `f4` the first corner of cell (i, j, k) of the box lies; `NONE` where all its corners are zero."""
    at = np.uint64(field)
    key = ((i >> 3) * i8[at + _BY] + (j >> 3)) * i8[at + _BZ] + (k >> 3)
    slot = slot_of(i8, field + i8[at + np.uint64(FIELD_TABLE)], i8[at + np.uint64(FIELD_SHIFT)], key)
    if slot < 0:
        return NONE
    row = u8[np.uint64(field + i8[at + np.uint64(FIELD_HELD)] + 8 * slot + (i & 7))]
    if not (row >> np.uint64(8 * (j & 7) + (k & 7))) & _1:
        return NONE
    first = 2 * (field + i8[at + np.uint64(FIELD_CELLS)])
    return np.uint64(first + slot * CELLS + (i & 7) * 243 + (j & 7) * 27 + (k & 7) * 3)


@njit(**UNCOUNTED, forceinline=True)
def locate(i8, u8, f8, field, x, y, z):
    """Corner in `f4` (`NONE`: zero there) of a point of the field's own frame, metres, and its place in the cell."""
    at = np.uint64(field)
    x = (x - f8[at + _CX]) * f8[at + _IX]
    y = (y - f8[at + _CY]) * f8[at + _IY]
    z = (z - f8[at + _CZ]) * f8[at + _IZ]
    near = 2 * ON_PLANE  # the outermost planes of a box hold no force
    is_inside = 0.0 <= x < 8.0 * i8[at + _BX] - near
    is_inside = is_inside and 0.0 <= y < 8.0 * i8[at + _BY] - near
    is_inside = is_inside and 0.0 <= z < 8.0 * i8[at + _BZ] - near
    if not is_inside:
        return NONE, 0.0, 0.0, 0.0
    i, fx = on_axis(x)
    j, fy = on_axis(y)
    k, fz = on_axis(z)
    return corner_of(i8, u8, field, i, j, k), fx, fy, fz


@njit(**UNCOUNTED, forceinline=True)
def slopes(f4, o, fx, fy, fz):
    """Derivatives of `between` along x, y and z, for one sample."""
    a0, b0 = np.float64(f4[o]), np.float64(f4[o + Y])
    c0, d0 = np.float64(f4[o + X]), np.float64(f4[o + XY])
    az, bz = np.float64(f4[o + Z]) - a0, np.float64(f4[o + YZ]) - b0
    cz, dz = np.float64(f4[o + XZ]) - c0, np.float64(f4[o + XYZ]) - d0
    a, b, c, d = a0 + fz * az, b0 + fz * bz, c0 + fz * cz, d0 + fz * dz
    low, high = az + fy * (bz - az), cz + fy * (dz - cz)
    return c + fy * (d - c) - (a + fy * (b - a)), (b - a) + fx * ((d - c) - (b - a)), low + fx * (high - low)
