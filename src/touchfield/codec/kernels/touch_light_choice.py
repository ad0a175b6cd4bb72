"""The encoder's choice of a residual in the light models of coder `touch`: the cheapest point that keeps the rule.

Floats, for the decoder follows none of it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.touch_lattice import amplitude_of, level_of, rebuild, step_at
from touchfield.codec.kernels.touch_light_coder import lean

__all__ = [
    "F0",
    "FREE",
    "MOVABLE",
    "SINE",
    "THRIFT",
    "K",
    "choose",
    "kept",
    "missed",
    "place_vector",
    "tolerance",
    "units",
]

K, F0, SINE, THRIFT, FREE, MOVABLE = 0, 1, 2, 3, 4, 5
"""Places in the rule: float64 [6], F_0 in units."""

_AROUND = np.array([0, -1, 1], np.int64)
_ROUNDING = 2e-7  # of a force, lost where whole units become newtons of 32 bits


@lean
def tolerance(size, rule):
    """The mask at a force of `size` units, less what the last rounding may cost; below 0: hopeless."""
    return max(rule[F0], rule[K] * size) * (1 - 1e-6) - _ROUNDING * size


@lean
def kept(d0, d1, d2, f0, f1, f2, size, tol, rule):
    """Whether a decoded vector may stand for a force (f0, f1, f2) of `size`, all in units."""
    e0, e1, e2 = d0 - f0, d1 - f1, d2 - f2
    error = e0 * e0 + e1 * e1 + e2 * e2
    if tol < 0:
        return False
    if rule[SINE] > 0 and size * rule[SINE] > rule[F0]:
        square = d0 * d0 + d1 * d1 + d2 * d2
        along = d0 * f0 + d1 * f1 + d2 * f2
        if along <= 0 or abs(np.sqrt(square) - size) > tol:
            return False
        across = square * size * size - along * along
        most = rule[SINE] * (1 - 1e-6) - 1e-6
        return across <= most * most * square * size * size
    if rule[SINE] > 0:
        tol = min(tol, rule[F0] * (1 - 1e-6) - _ROUNDING * size)
    return error <= tol * tol


@lean
def units(forces, s, scale, f):
    """A force in units, and its size."""
    f[0] = np.float64(forces[s, 0]) * scale
    f[1] = np.float64(forces[s, 1]) * scale
    f[2] = np.float64(forces[s, 2]) * scale
    return np.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])


@lean
def _reached(a, border, first):
    return level_of(a, border, first)


@lean
def place_vector(level, r0, r1, r2, axes, border, lattice, vector):
    """``vector`` = what the residual (r0, r1, r2) makes of an expected vector of this level, along these axes."""
    along = amplitude_of(level + 256 * r0, border)
    step = step_at(abs(along), lattice[2], lattice[3])
    rebuild(along, r1 * step, r2 * step, axes, vector)


@lean
def choose(f, size, tol, rule, level, axes, border, first, lattice, spread, found, vector, whole):
    """The residual (r0, r1, r2) of the force `f`, units float64 [3], into `found`, and what it decodes to.

    `spread` holds the mean sizes of the neighbours' residuals along and across; with `whole` the residual may be
    zero. Returns what it costs, bits, or, where each error has its price, squared steps; infinity where no point near
    keeps the rule: then the nearest one is given.
    """
    along = (f[0] * axes[0, 0] + f[1] * axes[0, 1] + f[2] * axes[0, 2]) / 16384.0
    near = np.int64(round(abs(along)))
    reached = _reached(min(near, (np.int64(1) << 18) - 1), border, first)
    if along < 0:
        reached = -reached
    n0 = np.int64(round((reached - level) / 256.0))
    across_1 = (f[0] * axes[1, 0] + f[1] * axes[1, 1] + f[2] * axes[1, 2]) / 16384.0
    across_2 = (f[0] * axes[2, 0] + f[1] * axes[2, 1] + f[2] * axes[2, 2]) / 16384.0
    best = np.inf
    nearest = np.inf
    bit = rule[THRIFT] if rule[FREE] > 0 else 1.0
    slope_0 = bit * 1.5 / (spread[0] + 0.5 if rule[FREE] == 0 else spread[0] + 1.5)
    slope_1 = bit * 1.5 / (spread[1] + 0.5 if rule[FREE] == 0 else spread[1] + 1.5)
    ball = rule[FREE] == 0 and rule[SINE] == 0
    most = tol * tol * 1.02 + 16.0
    for i in range(3):
        r0 = n0 + _AROUND[i]
        cost_0 = 0.0 if r0 == 0 else 1.5 * bit + abs(r0) * slope_0
        if cost_0 >= best:
            continue
        length = amplitude_of(level + 256 * r0, border)
        step = step_at(abs(length), lattice[2], lattice[3])
        error_0 = (along - length) ** 2
        n1 = np.int64(round(across_1 / step))
        n2 = np.int64(round(across_2 / step))
        for j in range(3):
            r1 = n1 + _AROUND[j]
            cost_1 = cost_0 if r1 == 0 else cost_0 + 1.5 * bit + abs(r1) * slope_1
            error_1 = error_0 + (across_1 - r1 * step) ** 2
            if cost_1 >= best or (ball and error_1 > most and nearest < np.inf):
                continue
            for k in range(3):
                r2 = n2 + _AROUND[k]
                cost = cost_1 if r2 == 0 else cost_1 + 1.5 * bit + abs(r2) * slope_1
                error = error_1 + (across_2 - r2 * step) ** 2
                if rule[FREE] > 0:
                    cost += error / (np.float64(lattice[0]) ** 2)
                if cost >= best or (ball and error > most and error >= nearest):
                    continue
                if (not whole and r0 == 0 and r1 == 0 and r2 == 0) or max(abs(r0), abs(r1), abs(r2)) >= 1 << 18:
                    continue
                place_vector(level, r0, r1, r2, axes, border, lattice, vector)
                empty = vector[0] == 0 and vector[1] == 0 and vector[2] == 0
                d0, d1, d2 = np.float64(vector[0]), np.float64(vector[1]), np.float64(vector[2])
                if not (empty and rule[MOVABLE] == 0) and (
                    rule[FREE] > 0 or kept(d0, d1, d2, f[0], f[1], f[2], size, tol, rule)
                ):
                    best = cost
                    found[0], found[1], found[2] = r0, r1, r2
                elif best == np.inf and error < nearest:
                    nearest = error
                    found[0], found[1], found[2] = r0, r1, r2
    place_vector(level, found[0], found[1], found[2], axes, border, lattice, vector)
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def missed(forces, decoded, scale, rule):
    """Which of the decoded vectors int32 [s, 3] (units) break the rule, of forces float32 [s, 3]; bool [s]."""
    out = np.zeros(forces.shape[0], np.bool_)
    for s in range(forces.shape[0]):
        f0, f1, f2 = (
            np.float64(forces[s, 0]) * scale, np.float64(forces[s, 1]) * scale, np.float64(forces[s, 2]) * scale,
        )  # fmt: skip
        d0, d1, d2 = np.float64(decoded[s, 0]), np.float64(decoded[s, 1]), np.float64(decoded[s, 2])
        held = forces[s, 0] != 0 or forces[s, 1] != 0 or forces[s, 2] != 0
        given = decoded[s, 0] != 0 or decoded[s, 1] != 0 or decoded[s, 2] != 0
        if not held and not given:
            continue
        size = np.sqrt(f0 * f0 + f1 * f1 + f2 * f2)
        if held != given and rule[MOVABLE] == 0:
            out[s] = True
        elif rule[FREE] == 0:
            out[s] = not kept(d0, d1, d2, f0, f1, f2, size, tolerance(size, rule), rule)
    return out
