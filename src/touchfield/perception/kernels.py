"""Compiled inner loops that decide which samples changed enough to be sent (deadbands). Imported only when
first needed, because they import numba.

The gates along a scan run in one thread, because each sample depends on the samples sent before it. Products
and sums are in float64; comparisons are written so that a NaN is sent, not held.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import kernel


@kernel
def gate_closed(vectors, decoded, fraction, sent):
    """Closed-loop deadband along a scan; `fraction` is k'.

    `vectors`, `decoded`: float32 [L, 3]. `sent`: bool [L], filled.
    """
    squared = fraction * fraction
    rx, ry, rz = 0.0, 0.0, 0.0
    limit = -1.0  # the first sample is always sent
    for i in range(vectors.shape[0]):
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        is_hold = dx * dx + dy * dy + dz * dz <= limit
        sent[i] = not is_hold
        if not is_hold:
            rx, ry, rz = np.float64(decoded[i, 0]), np.float64(decoded[i, 1]), np.float64(decoded[i, 2])
            limit = squared * (rx * rx + ry * ry + rz * rz)


_PREVIOUS, _ZERO = 0, 1  # numbers of the amplitude readings; "last-sent" is 2


@kernel
def gate_amplitudes(vectors, k, reading, sent):
    """Amplitude readings of eq. 8 along a scan.

    `vectors`: float32 [L, 3]. `sent`: bool [L], filled.
    """
    low, high = 1.0, 0.0  # an empty interval: the first sample is always sent
    for i in range(vectors.shape[0]):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        amplitude = math.sqrt(x * x + y * y + z * z)
        is_hold = low < amplitude and amplitude < high
        sent[i] = not is_hold
        if reading == _PREVIOUS or not is_hold:
            low, high = amplitude - k * amplitude, amplitude + k * amplitude
        elif reading == _ZERO:
            low, high = 0.0, 0.0


@kernel
def gate_in_time(start, stop, vectors, reference, fraction, sent):
    """Set `sent` where |x - reference| > `fraction` |reference|.

    `vectors`, `reference`: float32 [L, 3]. `sent`: bool [L].
    """
    squared = fraction * fraction
    for i in range(start, stop):
        rx, ry, rz = np.float64(reference[i, 0]), np.float64(reference[i, 1]), np.float64(reference[i, 2])
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        sent[i] = not dx * dx + dy * dy + dz * dz <= squared * (rx * rx + ry * ry + rz * rz)
