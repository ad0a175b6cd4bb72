"""Compiled deadbands, and ways to a level; imported only when first needed.

The gates along a scan run in one thread, because each sample depends on what was sent before it. Products and
sums are in float64; a comparison is written so that a NaN would be sent, not held.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import entry, kernel
from touchfield.medium.kernels import force_at


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


@entry
def to_level(points, met, metres, shape, brick_shape, keys, forces, limits, rounds, force):
    """Move `points` [n, 3] along the force to a level; `met` where it came within 2 %.

    `metres` are spacing and origin of the grid, `limits` the level and how far a round moves; `force` [3] is
    room.
    """
    dx, dy, dz, x0, y0, z0 = metres
    level, most = limits
    for p in range(points.shape[0]):
        size = 0.0
        for done in range(rounds + 1):
            x, y, z = points[p, 0], points[p, 1], points[p, 2]
            force_at((x - x0) / dx, (y - y0) / dy, (z - z0) / dz, shape, brick_shape, keys, forces, force)
            for axis in range(3):
                force[axis] = np.float32(force[axis])  # as a receiver is told
            fx, fy, fz = force[0], force[1], force[2]
            size = math.sqrt(fx * fx + fy * fy + fz * fz)
            if done == rounds or size == 0.0:
                break
            fx, fy, fz = fx / size, fy / size, fz / size
            x, y, z = x - most * fx, y - most * fy, z - most * fz
            force_at((x - x0) / dx, (y - y0) / dy, (z - z0) / dz, shape, brick_shape, keys, forces, force)
            gx, gy, gz = np.float32(force[0]), np.float32(force[1]), np.float32(force[2])
            per_m = max(
                (math.sqrt(gx * gx + gy * gy + gz * gz) - size) / most, 1e-9
            )  # saturated: the way out alone
            way = min(max((level - size) / per_m, -most), most)
            points[p, 0] -= fx * way
            points[p, 1] -= fy * way
            points[p, 2] -= fz * way
        met[p] = abs(size - level) <= 0.02 * level
