"""Compiled deadbands; imported only when first needed.

The gates along a scan run in one thread, because each sample depends on what was sent before it. Products and sums
are in float64; a comparison is written so that a NaN would be sent, not held.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.lean import kernel


@kernel
def gate_closed(vectors, decoded, fraction, sent):
    """The closed loop along a scan, float32 [L, 3] twice into bool [L]; `fraction` is k'."""
    squared = fraction * fraction
    rx, ry, rz = 0.0, 0.0, 0.0
    limit = -1.0  # the first sample is always sent
    for i in range(vectors.shape[0]):
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        is_held = dx * dx + dy * dy + dz * dz <= limit
        sent[i] = not is_held
        if not is_held:
            rx, ry, rz = np.float64(decoded[i, 0]), np.float64(decoded[i, 1]), np.float64(decoded[i, 2])
            limit = squared * (rx * rx + ry * ry + rz * rz)


_PREVIOUS, _ZERO = 0, 1  # of the amplitude readings; "last-sent" is 2


@kernel
def gate_amplitudes(vectors, k, reading, sent):
    """The amplitude readings of eq. 8 along a scan, float32 [L, 3] into bool [L]."""
    low, high = 1.0, 0.0  # an empty interval: the first sample is always sent
    for i in range(vectors.shape[0]):
        x, y, z = np.float64(vectors[i, 0]), np.float64(vectors[i, 1]), np.float64(vectors[i, 2])
        amplitude = math.sqrt(x * x + y * y + z * z)
        is_held = low < amplitude and amplitude < high
        sent[i] = not is_held
        if reading == _PREVIOUS or not is_held:
            low, high = amplitude - k * amplitude, amplitude + k * amplitude
        elif reading == _ZERO:
            low, high = 0.0, 0.0


@kernel
def gate_in_time(begin, end, vectors, reference, fraction, sent):
    """Where |x - reference| > `fraction` |reference|, float32 [L, 3] twice into bool [L]."""
    squared = fraction * fraction
    for i in range(begin, end):
        rx, ry, rz = np.float64(reference[i, 0]), np.float64(reference[i, 1]), np.float64(reference[i, 2])
        dx = np.float64(vectors[i, 0]) - rx
        dy = np.float64(vectors[i, 1]) - ry
        dz = np.float64(vectors[i, 2]) - rz
        sent[i] = not dx * dx + dy * dy + dz * dz <= squared * (rx * rx + ry * ry + rz * rz)
