"""The pass over the bricks of a frame in scan order, the support of each, and its voxels; it reads and writes.

A writer gives a `Truth`, and the choices of `choice` are made. A reader gives None: nothing of them is compiled then.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.codec.kernels import PLACE, READING, TASK, code, mix, price
from touchfield.codec.touch.kernels import choice, voxel
from touchfield.codec.touch.kernels import workspace as ws
from touchfield.codec.touch.kernels.voxel import before, held
from touchfield.lean import entry, inlined, lean

_BRICK = voxel.CONTEXTS
_BLOCK = _BRICK + 16
_BIT = _BLOCK + 32 + np.array([0, 1 << 14, 2 << 14], np.int64)
CONTEXTS = int(_BIT[2]) + 4096
SETS = voxel.SETS + 32
_SPARE = 16  # bytes that a code may seem to go on behind its end
_ROOM = 1 << 14  # bytes that a brick cannot fill


class Truth(NamedTuple):
    """Forces that are to be told, and the rule that they are told by."""

    forces: Float64s  # [n, 512, 3], units in scan order; with spatial masking [n, 512, 4], see `choice.tolerance`
    rule: choice.Limits
    prices: Float64s  # [3]; takes the bits of support, amplitude and direction


@lean
def code_brick(bits, last, state):
    """State of a brick that the reference knows: 0 coded, 1 coded with the reference followed, 2 as the reference."""
    if code(bits, _BRICK + last, np.int64(state == 2)):
        return np.int64(2)
    return code(bits, _BRICK + 4 + last, state)


@lean
def _face(window, first, axis):
    """True where the 4 x 4 cells before a sub-block along an axis, in another brick, hold a force."""
    back, one = first - before(first, axis), ws.UP if axis == 0 else ws.DEEP
    two = ws.UP if axis == 2 else ws.LEFT
    for i in range(4):
        for j in range(4):
            if held(window, first - back + i * one + j * two):
                return np.int64(1)
    return np.int64(0)


@inlined
def _there(old, first):
    """True where the reference holds a force in a sub-block."""
    for n in range(64):
        if old[(first + (n >> 4) * ws.DEEP + (n >> 2 & 3) * ws.UP + (n & 3)) * 4 + 3] > 0:
            return np.int64(1)
    return np.int64(0)


@lean
def code_blocks(bits, work, known, blocks):
    """Code the sub-blocks, of eight of 4 x 4 x 4 voxels, that hold a force: bit n of `blocks`."""
    window, out = work.window, np.int64(0)
    for n in range(8):
        first = (ws.LOW + (n & 4)) * ws.DEEP + (ws.LOW + 2 * (n & 2)) * ws.UP + ws.LOW + 4 * (n & 1)
        sides = np.int64(0)
        for axis in range(3):
            bit = 4 >> axis
            side = out >> (n - bit) & 1 if n & bit else _face(window, first, axis)
            sides = sides << 1 | side
        then = 1 + _there(work.old, first) if known else np.int64(0)
        out |= code(bits, _BLOCK + (then << 3 | sides), blocks >> n & 1) << n
    return out


@lean
def near_of(window, here):
    """Neighbours before a cell, across a face, that hold a force: bits 0 to 2, of axes 0 to 2."""
    return held(window, here - ws.DEEP) | held(window, here - ws.UP) << 1 | held(window, here - ws.LEFT) << 2


@lean
def then_of(old, here, known):
    """Opinion of the reference on a voxel: 0 nothing, 1 to 3 no force, 4 to 6 a force, with few or many around."""
    if not known:
        return np.int64(0)
    about = np.int64(0)
    for axis in range(3):
        step = here - before(here, axis)
        about += np.int64(old[(here - step) * 4 + 3] > 0) + np.int64(old[(here + step) * 4 + 3] > 0)
    if old[here * 4 + 3] > 0:
        return 4 + np.int64(about >= 5) + np.int64(about == 6)
    return 1 + np.int64(about >= 1) + np.int64(about >= 3)


@inlined
def _around(old, here):
    """Where the reference holds forces: here, and before and behind along each axis; 7 bits."""
    out = np.int64(old[here * 4 + 3] > 0)
    for axis in range(3):
        step = here - before(here, axis)
        out = out << 2 | np.int64(old[(here - step) * 4 + 3] > 0) << 1 | np.int64(old[(here + step) * 4 + 3] > 0)
    return out


@lean
def look_at_support(bits, work, here, near, then):
    """Gather the three contexts of a voxel's bit of support; returns their set of weights."""
    window = work.window
    deep, up, left = here - ws.DEEP, here - ws.UP, here - ws.LEFT
    mask = (
        near | held(window, deep + ws.UP) << 3 | held(window, deep + ws.LEFT) << 4 | held(window, up + ws.LEFT) << 5
    )
    wide = held(window, deep - ws.UP) | held(window, deep - ws.LEFT) << 1 | held(window, up - ws.LEFT) << 2
    wide |= held(window, deep - ws.DEEP) << 3 | held(window, left - ws.LEFT) << 4
    count = (near & 1) + (near >> 1 & 1) + (near >> 2)
    likely = wide
    if count:
        total = np.int64(0)
        for axis in range(3):
            if near >> axis & 1:
                total += voxel.ahead(window, before(here, axis), axis)
        # a class of length, of which 3 is none: a 28th of the top each
        likely = min(max((((total // count) * 28) >> 16) + 3, np.int64(0)), np.int64(31))
    around = _around(work.old, here) if then else np.int64(0)
    b = bits.inputs
    b[0] = _BIT[0] + ((likely << 6 | mask) << 3 | then)
    b[1] = _BIT[1] + ((wide << 6 | mask) << 3 | then)
    b[2] = _BIT[2] + ((around << 3 | near) << 2 | likely >> 3)
    return voxel.SETS + (count << 3 | then)


@lean
def enter(scan, work, n):
    """Lay out what is around brick n, and its reference; True if the reference knows the brick."""
    ws.load(work.window, ws.WIDTH, scan.cells, scan.near, n, 2)
    if scan.around.shape[0] == 0:
        return False
    ws.load(work.old, 4, scan.reference, scan.around, n, 1)
    return scan.around[n, 13] >= 0


@inlined
def settle(law, work, here, still):
    """Keep the vector of a voxel, which is as expected or as its residual says, and learn from it."""
    rows = work.rows
    if still:
        for k in range(3):
            rows[ws.VECTOR, k] = rows[ws.EXPECTED, k]
    else:
        voxel.place(law, work, rows[ws.STEPS, 0], rows[ws.STEPS, 1], rows[ws.STEPS, 2])
    v = rows[ws.VECTOR, 0], rows[ws.VECTOR, 1], rows[ws.VECTOR, 2]
    ws.store(work.window, here, v, ws.length_of(*v), voxel.sizes_of(work, still), law.slope)
    voxel.learn(work)


@entry
def code_scan(bits, scan, law, work, truth):
    """Code all bricks; ``scan.cells`` takes what a decoder holds. False where the buffer ends before."""
    last = np.int64(0)
    for n in range(scan.near.shape[0]):
        ends = bits.buffer.shape[0] + (_SPARE if bits.state[TASK] == READING else -_ROOM)
        if bits.state[PLACE] > ends:
            return False
        known, state, blocks = enter(scan, work, n), np.int64(0), np.int64(0)
        if known:
            if truth is not None:
                state = choice.state_of(work.old, truth.forces[n], truth.rule)
            last = state = code_brick(bits, last, state)
        if state == 2:
            ws.copy_reference(work.window, work.old, law.slope)
            ws.keep(work.window, scan.cells, n)
            continue
        if truth is not None:
            blocks = choice.blocks_of(truth.forces[n], truth.rule)
            truth.prices[0] -= price(bits)
        blocks = code_blocks(bits, work, known, blocks)
        if truth is not None:
            truth.prices[0] += price(bits)
        for x in range(scan.low[n, 0], scan.high[n, 0]):
            for y in range(scan.low[n, 1], scan.high[n, 1]):
                for z in range(scan.low[n, 2], scan.high[n, 2]):
                    if blocks >> ((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)) & 1:
                        here = ((x + ws.LOW) * ws.SIDE + y + ws.LOW) * ws.SIDE + z + ws.LOW
                        _code_voxel(bits, law, work, here, known, state, truth, n, (x * 8 + y) * 8 + z)
        ws.keep(work.window, scan.cells, n)
    return True


@inlined
def _code_voxel(bits, law, work, here, known, state, truth, n, at):
    near = near_of(work.window, here)
    then = then_of(work.old, here, known)
    there = still = np.int64(0)
    if truth is not None:
        f, rule, prices, told = truth.forces[n, at], truth.rule, truth.prices, price(bits)
        size = choice.size_of(f)
        there = choice.is_sent(f, size, rule)
    there = mix(bits, 3, look_at_support(bits, work, here, near, then), there)
    if truth is not None:
        told = _paid(bits, prices, 0, told)
    if not there:
        return
    voxel.expect(law, work, here, near, state == 1)
    voxel.look(law, work, here, near)
    if truth is not None:
        expected = work.rows[ws.EXPECTED]
        still = np.int64(choice.kept(expected[0], expected[1], expected[2], f, size, rule))
    still = voxel.code_still(bits, work, here, then, still)
    if truth is not None:
        told = _paid(bits, prices, 1, told)
    if not still:
        voxel.aim(law, work, here)
        if truth is not None:
            choice.choose(law, work, f, size, rule)
        for c in range(3):
            voxel.code_step(bits, work, c)
            if truth is not None:
                told = _paid(bits, prices, min(c, 1) + 1, told)
    settle(law, work, here, still)


@lean
def _paid(bits, prices, part, before):
    """Put what was told since `before` down to a part."""
    now = price(bits)
    prices[part] += now - before
    return now
