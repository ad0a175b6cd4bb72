"""Compiled inner loop that decompresses LZF (M. Lehmann, LibLZF), as of compressed PCD files.

A control byte below 32 is followed by that many bytes and one more; any other one copies bytes that were
written: its upper three bits and, if they are 7, the next byte give the length less 2, its lower five bits
and the next byte the distance less 1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from touchfield.compute.jit import kernel

_LITERALS = 32
_LONG = 7


@kernel
def _decompress(packed, out):
    """Fill `out`; return the number of bytes written, -1 if the input is not sound."""
    at, done = np.int64(0), np.int64(0)
    while at < len(packed):
        control = np.int64(packed[at])
        at += 1
        if control < _LITERALS:
            length = control + np.int64(1)
            if at + length > len(packed) or done + length > len(out):
                return -1
            for i in range(length):
                out[done + i] = packed[at + i]
            at += length
        else:
            length = control >> 5
            if length == _LONG:
                if at >= len(packed):
                    return -1
                length += np.int64(packed[at])
                at += 1
            if at >= len(packed):
                return -1
            start = np.int64(done) - ((control & 31) << 8) - np.int64(packed[at]) - 1
            at += 1
            length += 2
            if start < 0 or done + length > len(out):
                return -1
            for i in range(length):  # byte by byte: both ranges may overlap
                out[done + i] = out[start + i]
        done += length
    return done


def decompress(packed: NDArray[np.uint8], size: int) -> NDArray[np.uint8]:
    """Decompress bytes to `size` bytes; ValueError if they are not sound."""
    out = np.empty(size, np.uint8)
    if _decompress(packed, out) != size:
        raise ValueError("compressed data (LZF) that are damaged")
    return out
