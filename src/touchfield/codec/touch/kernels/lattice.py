"""Compiled geometry of the coder `touch`: whole numbers only, the same on every machine.

A residual (r0, r1, r2) is a step along the prediction, in a warped amplitude, and two across it. Widths: vectors have
18 bits and a sign, their squares 37; no intermediate reaches 2^53, so that doubles of JavaScript hold them.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.touch.kernels.workspace import AXES, VECTOR
from touchfield.codec.touch.lattice import BUCKET
from touchfield.lean import lean

__all__ = ["LIMIT", "amplitude_of", "axes_along", "level_of", "rebuild", "root", "step_at"]

LIMIT = (1 << 17) - 1
"""No component of a decoded vector is beyond it, units."""


@lean
def root(n):
    """floor(sqrt(n)) of 0 <= n < 2^52, whatever the machine's square root."""
    s = np.int64(np.sqrt(np.float64(n)))
    while s * s > n:
        s -= 1
    while (s + 1) * (s + 1) <= n:
        s += 1
    return s


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
