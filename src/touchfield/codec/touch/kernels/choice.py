"""The encoder's choice of a residual: the cheapest point that keeps the rule.

Floats, for the decoder follows none of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchfield.codec.kernels.bits import PRICING, TASK
from touchfield.codec.touch.kernels.lattice import amplitude_of, level_of, step_at
from touchfield.codec.touch.kernels.predict import before, held
from touchfield.codec.touch.kernels.residual import BASED, LEVEL, aim, code_step, place
from touchfield.codec.touch.kernels.window import SIZES, WIDTH
from touchfield.codec.touch.kernels.workspace import APART, AXES, EXPECTED, STEPS, VECTOR
from touchfield.lean import inlined, lean

__all__ = ["Limits", "choose", "fits", "kept", "still_pays", "tolerance"]

_AROUND = np.array([0, -1, 1], np.int64)
_ROUNDING = 2e-7  # of a force, lost where whole units become newtons of 32 bits
_REFERENCE_ERROR = 0.36  # squared steps about, that a voxel taken from the reference may be off in mode nmse


class Limits(NamedTuple):
    """Bounds of the error, in units; see `touchfield.codec.touch.rule`.

    Attributes
    ----------
    k, f0 : float
    sine : float
        Of the direction JND; 0 where only the mask rules.
    thrift : float
        What a bit may cost where every error has its price, squared steps.
    free, exact, thorough : bool
        No rule at all; the support is kept; candidates are priced by what they really take.
    """

    k: float
    f0: float
    sine: float
    thrift: float
    free: bool
    exact: bool
    thorough: bool


@lean
def tolerance(size, rule):
    """The mask at a force of `size` units, less what the last rounding may cost; below 0: hopeless."""
    return max(rule.f0, rule.k * size) * (1 - 1e-6) - _ROUNDING * size


@lean
def kept(d0, d1, d2, f, size, rule):
    """True where a decoded vector, whole units, may stand for the force `f`, float64 [3], of `size`."""
    tol = tolerance(size, rule)
    if tol < 0:
        return False
    e0, e1, e2 = d0 - f[0], d1 - f[1], d2 - f[2]
    if rule.sine > 0:
        if size * rule.sine > rule.f0:
            square = np.float64(d0 * d0 + d1 * d1 + d2 * d2)
            along = d0 * f[0] + d1 * f[1] + d2 * f[2]
            if along <= 0 or abs(np.sqrt(square) - size) > tol:
                return False
            across = square * size * size - along * along
            most = rule.sine * (1 - 1e-6) - 1e-6
            return across <= most * most * square * size * size
        tol = min(tol, rule.f0 * (1 - 1e-6) - _ROUNDING * size)
    return e0 * e0 + e1 * e1 + e2 * e2 <= tol * tol


@inlined
def fits(d0, d1, d2, f, rule):
    """True where the vector of the reference may stand for a force; (0, 0, 0) is none."""
    size = np.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    there = d0 != 0 or d1 != 0 or d2 != 0
    if rule.exact and there != (size > 0):
        return False
    if rule.free:
        return (d0 - f[0]) ** 2 + (d1 - f[1]) ** 2 + (d2 - f[2]) ** 2 <= _REFERENCE_ERROR * rule.f0 * rule.f0
    return kept(d0, d1, d2, f, size, rule)


@inlined
def _mean_sizes(work, here):
    """Mean sizes of the residuals of the neighbours, along and across."""
    along = across = 0.0
    count = 0
    for axis in range(3):
        at = before(here, axis)
        if held(work.window, at):
            sizes = np.int64(work.window[at * WIDTH + SIZES])
            along += sizes & 255
            across += sizes >> 8 & 255
            count += 1
    return (along / count, across / count / 2) if count else (3.0, 3.0)


@lean
def _guessed(r, slope, bit):
    """Likely cost of a component, by the sizes around; only to compare candidates."""
    return 0.0 if r == 0 else 1.5 * bit + abs(r) * slope


@lean
def choose(bits, law, work, here, f, size, rule):
    """Put the residual of the force `f`, units float64 [3], into the row `STEPS`; the centre is set.

    Of the points around the force the one that costs least, by a guess or, with ``rule.thorough``, by its price; the
    nearest where none keeps the rule. Returns the cost: bits, or squared steps where every error has its price.
    """
    rows, level = work.rows, work.of[LEVEL]
    along = (f[0] * rows[AXES + 0, 0] + f[1] * rows[AXES + 0, 1] + f[2] * rows[AXES + 0, 2]) / 16384.0
    across_1 = (f[0] * rows[AXES + 1, 0] + f[1] * rows[AXES + 1, 1] + f[2] * rows[AXES + 1, 2]) / 16384.0
    across_2 = (f[0] * rows[AXES + 2, 0] + f[1] * rows[AXES + 2, 1] + f[2] * rows[AXES + 2, 2]) / 16384.0
    reached = level_of(min(np.int64(round(abs(along))), np.int64((1 << 18) - 1)), law.border, law.first)
    n0 = np.int64(round(((reached if along >= 0 else -reached) - level) / 256.0))
    bit = rule.thrift if rule.free else 1.0
    ease = 1.5 if rule.free else 0.5
    mean_0, mean_1 = _mean_sizes(work, here)
    slope_0, slope_1 = bit * 1.5 / (mean_0 + ease), bit * 1.5 / (mean_1 + ease)
    best = nearest = np.inf
    b0 = b1 = b2 = np.int64(0)
    for i in range(3):
        r0 = n0 + _AROUND[i]
        cost_0 = _guessed(r0, slope_0, bit)
        length = amplitude_of(level + 256 * r0, law.border)
        step = step_at(abs(length), law.cross_floor, law.cross_rate)
        n1, n2 = np.int64(round(across_1 / step)), np.int64(round(across_2 / step))
        for j in range(9):
            r1, r2 = n1 + _AROUND[j // 3], n2 + _AROUND[j % 3]
            cost = cost_0 + _guessed(r1, slope_1, bit) + _guessed(r2, slope_1, bit)
            if cost >= best and not rule.thorough:
                continue
            error = (along - length) ** 2 + (across_1 - r1 * step) ** 2 + (across_2 - r2 * step) ** 2
            if max(abs(r0), abs(r1), abs(r2)) >= 1 << 18 or not _allowed(law, work, r0, r1, r2, f, size, rule):
                if error < nearest and best == np.inf:
                    nearest = error
                    b0, b1, b2 = r0, r1, r2
                continue
            if rule.thorough:
                rows[STEPS, 0], rows[STEPS, 1], rows[STEPS, 2] = r0, r1, r2
                cost = bit * _price(bits, law, work)
            if rule.free:
                cost += error / np.float64(law.floor) ** 2
            if cost < best:
                best = cost
                b0, b1, b2 = r0, r1, r2
    rows[STEPS, 0], rows[STEPS, 1], rows[STEPS, 2] = b0, b1, b2
    return best


@inlined
def _allowed(law, work, r0, r1, r2, f, size, rule):
    """True where a residual may be told, and makes a force that keeps the rule."""
    if r0 == 0 and r1 == 0 and r2 == 0 and not work.of[BASED]:
        return False
    place(law, work, r0, r1, r2)
    d0, d1, d2 = work.rows[VECTOR, 0], work.rows[VECTOR, 1], work.rows[VECTOR, 2]
    if rule.exact and d0 == 0 and d1 == 0 and d2 == 0:
        return False
    return rule.free or kept(d0, d1, d2, f, size, rule)


@inlined
def _price(bits, law, work):
    """Bits that the residual in the row `STEPS` would take."""
    before_task, before_cost = bits.state[TASK], bits.cost[0]
    bits.state[TASK], bits.cost[0] = PRICING, 0.0
    for c in range(3):
        code_step(bits, law, work, c)
    cost = bits.cost[0]
    bits.state[TASK], bits.cost[0] = before_task, before_cost
    return cost


@lean
def still_pays(bits, law, work, here, f, size, rule):
    """True where a voxel that stands costs less than one that is moved, every error having its price.

    ``bits.cost`` holds the bits of letting it stand; what they are if it moves follows from them.
    """
    still_bits = bits.cost[0]
    error = 0.0
    for k in range(3):
        error += (np.float64(work.rows[EXPECTED, k]) - f[k]) ** 2
    aim(law, work, here)
    cost = choose(bits, law, work, here, f, size, rule)
    if work.of[BASED]:
        for k in range(3):
            work.rows[APART, k] = -work.rows[APART, k]  # as it was before `aim`
    moved_bits = -np.log2(max(1.0 - 2.0**-still_bits, 1e-5)) + (0.0 if rule.thorough else 1.0)
    return np.int64(error / np.float64(law.floor) ** 2 + rule.thrift * still_bits < cost + rule.thrift * moved_bits)
