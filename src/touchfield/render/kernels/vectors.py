"""Compiled arithmetic of vectors of three numbers (dot and cross product, sum), stored as tuples or in the
memory that player and servo share."""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.coder_jit import uncounted

_1, _2 = np.uint64(1), np.uint64(2)


@uncounted(forceinline=True)
def three(f8, at):
    """Those at word `at` and behind it."""
    at = np.uint64(at)
    return f8[at], f8[at + _1], f8[at + _2]


@uncounted(forceinline=True)
def put(f8, at, v):
    """Write them at word `at`."""
    f8[at], f8[at + 1], f8[at + 2] = v


@uncounted(forceinline=True)
def dot(a, b):
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@uncounted(forceinline=True)
def along(a, share, b):
    """a + share b."""
    return a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2]


@uncounted(forceinline=True)
def plus(a, b):
    """a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@uncounted(forceinline=True)
def less(a, b):
    """a - b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@uncounted(forceinline=True)
def cross(a, b):
    """a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@uncounted(forceinline=True)
def times(share, a):
    """share a."""
    return share * a[0], share * a[1], share * a[2]


@uncounted(forceinline=True)
def turned(r, v):
    """R v."""
    return dot(r[0], v), dot(r[1], v), dot(r[2], v)


@uncounted(forceinline=True)
def turned_back(r, v):
    """R^T v."""
    return along(along(times(v[0], r[0]), v[1], r[1]), v[2], r[2])


@uncounted(forceinline=True)
def rows_of(f8, at):
    """A matrix, row by row."""
    return three(f8, at), three(f8, at + 3), three(f8, at + 6)


@uncounted(forceinline=True)
def matrix_of(w, v):
    """R of a quaternion of any length, in three rows; of zero the identity."""
    x, y, z = v
    square = w * w + x * x + y * y + z * z
    s = 2.0 / square if square > 0.0 else 0.0
    xx, yy, zz, xy, xz, yz = s * x * x, s * y * y, s * z * z, s * x * y, s * x * z, s * y * z
    wx, wy, wz = s * w * x, s * w * y, s * w * z
    return (
        (1.0 - yy - zz, xy - wz, xz + wy),
        (xy + wz, 1.0 - xx - zz, yz - wx),
        (xz - wy, yz + wx, 1.0 - xx - yy),
    )


@uncounted(forceinline=True)
def length(v):
    """|v|, also where the squares are beyond float64."""
    most = max(abs(v[0]), abs(v[1]), abs(v[2]))
    if most == 0.0:
        return 0.0
    x, y, z = v[0] / most, v[1] / most, v[2] / most
    return most * math.sqrt(x * x + y * y + z * z)


@uncounted(forceinline=True)
def is_finite(v):
    """True if all three numbers are."""
    return math.isfinite(v[0]) and math.isfinite(v[1]) and math.isfinite(v[2])
