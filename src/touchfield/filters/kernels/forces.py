"""Compiled loops over forces: clip and floor, pooling along the depth for arrays, and friction.

Of a stored field a column of the image asks at points that differ along z only: its forces are made between the four
columns of samples around it once for each stored depth, and the points in between are linear along z. `friction`
takes and gives plain numbers, so that the loop of a renderer can call it a thousand times a second. All sums are in
float64. Imported only when first needed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.arrays import Bools, Float32s, Float64s
from touchfield.lean import entry
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from touchfield.medium import ForceField, Grid

_INSIDE = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit


@entry
def _limited(begin, end, forces, force_max, floor, out, held):
    ceiling, bottom = force_max * force_max, floor * floor
    for n in range(begin, end):
        some = False
        for s in range(512):
            x, y, z = np.float64(forces[n, s, 0]), np.float64(forces[n, s, 1]), np.float64(forces[n, s, 2])
            square = x * x + y * y + z * z
            if square > ceiling:
                factor = force_max * _INSIDE / np.sqrt(square)
                x, y, z = x * factor, y * factor, z * factor
            elif square < bottom:
                x, y, z = np.float64(0), np.float64(0), np.float64(0)
            out[n, s, 0], out[n, s, 1], out[n, s, 2] = x, y, z
            if x != 0 or y != 0 or z != 0:
                some = True
        held[n] = some


def limited(forces_n: Float32s, force_max_n: float, floor_n: float) -> tuple[Float32s, Bools]:
    """Forces [n, 8, 8, 8, 3] clipped to a length and dropped below another, and which bricks hold any."""
    out = np.empty_like(forces_n)
    held = np.zeros(len(forces_n), np.bool_)
    flat = (len(forces_n), 512, 3)
    for_chunks(
        _limited, len(forces_n), forces_n.reshape(flat), force_max_n, floor_n, out.reshape(flat), held, chunk=64
    )
    return out, held


_COLUMNS_AT_ONCE = 256


@njit(cache=True, nogil=True, error_model="numpy")
def _pool(begin, end, places, counts, slots, forces, out):
    nx, ny, nz = counts[0], counts[1], counts[2]
    x_at, y_at, z_at = places
    rows = len(y_at)
    column = np.zeros((nz + 2, 3), np.float64)  # with a depth of nothing at both ends
    some = np.zeros(nz + 2, np.bool_)
    low, share = np.empty(len(z_at), np.int64), np.empty(len(z_at), np.float64)
    for m in range(len(z_at)):
        low[m] = min(max(int(np.floor(z_at[m])), -2), nz)
        share[m] = z_at[m] - low[m]
    for n in range(begin, end):
        x, y = x_at[n // rows], y_at[n % rows]
        i0, j0 = int(np.floor(x)), int(np.floor(y))
        column[:] = 0.0
        some[:] = False
        any_held = False
        for a in range(2):
            i, wx = i0 + a, (x - i0 if a else 1.0 - (x - i0))
            if i < 0 or i >= nx or wx == 0.0:
                continue
            for b in range(2):
                j, wy = j0 + b, (y - j0 if b else 1.0 - (y - j0))
                if j < 0 or j >= ny or wy == 0.0:
                    continue
                w = wx * wy
                for c in range(slots.shape[2]):
                    slot = slots[i >> 3, j >> 3, c]
                    if slot < 0:
                        continue
                    for k in range(min(8, nz - 8 * c)):
                        fx = forces[slot, i & 7, j & 7, k, 0]
                        fy = forces[slot, i & 7, j & 7, k, 1]
                        fz = forces[slot, i & 7, j & 7, k, 2]
                        if fx != 0 or fy != 0 or fz != 0:
                            at = 8 * c + k + 1
                            some[at] = any_held = True
                            column[at, 0] += w * fx
                            column[at, 1] += w * fy
                            column[at, 2] += w * fz
        if not any_held:
            continue
        greatest, total, count = 0.0, 0.0, 0
        for m in range(len(z_at)):
            at, after = low[m] + 1, share[m]
            if at < 0 or at > nz or not (some[at] or some[at + 1]):
                continue
            before = 1.0 - after
            px = np.float32(before * column[at, 0] + after * column[at + 1, 0])
            py = np.float32(before * column[at, 1] + after * column[at + 1, 1])
            pz = np.float32(before * column[at, 2] + after * column[at + 1, 2])
            square = np.float64(px) * px + np.float64(py) * py + np.float64(pz) * pz
            if square > 0.0:
                greatest = max(greatest, square)
                total += np.sqrt(square)
                count += 1
        out[n, 0] = np.sqrt(greatest)
        out[n, 1] = total / max(count, 1)


def pooled(stored: ForceField, asked: Grid) -> tuple[Float64s, Float64s]:
    """The greatest |F| along z at the points of a grid, and the mean of those that are there, float64 [x, y] each."""
    grid = stored.grid
    x, y, z = ((asked.axis_m(axis) - grid.origin_m[axis]) / grid.spacing_m[axis] for axis in range(3))
    slots = np.full(grid.brick_shape, -1, np.int64)
    slots[tuple(stored.bricks.T)] = np.arange(len(stored.bricks))
    out = np.zeros((len(x) * len(y), 2))
    given = ((x, y, z), np.array(grid.shape, np.int64), slots, stored.forces_n, out)
    for_chunks(_pool, len(out), *given, chunk=_COLUMNS_AT_ONCE)
    greatest, mean = out.reshape(len(x), len(y), 2).transpose(2, 0, 1)
    return greatest, mean


_IN_CONE = 1 - 2.0**-49  # so that rounding never lifts the friction out of its cone
_LEAST_N = 1e-290
"""Friction below this is none: near the least number of float64 its direction would be lost to rounding."""

_LEAST_SLIP = 2.0**-47
"""Of the greatest component of v: 32 units of rounding."""


@njit(cache=True, nogil=True)
def friction(fx, fy, fz, vx, vy, vz, mu, slip_speed):
    """F_t = -mu |F| v_t / max(|v_t|, v_s), three numbers, newtons.

    Force and velocity are first scaled by powers of two, which is exact, so that no square is lost at either end of
    float64. A slip so small beside v that its direction is rounding alone could drive the hand, and is taken as none.
    So F_t . v <= 0 holds of the numbers themselves, summed without rounding.
    """
    top, fast = max(abs(fx), abs(fy), abs(fz)), max(abs(vx), abs(vy), abs(vz))
    if top == 0 or fast == 0 or mu == 0:
        return 0.0, 0.0, 0.0
    lift, haste = math.frexp(top)[1], math.frexp(fast)[1]
    nx, ny, nz = math.ldexp(fx, -lift), math.ldexp(fy, -lift), math.ldexp(fz, -lift)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    ux, uy, uz = math.ldexp(vx, -haste), math.ldexp(vy, -haste), math.ldexp(vz, -haste)
    tx, ty, tz = ux, uy, uz
    for _ in range(2):  # the second time takes off what rounding left along n
        along = tx * nx + ty * ny + tz * nz
        tx, ty, tz = tx - along * nx, ty - along * ny, tz - along * nz
    slip = math.sqrt(tx * tx + ty * ty + tz * tz)
    if slip <= _LEAST_SLIP:
        return 0.0, 0.0, 0.0
    share, order = math.frexp(mu)
    size = math.ldexp(share * length * _IN_CONE, lift + order)
    whole = math.ldexp(slip_speed, -haste)  # infinite where v is all but nothing
    if whole > slip:
        size *= slip / whole  # one number, so that what it loses near the least of float64 turns no direction
    if size < _LEAST_N:
        return 0.0, 0.0, 0.0
    return -tx / slip * size, -ty / slip * size, -tz / slip * size


@njit(cache=True, nogil=True)
def frictions(forces, velocities, mu, slip_speed, out):
    """`friction` of many contacts, float64 [m, 3] of float64 [m, 3] twice."""
    for i in range(forces.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = friction(
            forces[i, 0], forces[i, 1], forces[i, 2],
            velocities[i, 0], velocities[i, 1], velocities[i, 2], mu, slip_speed,
        )  # fmt: skip
