"""Compiled loops of the Huffman coder: lengths by package-merge, and bits written and read through tables.

Bits are kept in words of 32, most significant first. Status numbers below zero are errors of the caller's data.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["EXHAUSTED", "INVALID", "canonical_codes", "decode", "decoder_table", "encode", "limited_lengths"]

INVALID = -1
"""Status: a symbol without a code, or bits that are none."""
EXHAUSTED = -2
"""Status: the bits end too early."""

FIRST_LEVEL = 12
MAX_LENGTH = 24


@njit(cache=True, nogil=True)
def _limited_lengths(weights, limit):
    n = weights.shape[0]
    chosen = np.zeros((limit, 2 * n), np.bool_)  # which items of each level are symbols, not packages
    level = np.empty(2 * n, np.int64)
    before = np.empty(2 * n, np.int64)
    size = 0
    for row in range(limit):
        packages = size // 2
        before, level = level, before
        leaf = package = 0
        size = n + packages
        for place in range(size):
            take = package >= packages
            if not take and leaf < n:
                take = weights[leaf] <= before[2 * package] + before[2 * package + 1]
            chosen[row, place] = take
            if take:
                level[place] = weights[leaf]
                leaf += 1
            else:
                level[place] = before[2 * package] + before[2 * package + 1]
                package += 1
    lengths = np.zeros(n, np.uint8)
    wanted = 2 * n - 2
    for row in range(limit - 1, -1, -1):
        leaves = 0
        for place in range(wanted):
            if chosen[row, place]:
                lengths[leaves] += 1
                leaves += 1
        wanted = 2 * (wanted - leaves)
    return lengths


def limited_lengths(weights: NDArray[np.int64], limit: int = MAX_LENGTH) -> NDArray[np.uint8]:
    """Optimal code lengths of at most `limit` bits (package-merge), uint8 [n].

    `weights` int64 [n] ascending and positive, 2 <= n <= 2^limit.
    """
    lengths: NDArray[np.uint8] = _limited_lengths(weights, limit)
    return lengths


@njit(cache=True, nogil=True)
def _canonical_codes(lengths, codes, order):
    first = np.zeros(MAX_LENGTH + 2, np.int64)  # first code of each length
    start = np.zeros(MAX_LENGTH + 2, np.int64)  # where its symbols begin in `order`
    count = np.zeros(MAX_LENGTH + 2, np.int64)
    for symbol in range(lengths.shape[0]):
        count[lengths[symbol]] += 1
    count[0] = 0
    for bits in range(1, MAX_LENGTH + 1):
        first[bits] = (first[bits - 1] + count[bits - 1]) << 1
        start[bits] = start[bits - 1] + count[bits - 1]
    place = np.zeros(MAX_LENGTH + 2, np.int64)
    for symbol in range(lengths.shape[0]):
        bits = lengths[symbol]
        if bits:
            codes[symbol] = ((first[bits] + place[bits]) << 5) | bits
            order[start[bits] + place[bits]] = symbol
            place[bits] += 1
    return first, start, count


@njit(cache=True, nogil=True)
def _first_level(codes, table):
    for symbol in range(codes.shape[0]):
        bits = codes[symbol] & 31
        if 0 < bits <= FIRST_LEVEL:
            spare = FIRST_LEVEL - bits
            begin = (codes[symbol] >> 5) << spare
            for place in range(begin, begin + (1 << spare)):
                table[place] = (symbol << 5) | bits


def canonical_codes(lengths: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Per symbol its code and its length, ``code << 5 | length``, uint32 [n]; 0 for absent symbols."""
    codes = np.zeros(len(lengths), np.uint32)
    _canonical_codes(lengths, codes, np.empty(len(lengths), np.uint16))
    return codes


def decoder_table(lengths: NDArray[np.uint8]) -> tuple[NDArray[np.uint32], NDArray[np.uint16], NDArray[np.int64]]:
    """What the decoder looks things up in.

    Returns
    -------
    table : uint32 [4096]
        By the next 12 bits: ``symbol << 5 | length``, or 0 where the code is longer or there is none.
    order : uint16 [n]
        Symbols in the order of their codes.
    walk : int64 [3, 26]
        By length: first code, place of its symbol in `order`, number of codes.
    """
    codes = np.zeros(len(lengths), np.uint32)
    order = np.zeros(max(1, len(lengths)), np.uint16)
    walk = np.stack(_canonical_codes(lengths, codes, order))
    table = np.zeros(1 << FIRST_LEVEL, np.uint32)
    _first_level(codes, table)
    return table, order, walk


@njit(cache=True, nogil=True)
def _encode(symbols, codes, words):
    held = filled = place = np.int64(0)
    for m in range(symbols.shape[0]):
        symbol = symbols[m]
        if not 0 <= symbol < codes.shape[0]:
            return INVALID
        entry = np.int64(codes[symbol])
        bits = entry & 31
        if bits == 0:
            return INVALID
        held = (held << bits) | (entry >> 5)
        filled += bits
        if filled >= 32:
            filled -= 32
            words[place] = held >> filled
            held &= (1 << filled) - 1
            place += 1
    if filled:
        words[place] = held << (32 - filled)
    return place * 32 + filled


def encode(symbols: NDArray[np.uint16], codes: NDArray[np.uint32], words: NDArray[np.uint32]) -> int:
    """Write the codes of `symbols` to `words`; the number of bits, or `INVALID`."""
    return int(_encode(symbols, codes, words))


@njit(cache=True, nogil=True)
def long_code(held, filled, order, walk):
    """Symbol and length of a code longer than the first level, ``symbol << 5 | length``, or `INVALID`."""
    for bits in range(FIRST_LEVEL + 1, MAX_LENGTH + 1):
        rank = ((held >> (filled - bits)) & ((1 << bits) - 1)) - walk[0, bits]
        if 0 <= rank < walk[2, bits]:
            return (np.int64(order[walk[1, bits] + rank]) << 5) | bits
    return INVALID


@njit(cache=True, nogil=True)
def _decode(words, bit_length, table, order, walk, symbols):
    held = filled = place = np.int64(0)
    for m in range(symbols.shape[0]):
        if filled < MAX_LENGTH:
            word = np.int64(0)
            if place < words.shape[0]:
                word = np.int64(words[place])
            held = (held << 32) | word  # what was used is pushed out at the top, and masked when looked at
            filled += 32
            place += 1
        entry = np.int64(table[(held >> (filled - FIRST_LEVEL)) & ((1 << FIRST_LEVEL) - 1)])
        if entry == 0:
            entry = long_code(held, filled, order, walk)
            if entry < 0:
                return INVALID
        filled -= entry & 31
        symbols[m] = entry >> 5
    used = place * 32 - filled
    return EXHAUSTED if used > bit_length else used


def decode(
    words: NDArray[np.uint32],
    bit_length: int,
    tables: tuple[NDArray[np.uint32], NDArray[np.uint16], NDArray[np.int64]],
    symbols: NDArray[np.uint16],
) -> int:
    """Fill `symbols` from `words`; the number of bits used, `INVALID` or `EXHAUSTED`."""
    return int(_decode(words, bit_length, *tables, symbols))
