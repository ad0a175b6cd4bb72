"""Compiled counting of symbols: tables, filled at about the speed of memory.

One add to a table costs one or two cycles, and waits for an add to the same place just before it. Hence several
tables, taken in turn; eight bytes of symbols loaded at once; and, where the symbols lie within a window of 128, one
add for a *pair* of them, into a table of pairs whose margins are the counts. The window is a guess from a few
samples; every stretch of the data is checked against it before it is counted, so that the counts are exact.

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
_SIDE = 1 << 7  # symbols of the window; the table of their pairs stays in the second-level cache eight times
_PAD = 16  # entries between tables, so that they do not share the sets of the cache
_NARROW = 1 << 13  # symbols nearer together than this: eight tables of them stay in that cache, too
_COMMON = 1 / 16  # share of a symbol
_SAMPLES = 1 << 12  # looked at for a plan
_SMALL = 1 << 15  # samples that need none
_PIECE = 1 << 18  # words of eight bytes worth a thread
_ROUND = 1 << 30  # words until the 32-bit tables are added up: a table takes at most four adds a word
_STRETCH = 64  # words made into pairs at once: few, so that memory is read while others are counted

_H = np.uint64(0x8000800080008000)
_LOW = np.uint64(0x7FFF7FFF7FFF7FFF)
_BEYOND = np.uint64(0xFF80FF80FF80FF80)
_FOLD = np.uint64(16 - 7)
_PAIRS = np.uint64(0x00003FFF00003FFF)
_U16, _U32, _U48 = np.uint64(16), np.uint64(32), np.uint64(48)
_FFFF = np.uint64(0xFFFF)
_ONE = np.uint32(1)


@njit(cache=True, nogil=True)
def _count_words(begin, end, words, table, stride):
    """Four 16-bit symbols a word into eight tables, `stride` apart; stride 0 makes them one."""
    t0, t1, t2, t3 = table, table[stride:], table[2 * stride :], table[3 * stride :]
    t4, t5, t6, t7 = table[4 * stride :], table[5 * stride :], table[6 * stride :], table[7 * stride :]
    i = begin
    while i + 1 < end:
        v, w = words[i], words[i + 1]
        t0[v & _FFFF] += _ONE
        t1[(v >> _U16) & _FFFF] += _ONE
        t2[(v >> _U32) & _FFFF] += _ONE
        t3[v >> _U48] += _ONE
        t4[w & _FFFF] += _ONE
        t5[(w >> _U16) & _FFFF] += _ONE
        t6[(w >> _U32) & _FFFF] += _ONE
        t7[w >> _U48] += _ONE
        i += 2
    if i < end:
        v = words[i]
        t0[v & _FFFF] += _ONE
        t1[(v >> _U16) & _FFFF] += _ONE
        t2[(v >> _U32) & _FFFF] += _ONE
        t3[v >> _U48] += _ONE


@njit(cache=True, nogil=True)
def _count_pairs(begin, end, words, base, table, stride):
    """Pairs of 16-bit symbols of base .. base + 127 into eight tables; returns where it met another symbol, or `end`.

    `base` holds the lowest symbol in each of its four lanes. A stretch is first made into the numbers of its pairs,
    two a word, by a loop that the compiler makes vectors of, and looked at for symbols outside the window.
    """
    t0, t1, t2, t3 = table, table[stride:], table[2 * stride :], table[3 * stride :]
    t4, t5, t6, t7 = table[4 * stride :], table[5 * stride :], table[6 * stride :], table[7 * stride :]
    low, flip = base & _LOW, (base & _H) ^ _H
    pairs = np.zeros(_STRETCH, np.uint64)
    for start in range(begin, end, _STRETCH):
        some = words[start : min(end, start + _STRETCH)]
        seen, differ, first = np.uint64(0), np.uint64(0), some[0]
        for i in range(len(some)):
            v = some[i]
            differ |= v ^ first
            v = ((v | _H) - low) ^ ((v & _H) ^ flip)  # lane by lane, without borrows
            seen |= v
            pairs[i] = (v | (v >> _FOLD)) & _PAIRS
        if seen & _BEYOND:
            return start
        if differ == 0:  # empty space, most of a field: counted without adding it up
            t0[pairs[0] & _FFFF] += np.uint32(len(some))
            t1[pairs[0] >> _U32] += np.uint32(len(some))
            continue
        for i in range(0, len(some) - 3, 4):
            a, b, c, d = pairs[i], pairs[i + 1], pairs[i + 2], pairs[i + 3]
            t0[a & _FFFF] += _ONE
            t1[a >> _U32] += _ONE
            t2[b & _FFFF] += _ONE
            t3[b >> _U32] += _ONE
            t4[c & _FFFF] += _ONE
            t5[c >> _U32] += _ONE
            t6[d & _FFFF] += _ONE
            t7[d >> _U32] += _ONE
        for i in range(len(some) // 4 * 4, len(some)):
            t0[pairs[i] & _FFFF] += _ONE
            t1[pairs[i] >> _U32] += _ONE
    return end


def _plan(x: NDArray[np.uint16]) -> tuple[int, bool, int]:
    """From a few samples: the lowest symbol of a window for pairs, whether there is one, and the stride of words.

    Many tables pay where all of them fit the cache, or where one symbol is so common that one table would wait.
    """
    cells = np.linspace(0, len(x) - 1, _SAMPLES + 1).astype(np.int64)
    jitter = np.arange(_SAMPLES) * 2_654_435_761 % (cells[1] - cells[0] + 1)  # so that no period of the data is met
    few = x[np.minimum(cells[:-1] + jitter, len(x) - 1)]
    low, spread = int(few.min()), int(few.max()) - int(few.min())
    turned = few ^ np.uint16(0x8000)  # so that -3 .. 3, seen as 65533 .. 3, lie together
    if (turned_spread := int(turned.max()) - int(turned.min())) < spread:
        low, spread = int(turned.min()) ^ 0x8000, turned_spread
    common = np.bincount(few).max() > _COMMON * len(few)
    stride = _SPAN + _PAD if common or spread < _NARROW else 0
    return (low - (_SIDE - 1 - spread) // 2) % _SPAN, spread < _SIDE, stride  # as much room below as above


def counts_of_16_bits(x: NDArray[np.uint16]) -> NDArray[np.int64]:
    """How often each 16-bit word occurs, int64 [65536].

    `x` uint16 [n], contiguous and aligned.
    """
    if len(x) < _SMALL:
        return np.bincount(x, minlength=_SPAN)
    total = np.zeros(_SPAN, np.int64)
    head = min(len(x), (-x.ctypes.data % 8) // 2)
    tail = head + (len(x) - head) // 4 * 4
    words = x[head:tail].view(np.uint64)
    for rest in (x[:head], x[tail:]):
        total += np.bincount(rest, minlength=_SPAN)
    low, narrow, stride = _plan(x)
    for start in range(0, len(words), _ROUND):
        some = words[start : start + _ROUND]
        for part in for_chunks(_piece, len(some), some, low, narrow, stride, chunk=_PIECE):
            total += part
    return total


def _piece(begin: int, end: int, words: Any, low: int, narrow: bool, stride: int) -> NDArray[np.int64]:
    counts = np.zeros(_SPAN, np.int64)
    if narrow:
        apart = _SIDE * _SIDE + _PAD
        pairs = np.zeros(8 * apart, np.uint32)
        begin = int(_count_pairs(begin, end, words, np.uint64(low * 0x0001000100010001), pairs, apart))
        table = pairs.reshape(8, apart)[:, :-_PAD].sum(axis=0, dtype=np.int64).reshape(_SIDE, _SIDE)
        counts[(low + np.arange(_SIDE)) % _SPAN] = table.sum(axis=0) + table.sum(axis=1)
    if begin < end:
        tables = np.zeros((8 if stride else 1) * (_SPAN + _PAD), np.uint32)
        _count_words(begin, end, words, tables, stride)
        for table in tables.reshape(-1, _SPAN + _PAD):
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
