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

from numba import njit

from touchfield.filters.kernels.forces import friction
from touchfield.render.block import words as W
from touchfield.render.kernels import effects
from touchfield.render.kernels.deformation import give_way
from touchfield.render.kernels.frames import force_at
from touchfield.render.kernels.material import material_at, texture
from touchfield.render.kernels.points import tool_force
from touchfield.render.kernels.proxy import held
from touchfield.render.kernels.vectors import (
    along,
    dot,
    is_finite,
    length,
    less,
    matrix_of,
    plus,
    put,
    rows_of,
    three,
    times,
    turned,
    turned_back,
)

_NOTHING = 0.0, 0.0, 0.0
_FARTHEST_M = 1e6  # what lies farther off is no place of a hand
_HARD = 1e-9  # m/N; a coupling of this softness is none
_LONGEST_S = 60.0  # a tick that comes later is as good as a first one
_LEAST, _MOST = 0.81, 1.21  # of the square of a quaternion that was meant to be of length 1


@njit(cache=True, nogil=True)
def tick(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z, dt):
    """The force of one tick, three numbers, newtons, the device's axes.

    The first four are the block. `frame_a` and `frame_b` are places of the frames before and after this time, perhaps
    the same; 0: there is none. `blend`, 0 to 1, goes from the one to the other. (x, y, z) is the place of the device,
    metres, its axes; any floats (others are compiled anew). A `dt`, seconds since the tick before, that is not
    positive and finite gives the force before once more.
    """
    if not effects.has_passed(f8, dt):
        return three(f8, W.FORCE)
    dt = min(dt, _LONGEST_S)
    f8[W.SINCE_S] += dt
    effects.remember(f8)
    is_placed = abs(x) <= _FARTHEST_M and abs(y) <= _FARTHEST_M and abs(z) <= _FARTHEST_M  # false of NaN, too
    is_placed = is_placed and is_turned(i8, f8)
    if is_placed:
        _arrive(f8, (x, y, z))
    if frame_a != 0 and frame_b != 0 and is_placed:
        gain = min(1.0, f8[W.GAIN] + effects.clamped_dt(f8, dt) / f8[W.RAMP_S])
        put(f8, W.WANTED, _wanted(i8, u8, f8, f4, frame_a, frame_b, blend, dt))
    else:
        gain = max(0.0, f8[W.GAIN] - effects.clamped_dt(f8, dt) / f8[W.RAMP_S])
        _leave(f8)
        if gain == 0.0:
            put(f8, W.WANTED, _NOTHING)
    f8[W.GAIN] = gain
    if gain == 0.0:
        put(f8, W.WANTED_TORQUE, _NOTHING)
    effects.limited_torque(f8, times(gain, three(f8, W.WANTED_TORQUE)), dt)
    return effects.limited(f8, times(gain, three(f8, W.WANTED)), dt)


@njit(cache=True, nogil=True)
def release(i8, u8, f8, f4, dt):
    """The next force on the way to zero, three numbers, newtons, the device's axes; zero in the end and ever after.

    It goes down in a straight line within the time of the ramp, or as fast as the slew limit allows.
    """
    if not effects.has_passed(f8, dt):
        return three(f8, W.FORCE)
    before = f8[W.GAIN]
    gain = max(0.0, before - effects.clamped_dt(f8, dt) / f8[W.RAMP_S])
    share = gain / before if gain > 0.0 else 0.0
    f8[W.GAIN], f8[W.IS_STARTED] = gain, 0.0
    _leave(f8)
    put(f8, W.WANTED, _NOTHING)
    put(f8, W.WANTED_TORQUE, _NOTHING)
    effects.limited_torque(f8, times(share, three(f8, W.TORQUE)), dt)
    return effects.limited(f8, times(share, three(f8, W.FORCE)), dt)


@njit(cache=True, nogil=True, forceinline=True)
def _leave(f8):
    """No field and no friction are felt."""
    f8[W.IS_COUPLED] = 0.0
    for place in (W.FIELD_FORCE, W.FRICTION_FORCE, W.FIELD_TORQUE):
        put(f8, place, _NOTHING)


@njit(cache=True, nogil=True, forceinline=True)
def _arrive(f8, device):
    """Keep a place of the device: where that is in the field, how fast it came there, what energy that took."""
    p = along(three(f8, W.CLUTCH), f8[W.SCALE], turned(rows_of(f8, W.AXES), device))
    if f8[W.IS_STARTED] != 0.0:
        effects.observe(f8, less(device, three(f8, W.DEVICE_POSITION)))
        effects.moved(f8, less(p, three(f8, W.POSITION)), f8[W.SINCE_S])
    else:
        put(f8, W.VELOCITY, _NOTHING)
    effects.adapt(f8)
    f8[W.IS_STARTED], f8[W.SINCE_S] = 1.0, 0.0
    put(f8, W.DEVICE_POSITION, device)
    put(f8, W.POSITION, p)


@njit(cache=True, nogil=True)
def _wanted(i8, u8, f8, f4, frame_a, frame_b, blend, dt):
    """The force before gain and limits, newtons, the device's axes."""
    p, v = three(f8, W.POSITION), three(f8, W.VELOCITY)
    row = material_at(i8, u8, f8, f4, frame_a, frame_b, blend, p) if i8[W.MATERIAL_COUNT] > 0 else 0
    if f8[W.WALL] > 0.0:
        force, drag = held(i8, u8, f8, f4, frame_a, frame_b, blend, *p)
    else:
        if i8[W.TOOL_POINTS] > 0:
            force = tool_force(i8, u8, f8, f4, frame_a, frame_b, blend, *p)
            want_torque(f8)
        elif f8[W.SOFTNESS] > _HARD:
            force, p = effects.coupled(i8, u8, f8, f4, frame_a, frame_b, blend, p)
        else:
            force = force_at(i8, u8, f8, f4, frame_a, frame_b, blend, *p)
        if not is_finite(force):
            force = _NOTHING
        give_way(i8, f8, frame_a, p, force, dt)
        drag = friction(force[0], force[1], force[2], v[0], v[1], v[2], f8[W.FRICTION_NOW], f8[W.SLIP_SPEED])
    put(f8, W.FIELD_FORCE, force)
    put(f8, W.FRICTION_FORCE, drag)
    size, sine = length(force), effects.vibration(i8, u8, f8, f4, frame_a, frame_b, blend, p, dt)
    if row > 0:
        sine += texture(i8, f8, row, force, v, dt)
    drag = along(drag, -f8[W.DAMPING], v)
    if size > 0.0:
        drag = plus(drag, (force[0] / size * sine, force[1] / size * sine, force[2] / size * sine))
    else:
        drag = drag[0], drag[1], drag[2] + sine
    axes = rows_of(f8, W.AXES)
    force = times(f8[W.FORCE_SCALE], turned_back(axes, plus(effects.braked(f8, force, v), drag)))
    return plus(effects.passive(f8, force, times(1.0 / f8[W.SCALE], turned_back(axes, v)), dt), three(f8, W.GRAVITY))


# -- torque ---------------------------------------------------------------------------------------------------------


@njit(cache=True, nogil=True)
def is_turned(i8, f8):
    """True if the device says how the grip is turned; keeps how that turns the tool in the field."""
    if i8[W.TOOL_POINTS] == 0:
        return True
    w, v = f8[W.ORIENTATION], three(f8, W.ORIENTATION + 1)
    if not _LEAST <= w * w + dot(v, v) <= _MOST:  # false of NaN, too
        return False
    grip, axes = matrix_of(w, v), rows_of(f8, W.AXES)
    for n in range(3):  # AXES . grip . AXES', column by column
        column = turned(axes, turned(grip, axes[n]))
        f8[W.TURN + n], f8[W.TURN + 3 + n], f8[W.TURN + 6 + n] = column
    return True


@njit(cache=True, nogil=True, forceinline=True)
def want_torque(f8):
    """The torque before gain and limits: a lever of the field is `SCALE` times the device's."""
    torque = three(f8, W.FIELD_TORQUE)
    if not is_finite(torque):
        torque = _NOTHING
    scale = f8[W.HANDEDNESS] * f8[W.FORCE_SCALE] / f8[W.SCALE]
    put(f8, W.WANTED_TORQUE, times(scale, turned_back(rows_of(f8, W.AXES), torque)))
