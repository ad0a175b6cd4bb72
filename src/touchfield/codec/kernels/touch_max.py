"""The compiled pass of effort `max` of the coder `touch`: support and force of each sample, one after another.

Planes from deep to shallow, in each its rows. For each sample first whether it holds a force, then the residual
of a locally fitted prediction, both with many mixed models. Encoder and decoder run the same code.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.mixer import (
    PLACE,
)
from touchfield.codec.kernels.touch_lattice import (
    LIMIT,
    axes_along,
    root,
    step_at,
)
from touchfield.codec.kernels.touch_max_choice import (
    SHORT,
    judge,
    same_as,
    uniform,
)
from touchfield.codec.kernels.touch_max_predict import (
    candidates,
    column,
    combine,
    fit,
    learn,
    other,
)
from touchfield.codec.kernels.touch_max_residual import (
    code_residual,
)
from touchfield.codec.kernels.touch_max_support import (
    neighbourhood,
    support_contexts,
)
from touchfield.codec.kernels.touch_max_window import (
    ALONE,
    CANDIDATES,
    CODED,
    COLUMN,
    COPY_BELOW,
    COPY_GUESS,
    COPY_PREVIOUS,
    GIVEN,
    NEAR_ONCE,
    PINNED,
    RESIDUAL_CONTEXTS,
    ROW,
    SAMPLES,
    SIZES,
    SLOW,
    WINDOW,
    WINDOW_WEIGHT,
    X,
)
from touchfield.codec.kernels.touch_mixing import (
    DECODE,
    ENCODE,
    SLOTS,
    code_bit,
    predict,
    slot_of,
)
from touchfield.codec.kernels.touch_planes import (
    PAD,
    fill_plane,
    make_plane_empty,
)
from touchfield.codec.kernels.touch_residual import (
    EXPERTS,
)
from touchfield.codec.kernels.touch_transition import (
    learn_chance,
    learn_change,
)

__all__ = ["DONE", "ENDED", "code_frame"]

DONE, ENDED = 0, 1
"""What `code_frame` returns: all is well, or the buffer is too short."""

_ROOM = 4096
"""More bytes than eight samples ever take."""


@njit(**LEAN)
def _copy(which, z, yy, xx, planes, previous, guess, z0, z1, v):
    for k in range(3):
        if which == COPY_BELOW:
            v[k] = planes.vectors[z1, yy, xx, k]
        elif which == COPY_PREVIOUS:
            v[k] = previous.vectors[z0, yy, xx, k]
        else:
            v[k] = guess.vectors[z0, yy, xx, k]


@njit(**LEAN)
def _flag(m, first, second, sets, other, where, bit, mode, state, buffer):
    """Code one bit of a brick's state, by two contexts."""
    m.io[SLOTS, 0] = slot_of(10, first)
    m.io[SLOTS, 1] = slot_of(11, second)
    return code_bit(
        m, np.int64(2), np.int64(0), np.int64(sets), np.int64(other), np.int64(where), np.int64(3), np.int64(bit),
        mode, state, buffer,
    )  # fmt: skip


@njit(**LEAN)
def _code_state(
    n, states, ways, z, bricks, planes, rule, original, before, ahead, links, inter, m, mode, state, buffer
):
    """How a brick is coded: what `touch_max_window` names."""
    which = np.int64(CODED)
    way = np.int64(0)
    if mode == ENCODE:
        way = ways[n]
        if inter & 1 and same_as(before[2], links[n, 0], n, rule, original):
            which = np.int64(COPY_PREVIOUS)
        elif inter & 2 and same_as(ahead[2], links[n, 1], n, rule, original):
            which = np.int64(COPY_GUESS)
        elif uniform(bricks, n, planes, z, rule, original):
            which = np.int64(COPY_BELOW)
    y0, x0 = 8 * np.int64(bricks[n, 1]) + PAD, 8 * np.int64(bricks[n, 2]) + PAD
    s = (z - 1) % 3
    full = np.int64(0)
    for y in range(0, 8, 2):
        for x in range(0, 8, 2):
            full += planes.vectors[s, y0 + y, x0 + x, 3] > 0
    full = full // 4
    if _flag(m, full * 4 + inter, inter, 380, 381 + full, 180, which != CODED, mode, state, buffer):
        if inter == 0:
            return np.int64(COPY_BELOW)
        first, second = 256 + full * 4 + inter, 256 + inter
        if not _flag(m, first, second, 386, 387 + full, 181, which != COPY_BELOW, mode, state, buffer):
            return np.int64(COPY_BELOW)
        if inter < 3:
            return np.int64(COPY_PREVIOUS if inter & 1 else COPY_GUESS)
        guessed = _flag(m, 512 + full, np.int64(512), 392, 393 + full, 182, which == COPY_GUESS, mode, state, buffer)
        return np.int64(COPY_GUESS if guessed else COPY_PREVIOUS)
    above = np.int64(0) if links[n, 2] < 0 else max(states[links[n, 2]] - COLUMN + 1, np.int64(0))
    beside = np.int64(0) if n == 0 else max(states[n - 1] - COLUMN + 1, np.int64(0))
    found = np.int64(0)
    for i in range(3):
        first = (1024 + full * 8 + beside) * 16 + (1 << i) + found
        second = (1024 + above * 8 + beside) * 16 + (1 << i) + found
        found = 2 * found + _flag(
            m, first, second, 398, 399 + i, 183 + i, (way >> (2 - i)) & 1, mode, state, buffer
        )  # fmt: skip
    return np.int64(CODED) if found == 0 else np.int64(COLUMN - 1) + min(found, np.int64(5))


@njit(cache=True, nogil=True, error_model="numpy")
def code_frame(
    bricks, layers, low, high, out, original, rule, lattice, border, first, metric, top, start,
    before, ahead, links, ways, models, planes, previous, guess, work, transitions, mode, state, buffer, misses,
):  # fmt: skip
    """Code the samples of the listed bricks.

    Parameters
    ----------
    bricks : int32 [n, 3]
        (z, y, x) in the pass's own axes, ascending.
    layers : int64 [m + 1]
        Where each layer of bricks begins.
    low, high : int64 [3]
        First and last + 1 sample within the grid, (z, y, x).
    out : int32 [n, 8, 8, 8, 3]
        The decoded vectors, filled; zeros at first.
    original : float64 [n, 8, 8, 8, 3]
        What is to be coded, in units; not looked at when decoding.
    rule : float64 [7]
        See `judge`; the last is whether the support may move.
    lattice : int64 [4]
        floor, rate, cross floor, cross rate.
    metric : int64 [5]
        Spacing along x, y, z over the largest, in 1/256; by how many units a force changes over that largest; and
        the share of the mean in the prediction of a chain, of 256.
    top : int64
        No prediction is longer.
    before, ahead : (int32 [k, 3], int64 [m + 1], int32 [k, 8, 8, 8, 3])
        The previous frame and the guess: bricks, layers, vectors; k = 0 where there is none.
    links : int64 [n, 3]
        For each brick its place in `before`, in `ahead`, and the brick of the layer before, or -1.
    ways : int64 [n]
        How the encoder predicts each brick: see `chain_breaks`.
    models : (Mixer, Mixer)
        Of the support and of the residual.
    misses : int64 [...]
        Encoder: ``misses[0]`` is the number of slots that follow.

    Returns
    -------
    status : int
    """
    support, residual = models
    decoding = mode == DECODE
    inter = np.int64(before[0].shape[0] > 0) | np.int64(ahead[0].shape[0] > 0) << 1
    near_a, near_q = np.zeros(13, np.int64), np.zeros(13, np.int64)
    view, taylor, mean = np.zeros(6, np.int64), np.zeros(3, np.int64), np.zeros(3, np.int64)
    cand = np.zeros((CANDIDATES, 3), np.int64)
    expert = np.zeros((EXPERTS, 3), np.int64)
    centre, spread = np.zeros((3, EXPERTS), np.int64), np.zeros((4, EXPERTS), np.int64)
    here = np.zeros(19, np.int64)
    short, costs = np.zeros((SHORT, 3), np.int64), np.zeros((SHORT, 2), np.float64)
    err = np.zeros((EXPERTS, 2), np.int64)
    contexts = np.zeros(RESIDUAL_CONTEXTS, np.int64)
    axes = np.zeros((3, 3), np.int64)
    p = np.zeros(3, np.int64)
    v = np.zeros(3, np.int64)
    o = np.zeros(3, np.float64)
    r = np.zeros(3, np.int64)
    scratch = np.zeros(3, np.int64)
    near, near_w = np.zeros(WINDOW.shape[0], np.int64), np.zeros(WINDOW.shape[0], np.int64)
    states = np.zeros(bricks.shape[0], np.int64)
    last = np.array([0, 0, -start], np.int64)
    m = CANDIDATES - 1 if inter > 0 else ALONE - 1
    capacity = work.kept.shape[0]
    given = np.int64(0)
    length = 0.0
    for layer in range(layers.shape[0] - 1):
        if layers[layer] == layers[layer + 1]:
            continue
        for z in range(8 * layer, 8 * layer + 8):
            if z < low[0] or z >= high[0]:
                continue
            make_plane_empty(planes, z - 2, bricks, layers)
            make_plane_empty(planes, z - 1, bricks, layers)
            make_plane_empty(planes, z, bricks, layers)
            if inter & 1:
                for i in range(-1, 2):
                    fill_plane(previous, z + i, before[0], before[1], before[2])
            if inter & 2:
                for i in range(-1, 2):
                    fill_plane(guess, z + i, ahead[0], ahead[1], ahead[2])
            z0, z1, z2 = z % 3, (z - 1) % 3, (z - 2) % 3
            begin = layers[layer]
            while begin < layers[layer + 1]:
                end = begin
                while end < layers[layer + 1] and bricks[end, 1] == bricks[begin, 1]:
                    end += 1
                for y in range(8 * bricks[begin, 1], 8 * bricks[begin, 1] + 8):
                    if y < low[1] or y >= high[1]:
                        continue
                    yy = np.int64(y) + PAD
                    for n in range(begin, end):
                        if state[PLACE] > (buffer.shape[0] + 8 if decoding else buffer.shape[0] - _ROOM):
                            return ENDED
                        if (z & 7 == 0 or z == low[0]) and (y & 7 == 0 or y == low[1]):
                            states[n] = _code_state(
                                n, states, ways, z, bricks, planes, rule, original, before, ahead, links, inter,
                                residual, mode, state, buffer,
                            )  # fmt: skip
                        for x in range(8 * bricks[n, 2], 8 * bricks[n, 2] + 8):
                            if x < low[2] or x >= high[2]:
                                continue
                            xx = np.int64(x) + PAD
                            if states[n] != CODED and states[n] < COLUMN:
                                _copy(states[n], z, yy, xx, planes, previous, guess, z0, z1, v)
                                if v[0] == 0 and v[1] == 0 and v[2] == 0:
                                    continue
                            else:
                                if not decoding:
                                    o[0] = original[n, z & 7, y & 7, x & 7, 0]
                                    o[1] = original[n, z & 7, y & 7, x & 7, 1]
                                    o[2] = original[n, z & 7, y & 7, x & 7, 2]
                                    length = np.sqrt(o[0] * o[0] + o[1] * o[1] + o[2] * o[2])
                                bits = neighbourhood(
                                    planes,
                                    transitions,
                                    z0,
                                    z1,
                                    yy,
                                    xx,
                                    metric,
                                    near_a,
                                    near_q,
                                    view,
                                    taylor,
                                    mean,
                                    scratch,
                                )
                                c, v16 = support_contexts(
                                    planes, z0, z1, z2, yy, xx, bits, near_q, view, inter, z, z, previous, guess,
                                    support,
                                )  # fmt: skip
                                held = np.int64(length > 0)
                                family = np.int64(0) if inter == 0 else np.int64(1)
                                some = family * 16 + min(view[5], 13) + 2
                                if not decoding and rule[6] > 0 and length <= rule[1] and held:
                                    held = np.int64(predict(support, c, np.int64(1), family, some, v16) > 32768)
                                if c == 2:
                                    family = np.int64(32)
                                held = code_bit(
                                    support, c, np.int64(1), family, some, v16, np.int64(0), held, mode, state, buffer
                                )
                                if view[5] > 0 and (view[5] < 13 or held == 0):
                                    for i in range(13):
                                        if near_a[i] > 0 and NEAR_ONCE[i] > 100:
                                            learn_chance(transitions, near_a[i], near_q[i], held)
                                if held == 0:
                                    continue
                                if view[5] == 0:
                                    if inter & 1 and previous.vectors[z0, yy, xx, 3] > 0:
                                        for k in range(3):
                                            taylor[k] = previous.vectors[z0, yy, xx, k]
                                    else:
                                        for k in range(3):
                                            taylor[k] = last[k]
                                    for k in range(3):
                                        mean[k] = taylor[k]
                                candidates(planes, z, yy, xx, z0, z1, z2, taylor, mean, previous, guess, cand)
                                if inter & 2 and guess.vectors[z0, yy, xx, 3] > 0 and view[5] == 0:
                                    for k in range(3):
                                        cand[0, k] = cand[18, k]
                                size = root(cand[0, 0] ** 2 + cand[0, 1] ** 2 + cand[0, 2] ** 2)
                                step = max(step_at(size, lattice[0], lattice[1]), 1)
                                shift = np.int64(0)
                                while (step >> shift) >= 64:
                                    shift += 1
                                count = 0
                                for i in range(WINDOW.shape[0]):
                                    s = z0 if WINDOW[i, 0] == 0 else (z1 if WINDOW[i, 0] == -1 else z2)
                                    yq, xq = yy + WINDOW[i, 1], xx + WINDOW[i, 2]
                                    if count == SAMPLES:
                                        break
                                    if planes.vectors[s, yq, xq, 3] > 0 and work.marks[s, yq, xq, ROW] >= 0:
                                        near[count] = work.marks[s, yq, xq, ROW]
                                        near_w[count] = WINDOW_WEIGHT[i]
                                        count += 1
                                fit(work, near, near_w, np.int64(count), shift, m, np.int64(4))
                                which = max(states[n] - COLUMN, 0)
                                column(
                                    planes, yy, xx, z0, z1, near_a, near_q, view, metric[3],
                                    which if which < 3 else np.int64(0), cand[0], expert[2],
                                )  # fmt: skip
                                if which == 3:
                                    other(guess, planes, yy, xx, z0, z1, lattice, expert[2])
                                elif which == 4:
                                    other(previous, planes, yy, xx, z0, z1, lattice, expert[2])
                                for k in range(3):
                                    expert[3, k] = cand[1, k]
                                    if inter & 2:
                                        expert[3, k] = cand[19, k]
                                    elif inter & 1:
                                        expert[3, k] = cand[17, k]
                                combine(cand, m, work.sums, np.int64(X), top, expert, np.int64(4))
                                combine(cand, m, work.sums, np.int64(SLOW), top, expert, np.int64(1))
                                for k in range(3):
                                    expert[0, k] = (expert[4, k] + expert[1, k]) >> 1
                                    if states[n] >= COLUMN:
                                        expert[0, k], expert[2, k] = expert[2, k], expert[0, k]
                                        expert[0, k] += ((expert[2, k] - expert[0, k]) * metric[4]) >> 8
                                    p[k] = min(max(expert[0, k], -LIMIT), LIMIT)
                                pn = root(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
                                if pn < 8:
                                    p[2] -= 16
                                    pn = root(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
                                axes_along(p[0], p[1], p[2], pn, axes)
                                step = max(step_at(pn, lattice[0], lattice[1]), 1)
                                given = work.sums[GIVEN, 0]
                                code_residual(
                                    work, residual, planes, z0, z1, yy, xx, near_a, view, cand, m, expert, p, pn,
                                    axes, step, lattice, border, first, rule, o, length, inter, centre, spread, err,
                                    here, contexts, r, v, scratch, short, costs, previous,
                                    np.int64(states[n] >= COLUMN), mode, state, buffer,
                                )  # fmt: skip
                                if not decoding and rule[4] == 0:
                                    e = judge(float(v[0]), float(v[1]), float(v[2]), o[0], o[1], o[2], length, rule)
                                    if e > 1 and misses[0] + 1 < misses.shape[0]:
                                        misses[0] += 1
                                        misses[misses[0]] = ((np.int64(n) * 8 + (z & 7)) * 8 + (y & 7)) * 8 + (x & 7)
                                row = given % capacity
                                work.sums[GIVEN, 0] = given + 1
                                work.marks[z0, yy, xx, ROW] = row
                                for k in range(3):
                                    work.kept[row, m, k] = v[k] - cand[0, k]
                                    for i in range(m):
                                        work.kept[row, i, k] = cand[i + 1, k] - cand[0, k]
                                learn(work, cand, m, shift, v)
                                an = max(np.int64(1), root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))
                                for i in range(13):
                                    if near_a[i] > 0 and NEAR_ONCE[i] > 100:
                                        learn_change(transitions, near_a[i], near_q[i], an - near_a[i])
                            for k in range(3):
                                planes.vectors[z0, yy, xx, k] = v[k]
                                out[n, z & 7, y & 7, x & 7, k] = v[k]
                                last[k] = v[k]
                            planes.vectors[z0, yy, xx, 3] = max(
                                np.int64(1), root(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
                            )
                            if states[n] != CODED and states[n] < COLUMN:
                                work.marks[z0, yy, xx, ROW] = -1
                                work.marks[z0, yy, xx, PINNED] = (
                                    work.marks[z1, yy, xx, PINNED] if planes.vectors[z1, yy, xx, 3] > 0 else 0
                                )
                                for k in range(3):
                                    work.marks[z0, yy, xx, SIZES + k] = 0
                                for k in range(2 * EXPERTS):
                                    work.marks[z0, yy, xx, k] = 4
                begin = end
    return DONE
