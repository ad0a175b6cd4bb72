"""Compiled loops of the Huffman coder: codes to bits and back. Bits fill bytes from the top."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.paper.huffman import LONGEST

__all__ = ["decode", "pack_bits"]


@njit(cache=True, nogil=True)
def pack_bits(values, lengths, out):
    """Write the low ``lengths[i]`` bits (44 at most) of each int64 value to uint8 `out`, which holds zeros."""
    held = filled = place = np.int64(0)
    for i in range(values.shape[0]):
        held = (held << np.int64(lengths[i])) | values[i]
        filled += lengths[i]
        while filled >= 8:
            filled -= 8
            out[place] = held >> filled
            place += 1
            held &= (np.int64(1) << filled) - 1
    if filled:
        out[place] = held << (8 - filled)


@njit(cache=True, nogil=True)
def decode(data, limits, ranks, order, level_count, sent, levels):
    """Read symbols until `sent` bool [L] is full; levels go to uint16 `levels`, runs leave `sent` as it is.

    Behind the end of `data` there are zeros. Returns the bits that were read, or -1 for bits that are no code, more
    levels than there is room for, or a run beyond the end; and the number of levels.
    """
    held = filled = place = used = np.int64(0)
    sample = level = np.int64(0)
    while sample < sent.shape[0]:
        while filled <= 48:
            byte = np.int64(data[place]) if place < data.shape[0] else np.int64(0)
            held = ((held << 8) | byte) & ((np.int64(1) << 56) - 1)
            filled += 8
            place += 1
        window = (held >> (filled - LONGEST)) & ((1 << LONGEST) - 1)
        bits = 1
        while bits <= LONGEST and window >= limits[bits]:
            bits += 1
        if bits > LONGEST:
            return np.int64(-1), level
        symbol = np.int64(order[ranks[bits] + (window >> (LONGEST - bits))])
        filled -= bits
        used += bits
        if symbol < level_count:
            if level == levels.shape[0]:
                return np.int64(-1), level
            sent[sample] = True
            levels[level] = symbol
            level += 1
            sample += 1
            continue
        j = symbol - level_count
        filled -= j
        used += j
        sample += (np.int64(1) << j) + ((held >> filled) & ((np.int64(1) << j) - 1))
        if sample > sent.shape[0]:
            return np.int64(-1), level
    return used, level
