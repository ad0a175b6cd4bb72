"""One turn of the servo: time, orders and frames -> `tick` -> a force for the device, a row of the log, the counts.

Called by the Python loop of the servo's process and by the compiled callback that a vendor's driver takes; it
allocates nothing, waits for nothing, and takes nothing but views of the shared block. No force, and no vibration of
a material, comes out but through the limits at the end of `tick` or through `release`.

**The media clock** turns orders of the player into media time, and tells which two frames are meant. At the beginning
and after a seek the clock stands until the first frames are there. Where a later one does not come in time there is
no force, but the clock goes on, so that what comes then is shown at its own time; only where nothing more will come,
as the feed has failed or the player is silent, does it stand.

Of the words that two processes share each has one writer. Orders go under a sequence number, and entries are complete
before they are seen: a fence stands between what is told and the word that tells it, so that neither compiler nor
processor shows them the other way round.
"""

from __future__ import annotations

import math

from numba import njit, types
from numba.extending import intrinsic

from touchfield.render.block import words as W
from touchfield.render.kernels.tick import release, tick
from touchfield.render.kernels.vectors import put, three

ROUNDING = 1e-6
"""Of a frame's number: a time that was meant to be a frame's own is that frame, and not the end of the one before."""

_FEED_FLAGS = (0, 2, 1, 4, 8)  # of the log (`block.record.FLAGS`), by the state of the feed


@intrinsic
def _fence(context):
    def code(backend, builder, signature, arguments):
        builder.fence("seq_cst")
        return backend.get_dummy_value()

    return types.void(), code


@njit(cache=True, nogil=True, forceinline=True)
def fence():
    """A full memory fence."""
    _fence()  # type: ignore[call-arg]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def publish(i8, generation, frame, at, now_ns):
    """Show a frame that is written: entry of an unrolled frame in the directory."""
    entry = i8[W.DIRECTORY] + W.DIRECTORY_WORDS * (frame % i8[W.SLOTS])
    i8[entry] = -1
    fence()
    i8[entry + 1] = at
    i8[entry + 2] = now_ns
    fence()
    i8[entry] = (generation << W.FRAME_BITS) | frame


@njit(cache=True, nogil=True)
def unrolled_frame(media_s, rate_hz):
    """The frame that is shown at a media time."""
    return math.floor(media_s * rate_hz + ROUNDING)


@njit(cache=True, nogil=True, forceinline=True)
def _media_now(i8, f8, clock_s):
    if i8[W.MODE_NOW] == W.PLAYING and (i8[W.FEED] == W.RUNNING or i8[W.FEED] == W.STALLED):
        return f8[W.ANCHOR_MEDIA_S] + (clock_s - f8[W.ANCHOR_CLOCK_S]) * f8[W.SPEED_NOW]
    return f8[W.MEDIA_S]


@njit(cache=True, nogil=True)
def adopt_order(i8, f8, clock_s):
    """Take the latest order of the player, if it is complete and new."""
    sequence = i8[W.SEQUENCE]
    if sequence == i8[W.SEQUENCE_SEEN] or sequence & 1:
        return
    fence()
    generation, start_s, speed, mode, stop = i8[W.GENERATION], f8[W.START_S], f8[W.SPEED], i8[W.MODE], i8[W.STOP]
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


@njit(cache=True, nogil=True, forceinline=True)
def _place(i8, frame):
    """Where an unrolled frame lies; 0 if it is not there."""
    entry = i8[W.DIRECTORY] + W.DIRECTORY_WORDS * (frame % i8[W.SLOTS])
    if i8[entry] != (i8[W.GENERATION_NOW] << W.FRAME_BITS) | frame:
        return 0
    fence()
    return i8[entry + 1]


@njit(cache=True, nogil=True)
def _count_use(i8, frame, now_ns):
    """Count the first use of a frame, and the time since it was published (unknown where that is 0)."""
    tag = (i8[W.GENERATION_NOW] << W.FRAME_BITS) | frame
    if tag == i8[W.USED]:
        return
    i8[W.USED] = tag
    i8[W.FRAMES_USED] += 1
    published = i8[i8[W.DIRECTORY] + W.DIRECTORY_WORDS * (frame % i8[W.SLOTS]) + 2]
    if published == 0:
        return
    latency = max(now_ns - published, 0)
    if i8[W.LEAST_LATENCY_NS] == 0 or latency < i8[W.LEAST_LATENCY_NS]:
        i8[W.LEAST_LATENCY_NS] = max(latency, 1)
    i8[W.LATENCIES + min(int(W.LATENCY_STEPS * math.log2(1e-3 * latency + 1.0)), W.LATENCY_BINS - 1)] += 1


@njit(cache=True, nogil=True)
def frames_now(i8, f8, clock_s, now_ns, is_silent):
    """Places of the frames before and after this instant, 0 where there is no force to be rendered; the share of the
    second; and the first unrolled frame that may still be read.
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
        _count_use(i8, wanted, now_ns)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _write_row(i8, f8, clock_s, force, is_silent, is_stopping):
    at = i8[W.LOG] + W.ROW_WORDS * (i8[W.LOG_WRITTEN] % i8[W.LOG_ROWS])
    f8[at] = clock_s
    f8[at + 1] = f8[W.MEDIA_S]
    put(f8, at + 2, three(f8, W.POSITION))
    put(f8, at + 5, three(f8, W.VELOCITY))
    put(f8, at + 8, three(f8, W.FIELD_FORCE))
    put(f8, at + 11, three(f8, W.FRICTION_FORCE))
    put(f8, at + 14, force)
    i8[at + 17] = _FEED_FLAGS[i8[W.FEED]] + 16 * is_stopping + 32 * is_silent + 64 * (i8[W.MODE_NOW] == W.PAUSED)
    for n in range(4):
        f8[at + 18 + n] = f8[W.ORIENTATION + n]
    put(f8, at + 22, three(f8, W.FIELD_TORQUE))
    put(f8, at + 25, three(f8, W.TORQUE))
    i8[at + 28] = i8[W.BUTTONS]
    f8[at + 29] = f8[W.GRIPPER_M]
    fence()
    i8[W.LOG_WRITTEN] += 1


@njit(cache=True, nogil=True)
def cycle(i8, u8, f8, f4, x, y, z, now_ns):
    """The force for the device at (x, y, z), in its own axes, at the time `now_ns` of the monotonic clock.

    The first four are the views of one `Memory`; (x, y, z) are metres, and not finite is as no field. The force,
    three floats, newtons, is within the device's limits; the torque is left in the block.
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
    frame_a, frame_b, blend, wanted = frames_now(i8, f8, clock_s, now_ns, is_silent)
    if is_stopping:
        force = release(i8, u8, f8, f4, dt_s)
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
