"""The standby: a process that waits beside the servo, and sets the force to zero if the servo dies.

It has loaded all code, so that it opens the device within milliseconds. A servo counts as dead if it ended
without having closed the device: it was killed, it crashed, or the player killed it because the device did
not answer. The standby never opens the device while the servo's process runs.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Any, Final

from touchfield.render.block import Block, Memory
from touchfield.render.point_device import PointDevice
from touchfield.render.servo import (
    CLOSED,
    UNIT,
    DeviceLink,
    Opener,
    WallClock,
    make_realtime,
    ramp_to_zero,
    slew_s,
    warm_up,
)

_OPEN_S: Final = 1.0  # the connection of a dead process may be released late
_RETRY_S: Final = 0.005
_ORPHAN_S: Final = 5.0  # beyond the ramp: the time that a servo without a player has for its end
_ANSWER_S: Final = 5.0  # limit for opening the device and setting zero, in a new interpreter or a waiting one
_JOIN_S: Final = 2.0
_POLL_S: Final = 0.002

_SUCCESS: Final = "The force was set to zero through a new connection to the device"
_FAILURE: Final = "Setting the force to zero through a new connection failed ({}): switch the device off"


# -- in the process of the standby -------------------------------------------------------------------------


def _run_standby(
    block: Block, servo_pid: int, is_realtime: bool, pipe: Connection, lifeline: Connection
) -> None:
    """Main function of the process.

    Receives the device, warms up, waits for the end of the servo, and takes over if it died. Signals to stop
    are for the servo: the standby ends after it.
    """
    for signal_number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(signal_number, signal.SIG_IGN)
    try:
        pipe.send(("started", ""))
        opener: Opener = pipe.recv()
        device = opener()
        with contextlib.suppress(Exception):  # `open` would report it
            device.load()
        warm_up(block.memory)
        make_realtime(is_realtime)
        pipe.send(("ready", ""))
        units: list[str] = []
        ramp_limit_s = 1e-9 * float(block.memory.receiver["layout"]["ramp_limit_ns"])
        if has_died(servo_pid, lifeline, pipe, ramp_limit_s, units.append):
            for unit in units[-1:]:
                device.use_unit(unit)
                opener = partial(open_unit, opener, unit)
            answer = take_over(block.memory, opener, device)
            with contextlib.suppress(OSError):  # there is no player any more
                pipe.send(("zero", answer))
    except EOFError:  # the player is gone before anything was played
        return
    except BaseException as error:
        with contextlib.suppress(OSError):
            pipe.send(("error", f"{type(error).__name__}: {error}"))
        sys.exit(1)


def open_unit(opener: Opener, unit: str) -> PointDevice:
    """Make a device, not yet open, whose `open` opens the unit with this id; can be pickled as a partial."""
    device = opener()
    device.use_unit(unit)
    return device


def has_died(
    servo_pid: int,
    lifeline: Connection,
    pipe: Connection,
    ramp_limit_s: float,
    on_unit: Callable[[str], None] = lambda unit: None,
) -> bool:
    """Wait for the end of the servo; False if it closed the device itself.

    The other end of `lifeline` is the servo's, that of `pipe` the player's. A servo without a player stops by
    itself; it is killed if it does not. `on_unit` gets the id of the unit that the servo has opened.
    """
    process: list[Any] = []
    with contextlib.suppress(AttributeError, OSError):  # Linux only; OSError: it has ended already
        process.append(os.pidfd_open(servo_pid))
    deadline_s = math.inf  # set once the player is gone
    while True:
        has_player = math.isinf(deadline_s)
        limit_s = None if has_player else max(deadline_s - time.monotonic(), 0.0)
        ends = wait([lifeline, *process, *([pipe] if has_player else [])], limit_s)
        try:
            while lifeline.poll():
                message = lifeline.recv_bytes()
                if message == CLOSED:
                    return False
                on_unit(message.removeprefix(UNIT).decode())
        except (EOFError, OSError):
            return True
        if any(end in process for end in ends):
            return True
        if pipe in ends:
            deadline_s = time.monotonic() + ramp_limit_s + _ORPHAN_S
        elif not ends:
            with contextlib.suppress(OSError):
                os.kill(servo_pid, getattr(signal, "SIGKILL", signal.SIGTERM))
            wait([lifeline, *process])
            return True


def take_over(memory: Memory, opener: Opener, device: PointDevice) -> str:
    """Bring the force of a dead servo to zero; returns the error, or an empty text.

    Ticks go on where those of the servo ended, with a stop, if the device still has the servo's force.
    Otherwise opening it has set zero, and it stays zero. `device` is one that `opener` made.
    """
    receiver, clock = memory.receiver, WallClock()
    if not device.has_force_at_open:
        clock.sleep_until(int(receiver["counts"]["last_ns"]) + math.ceil(1e9 * slew_s(receiver)))
    try:
        device = _open_again(opener, device)
        try:
            if not device.is_driven:  # closing a driven one is enough
                _end_force(memory, device, clock)
        finally:
            device.close()
        return ""
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def _end_force(memory: Memory, device: PointDevice, clock: WallClock) -> None:
    """Bring force and torque of an open device to zero; raises the error of its last call."""
    receiver, link = memory.receiver, DeviceLink(memory, device)
    if not device.has_force_at_open:
        receiver["state"]["force"]["output"] = receiver["state"]["torque"]["output"] = 0.0
    if not receiver["counts"]["ticks"]:
        link.put((0.0, 0.0, 0.0))
        return
    receiver["clock"]["is_released"] = 0  # the last force may not have reached the device
    error = ramp_to_zero(memory, device, link, clock, (0.0, 0.0, 0.0))
    if error is not None:
        raise error


def _open_again(opener: Opener, device: PointDevice) -> PointDevice:
    """Open a device whose last user has died; raises its error if it is not free in time."""
    deadline_s = time.monotonic() + _OPEN_S
    while True:
        try:
            device.open()
            return device
        except Exception:
            device.close()
            if time.monotonic() > deadline_s:
                raise
        time.sleep(_RETRY_S)
        device = opener()


# -- in the process of the player --------------------------------------------------------------------------


class StandbyProcess:
    """The process of the standby as seen by the player's.

    `opener` is pickled. `is_ready` is True once it waits for the servo's end. `answer` is None until it has
    taken over: then an empty text, or why it failed.
    """

    def __init__(
        self, block: Block, opener: memoryview, servo_pid: int, is_realtime: bool, lifeline: Connection
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, child_pipe = context.Pipe()
        self._opener = opener
        self._lock = threading.Lock()
        self.answer: str | None = None
        self.is_ready = False
        self._error = ""
        self._process = context.Process(
            target=_run_standby,
            args=(block, servo_pid, is_realtime, child_pipe, lifeline),
            name="touchfield-standby",
            daemon=True,
        )
        try:
            self._process.start()
        finally:
            child_pipe.close()

    @property
    def pid(self) -> int | None:
        """Id of the process."""
        return self._process.pid

    @property
    def loss(self) -> str:
        """How the process was lost; an empty text if it was not."""
        code = self._process.exitcode
        return self._error or f"exit code {code}" if code and self.answer is None else ""

    def receive(self) -> bool:
        """Read the messages of the process without waiting; returns whether it runs."""
        with self._lock:
            is_alive = self._process.is_alive()  # checked first: a dead process has sent all its messages
            with contextlib.suppress(EOFError, OSError):
                while self._pipe.poll():
                    kind, text = self._pipe.recv()
                    if kind == "started":
                        self._pipe.send_bytes(self._opener)
                    elif kind == "ready":
                        self.is_ready = True
                    elif kind == "zero":
                        self.answer = text
                    else:
                        self._error = text
        return is_alive

    def wait_answer(self) -> str | None:
        """Wait until it has taken over; None if it is lost. After too long a time, it is killed."""
        deadline_s = time.monotonic() + _ANSWER_S
        while self.receive() and self.answer is None:
            if time.monotonic() > deadline_s:
                self._process.kill()
                return f"no answer within {_ANSWER_S:g} s"
            time.sleep(_POLL_S)
        return self.answer

    def join(self) -> None:
        """Wait for the end of the process after that of the servo; kill it, if needed."""
        self._process.join(_JOIN_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(_JOIN_S)
        self.receive()
        self._pipe.close()


def lost_standby(reason: str) -> str:
    """Return what the user reads if there is no standby."""
    return (
        f"The standby of the servo is lost ({reason}): if the servo dies, its force stays for about a second"
    )


def replaced_standby(reason: str) -> str:
    """Return what the user reads if another standby was started in place of a lost one."""
    return f"A standby of the servo was lost ({reason}), and another one was started"


def zero_report(error: str) -> str:
    """Return what the user reads after a force was set to zero, or not, by `error`."""
    return _FAILURE.format(error) if error else _SUCCESS


# -- without a standby -------------------------------------------------------------------------------------


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

    It runs in a new process, after servo and standby have died without releasing the device.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_write_zero, args=(opener, sender), name="touchfield-zero", daemon=True)
    try:
        process.start()
        sender.close()
        answer = receiver.recv() if receiver.poll(_ANSWER_S) else f"no answer within {_ANSWER_S:g} s"
    except (EOFError, OSError) as error:
        answer = f"{type(error).__name__}"
    finally:
        process.join(0.5)
        if process.is_alive():
            process.kill()
            process.join()
        receiver.close()
        process.close()
    return zero_report(answer)
