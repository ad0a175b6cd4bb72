"""One turn of the servo: time, orders and frames -> `tick` -> a force for the device, a row of the log, the counts.

Called by the Python loop of the servo's process and by the compiled callback that a vendor's driver takes; it
allocates nothing, waits for nothing, and takes nothing but views of the shared block. No force comes out but through
the limits at the end of `tick` or through `release`.
"""

from __future__ import annotations

from numba import njit

from touchfield.render.control import (
    CLOCK_S,
    DEADLINE_NS,
    ENDED,
    FEED,
    FRAME_BITS,
    GENERATION_NOW,
    HEARTBEAT_NS,
    IS_PACED,
    IS_SIMULATED,
    LOG,
    LOG_ROWS,
    LOG_WRITTEN,
    MEDIA_S,
    MODE_NOW,
    NEEDS,
    PAUSED,
    RATE_HZ,
    RELEASED,
    RESTING,
    RUNNING,
    SILENCE_NS,
    STALLED,
    STOP_HERE,
    STOP_NOW,
    TICK_NS,
    WAITING,
)
from touchfield.render.kernels.media_clock import adopt_order, frames_now
from touchfield.render.kernels.order import fence
from touchfield.render.kernels.tick import release, tick
from touchfield.render.log import ROW_WORDS
from touchfield.render.places import FIELD_FORCE, FRICTION_FORCE, POSITION, VELOCITY
from touchfield.render.statistics import (
    FIRST_NS,
    LAST_NS,
    LATE,
    LATENESSES,
    MISSED,
    PERIODS,
    SILENT_TICKS,
    TICKS,
    TIME_BINS,
    WORST_LATENESS_NS,
    WORST_PERIOD_NS,
)
from touchfield.render.wrench_places import BUTTONS, FIELD_TORQUE, GRIPPER_M, ORIENTATION, TORQUE

__all__ = ["cycle"]


@njit(cache=True, nogil=True)
def _count_time(i8, now_ns):
    """Jitter and lateness of this tick, and the deadline of the next."""
    tick_ns = i8[TICK_NS]
    if i8[TICKS] == 0:
        i8[FIRST_NS] = now_ns
        i8[DEADLINE_NS] = now_ns
    else:
        period = abs(now_ns - i8[LAST_NS] - tick_ns)
        i8[PERIODS + min(period // 1000, TIME_BINS)] += 1
        i8[WORST_PERIOD_NS] = max(i8[WORST_PERIOD_NS], period)
    late = max(now_ns - i8[DEADLINE_NS], 0)
    i8[LATENESSES + min(late // 1000, TIME_BINS)] += 1
    i8[WORST_LATENESS_NS] = max(i8[WORST_LATENESS_NS], late)
    if 2 * late > tick_ns:
        i8[LATE] += 1
    following = (now_ns if i8[IS_PACED] else i8[DEADLINE_NS]) + tick_ns
    if following <= now_ns:  # what is past is past: no burst of ticks to catch up
        missed = (now_ns - following) // tick_ns + 1
        i8[MISSED] += missed
        following += missed * tick_ns
    i8[DEADLINE_NS] = following
    i8[LAST_NS] = now_ns
    i8[TICKS] += 1


@njit(cache=True, nogil=True)
def _write_row(i8, f8, clock_s, fx, fy, fz, is_silent, is_stopping):
    at = i8[LOG] + ROW_WORDS * (i8[LOG_WRITTEN] % i8[LOG_ROWS])
    f8[at] = clock_s
    f8[at + 1] = f8[MEDIA_S]
    for axis in range(3):
        f8[at + 2 + axis] = f8[POSITION + axis]
        f8[at + 5 + axis] = f8[VELOCITY + axis]
        f8[at + 8 + axis] = f8[FIELD_FORCE + axis]
        f8[at + 11 + axis] = f8[FRICTION_FORCE + axis]
    f8[at + 14], f8[at + 15], f8[at + 16] = fx, fy, fz
    feed = i8[FEED]
    flags = 1 if feed == RUNNING else 2 if feed == WAITING else 4 if feed == STALLED else 8 if feed == ENDED else 0
    i8[at + 17] = flags + 16 * is_stopping + 32 * is_silent + 64 * (i8[MODE_NOW] == PAUSED)
    for n in range(4):
        f8[at + 18 + n] = f8[ORIENTATION + n]
    for axis in range(3):
        f8[at + 22 + axis] = f8[FIELD_TORQUE + axis]
        f8[at + 25 + axis] = f8[TORQUE + axis]
    i8[at + 28] = i8[BUTTONS]
    f8[at + 29] = f8[GRIPPER_M]
    fence()
    i8[LOG_WRITTEN] += 1


@njit(cache=True, nogil=True)
def cycle(i8, u8, f8, f4, x, y, z, now_ns):
    """The force for the device at (x, y, z), in its own axes, at the time `now_ns` of the monotonic clock.

    Parameters
    ----------
    i8, u8, f8, f4 : int64 [w], uint64 [w], float64 [w], float32 [2 w]
        Views of one `Memory`.
    x, y, z : float
        Metres, in the device's axes; not finite is as no field.
    now_ns : int

    Returns
    -------
    (float, float, float)
        Newtons, in the device's axes, within its limits; the torque is left in the block.
    """
    is_simulated, ticks = i8[IS_SIMULATED] != 0, i8[TICKS]
    _count_time(i8, now_ns)
    if is_simulated:
        clock_s, dt_s = ticks / f8[RATE_HZ], 1.0 / f8[RATE_HZ]
    else:
        clock_s = 1e-9 * (now_ns - i8[FIRST_NS])
        dt_s = max(clock_s - f8[CLOCK_S], 0.0) if ticks else 1.0 / f8[RATE_HZ]
    f8[CLOCK_S] = clock_s
    adopt_order(i8, f8, clock_s)
    is_silent = i8[HEARTBEAT_NS] != 0 and now_ns - i8[HEARTBEAT_NS] > SILENCE_NS
    i8[SILENT_TICKS] += is_silent
    is_stopping = i8[STOP_NOW] != 0 or i8[STOP_HERE] != 0
    frame_a, frame_b, blend, wanted = frames_now(i8, f8, clock_s, now_ns, is_silent)
    if is_stopping:
        fx, fy, fz = release(i8, u8, f8, f4, dt_s)
    else:
        fx, fy, fz = tick(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z, dt_s)
    is_zero = fx == 0.0 and fy == 0.0 and fz == 0.0
    is_zero = is_zero and f8[TORQUE] == 0.0 and f8[TORQUE + 1] == 0.0 and f8[TORQUE + 2] == 0.0
    _write_row(i8, f8, clock_s, fx, fy, fz, is_silent, is_stopping)
    fence()
    i8[NEEDS] = (i8[GENERATION_NOW] << FRAME_BITS) | wanted
    i8[RESTING] = is_zero
    if is_stopping and is_zero:
        i8[RELEASED] = 1
    return fx, fy, fz
