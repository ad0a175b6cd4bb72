"""The servo: tick after tick, from the device's position to its force; and every way in which that can end.

However it ends, the device gets forces that go to zero within the slew limit, then zero, and is closed: at an order,
at a signal, when the player is gone, when the device itself fails (as far as it still listens).
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from touchfield.errors import DeviceError
from touchfield.render import control
from touchfield.render.grip import Grip
from touchfield.render.point_device import Point, PointDevice
from touchfield.render.statistics import TICKS

if TYPE_CHECKING:
    from touchfield.render.clock import Clock
    from touchfield.render.memory import Memory

__all__ = ["Opener", "serve"]

Opener = Callable[[], PointDevice]
"""Makes the device, not yet open; can be pickled."""

_WATCH_S: Final = 0.01
_MOST_SILENT_S: Final = 2.0
"""A driver that does not call for so long is taken for dead."""


def serve(memory: Memory, device: PointDevice, clock: Clock, must_stop: Callable[[], bool]) -> None:
    """Open a device and serve it until a stop has brought the force to zero; closes it in any case.

    Parameters
    ----------
    memory : Memory
        Laid out, with the first order in it.
    device : PointDevice
        Not yet open.
    clock : Clock
    must_stop : callable
        Asked before each tick.

    Raises
    ------
    DeviceError
        What the device raised, after the force was brought to zero as far as it listens.
    """
    from touchfield.render.kernels.cycle import cycle

    memory.i8[control.IS_SIMULATED] = type(device).advance is not PointDevice.advance
    memory.i8[control.IS_PACED] = device.is_paced or device.is_driven
    try:
        device.open()
        if device.is_driven:
            _watch(memory, device, must_stop)
        else:
            _serve(memory, device, clock, must_stop, cycle)
    finally:
        device.close()


def _serve(memory: Memory, device: PointDevice, clock: Clock, must_stop: Callable[[], bool], cycle: Any) -> None:
    i8, views, dt_s = memory.i8, memory.views, 1.0 / float(memory.f8[control.RATE_HZ])
    sleep_until, position_m, grip = clock.sleep_until, device.position_m, Grip(memory, device)
    is_paced = device.is_paced
    x = y = z = 0.0
    try:
        while not i8[control.RELEASED]:
            now_ns = 0 if is_paced else sleep_until(int(i8[control.DEADLINE_NS]))
            if must_stop():
                i8[control.STOP_HERE] = 1
            x, y, z = position_m()
            grip.read()
            grip.put(cycle(*views, x, y, z, clock.now_ns() if is_paced else now_ns))
            device.advance(0.0 if i8[control.MODE] == control.IDLE else dt_s)
    except BaseException:
        _let_go(memory, device, grip, clock, cycle, (x, y, z))
        raise


def _let_go(memory: Memory, device: PointDevice, grip: Grip, clock: Clock, cycle: Any, at_m: Point) -> None:
    """Force and torque to zero, whatever the device says to it."""
    i8, dt_s = memory.i8, 1.0 / float(memory.f8[control.RATE_HZ])
    i8[control.STOP_HERE] = 1
    ends_ns = clock.now_ns() + int(i8[control.RAMP_LIMIT_NS])
    while not i8[control.RELEASED]:
        now_ns = clock.sleep_until(int(i8[control.DEADLINE_NS]))
        if now_ns > ends_ns:  # it takes its time to answer; zero, but no sooner than the slew limit allows
            clock.sleep_until(now_ns + math.ceil(1e9 * grip.held_s))
            with contextlib.suppress(Exception):
                grip.put_nothing()
            return
        force = cycle(*memory.views, *at_m, now_ns)
        with contextlib.suppress(Exception):
            grip.put(force)
            device.advance(dt_s)


def _watch(memory: Memory, device: PointDevice, must_stop: Callable[[], bool]) -> None:
    """Leave the ticks to the vendor's driver, and wait for the end."""
    i8 = memory.i8
    device.drive(int(i8.ctypes.data), memory.words)
    seen, seen_s = -1, time.monotonic()
    try:
        while not i8[control.RELEASED]:
            if must_stop():
                i8[control.STOP_HERE] = 1
            time.sleep(_WATCH_S)
            device.watch()
            now_s, ticks = time.monotonic(), int(i8[TICKS])
            if ticks != seen:
                seen, seen_s = ticks, now_s
            elif now_s - seen_s > _MOST_SILENT_S:
                raise DeviceError(
                    "driver of the device", f"no call for {_MOST_SILENT_S:g} s", "its own rate", "Plug it in again."
                )
    finally:
        i8[control.STOP_HERE] = 1
        ends_s = time.monotonic() + 1e-9 * float(i8[control.RAMP_LIMIT_NS])
        while not i8[control.RELEASED] and seen_s + _MOST_SILENT_S > time.monotonic() and time.monotonic() < ends_s:
            time.sleep(_WATCH_S)
