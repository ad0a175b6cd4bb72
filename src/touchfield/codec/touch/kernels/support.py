"""Support of a frame: which of its sub-blocks hold a force, and which of their voxels."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.bits import code, mix
from touchfield.codec.kernels.lean import inlined, lean
from touchfield.codec.touch.kernels.predict import ahead, before, held
from touchfield.codec.touch.kernels.residual import CONTEXTS as _RESIDUALS
from touchfield.codec.touch.kernels.residual import SETS as _RESIDUAL_SETS
from touchfield.codec.touch.kernels.window import DEEP, LEFT, LENGTH, LOW, SIDE, UP, WIDTH

__all__ = ["CONTEXTS", "SETS", "code_blocks", "code_brick", "code_held", "look_at_support", "near_of", "then_of"]

_BRICK = _RESIDUALS
_BLOCK = _BRICK + 16
_BIT = _BLOCK + 32 + np.cumsum(np.array([0, 1 << 14, 1 << 15, 1 << 14, 1 << 12, 1 << 11, 1 << 12], np.int64))
CONTEXTS = int(_BIT[6])
SETS = _RESIDUAL_SETS + 32


@lean
def code_brick(bits, last, state):
    """State of a brick that the reference knows: 0 coded, 1 coded with the reference followed, 2 as the reference."""
    if code(bits, _BRICK + last, np.int64(state == 2)):
        return np.int64(2)
    return code(bits, _BRICK + 4 + last, state)


@lean
def _face(window, x, y, z, axis):
    """Whether the 4 x 4 cells before a sub-block, in another brick, hold any force."""
    for i in range(4):
        for j in range(4):
            if axis == 0:
                at = ((x - 1) * SIDE + y + i) * SIDE + z + j
            elif axis == 1:
                at = ((x + i) * SIDE + y - 1) * SIDE + z + j
            else:
                at = ((x + i) * SIDE + y + j) * SIDE + z - 1
            if window[at * WIDTH + LENGTH] > 0:
                return np.int64(1)
    return np.int64(0)


@inlined
def _there(old, x, y, z):
    """Whether the reference holds a force in a sub-block."""
    for i in range(4):
        for j in range(4):
            for k in range(4):
                if old[(((x + i) * SIDE + y + j) * SIDE + z + k) * 4 + 3] > 0:
                    return np.int64(1)
    return np.int64(0)


@lean
def code_blocks(bits, work, known, blocks):
    """Which of the eight sub-blocks of 4 x 4 x 4 voxels hold a force, bit n of `blocks`."""
    window, out = work.window, np.int64(0)
    for n in range(8):
        x, y, z = LOW + 4 * (n >> 2), LOW + 4 * (n >> 1 & 1), LOW + 4 * (n & 1)
        deep = out >> (n - 4) & 1 if n >= 4 else _face(window, x, y, z, 0)
        up = out >> (n - 2) & 1 if n & 2 else _face(window, x, y, z, 1)
        left = out >> (n - 1) & 1 if n & 1 else _face(window, x, y, z, 2)
        then = 1 + _there(work.old, x, y, z) if known else np.int64(0)
        out |= code(bits, _BLOCK + (then << 3 | deep << 2 | up << 1 | left), blocks >> n & 1) << n
    return out


@lean
def near_of(window, here):
    """Which neighbours before a cell, across a face, hold a force: bits 0 to 2, of axes 0 to 2."""
    return held(window, here - DEEP) | held(window, here - UP) << 1 | held(window, here - LEFT) << 2


@lean
def then_of(old, here, known):
    """What the reference says of a voxel: 0 nothing, 1 to 3 no force, 4 to 6 a force, with few or many around."""
    if not known:
        return np.int64(0)
    about = np.int64(0)
    for axis in range(3):
        step = here - before(here, axis)
        about += np.int64(old[(here - step) * 4 + 3] > 0) + np.int64(old[(here + step) * 4 + 3] > 0)
    if old[here * 4 + 3] > 0:
        return 4 + np.int64(about >= 5) + np.int64(about == 6)
    return 1 + np.int64(about >= 1) + np.int64(about >= 3)


@lean
def _bin(length):
    """Class of a length that is likely, of which 3 is none: a 28th of the top each."""
    return min(max(((length * 28) >> 16) + 3, np.int64(0)), np.int64(31))


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
    """Gather the contexts of a voxel's bit of support; returns their set of weights."""
    window = work.window
    deep, up, left = here - DEEP, here - UP, here - LEFT
    mask = near | held(window, deep + UP) << 3 | held(window, deep + LEFT) << 4 | held(window, up + LEFT) << 5
    wide = held(window, deep - UP) | held(window, deep - LEFT) << 1 | held(window, up - LEFT) << 2
    wide |= held(window, deep - DEEP) << 3
    behind = held(window, left - LEFT)
    count = (near & 1) + (near >> 1 & 1) + (near >> 2)
    b_deep = b_up = b_left = np.int64(0)
    likely = wide
    if count:
        t_deep = ahead(window, deep, 0) if near & 1 else np.int64(0)
        t_up = ahead(window, up, 1) if near & 2 else np.int64(0)
        t_left = ahead(window, left, 2) if near & 4 else np.int64(0)
        likely = _bin((t_deep + t_up + t_left) // count)
        b_deep, b_up, b_left = _bin(t_deep) * (near & 1), _bin(t_up) * (near >> 1 & 1), _bin(t_left) * (near >> 2)
    own = np.int64(then >= 4)
    patch = np.int64(0)  # forces in the 3 x 3 cells around the one before, along axis 0
    for i in range(-1, 2):
        for j in range(-1, 2):
            patch += held(window, deep + i * UP + j * LEFT)
    row = held(window, up - LEFT) + (near >> 1 & 1) + held(window, up + LEFT)
    around = _around(work.old, here) if then else np.int64(0)
    b = bits.inputs
    b[0] = _BIT[0] + ((likely << 6 | mask) << 3 | then)
    b[1] = _BIT[1] + (((wide | held(window, up - UP) << 4 | behind << 5) << 6 | mask) << 3 | then)
    b[2] = _BIT[2] + (((b_deep << 4 | b_up >> 1) << 4 | b_left >> 1) << 1 | own)
    b[3] = _BIT[3] + ((around << 3 | near) << 2 | likely >> 3)
    b[4] = _BIT[4] + ((((patch << 2 | row) << 1 | behind) << 1 | near >> 2) << 3 | likely >> 2)
    b[5] = _BIT[5] + ((b_deep << 6 | mask) << 1 | own)
    return _RESIDUAL_SETS + (count << 3 | then)


@lean
def code_held(bits, chosen, bit):
    """Whether a voxel holds a force, of the contexts that `look_at_support` has gathered."""
    return mix(bits, 6, chosen, bit)
