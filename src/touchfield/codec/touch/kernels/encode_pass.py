"""Encoding of a frame: the pass of `decode_pass`, with the choices that the decoder only hears of."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.bits import PLACE, PRICING, TASK, WRITING, mixed_chance, price
from touchfield.codec.touch.kernels.choice import choose, fits, kept, still_pays, tolerance
from touchfield.codec.touch.kernels.predict import expect, learn
from touchfield.codec.touch.kernels.residual import aim, code_step, code_still, look, place, sizes_of
from touchfield.codec.touch.kernels.support import (
    code_blocks,
    code_brick,
    code_held,
    look_at_support,
    near_of,
    then_of,
)  # fmt: skip
from touchfield.codec.touch.kernels.window import (
    LOW,
    SIDE,
    copy_reference,
    keep,
    length_of,
    load,
    load_reference,
    store,
)  # fmt: skip
from touchfield.codec.touch.kernels.workspace import EXPECTED, STEPS, VECTOR
from touchfield.lean import entry, inlined

__all__ = ["encode_bricks"]

_ROOM = 1 << 14  # bytes that a brick cannot fill


@entry
def encode_bricks(bits, scan, law, work, forces, rule, prices):
    """Code forces, units float64 [n, 512, 3] in scan order; False where the buffer is too short.

    ``scan.cells`` takes what the decoder will hold, and `prices`, float64 [3], the bits of support,
    amplitude and direction.
    """
    last = np.int64(0)
    for n in range(scan.near.shape[0]):
        if bits.state[PLACE] + _ROOM > bits.buffer.shape[0]:
            return False
        load(work.window, scan.cells, scan.near, n)
        known, state = False, np.int64(0)
        if scan.around.shape[0] > 0:
            load_reference(work.old, scan.reference, scan.around, n)
            known = scan.around[n, 13] >= 0
        if known:
            last = state = code_brick(bits, last, _state_of(work.old, forces[n], rule))
        if state == 2:
            copy_reference(work.window, work.old, law.slope)
            keep(work.window, scan.cells, n)
            continue
        paid = price(bits)
        blocks = code_blocks(bits, work, known, _blocks_of(forces[n], rule))
        prices[0] += price(bits) - paid
        for x in range(scan.low[n, 0], scan.high[n, 0]):
            for y in range(scan.low[n, 1], scan.high[n, 1]):
                for z in range(scan.low[n, 2], scan.high[n, 2]):
                    if blocks >> ((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)) & 1:
                        here = ((x + LOW) * SIDE + y + LOW) * SIDE + z + LOW
                        f = forces[n, (x * 8 + y) * 8 + z]
                        _encode_voxel(bits, law, work, here, known, state, f, rule, prices)
        keep(work.window, scan.cells, n)
    return True


@inlined
def _state_of(old, forces, rule):
    """The brick as the reference has it, if that keeps the rule; it is followed if it does so at half the voxels."""
    count = agrees = 0
    whole = True
    for at in range(512):
        c = ((((at >> 6) + LOW) * SIDE + (at >> 3 & 7) + LOW) * SIDE + (at & 7) + LOW) * 4
        f = forces[at]
        if old[c + 3] == 0 and f[0] == 0 and f[1] == 0 and f[2] == 0:
            continue
        d0, d1, d2 = np.int64(0), np.int64(0), np.int64(0)
        if old[c + 3] > 0:
            d0, d1, d2 = np.int64(old[c]), np.int64(old[c + 1]), np.int64(old[c + 2])
        here = fits(d0, d1, d2, f, rule)
        count += 1
        agrees += here
        whole = whole and here
    if whole:
        return np.int64(2)
    return np.int64(2 * agrees >= count)


@inlined
def _blocks_of(forces, rule):
    """Sub-blocks that hold a force that is to be kept."""
    blocks = np.int64(0)
    for at in range(512):
        f0, f1, f2 = forces[at, 0], forces[at, 1], forces[at, 2]
        square = f0 * f0 + f1 * f1 + f2 * f2
        if square > 0 and (rule.exact or square > rule.f0 * rule.f0):
            blocks |= np.int64(1) << ((at >> 8) * 4 + (at >> 5 & 1) * 2 + (at >> 2 & 1))
    return blocks


@inlined
def _worth_holding(bits, law, work, here, near, trusted, f, chosen, rule):
    """True for a force that may be left away, or made, and should be: where its bit would cost too much."""
    size = np.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    if rule.exact or size > rule.f0 or size > tolerance(size, rule):
        return np.int64(size > 0)
    chance = mixed_chance(bits, 3, chosen)
    if size > 0 and chance < 45000:
        return np.int64(0)
    if chance > 55000:
        expect(law, work, here, near, trusted)
        return np.int64(kept(work.rows[EXPECTED, 0], work.rows[EXPECTED, 1], work.rows[EXPECTED, 2], f, size, rule))
    return np.int64(size > 0)


@inlined
def _encode_voxel(bits, law, work, here, known, state, f, rule, prices):
    near = near_of(work.window, here)
    then = then_of(work.old, here, known)
    begun = price(bits)
    chosen = look_at_support(bits, work, here, near, then)
    bit = _worth_holding(bits, law, work, here, near, state == 1, f, chosen, rule)
    bit = code_held(bits, chosen, bit)
    told = price(bits)
    prices[0] += told - begun
    if not bit:
        return
    expect(law, work, here, near, state == 1)
    look(law, work, here, near)
    size = np.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    still = np.int64(kept(work.rows[EXPECTED, 0], work.rows[EXPECTED, 1], work.rows[EXPECTED, 2], f, size, rule))
    if rule.free:
        bits.state[TASK], bits.cost[0] = PRICING, 0.0
        code_still(bits, law, work, here, then, np.int64(1))
        still = still_pays(bits, law, work, here, f, size, rule)
        bits.state[TASK] = WRITING
    code_still(bits, law, work, here, then, still)
    prices[1] += price(bits) - told
    told = price(bits)
    if still:
        for k in range(3):
            work.rows[VECTOR, k] = work.rows[EXPECTED, k]
    else:
        aim(law, work, here)
        choose(bits, law, work, here, f, size, rule)
        for c in range(3):
            code_step(bits, law, work, c)
            if c == 0:
                prices[1] += price(bits) - told
                told = price(bits)
        place(law, work, work.rows[STEPS, 0], work.rows[STEPS, 1], work.rows[STEPS, 2])
    prices[2] += price(bits) - told
    v0, v1, v2 = work.rows[VECTOR, 0], work.rows[VECTOR, 1], work.rows[VECTOR, 2]
    store(work.window, here, v0, v1, v2, length_of(v0, v1, v2), sizes_of(work, still), law.slope)
    learn(work)
