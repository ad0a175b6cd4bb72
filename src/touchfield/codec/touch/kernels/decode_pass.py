"""Decoding of a frame: one pass over its bricks in scan order, the support of each, and its voxels."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels import POSITION, code, mix
from touchfield.codec.touch.kernels import voxel, workspace as ws
from touchfield.codec.touch.kernels.voxel import before, held
from touchfield.compute.coder_jit import entry, inlined, lean

_BRICK = voxel.CONTEXTS
_BLOCK = _BRICK + 16
_BIT = _BLOCK + 32 + np.array([0, 1 << 14, 2 << 14], np.int64)
CONTEXTS = int(_BIT[2]) + 4096
SETS = voxel.SETS + 32
_SPARE = 16  # bytes that a code may seem to go on behind its end


@lean
def code_brick(bits, last, state):
    """State of a brick that the reference knows: 0 coded, 1 coded with the reference followed, 2 as the
    reference.
    """
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
    """Opinion of the reference on a voxel: 0 nothing, 1 to 3 no force, 4 to 6 a force, with few or many
    around.
    """
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
        out = (
            out << 2
            | np.int64(old[(here - step) * 4 + 3] > 0) << 1
            | np.int64(old[(here + step) * 4 + 3] > 0)
        )
    return out


@lean
def look_at_support(bits, work, here, near, then):
    """Gather the three contexts of a voxel's bit of support; returns their set of weights."""
    window = work.window
    deep, up, left = here - ws.DEEP, here - ws.UP, here - ws.LEFT
    mask = (
        near
        | held(window, deep + ws.UP) << 3
        | held(window, deep + ws.LEFT) << 4
        | held(window, up + ws.LEFT) << 5
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
def decode_bricks(bits, scan, law, work):
    """Fill ``scan.cells``, as far as the code goes."""
    last = np.int64(0)
    for n in range(scan.near.shape[0]):
        if bits.state[POSITION] > bits.buffer.shape[0] + _SPARE:
            return
        known, state = enter(scan, work, n), np.int64(0)
        if known:
            last = state = code_brick(bits, last, np.int64(0))
        if state == 2:
            ws.copy_reference(work.window, work.old, law.slope)
            ws.keep(work.window, scan.cells, n)
            continue
        blocks = code_blocks(bits, work, known, np.int64(0))
        for x in range(scan.low[n, 0], scan.high[n, 0]):
            for y in range(scan.low[n, 1], scan.high[n, 1]):
                for z in range(scan.low[n, 2], scan.high[n, 2]):
                    if blocks >> ((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)) & 1:
                        here = ((x + ws.LOW) * ws.SIDE + y + ws.LOW) * ws.SIDE + z + ws.LOW
                        _decode_voxel(bits, law, work, here, known, state)
        ws.keep(work.window, scan.cells, n)


@inlined
def _decode_voxel(bits, law, work, here, known, state):
    near = near_of(work.window, here)
    then = then_of(work.old, here, known)
    if not mix(bits, np.int64(3), look_at_support(bits, work, here, near, then), np.int64(0)):
        return
    voxel.expect(law, work, here, near, state == 1)
    voxel.look(law, work, here, near)
    still = voxel.code_still(bits, work, here, then, np.int64(0))
    if not still:
        voxel.aim(law, work, here)
        for c in range(3):
            voxel.code_step(bits, work, c)
    settle(law, work, here, still)
