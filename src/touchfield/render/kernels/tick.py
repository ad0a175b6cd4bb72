"""One tick of the renderer, from the place of the device to its force (paper section 3.2, the last box of figure 4).

    place -> axes, scale, clutch -> velocity -> proxy, or field, or coupling -> friction, damping -> vibration
          -> axes, force scale -> passivity -> gravity -> gain -> limits -> force

`tick` and `release` are the only two that hand out forces, and both do so through `limits.limited`. They take the
four views of the block (`touchfield.render.memory`) and leave what a log may want in the state
(`touchfield.render.places`), and the torque of a tool at its own place (`touchfield.render.wrench_places`).

The gain goes to zero in the time that was asked for when there is no frame, or no place of the device that could be
one, and comes back likewise: of a force that cannot be computed any more, the last one is let go. All of it follows,
also the force for the weight of the handle.
"""

from __future__ import annotations

import math

from numba import njit

from touchfield.filters.kernels.forces import friction
from touchfield.render.kernels.effects import adapt, braked, coupled, moved, observe, passive, remember, vibration
from touchfield.render.kernels.frames import force_at
from touchfield.render.kernels.limits import clamped_dt, has_passed, length, limited
from touchfield.render.kernels.proxy import held
from touchfield.render.kernels.tool import tool_force
from touchfield.render.kernels.wrench import is_turned, let_torque_go, put_torque, want_torque
from touchfield.render.places import (
    AXES,
    CLUTCH,
    DAMPING,
    DEVICE_POSITION,
    FIELD_FORCE,
    FORCE,
    FORCE_SCALE,
    FRICTION,
    FRICTION_FORCE,
    GAIN,
    GRAVITY,
    IS_COUPLED,
    IS_STARTED,
    POSITION,
    RAMP_S,
    SCALE,
    SINCE_S,
    SLIP_SPEED,
    SOFTNESS,
    VELOCITY,
    WALL,
    WANTED,
)
from touchfield.render.wrench_places import FIELD_TORQUE, TOOL_POINTS

__all__ = ["release", "tick"]

_FARTHEST_M = 1e6  # what lies farther off is no place of a hand
_HARD = 1e-9  # m/N; a coupling of this softness is none
_LONGEST_S = 60.0  # a tick that comes later is as good as a first one


@njit(cache=True, nogil=True)
def tick(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z, dt):
    """The force of one tick, three numbers, newtons, the device's axes.

    Parameters
    ----------
    i8, u8, f8, f4 : int64, uint64, float64 [words], float32 [2 * words]
        The block.
    frame_a, frame_b : int
        Places of the frames before and after this time (`kernels.frames`), perhaps the same; 0: there is none.
    blend : float
        0 to 1, from the one to the other.
    x, y, z : float
        Place of the device, metres, its axes; may be any numbers, but of this type: others are compiled anew.
    dt : float
        Seconds since the tick before; one that is not positive and finite gives the force before once more.
    """
    if not has_passed(f8, dt):
        return f8[FORCE], f8[FORCE + 1], f8[FORCE + 2]
    dt = min(dt, _LONGEST_S)
    f8[SINCE_S] += dt
    remember(f8)
    is_placed = abs(x) <= _FARTHEST_M and abs(y) <= _FARTHEST_M and abs(z) <= _FARTHEST_M  # false of NaN, too
    is_placed = is_placed and is_turned(i8, f8)
    if is_placed:
        _arrive(f8, x, y, z)
    if frame_a != 0 and frame_b != 0 and is_placed:
        gain = min(1.0, f8[GAIN] + clamped_dt(f8, dt) / f8[RAMP_S])
        f8[WANTED], f8[WANTED + 1], f8[WANTED + 2] = _wanted(i8, u8, f8, f4, frame_a, frame_b, blend, dt)
    else:
        gain = max(0.0, f8[GAIN] - clamped_dt(f8, dt) / f8[RAMP_S])
        _leave(f8)
        if gain == 0.0:
            f8[WANTED], f8[WANTED + 1], f8[WANTED + 2] = 0.0, 0.0, 0.0
    f8[GAIN] = gain
    put_torque(f8, gain, dt)
    return limited(f8, gain * f8[WANTED], gain * f8[WANTED + 1], gain * f8[WANTED + 2], dt)


@njit(cache=True, nogil=True)
def release(i8, u8, f8, f4, dt):
    """The next force on the way to zero, three numbers, newtons, the device's axes; zero in the end and ever after.

    It goes down in a straight line within the time of the ramp, or as fast as the slew limit allows.
    """
    if not has_passed(f8, dt):
        return f8[FORCE], f8[FORCE + 1], f8[FORCE + 2]
    before = f8[GAIN]
    gain = max(0.0, before - clamped_dt(f8, dt) / f8[RAMP_S])
    share = gain / before if gain > 0.0 else 0.0
    f8[GAIN], f8[IS_STARTED] = gain, 0.0
    _leave(f8)
    for n in range(3):
        f8[WANTED + n] = 0.0
    let_torque_go(f8, share, dt)
    return limited(f8, share * f8[FORCE], share * f8[FORCE + 1], share * f8[FORCE + 2], dt)


@njit(cache=True, nogil=True, forceinline=True)
def _leave(f8):
    """No field and no friction are felt."""
    f8[IS_COUPLED] = 0.0
    for n in range(3):
        f8[FIELD_FORCE + n], f8[FRICTION_FORCE + n], f8[FIELD_TORQUE + n] = 0.0, 0.0, 0.0


@njit(cache=True, nogil=True, forceinline=True)
def _arrive(f8, x, y, z):
    """Keep a place of the device: where that is in the field, how fast it came there, what energy that took."""
    scale = f8[SCALE]
    px = f8[CLUTCH] + scale * (f8[AXES] * x + f8[AXES + 1] * y + f8[AXES + 2] * z)
    py = f8[CLUTCH + 1] + scale * (f8[AXES + 3] * x + f8[AXES + 4] * y + f8[AXES + 5] * z)
    pz = f8[CLUTCH + 2] + scale * (f8[AXES + 6] * x + f8[AXES + 7] * y + f8[AXES + 8] * z)
    if f8[IS_STARTED] != 0.0:
        observe(f8, x - f8[DEVICE_POSITION], y - f8[DEVICE_POSITION + 1], z - f8[DEVICE_POSITION + 2])
        moved(f8, px - f8[POSITION], py - f8[POSITION + 1], pz - f8[POSITION + 2], f8[SINCE_S])
        adapt(f8)
    else:
        adapt(f8)
        f8[VELOCITY], f8[VELOCITY + 1], f8[VELOCITY + 2] = 0.0, 0.0, 0.0
    f8[IS_STARTED], f8[SINCE_S] = 1.0, 0.0
    f8[DEVICE_POSITION], f8[DEVICE_POSITION + 1], f8[DEVICE_POSITION + 2] = x, y, z
    f8[POSITION], f8[POSITION + 1], f8[POSITION + 2] = px, py, pz


@njit(cache=True, nogil=True)
def _wanted(i8, u8, f8, f4, frame_a, frame_b, blend, dt):
    """The force before gain and limits, newtons, the device's axes."""
    px, py, pz = f8[POSITION], f8[POSITION + 1], f8[POSITION + 2]
    vx, vy, vz = f8[VELOCITY], f8[VELOCITY + 1], f8[VELOCITY + 2]
    if f8[WALL] > 0.0:
        (fx, fy, fz), (tx, ty, tz) = held(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz)
    else:
        if i8[TOOL_POINTS] > 0:
            fx, fy, fz = tool_force(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz)
            want_torque(f8)
        elif f8[SOFTNESS] > _HARD:
            fx, fy, fz, px, py, pz = coupled(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz, dt)
        else:
            fx, fy, fz = force_at(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz)
        if not (math.isfinite(fx) and math.isfinite(fy) and math.isfinite(fz)):
            fx, fy, fz = 0.0, 0.0, 0.0
        tx, ty, tz = friction(fx, fy, fz, vx, vy, vz, f8[FRICTION], f8[SLIP_SPEED])
    f8[FIELD_FORCE], f8[FIELD_FORCE + 1], f8[FIELD_FORCE + 2] = fx, fy, fz
    f8[FRICTION_FORCE], f8[FRICTION_FORCE + 1], f8[FRICTION_FORCE + 2] = tx, ty, tz
    size, sine = length(fx, fy, fz), vibration(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz, dt)
    sx, sy, sz = braked(f8, fx, fy, fz, vx, vy, vz)
    tx, ty, tz = tx - f8[DAMPING] * vx, ty - f8[DAMPING] * vy, tz - f8[DAMPING] * vz
    if size > 0.0:
        tx, ty, tz = tx + fx / size * sine, ty + fy / size * sine, tz + fz / size * sine
    else:
        tz += sine
    fx, fy, fz = _turned(f8, sx + tx, sy + ty, sz + tz, f8[FORCE_SCALE])
    vx, vy, vz = _turned(f8, vx, vy, vz, 1.0 / f8[SCALE])
    fx, fy, fz = passive(f8, fx, fy, fz, vx, vy, vz, dt)
    return fx + f8[GRAVITY], fy + f8[GRAVITY + 1], fz + f8[GRAVITY + 2]


@njit(cache=True, nogil=True, forceinline=True)
def _turned(f8, x, y, z, scale):
    """A vector of the field in the device's axes, times a number."""
    return (
        scale * (f8[AXES] * x + f8[AXES + 3] * y + f8[AXES + 6] * z),
        scale * (f8[AXES + 1] * x + f8[AXES + 4] * y + f8[AXES + 7] * z),
        scale * (f8[AXES + 2] * x + f8[AXES + 5] * y + f8[AXES + 8] * z),
    )
