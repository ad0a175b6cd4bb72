"""What the encoder of effort `max` chooses: the decoder never runs this, so it may take floating point."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.touch_lattice import (
    amplitude_of,
    level_of,
    rebuild,
    step_at,
)
from touchfield.codec.kernels.touch_max_window import (
    SATURATED,
)
from touchfield.codec.kernels.touch_planes import (
    PAD,
)

__all__ = ["SHORT", "chain_breaks", "choose", "enlist", "follow", "foresee", "judge", "may_be", "same_as", "uniform"]

SHORT = 8
"""Residuals whose price is asked of the model."""


@njit(**LEAN)
def judge(x0, x1, x2, o0, o1, o2, length, rule):
    """The error of (x0, x1, x2) as a share of what the rule allows, squared; above 1 where it is broken.

    rule : float64 [6]: k, F_0 in units, sine of the direction JND, thrift, free, step
    """
    d0, d1, d2 = x0 - o0, x1 - o1, x2 - o2
    e = d0 * d0 + d1 * d1 + d2 * d2
    if rule[4] > 0:
        return e / (rule[5] * rule[5])
    mask = max(rule[1], rule[0] * length)
    mask = max(mask * 0.999999, 1e-9)
    if rule[2] <= 0 or length * rule[2] <= rule[1]:
        return e / (mask * mask)
    along = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    dot = x0 * o0 + x1 * o1 + x2 * o2
    c0, c1, c2 = x1 * o2 - x2 * o1, x2 * o0 - x0 * o2, x0 * o1 - x1 * o0
    sine = np.sqrt(c0 * c0 + c1 * c1 + c2 * c2) / max(along * length, 1e-9)
    if dot <= 0:
        sine = 2.0
    radial = abs(along - length) / mask
    across = sine / (rule[2] * 0.999999)
    worst = max(radial, across)
    return worst * worst


@njit(**LEAN)
def may_be(v0, v1, v2, a, o0, o1, o2, rule):
    """Whether an original may be decoded as (v0, v1, v2)."""
    length = np.sqrt(o0 * o0 + o1 * o1 + o2 * o2)
    if (a > 0) != (length > 0) and (rule[4] > 0 or rule[6] == 0):
        return False
    if a == 0 and length == 0:
        return True
    e = judge(float(v0), float(v1), float(v2), o0, o1, o2, length, rule)
    return e <= (0.08 if rule[4] > 0 else 1.0)


@njit(**LEAN)
def uniform(bricks, n, p, z, rule, original):
    """Whether all of a brick may take the values of the plane before it (encoder only)."""
    y0, x0 = 8 * np.int64(bricks[n, 1]), 8 * np.int64(bricks[n, 2])
    s = (z - 1) % 3
    for y in range(8):
        for x in range(8):
            a = p.vectors[s, y0 + y + PAD, x0 + x + PAD, 3]
            v0 = p.vectors[s, y0 + y + PAD, x0 + x + PAD, 0]
            v1 = p.vectors[s, y0 + y + PAD, x0 + x + PAD, 1]
            v2 = p.vectors[s, y0 + y + PAD, x0 + x + PAD, 2]
            for k in range(8):
                o0, o1, o2 = original[n, k, y, x, 0], original[n, k, y, x, 1], original[n, k, y, x, 2]
                if not may_be(v0, v1, v2, a, o0, o1, o2, rule):
                    return False
    return True


@njit(**LEAN)
def same_as(field, slot_of_brick, n, rule, original):
    """Whether all of a brick may take the values of another field's brick (encoder only)."""
    for k in range(8):
        for y in range(8):
            for x in range(8):
                v0 = v1 = v2 = np.int64(0)
                if slot_of_brick >= 0:
                    v0 = field[slot_of_brick, k, y, x, 0]
                    v1 = field[slot_of_brick, k, y, x, 1]
                    v2 = field[slot_of_brick, k, y, x, 2]
                a = 1 if v0 != 0 or v1 != 0 or v2 != 0 else 0
                if not may_be(
                    v0, v1, v2, a, original[n, k, y, x, 0], original[n, k, y, x, 1], original[n, k, y, x, 2], rule
                ):
                    return False
    return True


@njit(**LEAN)
def follow(w, i, j, k, axis, metric, b, out):
    """What the law makes of the sample before (i, j, k) along an axis; false where that holds none (encoder only)."""
    y, x, z = j - (axis == 1), k - (axis == 2), i - (axis == 0)
    a = np.sqrt(w[z, y, x, 0] ** 2 + w[z, y, x, 1] ** 2 + w[z, y, x, 2] ** 2)
    if a == 0:
        return False
    c = 2 - axis
    length = a
    if a < SATURATED:
        length = a - w[z, y, x, c] / a * metric[c] * metric[3] / 256.0
    elif b < SATURATED:
        length = b
    for c in range(3):
        out[c] = w[z, y, x, c] * length / a
    return True


@njit(**LEAN)
def foresee(w, i, j, k, way, metric, b, other, at, limit, p, q):
    """What a way of predicting makes of a sample, into `q`; false where there is nothing to go by (encoder only)."""
    if way >= 4 and at >= 0:
        g0, g1, g2 = float(other[at, i, j, k, 0]), float(other[at, i, j, k, 1]), float(other[at, i, j, k, 2])
        if g0 != 0 or g1 != 0 or g2 != 0:
            off = 0.0
            if i > 0 and (w[i - 1, j, k, 0] != 0 or w[i - 1, j, k, 1] != 0 or w[i - 1, j, k, 2] != 0):
                for c in range(3):
                    off += (w[i - 1, j, k, c] - other[at, i - 1, j, k, c]) ** 2
            if off <= limit * limit:
                q[0], q[1], q[2] = g0, g1, g2
                return True
    seen = 0
    q[0] = q[1] = q[2] = 0.0
    for axis in range(3):
        taken = way == 0 or way == axis + 1 or (way >= 4 and axis == 0)
        if taken and (i, j, k)[axis] > 0 and follow(w, i, j, k, axis, metric, b, p):
            seen += 1
            q[0] += p[0]
            q[1] += p[1]
            q[2] += p[2]
    for c in range(3):
        q[c] /= max(seen, 1)
    return seen > 0


@njit(cache=True, nogil=True, error_model="numpy")
def chain_breaks(original, metric, rule, before, ahead, links):
    """How often each way to predict a brick breaks the rule, int64 [n, 6]: 0 from all around, 1 to 3 from the sample
    before along z, y or x alone, 4 from the guess, 5 from the previous frame (encoder only).

    Each is tried on the originals: a sample is followed from the one before, as what that was decoded as, until the
    rule is broken. A single chain keeps its error, and so stays within a rule that is relative, where a mean of
    neighbours with errors of their own does not.
    """
    out = np.zeros((original.shape[0], 6), np.int64)
    w = np.zeros((8, 8, 8, 3), np.float64)
    p = np.zeros(3, np.float64)
    q = np.zeros(3, np.float64)
    for n in range(original.shape[0]):
        for way in range(6):
            other = before[2] if way == 5 else ahead[2]
            at = links[n, 0] if way == 5 else links[n, 1]
            for i in range(8):
                for j in range(8):
                    for k in range(8):
                        o0, o1, o2 = original[n, i, j, k, 0], original[n, i, j, k, 1], original[n, i, j, k, 2]
                        b = np.sqrt(o0 * o0 + o1 * o1 + o2 * o2)
                        w[i, j, k, 0] = w[i, j, k, 1] = w[i, j, k, 2] = 0
                        if b <= (rule[1] if rule[4] == 0 else 0.0):
                            continue
                        limit = rule[5] if rule[4] > 0 else max(rule[1], rule[0] * b)
                        e = 2.0
                        if foresee(w, i, j, k, way, metric, b, other, at, limit, p, q):
                            e = judge(q[0], q[1], q[2], o0, o1, o2, b, rule)
                        if e <= (0.3 if rule[4] > 0 else 1.0):
                            w[i, j, k, 0], w[i, j, k, 1], w[i, j, k, 2] = q[0], q[1], q[2]
                        else:
                            w[i, j, k, 0], w[i, j, k, 1], w[i, j, k, 2] = o0, o1, o2
                            if way == 0 or way > 3 or (i, j, k)[way - 1] > 0:
                                out[n, way] += 1
    return out


@njit(**LEAN)
def enlist(short, costs, found, cost, e, r0, r1, r2):
    """Put a residual among the cheapest so far, ascending; how many there are now."""
    if found == SHORT and cost >= costs[SHORT - 1, 0]:
        return found
    i = min(found, SHORT - 1)
    while i > 0 and costs[i - 1, 0] > cost:
        costs[i, 0], costs[i, 1] = costs[i - 1, 0], costs[i - 1, 1]
        for c in range(3):
            short[i, c] = short[i - 1, c]
        i -= 1
    costs[i, 0], costs[i, 1] = cost, e
    short[i, 0], short[i, 1], short[i, 2] = r0, r1, r2
    return min(found + 1, SHORT)


@njit(**LEAN)
def choose(o, length, axes, pn, lattice, border, first, rule, mr, mt, p, short, costs, scratch):
    """Residuals within the rule that look cheap, into ``short[:n]`` with their errors in ``costs[:n, 1]``; n.

    o : float64 [3], the original in units; p : int64 [3], the prediction; mr, mt : mean sizes near by, 1/256.
    """
    free = rule[4] > 0
    o0, o1, o2 = o[0], o[1], o[2]
    found = 0
    e = judge(float(p[0]), float(p[1]), float(p[2]), o0, o1, o2, length, rule)
    if not free and e <= 1:
        short[0, 0] = short[0, 1] = short[0, 2] = 0
        return 1
    if free:
        found = enlist(short, costs, found, e, e, np.int64(0), np.int64(0), np.int64(0))
    base = level_of(pn, border, first)
    along = (o0 * axes[0, 0] + o1 * axes[0, 1] + o2 * axes[0, 2]) / 16384.0
    h = (o0 * axes[1, 0] + o1 * axes[1, 1] + o2 * axes[1, 2]) / 16384.0
    k = (o0 * axes[2, 0] + o1 * axes[2, 1] + o2 * axes[2, 2]) / 16384.0
    whole = np.int64(min(max(along, -200000.0), 200000.0))
    target = level_of(abs(whole), border, first)
    q0 = ((target if whole >= 0 else -target) - base) / 256.0
    n0 = np.int64(np.floor(q0 + 0.5))
    pr = 1.5 / (mr / 256.0 + 0.5)
    pt = 1.5 / (mt / 256.0 + 0.5)
    for reach in range(1, 4):
        for i in range(-reach, reach + 1):
            r0 = n0 + i
            c0 = 0.0 if r0 == 0 else 1.5 + abs(r0) * pr
            a = pn if r0 == 0 else amplitude_of(base + 256 * r0, border)
            s = step_at(abs(a), lattice[2], lattice[3])
            n1 = np.int64(np.floor(h / s + 0.5))
            n2 = np.int64(np.floor(k / s + 0.5))
            for j in range(-reach, reach + 1):
                r1 = n1 + j
                c1 = c0 if r1 == 0 else c0 + 1.5 + abs(r1) * pt
                for t in range(-reach, reach + 1):
                    r2 = n2 + t
                    if r0 == 0 and r1 == 0 and r2 == 0:
                        continue
                    c2 = c1 if r2 == 0 else c1 + 1.5 + abs(r2) * pt
                    if found == SHORT and c2 * (rule[3] if free else 1.0) >= costs[SHORT - 1, 0]:
                        continue
                    rebuild(a, r1 * s, r2 * s, axes, scratch)
                    e = judge(float(scratch[0]), float(scratch[1]), float(scratch[2]), o0, o1, o2, length, rule)
                    if free:
                        found = enlist(short, costs, found, e + rule[3] * c2, e, r0, r1, r2)
                    elif e <= 1:
                        found = enlist(short, costs, found, c2 + rule[3] * e, e, r0, r1, r2)
        if found > (1 if free else 0):
            break
    return found
