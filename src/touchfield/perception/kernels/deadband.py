"""The compiled core of `touchfield.perception.deadband`.

The gates along a scan run in one thread, because each sample depends on what was sent before it. Products and
sums are in float64; a comparison is written so that a NaN would be sent, not held.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Bools = NDArray[np.bool_]

__all__ = ["gate_amplitudes", "gate_closed", "gate_in_time", "held_values"]

_PIECE = 1 << 15


@njit(cache=True, nogil=True)
def _gate_closed(vectors, decoded, fraction, sent):
    squared = fraction * fraction
    rx, ry, rz = 0.0, 0.0, 0.0
    limit = -1.0  # the first sample is always sent
    for i in range(vectors.shape[0]):
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        held = dx * dx + dy * dy + dz * dz <= limit
        sent[i] = not held
        if not held:
            rx, ry, rz = np.float64(decoded[i, 0]), np.float64(decoded[i, 1]), np.float64(decoded[i, 2])
            limit = squared * (rx * rx + ry * ry + rz * rz)


def gate_closed(vectors: Float32s, decoded: Float32s, fraction: float) -> Bools:
    """The closed loop along a scan; `fraction` is k'. float32 [L, 3] twice, bool [L]."""
    sent = np.empty(len(vectors), np.bool_)
    _gate_closed(vectors, decoded, fraction, sent)
    return sent


_PREVIOUS, _ZERO, _LAST_SENT = 0, 1, 2
_READING = {"previous": _PREVIOUS, "zero": _ZERO, "last-sent": _LAST_SENT}


@njit(cache=True, nogil=True)
def _gate_amplitudes(vectors, k, reading, sent):
    low, high = 1.0, 0.0  # an empty interval: the first sample is always sent
    for i in range(vectors.shape[0]):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        amplitude = math.sqrt(x * x + y * y + z * z)
        held = low < amplitude and amplitude < high
        sent[i] = not held
        if reading == _PREVIOUS or not held:
            low, high = amplitude - k * amplitude, amplitude + k * amplitude
        elif reading == _ZERO:
            low, high = 0.0, 0.0


def gate_amplitudes(vectors: Float32s, k: float, reading: str) -> Bools:
    """The amplitude readings of eq. 8 along a scan. float32 [L, 3], bool [L]."""
    sent = np.empty(len(vectors), np.bool_)
    _gate_amplitudes(vectors, k, _READING[reading], sent)
    return sent


@njit(cache=True, nogil=True)
def _gate_in_time(begin, end, vectors, reference, fraction, sent):
    squared = fraction * fraction
    for i in range(begin, end):
        rx, ry, rz = np.float64(reference[i, 0]), np.float64(reference[i, 1]), np.float64(reference[i, 2])
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        sent[i] = not dx * dx + dy * dy + dz * dz <= squared * (rx * rx + ry * ry + rz * rz)


def gate_in_time(vectors: Float32s, reference: Float32s, fraction: float) -> Bools:
    """Where |x - reference| > `fraction` |reference|. float32 [L, 3] twice, bool [L]."""
    sent = np.empty(len(vectors), np.bool_)
    for_chunks(_gate_in_time, len(vectors), vectors, reference, fraction, sent, chunk=_PIECE)
    return sent


@njit(cache=True, nogil=True)
def _held_values(sent, decoded, out):
    x, y, z = np.float32(0), np.float32(0), np.float32(0)
    for i in range(sent.shape[0]):
        if sent[i]:
            x, y, z = decoded[i, 0], decoded[i, 1], decoded[i, 2]
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = z


def held_values(sent: Bools, decoded: Float32s) -> Float32s:
    """The last sent value at each place. bool [L], float32 [L, 3], float32 [L, 3]."""
    out = np.empty_like(decoded)
    _held_values(sent, decoded, out)
    return out
