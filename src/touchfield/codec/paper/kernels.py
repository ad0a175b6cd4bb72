"""Compiled inner loops of the encoder of coder `paper`: nearest direction in the codebook, amplitude levels,
and Huffman bits. Imported only when first needed, because they import numba.
"""

from __future__ import annotations

import numpy as np

from touchfield.compute.jit import kernel


@kernel(error_model="numpy")
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


@kernel(error_model="numpy")
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
