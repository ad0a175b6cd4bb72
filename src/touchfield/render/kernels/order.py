"""Words that two processes share: orders under a sequence number, and entries that are complete before they are seen.

Each word has one writer. A fence stands between what is told and the word that tells it, so that neither compiler nor
processor shows them the other way round.
"""

from __future__ import annotations

from numba import njit, types
from numba.extending import intrinsic

from touchfield.render.control import (
    DIRECTORY,
    DIRECTORY_WORDS,
    FRAME_BITS,
    GENERATION,
    MODE,
    SEQUENCE,
    SLOTS,
    SPEED,
    START_S,
    STOP,
)

__all__ = ["fence", "give_order", "publish"]


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
    i8[SEQUENCE] += 1
    fence()
    i8[GENERATION] = generation
    f8[START_S] = start_s
    f8[SPEED] = speed
    i8[MODE] = mode
    i8[STOP] = stop
    fence()
    i8[SEQUENCE] += 1


@njit(cache=True, nogil=True)
def publish(i8, generation, frame, at, now_ns):
    """Show a frame that is written: entry of an unrolled frame in the directory."""
    entry = i8[DIRECTORY] + DIRECTORY_WORDS * (frame % i8[SLOTS])
    i8[entry] = -1
    fence()
    i8[entry + 1] = at
    i8[entry + 2] = now_ns
    fence()
    i8[entry] = (generation << FRAME_BITS) | frame
