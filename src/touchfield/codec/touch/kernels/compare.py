"""Compiled comparison of an original with what a decoder makes of it, voxel by voxel of both supports.

Bricks of both fields are merged by their keys; what neither holds is zero in both. All in float64, squares of
float32 sizes, so that nothing overflows or vanishes. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.lean import entry, inlined

MASK, DIRECTION, FREE = 0, 1, 2  # the last: anything goes

_NONE = np.iinfo(np.int64).max


@inlined
def _ratio2(x, y, z, u, v, w, rule, k, f0, sine, angle, hidden):
    """The square of |error| / allowed, of an original (x, y, z) and a decoded (u, v, w)."""
    if rule == FREE:
        return 0.0
    size2 = x * x + y * y + z * z
    error2 = (u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2
    if error2 == 0.0:
        return 0.0
    allowed2 = max(f0 * f0, k * k * size2)
    if hidden > 0.0:
        allowed2 = max(allowed2, (k * math.sqrt(size2) + hidden) ** 2)
    if rule == DIRECTION:
        size = math.sqrt(size2)
        if size * sine > f0:
            radial = abs(math.sqrt(u * u + v * v + w * w) - size) / math.sqrt(allowed2)
            a, b, c = y * w - z * v, z * u - x * w, x * v - y * u
            turn = math.atan2(math.sqrt(a * a + b * b + c * c), x * u + y * v + z * w) / angle
            return max(radial, turn) ** 2
        allowed2 = f0 * f0
    return error2 / allowed2 if allowed2 > 0.0 else np.inf


@entry
def compare(keys, forces, other_keys, other, rule, exact, limits, hidden, found):
    """Compare voxel by voxel; `found`, int64 [2, n], takes the first n that are beyond, of which all are counted.

    `hidden`: what forces around hide, newtons, float32 [bricks of the original, 512], or [0, 512].
    """
    k, f0, sine, angle = limits
    worst, worst_key, worst_place = 0.0, -1, 0
    supported, within, decoded, beyond = 0, 0, 0, 0
    i, j = 0, 0
    while i < keys.shape[0] or j < other_keys.shape[0]:
        mine = keys[i] if i < keys.shape[0] else _NONE
        theirs = other_keys[j] if j < other_keys.shape[0] else _NONE
        key = min(mine, theirs)
        for place in range(512):
            x, y, z, u, v, w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if mine == key:
                x, y, z = 1.0 * forces[i, place, 0], 1.0 * forces[i, place, 1], 1.0 * forces[i, place, 2]
            if theirs == key:
                u, v, w = 1.0 * other[j, place, 0], 1.0 * other[j, place, 1], 1.0 * other[j, place, 2]
            held = x != 0.0 or y != 0.0 or z != 0.0
            sent = u != 0.0 or v != 0.0 or w != 0.0
            if not held and not sent:
                continue
            around = 1.0 * hidden[i, place] if mine == key and hidden.shape[0] else 0.0
            ratio2 = _ratio2(x, y, z, u, v, w, rule, k, f0, sine, angle, around)
            if exact and held != sent:
                ratio2 = np.inf
            supported += held
            decoded += sent
            within += held and ratio2 <= 1.0
            if ratio2 > worst:
                worst, worst_key, worst_place = ratio2, key, place
            if ratio2 > 1.0:
                if beyond < found.shape[1]:
                    found[0, beyond], found[1, beyond] = key, place
                beyond += 1
        i += mine == key
        j += theirs == key
    return beyond, worst, worst_key, worst_place, supported, within, decoded


@entry
def largest(forces):
    """The longest |F| of float32 [n, 3]; infinite where one is not a finite number."""
    most = 0.0
    for i in range(forces.shape[0]):
        x, y, z = np.float64(forces[i, 0]), np.float64(forces[i, 1]), np.float64(forces[i, 2])
        size2 = x * x + y * y + z * z
        if not size2 < np.inf:
            return np.inf
        most = max(most, size2)
    return math.sqrt(most)
