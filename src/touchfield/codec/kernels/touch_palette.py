"""Compiled loops of the lossless model: who is beside whom, and the symbols of a frame.

One loop serves both directions. A sample is one to twelve symbols, its *planes*. First flags tell whether all of them
are those of the sample before it in time, z, y or x; otherwise each symbol follows bit by bit, from the highest, with
chances of contexts that are mixed on the logistic scale. Whole numbers below 2^53 throughout; floats only count what
the encoder spent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.codec.kernels.mixer import PLACE, SQUASH, STRETCH, Coder, learn, length_of, narrow
from touchfield.codec.kernels.whole_numbers import DONE, ENDED

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["DONE", "ENDED", "FAULT", "code_symbols", "neighbours"]

FAULT = 1
"""Status: a symbol that there is not."""

_HALF_DOMAIN = 3072
_HASH = (1 << 22) - 1
_FACTOR = 0x2F0B4C47  # odd, below 2^30: a product with 22 bits stays below 2^52
_LEAST_TABLE, _LARGEST_TABLE = 1 << 12, 1 << 22

_CANDIDATES = 4
_INPUTS = 14  # contexts of a symbol's bit; flags have the first `_FLAG_INPUTS`
_FLAG_INPUTS = 6
_HASHED = 8  # the first of them know symbols, the others how far the bits are from a predicted number
_AGREEING = _INPUTS - _HASHED + 1
_WIDEST = 20
_MIX_SHIFT = 14


# -- who is beside whom -----------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def _neighbours(slots, bricks_before, place_of, out):
    """``out[i, j]``: the sample before i in z, y, x, zy, zx, yx, or -1."""
    for i in range(slots.shape[0]):
        place_of[slots[i]] = i
    for i in range(slots.shape[0]):
        slot = slots[i]
        brick = slot >> 9
        x, y, z = (slot >> 6) & 7, (slot >> 3) & 7, slot & 7
        for j in range(6):
            dx, dy, dz = np.int64(j == 2 or j >= 4), np.int64(j == 1 or j == 3 or j == 5), np.int64(j in (0, 3, 4))
            b = np.int64(brick)
            if dx > x:
                b = bricks_before[b, 0]
            if b >= 0 and dy > y:
                b = bricks_before[b, 1]
            if b >= 0 and dz > z:
                b = bricks_before[b, 2]
            out[i, j] = -1
            if b >= 0:
                out[i, j] = place_of[(b << 9) | (((x - dx) & 7) << 6) | (((y - dy) & 7) << 3) | ((z - dz) & 7)]


def neighbours(slots: NDArray[np.int64], bricks_before: NDArray[np.int64]) -> NDArray[np.int32]:
    """The samples before each in z, y, x, and diagonally in zy, zx, yx; -1 where none is.

    Parameters
    ----------
    slots : int64 [n]
        Ascending, ``brick * 512 + x * 64 + y * 8 + z``.
    bricks_before : int64 [m, 3]
        For each brick, the brick before it in x, y, z, or -1.

    Returns
    -------
    int32 [n, 6]
    """
    out = np.empty((len(slots), 6), np.int32)
    _neighbours(slots, bricks_before, np.full(len(bricks_before) * 512, -1, np.int32), out)
    return out


# -- symbols ----------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True, inline="always")
def _stir(h, value):
    t = ((h ^ value) & _HASH) * _FACTOR + value
    return (t ^ (t >> 19)) & _HASH


@njit(cache=True, nogil=True, inline="always")
def _bit(at, inputs, chosen, bit, decoding, state, buffer, chances, visits, weights, stretched, spent, kind):
    """Code one bit in the contexts ``at[:inputs]``, mixed by the weights `chosen`, and learn from it."""
    x = np.int64(0)
    for k in range(inputs):
        s = np.int64(STRETCH[np.uint64(chances[at[k]] >> 10)])
        stretched[k] = s
        x += weights[chosen, k] * s
    x >>= 16
    x = min(max(x, np.int64(-_HALF_DOMAIN)), np.int64(_HALF_DOMAIN - 1))
    p = np.int64(SQUASH[np.uint64(x + _HALF_DOMAIN)])
    bit = narrow(p, bit, decoding, state, buffer)
    if not decoding:
        spent[kind] -= np.log2((p if bit else 65536 - p) / 65536)
    error = (bit << 16) - p
    for k in range(inputs):
        weight = weights[chosen, k] + ((stretched[k] * error + (1 << (_MIX_SHIFT - 1))) >> _MIX_SHIFT)
        weights[chosen, k] = min(max(weight, -(1 << 22)), 1 << 22)
        learn(at[k], np.int64(chances[at[k]]), bit, chances, visits)
    return bit


@njit(cache=True, nogil=True, inline="always")
def _same(symbols, i, others, j):
    p = 0
    while p < symbols.shape[1] and symbols[i, p] == others[j, p]:
        p += 1
    return p == symbols.shape[1]


@njit(cache=True, nogil=True, inline="always")
def _symbol(symbols, j, p):
    return np.int64(symbols[j, p]) + 1 if j >= 0 else np.int64(0)


@njit(cache=True, nogil=True)
def _code_symbols(symbols, previous, near, sizes, widths, decoding, state, buffer, chances, visits, weights, spent):
    n, planes = symbols.shape
    mask = np.int64(chances.shape[0] - 1)
    at = np.zeros(_INPUTS, np.int64)
    stretched = np.zeros(_INPUTS, np.int64)
    seeds = np.zeros(_INPUTS, np.int64)
    guesses = np.zeros(_INPUTS, np.int64)
    how = np.zeros(n, np.uint8)  # the candidate that hit, or 4; 5 is "none there"
    timed = previous.shape[0] == n
    for i in range(n):
        jz, jy, jx = near[i, 0], near[i, 1], near[i, 2]
        told = timed and previous[i, 0] >= 0
        # what is known to agree: a bit for each candidate that is there, and for each pair that is equal
        pattern = np.int64(told) | np.int64(jz >= 0) << 1 | np.int64(jy >= 0) << 2 | np.int64(jx >= 0) << 3
        zy = jz >= 0 and jy >= 0 and _same(symbols, jz, symbols, jy)
        zx = jz >= 0 and jx >= 0 and _same(symbols, jz, symbols, jx)
        yx = jy >= 0 and jx >= 0 and _same(symbols, jy, symbols, jx)
        tz = told and jz >= 0 and _same(symbols, jz, previous, i)
        ty = told and jy >= 0 and _same(symbols, jy, previous, i)
        tx = told and jx >= 0 and _same(symbols, jx, previous, i)
        pattern |= np.int64(zy) << 4 | np.int64(zx) << 5 | np.int64(yx) << 6
        pattern |= np.int64(tz) << 7 | np.int64(ty) << 8 | np.int64(tx) << 9
        ways = np.int64(how[jz] if jz >= 0 else 5)
        ways = ways * 6 + (how[jy] if jy >= 0 else 5)
        ways = ways * 6 + (how[jx] if jx >= 0 else 5)
        last = planes - 1
        z0, y0, x0 = _symbol(symbols, jz, 0), _symbol(symbols, jy, 0), _symbol(symbols, jx, 0)
        z1 = _symbol(symbols, jz, last)
        t0 = np.int64(previous[i, 0]) + 1 if told else np.int64(0)
        hit = False
        for c in range(_CANDIDATES):
            if c == 0:
                if not told:
                    continue
            elif c == 1:
                if jz < 0 or tz:
                    continue
            elif c == 2:
                if jy < 0 or zy or ty:
                    continue
            elif jx < 0 or zx or yx or tx:
                continue
            at[0] = _stir(_stir(1, c), pattern) & mask
            at[1] = _stir(_stir(_stir(2, c), ways), pattern & 15) & mask
            at[2] = _stir(_stir(_stir(3, c), z0), z1) & mask
            at[3] = _stir(_stir(_stir(_stir(4, c), y0), x0), z0) & mask
            at[4] = _stir(_stir(_stir(5, c), t0), z0) & mask
            at[5] = _stir(_stir(_stir(6, c), ways), pattern) & mask
            if c == 0:
                bit = np.int64(not decoding and _same(symbols, i, previous, i))
            else:
                bit = np.int64(not decoding and _same(symbols, i, symbols, near[i, c - 1]))
            hit = _bit(
                at, _FLAG_INPUTS, c, bit, decoding, state, buffer, chances, visits, weights, stretched, spent, 0
            )
            if hit:
                how[i] = c
                if decoding:
                    for p in range(planes):
                        symbols[i, p] = previous[i, p] if c == 0 else symbols[near[i, c - 1], p]
                break
        if hit:
            continue
        how[i] = 4
        for p in range(planes):
            width = widths[p]
            z, y, x = _symbol(symbols, jz, p), _symbol(symbols, jy, p), _symbol(symbols, jx, p)
            t = np.int64(previous[i, p]) + 1 if told else np.int64(0)
            one = np.int64(symbols[i, p - 1]) + 1 if p > 0 else np.int64(0)
            two = np.int64(symbols[i, p - 2]) + 1 if p > 1 else np.int64(0)
            base = _stir(7, p)
            seeds[0] = base
            seeds[1] = _stir(_stir(base, 1), z)
            seeds[2] = _stir(_stir(base, 2), y)
            seeds[3] = _stir(_stir(base, 3), x)
            seeds[4] = _stir(_stir(_stir(_stir(base, 4), z), y), x)
            seeds[5] = _stir(_stir(_stir(base, 5), one if p else z), two if p else x)
            seeds[6] = _stir(_stir(_stir(base, 6), t), z)
            seeds[7] = _stir(_stir(_stir(_stir(base, 7), z), one), two)
            # numbers that the symbol may be near to: z, or what else there is; slopes; the mean, or the frame before
            first = z if z else (y if y else (x if x else t))
            third = y if y else (x if x else t)
            guesses[8] = first
            guesses[9] = first
            if z and y and near[i, 3] >= 0:
                guesses[9] = z + y - _symbol(symbols, near[i, 3], p)
            guesses[10] = third if third else first
            if z and x and near[i, 4] >= 0:
                guesses[10] = z + x - _symbol(symbols, near[i, 4], p)
            count = np.int64(z > 0) + np.int64(y > 0) + np.int64(x > 0)
            guesses[11] = t if t else ((z + y + x) // count if count else np.int64(0))
            zz = _symbol(symbols, near[jz, 0], p) if jz >= 0 else np.int64(0)
            yy = _symbol(symbols, near[jy, 1], p) if jy >= 0 else np.int64(0)
            guesses[12] = 2 * z - zz if z and zz else first
            guesses[13] = 2 * y - yy if y and yy else third
            spread = abs(z - y) if z and y else (abs(z - x) if z and x else (abs(y - x) if y and x else np.int64(0)))
            stir = min(length_of(spread), 15)
            for k in range(_HASHED, _INPUTS):
                seeds[k] = _stir(_stir(_stir(base, k), stir if k & 1 else count), np.int64(guesses[k] > 0))
                guesses[k] = min(max(guesses[k] - 1, 0), sizes[p] - 1)
            node = np.int64(1)
            symbol = np.int64(symbols[i, p])
            for left in range(width - 1, -1, -1):
                agree = np.int64(0)
                for k in range(_HASHED):
                    at[k] = _stir(seeds[k], node) & mask
                prefix = node - (np.int64(1) << (width - 1 - left))
                for k in range(_HASHED, _INPUTS):
                    ahead = prefix - (guesses[k] >> (left + 1))
                    ahead = min(max(ahead, -2), 2)
                    agree += np.int64(ahead == 0)
                    below = guesses[k] << 2 >> left & 7
                    at[k] = _stir(seeds[k], ((ahead + 2) * 8 + below) * 32 + left) & mask
                chosen = _CANDIDATES + (p * _WIDEST + left) * _AGREEING + agree
                bit = (symbol >> left) & 1
                bit = _bit(
                    at,
                    _INPUTS,
                    chosen,
                    bit,
                    decoding,
                    state,
                    buffer,
                    chances,
                    visits,
                    weights,
                    stretched,
                    spent,
                    1 + p,
                )
                node = 2 * node + bit
            symbol = node - (np.int64(1) << width)
            if symbol >= sizes[p]:
                return FAULT
            symbols[i, p] = symbol
        if decoding and state[PLACE] > buffer.shape[0]:
            return ENDED
    return DONE


def code_symbols(
    data: NDArray[np.uint8] | None,
    symbols: NDArray[np.int32],
    previous: NDArray[np.int32],
    near: NDArray[np.int32],
    sizes: tuple[int, ...],
) -> tuple[int, Coder, NDArray[np.float64]]:
    """Code the symbols of a frame: read by the encoder, filled in by the decoder.

    Parameters
    ----------
    data : uint8 [size] or None
        What to decode; None to encode.
    symbols : int32 [n, planes]
        Below `sizes`.
    previous : int32 [n, planes] or [0, planes]
        Those of the same samples in the frame before; -1 where there are none.
    near : int32 [n, 6]
        See `neighbours`.
    sizes : int, for each plane
        How many symbols there are, 2^20 at most.

    Returns
    -------
    status : int
    coder : Coder
        Its buffer holds the code.
    spent : float64 [1 + planes]
        Bits of the flags and of each plane, by their chances; zeros of a decoder.
    """
    planes = len(sizes)
    widths = np.array([max(size - 1, 0).bit_length() for size in sizes], np.int64)
    table = _LEAST_TABLE
    while table < min(_LARGEST_TABLE, symbols.size * 16):
        table *= 2
    decoding = data is not None
    # a bit costs 14 bits at most (its chance is 4 of 65536 at least)
    most = (_CANDIDATES + int(widths.sum())) * len(symbols) * 14 // 8 + 64
    coder = Coder(data if data is not None else np.empty(most, np.uint8), decoding, (table, 0), 1)
    weights = np.full((_CANDIDATES + planes * _WIDEST * _AGREEING, _INPUTS), 65536 * 3 // 10, np.int64)
    spent = np.zeros(1 + planes)
    status = _code_symbols(
        symbols,
        previous,
        near,
        np.array(sizes, np.int64),
        widths,
        decoding,
        coder.state,
        coder.buffer,
        coder.chances,
        coder.visits,
        weights,
        spent,
    )
    return int(status), coder, spent
