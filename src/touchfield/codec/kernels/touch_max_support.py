"""What effort `max` of the coder `touch` knows of a sample before its support bit; whole numbers only."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.touch_max_window import (
    NEAR,
    NEAR_ONCE,
    NEAR_WEIGHT,
)
from touchfield.codec.kernels.touch_mixing import (
    LOGITS,
    SLOTS,
    logit,
    slot_of,
)
from touchfield.codec.kernels.touch_transition import (
    look_up,
)

__all__ = ["neighbourhood", "occupancy", "size16", "support_contexts"]


@njit(**LEAN, inline="always")
def size16(a):
    return np.int64(0) if a == 0 else 1 + min(a >> 12, 14)


@njit(**LEAN)
def neighbourhood(p, t, z0, z1, yy, xx, metric, near_a, near_q, view, taylor, mean, out):
    """What the 13 neighbours say: bits of which hold a force, and in `view` [6] the sum of logits of a force and its
    weight, the length foreseen, the surest one and its deviation, and how many hold one; `taylor`, `mean` [3]."""
    bits = np.int64(0)
    held = np.int64(0)
    weight = total = length = np.int64(0)
    least = np.int64(1) << 40
    surest = odds = odds_weight = np.int64(0)
    for c in range(3):
        taylor[c] = 0
        mean[c] = 0
    for i in range(13):
        s = z1 if NEAR[i, 0] < 0 else z0
        y, x = yy + NEAR[i, 1], xx + NEAR[i, 2]
        a = np.int64(p.vectors[s, y, x, 3])
        near_a[i] = a
        if a == 0:
            continue
        bits |= np.int64(1) << i
        held += 1
        v0, v1, v2 = np.int64(p.vectors[s, y, x, 0]), np.int64(p.vectors[s, y, x, 1]), np.int64(p.vectors[s, y, x, 2])
        q = (v0 * NEAR[i, 2] * metric[0] + v1 * NEAR[i, 1] * metric[1] + v2 * NEAR[i, 0] * metric[2]) // a
        near_q[i] = q
        look_up(t, a, q, out)
        odds += NEAR_ONCE[i] * logit(out[2])
        odds_weight += NEAR_ONCE[i]
        foreseen = max(a + out[0], 1300)
        deviation = max(out[1], 1)
        w = (NEAR_WEIGHT[i] << 24) // (deviation * deviation + 1600000) + 1
        if deviation < least:
            least, surest = deviation, foreseen
        scale = (foreseen << 12) // a
        taylor[0] += w * ((v0 * scale) >> 12)
        taylor[1] += w * ((v1 * scale) >> 12)
        taylor[2] += w * ((v2 * scale) >> 12)
        length += w * foreseen
        weight += w
        mean[0] += NEAR_WEIGHT[i] * v0
        mean[1] += NEAR_WEIGHT[i] * v1
        mean[2] += NEAR_WEIGHT[i] * v2
        total += NEAR_WEIGHT[i]
    if weight > 0:
        for c in range(3):
            taylor[c] //= weight
            mean[c] //= total
        length //= weight
    view[0], view[1], view[2], view[3], view[4], view[5] = odds, odds_weight, length, surest, least, held
    return bits


@njit(**LEAN)
def occupancy(field, z, yy, xx):
    """Which of a known field's samples at and about here hold a force: 7 bits, and all 27."""
    s0, s1, s2 = z % 3, (z - 1) % 3, (z + 1) % 3
    b = field.vectors[:, :, :, 3]
    seven = np.int64(b[s0, yy, xx] > 0) | np.int64(b[s0, yy, xx - 1] > 0) << 1 | np.int64(b[s0, yy, xx + 1] > 0) << 2
    seven |= np.int64(b[s0, yy - 1, xx] > 0) << 3 | np.int64(b[s0, yy + 1, xx] > 0) << 4
    seven |= np.int64(b[s1, yy, xx] > 0) << 5 | np.int64(b[s2, yy, xx] > 0) << 6
    all27 = np.int64(0)
    j = 0
    for s in (s1, s0, s2):
        for y in range(-1, 2):
            for x in range(-1, 2):
                all27 |= np.int64(b[s, yy + y, xx + x] > 0) << j
                j += 1
    return seven, all27


@njit(**LEAN)
def support_contexts(p, z0, z1, z2, yy, xx, bits, near_q, view, inter, before, ahead, previous, guess, m):
    """Fill ``m.io[SLOTS]`` for the support bit; the number of contexts, and the quantised sum of logits."""
    a = p.vectors[:, :, :, 3]
    vs = view[0] // view[1] if view[1] > 0 else np.int64(0)
    if view[5] > 0:
        t40 = min(max((view[2] * 29 >> 16) + 10, 0), 39)
        s32 = min(max((view[3] * 23 >> 16) + 8, 0), 31)
        v16 = min(max((vs * 2 + 128) >> 8, -8), 8) + 9
    else:
        t40, s32, v16 = np.int64(40), np.int64(40), np.int64(0)
    qx, qy, qz = size16(a[z0, yy, xx - 1]), size16(a[z0, yy - 1, xx]), size16(a[z1, yy, xx])
    dz = ((near_q[4] + 256) >> 6) if qz > 0 else np.int64(9)
    dy = ((near_q[10] + 256) >> 6) if qy > 0 else np.int64(9)
    dx = ((near_q[12] + 256) >> 6) if qx > 0 else np.int64(9)
    dz, dy, dx = min(max(dz, 0), 15), min(max(dy, 0), 15), min(max(dx, 0), 15)
    far = np.int64(a[z0, yy, xx - 2] > 0) | np.int64(a[z0, yy - 2, xx] > 0) << 1 | np.int64(a[z2, yy, xx] > 0) << 2
    far |= np.int64(a[z0, yy - 1, xx + 2] > 0) << 3 | np.int64(a[z1, yy, xx + 2] > 0) << 4
    far |= np.int64(a[z1, yy + 2, xx] > 0) << 5 | np.int64(a[z0, yy - 2, xx + 1] > 0) << 6
    far |= np.int64(a[z2, yy + 1, xx] > 0) << 7 | np.int64(a[z2, yy, xx + 1] > 0) << 8
    h = m.io[SLOTS]
    h[0] = slot_of(0, bits)
    h[1] = slot_of(1, bits * 512 + far)
    h[2] = slot_of(2, (v16 * 64 + t40) * 64 + s32)
    h[3] = slot_of(3, (qz * 32 + qy) * 32 + qx)
    if inter == 0 and view[5] == 0:
        # nothing near by: all that follows would say the same again
        m.io[LOGITS, 2] = 0
        return 2, v16
    cross = ((bits >> 1) & 1) | ((bits >> 3) & 1) << 1 | ((bits >> 5) & 1) << 2 | ((bits >> 7) & 1) << 3
    h[4] = slot_of(4, ((qz * 16 + dz) * 16 + ((bits >> 9) & 15)) * 16 + cross)
    h[5] = slot_of(5, (qx * 16 + dx) * 512 + qy * 16 + dy)
    h[6] = slot_of(6, (v16 * 16 + view[5]) * 8 + (far & 7))
    h[7] = slot_of(7, (qz * 16 + dz) * 32 + v16)
    n = 8
    if inter & 1:
        seven, all27 = occupancy(previous, before, yy, xx)
        qa = size16(previous.vectors[z0, yy, xx, 3])
        h[8] = slot_of(8, all27)
        h[9] = slot_of(9, seven * 64 + t40)
        h[10] = slot_of(10, (qa * 32 + v16) * 32 + qz)
        h[11] = slot_of(11, seven << 13 | bits)
        h[12] = slot_of(12, ((qa * 32 + qz) * 32 + qx) * 32 + qy)
        n = 13
    if inter & 2:
        seven, all27 = occupancy(guess, ahead, yy, xx)
        qa = size16(guess.vectors[z0, yy, xx, 3])
        h[n] = slot_of(13, all27)
        h[n + 1] = slot_of(14, (qa * 32 + v16) * 32 + qz)
        h[n + 2] = slot_of(15, (seven * 64 + s32) * 32 + qa)
        h[n + 3] = slot_of(16, seven << 13 | bits)
        n += 4
    m.io[LOGITS, n] = vs
    return n, v16
