"""Compiled block motion of the coder `touch`: one block fetched from the frame before, and the code of its vectors.

Whole numbers only. Displacements are in quarters of a voxel; trilinear weights are multiples of 1/64, and the 64
times 17 bits of a sum stay far below 2^53. One loop codes the vectors in both directions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.codec.kernels.mixer import PLACE, Coder, length_of, mixed, narrow

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "DONE",
    "ENDED",
    "FAULT",
    "LIMIT",
    "QUARTERS",
    "REACH",
    "code_vectors",
    "fetch",
    "fetch_blocks",
    "held_blocks",
    "motion_coder",
    "rows_of",
    "slots_around",
]

DONE = 0
FAULT = 1
"""Status: a displacement beyond its limit."""
ENDED = 2
"""Status: the bits end too early."""

QUARTERS = 4
"""Steps of a displacement in a voxel."""

REACH = 16
"""Voxels that a block is displaced at most, along each axis."""

LIMIT = QUARTERS * REACH
_WHOLE = QUARTERS**3
_EDGE = 8
_SPAN = 2  # bricks that the 9 samples of a block of 8 can touch, along an axis

LONGEST = 8
"""Binary digits of the largest residual, 2 `LIMIT`."""

NODES = 16
_FLAGS, _PATTERNS = 8, 54  # contexts of the flag "moves": neighbours that move, and which of them
CONTEXTS = (NODES * (_FLAGS + 12), NODES * (_PATTERNS + 15))
"""Contexts of the two models: by the neighbours that move; by which they are, or by the residual before."""


@njit(cache=True, nogil=True)
def slots_around(keys, counts, first, table):
    """The slot of each brick from brick coordinates `first` on, -1 where there is none; int32 ``table[a, b, c]``.

    `keys` are those of `brick_keys`, ascending, and `counts` the bricks along each axis of the grid.
    """
    table[:] = -1
    n = keys.shape[0]
    z_begin = max(first[2], 0)
    z_end = min(first[2] + table.shape[2], counts[2])
    for i in range(table.shape[0]):
        x = first[0] + i
        if x < 0 or x >= counts[0]:
            continue
        for j in range(table.shape[1]):
            y = first[1] + j
            if y < 0 or y >= counts[1]:
                continue
            base = (x * counts[1] + y) * counts[2]
            low, high = 0, n
            while low < high:
                middle = (low + high) >> 1
                if keys[middle] < base + z_begin:
                    low = middle + 1
                else:
                    high = middle
            while low < n and keys[low] < base + z_end:
                table[i, j, keys[low] - base - first[2]] = low
                low += 1


@njit(cache=True, nogil=True)
def rows_of(vectors):
    """Where bricks hold a force: bit z of int64 ``[n, 8, 8]``."""
    n = vectors.shape[0]
    rows = np.zeros((n, _EDGE, _EDGE), np.int64)
    for s in range(n):
        for x in range(_EDGE):
            for y in range(_EDGE):
                row = np.int64(0)
                for z in range(_EDGE):
                    v = vectors[s, x, y, z]
                    row |= np.int64((v[0] | v[1] | v[2]) != 0) << z
                rows[s, x, y] = row
    return rows


@njit(cache=True, nogil=True)
def fetch(x, y, z, table, vectors, least, out):
    """``out`` = the force at quarters (x, y, z) >= 0 from the first sample of `table`; whether there is one.

    `vectors` is flat here, 1536 numbers a brick.

    Only corners with a force count, and at least half of the weight must be on such: the support ends as sharply
    as it did. A result shorter than `least` is none.
    """
    i, j, k = x >> 2, y >> 2, z >> 2
    fx, fy, fz = x & 3, y & 3, z & 3
    weight = np.int64(0)
    s0 = s1 = s2 = np.int64(0)
    for a in range(1 + (fx > 0)):
        wx = fx if a else QUARTERS - fx
        bx, lx = (i + a) >> 3, (i + a) & 7
        for b in range(1 + (fy > 0)):
            wy = wx * (fy if b else QUARTERS - fy)
            by, ly = (j + b) >> 3, (j + b) & 7
            for c in range(1 + (fz > 0)):
                slot = table[bx, by, (k + c) >> 3]
                if slot < 0:
                    continue
                at = 3 * ((np.int64(slot) << 9) + (lx << 6) + (ly << 3) + ((k + c) & 7))
                v0, v1, v2 = np.int64(vectors[at]), np.int64(vectors[at + 1]), np.int64(vectors[at + 2])
                if v0 == 0 and v1 == 0 and v2 == 0:
                    continue
                w = wy * (fz if c else QUARTERS - fz)
                weight += w
                s0 += w * v0
                s1 += w * v1
                s2 += w * v2
    if 2 * weight < _WHOLE:
        return False
    half = weight >> 1
    s0 = (s0 + half) // weight
    s1 = (s1 + half) // weight
    s2 = (s2 + half) // weight
    if s0 * s0 + s1 * s1 + s2 * s2 < least * least:
        return False
    out[0], out[1], out[2] = s0, s1, s2
    return True


@njit(cache=True, nogil=True)
def held_blocks(bricks, rows, shift):
    """The blocks of 2^shift samples, 4 or 8, in which bricks hold a force, int64 [m, 3], in no order."""
    n = bricks.shape[0]
    per = _EDGE >> shift
    size = 1 << shift
    ones = (1 << size) - 1
    out = np.empty((n * per * per * per, 3), np.int64)
    m = 0
    for s in range(n):
        for a in range(per):
            for b in range(per):
                row = np.int64(0)
                for x in range(size):
                    for y in range(size):
                        row |= rows[s, a * size + x, b * size + y]
                for c in range(per):
                    if (row >> (c * size)) & ones:
                        out[m, 0] = bricks[s, 0] * per + a
                        out[m, 1] = bricks[s, 1] * per + b
                        out[m, 2] = bricks[s, 2] * per + c
                        m += 1
    return out[:m].copy()


# -- one block moved --------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _row(table, rows, x, y, z, size):
    """Bit i: whether there is a force at sample (x, y, z + i) of the table, i up to `size`."""
    row = np.int64(0)
    for k in range(z >> 3, ((z + size) >> 3) + 1):
        slot = table[x >> 3, y >> 3, k]
        if slot >= 0:
            row |= rows[slot, x & 7, y & 7] << (k * _EDGE)
    return row >> z


@njit(cache=True, nogil=True)
def fetch_blocks(blocks, moves, shift, before, least, shape, slots, out, held):
    """Write moved blocks into bricks `slots` of ``out[n, 8, 8, 8, 3]``; ``held[n]`` tells which got a force.

    `before` is (keys, vectors, rows, bricks along each axis) of the previous frame, `shape` the grid's samples.
    """
    keys, bricks, rows, counts = before
    vectors = bricks.reshape(-1)
    size = 1 << shift
    first = np.empty(3, np.int64)
    local = np.empty(3, np.int64)
    begin = np.empty(3, np.int64)
    vector = np.zeros(3, np.int64)
    table = np.empty((_SPAN, _SPAN, _SPAN), np.int32)
    masks = np.empty((size + 1, size + 1), np.int64)
    for i in range(blocks.shape[0]):
        for c in range(3):
            begin[c] = blocks[i, c] << shift
            start = begin[c] + (moves[i, c] >> 2)
            first[c] = start >> 3
            local[c] = start & 7
        slots_around(keys, counts, first, table)
        fx, fy, fz = moves[i, 0] & 3, moves[i, 1] & 3, moves[i, 2] & 3
        for x in range(size + 1):
            for y in range(size + 1):
                masks[x, y] = _row(table, rows, local[0] + x, local[1] + y, local[2], size)
        u, v, w = begin[0] & 7, begin[1] & 7, begin[2] & 7
        slot = slots[i]
        out[slot, u : u + size, v : v + size, w : w + size] = 0
        within = (np.int64(1) << min(size, shape[2] - begin[2])) - 1
        for x in range(min(size, shape[0] - begin[0])):
            for y in range(min(size, shape[1] - begin[1])):
                row = masks[x, y]
                if fx:
                    row |= masks[x + 1, y]
                if fy:
                    row |= masks[x, y + 1]
                if fx and fy:
                    row |= masks[x + 1, y + 1]
                if fz:
                    row |= row >> 1
                row &= within
                z = 0
                while row >> z:
                    if (row >> z) & 1:
                        p, q, r = (local[0] + x) * 4 + fx, (local[1] + y) * 4 + fy, (local[2] + z) * 4 + fz
                        if fetch(p, q, r, table, vectors, least, vector):
                            out[slot, u + x, v + y, w + z, 0] = vector[0]
                            out[slot, u + x, v + y, w + z, 1] = vector[1]
                            out[slot, u + x, v + y, w + z, 2] = vector[2]
                            held[slot] = True
                    z += 1


# -- the code of the displacements ------------------------------------------------------------------------


def motion_coder(buffer: NDArray[np.uint8], *, decoding: bool) -> Coder:
    """A coder with the contexts of displacements."""
    return Coder(buffer, decoding, CONTEXTS, NODES)


@njit(cache=True, nogil=True)
def _bit(node, first, second, bit, decoding, state, buffer, chances, visits, weights):
    a, b = first * NODES + node, CONTEXTS[0] + second * NODES + node
    return mixed(a, b, node, bit, decoding, state, buffer, chances, visits, weights)


@njit(cache=True, nogil=True)
def _code_residual(r, first, second, decoding, state, buffer, chances, visits, weights):
    """A residual: is it zero, its sign, its length one by one, then what is below its top bit."""
    model = (decoding, state, buffer, chances, visits, weights)
    if _bit(0, first, second, np.int64(r != 0), *model) == 0:
        return np.int64(0)
    sign = _bit(1, first, second, np.int64(r < 0), *model)
    size = abs(r)
    known = length_of(size)
    length = 1
    while length < LONGEST and _bit(1 + length, first, second, np.int64(known > length), *model):
        length += 1
    found = np.int64(1)
    for place in range(length - 2, -1, -1):
        bit = (size >> place) & 1
        if place == length - 2:
            bit = _bit(NODES // 2 - 1 + length, first, second, bit, *model)
        else:
            bit = narrow(np.int64(32768), bit, decoding, state, buffer)
        found = (found << 1) | bit
    return -found if sign else found


@njit(cache=True, nogil=True)
def _middle(a, b, c):
    return max(min(a, b), min(max(a, b), c))


@njit(cache=True, nogil=True)
def _code(neighbours, held, moved, moves, decoding, state, buffer, chances, visits, weights):
    model = (decoding, state, buffer, chances, visits, weights)
    last = -1
    near = np.empty(3, np.int64)
    for i in range(moved.shape[0]):
        n = 0
        pattern = np.int64(0)
        for h in range(3):
            j = neighbours[i, h]
            pattern = 3 * pattern + (0 if j < 0 else 1 + np.int64(moved[j]))
            if j >= 0 and moved[j]:
                near[n] = j
                n += 1
        flag = _bit(0, 2 * n + np.int64(held[i]), 2 * pattern + np.int64(held[i]), np.int64(moved[i]), *model)
        moved[i] = flag != 0
        if decoding and state[PLACE] > buffer.shape[0]:
            return ENDED
        if flag == 0:
            continue
        if n == 0 and last >= 0:
            near[0] = last
        size = 0
        for c in range(3):
            guess = np.int64(0)
            if n == 3:
                guess = _middle(moves[near[0], c], moves[near[1], c], moves[near[2], c])
            elif n or last >= 0:
                guess = moves[near[0], c]
            first = _FLAGS + 4 * c + n
            second = _PATTERNS + 5 * c + min(size, 4)
            r = _code_residual(moves[i, c] - guess, first, second, *model)
            value = guess + r
            if abs(value) > LIMIT:
                return FAULT
            moves[i, c] = value
            size = length_of(abs(r)) if c == 0 else max(size, length_of(abs(r)))
        if moves[i, 0] == 0 and moves[i, 1] == 0 and moves[i, 2] == 0:
            return FAULT
        last = i
    return DONE


def code_vectors(
    coder: Coder,
    neighbours: NDArray[np.int64],
    held: NDArray[np.bool_],
    moved: NDArray[np.bool_],
    moves: NDArray[np.int64],
) -> int:
    """Code which blocks move, and where from: read by the encoder, filled in by the decoder; returns a status.

    Parameters
    ----------
    coder : Coder
    neighbours : int64 [n, 3]
        The blocks before each one along z, y and x; -1 for none.
    held : bool [n]
        Whether a block held a force in the frame before.
    moved : bool [n]
    moves : int64 [n, 3]
        Quarters of a voxel, not all zero where a block moves. Both zeros for the decoder.
    """
    c = coder
    models = c.chances, c.visits, c.weights
    return int(_code(neighbours, held, moved, moves, c.decoding, c.state, c.buffer, *models))
