"""Compiled inner loops of coder `paper`: nearest direction in the codebook, amplitude levels, Huffman bits,
and prediction.
"""

from __future__ import annotations

import numpy as np

from touchfield.compute.coder_jit import entry
from touchfield.compute.jit import kernel


@entry
def nearest(start, stop, vectors, vertices, side, first, candidates, out):
    """Write the index of the vertex of largest dot product for each vector to `out`.

    `vectors`: finite float32 [m, 3]. `vertices`: [n, 3]. `out`: uint16 [m]; the first of several equal
    vertices. The six faces of the cube around the unit sphere have `side` * `side` cells each. The vertices
    that can be nearest to a direction in cell c are candidates[first[c] : first[c + 1]], ascending
    (`Codebook._cells`).
    """
    half = 0.5 * side
    for i in range(start, stop):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        axis, along, u, v = 0, x, y, z
        if abs(y) > abs(x) and abs(y) >= abs(z):
            axis, along, u, v = 1, y, z, x
        elif abs(z) > abs(x):
            axis, along, u, v = 2, z, x, y
        if along == 0.0:
            out[i] = 0
            continue
        scale = half / abs(along)
        row = min(np.int64(u * scale + half), side - 1)
        column = min(np.int64(v * scale + half), side - 1)
        face = 2 * axis + (along > 0.0)
        cell = (face * side + row) * side + column
        best, winner = -np.inf, 0
        for k in range(first[cell], first[cell + 1]):
            j = candidates[k]
            dot = vertices[j, 0] * x + vertices[j, 1] * y + vertices[j, 2] * z
            if dot > best:
                best, winner = dot, j
        out[i] = winner


DROPPED_BITS = 16  # of an amplitude's float32 bit pattern; exponent and 7 bits of the fraction remain


@entry
def levels_of(start, stop, amplitudes, patterns, thresholds, first, out):
    """Write the number of thresholds at or below each amplitude to `out`, uint16 [m].

    `amplitudes`: float32 [m], 0 or more; `patterns` are their bits as uint32. An amplitude whose leading bits
    are p is at or above `first[p]` to `first[p + 1]` thresholds; bisection finds the number between these.
    """
    for i in range(start, stop):
        leading = (patterns[i] & np.uint32(0x7FFFFFFF)) >> np.uint32(DROPPED_BITS)
        low, high = first[leading], first[leading + 1]
        while low < high:
            middle = (low + high) >> 1
            if thresholds[middle] <= amplitudes[i]:
                low = middle + 1
            else:
                high = middle
        out[i] = low


MAX_CODE_BITS = 24  # maximum length of a Huffman code


@kernel
def pack_bits(values, lengths, out):
    """Write the low ``lengths[i]`` bits of each int64 value to `out`.

    Lengths are at most 44. `out` is uint8 and must be zero at first.
    """
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
    """Read symbols until every sample of `sent`, bool [L], is decoded.

    Sent samples become True and their levels go to `levels`, uint16; runs leave `sent` unchanged. Zeros are
    read after the end of `data`. Returns the number of bits read and the number of levels. The number of bits
    is -1 for bits that are no code, more levels than `levels` can hold, or a run beyond the last sample.
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


# step sizes in sixteenths of the finest; each is larger by a factor 2^(1/4)
STEPS = np.array([16, 19, 23, 27, 32, 38, 45, 54, 64], np.int64)
_ONE = 1 << 16  # of the weights
_NUDGE = 48
_FAR = 1 << 40


@kernel
def adpcm(values, residuals, decoding):
    """ADPCM of one component, int64 [n], in sixteenths of the finest step.

    The function reads `values` and writes `residuals`, or the reverse if `decoding`; in both cases `values`
    becomes the decoded signal. Two weights adapt to the sign of the prediction error (as in G.726). The step
    increases after a residual of magnitude 2 or more and decreases after a residual of 0.
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
        # only bytes that no encoder has written reach the limit
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
