"""Compiled counting of symbols in tables.

One add to a table costs one or two cycles, and waits for an add to the same place just before it: hence four tables,
taken in turn, and eight bytes of symbols loaded at once. Stretches of one symbol, most of a field, take four adds.
Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from touchfield.arrays import Int64s
from touchfield.parallel import for_chunks

_SPAN = 1 << 16
_PAD = 16  # entries between tables, so that they do not share the sets of the cache
_SMALL = 1 << 15  # samples that need no tables
_STRETCH = 1 << 7  # words of eight bytes
_PIECE = 1 << 11  # stretches worth a thread
_ROUND = 1 << 22  # stretches until the 32-bit tables are added up

_FFFF = np.uint64(0xFFFF)
_0, _1, _S, _16, _32, _48 = (np.uint64(i) for i in (0, 1, _STRETCH, 16, 32, 48))  # no sign to check
_ONE, _ALL = np.uint32(1), np.uint32(_STRETCH)


@njit(cache=True, nogil=True)
def _count_words(words, tables):
    """Four 16-bit symbols a word into four tables in turn, uint32 [4, 65552]; `words` are whole stretches."""
    t0, t1, t2, t3 = tables[0], tables[1], tables[2], tables[3]
    for start in range(_0, np.uint64(len(words)), _S):
        first = words[start]
        if first == words[start + _S - _1]:
            differ = _0
            for i in range(start, start + _S):
                differ |= words[i] ^ first
            if differ == _0:
                t0[first & _FFFF] += _ALL
                t1[(first >> _16) & _FFFF] += _ALL
                t2[(first >> _32) & _FFFF] += _ALL
                t3[first >> _48] += _ALL
                continue
        for i in range(start, start + _S):
            v = words[i]
            t0[v & _FFFF] += _ONE
            t1[(v >> _16) & _FFFF] += _ONE
            t2[(v >> _32) & _FFFF] += _ONE
            t3[v >> _48] += _ONE


def counts_of_16_bits(x: NDArray[np.uint16]) -> Int64s:
    """How often each 16-bit word occurs, int64 [65536], of uint16 [n], contiguous and aligned."""
    if len(x) < _SMALL:
        return np.bincount(x, minlength=_SPAN)
    head = min(len(x), (-x.ctypes.data % 8) // 2)
    tail = head + (len(x) - head) // (4 * _STRETCH) * (4 * _STRETCH)
    words = x[head:tail].view(np.uint64)
    total = np.bincount(x[:head], minlength=_SPAN) + np.bincount(x[tail:], minlength=_SPAN)
    stretches = len(words) // _STRETCH
    for start in range(0, stretches, _ROUND):
        some = words[start * _STRETCH :]
        for part in for_chunks(_piece, min(_ROUND, stretches - start), some, chunk=_PIECE):
            total += part
    return total


def _piece(begin: int, end: int, words: Any) -> Int64s:
    tables = np.zeros((4, _SPAN + _PAD), np.uint32)
    _count_words(words[begin * _STRETCH : end * _STRETCH], tables)
    return tables.sum(axis=0, dtype=np.int64)[:_SPAN]


def counts_of_8_bits(x: NDArray[np.uint8]) -> Int64s:
    """How often each byte occurs, int64 [256]: margins of a table of 16-bit words. `x` uint8 [n], contiguous."""
    head = x.ctypes.data % 2
    tail = head + (len(x) - head) // 2 * 2
    counts = np.bincount(x[:head], minlength=256) + np.bincount(x[tail:], minlength=256)
    table = counts_of_16_bits(x[head:tail].view(np.uint16)).reshape(256, 256)
    total: Int64s = counts + table.sum(axis=0) + table.sum(axis=1)
    return total


@njit(cache=True, nogil=True)
def _add(keys, table):
    for i in range(len(keys)):
        table[keys[i]] += 1


def add_counts(keys: Int64s, table: Int64s) -> None:
    """Count `keys` int64 [n] of 0 .. K - 1 into `table` int64 [K]; out of range is the caller's fault."""
    _add(keys, table)
