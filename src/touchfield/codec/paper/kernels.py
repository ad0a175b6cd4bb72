"""Compiled loops of the paper's coder: the nearest direction, Huffman codes to bits and back, and ADPCM."""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.coder_jit import entry
from touchfield.compute.jit import kernel
from touchfield.medium.kernels import lower_bound


@entry
def nearest(start, stop, vectors, vertices, reach, out):
    """Fill uint16 [m] with the first of the vertices [3, n] of largest dot product for finite float32 [m, 3].

    Vertices ascend by x; the nearest vertex of a direction is within `reach`, so only these x are searched.
    """
    for i in range(start, stop):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        size = math.sqrt(x * x + y * y + z * z)
        best, winner = -np.inf, 0
        if size > 0.0:
            j, last = lower_bound(vertices[0], x / size - reach), x / size + reach
            while j < vertices.shape[1] and vertices[0, j] <= last:
                dot = vertices[0, j] * x + vertices[1, j] * y + vertices[2, j] * z
                if dot > best:
                    best, winner = dot, j
                j += 1
        out[i] = winner


MAX_CODE_BITS = 24  # bits of a Huffman code, at most


@kernel
def pack_bits(values, lengths, out):
    """Write the low ``lengths[i]`` bits (at most 44) of each int64 value to uint8 `out`, initially zeros."""
    pending = filled = byte_index = np.int64(0)
    for i in range(values.shape[0]):
        pending = (pending << np.int64(lengths[i])) | values[i]
        filled += lengths[i]
        while filled >= 8:
            filled -= 8
            out[byte_index] = pending >> filled
            byte_index += 1
            pending &= (np.int64(1) << filled) - 1
    if filled:
        out[byte_index] = pending << (8 - filled)


@kernel
def decode(data, limits, ranks, order, level_count, sent, levels):
    """Read symbols until `sent` bool [L] is full; levels go to uint16 `levels`, runs leave `sent` as it is.

    Zeros follow the end of `data`. Returns the number of bits read, or -1 for bits that are no code, too many
    levels for `levels`, or a run beyond the end; and the number of levels.
    """
    pending = filled = byte_index = used = np.int64(0)
    sample = level = np.int64(0)
    while sample < sent.shape[0]:
        while filled <= 48:
            byte = np.int64(data[byte_index]) if byte_index < data.shape[0] else np.int64(0)
            pending = ((pending << 8) | byte) & ((np.int64(1) << 56) - 1)
            filled += 8
            byte_index += 1
        window = (pending >> (filled - MAX_CODE_BITS)) & ((1 << MAX_CODE_BITS) - 1)
        bits = 1
        while bits <= MAX_CODE_BITS and window >= limits[bits]:
            bits += 1
        if bits > MAX_CODE_BITS:
            return np.int64(-1), level
        symbol = np.int64(order[ranks[bits] + (window >> (MAX_CODE_BITS - bits))])
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
        sample += (np.int64(1) << j) + ((pending >> filled) & ((np.int64(1) << j) - 1))
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
    """ADPCM of one component, int64 [n], in sixteenths of the finest step.

    Reads `values` and writes `residuals`, or the reverse if `decoding`. Two weights adapt by the sign of the
    prediction error (as in G.726); the step increases after a residual of 2 or more and decreases after a 0.
    `values` becomes the decoded signal in both cases.
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
            residual = values[i] - predicted
            q = (2 * abs(residual) + step) // (2 * step)
            q = -q if residual < 0 else q
            residuals[i] = q
        # the limit is only reached with bytes that no encoder wrote
        value = min(max(predicted + q * step, np.int64(-_FAR)), np.int64(_FAR))
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
