"""The limits that every force passes last: heat, peak, slew (devices.md: "every force that leaves the program ...").

A torque passes the same ones, with numbers of its own; below, F may be either.

Numbers go in and numbers come out, and what comes out is what counts: |F| <= limit and |F - F_before| <= slew dt hold
of the float64 that are handed out, however a reader computes these lengths.

Both always hold, because the limit itself sinks by no more than half of what the slew limit allows in that time. So
the force before can be shortened to the limit of now, which takes half the way at most; the rest of the way leads
straight towards the force that is wanted, and between two points of a ball one does not leave it.

The continuous limit C is one of heat: H follows |F|^2 with the time constant of the motors. Up to H = 3/4 C^2 the
peak is allowed; from there to H = C^2 the limit sinks to C, so that a force that is asked for without end comes down
to C without a step, and stays there.
"""

from __future__ import annotations

import math

from numba import njit

from touchfield.render.places import CONTINUOUS, FORCE, HEAT, LIMIT, PEAK, RATE_HZ, SLEW, THERMAL_S
from touchfield.render.wrench_places import (
    TORQUE,
    TORQUE_CONTINUOUS,
    TORQUE_HEAT,
    TORQUE_LIMIT,
    TORQUE_PEAK,
    TORQUE_SLEW,
)

_FORCE = (FORCE, HEAT, LIMIT, PEAK, CONTINUOUS, SLEW)
_TORQUE = (TORQUE, TORQUE_HEAT, TORQUE_LIMIT, TORQUE_PEAK, TORQUE_CONTINUOUS, TORQUE_SLEW)
"""Where each keeps what was handed out, its heat and its limit at present, and where its own limits stand."""

_INSIDE = 1 - 2.0**-40
"""So much of a limit is used; the rest is for the rounding of those who look."""

_ROUNDING = 2.0**-49
"""Of the forces themselves: what their differences may be off by."""

_COOL_SHARE = 0.75
"""Of C^2: below this heat the peak is allowed."""

_LATEST_TICKS = 2.0
"""A tick that comes later may move the force no further than one that comes now: no leap after a stall."""


@njit(cache=True, nogil=True, forceinline=True)
def length(x, y, z):
    """sqrt(x^2 + y^2 + z^2), also where the squares are beyond float64."""
    most = max(abs(x), abs(y), abs(z))
    if most == 0.0:
        return 0.0
    x, y, z = x / most, y / most, z / most
    return most * math.sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True, forceinline=True)
def has_passed(f8, dt):
    """Whether dt is a time in which something may change; in a block without parameters nothing does."""
    return dt > 0.0 and dt < math.inf and f8[RATE_HZ] > 0.0


@njit(cache=True, nogil=True, forceinline=True)
def clamped_dt(f8, dt):
    """The time for which forces and gains may move, seconds."""
    return min(dt, _LATEST_TICKS / f8[RATE_HZ])


@njit(cache=True, nogil=True, forceinline=True)
def _heated(f8, at, dt):
    """Heat after a time in which the force before was held; the limit that goes with it."""
    held, heat_at, _, peak_at, continuous_at, _ = at
    x, y, z = f8[held], f8[held + 1], f8[held + 2]
    heat = f8[heat_at]
    heat += (x * x + y * y + z * z - heat) * -math.expm1(-dt / f8[THERMAL_S])
    f8[heat_at] = heat
    peak, continuous = f8[peak_at], f8[continuous_at]
    if continuous <= 0.0:
        return peak
    most = continuous * continuous
    cool = (most - heat) / ((1.0 - _COOL_SHARE) * most)
    return continuous + (peak - continuous) * min(max(cool, 0.0), 1.0)


@njit(cache=True, nogil=True, forceinline=True)
def _within(f8, at, x, y, z, dt):
    """What may be handed out where (x, y, z) is wanted; `at` is `_FORCE` or `_TORQUE`."""
    held, _, limit_at, peak_at, _, slew_at = at
    fx, fy, fz = f8[held], f8[held + 1], f8[held + 2]
    if not has_passed(f8, dt):
        return fx, fy, fz
    bound = _heated(f8, at, dt)
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        x, y, z = 0.0, 0.0, 0.0
    before = length(fx, fy, fz)
    step = f8[slew_at] * clamped_dt(f8, dt)
    room = step * _INSIDE - _ROUNDING * f8[peak_at]
    if room <= 0.0:
        return fx, fy, fz  # the time was too short for any step that float64 can tell
    bound = max(bound, f8[limit_at] - 0.5 * room)
    f8[limit_at] = bound
    bound *= _INSIDE
    size = length(x, y, z)
    if size > bound:
        share = bound / size
        x, y, z = x * share, y * share, z * share
    if before > bound:
        share = bound / before
        fx, fy, fz = fx * share, fy * share, fz * share
        room = max(0.0, room - (before - bound))
    dx, dy, dz = x - fx, y - fy, z - fz
    way = length(dx, dy, dz)
    if way > room:
        share = room / way
        x, y, z = fx + dx * share, fy + dy * share, fz + dz * share
    x, y, z = x + 0.0, y + 0.0, z + 0.0  # -0.0 is 0.0
    f8[held], f8[held + 1], f8[held + 2] = x, y, z
    return x, y, z


@njit(cache=True, nogil=True)
def limited(f8, x, y, z, dt):
    """The force that may be handed out where (x, y, z) is wanted, newtons; keeps it, heat and limit in the state.

    A dt that is not positive gives the force before once more.
    """
    return _within(f8, _FORCE, x, y, z, dt)


@njit(cache=True, nogil=True)
def limited_torque(f8, x, y, z, dt):
    """The same of a torque, newton metres; zero for ever where the device states none."""
    return _within(f8, _TORQUE, x, y, z, dt)
