"""Compiled fits of the column guess: which surface, or two, a column of forces speaks for (floats)."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.lean import entry, inlined, lean

__all__ = ["fit_row"]


@lean
def _direction(d, begin, end, tolerances, u):
    """The direction of the samples of a column from begin to end - 1, those weighed most whose mask is narrow."""
    for c in range(3):
        u[c] = 0.0
    for t in range(begin, end):
        for c in range(3):
            u[c] += d[t, c] / (tolerances[t] * tolerances[t])
    return _normalised(u)


@lean
def _normalised(u):
    length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for c in range(3):
        u[c] /= max(length, 1e-9)
    return length


@lean
def _start(d, u, amplitude, slope, span, tolerances):
    """Where the ramp of samples begin to end - 1 starts, samples."""
    total = weight = 0.0
    for t in range(span[0], span[1]):
        share = (d[t, 0] * u[0] + d[t, 1] * u[1] + d[t, 2] * u[2]) / amplitude
        if 0.0 < share < 0.97:
            w = 1.0 / (tolerances[t] * tolerances[t])
            total += w * (t - share / slope)
            weight += w
    return total / weight if weight > 0.0 else span[0] - 0.5


@lean
def _told(z, u, amplitude, out):
    out[0] = 256.0 * z
    out[1] = 16384.0 * u[0] / (1.0 + u[2])
    out[2] = 16384.0 * u[1] / (1.0 + u[2])
    out[3] = amplitude


@inlined
def _rest_of(d, u, z, amplitude, slope, begin, rest):
    """What of a column is left when a surface is taken from it."""
    for t in range(begin, d.shape[0]):
        size = amplitude * min(1.0, max(0.0, (t - z) * slope))
        for c in range(3):
            rest[t, c] = d[t, c] - size * u[c]


@inlined
def _growth(d, u, begin, end):
    """Of the force along a direction, from sample to sample: the slope of a line through it."""
    n = sx = sy = sxx = sxy = 0.0
    for t in range(begin, end):
        y = d[t, 0] * u[0] + d[t, 1] * u[1] + d[t, 2] * u[2]
        x = float(t - begin)
        w = 1.0 / max(1.0, y)
        n += w
        sx += w * x
        sy += w * y
        sxx += w * x * x
        sxy += w * x * y
    return (n * sxy - sx * sy) / max(n * sxx - sx * sx, 1e-9)


@inlined
def _fit_two(d, first, flat, plateau, heads, tolerances, work, out):
    """Two surfaces one behind the other, where they miss least."""
    top, ramp = heads
    u, v, rest = work
    depth = d.shape[0]
    best = 1e18
    for cut in range(first + 3, flat, max(1, (flat - first) // 24)):
        _direction(d, first, cut, tolerances, u)
        if u[2] < 0.06:
            continue
        slope = ramp * u[2]
        amplitude = _growth(d, u, first, cut) / slope
        if amplitude < 0.01 * top or amplitude > 1.5 * top:
            continue
        z = _start(d, u, amplitude, slope, (first, cut), tolerances)
        _rest_of(d, u, z, amplitude, slope, first, rest)
        if plateau:
            for c in range(3):
                v[c] = rest[depth - 1, c]
            behind = _normalised(v)
        else:
            _direction(rest, cut, depth, tolerances, v)
            behind = top - amplitude
        if v[2] < 0.06 or behind < 0.01 * top:
            continue
        more = ramp * v[2]
        z2 = _start(rest, v, behind, more, (cut, flat), tolerances)
        cost = 0.0
        for t in range(first, flat):
            size = behind * min(1.0, max(0.0, (t - z2) * more))
            error = 0.0
            for c in range(3):
                error += (rest[t, c] - size * v[c]) ** 2
            cost += min(error / (tolerances[t] * tolerances[t]), 4.0)
        if cost < best:
            best = cost
            _told(z, u, amplitude, out[0])
            _told(z2, v, behind, out[1])


@entry
def fit_row(forces, heads, mask, spans, surfaces, work):
    """Fit the columns of a row, float32 [n, depth, 4]."""
    top, ramp = heads
    tolerances, u, v, rest = work
    depth = forces.shape[1]
    for n in range(forces.shape[0]):
        d = forces[n]
        first = depth
        while first > 0 and d[first - 1, 3] > 0.0:
            first -= 1
            tolerances[first] = max(mask[1], mask[0] * d[first, 3])
        flat = depth - 1
        while flat > first:
            apart = 0.0
            for c in range(3):
                apart += (d[flat - 1, c] - d[depth - 1, c]) ** 2
            if apart > 1e-4 * d[depth - 1, 3] ** 2:
                break
            flat -= 1
        plateau = flat < depth - 1
        if not plateau:
            flat = depth
        spans[n, 0] = first
        spans[n, 1] = flat
        _direction(d, first, depth, tolerances, u)
        u[2] = max(u[2], 0.05)
        amplitude = np.float64(d[depth - 1, 3]) if plateau else top
        z = _start(d, u, amplitude, ramp * u[2], (first, flat), tolerances)
        _told(z, u, amplitude if plateau else 0.0, surfaces[n, 0])
        _fit_two(d, first, flat, plateau, heads, tolerances, (u, v, rest), surfaces[n, 1:])
