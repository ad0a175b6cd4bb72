"""Compiled loops of the paper's coder: the nearest direction, Huffman codes to bits and back, and ADPCM."""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import entry, kernel
from touchfield.medium.kernels import first_at_least


@entry
def nearest(begin, end, vectors, vertices, reach, out):
    """Fill uint16 [m] with the first of the vertices [3, n] of largest dot product for finite float32 [m, 3].

    Vertices ascend by x; the nearest of a direction is no farther than `reach`, so that no other x is looked
    at.
    """
    for i in range(begin, end):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        size = math.sqrt(x * x + y * y + z * z)
        best, winner = -np.inf, 0
        if size > 0.0:
            j, last = first_at_least(vertices[0], x / size - reach), x / size + reach
            while j < vertices.shape[1] and vertices[0, j] <= last:
                dot = vertices[0, j] * x + vertices[1, j] * y + vertices[2, j] * z
                if dot > best:
                    best, winner = dot, j
                j += 1
        out[i] = winner


LONGEST = 24  # bits of a Huffman code, at most


@kernel
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


@kernel
def decode(data, limits, ranks, order, level_count, sent, levels):
    """Read symbols until `sent` bool [L] is full; levels go to uint16 `levels`, runs leave `sent` as it is.

    Behind the end of `data` there are zeros. Returns the bits that were read, or -1 for bits that are no
    code, more levels than there is room for, or a run beyond the end; and the number of levels.
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


# steps in sixteenths of the finest: a factor 2^(1/4) each
STEPS = np.array([16, 19, 23, 27, 32, 38, 45, 54, 64], np.int64)
_ONE = 1 << 16  # of the weights
_NUDGE = 48
_FAR = 1 << 40


@kernel
def adpcm(values, residuals, decoding):
    """ADPCM of one component, int64 [n], in sixteenths: reads `values` and writes `residuals`, or the
    reverse.

    Two weights follow the signal by the sign of what they miss (as in G.726), and the step goes up after a
    residual of 2 or more and down after a 0. ``values`` holds the decoded signal in both cases.
    """
    w0, w1 = np.int64(_ONE), np.int64(0)
    last = before = rung = np.int64(0)
    for i in range(values.shape[0]):
        slope = last - before
        predicted = (w0 * last + w1 * slope + (_ONE >> 1)) >> 16
        step = STEPS[rung]
        if decoding:
            q = residuals[i]
        else:
            miss = values[i] - predicted
            q = (2 * abs(miss) + step) // (2 * step)
            q = -q if miss < 0 else q
            residuals[i] = q
        value = min(
            max(predicted + q * step, np.int64(-_FAR)), np.int64(_FAR)
        )  # only strangers' bytes reach it
        values[i] = value
        sign = np.int64(q > 0) - np.int64(q < 0)
        w0 += _NUDGE * sign * (np.int64(last > 0) - np.int64(last < 0))
        w1 += _NUDGE * sign * (np.int64(slope > 0) - np.int64(slope < 0))
        w0 = min(max(w0, np.int64(_ONE * 7 // 8)), np.int64(_ONE * 9 // 8))
        w1 = min(max(w1, np.int64(-_ONE // 4)), np.int64(_ONE))
        if abs(q) >= 2:
            rung = min(rung + 1, STEPS.shape[0] - 1)
        elif q == 0:
            rung = max(rung - 1, np.int64(0))
        before, last = last, value
