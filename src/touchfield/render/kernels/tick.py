"""Compiled: one tick of the servo. From the position of the device and the frames in memory it computes the
force for the device, writes one row of the log, and counts.

    place -> axes, scale, clutch -> velocity -> proxy, or field, or coupling -> friction, damping -> vibration
          -> axes, force scale -> passivity -> gravity -> gain -> limits -> force

`tick` and `release` are the only two that hand out forces, and both do so through `effects.limited`. `cycle`
is called by the Python loop of the servo and by the callback that a vendor's driver takes; it allocates
nothing, waits for nothing, and takes nothing but views of the block. Without a frame or a place (or a turn)
of the device the gain goes to zero in the time of the ramp, and the last force is let go.

**The media clock** stands at the beginning and after a seek until the first frames are there. Where a later
one is late there is no force, but the clock goes on; only where nothing more will come does it stand. Each
word has one writer; a fence stands between what is told and the word that tells it.
"""

from __future__ import annotations

import math

from numba import types
from numba.extending import intrinsic

from touchfield.compute.jit import inner, kernel
from touchfield.filters.kernels.forces import friction
from touchfield.render.block import words as W
from touchfield.render.kernels import effects
from touchfield.render.kernels.effects import material_at, texture
from touchfield.render.kernels.frames import force_at, give_way
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


@kernel
def tick(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z, dt):
    """The force of one tick, three numbers, newtons, the device's axes, for a device at (x, y, z), metres.

    `frame_a` and `frame_b` are places of the frames before and after this time, 0: there is none; `blend`
    goes from the one to the other. A `dt`, seconds, that is not positive and finite gives the force before
    once more.
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


@kernel
def release(f8, dt):
    """The next force on the way to zero within the ramp or the slew limit, newtons; zero for ever in the end."""
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


@inner(forceinline=True)
def _leave(f8):
    """No field and no friction are felt."""
    f8[W.IS_COUPLED] = 0.0
    for place in (W.FIELD_FORCE, W.FRICTION_FORCE, W.FIELD_TORQUE):
        put(f8, place, _NOTHING)


@inner(forceinline=True)
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


@inner(inline="always")
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
    return plus(
        effects.passive(f8, force, times(1.0 / f8[W.SCALE], turned_back(axes, v)), dt), three(f8, W.GRAVITY)
    )


@inner
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


@inner(forceinline=True)
def want_torque(f8):
    """The torque before gain and limits: a lever of the field is `SCALE` times the device's."""
    torque = three(f8, W.FIELD_TORQUE)
    if not is_finite(torque):
        torque = _NOTHING
    scale = f8[W.HANDEDNESS] * f8[W.FORCE_SCALE] / f8[W.SCALE]
    put(f8, W.WANTED_TORQUE, times(scale, turned_back(rows_of(f8, W.AXES), torque)))


ROUNDING = 1e-6
"""Of a frame's number: a time that was meant to be a frame's own is that frame, and not the end of the one
before.
"""

_FEED_FLAGS = (0, 2, 1, 4, 8)  # of the log (`block.FLAGS`), by the state of the feed


@intrinsic
def _fence(context):
    def code(backend, builder, signature, arguments):
        builder.fence("seq_cst")
        return backend.get_dummy_value()

    return types.void(), code


@inner(forceinline=True)
def fence():
    """A full memory fence."""
    _fence()  # type: ignore[call-arg]


@kernel
def give_order(i8, f8, generation, start_s, speed, mode, stop):
    """Write one order of the player; the servo takes it whole or not yet."""
    i8[W.SEQUENCE] += 1
    fence()
    i8[W.GENERATION] = generation
    f8[W.START_S] = start_s
    f8[W.SPEED] = speed
    i8[W.MODE] = mode
    i8[W.STOP] = stop
    fence()
    i8[W.SEQUENCE] += 1


@kernel
def publish(i8, generation, frame, at):
    """Show a frame that is written: entry of an unrolled frame in the directory."""
    entry = i8[W.DIRECTORY] + W.DIRECTORY_WORDS * (frame % i8[W.SLOTS])
    i8[entry] = -1
    fence()
    i8[entry + 1] = at
    fence()
    i8[entry] = (generation << W.FRAME_BITS) | frame


@kernel
def unrolled_frame(media_s, rate_hz):
    """The frame that is shown at a media time."""
    return math.floor(media_s * rate_hz + ROUNDING)


@inner(forceinline=True)
def _media_now(i8, f8, clock_s):
    if i8[W.MODE_NOW] == W.PLAYING and (i8[W.FEED] == W.RUNNING or i8[W.FEED] == W.STALLED):
        return f8[W.ANCHOR_MEDIA_S] + (clock_s - f8[W.ANCHOR_CLOCK_S]) * f8[W.SPEED_NOW]
    return f8[W.MEDIA_S]


@inner(inline="always")
def adopt_order(i8, f8, clock_s):
    """Take the latest order of the player, if it is complete and new."""
    sequence = i8[W.SEQUENCE]
    if sequence == i8[W.SEQUENCE_SEEN] or sequence & 1:
        return
    fence()
    generation, start_s, speed, mode, stop = (
        i8[W.GENERATION],
        f8[W.START_S],
        f8[W.SPEED],
        i8[W.MODE],
        i8[W.STOP],
    )
    fence()
    if i8[W.SEQUENCE] != sequence:
        return  # written meanwhile; the next tick will have it
    media_s = _media_now(i8, f8, clock_s)
    if generation != i8[W.GENERATION_NOW]:
        i8[W.GENERATION_NOW] = generation
        media_s = start_s
        i8[W.FEED] = W.READY
    elif mode != i8[W.MODE_NOW] and i8[W.FEED] != W.ENDED:
        i8[W.FEED] = W.READY
    f8[W.MEDIA_S] = media_s
    f8[W.ANCHOR_MEDIA_S] = media_s
    f8[W.ANCHOR_CLOCK_S] = clock_s
    f8[W.SPEED_NOW] = speed
    i8[W.MODE_NOW] = mode
    i8[W.STOP_NOW] = stop
    fence()
    i8[W.SEQUENCE_SEEN] = sequence  # last: who sees it sees no state of the order before


@inner(forceinline=True)
def _place(i8, frame):
    """Where an unrolled frame lies; 0 if it is not there."""
    entry = i8[W.DIRECTORY] + W.DIRECTORY_WORDS * (frame % i8[W.SLOTS])
    if i8[entry] != (i8[W.GENERATION_NOW] << W.FRAME_BITS) | frame:
        return 0
    fence()
    return i8[entry + 1]


@inner(inline="always")
def _count_use(i8, frame):
    """Count the first use of a frame."""
    tag = (i8[W.GENERATION_NOW] << W.FRAME_BITS) | frame
    if tag != i8[W.USED]:
        i8[W.USED] = tag
        i8[W.FRAMES_USED] += 1


@inner(inline="always")
def frames_now(i8, f8, clock_s, is_silent):
    """Places of the two frames of this instant, 0: no force; share of the second; first frame still to be
    read.
    """
    count, rate_hz = i8[W.FRAME_COUNT], f8[W.FRAME_RATE_HZ]
    media_s = _media_now(i8, f8, clock_s)
    wanted, following, blend = 0, 0, 0.0
    if count > 1:
        wanted = unrolled_frame(media_s, rate_hz)
        if not i8[W.IS_LOOP] and wanted >= count:
            f8[W.MEDIA_S] = count / rate_hz
            i8[W.FEED] = W.ENDED
            return 0, 0, 0.0, count
        following = wanted if wanted == count - 1 and not i8[W.IS_LOOP] else wanted + 1
        blend = min(max(media_s * rate_hz - wanted, 0.0), 1.0)
    before_s = f8[W.MEDIA_S]
    f8[W.MEDIA_S] = media_s
    is_playing = i8[W.MODE_NOW] == W.PLAYING
    i8[W.PLAYED_TICKS] += is_playing
    if i8[W.MODE_NOW] == W.IDLE:
        return 0, 0, 0.0, wanted
    frame_a, frame_b = _place(i8, wanted), _place(i8, following)
    if frame_a and frame_b and not is_silent:
        if is_playing and i8[W.FEED] != W.RUNNING:
            f8[W.ANCHOR_MEDIA_S] = media_s
            f8[W.ANCHOR_CLOCK_S] = clock_s
            i8[W.FEED] = W.RUNNING
        _count_use(i8, wanted)
        return frame_a, frame_b, blend, wanted
    if is_playing:
        if i8[W.FEED] == W.RUNNING:
            i8[W.FEED] = W.STALLED
            i8[W.UNDERRUNS] += 1 if not i8[W.FEED_FAILED] and not is_silent else 0
        elif i8[W.FEED] == W.READY:
            i8[W.FEED] = W.WAITING
            i8[W.WAITS] += 1
        i8[W.STALLED_TICKS if i8[W.FEED] == W.STALLED else W.WAITING_TICKS] += 1
        if is_silent or i8[W.FEED_FAILED]:
            f8[W.MEDIA_S] = f8[W.ANCHOR_MEDIA_S] = before_s
            f8[W.ANCHOR_CLOCK_S] = clock_s
    return 0, 0, 0.0, wanted


@inner(inline="always")
def _count_time(i8, now_ns):
    """Jitter and lateness of this tick, and the deadline of the next."""
    tick_ns = i8[W.TICK_NS]
    if i8[W.TICKS] == 0:
        i8[W.FIRST_NS] = now_ns
        i8[W.DEADLINE_NS] = now_ns
    else:
        period = abs(now_ns - i8[W.LAST_NS] - tick_ns)
        i8[W.PERIODS + min(period // 1000, W.TIME_BINS)] += 1
        i8[W.WORST_PERIOD_NS] = max(i8[W.WORST_PERIOD_NS], period)
    late = max(now_ns - i8[W.DEADLINE_NS], 0)
    i8[W.LATENESSES + min(late // 1000, W.TIME_BINS)] += 1
    i8[W.WORST_LATENESS_NS] = max(i8[W.WORST_LATENESS_NS], late)
    if 2 * late > tick_ns:
        i8[W.LATE] += 1
    following = (now_ns if i8[W.IS_PACED] else i8[W.DEADLINE_NS]) + tick_ns
    if following <= now_ns:  # what is past is past: no burst of ticks to catch up
        missed = (now_ns - following) // tick_ns + 1
        i8[W.MISSED] += missed
        following += missed * tick_ns
    i8[W.DEADLINE_NS] = following
    i8[W.LAST_NS] = now_ns
    i8[W.TICKS] += 1


@inner(inline="always")
def _write_row(i8, f8, clock_s, force, is_silent, is_stopping):
    at = i8[W.LOG] + W.ROW_WORDS * (i8[W.LOG_WRITTEN] % i8[W.LOG_ROWS])
    f8[at] = clock_s
    f8[at + 1] = f8[W.MEDIA_S]
    put(f8, at + 2, three(f8, W.POSITION))
    put(f8, at + 5, three(f8, W.VELOCITY))
    put(f8, at + 8, three(f8, W.FIELD_FORCE))
    put(f8, at + 11, three(f8, W.FRICTION_FORCE))
    put(f8, at + 14, force)
    i8[at + 17] = (
        _FEED_FLAGS[i8[W.FEED]] + 16 * is_stopping + 32 * is_silent + 64 * (i8[W.MODE_NOW] == W.PAUSED)
    )
    for n in range(4):
        f8[at + 18 + n] = f8[W.ORIENTATION + n]
    put(f8, at + 22, three(f8, W.FIELD_TORQUE))
    put(f8, at + 25, three(f8, W.TORQUE))
    i8[at + 28] = i8[W.BUTTONS]
    f8[at + 29] = f8[W.GRIPPER_M]
    fence()
    i8[W.LOG_WRITTEN] += 1


@kernel
def cycle(i8, u8, f8, f4, x, y, z, now_ns):
    """The force, newtons, for the device at (x, y, z), metres, at `now_ns` of the clock; torque is in the
    block.
    """
    is_simulated, ticks = i8[W.IS_SIMULATED] != 0, i8[W.TICKS]
    _count_time(i8, now_ns)
    if is_simulated:
        clock_s, dt_s = ticks / f8[W.RATE_HZ], 1.0 / f8[W.RATE_HZ]
    else:
        clock_s = 1e-9 * (now_ns - i8[W.FIRST_NS])
        dt_s = max(clock_s - f8[W.CLOCK_S], 0.0) if ticks else 1.0 / f8[W.RATE_HZ]
    f8[W.CLOCK_S] = clock_s
    adopt_order(i8, f8, clock_s)
    is_silent = i8[W.HEARTBEAT_NS] != 0 and now_ns - i8[W.HEARTBEAT_NS] > W.SILENCE_NS
    is_stopping = i8[W.STOP_NOW] != 0 or i8[W.STOP_HERE] != 0
    frame_a, frame_b, blend, wanted = frames_now(i8, f8, clock_s, is_silent)
    if is_stopping:
        force = release(f8, dt_s)
    else:
        force = tick(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z, dt_s)
    is_zero = force == (0.0, 0.0, 0.0) and three(f8, W.TORQUE) == (0.0, 0.0, 0.0)
    _write_row(i8, f8, clock_s, force, is_silent, is_stopping)
    fence()
    i8[W.NEEDS] = (i8[W.GENERATION_NOW] << W.FRAME_BITS) | wanted
    i8[W.RESTING] = is_zero
    if is_stopping and is_zero:
        i8[W.RELEASED] = 1
    return force
