"""The encoder's choices in the quick model of coder `touch`: floats, for the decoder follows none of them."""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.touch_lattice import step_at
from touchfield.codec.kernels.touch_light_choice import FREE, SINE, THRIFT, kept
from touchfield.codec.kernels.touch_light_coder import lean
from touchfield.codec.kernels.touch_quick_cells import across_axes, direction_of, level_at, moved, scaled

__all__ = ["choose", "good", "looked_over"]


@lean
def good(v0, v1, v2, f, size, tol, rule, lattice):
    """Whether a vector may stand for the force `f` without a residual."""
    d0, d1, d2 = np.float64(v0), np.float64(v1), np.float64(v2)
    if rule[FREE] > 0:
        least = (0.5 + 0.2 * rule[THRIFT]) * lattice[0]
        return (d0 - f[0]) ** 2 + (d1 - f[1]) ** 2 + (d2 - f[2]) ** 2 < least * least
    return kept(d0, d1, d2, f[0], f[1], f[2], size, tol, rule)


@lean
def choose(f, size, tol, rule, u0, u1, u2, a, border, first, lattice, found):
    """The residual (r0, r1, r2) of the force `f`, units float64 [3], to the direction and amplitude expected.

    Into int64 `found` [3]: the cheapest of a few points about the nearest one that keep the rule; where none does,
    the nearest.
    """
    along = (f[0] * u0 + f[1] * u1 + f[2] * u2) / 65536.0
    level = level_at(a, border, first)
    reached = level_at(min(np.int64(abs(along)), (np.int64(1) << 18) - 1), border, first)
    if along < 0:
        reached = -reached
    n0 = (reached - level + 8) >> 4
    free = rule[FREE] > 0
    best = np.inf
    nearest = np.inf
    h0, h1, h2, k0, k1, k2 = across_axes(u0, u1, u2)
    across_1 = (f[0] * h0 + f[1] * h1 + f[2] * h2) / 65536.0
    across_2 = (f[0] * k0 + f[1] * k1 + f[2] * k2) / 65536.0
    wide = across_1 * across_1 + across_2 * across_2
    least = np.float64(lattice[0]) * lattice[0]
    ball = rule[SINE] == 0 and not free
    most = tol * tol * 1.02 + 16.0
    toward = -1 if n0 > 0 else 1
    for turn in range(3):  # without a step across, with one, and then from all about
        if turn > 0 and best < np.inf and not (turn == 1 and free):
            break
        for i in range(4):
            r0 = n0 + toward if i == 0 else (n0 if i == 1 else (n0 - toward if i == 2 else np.int64(0)))
            if i == 3 and abs(n0) < 2:
                continue
            if turn == 0:
                if r0 == 0:
                    continue
                length = moved(a, r0, border, first)
                error = (along - length) ** 2 + wide
                if ball and error > most and error >= nearest:
                    continue
                if free:
                    cost = error / least + rule[THRIFT] * 0.3 * (1.5 + abs(r0))
                    if cost < best:
                        best = cost
                        found[0], found[1], found[2] = r0, 0, 0
                    continue
                w0, w1, w2 = u0, u1, u2
                if length <= 0:
                    w0, w1, w2, length = -u0, -u1, -u2, -length
                length = max(length, np.int64(1))
                if kept(
                    np.float64(scaled(w0, length)), np.float64(scaled(w1, length)), np.float64(scaled(w2, length)),
                    f[0], f[1], f[2], size, tol, rule,
                ):  # fmt: skip
                    if abs(r0) < best:
                        best = abs(r0)
                        found[0], found[1], found[2] = r0, 0, 0
                elif best == np.inf and error < nearest:
                    nearest = error
                    found[0], found[1], found[2] = r0, 0, 0
                continue
            length = moved(a, r0, border, first)
            step = step_at(abs(length), lattice[2], lattice[3])
            n1, n2 = np.int64(round(across_1 / step)), np.int64(round(across_2 / step))
            for j in range(3 if turn == 1 else 9):
                if turn == 1:
                    r1 = n1 if j != 1 else np.int64(0)
                    r2 = n2 if j != 0 else np.int64(0)
                else:
                    r1, r2 = n1 + j // 3 - 1, n2 + j % 3 - 1
                if r1 == 0 and r2 == 0:
                    continue
                cost = (1.0 + abs(r0) if r0 != 0 else 0.0) + abs(r1) + abs(r2) + (r1 != 0) + (r2 != 0)
                error = (along - length) ** 2 + (across_1 - r1 * step) ** 2 + (across_2 - r2 * step) ** 2
                if free:
                    cost = error / least + rule[THRIFT] * 0.3 * cost
                if cost >= best or (ball and error > most and error >= nearest):
                    continue
                if max(abs(r0), abs(r1), abs(r2)) >= 1 << 17:
                    continue
                s1, s2 = r1 * step, r2 * step
                v0 = scaled(1, length * u0 + s1 * h0 + s2 * k0)
                v1 = scaled(1, length * u1 + s1 * h1 + s2 * k1)
                v2 = scaled(1, length * u2 + s1 * h2 + s2 * k2)
                if v0 == 0 and v1 == 0 and v2 == 0:
                    continue
                w0, w1, w2, reach = direction_of(v0, v1, v2)
                d0, d1, d2 = scaled(w0, reach), scaled(w1, reach), scaled(w2, reach)
                if free or kept(np.float64(d0), np.float64(d1), np.float64(d2), f[0], f[1], f[2], size, tol, rule):
                    best = cost
                    found[0], found[1], found[2] = r0, r1, r2
                elif best == np.inf and error < nearest:
                    nearest = error
                    found[0], found[1], found[2] = r0, r1, r2
    return best < np.inf


@njit(cache=True, nogil=True, error_model="numpy")
def looked_over(forces):
    """The longest component of each brick of float32 [n, 8, 8, 8, 3], and how many samples have a force."""
    peak = np.zeros(forces.shape[0], np.float32)
    count = 0
    for n in range(forces.shape[0]):
        most = np.float32(0)
        for x in range(8):
            for y in range(8):
                for z in range(8):
                    a, b, c = abs(forces[n, x, y, z, 0]), abs(forces[n, x, y, z, 1]), abs(forces[n, x, y, z, 2])
                    own = max(a, max(b, c))
                    count += own > 0
                    most = max(most, own)
        peak[n] = most
    return peak, count
