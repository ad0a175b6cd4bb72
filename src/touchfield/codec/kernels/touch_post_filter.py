"""Compiled loops of the post filter of coder `touch`: a force and its 26 neighbours, brick by brick.

A brick is laid out with one sample around it, so that neighbours are reached without asking for their brick. The
filter reads what was decoded and writes elsewhere: bricks may be filtered in any order.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.touch_lattice import LIMIT

__all__ = ["EDGE", "FEATURES", "SHIFT", "filter_bricks", "gather"]

EDGE = 10
"""Samples along the edge of a brick with one more on each side."""

SHIFT = 14
"""A weight of 1 is 2^14."""

FEATURES = 79
"""Clipped difference, difference, and what is outside, of 26 neighbours each; and the force itself."""

_CELLS = EDGE * EDGE * EDGE


@njit(cache=True, nogil=True)
def _lay_out(vectors, links, n, patch):
    """A brick and one sample around it, int32 [1000, 4]: components, and 1 where there is a force, else 0."""
    for i in range(27):
        x0, y0, z0 = i // 9 - 1, i // 3 % 3 - 1, i % 3 - 1
        xa, xb = (7 if x0 < 0 else 0), (1 if x0 > 0 else 8)
        ya, yb = (7 if y0 < 0 else 0), (1 if y0 > 0 else 8)
        za, zb = (7 if z0 < 0 else 0), (1 if z0 > 0 else 8)
        b = links[n, i]
        for x in range(xa, xb):
            for y in range(ya, yb):
                at = ((8 * x0 + x + 1) * EDGE + 8 * y0 + y + 1) * EDGE + 8 * z0 + za + 1
                for z in range(za, zb):
                    if b < 0:
                        patch[at, 0] = patch[at, 1] = patch[at, 2] = patch[at, 3] = 0
                    else:
                        u, v, w = vectors[b, x, y, z, 0], vectors[b, x, y, z, 1], vectors[b, x, y, z, 2]
                        patch[at, 0] = u
                        patch[at, 1] = v
                        patch[at, 2] = w
                        patch[at, 3] = np.int32((u | v | w) != 0)
                    at += 1


@njit(cache=True, nogil=True)
def filter_bricks(begin, end, vectors, links, apart, weights, own, limit, out):
    """Filter bricks `begin` to `end` - 1.

    Parameters
    ----------
    vectors : int32 [n, 8, 8, 8, 3]
        As decoded, units.
    links : int64 [n, 27]
        The brick at each of the places around, x slowest, or -1.
    apart : int64 [m]
        How far the neighbours that have a weight lie from a sample of a patch.
    weights : int64 [m, 3]
        Of the clipped difference, of the difference, and of what is outside, 1/2^14.
    own : int64
        The weight of the force itself.
    limit : int64
        Where differences are clipped, units.
    out : int32 [n, 8, 8, 8, 3]
        Takes the filtered vectors; zeros at first.
    """
    patch = np.empty((_CELLS, 4), np.int32)
    half = 1 << (SHIFT - 1)
    for n in range(begin, end):
        _lay_out(vectors, links, n, patch)
        for x in range(8):
            for y in range(8):
                at = ((x + 1) * EDGE + y + 1) * EDGE
                for z in range(8):
                    at += 1
                    if patch[at, 3] == 0:
                        continue
                    c0, c1, c2 = np.int64(patch[at, 0]), np.int64(patch[at, 1]), np.int64(patch[at, 2])
                    s0, s1, s2 = own * c0 + half, own * c1 + half, own * c2 + half
                    for i in range(apart.shape[0]):
                        q = at + apart[i]
                        if patch[q, 3] != 0:
                            clipped, plain = weights[i, 0], weights[i, 1]
                            d0, d1, d2 = patch[q, 0] - c0, patch[q, 1] - c1, patch[q, 2] - c2
                            s0 += plain * d0 + clipped * min(max(d0, -limit), limit)
                            s1 += plain * d1 + clipped * min(max(d1, -limit), limit)
                            s2 += plain * d2 + clipped * min(max(d2, -limit), limit)
                        else:
                            outside = weights[i, 2]
                            s0 -= outside * c0
                            s1 -= outside * c1
                            s2 -= outside * c2
                    r0 = min(max(c0 + (s0 >> SHIFT), -LIMIT), LIMIT)
                    r1 = min(max(c1 + (s1 >> SHIFT), -LIMIT), LIMIT)
                    r2 = min(max(c2 + (s2 >> SHIFT), -LIMIT), LIMIT)
                    if r0 == 0 and r1 == 0 and r2 == 0:
                        r0, r1, r2 = c0, c1, c2
                    out[n, x, y, z, 0] = r0
                    out[n, x, y, z, 1] = r1
                    out[n, x, y, z, 2] = r2


@njit(cache=True, nogil=True)
def gather(vectors, links, original, places, scale, limit, features, errors):
    """What the filter sees at some samples, and what it should add there.

    Parameters
    ----------
    original : float32 [n, 8, 8, 8, 3]
        Of the same bricks, newtons; `scale` units of a newton.
    places : int64 [k]
        Slots, ascending; with a decoded force each.
    features : float64 [3 k, 79]
    errors : float64 [3 k]

    Both are filled; units.
    """
    patch = np.empty((_CELLS, 4), np.int32)
    last = -1
    for k in range(places.shape[0]):
        n, place = places[k] >> 9, places[k] & 511
        if n != last:
            _lay_out(vectors, links, n, patch)
            last = n
        x, y, z = place >> 6, place >> 3 & 7, place & 7
        at = ((x + 1) * EDGE + y + 1) * EDGE + z + 1
        for c in range(3):
            row = 3 * k + c
            mine = float(patch[at, c])
            errors[row] = float(original[n, x, y, z, c]) * scale - mine
            features[row, 78] = mine
            for i in range(26):
                o = i if i < 13 else i + 1
                q = at + ((o // 9 - 1) * EDGE + o // 3 % 3 - 1) * EDGE + o % 3 - 1
                if patch[q, 3] != 0:
                    d = float(patch[q, c]) - mine
                    features[row, i] = min(max(d, -float(limit)), float(limit))
                    features[row, 26 + i] = d
                    features[row, 52 + i] = 0.0
                else:
                    features[row, i] = features[row, 26 + i] = 0.0
                    features[row, 52 + i] = -mine
