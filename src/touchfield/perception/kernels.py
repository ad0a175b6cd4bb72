"""Compiled inner loops that decide which samples changed enough to be sent (deadbands), and that move points
to where a field reaches a given force. Imported only when first needed, because they import numba.

The gates along a scan run in one thread, because each sample depends on the samples sent before it. Products
and sums are in float64; comparisons are written so that a NaN is sent, not held.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.coder_jit import entry
from touchfield.compute.jit import kernel
from touchfield.medium.kernels import force_at


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


@entry
def move_to_level(points, met, metres, shape, brick_shape, keys, forces, limits, rounds, force):
    """Move `points` [n, 3] along the force to a level; set `met` for those within 2 %.

    `metres` are spacing and origin of the grid, `limits` the level and the largest move of a round; `force`
    [3] is scratch space.
    """
    dx, dy, dz, x0, y0, z0 = metres
    level, max_move_m = limits
    for p in range(points.shape[0]):
        size = 0.0
        for round_number in range(rounds + 1):
            x, y, z = points[p, 0], points[p, 1], points[p, 2]
            force_at((x - x0) / dx, (y - y0) / dy, (z - z0) / dz, shape, brick_shape, keys, forces, force)
            for axis in range(3):
                force[axis] = np.float32(force[axis])  # as a receiver renders it
            fx, fy, fz = force[0], force[1], force[2]
            size = math.sqrt(fx * fx + fy * fy + fz * fz)
            if round_number == rounds or size == 0.0:
                break
            fx, fy, fz = fx / size, fy / size, fz / size
            x, y, z = x - max_move_m * fx, y - max_move_m * fy, z - max_move_m * fz
            force_at((x - x0) / dx, (y - y0) / dy, (z - z0) / dz, shape, brick_shape, keys, forces, force)
            gx, gy, gz = np.float32(force[0]), np.float32(force[1]), np.float32(force[2])
            per_m = max(
                (math.sqrt(gx * gx + gy * gy + gz * gz) - size) / max_move_m, 1e-9
            )  # at least 1e-9: where the force saturates, only the way outwards is left
            move_m = min(max((level - size) / per_m, -max_move_m), max_move_m)
            points[p, 0] -= fx * move_m
            points[p, 1] -= fy * move_m
            points[p, 2] -= fz * move_m
        met[p] = abs(size - level) <= 0.02 * level
