"""Compiled loop of the exact mode: the samples of a frame (docs/format/touch-exact.md, "Samples")."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.codec.kernels import (
    LIST_CONTEXTS as _TABLE,
    LIST_SETS as _SETS,
    POSITION,
    READING,
    TASK,
    mix,
    price,
)
from touchfield.compute.coder_jit import entry, inlined, lean

_SIZE: Final = 1 << 18
_BESIDE: Final = (
    (0, 0, -1), (0, -1, 0), (-1, 0, 0), (0, -1, -1), (-1, 0, -1), (-1, -1, 0), (0, -1, 1), (-1, 1, 0), (-1, 0, 1),
    (0, 0, -2), (0, -2, 0), (-2, 0, 0),
)  # fmt: skip
ROWS: Final = 3 + len(_BESIDE)
_NONE: Final = ROWS - 1
CONTEXTS, SETS = _TABLE + _SIZE, _SETS + 96 + ROWS
"""Those of the list of bricks, and behind them a table of hashed contexts, and sets of weights."""


class Frame(NamedTuple):
    """The samples of a frame, in b bricks of 512."""

    # [b, 27]; places in the list of a brick and of those around it, x slowest; -1 of those not listed, or
    # told later
    near: Int64s
    inside: Int64s  # [b, 3]; samples of a brick within the grid
    # symbols, before: [b * 512, planes]; of each sample, and of the same one in the frame before; -1 without
    # a force
    symbols: Int64s
    before: Int64s
    sizes: Int64s  # [planes]; how many symbols there are
    rows: Int64s  # [ROWS, planes]; symbols of a sample itself, of the frame before, of those beside; and none
    spent: Float64s  # [3]; bits of support, of copies and the first plane, and of the other planes


@lean
def _hash(h, value):
    t = ((h ^ value) & 4194303) * 0x2F0B4C47 + value
    return (t ^ (t >> 19)) & 4194303


@lean
def _context(h, value):
    return _TABLE + (_hash(h, value) & (_SIZE - 1))


@inlined
def _gather(f, brick, x, y, z):
    """Fill the rows."""
    slot = brick << 9 | x << 6 | y << 3 | z
    for p in range(f.sizes.shape[0]):
        f.rows[0, p], f.rows[1, p], f.rows[_NONE, p] = f.symbols[slot, p], f.before[slot, p], -1
    for k in range(len(_BESIDE)):
        a, b, c = x + _BESIDE[k][0], y + _BESIDE[k][1], z + _BESIDE[k][2]
        place = f.near[brick, ((a + 8) >> 3) * 9 + ((b + 8) >> 3) * 3 + ((c + 8) >> 3)]
        beside = (a & 7) << 6 | (b & 7) << 3 | (c & 7)
        for p in range(f.sizes.shape[0]):
            f.rows[2 + k, p] = f.symbols[place << 9 | beside, p] if place >= 0 else -1


@lean
def _alike(rows, row):
    """Rows that hold the same symbols as a row, by bits."""
    same = np.int64(0)
    for other in range(ROWS):
        alike = np.int64(1)
        for p in range(rows.shape[1]):
            alike &= np.int64(rows[other, p] == rows[row, p])
        same |= alike << other
    return same


@lean
def _about(kind, guess, node, left):
    """The context of a bit that `left` others follow, by how far the number lies from a guess."""
    ahead = min(max(node - (guess >> (left + 1)), np.int64(-2)), np.int64(2))
    return _context(kind, ((ahead + 2) * 8 + (guess << 2 >> left & 7)) * 32 + left)


@inlined
def _tell(bits, f, p):
    """Tell one symbol, from its highest bit on; True if there is such a one."""
    t, z, y, x, zy = f.rows[1, p], f.rows[2, p], f.rows[3, p], f.rows[4, p], f.rows[5, p]
    size, symbol, node, width = f.sizes[p], f.rows[0, p], np.int64(0), np.int64(0)
    guess = z if z >= 0 else (y if y >= 0 else (x if x >= 0 else max(t, np.int64(0))))
    if z >= 0 and y >= 0 and zy >= 0:
        guess = min(max(z + y - zy, np.int64(0)), size - 1)
    late = t if t >= 0 else guess
    by_z = _hash(np.int64(40 + p), z)
    by_x = _hash(_hash(np.int64(44 + p), f.rows[0, p - 1] if p else np.int64(0)), x)
    while size - 1 >> width:
        width += 1
    for left in range(width - 1, -1, -1):
        bits.inputs[0] = _about(np.int64(32 + p), guess, node, left)
        bits.inputs[1] = _about(np.int64(36 + p), late, node, left)
        bits.inputs[2] = _context(by_z, node << 5 | left)
        bits.inputs[3] = _context(by_x, node << 5 | left)
        chosen = _SETS + 32 * p + width - 1 - left
        node = 2 * node + mix(bits, np.int64(4), chosen, symbol >> left & 1)
    f.rows[0, p] = node
    return node < size


@inlined
def _sample(bits, f, slot):
    """Tell a sample, of which the rows are known; True if it has such symbols."""
    spent = price(bits)
    for c in (_NONE, 1, 2, 3, 4):
        same = _alike(f.rows, c)
        first = np.int64(c == _NONE)
        if first or (f.rows[c, 0] >= 0 and same & ((1 << c) - 2) == 0):
            bits.inputs[0] = _context(np.int64(c), same >> 1)
            bits.inputs[1] = _context(
                _hash(np.int64(16 + c), same >> 1 & 31), _alike(f.rows, np.int64(2)) >> 1
            )
            alike = mix(bits, np.int64(2), _SETS + 96 + c, same & 1)
            f.spent[1 - first] += price(bits) - spent
            spent = price(bits)
            if alike:
                for p in range(f.sizes.shape[0]):
                    f.symbols[slot, p] = f.rows[c, p]
                return True
    for p in range(f.sizes.shape[0]):
        if not _tell(bits, f, p):
            return False
        f.symbols[slot, p] = f.rows[0, p]
        f.spent[1 + min(p, 1)] += price(bits) - spent
        spent = price(bits)
    return True


@entry
def code_samples(bits, f):
    """The samples of all bricks, z fastest; False after a symbol that there is not, or the end of the bytes."""
    for brick in range(f.near.shape[0]):
        if bits.state[TASK] == READING and bits.state[POSITION] > bits.buffer.shape[0] + 6:
            return False
        for n in range(512):
            x, y, z = n >> 6, n >> 3 & 7, n & 7
            if x < f.inside[brick, 0] and y < f.inside[brick, 1] and z < f.inside[brick, 2]:
                _gather(f, brick, x, y, z)
                if not _sample(bits, f, brick << 9 | n):
                    return False
    return True
