"""Coding the residual of a prediction in effort `max` of the coder `touch`, and what it stands for."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.touch_lattice import (
    LIMIT,
    amplitude_of,
    level_of,
    rebuild,
    root,
    step_at,
)
from touchfield.codec.kernels.touch_max_choice import (
    choose,
)
from touchfield.codec.kernels.touch_max_window import (
    NEAR,
    NEAR_WEIGHT,
    PINNED,
    SIZES,
)
from touchfield.codec.kernels.touch_mixing import (
    ENCODE,
    LOGITS,
    PRICE,
    PRICED,
    SLOTS,
    code_bit,
    logit,
    slot_of,
)
from touchfield.codec.kernels.touch_residual import (
    EXPERTS,
    code_component,
    half_octaves,
    level16,
    within,
)

__all__ = ["code_parts", "code_residual", "force_of"]


@njit(**LEAN)
def force_of(r, pn, axes, lattice, border, first, v):
    """The force that a residual other than zero stands for."""
    length = pn if r[0] == 0 else amplitude_of(level_of(pn, border, first) + 256 * r[0], border)
    s = step_at(abs(length), lattice[2], lattice[3])
    limit = 4 * LIMIT // max(s, 1)
    rebuild(length, min(max(r[1], -limit), limit) * s, min(max(r[2], -limit), limit) * s, axes, v)
    if v[0] == 0 and v[1] == 0 and v[2] == 0:
        v[2] = 1


@njit(**LEAN)
def code_parts(m, here, centre, spread, contexts, r, mode, state, buffer):
    """Code whether the residual is zero altogether, then its part along, then the two across."""
    n = np.int64(10)
    qr, qt, sp, qa, qn, qv, mm = here[0], here[1], here[2], here[3], here[4], here[5], here[6]
    ps, quiet = here[7], here[8]
    contexts[0] = (qr * 16 + sp) * 32 + qt
    contexts[1] = (qr * 16 + qt) * 32 + qv
    contexts[2] = (sp * 16 + qa) * 16 + mm
    contexts[3] = ps * 16 + qr
    contexts[4] = (qn * 16 + mm) * 16 + qa
    contexts[5] = quiet * 16 + mm
    contexts[6] = (ps * 16 + sp) * 16 + qa
    contexts[7] = (qa * 32 + qv) * 16 + quiet % 9
    rx, ry, rz = here[15], here[16], here[17]
    contexts[8] = (rz * 16 + ry) * 16 + rx
    contexts[9] = (rz * 16 + qr) * 16 + qa
    for i in range(n):
        m.io[SLOTS, i] = slot_of(i, contexts[i] * 8 + here[18] * 4)
    for j in range(EXPERTS):
        chance = np.int64(65536)
        for c in range(3):
            chance = chance * within(centre[c, j], spread[c, j]) >> 16
        m.io[LOGITS, n + j] = logit(65536 - chance)
    moved = np.int64(r[0] != 0 or r[1] != 0 or r[2] != 0)
    moved = code_bit(m, n, np.int64(EXPERTS), here[18], 2 + qr, 120 + qt, np.int64(4), moved, mode, state, buffer)
    if moved == 0:
        r[0] = r[1] = r[2] = 0
        return
    for c in range(3):
        q = qr if c == 0 else qt
        a0 = np.int64(0)
        if c > 0:
            a0 = min(np.int64(3), abs(r[0])) * 4
        if c == 2:
            a0 += min(np.int64(3), abs(r[1]))
            for j in range(EXPERTS):
                spread[3, j] = (spread[1, j] * 4 + 128 * min(abs(r[1]), np.int64(20))) // 5 + 1
        u1 = min(max((centre[c, 2] * 3) >> 9, -3), 3) + 3
        u2 = min(max((centre[c, 3] * 3) >> 9, -3), 3) + 3
        contexts[0] = (q * 16 + sp) * 16 + a0
        contexts[1] = (qr * 16 + qt) * 16 + a0 if c > 0 else (qr * 16 + qt) * 32 + qv
        contexts[2] = ((sp * 16 + qa) * 16 + mm) * 16 + a0
        contexts[3] = (ps * 16 + q) * 16 + a0
        contexts[4] = ((qn * 16 + mm) * 16 + qa) * 16 + a0
        contexts[5] = (here[12 + c] * 16 + mm) * 16 + a0
        contexts[6] = ((u1 * 7 + u2) * 16 + q) * 16 + a0
        contexts[7] = ((qa * 32 + qv) * 16 + q) * 16 + a0
        contexts[8] = ((rz * 16 + q) * 16 + qa) * 16 + a0
        contexts[9] = ((rz * 16 + ry) * 16 + rx) * 16 + a0
        for i in range(n):
            contexts[i] = contexts[i] * 8 + here[18] * 4 + c + 1
        must = c == 2 and r[0] == 0 and r[1] == 0
        r[c] = code_component(
            m, 20 + 60 * c, np.int64(1 if c == 0 else 2), contexts, n, centre[c], spread[c + (c == 2)],
            min(q >> 1, np.int64(7)), r[c], must, mode, state, buffer, 30 * c,
        )  # fmt: skip


@njit(**LEAN)
def code_residual(
    work, m, planes, z0, z1, yy, xx, near_a, view, cand, width, expert, p, pn, axes, step, lattice, border, first,
    rule, o, length, inter, centre, spread, err, here, contexts, r, v, scratch, short, costs, previous,
    column, mode, state, buffer,
):  # fmt: skip
    """Code the residual ``r`` of the prediction ``p`` of length `pn`, and rebuild the force ``v``."""
    marks = work.marks
    total = along = cross = np.int64(0)
    for j in range(EXPERTS):
        err[j, 0] = err[j, 1] = 0
    for i in range(13):
        if near_a[i] == 0:
            continue
        s = z1 if NEAR[i, 0] < 0 else z0
        y, x = yy + NEAR[i, 1], xx + NEAR[i, 2]
        w = NEAR_WEIGHT[i]
        total += w
        along += w * work.marks[s, y, x, SIZES + 0]
        cross += w * (np.int64(work.marks[s, y, x, SIZES + 1]) + work.marks[s, y, x, SIZES + 2])
        for j in range(EXPERTS):
            err[j, 0] += w * work.marks[s, y, x, j]
            err[j, 1] += w * work.marks[s, y, x, EXPERTS + j]
    mr = ((along << 8) + 13107) // (total + 128)
    mt = ((cross << 7) + 13107) // (total + 128)
    unseen = np.int64(0)
    if total == 0:
        mr, mt = max(mr, np.int64(512)), max(mt, np.int64(512))
        unseen = np.int64(24640)
    spread_all = np.int64(0)
    for i in range(width + 1):
        for c in range(3):
            d = cand[i, c] - p[c]
            spread_all += d * d
    sp = level16((root(spread_all // (width + 1)) << 8) // step)
    qa = min(pn >> 12, 15)
    qr, qt = level16(mr), level16(mt)
    qn = min(view[5], 13)
    qv = level16((min(view[4], 1 << 20) << 7) // step) if view[5] > 0 else np.int64(16)
    a = planes.vectors[:, :, :, 3]
    mm = np.int64(a[z0, yy, xx - 1] > 0) | np.int64(a[z0, yy - 1, xx] > 0) << 1 | np.int64(a[z1, yy, xx] > 0) << 2
    if inter & 1:
        mm |= np.int64(previous.vectors[z0, yy, xx, 3] > 0) << 3
    ps = np.int64(300) + inter
    if inter & 1 and previous.vectors[z0, yy, xx, 3] > 0:
        d = np.int64(0)
        for c in range(3):
            d += (previous.vectors[z0, yy, xx, c] - p[c]) ** 2
        ps = level16((root(d) << 8) // step)
    elif inter & 2:
        d = np.int64(0)
        for c in range(3):
            d += (cand[18, c] - p[c]) ** 2
        ps = 100 + level16((root(d) << 8) // step)
    quiet = np.int64(0)
    for i in range(3):
        s = z1 if i == 2 else z0
        y, x = yy - (i == 1), xx - (i == 0)
        q = marks[s, y, x, SIZES] + marks[s, y, x, SIZES + 1] + marks[s, y, x, SIZES + 2] if a[s, y, x] > 0 else 0
        quiet = quiet * 3 + min(np.int64(2), np.int64(q))
    here[0], here[1], here[2], here[3], here[4], here[5], here[6] = qr, qt, sp, qa, qn, qv, mm
    here[7], here[8], here[9], here[10], here[11] = ps, quiet, total, unseen, step
    here[18] = column
    # a force is known as well as where it was last corrected: how much finer must it be here?
    pinned = np.int64(0)
    pinned_weight = np.int64(0)
    for i in range(3):
        s = z1 if i == 2 else z0
        y, x = yy - (i == 1), xx - (i == 0)
        here[15 + i] = 0
        if a[s, y, x] > 0:
            old = np.int64(marks[s, y, x, PINNED])
            here[15 + i] = min(max(half_octaves((old << 4) // step) - 6, 1), 15)
            pinned += old * (2 if i == 2 else 1)
            pinned_weight += 2 if i == 2 else 1
    pinned = pinned // pinned_weight if pinned_weight > 0 else step
    for c in range(3):
        trio = np.int64(0)
        for i in range(3):
            s = z1 if i == 2 else z0
            y, x = yy - (i == 1), xx - (i == 0)
            trio = trio * 4 + (min(np.int64(3), np.int64(marks[s, y, x, SIZES + c])) if a[s, y, x] > 0 else 0)
        here[12 + c] = trio
        for j in range(EXPERTS):
            t = np.int64(0)
            for k in range(3):
                t += (expert[j, k] - p[k]) * axes[c, k]
            centre[c, j] = min(max(((t >> 14) << 8) // step, -100000), 100000)
            e = err[j, 0 if c == 0 else 1]
            spread[c, j] = max(root(((e + 616 + unseen) // (total + 77) + 1) << 12) >> 1, 12)
    if mode == ENCODE:
        found = choose(o, length, axes, pn, lattice, border, first, rule, mr, mt, p, short, costs, scratch)
        best = 1e30
        r[0] = r[1] = r[2] = 0
        for i in range(found):
            price = 0.0
            if found > 1:
                for c in range(3):
                    scratch[c] = short[i, c]
                m.spent[PRICED] = 0.0
                code_parts(m, here, centre, spread, contexts, scratch, np.int64(PRICE), state, buffer)
                price = m.spent[PRICED]
            price = costs[i, 1] + rule[3] * price if rule[4] > 0 else price + rule[3] * costs[i, 1]
            if price < best:
                best = price
                r[0], r[1], r[2] = short[i, 0], short[i, 1], short[i, 2]
    code_parts(m, here, centre, spread, contexts, r, mode, state, buffer)
    if r[0] == 0 and r[1] == 0 and r[2] == 0:
        v[0], v[1], v[2] = p[0], p[1], p[2]
    else:
        force_of(r, pn, axes, lattice, border, first, v)
    marks[z0, yy, xx, PINNED] = pinned if r[0] == 0 and r[1] == 0 and r[2] == 0 else step
    for c in range(3):
        marks[z0, yy, xx, SIZES + c] = min(abs(r[c]), np.int64(200))
    for j in range(EXPERTS):
        x0 = min(max(((v[0] - expert[j, 0]) << 4) // step, -3000), 3000)
        x1 = min(max(((v[1] - expert[j, 1]) << 4) // step, -3000), 3000)
        x2 = min(max(((v[2] - expert[j, 2]) << 4) // step, -3000), 3000)
        t = (x0 * axes[0, 0] + x1 * axes[0, 1] + x2 * axes[0, 2]) >> 14
        both = x0 * x0 + x1 * x1 + x2 * x2
        work.marks[z0, yy, xx, j] = min((t * t) >> 4, 6400)
        work.marks[z0, yy, xx, EXPERTS + j] = min(max(both - t * t, 0) >> 5, 6400)
