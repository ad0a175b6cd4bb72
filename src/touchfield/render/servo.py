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
from touchfield.render.block import words as W
from touchfield.render.point_device import Point, PointDevice

if TYPE_CHECKING:
    from touchfield.render.block.memory import Memory

Opener = Callable[[], PointDevice]  # makes the device, not yet open; can be pickled
_WATCH_S: Final = 0.01
_MOST_SILENT_S: Final = 2.0
"""A driver that does not call for so long is taken for dead."""


class WallClock:
    """The machine's clock that never goes back, the same for all its processes, in its finest steps."""

    now_ns = staticmethod(time.perf_counter_ns)

    def sleep_until(self, deadline_ns: int) -> int:
        """Wait for a deadline, so that what was slept too long is not added up; the time then."""
        while (now_ns := self.now_ns()) < deadline_ns:
            time.sleep(1e-9 * (deadline_ns - now_ns))
        return now_ns


class VirtualClock:
    """Time that passes only where it is waited for."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """Nanoseconds."""
        return self._now_ns

    def sleep_until(self, deadline_ns: int) -> int:
        """It is the deadline now."""
        self._now_ns = max(self._now_ns, deadline_ns)
        return self._now_ns


Clock = WallClock | VirtualClock


class Grip:
    """Traffic between a device and the block beside its place: orientation, buttons, gripper; force and torque.

    A device that does not tell these is not asked, and gets its force alone.
    """

    def __init__(self, memory: Memory, device: PointDevice) -> None:
        self._f8, self._i8, self._device = memory.f8, memory.i8, device

        def has(name: str) -> bool:
            return getattr(type(device), name) is not getattr(PointDevice, name)

        self._is_turning, self._has_buttons, self._has_gripper, self._is_twisting = map(
            has, ("orientation", "buttons", "gripper_m", "put_wrench")
        )

    def read(self) -> None:
        """Keep what the device tells beside its place."""
        if self._is_turning:
            self._f8[W.ORIENTATION : W.ORIENTATION + 4] = self._device.orientation()
        if self._has_buttons:
            self._i8[W.BUTTONS] = self._device.buttons()
        if self._has_gripper:
            self._f8[W.GRIPPER_M] = self._device.gripper_m()

    def put(self, force_n: Point) -> None:
        """Put a force, and the torque that the latest tick left."""
        if self._is_twisting:
            self._device.put_wrench(*force_n, *self._f8[W.TORQUE : W.TORQUE + 3].tolist())
        else:
            self._device.put_force_n(*force_n)

    def put_nothing(self) -> None:
        """Put neither force nor torque."""
        self._f8[W.TORQUE : W.TORQUE + 3] = 0.0
        self.put((0.0, 0.0, 0.0))

    @property
    def held_s(self) -> float:
        """The time in which what is held may go to zero, seconds."""
        f8 = self._f8
        force_s = math.hypot(*f8[W.FORCE : W.FORCE + 3]) / float(f8[W.SLEW])
        torque = math.hypot(*f8[W.TORQUE : W.TORQUE + 3])
        return max(force_s, torque / float(f8[W.TORQUE_SLEW])) if torque > 0 else force_s


def serve(memory: Memory, device: PointDevice, clock: Clock, must_stop: Callable[[], bool]) -> None:
    """Open a device and serve it until a stop has brought the force to zero; closes it in any case.

    `memory` is laid out, with the first order in it; `must_stop` is asked before each tick. What the device raises
    is raised after the force was brought to zero, as far as it listens.
    """
    from touchfield.render.kernels.cycle import cycle

    memory.i8[W.IS_SIMULATED] = type(device).advance is not PointDevice.advance
    memory.i8[W.IS_PACED] = device.is_paced or device.is_driven
    try:
        device.open()
        if device.is_driven:
            _watch(memory, device, must_stop)
        else:
            _serve(memory, device, clock, must_stop, cycle)
    finally:
        device.close()


def _serve(memory: Memory, device: PointDevice, clock: Clock, must_stop: Callable[[], bool], cycle: Any) -> None:
    i8, views, dt_s = memory.i8, memory.views, 1.0 / float(memory.f8[W.RATE_HZ])
    sleep_until, position_m, grip = clock.sleep_until, device.position_m, Grip(memory, device)
    is_paced = device.is_paced
    x = y = z = 0.0
    try:
        while not i8[W.RELEASED]:
            now_ns = 0 if is_paced else sleep_until(int(i8[W.DEADLINE_NS]))
            if must_stop():
                i8[W.STOP_HERE] = 1
            x, y, z = position_m()
            grip.read()
            grip.put(cycle(*views, x, y, z, clock.now_ns() if is_paced else now_ns))
            device.advance(0.0 if i8[W.MODE] == W.IDLE else dt_s)
    except BaseException:
        _let_go(memory, device, grip, clock, cycle, (x, y, z))
        raise


def _let_go(memory: Memory, device: PointDevice, grip: Grip, clock: Clock, cycle: Any, at_m: Point) -> None:
    """Force and torque to zero, whatever the device says to it."""
    i8, dt_s = memory.i8, 1.0 / float(memory.f8[W.RATE_HZ])
    i8[W.STOP_HERE] = 1
    ends_ns = clock.now_ns() + int(i8[W.RAMP_LIMIT_NS])
    while not i8[W.RELEASED]:
        now_ns = clock.sleep_until(int(i8[W.DEADLINE_NS]))
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
        while not i8[W.RELEASED]:
            if must_stop():
                i8[W.STOP_HERE] = 1
            time.sleep(_WATCH_S)
            device.watch()
            now_s, ticks = time.monotonic(), int(i8[W.TICKS])
            if ticks != seen:
                seen, seen_s = ticks, now_s
            elif now_s - seen_s > _MOST_SILENT_S:
                raise DeviceError(
                    "driver of the device", f"no call for {_MOST_SILENT_S:g} s", "its own rate", "Plug it in again."
                )
    finally:
        i8[W.STOP_HERE] = 1
        ends_s = time.monotonic() + 1e-9 * float(i8[W.RAMP_LIMIT_NS])
        while not i8[W.RELEASED] and seen_s + _MOST_SILENT_S > time.monotonic() and time.monotonic() < ends_s:
            time.sleep(_WATCH_S)
