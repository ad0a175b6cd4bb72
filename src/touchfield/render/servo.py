"""The servo: the process that reads the position of a force-feedback device and sets its force, at each tick
(1 kHz or more).

Whether it ends by an order, a signal, the loss of the player or a failure of the device, the force goes to
zero within the slew limit and the device is closed, as far as the device still accepts forces. If it dies
without that, `standby` takes over the device.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import os
import signal
import struct
import sys
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from touchfield.compute.native import native
from touchfield.errors import DeviceError, TouchfieldError
from touchfield.render.block import Block, Memory, layout
from touchfield.render.loop_delay import LoopMeter, LoopTimes
from touchfield.render.point_device import NOWHERE, Point, PointDevice
from touchfield.render.readiness import ReadinessWatch, open_when_ready
from touchfield.render.readings import (
    buttons_reading,
    gripper_reading,
    orientation_reading,
    position_reading,
)

Opener = Callable[[], PointDevice]
"""Callable that makes the device, not yet open; can be pickled."""

_WATCH_S: Final = 0.01
_MAX_SILENCE_S: Final = 2.0  # time without a call after which a driver counts as dead


class WallClock:
    """The monotonic clock of the machine, the same for all its processes."""

    now_ns = staticmethod(time.perf_counter_ns)

    def sleep_until(self, deadline_ns: int) -> int:
        """Wait for a deadline, so that sleep errors do not add up; returns the time."""
        while (now_ns := self.now_ns()) < deadline_ns:
            time.sleep(1e-9 * (deadline_ns - now_ns))
        return now_ns


class VirtualClock:
    """A clock whose time passes only in `sleep_until`."""

    def __init__(self) -> None:
        self._now_ns = 0

    def now_ns(self) -> int:
        """Return the time in nanoseconds."""
        return self._now_ns

    def sleep_until(self, deadline_ns: int) -> int:
        """Set the clock to the deadline."""
        self._now_ns = max(self._now_ns, deadline_ns)
        return self._now_ns


Clock = WallClock | VirtualClock


class DeviceLink:
    """Exchange between a device and the block.

    A method that the device does not override is never called. All that the device reports is converted here
    (`readings`), whatever the types that its driver returns.
    """

    def __init__(self, memory: Memory, device: PointDevice) -> None:
        self._grip, self._device = memory.receiver["grip"], device
        self._torque_nm = memory.receiver["state"]["torque"]["output"]
        self._has_orientation, self._has_buttons, self._has_gripper, self._has_torque = (
            overrides(device, name) for name in ("orientation", "buttons", "gripper_m", "put_wrench")
        )

    def position_m(self) -> Point:
        """Return the position of the device, metres; store orientation, buttons and gripper in the block.

        Raises `DeviceError` if the device does, or if a reading has another form.
        """
        position_m = position_reading(self._device.position_m())
        if self._has_orientation:
            self._grip["orientation"] = orientation_reading(self._device.orientation())
        if self._has_buttons:
            self._grip["buttons"] = buttons_reading(self._device.buttons())
        if self._has_gripper:
            self._grip["gripper_m"] = gripper_reading(self._device.gripper_m())
        return position_m

    def put(self, force_n: Point) -> None:
        """Apply a force, and the torque of the latest tick."""
        if self._has_torque:
            self._device.put_wrench(*force_n, *self._torque_nm.tolist())
        else:
            self._device.put_force_n(*force_n)


def overrides(device: PointDevice, name: str) -> bool:
    """Return True if the class of a device has a method of its own."""
    return getattr(type(device), name) is not getattr(PointDevice, name)


def _open(device: PointDevice) -> bool:
    device.open()
    return True


def serve(
    memory: Memory,
    device: PointDevice,
    clock: Clock,
    must_stop: Callable[[], bool],
    open_device: Callable[[PointDevice], bool] = _open,
    watch: ReadinessWatch | None = None,
    report_loop: Callable[[LoopTimes], None] | None = None,
) -> None:
    """Serve a device until a stop has brought the force to zero; it is always closed.

    `open_device` opens it; if that returns False, there is nothing to serve. `must_stop` is called before
    each tick. While `watch` reports that the device is not ready, it has no position and hence no force.
    `report_loop` gets the times of the loop of a device that is not simulated. An error of the device is
    raised once the force is zero.
    """
    receiver = memory.receiver
    clock_state, orders, dt_s = receiver["clock"], receiver["orders"], 1.0 / receiver["settings"]["rate_hz"]
    is_paced, link, latest_m = device.is_paced, DeviceLink(memory, device), (0.0, 0.0, 0.0)
    is_simulated = receiver["layout"]["is_simulated"] = overrides(device, "advance")
    meter = None
    if report_loop is not None and not is_simulated:
        meter = LoopMeter(report_loop)
    receiver["layout"]["is_paced"] = is_paced or device.is_driven
    try:
        if not open_device(device):
            return
        if device.is_driven:
            _supervise(memory, device, must_stop, watch, meter)
            return
        sleep_until = clock.sleep_until
        try:
            while not clock_state["is_released"]:
                now_ns = 0 if is_paced else sleep_until(int(clock_state["deadline_ns"]))
                if must_stop():
                    clock_state["is_stopping"] = 1
                start_s = perf_counter()
                latest_m = link.position_m()
                if watch is not None and not watch.is_ready(start_s):
                    latest_m = NOWHERE
                link.put(native.cycle(memory.bytes, *latest_m, clock.now_ns() if is_paced else now_ns))
                if meter is not None:
                    end_s = perf_counter()
                    meter.add(end_s - start_s, end_s)
                device.advance(0.0 if orders["mode"] == layout.IDLE else dt_s)
        except BaseException:
            ramp_to_zero(memory, device, link, clock, latest_m)
            raise
    finally:
        device.close()


def ramp_to_zero(
    memory: Memory, device: PointDevice, link: DeviceLink, clock: Clock, position_m: Point
) -> Exception | None:
    """Bring force and torque to zero; returns the error of the last call of the device, None if it worked.

    Earlier errors of the device are ignored.
    """
    receiver = memory.receiver
    clock_state, dt_s = receiver["clock"], 1.0 / receiver["settings"]["rate_hz"]
    clock_state["is_stopping"] = 1
    deadline_ns = clock.now_ns() + int(receiver["layout"]["ramp_limit_ns"])
    error: Exception | None = None
    while not clock_state["is_released"]:
        now_ns = clock.sleep_until(int(clock_state["deadline_ns"]))
        is_late = now_ns > deadline_ns  # the device is slow: set zero, no sooner than the slew limit allows
        if is_late:
            clock.sleep_until(now_ns + math.ceil(1e9 * slew_s(receiver)))
            receiver["state"]["torque"]["output"] = 0.0
            force = (0.0, 0.0, 0.0)
        else:
            force = native.cycle(memory.bytes, *position_m, now_ns)
        try:
            link.put(force)
            error = None
        except Exception as put_error:
            error = put_error
        if is_late:
            break
        with contextlib.suppress(Exception):
            device.advance(dt_s)
    return error


def slew_s(receiver: Any) -> float:
    """Return the time that the slew limits need for the present force and torque, seconds."""
    seconds = 0.0
    for name in ("force", "torque"):
        size = math.hypot(*receiver["state"][name]["output"])
        if size:
            seconds = max(seconds, size / float(receiver["settings"][f"{name}_limits"]["slew_per_s"]))
    return seconds


def _supervise(
    memory: Memory,
    device: PointDevice,
    must_stop: Callable[[], bool],
    watch: ReadinessWatch | None,
    meter: LoopMeter | None,
) -> None:
    """Leave the ticks to the vendor's driver, and wait for the end.

    The driver's own callback takes the force away while the device is not ready; `watch` reports it.
    """
    clock, counts = memory.receiver["clock"], memory.receiver["counts"]
    device.drive(int(memory.bytes.ctypes.data), memory.size_bytes)
    latest_ticks, latest_tick_s = -1, time.monotonic()
    try:
        while not clock["is_released"]:
            if must_stop():
                clock["is_stopping"] = 1
            time.sleep(_WATCH_S)
            device.watch()
            now_s, ticks = time.monotonic(), int(counts["ticks"])
            if watch is not None:
                watch.is_ready(now_s)
            if ticks != latest_ticks:
                if meter is not None:
                    meter.add(device.frame_s(), now_s, ticks - latest_ticks)
                latest_ticks, latest_tick_s = ticks, now_s
            elif now_s - latest_tick_s > _MAX_SILENCE_S:
                raise DeviceError(
                    "driver of the device",
                    f"no call for {_MAX_SILENCE_S:g} s",
                    "its own rate",
                    "Plug it in again.",
                )
    finally:
        clock["is_stopping"] = 1
        deadline_s = time.monotonic() + 1e-9 * float(memory.receiver["layout"]["ramp_limit_ns"])
        while (
            not clock["is_released"]
            and latest_tick_s + _MAX_SILENCE_S > time.monotonic()
            and time.monotonic() < deadline_s
        ):
            time.sleep(_WATCH_S)


FIFO_PRIORITY: Final = 50
"""Above all ordinary processes, below the kernel's own threads."""

_LATENCY: Final = "/dev/cpu_dma_latency"
"""While this file is open, no processor takes longer to wake than the value written, us."""

_MCL_CURRENT, _MCL_ONFAULT = 1, 4
_PR_SET_TIMERSLACK: Final = 29

CLOSED: Final = b"closed"
"""Last message of the servo to its standby: it has closed the device itself."""

UNIT: Final = b"unit "
"""Start of the message that names the unit which the servo has opened; its id follows."""


def run_servo(path: str, is_realtime: bool, wait_s: float, pipe: Connection, lifeline: Connection) -> None:
    """Main function of the servo's process.

    Attaches to the block, receives the device, warms up, waits up to `wait_s` seconds until the device is
    ready, serves, and reports. `lifeline` is the writing end
    of a pipe that the standby reads; it is closed at the latest when this process ends.
    """
    parent = os.getppid()
    block = Block.attach(Path(path))
    pipe.send(("attached", None))
    memory = block.memory

    def stop(*_: Any) -> None:
        memory.receiver["clock"]["is_stopping"] = 1

    for signal_number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(signal_number, stop)
    try:
        opener: Opener = pipe.recv()
        warm_up(memory)
        report = make_realtime(is_realtime)
        device = opener()
        clock, orders = memory.receiver["clock"], memory.receiver["orders"]

        def is_orphan() -> bool:
            return os.getppid() != parent

        def note(text: str) -> None:
            with contextlib.suppress(OSError):  # the player is gone: the next tick finds that
                pipe.send(("note", text))

        def report_loop(times: LoopTimes) -> None:
            with contextlib.suppress(OSError):
                pipe.send(("loop", times))

        def open_device(device: PointDevice) -> bool:
            def must_stop() -> bool:
                return bool(clock["is_stopping"] or orders["is_stopping"]) or is_orphan()

            is_ready = open_when_ready(device, wait_s, must_stop, note)
            if is_ready:
                if device.unit:
                    lifeline.send_bytes(UNIT + device.unit.encode())
                pipe.send(("ready", (report, device.unit)))
            return is_ready

        watch = None
        if overrides(device, "state"):
            watch = ReadinessWatch(device.title, device.state, wait_s, note)
        serve(memory, device, WallClock(), is_orphan, open_device, watch, report_loop)
        pipe.send(("done", None))
    except BaseException as error:
        reported = error
        if not isinstance(error, TouchfieldError):
            reported = DeviceError("device", f"{type(error).__name__}: {error}")
        with contextlib.suppress(OSError):
            pipe.send(("error", reported))
    finally:
        with contextlib.suppress(OSError):
            lifeline.send_bytes(CLOSED)
        with contextlib.suppress(OSError):
            pipe.close()


def warm_up(memory: Memory) -> None:
    """Load the code by running ticks on a copy of the block without frames."""
    arena = int(memory.receiver["layout"]["arena_offset"])
    scratch = Memory.empty(max(arena, layout.RECEIVER.itemsize))
    scratch.bytes[:] = memory.bytes[: scratch.size_bytes]
    parts = scratch.receiver["layout"]
    offset, slots = int(parts["directory_offset"]), int(parts["directory_slots"])
    scratch.array(layout.DIRECTORY_ENTRY, offset, slots)["tag"] = -1  # the copy has no frames
    for n in range(32):
        native.cycle(scratch.bytes, 0.0, 0.0, 0.0, 1 + n * int(scratch.receiver["layout"]["tick_ns"]))
    scratch.receiver["clock"]["is_stopping"] = 1
    native.cycle(scratch.bytes, 0.0, 0.0, 0.0, 1 << 40)


def make_realtime(is_realtime: bool = True) -> dict[str, str]:
    """Request real-time behaviour for this process; never raises.

    Disables the garbage collector and the grouping of timers. With `is_realtime`, also requests SCHED_FIFO,
    locked memory, and processors that stay awake until the process ends. The entries ``priority``, ``memory``
    and ``processors`` of the result describe what was obtained, or why not.
    """
    gc.collect()
    gc.disable()
    gc.freeze()
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    if not is_realtime:
        skipped = {"memory": "not locked: not requested", "processors": "may sleep: not requested"}
        return {"priority": "normal: requested", **skipped}

    def lock() -> None:
        """Lock all pages that are or will be touched; the block need not be resident as a whole."""
        if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_ONFAULT):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    def use_fifo() -> None:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY))

    def keep_awake() -> None:
        os.write(os.open(_LATENCY, os.O_WRONLY), struct.pack("i", 0))

    report = {"priority": f"SCHED_FIFO {FIFO_PRIORITY}", "memory": "locked", "processors": "never asleep"}
    for key, fallback, request in (
        ("priority", "normal", use_fifo),
        ("memory", "not locked", lock),  # the flags are those of Linux
        ("processors", "may sleep", keep_awake),
    ):
        try:
            request()
        except (OSError, AttributeError) as error:
            report[key] = f"{fallback}: {getattr(error, 'strerror', None) or 'not on this system'}"
    return report
