"""Compiled code of the adapters, imported only when first needed: the callback of OpenHaptics, the simulated
hand.

**The callback** is called a thousand times a second by the driver: no interpreter on its way. It gets the
address of a box: words of eight bytes, in which the adapter says where the block of the player is, and the
callback what it does. Pointers are made from those words; the views of the block are the same four that every
kernel of the renderer takes.

**The hand**: where its target is, and how a spring pulls it there. State, float64 [10]: time, position,
velocity, force. `follow` and `spring` move it on by dt.
"""

from __future__ import annotations

import ctypes
import math
import sys
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import carray, cfunc, types
from numba.extending import intrinsic

from touchfield.compute.jit import inner, kernel

BOX = 24
"""Words of the box, as below."""

ADDRESS, WORDS, HANDLE = 0, 1, 2
"""Where the block is, how long, and the driver's name for the device."""

STOP, DONE, CALLS = 3, 4, 5
"""Order to end; 1 when it has, 2 if the renderer failed; how many calls there were."""

CLOCK, POSITION, FORCE = 6, 8, 11
"""Two words of the clock, three of the position in millimetres, three of the force in newtons."""

ERROR, SCRATCH = 14, 16
"""The first fault that the driver told, 0 for none; two words for the telling."""

_CALL_AGAIN, _CALL_NO_MORE = np.uint32(1), np.uint32(0)
_CURRENT_POSITION, _CURRENT_FORCE = np.uint32(0x2050), np.uint32(0x2700)


def _as_pointer(_typing, address):
    """An address as a pointer."""

    def made(_context, builder, _signature, arguments):
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), made


_pointer: Any = intrinsic(_as_pointer)


def _typed(address: int | None, *arguments: Any, result: Any = None) -> Any:
    """The function at an address, for compiled code, where a pointer is a whole number."""
    return ctypes.CFUNCTYPE(result, *arguments)(address or 0)


def address_of(function: Any) -> int | None:
    """Where a function of ctypes lies."""
    return ctypes.cast(function, ctypes.c_void_p).value


def clock() -> Any:
    """A compiled function that reads the clock of `time.perf_counter_ns`: ``now(box) -> nanoseconds``."""
    if sys.platform == "win32":
        windows, frequency = ctypes.WinDLL("kernel32"), ctypes.c_int64()
        windows.QueryPerformanceFrequency(ctypes.byref(frequency))
        read, ticks = _typed(address_of(windows.QueryPerformanceCounter), ctypes.c_size_t), frequency.value

        @inner
        def now_of_ticks(box):
            read(box.ctypes.data + 8 * CLOCK)
            seconds, rest = divmod(box[CLOCK], ticks)
            return seconds * 1000000000 + rest * 1000000000 // ticks

        return now_of_ticks
    read = _typed(address_of(ctypes.CDLL(None).clock_gettime), ctypes.c_int32, ctypes.c_size_t)
    kind = np.int32(8 if sys.platform == "darwin" else 1)  # CLOCK_UPTIME_RAW, CLOCK_MONOTONIC

    @inner
    def now(box):
        read(kind, box.ctypes.data + 8 * CLOCK)
        return box[CLOCK] * 1000000000 + box[CLOCK + 1]

    return now


def _latest_error(get_error: int | None) -> Any:
    """A compiled function: the code of the driver's latest error, 0 for none.

    hdGetError returns three words of four bytes by value. Compiled code knows no such result, but its calling
    convention: two registers, the first of which holds the code; under Windows a place that the caller names.
    """
    if sys.platform == "win32":
        tell = _typed(get_error, ctypes.c_size_t)

        @inner
        def told_in_place(box):
            tell(box.ctypes.data + 8 * SCRATCH)
            return box[SCRATCH] & 0xFFFFFFFF

        return told_in_place
    ask = _typed(get_error, result=ctypes.c_uint64)

    @inner
    def told(_box):
        return np.int64(ask() & np.uint64(0xFFFFFFFF))

    return told


@cache
def compiled_callback(
    cycle: Any, begin: int | None, end: int | None, get: int | None, put: int | None, error: int | None
) -> Any:
    """The callback, HDCallbackCode (void *), as a numba cfunc; its `address` is what the driver gets.

    ``cycle(i8, u8, f8, f4, x, y, z, now_ns) -> (fx, fy, fz)`` is compiled, metres and newtons in the device's
    axes; the rest are `address_of` hdBeginFrame, hdEndFrame, hdGetDoublev, hdSetDoublev and hdGetError of the
    vendor's library, which stays loaded.
    """
    begin_frame, end_frame = _typed(begin, ctypes.c_uint32), _typed(end, ctypes.c_uint32)
    get_doubles = _typed(get, ctypes.c_uint32, ctypes.c_size_t)
    set_doubles = _typed(put, ctypes.c_uint32, ctypes.c_size_t)
    now, latest_error = clock(), _latest_error(error)

    @cfunc(types.uint32(types.voidptr))
    def callback(user):
        box, numbers = carray(user, (BOX,), np.int64), carray(user, (BOX,), np.float64)
        handle, stop = np.uint32(box[HANDLE]), box[STOP]
        box[CALLS] += 1
        begin_frame(handle)
        fx = fy = fz = 0.0
        if stop == 0:
            get_doubles(_CURRENT_POSITION, box.ctypes.data + 8 * POSITION)
            block, words = _pointer(box[ADDRESS]), box[WORDS]
            i8, u8 = carray(block, (words,), np.int64), carray(block, (words,), np.uint64)
            f8, f4 = carray(block, (words,), np.float64), carray(block, (2 * words,), np.float32)
            x, y, z = numbers[POSITION] / 1000, numbers[POSITION + 1] / 1000, numbers[POSITION + 2] / 1000
            try:
                fx, fy, fz = cycle(i8, u8, f8, f4, x, y, z, now(box))
            except Exception:  # nobody above would hear of it, and the last force would stay
                stop = 2
        numbers[FORCE], numbers[FORCE + 1], numbers[FORCE + 2] = fx, fy, fz
        set_doubles(_CURRENT_FORCE, box.ctypes.data + 8 * FORCE)
        end_frame(handle)
        code = latest_error(box)
        # 0x02xx: the driver limits the force for a while, of itself (warm motors, a hand too fast)
        if code != 0 and code >> 8 != 2 and box[ERROR] == 0:
            box[ERROR] = code
        if stop != 0:
            box[DONE] = stop
            return _CALL_NO_MORE
        return _CALL_AGAIN

    return callback


_TURN = 0.1
"""Of a sub-step: the phase by which spring and mass swing on; what is stable reaches to 2."""


@inner
def _around(times, t):
    """The samples before and after t, and how far t is between; at rest at both ends, of equal times the
    later.
    """
    low = np.searchsorted(times, t, side="right")
    a, b = max(low - 1, 0), min(low, times.shape[0] - 1)
    return a, b, (t - times[a]) / (times[b] - times[a]) if b > a and low > 0 else 0.0


@kernel
def turned(times, quaternions, t, out):
    """The orientation at t into `out` [4]: along the shorter way, made unit."""
    a, b, share = _around(times, t)
    cosine = 0.0
    for n in range(4):
        cosine += quaternions[a, n] * quaternions[b, n]
    share, rest = share if cosine >= 0.0 else -share, 1.0 - share
    square = 0.0
    for n in range(4):
        out[n] = rest * quaternions[a, n] + share * quaternions[b, n]
        square += out[n] * out[n]
    for n in range(4):
        out[n] /= math.sqrt(square)


@inner
def _target(times, positions, t):
    """The trajectory at t: linear between samples."""
    a, b, share = _around(times, t)
    rest = 1.0 - share
    return (
        rest * positions[a, 0] + share * positions[b, 0],
        rest * positions[a, 1] + share * positions[b, 1],
        rest * positions[a, 2] + share * positions[b, 2],
    )


@kernel
def follow(times, positions, state, dt):
    """The hand is where the trajectory is, whatever pushes it."""
    state[0] += dt
    state[1], state[2], state[3] = _target(times, positions, state[0])


@kernel
def spring(times, positions, state, mass, stiffness, damping, dt):
    """m a = k (target - x) - b v + F, by semi-implicit Euler with b taken implicitly.

    So it is stable where sqrt(k/m) times the sub-step is below 2, for any b; the force holds for the whole
    dt.
    """
    steps = max(1, math.ceil(dt * math.sqrt(stiffness / mass) / _TURN))
    h = dt / steps
    kept = 1.0 / (1.0 + h * damping / mass)
    for _ in range(steps):
        state[0] += h
        target = _target(times, positions, state[0])
        for axis in range(3):
            pull = stiffness * (target[axis] - state[1 + axis]) + state[7 + axis]
            state[4 + axis] = (state[4 + axis] + h * pull / mass) * kept
            state[1 + axis] += h * state[4 + axis]
