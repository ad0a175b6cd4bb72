"""The compiled core of `touchfield.filters.contact`: one contact, in numbers, and a loop over many.

`friction` takes and gives plain numbers, so that the loop of a renderer can call it a thousand times a second. All
is in float64. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["friction", "frictions"]

_INSIDE = 1 - 2.0**-49  # so that rounding never lifts the friction out of its cone
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
    size = math.ldexp(share * length * _INSIDE, lift + order)
    whole = math.ldexp(slip_speed, -haste)  # infinite where v is all but nothing
    if whole > slip:
        size *= slip / whole  # one number, so that what it loses near the least of float64 turns no direction
    if size < _LEAST_N:
        return 0.0, 0.0, 0.0
    return -tx / slip * size, -ty / slip * size, -tz / slip * size


@njit(cache=True, nogil=True)
def _frictions(forces, velocities, mu, slip_speed, out):
    for i in range(forces.shape[0]):
        out[i, 0], out[i, 1], out[i, 2] = friction(
            forces[i, 0], forces[i, 1], forces[i, 2],
            velocities[i, 0], velocities[i, 1], velocities[i, 2], mu, slip_speed,
        )  # fmt: skip


def frictions(forces_n: Float64s, velocities_m_s: Float64s, mu: float, slip_speed_m_s: float) -> Float64s:
    """`friction` of many contacts, float64 [m, 3] of float64 [m, 3] twice."""
    out = np.empty_like(forces_n)
    _frictions(forces_n, velocities_m_s, mu, slip_speed_m_s, out)
    return out
