"""Compiled loops of the amplitude stream: runs of held samples found, written and read back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.codec.kernels.huffman import EXHAUSTED, FIRST_LEVEL, INVALID, MAX_LENGTH, long_code

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["OVERRUN", "decode", "encode", "pack", "unpack"]

OVERRUN = -3
"""Status: the symbols stand for more samples than there are."""

TOP_RUN = 20


@njit(cache=True, nogil=True)
def _pack(sent, levels, level_count, top, symbols, values, bits):
    count = level = place = 0
    while place < sent.shape[0]:
        if sent[place]:
            symbols[count] = levels[level]
            values[count] = 0
            bits[count] = 0
            level += 1
            count += 1
            place += 1
            continue
        begin = place
        while place < sent.shape[0] and not sent[place]:
            place += 1
        run = place - begin
        while run > 0:
            j = 0
            while j < top and run >> (j + 1):
                j += 1
            length = min(run, (1 << (j + 1)) - 1)
            symbols[count] = level_count + j
            values[count] = length - (1 << j)
            bits[count] = j
            run -= length
            count += 1
    return count


def pack(
    sent: NDArray[np.bool_], levels: NDArray[np.uint16], level_count: int, top: int
) -> tuple[NDArray[np.uint16], NDArray[np.uint32], NDArray[np.uint8]]:
    """See `touchfield.codec.runs.pack_runs`; the longest run symbol is R_`top`."""
    size = len(sent)
    symbols, values, bits = np.empty(size, np.uint16), np.empty(size, np.uint32), np.empty(size, np.uint8)
    count = _pack(sent, levels, level_count, top, symbols, values, bits)
    return symbols[:count].copy(), values[:count].copy(), bits[:count].copy()


@njit(cache=True, nogil=True)
def _unpack(symbols, values, level_count, sent, levels):
    place = level = 0
    for m in range(symbols.shape[0]):
        symbol = np.int64(symbols[m])
        if symbol < level_count:
            length = 1
        else:
            j = symbol - level_count
            if j > TOP_RUN or values[m] >> j:
                return INVALID
            length = (1 << j) + np.int64(values[m])
        if place + length > sent.shape[0]:
            return OVERRUN
        if symbol < level_count:
            sent[place] = True
            levels[level] = symbol
            level += 1
        place += length
    return level if place == sent.shape[0] else EXHAUSTED


def unpack(
    symbols: NDArray[np.uint16],
    values: NDArray[np.uint32],
    level_count: int,
    sent: NDArray[np.bool_],
    levels: NDArray[np.uint16],
) -> int:
    """Fill `sent` (zeros before) and `levels`; the number of levels, or a status below zero."""
    return int(_unpack(symbols, values, level_count, sent, levels))


@njit(cache=True, nogil=True)
def _encode(symbols, values, extra, codes, words):
    # the bits are put here as in `huffman`, and not by one function: that was measured at a third of the speed
    held = filled = place = np.int64(0)
    for m in range(symbols.shape[0]):
        symbol = symbols[m]
        if symbol >= codes.shape[0]:
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
        bits = np.int64(extra[m])
        if bits:
            held = (held << bits) | np.int64(values[m])
            filled += bits
            if filled >= 32:
                filled -= 32
                words[place] = held >> filled
                held &= (1 << filled) - 1
                place += 1
    if filled:
        words[place] = held << (32 - filled)
    return place * 32 + filled


def encode(
    streams: tuple[NDArray[np.uint16], NDArray[np.uint32], NDArray[np.uint8]],
    codes: NDArray[np.uint32],
    words: NDArray[np.uint32],
) -> int:
    """Write symbols and their raw bits to `words`; the number of bits, or `INVALID`."""
    return int(_encode(*streams, codes, words))


@njit(cache=True, nogil=True)
def _decode(words, bit_length, table, order, walk, level_count, sent, levels):
    held = filled = place = np.int64(0)
    sample = level = np.int64(0)
    while sample < sent.shape[0]:
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
                return INVALID, level
        filled -= entry & 31
        symbol = entry >> 5
        if symbol < level_count:
            if level == levels.shape[0]:  # there is room for as many levels as there are bits
                return EXHAUSTED, level
            sent[sample] = True
            levels[level] = symbol
            level += 1
            sample += 1
            continue
        j = symbol - level_count
        if j > TOP_RUN:
            return INVALID, level
        if filled < j:
            word = np.int64(0)
            if place < words.shape[0]:
                word = np.int64(words[place])
            held = (held << 32) | word
            filled += 32
            place += 1
        filled -= j
        sample += (1 << j) + ((held >> filled) & ((1 << j) - 1))
        if sample > sent.shape[0]:
            return OVERRUN, level
        if place * 32 - filled > bit_length:
            return EXHAUSTED, level
    return place * 32 - filled, level


def decode(
    words: NDArray[np.uint32],
    bit_length: int,
    tables: tuple[NDArray[np.uint32], NDArray[np.uint16], NDArray[np.int64]],
    level_count: int,
    sent: NDArray[np.bool_],
    levels: NDArray[np.uint16],
) -> tuple[int, int]:
    """Fill `sent` (zeros before) and `levels`; the bits used or a status below zero, and the number of levels."""
    used, count = _decode(words, bit_length, *tables, level_count, sent, levels)
    return int(used), int(count)
