"""Compiled loops of the exact mode: a list of numbers, and the samples of a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.codec.kernels.bits import PLACE, READING, TASK, code, even, mix, price
from touchfield.codec.kernels.lean import entry, inlined, lean

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CONTEXTS", "SETS", "VALUE_CONTEXTS", "Frame", "code_frame", "code_numbers"]

VALUE_CONTEXTS: Final = 33 * 64
_OLD: Final = 4096
_COPY: Final = _OLD + 1024
CONTEXTS: Final = _COPY + 4 * 625
"""Chances of a frame in front of the table of hashed ones."""

_MIXED: Final = 20  # bits of a symbol whose chances are learnt; lower ones are even
_COPY_SETS: Final = 8
_SYMBOL_SETS: Final = _COPY_SETS + 4
SETS: Final = _SYMBOL_SETS + 3 * _MIXED

_NEAR: Final = (-144, -12, -1, -143, -13, -11, -156, -288, -24, -132, -131, -2)
_LATE: Final = (0, -1, 1, -12, 12, -144, 144)
_BESIDE: Final = (-1, -12, -144, -13, -145)  # z, y, x, and the corners zy and zx
_NONE, _ABSENT = 4, 5


class Frame(NamedTuple):
    """The samples of a frame, in b bricks of 512.

    Attributes
    ----------
    bricks : int64 [b, 27]
        Places in the list of each brick and of those around it, x slowest; -1 of those not listed.
    inside : int64 [b, 3]
        Samples of a brick within the grid.
    held, places : uint8, int32 [b * 512]
        When writing, 1 where a sample holds a force; the numbers of those already told that do, -1 of all others.
    before : int64 [b * 512, planes] or [0, planes]
        Symbols of the frame before; -1 of a force that the palette has not, -2 without one.
    symbols : int64 [samples, planes]
        Of those that hold a force, by number.
    sizes : int64 [planes]
        How many symbols there are.
    how : uint8 [samples]
        The candidate that each is a copy of, or `_NONE`.
    window, old : int32 [1728]
        `places`, and `before` of the first plane, around a brick, whose first sample is at (2, 2, 2) of 12 x 12 x 12.
    candidates : int64 [6, planes + 1]
        Symbols of the frame before and of the samples beside, -1 without; then which candidate is the same.
    spent : float64 [1 + planes]
        Bits of copies and of each plane.
    """

    bricks: NDArray[np.int64]
    inside: NDArray[np.int64]
    held: NDArray[np.uint8]
    places: NDArray[np.int32]
    before: NDArray[np.int64]
    symbols: NDArray[np.int64]
    sizes: NDArray[np.int64]
    how: NDArray[np.uint8]
    window: NDArray[np.int32]
    old: NDArray[np.int32]
    candidates: NDArray[np.int64]
    spent: NDArray[np.float64]


@lean
def _digits(value):
    n = np.int64(0)
    while value > 0:
        value >>= 1
        n += 1
    return n


@entry
def code_numbers(bits, at, numbers):
    """Numbers below 2^32, int64 [n]: how many binary digits, and the digits behind the first."""
    last = np.int64(0)
    for n in range(numbers.shape[0]):
        count, node = _digits(numbers[n]), np.int64(1)
        for left in range(5, -1, -1):
            node = 2 * node + code(bits, at + 64 * last + node, (count >> left) & 1)
        last = min(node - 64, np.int64(32))
        if last:
            first = np.int64(1) << (last - 1)
            numbers[n] = first | even(bits, numbers[n] & (first - 1), last - 1)


@lean
def _stir(h, value):
    t = ((h ^ value) & 4194303) * 0x2F0B4C47 + value
    return (t ^ (t >> 19)) & 4194303


@inlined
def _gather(f, brick):
    """Fill the windows."""
    timed = f.before.shape[0] > 0
    for n in range(1728):
        x, y, z = n // 144 + 6, n // 12 % 12 + 6, n % 12 + 6
        near = f.bricks[brick, (x >> 3) * 9 + (y >> 3) * 3 + (z >> 3)]
        slot = near << 9 | (x & 7) << 6 | (y & 7) << 3 | (z & 7)
        f.window[n] = f.places[slot] if near >= 0 else -1
        f.old[n] = timed and near >= 0 and f.before[slot, 0] > -2


@inlined
def _held(bits, at, sets, f, here, held):
    """Tell whether a sample holds a force."""
    near, late = np.int64(0), np.int64(0)
    for k in range(12):
        near |= np.int64(f.window[here + _NEAR[k]] >= 0) << k
    for k in range(7):
        late |= np.int64(f.old[here + _LATE[k]]) << k
    bits.inputs[0] = at + near
    bits.inputs[1] = at + _OLD + (late << 3 | near & 7)
    return mix(bits, 2, sets + (near & 7), held)


@inlined
def _copied(bits, at, sets, mask, f, i, here):
    """Tell whether a sample is the same as one of the candidates, and as which."""
    told, planes = f.candidates, f.symbols.shape[1]
    pattern, ways = np.int64(0), np.int64(0)
    for c in range(4):
        same = np.int64(c + 1 if told[c, 0] >= 0 else 0)
        for other in range(c - 1, -1, -1):
            alike = same > 0
            for p in range(planes):
                alike &= told[other, p] == told[c, p]
            if alike:
                same = np.int64(other + 1)
        told[c, planes] = same
        pattern = 5 * pattern + same
        if c:
            n = f.window[here + _BESIDE[c - 1]]
            ways = 6 * ways + (np.int64(f.how[n]) if n >= 0 else np.int64(_ABSENT))
    for c in range(4):
        if told[c, planes] == c + 1:
            bits.inputs[0] = at + _COPY + 625 * c + pattern
            bits.inputs[1] = at + CONTEXTS + (_stir(_stir(c, ways), pattern) & mask)
            bits.inputs[2] = at + CONTEXTS + (_stir(_stir(4 + c, told[0, 0]), told[1, 0]) & mask)
            equal = np.int64(1)
            for p in range(planes):
                equal &= np.int64(f.symbols[i, p] == told[c, p])
            if mix(bits, 3, sets + _COPY_SETS + c, equal):
                for p in range(planes):
                    f.symbols[i, p] = told[c, p]
                return c
    return _NONE


@inlined
def _tell(bits, at, sets, mask, f, i, p):
    """Tell one symbol, from its highest bit on; True if there is such a one."""
    s, told = f.symbols, f.candidates
    t, z, y, x, zy, zx = told[0, p], told[1, p], told[2, p], told[3, p], told[4, p], told[5, p]
    there = np.int64(z >= 0) + np.int64(y >= 0) + np.int64(x >= 0)
    last = y if y >= 0 else (x if x >= 0 else t)
    first = z if z >= 0 else last
    mean = (max(z, np.int64(0)) + max(y, np.int64(0)) + max(x, np.int64(0))) // max(there, np.int64(1))
    spread = abs(z - y) if z >= 0 and y >= 0 else (abs(z - x) if z >= 0 and x >= 0 else np.int64(0))
    guesses = (
        z + y - zy if z >= 0 and y >= 0 and zy >= 0 else first,
        z + x - zx if z >= 0 and x >= 0 and zx >= 0 else (last if last >= 0 else first),
        t if t >= 0 else mean,
    )
    base = _stir(8, 4 * p + there)
    spread = min(_digits(spread), np.int64(15))
    marks = (
        _stir(base, spread), _stir(base, 16 + spread), _stir(base, 32 + spread), _stir(9, p), _stir(_stir(10, p), z),
        _stir(_stir(_stir(11, p), s[i, p - 1] if p else z), s[i, 0] if p > 1 else x),
    )  # fmt: skip
    size, node, symbol = f.sizes[p], np.int64(1), s[i, p]
    width = _digits(size - 1)
    for left in range(width - 1, -1, -1):
        depth = width - 1 - left
        if depth == _MIXED:
            node = node << (left + 1) | even(bits, symbol & ((np.int64(2) << left) - 1), left + 1)
            break
        for k in range(3):
            guess = min(max(guesses[k], np.int64(0)), size - 1)
            ahead = min(max(node - (np.int64(1) << depth) - (guess >> (left + 1)), np.int64(-2)), np.int64(2))
            below = (ahead + 2) * 8 + (guess << 2 >> left & 7)
            bits.inputs[k] = at + CONTEXTS + (_stir(marks[k], below * 32 + left) & mask)
            bits.inputs[3 + k] = at + CONTEXTS + (_stir(marks[3 + k], node) & mask)
        node = 2 * node + mix(bits, 6, sets + _SYMBOL_SETS + _MIXED * p + depth, (symbol >> left) & 1)
    s[i, p] = node - (np.int64(1) << width)
    return s[i, p] < size


@inlined
def _force(bits, at, sets, mask, f, i, slot, here):
    """Tell the force of sample i; True if there is such a one."""
    planes = f.symbols.shape[1]
    for p in range(planes):
        f.candidates[0, p] = max(f.before[slot, p], np.int64(-1)) if f.before.shape[0] else np.int64(-1)
        for k in range(5):
            n = f.window[here + _BESIDE[k]]
            f.candidates[1 + k, p] = f.symbols[n, p] if n >= 0 else -1
    spent = price(bits)
    f.how[i] = _copied(bits, at, sets, mask, f, i, here)
    f.spent[0] += price(bits) - spent
    if f.how[i] == _NONE:
        for p in range(planes):
            spent = price(bits)
            if not _tell(bits, at, sets, mask, f, i, p):
                return False
            f.spent[1 + p] += price(bits) - spent
    return True


@entry
def code_frame(bits, at, sets, mask, f):
    """The samples of all bricks, z fastest; how many hold a force, or -1 after a symbol that there is not."""
    i = np.int64(0)
    for brick in range(f.bricks.shape[0]):
        if bits.state[TASK] == READING and bits.state[PLACE] > bits.buffer.shape[0] + 6:
            return -1
        _gather(f, brick)
        for n in range(512):
            x, y, z = n >> 6, n >> 3 & 7, n & 7
            if x < f.inside[brick, 0] and y < f.inside[brick, 1] and z < f.inside[brick, 2]:
                slot, here = brick << 9 | n, (x * 12 + y) * 12 + z + 314
                if _held(bits, at, sets, f, here, np.int64(f.held[slot])):
                    if not _force(bits, at, sets, mask, f, i, slot, here):
                        return -1
                    f.window[here] = f.places[slot] = i
                    i += 1
    return i
