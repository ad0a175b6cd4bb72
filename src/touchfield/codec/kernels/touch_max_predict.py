"""What effort `max` of the coder `touch` predicts a force from; whole numbers only.

Candidates from the causal neighbours, the previous frame and the guess are weighed by least squares; the law of
paper section 3.2, F = K d n, followed along one axis is a prediction of its own.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.touch_lattice import (
    LIMIT,
    step_at,
)
from touchfield.codec.kernels.touch_least_squares import (
    MOST,
    ONE,
    accumulate,
    descend,
)
from touchfield.codec.kernels.touch_max_window import (
    ALL,
    ALL_B,
    NONE,
    RIDGE,
    SATURATED,
    SLOW,
    B,
    M,
    X,
)

__all__ = ["candidates", "changes", "column", "combine", "fit", "learn", "other"]

_FULL = np.int64(1) << 32
"""Sums of squares beyond it are halved with all others: 19 products with weights of 2^16 stay below 2^53."""


@njit(**LEAN)
def candidates(p, zz, yy, xx, z0, z1, z2, t, u, previous, guess, cand):
    """The predictions to be weighed, ``cand[i, c]``; what is not there is the first, `t`."""
    v, a = p.vectors, p.vectors[:, :, :, 3]
    hx, hy, hz = a[z0, yy, xx - 1] > 0, a[z0, yy - 1, xx] > 0, a[z1, yy, xx] > 0
    hx2, hy2, hz2 = a[z0, yy, xx - 2] > 0, a[z0, yy - 2, xx] > 0, a[z2, yy, xx] > 0
    hxy, hxz, hyz = a[z0, yy - 1, xx - 1] > 0, a[z1, yy, xx - 1] > 0, a[z1, yy - 1, xx] > 0
    for c in range(3):
        tv = t[c]
        vx = np.int64(v[z0, yy, xx - 1, c]) if hx else tv
        vy = np.int64(v[z0, yy - 1, xx, c]) if hy else tv
        vz = np.int64(v[z1, yy, xx, c]) if hz else tv
        cand[0, c] = tv
        cand[1, c] = u[c]
        cand[2, c], cand[3, c], cand[4, c] = vx, vy, vz
        cand[5, c] = 2 * vz - v[z2, yy, xx, c] if hz and hz2 else tv
        cand[6, c] = 2 * vx - v[z0, yy, xx - 2, c] if hx and hx2 else tv
        cand[7, c] = 2 * vy - v[z0, yy - 2, xx, c] if hy and hy2 else tv
        cand[8, c] = vx + vy - v[z0, yy - 1, xx - 1, c] if hx and hy and hxy else tv
        cand[9, c] = vx + vz - v[z1, yy, xx - 1, c] if hx and hz and hxz else tv
        cand[10, c] = vy + vz - v[z1, yy - 1, xx, c] if hy and hz and hyz else tv
        cand[11, c] = v[z1, yy, xx + 1, c] if a[z1, yy, xx + 1] > 0 else tv
        cand[12, c] = v[z1, yy + 1, xx, c] if a[z1, yy + 1, xx] > 0 else tv
        cand[13, c] = v[z1, yy, xx - 1, c] if hxz else tv
        cand[14, c] = v[z1, yy - 1, xx, c] if hyz else tv
        cand[15, c] = v[z0, yy - 1, xx + 1, c] if a[z0, yy - 1, xx + 1] > 0 else tv
    changes(p, zz, yy, xx, z0, z1, previous, t, cand, np.int64(16))
    changes(p, zz, yy, xx, z0, z1, guess, t, cand, np.int64(18))


@njit(**LEAN)
def changes(p, zz, yy, xx, z0, z1, other, t, cand, at):
    """Two candidates from another field: its force here, and that with the change that its neighbours had."""
    if other.held[z0] != zz or other.vectors[z0, yy, xx, 3] == 0:
        for c in range(3):
            cand[at, c] = t[c]
            cand[at + 1, c] = t[c]
        return
    v, w = p.vectors, other.vectors
    a, b = v[:, :, :, 3], w[:, :, :, 3]
    n = np.int64(0)
    s0 = s1 = s2 = np.int64(0)
    if a[z0, yy, xx - 1] > 0 and b[z0, yy, xx - 1] > 0:
        n += 1
        s0 += v[z0, yy, xx - 1, 0] - w[z0, yy, xx - 1, 0]
        s1 += v[z0, yy, xx - 1, 1] - w[z0, yy, xx - 1, 1]
        s2 += v[z0, yy, xx - 1, 2] - w[z0, yy, xx - 1, 2]
    if a[z0, yy - 1, xx] > 0 and b[z0, yy - 1, xx] > 0:
        n += 1
        s0 += v[z0, yy - 1, xx, 0] - w[z0, yy - 1, xx, 0]
        s1 += v[z0, yy - 1, xx, 1] - w[z0, yy - 1, xx, 1]
        s2 += v[z0, yy - 1, xx, 2] - w[z0, yy - 1, xx, 2]
    if a[z1, yy, xx] > 0 and b[z1, yy, xx] > 0:
        n += 1
        s0 += v[z1, yy, xx, 0] - w[z1, yy, xx, 0]
        s1 += v[z1, yy, xx, 1] - w[z1, yy, xx, 1]
        s2 += v[z1, yy, xx, 2] - w[z1, yy, xx, 2]
    n = max(n, np.int64(1))
    for c in range(3):
        cand[at, c] = w[z0, yy, xx, c]
    cand[at + 1, 0] = w[z0, yy, xx, 0] + s0 // n
    cand[at + 1, 1] = w[z0, yy, xx, 1] + s1 // n
    cand[at + 1, 2] = w[z0, yy, xx, 2] + s2 // n


@njit(**LEAN)
def column(p, yy, xx, z0, z1, near_a, near_q, view, slope, which, t, out):
    """What the law says of the sample next to another along one axis (0 z, 1 y, 2 x): the same direction, and
    longer or shorter by K times the step along it."""
    n = 4 if which == 0 else (10 if which == 1 else 12)
    a = near_a[n]
    if a == 0:
        for c in range(3):
            out[c] = t[c]
        return
    s = z1 if which == 0 else z0
    y, x = yy - (which == 1), xx - (which == 2)
    if a >= SATURATED:
        length = a if view[2] >= SATURATED - 1024 else view[2]
    else:
        length = max(a + ((slope * near_q[n]) >> 8), 656)
    for c in range(3):
        v = np.int64(p.vectors[s, y, x, c])
        out[c] = v if length == a else (v * length) // a


@njit(**LEAN)
def other(field, p, yy, xx, z0, z1, lattice, out):
    """Take another field's force, unless it was off already at the sample before along z."""
    a = np.int64(field.vectors[z0, yy, xx, 3])
    if a == 0:
        return
    if p.vectors[z1, yy, xx, 3] > 0 and field.vectors[z1, yy, xx, 3] > 0:
        d = np.int64(0)
        for c in range(3):
            d += (np.int64(p.vectors[z1, yy, xx, c]) - field.vectors[z1, yy, xx, c]) ** 2
        s = step_at(np.int64(field.vectors[z1, yy, xx, 3]), lattice[0], lattice[1])
        if d > s * s:
            return
    for c in range(3):
        out[c] = field.vectors[z0, yy, xx, c]


@njit(**LEAN)
def fit(work, near, weights, count, shift, m, local):
    """Weights of the candidates: ``work.x[:m]`` by least squares near by and, less firmly, over all that came before;
    ``work.slow[:m]`` by the latter alone."""
    near_a, all_a = work.sums[:M], work.sums[ALL : ALL + M]
    b, all_b, slow, x = work.sums[B], work.sums[ALL_B], work.sums[SLOW], work.sums[X]
    ridge, none = work.sums[RIDGE], work.sums[NONE]
    accumulate(near_a, b, m, near, weights, count, work.kept, shift, work.d)
    trace = np.int64(0)
    known = np.int64(0)
    for i in range(m):
        trace += near_a[i, i]
        known += all_a[i, i] >> 3
    if known > 0:
        share = ((trace + 64) << 12) // (2 * known + 1)
        for i in range(m):
            b[i] += ((all_b[i] >> 3) * share) >> 12
            for j in range(m):
                near_a[i, j] += ((all_a[i, j] >> 3) * share) >> 12
    for i in range(m):
        none[i] = 0
    descend(all_a, all_b, m, slow, none, 1, slow)
    for i in range(m):
        ridge[i] = (trace >> 10) + 200
    descend(near_a, b, m, slow, ridge, local, x)


@njit(**LEAN)
def combine(cand, m, sums, row, top, out, which):
    """The sum of the candidates by the weights ``sums[row]``, into ``out[which]``; the first where it is nonsense."""
    size = np.int64(0)
    for c in range(3):
        s = np.int64(0)
        for i in range(m):
            s += sums[row, i] * (cand[i + 1, c] - cand[0, c])
        out[which, c] = min(max(cand[0, c] + ((s + ONE // 2) >> 14), -LIMIT), LIMIT)
        size += out[which, c] * out[which, c]
    if size > top * top:
        for c in range(3):
            out[which, c] = cand[0, c]


@njit(**LEAN)
def learn(work, cand, m, shift, came):
    """Add one sample to the sums over all; old ones fade, faster where the sums grow large."""
    d, all_a, all_b = work.d[0], work.sums[ALL : ALL + M], work.sums[ALL_B]
    half = (1 << shift) >> 1
    for c in range(3):
        for i in range(m):
            d[i, c] = min(max((cand[i + 1, c] - cand[0, c] + half) >> shift, -MOST), MOST)
        d[m, c] = min(max((came[c] - cand[0, c] + half) >> shift, -MOST), MOST)
    full = False
    for i in range(m):
        d0, d1, d2 = np.int64(d[i, 0]) << 3, np.int64(d[i, 1]) << 3, np.int64(d[i, 2]) << 3
        all_b[i] += d0 * d[m, 0] + d1 * d[m, 1] + d2 * d[m, 2] - (all_b[i] >> 13)
        for j in range(m):
            all_a[i, j] += d0 * d[j, 0] + d1 * d[j, 1] + d2 * d[j, 2] - (all_a[i, j] >> 13)
        full |= all_a[i, i] > _FULL
    if full:
        for i in range(m):
            all_b[i] >>= 1
            for j in range(m):
                all_a[i, j] >>= 1
