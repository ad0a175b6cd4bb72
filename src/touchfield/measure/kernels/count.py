"""Compiled counting of symbols: tables, filled at about the speed of memory.

One add to a table costs one or two cycles, and waits for an add to the same place just before it. Hence several
tables, taken in turn; eight bytes of symbols loaded at once; and, where the symbols lie within a window of 64 or 128,
one add for a *pair* of them, into a table of pairs whose margins are the counts. The first window is a guess from a
few samples. Every stretch of the data is checked against it: one with a symbol outside is counted symbol by symbol,
and after many such the rest of the block gets a window of its own, or none. The counts are exact in any case.

Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["add_counts", "counts_of_8_bits", "counts_of_16_bits"]

_SPAN = 1 << 16
_FEW, _MOST = 6, 7  # bits of a symbol in a window: two tables of pairs fit the first-level cache, or the second
_SIDE = 1 << _MOST
_PAD = 16  # entries between tables, so that they do not share the sets of the cache
_APART = _SIDE * _SIDE + _SIDE // 2  # of pairs; half a row, so that the middles of the rows do not share them either
_NARROW = 1 << 13  # symbols nearer together than this: several tables of them stay in the second-level cache, too
_COMMON = 1 / 16  # share of a symbol
_COMMON_OF_PAIRS = 1 / 3
_ALIKE = 1 / 64  # chance that two symbols are the same; below it, pairs are spread over more than the nearest cache
_SAMPLES = 1 << 12  # looked at for a plan
_SMALL = 1 << 15  # samples that need none
_STRETCH = 1 << 7  # words of eight bytes made into pairs at once
_BLOCK = 1 << 15  # words with one window; adding up the tables of pairs takes a small part of counting them
_MISSES = 4  # stretches of a block outside its window, and one for 8 within, until another is looked for
_PIECE = 1 << 11  # stretches worth a thread
_ROUND = 1 << 22  # stretches until the 32-bit tables are added up: a table takes at most four adds a word
_AHEAD = np.uint64(512)  # words: how far ahead memory is asked for while pairs are counted, and it would be idle
_LINE = np.uint64(8)  # words of a line of the cache

_H = np.uint64(0x8000800080008000)
_LOW = np.uint64(0x7FFF7FFF7FFF7FFF)
_LANES = np.uint64(0x0001000100010001)
_HALVES = np.uint64(0x0000000100000001)
_U16, _U32, _U48 = np.uint64(16), np.uint64(32), np.uint64(48)
_FFFF = np.uint64(0xFFFF)
_0, _1, _2, _3, _4, _S = (np.uint64(i) for i in (0, 1, 2, 3, 4, _STRETCH))  # no sign to check
_ONE = np.uint32(1)


@njit(cache=True, nogil=True)
def _count_words(words, table, tables):
    """Four 16-bit symbols a word into 1, 4 or 8 tables in turn; `words` are whole stretches."""
    s = (_SPAN + _PAD) * (tables > 1)
    t0, t1, t2, t3 = table, table[s:], table[2 * s :], table[3 * s :]
    s4 = 4 * s * (tables > 4)
    t4, t5, t6, t7 = table[s4:], table[s4 + s :], table[s4 + 2 * s :], table[s4 + 3 * s :]
    for start in range(_0, np.uint64(len(words)), _S):
        first = words[start]
        if first == words[start + _S - _1]:
            differ = _0
            for i in range(start, start + _S):
                differ |= words[i] ^ first
            if differ == _0:
                t0[first & _FFFF] += np.uint32(_STRETCH)
                t1[(first >> _U16) & _FFFF] += np.uint32(_STRETCH)
                t2[(first >> _U32) & _FFFF] += np.uint32(_STRETCH)
                t3[first >> _U48] += np.uint32(_STRETCH)
                continue
        for i in range(start, start + _S, _2):
            v, w = words[i], words[i + _1]
            t0[v & _FFFF] += _ONE
            t1[(v >> _U16) & _FFFF] += _ONE
            t2[(v >> _U32) & _FFFF] += _ONE
            t3[v >> _U48] += _ONE
            t4[w & _FFFF] += _ONE
            t5[(w >> _U16) & _FFFF] += _ONE
            t6[(w >> _U32) & _FFFF] += _ONE
            t7[w >> _U48] += _ONE


@njit(cache=True, nogil=True)
def _count_pairs(words, low, bits, table, tables, counts):
    """Pairs of symbols of low .. low + 2^bits - 1 into 2 or 4 tables; `words` are whole stretches.

    Returns the words read, and a number that says nothing, but keeps the loads ahead. Stretches with a symbol outside
    the window go to `counts`.
    A stretch is first made into the numbers of its pairs, two a word, by a loop that the compiler makes vectors of,
    and looked at for symbols outside the window.
    """
    s = _APART * (tables > 2)
    t0, t1, t2, t3 = table, table[_APART:], table[2 * s :], table[2 * s + _APART :]
    side, lows = np.uint64(1) << np.uint64(bits), np.uint64(low) * _LANES
    base, flip = lows & _LOW, (lows & _H) ^ _H
    beyond, kept, fold = (_FFFF ^ (side - _1)) * _LANES, (side * side - _1) * _HALVES, np.uint64(16 - bits)
    pairs = np.zeros(_STRETCH, np.uint64)
    missed, paired, ahead, last = 0, 0, _0, np.uint64(len(words) - 1)
    for start in range(_0, np.uint64(len(words)), _S):
        seen, differ, first = _0, _0, words[start]
        for i in range(_0, _S):
            v = words[start + i]
            differ |= v ^ first
            v = ((v | _H) - base) ^ ((v & _H) ^ flip)  # lane by lane, without borrows
            seen |= v
            pairs[i] = (v | (v >> fold)) & kept
        if seen & beyond:
            if missed > _MISSES + paired // 8:
                return np.int64(start), ahead
            missed += 1
            for i in range(start, start + _S):
                v = words[i]
                counts[v & _FFFF] += 1
                counts[(v >> _U16) & _FFFF] += 1
                counts[(v >> _U32) & _FFFF] += 1
                counts[v >> _U48] += 1
            continue
        if differ == _0:  # empty space, most of a field: counted without adding it up
            t0[pairs[_0] & _FFFF] += np.uint32(_STRETCH)
            t1[pairs[_0] >> _U32] += np.uint32(_STRETCH)
            continue
        paired += 1
        for line in range(_0, _S, _LINE):
            ahead |= words[min(start + _AHEAD + line, last)]
            for i in range(line, line + _LINE, _4):
                a, b, c, d = pairs[i], pairs[i + _1], pairs[i + _2], pairs[i + _3]
                t0[a & _FFFF] += _ONE
                t1[a >> _U32] += _ONE
                t2[b & _FFFF] += _ONE
                t3[b >> _U32] += _ONE
                t0[c & _FFFF] += _ONE
                t1[c >> _U32] += _ONE
                t2[d & _FFFF] += _ONE
                t3[d >> _U32] += _ONE
    return len(words), ahead


@njit(cache=True, nogil=True)
def _add_margins(low, bits, table, tables, counts):
    """Add the symbols of the tables of pairs to `counts`, and clear the tables."""
    side = 1 << bits
    for t in range(tables):
        for high in range(side):
            row = table[t * _APART + (high << bits) :][:side]
            total = 0
            for i in range(side):
                total += row[i]
                counts[(low + i) % _SPAN] += row[i]
                row[i] = 0
            counts[(low + high) % _SPAN] += total


@njit(cache=True, nogil=True)
def _range(symbols, side):
    """The lowest symbol, and how far above it the highest lies; looked at no further once that is `side` or more.

    Distances from the first symbol, modulo 2^16, so that neither -3 .. 3 nor 32766 .. 32770 is a wide range.
    """
    first, least, most = symbols[0], np.int16(0), np.int16(0)
    for start in range(0, len(symbols), 4 * _STRETCH):
        some = symbols[start : start + 4 * _STRETCH]
        for i in range(len(some)):
            distance = np.int16(some[i] - first)
            least, most = min(least, distance), max(most, distance)
        if most - least >= side:
            break
    return (first + least) % _SPAN, most - least


@njit(cache=True, nogil=True)
def _window(low, spread, wide):
    """The lowest symbol of a window and its bits: as much room below as above."""
    bits = _MOST if wide or spread >= 1 << _FEW else _FEW
    return (low - ((1 << bits) - 1 - spread) // 2) % _SPAN, bits


@njit(cache=True, nogil=True)
def _count_blocks(words, low, bits, side, pairs, tables, singles, tables_of_singles, counts):
    """Count block after block, in pairs where a window fits; `bits` 0 is none yet, `side` the largest.

    Returns whether `singles` was used.
    """
    used = False
    for start in range(0, len(words), _BLOCK):
        block = words[start : start + _BLOCK]
        if bits:
            read, _ = _count_pairs(block, low, bits, pairs, tables, counts)
            block = block[read:]
        if len(block):
            lowest, spread = _range(block.view(np.int16), side)
            if spread < side:
                if bits:
                    _add_margins(low, bits, pairs, tables, counts)
                # one of 64 that did not hold is followed by one of 128, lest the next does not hold either
                low, bits = _window(lowest, spread, bits > 0 and side > 1 << _FEW)
                _count_pairs(block, low, bits, pairs, tables, counts)
            else:
                _count_words(block, singles, tables_of_singles)
                used = True
    if bits:
        _add_margins(low, bits, pairs, tables, counts)
    return used


def _plan(x: NDArray[np.uint16]) -> tuple[int, int, int, int, int]:
    """From a few samples: the window of pairs and the largest (see `_count_blocks`), and the tables of either kind.

    Two tables of pairs fit the cache; four pay where one symbol is so common that fewer would wait. Of single
    symbols, four pay where all of them fit the cache, and then eight where one is common.
    """
    cells = np.linspace(0, len(x) - 1, _SAMPLES + 1).astype(np.int64)
    jitter = np.arange(_SAMPLES) * 2_654_435_761 % (cells[1] - cells[0] + 1)  # so that no period of the data is met
    few = x[np.minimum(cells[:-1] + jitter, len(x) - 1)]
    spread = min(int(np.ptp(few)), int(np.ptp(few ^ np.uint16(0x8000))))  # turned, so that -3 .. 3 lie together
    shares = np.bincount(few) / len(few)
    side = _SIDE if (shares**2).sum() > _ALIKE else 1 << _FEW
    lowest, narrow = _range(few.view(np.int16), side)
    low, bits = _window(lowest, narrow, False) if narrow < side else (0, 0)
    tables = 8 if shares.max() > _COMMON else 4 if spread < _NARROW else 1
    return low, bits, side, 4 if shares.max() > _COMMON_OF_PAIRS else 2, tables


def counts_of_16_bits(x: NDArray[np.uint16]) -> NDArray[np.int64]:
    """How often each 16-bit word occurs, int64 [65536].

    `x` uint16 [n], contiguous and aligned.
    """
    if len(x) < _SMALL:
        return np.bincount(x, minlength=_SPAN)
    total = np.zeros(_SPAN, np.int64)
    head = min(len(x), (-x.ctypes.data % 8) // 2)
    tail = head + (len(x) - head) // (4 * _STRETCH) * (4 * _STRETCH)
    words = x[head:tail].view(np.uint64)
    for rest in (x[:head], x[tail:]):
        total += np.bincount(rest, minlength=_SPAN)
    plan = _plan(x)
    stretches = len(words) // _STRETCH
    for start in range(0, stretches, _ROUND):
        some = words[start * _STRETCH :]
        for part in for_chunks(_piece, min(_ROUND, stretches - start), some, *plan, chunk=_PIECE):
            total += part
    return total


def _piece(
    begin: int, end: int, words: Any, low: int, bits: int, side: int, of_pairs: int, tables: int
) -> NDArray[np.int64]:
    counts = np.zeros(_SPAN, np.int64)
    pairs, singles = np.zeros(of_pairs * _APART, np.uint32), np.zeros(tables * (_SPAN + _PAD), np.uint32)
    if _count_blocks(
        words[begin * _STRETCH : end * _STRETCH], low, bits, side, pairs, of_pairs, singles, tables, counts
    ):
        for table in singles.reshape(-1, _SPAN + _PAD):
            counts += table[:_SPAN]
    return counts


def counts_of_8_bits(x: NDArray[np.uint8]) -> NDArray[np.int64]:
    """How often each byte occurs, int64 [256]: margins of a table of 16-bit words. `x` uint8 [n], contiguous."""
    head = x.ctypes.data % 2
    tail = head + (len(x) - head) // 2 * 2
    counts = np.bincount(x[:head], minlength=256) + np.bincount(x[tail:], minlength=256)
    table = counts_of_16_bits(x[head:tail].view(np.uint16)).reshape(256, 256)
    total: NDArray[np.int64] = counts + table.sum(axis=0) + table.sum(axis=1)
    return total


@njit(cache=True, nogil=True)
def _add(keys, table):
    for i in range(len(keys)):
        table[keys[i]] += 1


def add_counts(keys: NDArray[np.int64], table: NDArray[np.int64]) -> None:
    """Count `keys` int64 [n] of 0 .. K - 1 into `table` int64 [K]; out of range is the caller's fault."""
    _add(keys, table)
