"""The servo: tick after tick, from the device's position to its force; and every way in which that can end.

However it ends, the device gets forces that go to zero within the slew limit, then zero, and is closed: at an
order, at a signal, when the player is gone, when the device itself fails (as far as it still listens).
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
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from pickle import PickleError
from typing import Any, Final

from touchfield.errors import DeviceError, InvalidArgument, TouchfieldError
from touchfield.render.block import Block, Memory
from touchfield.render.block import words as W
from touchfield.render.point_device import Point, PointDevice

Opener = Callable[[], PointDevice]  # makes the device, not yet open; can be pickled
_WATCH_S: Final = 0.01
_MOST_SILENT_S: Final = 2.0  # A driver that does not call for so long is taken for dead


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
    """Traffic between a device and the block beside its place; a device that tells no more is not asked for
    it.
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


def serve(memory: Memory, device: PointDevice, clock: Clock, must_stop: Callable[[], bool]) -> None:
    """Open a device and serve it until a stop has brought the force to zero; closes it in any case.

    `must_stop` is asked before each tick. What the device raises is raised once the force is zero.
    """
    from touchfield.render.kernels.tick import cycle

    i8, views, dt_s = memory.i8, memory.views, 1.0 / float(memory.f8[W.RATE_HZ])
    is_paced, grip, at_m = device.is_paced, Grip(memory, device), (0.0, 0.0, 0.0)
    i8[W.IS_SIMULATED] = type(device).advance is not PointDevice.advance
    i8[W.IS_PACED] = is_paced or device.is_driven
    try:
        device.open()
        if device.is_driven:
            _watch(memory, device, must_stop)
            return
        sleep_until, position_m = clock.sleep_until, device.position_m
        try:
            while not i8[W.RELEASED]:
                now_ns = 0 if is_paced else sleep_until(int(i8[W.DEADLINE_NS]))
                if must_stop():
                    i8[W.STOP_HERE] = 1
                at_m = position_m()
                grip.read()
                grip.put(cycle(*views, *at_m, clock.now_ns() if is_paced else now_ns))
                device.advance(0.0 if i8[W.MODE] == W.IDLE else dt_s)
        except BaseException:
            _let_go(memory, device, grip, clock, cycle, at_m)
            raise
    finally:
        device.close()


def _let_go(memory: Memory, device: PointDevice, grip: Grip, clock: Clock, cycle: Any, at_m: Point) -> None:
    """Force and torque to zero, whatever the device says to it."""
    i8, f8, dt_s = memory.i8, memory.f8, 1.0 / float(memory.f8[W.RATE_HZ])
    i8[W.STOP_HERE] = 1
    ends_ns = clock.now_ns() + int(i8[W.RAMP_LIMIT_NS])
    while not i8[W.RELEASED]:
        now_ns = clock.sleep_until(int(i8[W.DEADLINE_NS]))
        if now_ns > ends_ns:  # it takes its time to answer; zero, but no sooner than the slew limit allows
            limits = ((W.FORCE, W.SLEW), (W.TORQUE, W.TORQUE_SLEW))
            forces = [(math.hypot(*f8[at : at + 3]), float(f8[slew])) for at, slew in limits]
            clock.sleep_until(
                now_ns + math.ceil(1e9 * max(size / slew if size else 0.0 for size, slew in forces))
            )
            f8[W.TORQUE : W.TORQUE + 3] = 0.0
            with contextlib.suppress(Exception):
                grip.put((0.0, 0.0, 0.0))
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
                    "driver of the device",
                    f"no call for {_MOST_SILENT_S:g} s",
                    "its own rate",
                    "Plug it in again.",
                )
    finally:
        i8[W.STOP_HERE] = 1
        ends_s = time.monotonic() + 1e-9 * float(i8[W.RAMP_LIMIT_NS])
        while not i8[W.RELEASED] and seen_s + _MOST_SILENT_S > time.monotonic() and time.monotonic() < ends_s:
            time.sleep(_WATCH_S)


_BEGIN_S: Final = (
    180.0  # in which interpreter and code are loaded; on a fresh machine the code is compiled first
)
_SILENT_S: Final = (
    0.03  # without a tick for so long, a process that waits for something is one whose device hangs
)
_MOST_STARVED_S: Final = 2.0  # the same of one that could run, and has only not got the processor
FIFO_PRIORITY: Final = (
    50  # in the middle: above all ordinary processes, below what the kernel itself runs there
)
_LATENCY: Final = (
    "/dev/cpu_dma_latency"  # while it is open, no processor takes longer to wake than was written, us
)
_MCL_CURRENT, _MCL_ONFAULT = 1, 4
_PR_SET_TIMERSLACK: Final = 29

_LONGEST_S: Final = 5.0  # in which a new interpreter starts, the device is opened, and zero is written
_TERMINATE_S: Final = 3.0
_KILL_S: Final = 2.0


def _main(path: str, is_realtime: bool, pipe: Connection) -> None:
    """The process: attach, hear of the device, warm up, open, serve, tell."""
    parent = os.getppid()
    block = Block.attach(Path(path))
    pipe.send(("attached", None))
    memory = block.memory
    i8 = memory.i8

    def stop(*_: Any) -> None:
        i8[W.STOP_HERE] = 1

    for one in (signal.SIGTERM, signal.SIGINT):
        signal.signal(one, stop)
    try:
        opener: Opener = pipe.recv()
        warm_up(memory)
        report = prefer(is_realtime)
        device = opener()
        is_ready = False

        def must_stop() -> bool:
            nonlocal is_ready
            if not is_ready:  # asked for the first time once the device is open
                is_ready = True
                pipe.send(("ready", report))
            return os.getppid() != parent

        serve(memory, device, WallClock(), must_stop)
        pipe.send(("done", None))
    except BaseException as error:
        own = (
            error
            if isinstance(error, TouchfieldError)
            else DeviceError("device", f"{type(error).__name__}: {error}")
        )
        with contextlib.suppress(OSError):
            pipe.send(("error", own))
    finally:
        with contextlib.suppress(OSError):
            pipe.close()


def warm_up(memory: Memory) -> None:
    """Load the compiled code, or compile it, by ticks on a copy of the block without frames."""
    from touchfield.render.kernels.tick import cycle

    mute = Memory.empty(max(int(memory.i8[W.ARENA]), W.FREE))
    mute.i8[:] = memory.i8[: mute.words]
    for n in range(32):
        cycle(*mute.views, 0.0, 0.0, 0.0, 1 + n * int(mute.i8[W.TICK_NS]))
    mute.i8[W.STOP_HERE] = 1
    cycle(*mute.views, 0.0, 0.0, 0.0, 1 << 40)


def prefer(is_realtime: bool = True) -> dict[str, str]:
    """Make this process punctual; what was had is told, and what was not is no error.

    No collector, wake-ups by themselves, and with `is_realtime` SCHED_FIFO, locked memory, and processors
    that stay awake until it ends. ``priority``, ``memory`` and ``processors`` tell what there is, or why not.
    """
    gc.collect()
    gc.disable()
    gc.freeze()
    if sys.platform.startswith("linux"):
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)
    if not is_realtime:
        rest = {"memory": "not locked: not asked for", "processors": "may sleep: not asked for"}
        return {"priority": "normal: asked for", **rest}

    def lock() -> None:  # what was and will be touched of the block, which need not be there as a whole
        if ctypes.CDLL(None, use_errno=True).mlockall(_MCL_CURRENT | _MCL_ONFAULT):
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))

    report = {"priority": f"SCHED_FIFO {FIFO_PRIORITY}", "memory": "locked", "processors": "kept awake"}
    for key, otherwise, act in (
        (
            "priority",
            "normal",
            lambda: os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO_PRIORITY)),
        ),
        ("memory", "not locked", lock),  # on Linux alone, as its flags
        ("processors", "may sleep", lambda: os.write(os.open(_LATENCY, os.O_WRONLY), struct.pack("i", 0))),
    ):
        try:
            act()
        except (OSError, AttributeError) as error:
            report[key] = f"{otherwise}: {getattr(error, 'strerror', None) or 'not on this system'}"
    return report


def _zero(opener: Opener, pipe: Connection) -> None:
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


def zero_afresh(opener: Opener) -> str:
    """Zero through a fresh connection from a process of its own, where a servo is gone without; how it went."""
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_zero, args=(opener, theirs), name="touchfield-zero", daemon=True)
    try:
        process.start()
        theirs.close()
        answer = mine.recv() if mine.poll(_LONGEST_S) else f"no answer within {_LONGEST_S:g} s"
    except (EOFError, OSError) as error:
        answer = f"{type(error).__name__}"
    finally:
        process.join(0.5)
        if process.is_alive():
            process.kill()
            process.join()
        mine.close()
        process.close()
    if answer:
        return (
            f"A force of zero was tried through a fresh connection, which failed ({answer}): switch the "
            "device off"
        )
    return "A force of zero was written through a fresh connection to the device"


def is_waiting(pid: int) -> bool:
    """True if no thread of a process runs or could run, and where the system does not tell."""
    try:
        for one in Path(f"/proc/{pid}/task").iterdir():
            if (one / "stat").read_text().rpartition(")")[2].split()[0] == "R":
                return False
    except (OSError, IndexError):
        pass
    return True


class ServoProcess:
    """The process as its parent holds it; the block is laid out, with the first order in it.

    `report` is that of `prefer`, once it is ready; `error` is what ended it; `is_done`: it ended in order;
    `is_lost`: without having brought the force to zero.
    """

    def __init__(self, block: Block, opener: Opener, is_realtime: bool) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._block = block
        try:
            self._opener = ForkingPickler.dumps(opener)
        except (AttributeError, TypeError, ImportError, PickleError) as error:  # of a local function, say
            raise InvalidArgument(
                "opener", f"{opener!r} ({error})", "a callable that can be pickled"
            ) from error
        self.report: dict[str, str] = {}
        self.error: TouchfieldError | None = None
        self.is_ready = self.is_done = self.is_lost = self._is_joined = False
        self._ticks, self._ticked_s = -1, time.monotonic()
        self._silent_s = max(_SILENT_S, 3 / float(block.memory.f8[W.RATE_HZ]))
        self._process = context.Process(
            target=_main, args=(str(block.path), is_realtime, theirs), name="touchfield-servo", daemon=True
        )
        try:
            self._process.start()
        finally:
            theirs.close()

    @property
    def pid(self) -> int | None:
        """Of the process; None once it has ended."""
        return None if self._is_joined else self._process.pid

    def notice(self, ticks: int, has_released: bool) -> None:
        """End the process of a device that hangs: no tick has come since long ago, and the force is not at
        zero.
        """
        now_s = time.monotonic()
        is_over = self._is_joined or self.error or self.is_done or not self._process.is_alive()
        if ticks != self._ticks or has_released or is_over:
            self._ticks, self._ticked_s = ticks, now_s
            return
        silent_s = now_s - self._ticked_s
        if silent_s < self._silent_s or (
            silent_s < _MOST_STARVED_S and self.pid and not is_waiting(self.pid)
        ):
            return
        self.error = DeviceError(
            "device", f"no answer for {1e3 * silent_s:.0f} ms", "a position at each tick", "Plug it in again."
        )
        self.is_lost = True
        self._process.kill()

    def listen(self) -> None:
        """Take what it told since; never waits."""
        if self._is_joined:
            return
        is_alive = self._process.is_alive()  # asked first: the words of one that is not are all there
        with contextlib.suppress(EOFError, OSError):
            while self._pipe.poll():
                kind, content = self._pipe.recv()
                if kind == "attached":
                    # not as an argument: `start` would wait for ever to hand a long one to a process that is
                    # gone
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
            self.is_lost = self.is_ready
            self.error = DeviceError(
                "servo process",
                f"its end with exit code {self._process.exitcode}",
                "a process that runs until it is told to stop",
                ""
                if self.is_ready
                else 'Begin the player under `if __name__ == "__main__":` of your program.',
            )

    def wait_ready(self) -> None:
        """Wait until the device is open; raises what it could not be opened for."""
        ends = time.monotonic() + _BEGIN_S
        while not self.is_ready:
            self.listen()
            if self.error is not None:
                raise self.error
            if self.is_done:
                return
            if time.monotonic() > ends:
                raise DeviceError("servo process", f"no sign for {_BEGIN_S:g} s", "an open device")
            time.sleep(0.002)

    def join(self, ramp_s: float) -> None:
        """Wait for its end, after it was told to stop; one that does not end is terminated, then killed."""
        process = self._process
        process.join(ramp_s)
        for end, seconds in ((process.terminate, _TERMINATE_S), (process.kill, _KILL_S)):
            if process.is_alive():
                end()
                process.join(seconds)
        self.listen()
        self._is_joined = True
        self._pipe.close()
        if not process.is_alive():
            process.close()
