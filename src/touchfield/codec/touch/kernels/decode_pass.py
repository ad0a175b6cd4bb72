"""Decoding of a frame: one pass over its bricks in scan order, and over the voxels of each."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.bits import PLACE
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

__all__ = ["decode_bricks"]

_SPARE = 16  # bytes that a code may seem to go on behind its end


@entry
def decode_bricks(bits, scan, law, work):
    """Fill ``scan.cells``; False where the code ends too early."""
    last = np.int64(0)
    for n in range(scan.near.shape[0]):
        if bits.state[PLACE] > bits.buffer.shape[0] + _SPARE:
            return False
        load(work.window, scan.cells, scan.near, n)
        known, state = False, np.int64(0)
        if scan.around.shape[0] > 0:
            load_reference(work.old, scan.reference, scan.around, n)
            known = scan.around[n, 13] >= 0
        if known:
            last = state = code_brick(bits, last, np.int64(0))
        if state == 2:
            copy_reference(work.window, work.old, law.slope)
            keep(work.window, scan.cells, n)
            continue
        blocks = code_blocks(bits, work, known, np.int64(0))
        for x in range(scan.low[n, 0], scan.high[n, 0]):
            for y in range(scan.low[n, 1], scan.high[n, 1]):
                for z in range(scan.low[n, 2], scan.high[n, 2]):
                    if blocks >> ((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)) & 1:
                        here = ((x + LOW) * SIDE + y + LOW) * SIDE + z + LOW
                        _decode_voxel(bits, law, work, here, known, state)
        keep(work.window, scan.cells, n)
    return True


@inlined
def _decode_voxel(bits, law, work, here, known, state):
    near = near_of(work.window, here)
    then = then_of(work.old, here, known)
    if not code_held(bits, look_at_support(bits, work, here, near, then), np.int64(0)):
        return
    expect(law, work, here, near, state == 1)
    look(law, work, here, near)
    still = code_still(bits, law, work, here, then, np.int64(0))
    if still:
        for k in range(3):
            work.rows[VECTOR, k] = work.rows[EXPECTED, k]
    else:
        aim(law, work, here)
        for c in range(3):
            code_step(bits, law, work, c)
        place(law, work, work.rows[STEPS, 0], work.rows[STEPS, 1], work.rows[STEPS, 2])
    v0, v1, v2 = work.rows[VECTOR, 0], work.rows[VECTOR, 1], work.rows[VECTOR, 2]
    store(work.window, here, v0, v1, v2, length_of(v0, v1, v2), sizes_of(work, still), law.slope)
    learn(work)
