"""Encoding of a frame: the pass of `decode_pass`, with the choices that the decoder only hears of (floats)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchfield.codec.kernels import mix, price
from touchfield.codec.touch.kernels import decode_pass as shared, voxel, workspace as ws
from touchfield.compute.coder_jit import entry, inlined, lean

ROOM = 1 << 14  # bytes that a brick cannot fill
_AROUND = np.array([0, -1, 1], np.int64)
_LARGER = 0.3  # of the bits, about, of a component that is not zero: those of each step of its size


class Limits(NamedTuple):
    """Bounds of an error, newtons or units; of the passes, less what rounding costs
    (`frame_encoder.limits_for`).
    """

    k: float
    f0: float
    sine: float  # of the direction JND; 0 where only the mask rules
    exact: bool  # the support is kept


@lean
def _size_of(f):
    return np.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])


@lean
def ratio2(f, d0, d1, d2, hidden, rule):
    """The square of |error| / allowed where (d0, d1, d2) stands for `f`, of whose error forces around hide a
    part.
    """
    error2 = (d0 - f[0]) ** 2 + (d1 - f[1]) ** 2 + (d2 - f[2]) ** 2
    if error2 == 0.0:
        return 0.0
    size = _size_of(f)
    allowed = max(rule.f0, rule.k * size + hidden)
    if rule.sine > 0.0:
        if size * rule.sine > rule.f0:
            radial = abs(math.sqrt(d0 * d0 + d1 * d1 + d2 * d2) - size) / allowed
            a, b, c = f[1] * d2 - f[2] * d1, f[2] * d0 - f[0] * d2, f[0] * d1 - f[1] * d0
            turn = math.atan2(math.sqrt(a * a + b * b + c * c), f[0] * d0 + f[1] * d1 + f[2] * d2)
            return max(radial, turn / math.asin(rule.sine)) ** 2
        allowed = rule.f0
    return error2 / (allowed * allowed) if allowed > 0.0 else np.inf


@lean
def kept(d0, d1, d2, f, rule):
    """True where a decoded vector, whole units, may stand for a force; (0, 0, 0) is none.

    `f` is float64 [3], or [4] with what forces around hide of its error.
    """
    if rule.exact and (d0 != 0 or d1 != 0 or d2 != 0) != (f[0] != 0 or f[1] != 0 or f[2] != 0):
        return False
    return (
        ratio2(f, np.float64(d0), np.float64(d1), np.float64(d2), f[3] if f.shape[0] == 4 else 0.0, rule)
        <= 1.0
    )


@lean
def choose(law, work, f, rule):
    """Put the residual of the force `f`, units float64 [3], into the row `STEPS`; the centre is set.

    Of the points around the force the one that likely costs least; the nearest where none keeps the rule.
    """
    rows, level, best = work.rows, work.of[voxel.LEVEL], np.inf
    rows[ws.STEPS] = 0
    along = (
        f[0] * rows[ws.AXES + 0, 0] + f[1] * rows[ws.AXES + 0, 1] + f[2] * rows[ws.AXES + 0, 2]
    ) / 16384.0
    across_1 = (
        f[0] * rows[ws.AXES + 1, 0] + f[1] * rows[ws.AXES + 1, 1] + f[2] * rows[ws.AXES + 1, 2]
    ) / 16384.0
    across_2 = (
        f[0] * rows[ws.AXES + 2, 0] + f[1] * rows[ws.AXES + 2, 1] + f[2] * rows[ws.AXES + 2, 2]
    ) / 16384.0
    reached = ws.level_of(min(np.int64(round(abs(along))), np.int64((1 << 18) - 1)), law.border)
    n0 = np.int64(round(((reached if along >= 0 else -reached) - level) / 256.0))
    for i in range(3):
        r0 = n0 + _AROUND[i]
        step = ws.step_at(abs(ws.amplitude_of(level + 256 * r0, law.border)), law.cross_floor, law.cross_rate)
        n1, n2 = np.int64(round(across_1 / step)), np.int64(round(across_2 / step))
        for j in range(9):
            r1, r2 = n1 + _AROUND[j // 3], n2 + _AROUND[j % 3]
            cost = (r0 != 0) + (r1 != 0) + (r2 != 0) + _LARGER * (abs(r0) + abs(r1) + abs(r2))
            most = max(abs(r0), abs(r1), abs(r2))
            if cost < best and most < 1 << 18 and (most > 0 or work.of[voxel.BASED]):
                voxel.place(law, work, r0, r1, r2)
                is_kept = kept(rows[ws.VECTOR, 0], rows[ws.VECTOR, 1], rows[ws.VECTOR, 2], f, rule)
                if is_kept:
                    best = cost
                if is_kept or i + j == 0:
                    rows[ws.STEPS, 0], rows[ws.STEPS, 1], rows[ws.STEPS, 2] = r0, r1, r2


@lean
def _account(bits, prices, kind):
    """Count the bits since the last account as those of a kind."""
    paid = price(bits)
    prices[kind] += paid - prices[3]
    prices[3] = paid


@entry
def encode_bricks(bits, scan, law, work, forces, rule, prices):
    """Code forces, units float64 [n, 512, 3] in scan order.

    With spatial masking they are [n, 512, 4], see `kept`. ``scan.cells`` takes what the decoder will hold,
    and `prices`, float64 [4], the bits of support, amplitude and direction, and their sum.
    """
    last = np.int64(0)
    for n in range(scan.near.shape[0]):
        known, state = shared.enter(scan, work, n), np.int64(0)
        if known:
            last = state = shared.code_brick(bits, last, _state_of(work.old, forces[n], rule))
        if state == 2:
            ws.copy_reference(work.window, work.old, law.slope)
            ws.keep(work.window, scan.cells, n)
            continue
        blocks = shared.code_blocks(bits, work, known, _blocks_of(forces[n], rule))
        for x in range(scan.low[n, 0], scan.high[n, 0]):
            for y in range(scan.low[n, 1], scan.high[n, 1]):
                for z in range(scan.low[n, 2], scan.high[n, 2]):
                    if blocks >> ((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)) & 1:
                        here = ((x + ws.LOW) * ws.SIDE + y + ws.LOW) * ws.SIDE + z + ws.LOW
                        f = forces[n, (x * 8 + y) * 8 + z]
                        _encode_voxel(bits, law, work, here, known, state, f, rule, prices)
        ws.keep(work.window, scan.cells, n)
    _account(bits, prices, np.int64(0))


@inlined
def _state_of(old, forces, rule):
    """The brick as the reference has it, if that keeps the rule everywhere; else the reference is followed."""
    for at in range(512):
        c = ((((at >> 6) + ws.LOW) * ws.SIDE + (at >> 3 & 7) + ws.LOW) * ws.SIDE + (at & 7) + ws.LOW) * 4
        if not kept(np.int64(old[c]), np.int64(old[c + 1]), np.int64(old[c + 2]), forces[at], rule):
            return np.int64(1)
    return np.int64(2)


@inlined
def _blocks_of(forces, rule):
    """Sub-blocks that hold a force that is to be kept."""
    blocks, least = np.int64(0), 0.0 if rule.exact else rule.f0
    for at in range(512):
        if _size_of(forces[at]) > least:
            blocks |= np.int64(1) << ((at >> 8) * 4 + (at >> 5 & 1) * 2 + (at >> 2 & 1))
    return blocks


@inlined
def _encode_voxel(bits, law, work, here, known, state, f, rule, prices):
    near = shared.near_of(work.window, here)
    then = shared.then_of(work.old, here, known)
    chosen = shared.look_at_support(bits, work, here, near, then)
    bit = mix(bits, np.int64(3), chosen, np.int64(_size_of(f) > (0.0 if rule.exact else rule.f0)))
    if not bit:
        return
    _account(bits, prices, np.int64(0))
    voxel.expect(law, work, here, near, state == 1)
    voxel.look(law, work, here, near)
    expected = work.rows[ws.EXPECTED]
    still = np.int64(kept(expected[0], expected[1], expected[2], f, rule))
    voxel.code_still(bits, work, here, then, still)
    if not still:
        voxel.aim(law, work, here)
        choose(law, work, f, rule)
        for c in range(3):
            voxel.code_step(bits, work, c)
            if c == 0:
                _account(bits, prices, np.int64(1))
    _account(bits, prices, np.int64(1 if still else 2))
    shared.settle(law, work, here, still)


@entry
def compare(mine, forces, theirs, other, rule, hidden, beyond):
    """An original beside what a decoder makes of it, voxel by voxel of both supports, in float64.

    `mine` and `theirs` are the places of the same bricks in both, int64 [n], -1 where one has none, so that
    all is zero; `rule` are `Limits` in newtons; `hidden` what forces around hide, newtons, float32 [bricks of
    the original, 512], or [0, 512]. `beyond`, bool [n, 512], False before, takes the voxels that break the
    rule. Returns the square of the largest share of what is allowed, where in `beyond` that is, and how many
    voxels with a force are within the rule, and decoded ones have a force.
    """
    worst, where, within, decoded = 0.0, -1, 0, 0
    for n in range(mine.shape[0]):
        i, j = mine[n], theirs[n]
        for place in range(512):
            f, u, v, w = (0.0, 0.0, 0.0), 0.0, 0.0, 0.0
            if i >= 0:
                f = 1.0 * forces[i, place, 0], 1.0 * forces[i, place, 1], 1.0 * forces[i, place, 2]
            if j >= 0:
                u, v, w = 1.0 * other[j, place, 0], 1.0 * other[j, place, 1], 1.0 * other[j, place, 2]
            held = f[0] != 0.0 or f[1] != 0.0 or f[2] != 0.0
            sent = u != 0.0 or v != 0.0 or w != 0.0
            around = 1.0 * hidden[i, place] if i >= 0 and hidden.shape[0] else 0.0
            ratio = ratio2(f, u, v, w, around, rule)
            if rule.exact and held != sent:
                ratio = np.inf
            decoded += sent
            within += held and ratio <= 1.0
            beyond[n, place] = ratio > 1.0
            if ratio > worst:
                worst, where = ratio, n << 9 | place
    return worst, where, within, decoded
