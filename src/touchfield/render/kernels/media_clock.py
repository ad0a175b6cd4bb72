"""The media clock: orders of the player -> media time, and which two frames are meant.

At the beginning and after a seek the clock stands until the first frames are there. Where a later one does not come
in time there is no force, but the clock goes on, so that what comes then is shown at its own time; only where nothing
more will come, as the feed has failed or the player is silent, does it stand.
"""

from __future__ import annotations

import math

from numba import njit

from touchfield.render.control import (
    ANCHOR_CLOCK_S,
    ANCHOR_MEDIA_S,
    DIRECTORY,
    DIRECTORY_WORDS,
    ENDED,
    FEED,
    FEED_FAILED,
    FRAME_BITS,
    FRAME_COUNT,
    FRAME_RATE_HZ,
    GENERATION,
    GENERATION_NOW,
    IDLE,
    IS_LOOP,
    MEDIA_S,
    MODE,
    MODE_NOW,
    PLAYING,
    READY,
    RUNNING,
    SEQUENCE,
    SEQUENCE_SEEN,
    SLOTS,
    SPEED,
    SPEED_NOW,
    STALLED,
    START_S,
    STOP,
    STOP_NOW,
    USED,
    WAITING,
)
from touchfield.render.kernels.order import fence
from touchfield.render.statistics import (
    FRAMES_USED,
    LATENCIES,
    LATENCY_BINS,
    LATENCY_STEPS,
    LEAST_LATENCY_NS,
    PLAYED_TICKS,
    STALLED_TICKS,
    UNDERRUNS,
    WAITING_TICKS,
    WAITS,
)

__all__ = ["adopt_order", "frames_now", "unrolled_frame"]

ROUNDING = 1e-6
"""Of a frame's number: a time that was meant to be a frame's own is that frame, and not the end of the one before."""


@njit(cache=True, nogil=True)
def unrolled_frame(media_s, rate_hz):
    """The frame that is shown at a media time."""
    return math.floor(media_s * rate_hz + ROUNDING)


@njit(cache=True, nogil=True, forceinline=True)
def _media_now(i8, f8, clock_s):
    if i8[MODE_NOW] == PLAYING and (i8[FEED] == RUNNING or i8[FEED] == STALLED):
        return f8[ANCHOR_MEDIA_S] + (clock_s - f8[ANCHOR_CLOCK_S]) * f8[SPEED_NOW]
    return f8[MEDIA_S]


@njit(cache=True, nogil=True)
def adopt_order(i8, f8, clock_s):
    """Take the latest order of the player, if it is complete and new."""
    sequence = i8[SEQUENCE]
    if sequence == i8[SEQUENCE_SEEN] or sequence & 1:
        return
    fence()
    generation, start_s, speed, mode, stop = i8[GENERATION], f8[START_S], f8[SPEED], i8[MODE], i8[STOP]
    fence()
    if i8[SEQUENCE] != sequence:
        return  # written meanwhile; the next tick will have it
    media_s = _media_now(i8, f8, clock_s)
    if generation != i8[GENERATION_NOW]:
        i8[GENERATION_NOW] = generation
        media_s = start_s
        i8[FEED] = READY
    elif mode != i8[MODE_NOW] and i8[FEED] != ENDED:
        i8[FEED] = READY
    f8[MEDIA_S] = media_s
    f8[ANCHOR_MEDIA_S] = media_s
    f8[ANCHOR_CLOCK_S] = clock_s
    f8[SPEED_NOW] = speed
    i8[MODE_NOW] = mode
    i8[STOP_NOW] = stop
    fence()
    i8[SEQUENCE_SEEN] = sequence  # last: who sees it sees no state of the order before


@njit(cache=True, nogil=True, forceinline=True)
def _place(i8, frame):
    """Where an unrolled frame lies; 0 if it is not there."""
    entry = i8[DIRECTORY] + DIRECTORY_WORDS * (frame % i8[SLOTS])
    if i8[entry] != (i8[GENERATION_NOW] << FRAME_BITS) | frame:
        return 0
    fence()
    return i8[entry + 1]


@njit(cache=True, nogil=True)
def _count_use(i8, frame, now_ns):
    """Count the first use of a frame, and the time since it was published (unknown where that is 0)."""
    tag = (i8[GENERATION_NOW] << FRAME_BITS) | frame
    if tag == i8[USED]:
        return
    i8[USED] = tag
    i8[FRAMES_USED] += 1
    published = i8[i8[DIRECTORY] + DIRECTORY_WORDS * (frame % i8[SLOTS]) + 2]
    if published == 0:
        return
    latency = max(now_ns - published, 0)
    if i8[LEAST_LATENCY_NS] == 0 or latency < i8[LEAST_LATENCY_NS]:
        i8[LEAST_LATENCY_NS] = max(latency, 1)
    i8[LATENCIES + min(int(LATENCY_STEPS * math.log2(1e-3 * latency + 1.0)), LATENCY_BINS - 1)] += 1


@njit(cache=True, nogil=True)
def frames_now(i8, f8, clock_s, now_ns, is_silent):
    """The frames before and after this instant, and the share of the second.

    Returns
    -------
    frame_a, frame_b : int
        Word places; 0 where there is no force to be rendered.
    blend : float
    wanted : int
        The first unrolled frame that may still be read.
    """
    count, rate_hz = i8[FRAME_COUNT], f8[FRAME_RATE_HZ]
    media_s = _media_now(i8, f8, clock_s)
    wanted, following, blend = 0, 0, 0.0
    if count > 1:
        wanted = unrolled_frame(media_s, rate_hz)
        if not i8[IS_LOOP] and wanted >= count:
            f8[MEDIA_S] = count / rate_hz
            i8[FEED] = ENDED
            return 0, 0, 0.0, count
        following = wanted if wanted == count - 1 and not i8[IS_LOOP] else wanted + 1
        blend = min(max(media_s * rate_hz - wanted, 0.0), 1.0)
    before_s = f8[MEDIA_S]
    f8[MEDIA_S] = media_s
    is_playing = i8[MODE_NOW] == PLAYING
    i8[PLAYED_TICKS] += is_playing
    if i8[MODE_NOW] == IDLE:
        return 0, 0, 0.0, wanted
    frame_a, frame_b = _place(i8, wanted), _place(i8, following)
    if frame_a and frame_b and not is_silent:
        if is_playing and i8[FEED] != RUNNING:
            f8[ANCHOR_MEDIA_S] = media_s
            f8[ANCHOR_CLOCK_S] = clock_s
            i8[FEED] = RUNNING
        _count_use(i8, wanted, now_ns)
        return frame_a, frame_b, blend, wanted
    if is_playing:
        if i8[FEED] == RUNNING:
            i8[FEED] = STALLED
            i8[UNDERRUNS] += 1 if not i8[FEED_FAILED] and not is_silent else 0
        elif i8[FEED] == READY:
            i8[FEED] = WAITING
            i8[WAITS] += 1
        i8[STALLED_TICKS if i8[FEED] == STALLED else WAITING_TICKS] += 1
        if is_silent or i8[FEED_FAILED]:
            f8[MEDIA_S] = f8[ANCHOR_MEDIA_S] = before_s
            f8[ANCHOR_CLOCK_S] = clock_s
    return 0, 0, 0.0, wanted
