"""Cells, the working storage of the quick model of coder `touch`, and the geometry between them.

A cell is eight numbers: the direction of the force, 1/65536, its amplitude, units, the sizes of its residual, and
what the amplitude is likely to lose in a step along each axis of the scan (``slope * F_c / |F|``). What is held
decides a plane of bytes: 0 nothing, `HELD`, or `RAW`: the vector itself in place of the direction. So a force that is
followed without a residual takes no division, no root and no product but those of its vector.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.codec.kernels.touch_lattice import LIMIT, root
from touchfield.codec.kernels.touch_quick_coder import quick

__all__ = ["HELD", "RAW", "across_axes", "direction_of", "level_at", "losses", "moved", "ready", "scaled"]

HELD, RAW = 1, 2

_INVERSE = np.array([(1 << 32) // max(1, math.isqrt((2 * n + 1) << 21)) for n in range(1024)], np.int64)
"""2^32 over the root of what lies in the middle of each 1024th of 2^32."""

_BUCKET = 5


@quick
def scaled(u, a):
    """A component of a vector: direction by amplitude."""
    return min(max((u * a + 32768) >> 16, -LIMIT), LIMIT)


@quick
def direction_of(v0, v1, v2):
    """Direction and amplitude of a vector that is not zero."""
    a = max(np.int64(1), root(v0 * v0 + v1 * v1 + v2 * v2))
    inverse = (np.int64(1) << 34) // a
    return (
        (v0 * inverse + (1 << 17)) >> 18, (v1 * inverse + (1 << 17)) >> 18, (v2 * inverse + (1 << 17)) >> 18, a,
    )  # fmt: skip


@quick
def losses(u0, u1, u2, law):
    """What the amplitude loses along each axis of the scan."""
    s0 = u0 if law[3] == 0 else (u1 if law[3] == 1 else u2)
    s1 = u0 if law[4] == 0 else (u1 if law[4] == 1 else u2)
    s2 = u0 if law[5] == 0 else (u1 if law[5] == 1 else u2)
    return (s0 * law[0]) >> 16, (s1 * law[1]) >> 16, (s2 * law[2]) >> 16


@quick
def ready(at, there, cells, law):
    """Make a raw cell one like the others."""
    if there[np.uint64(at)] == RAW:
        c = np.uint64(at * 8)
        u0, u1, u2, a = direction_of(
            np.int64(cells[c]), np.int64(cells[c + np.uint64(1)]), np.int64(cells[c + np.uint64(2)])
        )
        l0, l1, l2 = losses(u0, u1, u2, law)
        cells[c], cells[c + np.uint64(1)], cells[c + np.uint64(2)], cells[c + np.uint64(3)] = u0, u1, u2, a
        cells[c + np.uint64(4)] = 0
        cells[c + np.uint64(5)], cells[c + np.uint64(6)], cells[c + np.uint64(7)] = l0, l1, l2
        there[np.uint64(at)] = HELD


@quick
def level_at(a, border, first):
    """The last border not above `a` units, 0 <= a < 2^18."""
    x = a << 8
    low = first[np.uint64(a >> _BUCKET)]
    high = first[np.uint64((a >> _BUCKET) + 1)] + 1
    while high - low > 1:
        middle = (low + high) >> 1
        if border[np.uint64(middle)] <= x:
            low = middle
        else:
            high = middle
    return low


@quick
def moved(a, r, border, first):
    """The amplitude `r` steps from `a`; below zero it is a force the other way."""
    if r == 0:
        return a
    i = level_at(a, border, first)
    j = i + 16 * r
    last = np.int64(border.shape[0] - 1)
    if j < 0:
        return -min(border[np.uint64(min(-j, last))] >> 8, (np.int64(1) << 18) - 1)
    return min((border[np.uint64(min(j, last))] + (a << 8) - border[np.uint64(i)]) >> 8, (np.int64(1) << 18) - 1)


@quick
def across_axes(u0, u1, u2):
    """Two directions across (u0, u1, u2), 1/65536, of length one about."""
    if abs(u2) < 58982:
        h0, h1, h2 = -u1, u0, np.int64(0)
    else:
        h0, h1, h2 = np.int64(0), -u2, u1
    inverse = _INVERSE[np.uint64(min((h0 * h0 + h1 * h1 + h2 * h2) >> 22, 1023))]
    h0, h1, h2 = (h0 * inverse) >> 16, (h1 * inverse) >> 16, (h2 * inverse) >> 16
    return (
        h0, h1, h2, (u1 * h2 - u2 * h1) >> 16, (u2 * h0 - u0 * h2) >> 16, (u0 * h1 - u1 * h0) >> 16,
    )  # fmt: skip
