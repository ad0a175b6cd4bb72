"""The servo: the process that reads the position of a force-feedback device and sets its force, at each tick
(1 kHz or more).

Whether it ends by an order, a signal, the loss of the player or a failure of the device, the force goes to
zero within the slew limit and the device is closed, as far as the device still accepts forces.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import multiprocessing
import os
import signal
import struct
import sys
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from pickle import PickleError
from typing import Any, Final

from touchfield.compute.native import native
from touchfield.errors import DeviceError, InvalidArgument, TouchfieldError
from touchfield.render.block import Block, Memory, layout
from touchfield.render.point_device import Point, PointDevice

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
    """Exchange between a device and the block, apart from the position.

    A method that the device does not override is never called.
    """

    def __init__(self, memory: Memory, device: PointDevice) -> None:
        self._grip, self._device = memory.receiver["grip"], device
        self._torque_nm = memory.receiver["state"]["torque"]["output"]

        def has(name: str) -> bool:
            return getattr(type(device), name) is not getattr(PointDevice, name)

        self._has_orientation, self._has_buttons, self._has_gripper, self._has_torque = map(
            has, ("orientation", "buttons", "gripper_m", "put_wrench")
        )

    def read(self) -> None:
        """Store orientation, buttons and gripper of the device in the block."""
        if self._has_orientation:
            self._grip["orientation"] = self._device.orientation()
        if self._has_buttons:
            self._grip["buttons"] = self._device.buttons()
        if self._has_gripper:
            self._grip["gripper_m"] = self._device.gripper_m()

    def put(self, force_n: Point) -> None:
        """Apply a force, and the torque of the latest tick."""
        if self._has_torque:
            self._device.put_wrench(*force_n, *self._torque_nm.tolist())
        else:
            self._device.put_force_n(*force_n)


def serve(memory: Memory, device: PointDevice, clock: Clock, must_stop: Callable[[], bool]) -> None:
    """Serve a device until a stop has brought the force to zero; it is always closed.

    `must_stop` is called before each tick. An error of the device is raised once the force is zero.
    """
    receiver = memory.receiver
    clock_state, orders, dt_s = receiver["clock"], receiver["orders"], 1.0 / receiver["settings"]["rate_hz"]
    is_paced, link, latest_m = device.is_paced, DeviceLink(memory, device), (0.0, 0.0, 0.0)
    receiver["layout"]["is_simulated"] = type(device).advance is not PointDevice.advance
    receiver["layout"]["is_paced"] = is_paced or device.is_driven
    try:
        device.open()
        if device.is_driven:
            _supervise(memory, device, must_stop)
            return
        sleep_until, position_m = clock.sleep_until, device.position_m
        try:
            while not clock_state["is_released"]:
                now_ns = 0 if is_paced else sleep_until(int(clock_state["deadline_ns"]))
                if must_stop():
                    clock_state["is_stopping"] = 1
                latest_m = position_m()
                link.read()
                link.put(native.cycle(memory.bytes, *latest_m, clock.now_ns() if is_paced else now_ns))
                device.advance(0.0 if orders["mode"] == layout.IDLE else dt_s)
        except BaseException:
            _ramp_to_zero(memory, device, link, clock, latest_m)
            raise
    finally:
        device.close()


def _ramp_to_zero(
    memory: Memory, device: PointDevice, link: DeviceLink, clock: Clock, position_m: Point
) -> None:
    """Bring force and torque to zero, ignoring errors of the device."""
    receiver = memory.receiver
    clock_state, dt_s = receiver["clock"], 1.0 / receiver["settings"]["rate_hz"]
    clock_state["is_stopping"] = 1
    deadline_ns = clock.now_ns() + int(receiver["layout"]["ramp_limit_ns"])
    while not clock_state["is_released"]:
        now_ns = clock.sleep_until(int(clock_state["deadline_ns"]))
        if now_ns > deadline_ns:  # the device is slow: set zero, no sooner than the slew limit allows
            clock.sleep_until(now_ns + math.ceil(1e9 * max(map(partial(_slew_s, receiver), _LIMITED))))
            receiver["state"]["torque"]["output"] = 0.0
            with contextlib.suppress(Exception):
                link.put((0.0, 0.0, 0.0))
            return
        force = native.cycle(memory.bytes, *position_m, now_ns)
        with contextlib.suppress(Exception):
            link.put(force)
            device.advance(dt_s)


_LIMITED: Final = ("force", "torque")


def _slew_s(receiver: Any, name: str) -> float:
    """Return the time that the slew limit needs for the present force or torque, seconds."""
    size = math.hypot(*receiver["state"][name]["output"])
    return size / float(receiver["settings"][f"{name}_limits"]["slew_per_s"]) if size else 0.0


def _supervise(memory: Memory, device: PointDevice, must_stop: Callable[[], bool]) -> None:
    """Leave the ticks to the vendor's driver, and wait for the end."""
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
            if ticks != latest_ticks:
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


_START_S: Final = 180.0
"""Time limit for loading interpreter and code."""

_SILENT_S: Final = 0.03
"""Time without a tick after which the device of a waiting process counts as hung."""

_MAX_STARVED_S: Final = 2.0
"""The same for a runnable process, which may only lack processor time."""

FIFO_PRIORITY: Final = 50
"""Above all ordinary processes, below the kernel's own threads."""

_LATENCY: Final = "/dev/cpu_dma_latency"
"""While this file is open, no processor takes longer to wake than the value written, us."""

_MCL_CURRENT, _MCL_ONFAULT = 1, 4
_PR_SET_TIMERSLACK: Final = 29

_ZERO_FORCE_S: Final = 5.0  # limit for starting an interpreter, opening the device, and writing zero
_TERMINATE_S: Final = 3.0
_KILL_S: Final = 2.0


def _run_servo(path: str, is_realtime: bool, pipe: Connection) -> None:
    """Main function of the servo's process.

    Attaches to the block, receives the device, warms up, serves, and reports.
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
        is_ready = False

        def must_stop() -> bool:
            nonlocal is_ready
            if not is_ready:  # the first call: the device is open
                is_ready = True
                pipe.send(("ready", report))
            return os.getppid() != parent

        serve(memory, device, WallClock(), must_stop)
        pipe.send(("done", None))
    except BaseException as error:
        reported = error
        if not isinstance(error, TouchfieldError):
            reported = DeviceError("device", f"{type(error).__name__}: {error}")
        with contextlib.suppress(OSError):
            pipe.send(("error", reported))
    finally:
        with contextlib.suppress(OSError):
            pipe.close()


def warm_up(memory: Memory) -> None:
    """Load the code by running ticks on a copy of the block without frames."""
    arena = int(memory.receiver["layout"]["arena_offset"])
    scratch = Memory.empty(max(arena, layout.RECEIVER.itemsize))
    scratch.bytes[:] = memory.bytes[: scratch.size_bytes]
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


def _write_zero(opener: Opener, pipe: Connection) -> None:
    try:
        device = opener()
        try:
            device.open()
            if not device.is_driven:
                device.put_wrench(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        finally:
            device.close()
        pipe.send("")
    except BaseException as error:
        pipe.send(f"{type(error).__name__}: {error}")


def zero_by_reconnecting(opener: Opener) -> str:
    """Set the force to zero through a new connection; describes the outcome.

    It runs in a process of its own, after a servo has died without releasing the device.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_write_zero, args=(opener, sender), name="touchfield-zero", daemon=True)
    try:
        process.start()
        sender.close()
        answer = receiver.recv() if receiver.poll(_ZERO_FORCE_S) else f"no answer within {_ZERO_FORCE_S:g} s"
    except (EOFError, OSError) as error:
        answer = f"{type(error).__name__}"
    finally:
        process.join(0.5)
        if process.is_alive():
            process.kill()
            process.join()
        receiver.close()
        process.close()
    if answer:
        return f"Setting the force to zero through a new connection failed ({answer}): switch the device off"
    return "The force was set to zero through a new connection to the device"


def is_waiting(pid: int) -> bool:
    """Return True if no thread of a process is running or runnable, or the system hides it."""
    try:
        for thread in Path(f"/proc/{pid}/task").iterdir():
            if (thread / "stat").read_text().rpartition(")")[2].split()[0] == "R":
                return False
    except (OSError, IndexError):
        pass
    return True


class ServoProcess:
    """The servo's process as seen by its parent.

    The block must be laid out, with the first order in it. `report` is that of `make_realtime`, once the
    process is ready; `error` is the error that ended it. `is_done` is True if it ended as ordered, and
    `is_unreleased` if it ended without bringing the force to zero.
    """

    def __init__(self, block: Block, opener: Opener, is_realtime: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, child_pipe = context.Pipe()
        self._block = block
        try:
            self._opener = ForkingPickler.dumps(opener)
        except (AttributeError, TypeError, ImportError, PickleError) as error:  # e.g. of a local function
            raise InvalidArgument(
                "opener", f"{opener!r} ({error})", "a callable that can be pickled"
            ) from error
        self.report: dict[str, str] = {}
        self.error: TouchfieldError | None = None
        self.is_ready = self.is_done = self.is_unreleased = self._is_joined = False
        self._ticks, self._ticked_s = -1, time.monotonic()
        self._silent_s = max(_SILENT_S, 3 / float(block.memory.receiver["settings"]["rate_hz"]))
        self._process = context.Process(
            target=_run_servo,
            args=(str(block.path), is_realtime, child_pipe),
            name="touchfield-servo",
            daemon=True,
        )
        try:
            self._process.start()
        finally:
            child_pipe.close()

    @property
    def pid(self) -> int | None:
        """Id of the process; None once it has ended."""
        return None if self._is_joined else self._process.pid

    def check_progress(self, ticks: int, has_released: bool) -> None:
        """Kill the process if its device hangs while a force is applied.

        A device hangs if the process waits for it and no tick has passed for too long.
        """
        now_s = time.monotonic()
        is_over = self._is_joined or self.error or self.is_done or not self._process.is_alive()
        if ticks != self._ticks or has_released or is_over:
            self._ticks, self._ticked_s = ticks, now_s
            return
        silent_s = now_s - self._ticked_s
        if silent_s < self._silent_s:
            return
        if silent_s < _MAX_STARVED_S and self.pid and not is_waiting(self.pid):
            return
        self.error = DeviceError(
            "device", f"no answer for {1e3 * silent_s:.0f} ms", "a position at each tick", "Plug it in again."
        )
        self.is_unreleased = True
        self._process.kill()

    def receive(self) -> None:
        """Read the messages of the process; never waits."""
        if self._is_joined:
            return
        is_alive = self._process.is_alive()  # checked first: a dead process has sent all its messages
        with contextlib.suppress(EOFError, OSError):
            while self._pipe.poll():
                kind, content = self._pipe.recv()
                if kind == "attached":
                    # not passed as an argument: if the process is gone, `start` would block on a long one
                    self._pipe.send_bytes(self._opener)
                    if os.name == "posix":
                        self._block.unlink()
                elif kind == "ready":
                    self.is_ready, self.report = True, content
                elif kind == "done":
                    self.is_done = True
                else:
                    self.error = content
        if not is_alive and not self.is_done and self.error is None:
            self.is_unreleased = self.is_ready
            hint = (
                ""
                if self.is_ready
                else 'Start the player under `if __name__ == "__main__":` of your program.'
            )
            self.error = DeviceError(
                "servo process",
                f"its end with exit code {self._process.exitcode}",
                "a process that runs until it is stopped",
                hint,
            )

    def wait_ready(self) -> None:
        """Wait until the device is open; raises the error if it cannot be opened."""
        deadline = time.monotonic() + _START_S
        while not self.is_ready:
            self.receive()
            if self.error is not None:
                raise self.error
            if self.is_done:
                return
            if time.monotonic() > deadline:
                raise DeviceError("servo process", f"no sign for {_START_S:g} s", "an open device")
            time.sleep(0.002)

    def join(self, ramp_s: float) -> None:
        """Wait for the end of the process after a stop; terminate it, then kill it, if needed."""
        process = self._process
        process.join(ramp_s)
        for end, seconds in ((process.terminate, _TERMINATE_S), (process.kill, _KILL_S)):
            if process.is_alive():
                end()
                process.join(seconds)
        self.receive()
        self._is_joined = True
        self._pipe.close()
        if not process.is_alive():
            process.close()
