"""One tick of the renderer, from the place of the device to its force (paper section 3.2, the last box of figure 4).

    place -> axes, scale, clutch -> velocity -> proxy, or field, or coupling -> friction, damping -> vibration
          -> axes, force scale -> passivity -> gravity -> gain -> limits -> force

`tick` and `release` are the only two that hand out forces, and both do so through `effects.limited`. They take the
four views of the block, and leave in it what a log may want and the torque of a tool (`block.words`), whose way is
that of the force.

The gain goes to zero in the time that was asked for when there is no frame, or no place of the device that could be
one, and comes back likewise: of a force that cannot be computed any more, the last one is let go. All of it follows,
also the force for the weight of the handle.

A grip that says no orientation (not finite, or no unit quaternion) is as a device that says no place: gain goes down,
and of a torque that cannot be computed any more the last one is let go, within the limits.
"""

from __future__ import annotations

import math

from numba import njit

from touchfield.filters.kernels.forces import friction
from touchfield.render.block import words as W
from touchfield.render.kernels.effects import (
    adapt,
    braked,
    clamped_dt,
    coupled,
    has_passed,
    length,
    limited,
    limited_torque,
    moved,
    observe,
    passive,
    remember,
    vibration,
)  # fmt: skip
from touchfield.render.kernels.frames import force_at, turned
from touchfield.render.kernels.points import tool_force
from touchfield.render.kernels.proxy import held

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
        return f8[W.FORCE], f8[W.FORCE + 1], f8[W.FORCE + 2]
    dt = min(dt, _LONGEST_S)
    f8[W.SINCE_S] += dt
    remember(f8)
    is_placed = abs(x) <= _FARTHEST_M and abs(y) <= _FARTHEST_M and abs(z) <= _FARTHEST_M  # false of NaN, too
    is_placed = is_placed and is_turned(i8, f8)
    if is_placed:
        _arrive(f8, x, y, z)
    if frame_a != 0 and frame_b != 0 and is_placed:
        gain = min(1.0, f8[W.GAIN] + clamped_dt(f8, dt) / f8[W.RAMP_S])
        f8[W.WANTED], f8[W.WANTED + 1], f8[W.WANTED + 2] = _wanted(i8, u8, f8, f4, frame_a, frame_b, blend, dt)
    else:
        gain = max(0.0, f8[W.GAIN] - clamped_dt(f8, dt) / f8[W.RAMP_S])
        _leave(f8)
        if gain == 0.0:
            f8[W.WANTED], f8[W.WANTED + 1], f8[W.WANTED + 2] = 0.0, 0.0, 0.0
    f8[W.GAIN] = gain
    put_torque(f8, gain, dt)
    return limited(f8, gain * f8[W.WANTED], gain * f8[W.WANTED + 1], gain * f8[W.WANTED + 2], dt)


@njit(cache=True, nogil=True)
def release(i8, u8, f8, f4, dt):
    """The next force on the way to zero, three numbers, newtons, the device's axes; zero in the end and ever after.

    It goes down in a straight line within the time of the ramp, or as fast as the slew limit allows.
    """
    if not has_passed(f8, dt):
        return f8[W.FORCE], f8[W.FORCE + 1], f8[W.FORCE + 2]
    before = f8[W.GAIN]
    gain = max(0.0, before - clamped_dt(f8, dt) / f8[W.RAMP_S])
    share = gain / before if gain > 0.0 else 0.0
    f8[W.GAIN], f8[W.IS_STARTED] = gain, 0.0
    _leave(f8)
    for n in range(3):
        f8[W.WANTED + n] = 0.0
    let_torque_go(f8, share, dt)
    return limited(f8, share * f8[W.FORCE], share * f8[W.FORCE + 1], share * f8[W.FORCE + 2], dt)


@njit(cache=True, nogil=True, forceinline=True)
def _leave(f8):
    """No field and no friction are felt."""
    f8[W.IS_COUPLED] = 0.0
    for n in range(3):
        f8[W.FIELD_FORCE + n], f8[W.FRICTION_FORCE + n], f8[W.FIELD_TORQUE + n] = 0.0, 0.0, 0.0


@njit(cache=True, nogil=True, forceinline=True)
def _arrive(f8, x, y, z):
    """Keep a place of the device: where that is in the field, how fast it came there, what energy that took."""
    scale = f8[W.SCALE]
    px = f8[W.CLUTCH] + scale * (f8[W.AXES] * x + f8[W.AXES + 1] * y + f8[W.AXES + 2] * z)
    py = f8[W.CLUTCH + 1] + scale * (f8[W.AXES + 3] * x + f8[W.AXES + 4] * y + f8[W.AXES + 5] * z)
    pz = f8[W.CLUTCH + 2] + scale * (f8[W.AXES + 6] * x + f8[W.AXES + 7] * y + f8[W.AXES + 8] * z)
    if f8[W.IS_STARTED] != 0.0:
        observe(f8, x - f8[W.DEVICE_POSITION], y - f8[W.DEVICE_POSITION + 1], z - f8[W.DEVICE_POSITION + 2])
        moved(f8, px - f8[W.POSITION], py - f8[W.POSITION + 1], pz - f8[W.POSITION + 2], f8[W.SINCE_S])
        adapt(f8)
    else:
        adapt(f8)
        f8[W.VELOCITY], f8[W.VELOCITY + 1], f8[W.VELOCITY + 2] = 0.0, 0.0, 0.0
    f8[W.IS_STARTED], f8[W.SINCE_S] = 1.0, 0.0
    f8[W.DEVICE_POSITION], f8[W.DEVICE_POSITION + 1], f8[W.DEVICE_POSITION + 2] = x, y, z
    f8[W.POSITION], f8[W.POSITION + 1], f8[W.POSITION + 2] = px, py, pz


@njit(cache=True, nogil=True)
def _wanted(i8, u8, f8, f4, frame_a, frame_b, blend, dt):
    """The force before gain and limits, newtons, the device's axes."""
    px, py, pz = f8[W.POSITION], f8[W.POSITION + 1], f8[W.POSITION + 2]
    vx, vy, vz = f8[W.VELOCITY], f8[W.VELOCITY + 1], f8[W.VELOCITY + 2]
    if f8[W.WALL] > 0.0:
        (fx, fy, fz), (tx, ty, tz) = held(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz)
    else:
        if i8[W.TOOL_POINTS] > 0:
            fx, fy, fz = tool_force(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz)
            want_torque(f8)
        elif f8[W.SOFTNESS] > _HARD:
            fx, fy, fz, px, py, pz = coupled(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz, dt)
        else:
            fx, fy, fz = force_at(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz)
        if not (math.isfinite(fx) and math.isfinite(fy) and math.isfinite(fz)):
            fx, fy, fz = 0.0, 0.0, 0.0
        tx, ty, tz = friction(fx, fy, fz, vx, vy, vz, f8[W.FRICTION], f8[W.SLIP_SPEED])
    f8[W.FIELD_FORCE], f8[W.FIELD_FORCE + 1], f8[W.FIELD_FORCE + 2] = fx, fy, fz
    f8[W.FRICTION_FORCE], f8[W.FRICTION_FORCE + 1], f8[W.FRICTION_FORCE + 2] = tx, ty, tz
    size, sine = length(fx, fy, fz), vibration(i8, u8, f8, f4, frame_a, frame_b, blend, px, py, pz, dt)
    sx, sy, sz = braked(f8, fx, fy, fz, vx, vy, vz)
    tx, ty, tz = tx - f8[W.DAMPING] * vx, ty - f8[W.DAMPING] * vy, tz - f8[W.DAMPING] * vz
    if size > 0.0:
        tx, ty, tz = tx + fx / size * sine, ty + fy / size * sine, tz + fz / size * sine
    else:
        tz += sine
    fx, fy, fz = _turned(f8, sx + tx, sy + ty, sz + tz, f8[W.FORCE_SCALE])
    vx, vy, vz = _turned(f8, vx, vy, vz, 1.0 / f8[W.SCALE])
    fx, fy, fz = passive(f8, fx, fy, fz, vx, vy, vz, dt)
    return fx + f8[W.GRAVITY], fy + f8[W.GRAVITY + 1], fz + f8[W.GRAVITY + 2]


@njit(cache=True, nogil=True, forceinline=True)
def _turned(f8, x, y, z, scale):
    """A vector of the field in the device's axes, times a number."""
    return (
        scale * (f8[W.AXES] * x + f8[W.AXES + 3] * y + f8[W.AXES + 6] * z),
        scale * (f8[W.AXES + 1] * x + f8[W.AXES + 4] * y + f8[W.AXES + 7] * z),
        scale * (f8[W.AXES + 2] * x + f8[W.AXES + 5] * y + f8[W.AXES + 8] * z),
    )


# -- torque ---------------------------------------------------------------------------------------------------------

_LEAST, _MOST = 0.81, 1.21
"""Of the square of a quaternion that was meant to be of length 1."""


@njit(cache=True, nogil=True)
def is_turned(i8, f8):
    """Whether the device says how the grip is turned; keeps how that turns the tool in the field."""
    if i8[W.TOOL_POINTS] == 0:
        return True
    w, x, y, z = f8[W.ORIENTATION], f8[W.ORIENTATION + 1], f8[W.ORIENTATION + 2], f8[W.ORIENTATION + 3]
    square = w * w + x * x + y * y + z * z
    if not _LEAST <= square <= _MOST:  # false of NaN, too
        return False
    s = 2.0 / square
    grip = (
        (1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
        (s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)),
        (s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)),
    )
    axes = (
        (f8[W.AXES], f8[W.AXES + 1], f8[W.AXES + 2]),
        (f8[W.AXES + 3], f8[W.AXES + 4], f8[W.AXES + 5]),
        (f8[W.AXES + 6], f8[W.AXES + 7], f8[W.AXES + 8]),
    )
    for n in range(3):  # W.AXES . grip . W.AXES', column by column
        gx, gy, gz = turned(grip, axes[n][0], axes[n][1], axes[n][2])
        gx, gy, gz = turned(axes, gx, gy, gz)
        f8[W.TURN + n], f8[W.TURN + 3 + n], f8[W.TURN + 6 + n] = gx, gy, gz
    return True


@njit(cache=True, nogil=True, forceinline=True)
def want_torque(f8):
    """The torque before gain and limits: a lever of the field is `SCALE` times the device's."""
    tx, ty, tz = f8[W.FIELD_TORQUE], f8[W.FIELD_TORQUE + 1], f8[W.FIELD_TORQUE + 2]
    if not (math.isfinite(tx) and math.isfinite(ty) and math.isfinite(tz)):
        tx, ty, tz = 0.0, 0.0, 0.0
    scale = f8[W.HANDEDNESS] * f8[W.FORCE_SCALE] / f8[W.SCALE]
    for n in range(3):
        f8[W.WANTED_TORQUE + n] = scale * (f8[W.AXES + n] * tx + f8[W.AXES + 3 + n] * ty + f8[W.AXES + 6 + n] * tz)


@njit(cache=True, nogil=True, forceinline=True)
def put_torque(f8, gain, dt):
    """Hand out the torque that is wanted, as far as gain and limits let it."""
    if gain == 0.0:
        f8[W.WANTED_TORQUE], f8[W.WANTED_TORQUE + 1], f8[W.WANTED_TORQUE + 2] = 0.0, 0.0, 0.0
    limited_torque(f8, gain * f8[W.WANTED_TORQUE], gain * f8[W.WANTED_TORQUE + 1], gain * f8[W.WANTED_TORQUE + 2], dt)


@njit(cache=True, nogil=True, forceinline=True)
def let_torque_go(f8, share, dt):
    """The next torque on the way to zero: `share` of the one before."""
    for n in range(3):
        f8[W.WANTED_TORQUE + n] = 0.0
    limited_torque(f8, share * f8[W.TORQUE], share * f8[W.TORQUE + 1], share * f8[W.TORQUE + 2], dt)
