"""Compiled loops of the paper's coder: nearest directions, levels of amplitudes, Huffman codes and ADPCM."""

from __future__ import annotations

import numpy as np

from touchfield.compute.coder_jit import entry
from touchfield.compute.jit import kernel


@entry
def nearest(start, stop, vectors, vertices, side, first, candidates, out):
    """Fill uint16 [m] with the first of the vertices [n, 3] of largest dot product for finite float32 [m, 3].

    The six faces of the cube around the unit sphere have `side` * `side` cells each; the vertices that can be
    nearest to a direction of cell c are candidates[first[c] : first[c + 1]], ascending (`Codebook._cells`).
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


DROPPED_BITS = 16  # of an amplitude's pattern as float32: exponent and 7 bits of its fraction are left


@entry
def levels_of(start, stop, amplitudes, patterns, thresholds, first, out):
    """Fill uint16 [m] with the number of thresholds at or below each amplitude, float32 [m], 0 or more.

    `patterns` are the amplitudes' bits as uint32. Amplitudes whose leading bits are p lie above the first
    `first[p]` thresholds, and above no more than `first[p + 1]`; between these, by bisection.
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
