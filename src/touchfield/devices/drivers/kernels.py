"""Compiled code of two drivers: the callback that the vendor's OpenHaptics library calls at each tick, and
the motion of the simulated hand.

Import this module only where it is used, since it imports numba.

**Callback.** The vendor's driver calls it a thousand times a second, without the interpreter. Its argument is
the address of an exchange buffer, the box, of 8-byte words. The driver class writes the address of the
player's block to the box, and the callback writes its results. The callback makes pointers from these words;
the views of the block are the same four that every kernel of the renderer takes.

**Simulated hand.** The hand follows its target exactly, or a spring pulls it there. The state is float64
[10]: time, position, velocity, force. `follow` and `spring` advance it by dt.
"""

from __future__ import annotations

import ctypes
import math
import sys
from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import carray, cfunc, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from touchfield.compute.jit import inner, kernel

BOX = 24
"""Number of words of the box; the constants below are their indices."""

ADDRESS, WORD_COUNT, HANDLE = 0, 1, 2
"""Address and length of the block, and the driver's handle of the device."""

STOP, DONE, CALLS = 3, 4, 5
"""Order to stop; 1 after stopping or 2 if the renderer failed; number of calls."""

CLOCK, POSITION, FORCE = 6, 8, 11
"""Two words of the clock, three of the position in millimetres, three of the force in newtons."""

ERROR, SCRATCH = 14, 16
"""First fault that the driver reported, 0 for none; two words of scratch memory."""

_CALL_AGAIN, _CALL_NO_MORE = np.uint32(1), np.uint32(0)
_CURRENT_POSITION, _CURRENT_FORCE = np.uint32(0x2050), np.uint32(0x2700)


def _as_pointer(_typing, address):
    """Convert an address to a pointer."""

    def build(_context, builder, _signature, arguments):
        return builder.inttoptr(arguments[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), build


_pointer: Any = intrinsic(_as_pointer)


def _typed(address: int | None, *arguments: Any, result: Any = None) -> Any:
    """Return the function at an address, for compiled code that passes pointers as integers."""
    return ctypes.CFUNCTYPE(result, *arguments)(address or 0)


def address_of(function: Any) -> int | None:
    """Return the address of a ctypes function."""
    return ctypes.cast(function, ctypes.c_void_p).value


def clock() -> Any:
    """Return a compiled function that reads the clock of `time.perf_counter_ns`.

    Its form is ``now(box) -> nanoseconds``.
    """
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
    """Return a compiled function for the code of the driver's latest error.

    The code is 0 if there is no error. hdGetError returns three words of four bytes by value. Compiled code
    has no such result type, but the same calling convention: two registers, the first of which contains the
    code; on Windows, memory that the caller provides.
    """
    if sys.platform == "win32":
        get_error_into = _typed(get_error, ctypes.c_size_t)

        @inner
        def read_into_box(box):
            get_error_into(box.ctypes.data + 8 * SCRATCH)
            return box[SCRATCH] & 0xFFFFFFFF

        return read_into_box
    get_error_code = _typed(get_error, result=ctypes.c_uint64)

    @inner
    def read_code(_box):
        return np.int64(get_error_code() & np.uint64(0xFFFFFFFF))

    return read_code


@cache
def compiled_callback(
    cycle: Any,
    begin_address: int | None,
    end_address: int | None,
    get_address: int | None,
    set_address: int | None,
    error_address: int | None,
) -> Any:
    """Compile the callback, HDCallbackCode (void *), as a numba cfunc.

    The driver gets its `address`. ``cycle(i8, u8, f8, f4, x, y, z, now_ns) -> (fx, fy, fz)`` is compiled, in
    metres and newtons in the device's axes. The other arguments are `address_of` hdBeginFrame, hdEndFrame,
    hdGetDoublev, hdSetDoublev and hdGetError of the vendor's library, which stays loaded.
    """
    begin_frame, end_frame = _typed(begin_address, ctypes.c_uint32), _typed(end_address, ctypes.c_uint32)
    get_doubles = _typed(get_address, ctypes.c_uint32, ctypes.c_size_t)
    set_doubles = _typed(set_address, ctypes.c_uint32, ctypes.c_size_t)
    now, latest_error = clock(), _latest_error(error_address)

    @cfunc(types.uint32(types.voidptr))
    def callback(user):
        box, numbers = carray(user, (BOX,), np.int64), carray(user, (BOX,), np.float64)
        handle, stop = np.uint32(box[HANDLE]), box[STOP]
        box[CALLS] += 1
        begin_frame(handle)
        fx = fy = fz = 0.0
        if stop == 0:
            get_doubles(_CURRENT_POSITION, box.ctypes.data + 8 * POSITION)
            block, word_count = _pointer(box[ADDRESS]), box[WORD_COUNT]
            i8, u8 = carray(block, (word_count,), np.int64), carray(block, (word_count,), np.uint64)
            f8, f4 = carray(block, (word_count,), np.float64), carray(block, (2 * word_count,), np.float32)
            x, y, z = numbers[POSITION] / 1000, numbers[POSITION + 1] / 1000, numbers[POSITION + 2] / 1000
            try:
                fx, fy, fz = cycle(i8, u8, f8, f4, x, y, z, now(box))
            except Exception:  # the caller cannot handle it, and the last force would stay
                stop = 2
        numbers[FORCE], numbers[FORCE + 1], numbers[FORCE + 2] = fx, fy, fz
        set_doubles(_CURRENT_FORCE, box.ctypes.data + 8 * FORCE)
        end_frame(handle)
        code = latest_error(box)
        # 0x02xx: the driver itself limits the force for a while (warm motors, or a fast hand)
        if code != 0 and code >> 8 != 2 and box[ERROR] == 0:
            box[ERROR] = code
        if stop != 0:
            box[DONE] = stop
            return _CALL_NO_MORE
        return _CALL_AGAIN

    return callback


_TURN = 0.1
"""Phase of the spring and mass in a sub-step; the integration is stable up to 2."""


@inner
def _bracket(times, t):
    """Return the samples before and after t, and the fraction of t between them.

    Before the first and after the last sample the fraction is 0; of equal times, the later sample counts.
    """
    low = np.searchsorted(times, t, side="right")
    a, b = max(low - 1, 0), min(low, times.shape[0] - 1)
    return a, b, (t - times[a]) / (times[b] - times[a]) if b > a and low > 0 else 0.0


@kernel
def interpolate_orientation(times, quaternions, t, out):
    """Write the orientation at t to `out` [4]: along the shorter arc, normalised."""
    a, b, weight = _bracket(times, t)
    cosine = 0.0
    for n in range(4):
        cosine += quaternions[a, n] * quaternions[b, n]
    weight, rest = weight if cosine >= 0.0 else -weight, 1.0 - weight
    square = 0.0
    for n in range(4):
        out[n] = rest * quaternions[a, n] + weight * quaternions[b, n]
        square += out[n] * out[n]
    for n in range(4):
        out[n] /= math.sqrt(square)


@inner
def _target(times, positions, t):
    """Return the position of the trajectory at t, linear between samples."""
    a, b, weight = _bracket(times, t)
    rest = 1.0 - weight
    return (
        rest * positions[a, 0] + weight * positions[b, 0],
        rest * positions[a, 1] + weight * positions[b, 1],
        rest * positions[a, 2] + weight * positions[b, 2],
    )


@kernel
def follow(times, positions, state, dt):
    """Move the hand along the trajectory, whatever the force."""
    state[0] += dt
    state[1], state[2], state[3] = _target(times, positions, state[0])


@kernel
def spring(times, positions, state, mass, stiffness, damping, dt):
    """Step m a = k (target - x) - b v + F by semi-implicit Euler, with b implicit.

    This is stable where sqrt(k/m) times the sub-step is below 2, for any b. The force is constant during dt.
    """
    steps = max(1, math.ceil(dt * math.sqrt(stiffness / mass) / _TURN))
    h = dt / steps
    damping_factor = 1.0 / (1.0 + h * damping / mass)
    for _ in range(steps):
        state[0] += h
        target = _target(times, positions, state[0])
        for axis in range(3):
            pull = stiffness * (target[axis] - state[1 + axis]) + state[7 + axis]
            state[4 + axis] = (state[4 + axis] + h * pull / mass) * damping_factor
            state[1 + axis] += h * state[4 + axis]
