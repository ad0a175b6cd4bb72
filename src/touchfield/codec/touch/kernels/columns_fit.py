"""Compiled fits of the column guess: which surface, or two, a column speaks for, and how they are told."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.codec.touch.kernels import guess as layout
from touchfield.compute.coder_jit import entry, inlined, lean

_STEEP = 0.05  # no direction is less outward


class Fits(NamedTuple):
    """Evidence of the columns of a row, and room for what one of them speaks for."""

    forces: (
        Float32s  # [columns, depth, 4]; across, across, outward, the length; units, from outside to inside
    )
    mask: Float64s  # [2]; k, and F_0 in units
    ramp: Float64s  # [2]; the force deep inside, units, and the growth of its share from sample to sample
    span: Int64s  # [2]; the first sample with a force, and that from which on it is constant
    surfaces: Float64s  # [3, 4]; X, Y, Z, A of the one surface, and of two; A is 0 where it cannot be told
    # weights, one, two, rest: [depth], [3], [3], [depth, 3]; what the samples weigh, directions, and what the
    # first of two surfaces leaves
    weights: Float64s
    one: Float64s
    two: Float64s
    rest: Float64s


@lean
def _direction(d, begin, end, weights, u):
    """The direction of samples begin to end - 1."""
    for c in range(3):
        u[c] = 0.0
        for t in range(begin, end):
            u[c] += weights[t] * d[t, c]
    length = np.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    for c in range(3):
        u[c] /= max(length, 1e-9)
    return length


@lean
def _along(d, u):
    return d[0] * u[0] + d[1] * u[1] + d[2] * u[2]


@lean
def _start(d, u, amplitude, slope, begin, end, weights):
    """Where the ramp of samples begin to end - 1 starts, samples."""
    total = weight = 0.0
    for t in range(begin, end):
        share = _along(d[t], u) / amplitude
        if 0.0 < share < 0.97:
            total += weights[t] * (t - share / slope)
            weight += weights[t]
    return total / weight if weight > 0.0 else begin - 0.5


@lean
def _tell(u, z, amplitude, out):
    out[0] = 16384.0 * u[0] / (1.0 + u[2])
    out[1] = 16384.0 * u[1] / (1.0 + u[2])
    out[2] = 256.0 * z
    out[3] = amplitude


@lean
def fit_two(fits, n):
    """Two surfaces one behind the other, where they miss least; False if there are none."""
    weights, u, v, rest = fits.weights, fits.one, fits.two, fits.rest
    d, out = fits.forces[n], fits.surfaces
    first, flat = fits.span[0], fits.span[1]
    top, ramp = fits.ramp[0], fits.ramp[1]
    depth = d.shape[0]
    best = 1e18
    for cut in range(first + 3, flat, max(1, (flat - first) // 24)):
        _direction(d, first, cut, weights, u)
        growth = (_along(d[cut - 1], u) - _along(d[first + 1], u)) / (cut - first - 2)
        amplitude = growth / (ramp * u[2]) if u[2] > _STEEP else 0.0
        if amplitude < 0.01 * top or amplitude > 1.5 * top:
            continue
        z = _start(d, u, amplitude, ramp * u[2], first, cut, weights)
        for t in range(first, depth):
            size = amplitude * min(1.0, max(0.0, (t - z) * ramp * u[2]))
            for c in range(3):
                rest[t, c] = d[t, c] - size * u[c]
        behind = _direction(rest, depth - 1 if flat < depth else cut, depth, weights, v)
        behind = behind / weights[depth - 1] if flat < depth else top - amplitude
        if v[2] <= _STEEP or behind < 0.01 * top:
            continue
        z2 = _start(rest, v, behind, ramp * v[2], cut, flat, weights)
        cost = 0.0
        for t in range(first, flat):
            size = behind * min(1.0, max(0.0, (t - z2) * ramp * v[2]))
            x, y, w = rest[t, 0] - size * v[0], rest[t, 1] - size * v[1], rest[t, 2] - size * v[2]
            cost += min((x * x + y * y + w * w) * weights[t], 4.0)
        if cost < best:
            best = cost
            _tell(u, z, amplitude, out[1])
            _tell(v, z2, behind, out[2])
    return best < 1e18


@lean
def fit_one(fits, n):
    """The span of a column, the weights of its samples, and the one surface."""
    weights, u, d = fits.weights, fits.one, fits.forces[n]
    k, f0, top, ramp = fits.mask[0], fits.mask[1], fits.ramp[0], fits.ramp[1]
    first = depth = d.shape[0]
    while first > 0 and d[first - 1, 3] > 0.0:
        first -= 1
        weights[first] = 1.0 / max(f0, k * d[first, 3]) ** 2
    flat = depth - 1
    while flat > first and abs(d[flat - 1, 3] - d[depth - 1, 3]) <= 0.01 * d[depth - 1, 3]:
        flat -= 1
    if flat == depth - 1:
        flat = depth
    fits.span[0], fits.span[1] = first, flat
    _direction(d, first, depth, weights, u)
    u[2] = max(u[2], _STEEP)
    amplitude = np.float64(d[depth - 1, 3]) if flat < depth else top
    z = _start(d, u, amplitude, ramp * u[2], first, flat, weights)
    _tell(u, z, amplitude if flat < depth else 0.0, fits.surfaces[0])


_MISS = 6.5  # bits, about, of a voxel that the guess misses
_A, _X, _Y, _Z = layout.A, layout.X, layout.Y, layout.Z


@lean
def _bits(r):
    """Bits of a residual, about."""
    return 2.5 + 2.0 * np.log2(abs(r)) if r else 0.1


@lean
def _cost(columns, at, fits, n, enough):
    """Bits that the voxels of a column would still take, about; whatever is above `enough` counts as that."""
    heads, d, stop = columns.heads, fits.forces[n], fits.forces.shape[1]
    one, two = columns.surfaces[at], columns.surfaces[at + 1]
    cost = 0.0
    for t in range(max(np.int64(0), min(fits.span[0], one[_Z] >> 8)), stop):
        share, more = layout.share_at(one, t, heads), layout.share_at(two, t, heads)
        a, b = np.float64(share * one[_A]), np.float64(more * two[_A])
        square = 0.0
        for c in range(3):
            x = (a * one[layout.U + c] + b * two[layout.U + c]) / 1073741824.0 - d[t, c]
            square += x * x
        tol = max(fits.mask[1], fits.mask[0] * d[t, 3])
        if square > tol * tol:
            cost += _MISS
        if cost > enough:
            break
    return cost


@lean
def _try(columns, at, fits, n, own, best):
    """Set the column's surfaces as ``columns.told`` says, and return the bits that this takes, about.

    Bits 0, 1, 2 of `own` tell whether the direction, the start and the amplitude of the last surface are as
    fitted, else as expected; those of the first one of two are as fitted.
    """
    r, expected, count, mode = columns.residuals, columns.expected, columns.told[0], columns.told[1]
    columns.surfaces[at + 1, _A] = 0
    bits = 0.2 + 2.0 * (mode > 0) + 3.0 * (count > 1)
    for slot in range(count):
        fit = fits.surfaces[slot + count - 1]
        layout.expect(columns, at, np.int64(slot))
        for c in range(4):
            told = slot + 1 < count or (own >> max(0, c - 1)) & 1
            r[slot, c] = 0
            if told and fit[_A] + (c != _A) > 0.0:
                steps = (fit[c] - expected[c]) / layout.step_of(columns, np.int64(c))
                r[slot, c] = np.int64(np.rint(min(max(steps, -1e6), 1e6)))
            bits += _bits(r[slot, c])
            if c == layout.Y:
                layout.turn(columns, at, np.int64(slot))
        layout.set_surface(columns, at, np.int64(slot))
    return bits + _cost(columns, at, fits, n, best - bits) if bits < best else best


@inlined
def _choose(columns, at, fits, n):
    """Set the residuals of one column, and ``columns.told``."""
    told, best = columns.told, 1e18
    fit_one(fits, n)
    chosen = np.int64(1), np.int64(0), np.int64(0)
    modes = layout.MODES if layout.is_torn(columns.surfaces, at, columns.row) else 1
    for count in range(1, 3):
        if count == 2 and not fit_two(fits, n):
            break
        for mode in range(modes):
            for own in range(8):
                told[0], told[1] = count, mode
                bits = _try(columns, at, fits, n, np.int64(own), best)
                if bits < best:
                    best, chosen = bits, (np.int64(count), np.int64(mode), np.int64(own))
    told[0], told[1] = chosen[0], chosen[1]
    _try(columns, at, fits, n, chosen[2], 1e18)


@entry
def write_row(bits, columns, row, count, fits):
    """Fit, choose and write a row of columns; those that cannot be told have no surface."""
    depth = fits.forces.shape[1]
    for j in range(count):
        place = (row + 1) * columns.row + 2 * j + 2
        columns.told[0] = 0
        if fits.forces[j, depth - 1, 3] > 0:
            _choose(columns, place, fits, np.int64(j))
        layout.code_column(bits, columns, place)
