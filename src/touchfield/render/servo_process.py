"""The servo's process as the player sees it: starts it and its standby, reads their messages, ends them."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from pickle import PickleError
from typing import Final

from touchfield.errors import DeviceError, InvalidArgument, TouchfieldError
from touchfield.render.block import Block
from touchfield.render.loop_delay import LoopTimes
from touchfield.render.readiness import DEFAULT_WAIT_S
from touchfield.render.servo import Opener, run_servo
from touchfield.render.standby import (
    StandbyProcess,
    lost_standby,
    open_unit,
    replaced_standby,
    zero_by_reconnecting,
    zero_report,
)

_START_S: Final = 180.0
"""Time limit for loading interpreter and code."""

_SILENT_S: Final = 0.03
"""Time without a tick after which the device of a waiting process counts as hung."""

_MAX_STARVED_S: Final = 2.0
"""The same for a runnable process, which may only lack processor time."""

_MAX_STANDBYS: Final = 3
"""Standbys of a servo, one after the other: what ends each of them would end the next one, too."""

_TERMINATE_S: Final = 3.0
_KILL_S: Final = 2.0


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
    """The servo's process as seen by its parent, and its standby.

    The block must be laid out, with the first order in it. `report` is that of `make_realtime`, once the
    process is ready; `error` is the error that ended it. `is_done` is True if it ended as ordered, and
    `is_unreleased` if it ended without bringing the force to zero. The device may take `wait_s` seconds to
    get ready; `on_note` is called with what it lacks. The standby starts once the servo has loaded its code,
    so that it does not delay the servo; if it is lost, another one starts. `loop_times` are those of the
    slowest second of the servo's loop so far; None before the first report, and for a simulated device.
    """

    def __init__(
        self,
        block: Block,
        opener: Opener,
        is_realtime: bool,
        wait_s: float = DEFAULT_WAIT_S,
        on_note: Callable[[str], None] = lambda note: None,
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, child_pipe = context.Pipe()
        self._block, self._opener, self._is_realtime = block, opener, is_realtime
        self._wait_s, self._on_note = wait_s, on_note
        try:
            self._pickled_opener = ForkingPickler.dumps(opener)
        except (AttributeError, TypeError, ImportError, PickleError) as error:  # e.g. of a local function
            raise InvalidArgument(
                "opener", f"{opener!r} ({error})", "a callable that can be pickled"
            ) from error
        self.report: dict[str, str] = {}
        self.loop_times: LoopTimes | None = None
        self._unit = ""
        self.error: TouchfieldError | None = None
        self.is_ready = self.is_done = self.is_unreleased = self._is_joined = False
        self._ticks, self._ticked_s = -1, time.monotonic()
        self._silent_s = max(_SILENT_S, 3 / float(block.memory.receiver["settings"]["rate_hz"]))
        self._standby: StandbyProcess | None = None
        self._standby_count, self._standby_error = 0, ""
        self._losses: list[str] = []  # of standbys that were replaced
        self._lifeline, child_lifeline = context.Pipe(duplex=False)
        self._process = context.Process(
            target=run_servo,
            args=(str(block.path), is_realtime, wait_s, child_pipe, child_lifeline),
            name="touchfield-servo",
            daemon=True,
        )
        try:
            self._process.start()
        finally:
            child_pipe.close()
            child_lifeline.close()

    @property
    def pid(self) -> int | None:
        """Id of the process; None once it has ended."""
        return None if self._is_joined else self._process.pid

    @property
    def standby(self) -> StandbyProcess | None:
        """The standby; None before the servo has loaded its code, or if there is none."""
        return self._standby

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user: that a standby was lost."""
        loss = self._standby.loss if self._standby is not None else self._standby_error
        return (*map(replaced_standby, self._losses), *((lost_standby(loss),) if loss else ()))

    def check_progress(self, ticks: int, has_released: bool) -> None:
        """Kill the process if its device hangs while a force is applied; the standby then takes over.

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
        """Read the messages of servo and standby; never waits."""
        self._receive_of_standby()
        if self._is_joined:
            return
        is_alive = self._process.is_alive()  # checked first: a dead process has sent all its messages
        with contextlib.suppress(EOFError, OSError):
            while self._pipe.poll():
                kind, content = self._pipe.recv()
                if kind == "attached":
                    # not passed as an argument: if the process is gone, `start` would block on a long one
                    self._pipe.send_bytes(self._pickled_opener)
                    if os.name == "posix":  # no other process opens the block by its name
                        self._block.unlink()
                    self._start_standby()
                elif kind == "ready":
                    self.is_ready, (self.report, self._unit) = True, content
                elif kind == "loop":
                    self.loop_times = content
                elif kind == "note":
                    self._on_note(content)
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

    def _start_standby(self) -> None:
        """Start the standby; without one, the servo runs all the same.

        The first one gets the unit from the servo; later ones are started with it.
        """
        assert self._process.pid is not None
        opener = self._pickled_opener
        if self._unit:
            opener = ForkingPickler.dumps(self._opener_of_unit)
        try:
            self._standby = StandbyProcess(
                self._block, opener, self._process.pid, self._is_realtime, self._lifeline
            )
        except OSError as error:
            self._standby, self._standby_error = None, str(error)
        self._standby_count += 1

    @property
    def _opener_of_unit(self) -> Opener:
        """The opener of the unit that the servo has opened, if one made anew might open another one."""
        return partial(open_unit, self._opener, self._unit) if self._unit else self._opener

    def _receive_of_standby(self) -> None:
        """Read the messages of the standby; start another one if it is lost while the servo runs."""
        if self._standby is None or self._standby.receive() or not self._standby.loss:
            return
        is_over = self._is_joined or self.is_done or self.error is not None or not self._process.is_alive()
        if not is_over and self._standby_count < _MAX_STANDBYS:
            self._losses.append(self._standby.loss)
            self._standby.join()
            self._start_standby()

    def zero_force(self) -> str:
        """Wait until the standby of a lost servo has set the force to zero; describes the outcome.

        Without a standby, a new process does it.
        """
        error = None if self._standby is None else self._standby.wait_answer()
        if error is not None:
            return zero_report(error)
        return zero_by_reconnecting(self._opener_of_unit)

    def wait_ready(self) -> None:
        """Wait until the device is open and ready; raises the error if it cannot be opened."""
        limit_s = _START_S + self._wait_s
        deadline = time.monotonic() + limit_s
        while not self.is_ready:
            self.receive()
            if self.error is not None:
                raise self.error
            if self.is_done:
                return
            if time.monotonic() > deadline:
                raise DeviceError("servo process", f"no sign for {limit_s:g} s", "an open device")
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
        self._lifeline.close()
        if not process.is_alive():
            process.close()

    def join_standby(self) -> None:
        """Wait for the end of the standby, after that of the servo."""
        if self._standby is not None:
            self._standby.join()
