"""The standby: it brings the force of a dead servo to zero, at once and within the slew limit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest
from player_makers import OMNI, RestingDevice, laid_out, numbered_medium
from processes import no_leftovers, runs
from recorded_devices import BusyAtFirst, BusyForEver, Lasting, Record, Recorded, records

from touchfield.errors import DeviceError
from touchfield.render import servo_process, standby
from touchfield.render.player import Player
from touchfield.render.servo import CLOSED
from touchfield.render.spec import RenderSpec
from touchfield.render.standby import StandbyProcess, has_died, take_over

__all__ = ["no_leftovers"]  # a fixture of all tests here
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")

SLEW_N_PER_S = 20.0
SPEC = RenderSpec(slew_n_per_s=SLEW_N_PER_S, ramp_s=1e-3)
"""The field's 0.5 to 0.8 N take at least 25 ms to zero."""

MAX_ZERO_S = 1.0
"""Bound for a busy machine; bench/bench_servo.py measures the time."""


def wait_for_standby(player: Player) -> StandbyProcess:
    """Wait until the standby waits for the servo."""
    assert player._servo is not None
    deadline_s = time.monotonic() + 60
    while (process := player._servo.standby) is None or not process.is_ready:
        assert time.monotonic() < deadline_s
        time.sleep(0.005)
    return process


def played_until(name: str, device: type[Recorded], path: Path) -> tuple[list[Record], int, tuple[str, ...]]:
    """Play, signal the servo while a force acts, and wait for the end; returns calls, time, and notes."""
    with Player(numbered_medium(20), OMNI, partial(device, path), SPEC, loop=True) as player:
        wait_for_standby(player)
        player.play()
        assert not player.wait(0.2)
        assert player.servo_pid is not None
        signalled_ns = time.perf_counter_ns()
        os.kill(player.servo_pid, getattr(signal, name))
        with pytest.raises(DeviceError):
            player.wait(30)
    return records(path), signalled_ns, player.notes


def takeover(calls: list[Record]) -> int:
    """Index of the first call in the process of the standby."""
    return next(n for n, call in enumerate(calls) if call.pid != calls[0].pid)


@pytest.mark.parametrize("name", ["SIGKILL", "SIGSEGV", "SIGSTOP"])
def test_a_dead_or_hung_servo_is_replaced_at_once_within_the_slew_limit(name: str, tmp_path: Path) -> None:
    calls, signalled_ns, notes = played_until(name, Lasting, tmp_path / "calls")
    first = takeover(calls)
    assert {call.pid for call in calls[:first]} == {calls[0].pid}
    assert len({call.pid for call in calls[first:]}) == 1, "one process, and only after the servo's last call"
    assert [call.what for call in calls[first:]] == ["open", *["force"] * (len(calls) - first - 2), "close"]
    forces = np.array([call.force_n for call in calls if call.what == "force"])
    steps = np.linalg.norm(np.diff(forces, axis=0), axis=1)
    assert np.linalg.norm(calls[first - 1].force_n) > 0.4 and not forces[-1].any()
    # a tick may be two periods late, and the last force of the servo may not have reached the device
    assert steps.max() <= 2 * 2e-3 * SLEW_N_PER_S * (1 + 1e-9)
    falling = np.array([call.force_n for call in calls[first:] if call.what == "force"])
    assert len(falling) > 10 and (np.diff(np.linalg.norm(falling, axis=1)) < 0).all()
    assert calls[-2].time_ns - signalled_ns < 1e9 * MAX_ZERO_S
    assert any("set to zero through a new connection" in note for note in notes)
    assert not any("standby" in note for note in notes)


def test_a_force_that_opening_sets_to_zero_does_not_come_back(tmp_path: Path) -> None:
    calls, signalled_ns, notes = played_until("SIGKILL", Recorded, tmp_path / "calls")
    first = takeover(calls)
    after = calls[first:]
    assert any(calls[first - 1].force_n)
    assert [(call.what, call.force_n) for call in after] == [
        ("open", ()),
        ("force", (0.0, 0.0, 0.0)),
        ("close", ()),
    ]
    assert after[1].time_ns - signalled_ns < 1e9 * MAX_ZERO_S
    assert any("set to zero through a new connection" in note for note in notes)


def test_a_device_that_is_released_late_is_opened_once_it_is_free(tmp_path: Path) -> None:
    calls, _, notes = played_until("SIGKILL", BusyAtFirst, tmp_path / "calls")
    after = [call.what for call in calls[takeover(calls) :]]
    assert after[:6] == ["refused"] * 5 + ["open"] and calls[-2].force_n == (0.0, 0.0, 0.0)
    assert any("set to zero through a new connection" in note for note in notes)


def test_a_device_that_cannot_be_opened_twice_is_reported(tmp_path: Path) -> None:
    calls, _, notes = played_until("SIGKILL", BusyForEver, tmp_path / "calls")
    assert {call.what for call in calls[takeover(calls) :]} == {"refused"}
    assert any("failed (DeviceError: fake device: found it is in use" in note for note in notes)
    assert any(note.endswith("switch the device off") for note in notes)


@pytest.mark.parametrize("name", ["stop", "SIGTERM"])
def test_a_servo_that_ends_by_itself_is_not_replaced(name: str, tmp_path: Path) -> None:
    path = tmp_path / "calls"
    with Player(numbered_medium(20), OMNI, partial(Lasting, path), SPEC, loop=True) as player:
        process = wait_for_standby(player)
        player.play()
        assert not player.wait(0.2)
        if name == "SIGTERM":
            for pid in (process.pid, player.servo_pid):
                assert pid is not None
                os.kill(pid, signal.SIGTERM)
            assert player.wait(30)
    calls = records(path)
    assert {call.pid for call in calls} == {calls[0].pid} and calls[-1].what == "close"
    assert process.answer is None and not player._servo.notes  # type: ignore[union-attr]
    assert process.pid is not None and not runs(process.pid)


def test_a_lost_standby_is_replaced_and_reported(tmp_path: Path) -> None:
    path = tmp_path / "calls"
    with Player(numbered_medium(20), OMNI, partial(Lasting, path), SPEC, loop=True) as player:
        first = wait_for_standby(player)
        player.play()
        assert not player.wait(0.2) and first.pid is not None and player.servo_pid is not None
        os.kill(first.pid, signal.SIGKILL)
        while player._servo.standby is first:  # type: ignore[union-attr]
            assert not player.wait(0.01), "the servo goes on"
        second = wait_for_standby(player)
        assert second.pid != first.pid and not runs(first.pid)
        (note,) = [note for note in player.notes if "standby" in note]
        assert note == "A standby of the servo was lost (exit code -9), and another one was started"
        os.kill(player.servo_pid, signal.SIGKILL)
        with pytest.raises(DeviceError, match="exit code -9"):
            player.wait(30)
    calls = records(path)
    after = calls[takeover(calls) :]
    assert {call.pid for call in after} == {second.pid} and len(after) > 10
    assert not any(after[-2].force_n) and after[-1].what == "close"
    assert any("set to zero through a new connection" in note for note in player.notes)


def test_standbys_that_end_one_after_the_other_are_not_started_for_ever(tmp_path: Path) -> None:
    path = tmp_path / "calls"
    with Player(numbered_medium(20), OMNI, partial(Lasting, path), SPEC, loop=True) as player:
        pids = []
        for _ in range(3):
            process = wait_for_standby(player)
            assert process.pid is not None
            pids.append(process.pid)
            os.kill(process.pid, signal.SIGKILL)
            while process.is_ready and not process.loss:
                time.sleep(0.01)
            player._update()
        assert len(set(pids)) == 3 and player._servo.standby is process  # type: ignore[union-attr]
        notes = [note for note in player.notes if "standby" in note]
        assert len(notes) == 3 and notes[-1].startswith("The standby of the servo is lost (exit code -9)")


def test_without_its_standby_a_servo_goes_on_and_a_new_process_sets_zero(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(servo_process, "_MAX_STANDBYS", 1)
    path = tmp_path / "calls"
    with Player(numbered_medium(20), OMNI, partial(Lasting, path), SPEC, loop=True) as player:
        process = wait_for_standby(player)
        player.play()
        assert not player.wait(0.2) and process.pid is not None and player.servo_pid is not None
        os.kill(process.pid, signal.SIGKILL)
        assert not player.wait(0.2)
        assert any("standby of the servo is lost (exit code -9)" in note for note in player.notes)
        os.kill(player.servo_pid, signal.SIGKILL)
        with pytest.raises(DeviceError, match="exit code -9"):
            player.wait(30)
    calls = records(path)
    assert [call.what for call in calls[takeover(calls) :]] == ["open", "force", "close"]
    assert calls[-2].force_n == (0.0, 0.0, 0.0)
    assert any("set to zero through a new connection" in note for note in player.notes)


PROGRAM = """
import sys
sys.path.insert(0, {folder!r})
from functools import partial
from pathlib import Path
from test_standby import OMNI, SPEC, Lasting, Player, numbered_medium, wait_for_standby
if __name__ == "__main__":
    with Player(numbered_medium(20), OMNI, partial(Lasting, Path({path!r})), SPEC, loop=True) as player:
        process = wait_for_standby(player)
        player.play()
        player.wait(0.2)
        print(player.servo_pid, process.pid, flush=True)
        player.wait(60)
"""


def test_the_force_of_a_player_and_servo_that_die_together_goes_to_zero(tmp_path: Path) -> None:
    path, script = tmp_path / "calls", tmp_path / "program.py"
    script.write_text(PROGRAM.format(folder=str(Path(__file__).parent), path=str(path)))
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        servo_pid, standby_pid = map(int, program.stdout.readline().split())
        os.kill(servo_pid, signal.SIGSTOP)  # it cannot stop by itself
        program.kill()
        killed_ns = time.perf_counter_ns()
        os.kill(servo_pid, signal.SIGKILL)
        program.wait(30)
    deadline_s = time.monotonic() + 20
    while (runs(servo_pid) or runs(standby_pid)) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert not runs(servo_pid) and not runs(standby_pid)
    calls = records(path)
    assert calls[0].pid == servo_pid and calls[-1].pid == standby_pid
    assert [call.what for call in calls[-2:]] == ["force", "close"]
    assert calls[-2].force_n == (0.0, 0.0, 0.0) and calls[-2].time_ns - killed_ns < 1e9 * MAX_ZERO_S


# -- in this process ---------------------------------------------------------------------------------------


@pytest.fixture
def sleeper() -> object:
    """A process in place of the servo's, and both ends of its lifeline."""
    reader, writer = Pipe(duplex=False)
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
        yield process, reader, writer
        process.kill()
    for end in (reader, writer):
        end.close()


@pytest.mark.parametrize("has_pidfd", [True, False])
def test_only_a_servo_that_has_not_closed_its_device_has_died(
    sleeper: tuple, has_pidfd: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not has_pidfd:
        monkeypatch.delattr("os.pidfd_open", raising=False)
    process, lifeline, servo_end = sleeper
    pipe, player_end = Pipe()
    servo_end.send_bytes(CLOSED)
    assert not has_died(process.pid, lifeline, pipe, 1.0)
    process.kill()
    servo_end.close()
    assert has_died(process.pid, lifeline, pipe, 1.0)
    player_end.close()


def test_a_servo_that_outlives_its_player_is_killed(sleeper: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standby, "_ORPHAN_S", 0.1)
    process, lifeline, _ = sleeper
    pipe, player_end = Pipe()
    player_end.close()
    assert has_died(process.pid, lifeline, pipe, 0.1) and process.wait(10) == -signal.SIGKILL


class Wrench(RestingDevice):
    """Has a torque; some wrenches fail."""

    has_force_at_open = True
    fails_from = 10**9

    def __init__(self) -> None:
        super().__init__()
        self.wrenches: list[tuple[float, ...]] = []
        self.died_ns = self.opened_ns = 0

    def open(self) -> None:
        super().open()
        self.opened_ns = time.perf_counter_ns()

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        assert self.is_open and not self.closed
        self.wrenches.append((fx, fy, fz, tx, ty, tz))
        if len(self.wrenches) >= self.fails_from:
            raise OSError("a broken pipe")


class Driven(Wrench):
    """A device whose driver calls."""

    is_driven = True


def taken_over(device: Wrench, ticks: int = 1, is_released: bool = False) -> str:
    """The answer after a servo died with 0.4 N and 0.02 N m."""
    _, memory = laid_out(numbered_medium(1))
    receiver = memory.receiver
    device.died_ns = time.perf_counter_ns()
    receiver["counts"]["ticks"], receiver["counts"]["last_ns"] = ticks, device.died_ns
    receiver["clock"]["is_released"] = is_released
    receiver["state"]["gain"] = 1.0
    if ticks:
        receiver["state"]["force"]["output"][2], receiver["state"]["torque"]["output"][0] = 0.4, 0.02
    for name, slew_per_s in (("force", 20.0), ("torque", 1.0)):
        receiver["settings"][f"{name}_limits"]["peak"] = 1.0
        receiver["settings"][f"{name}_limits"]["slew_per_s"] = slew_per_s
        receiver["state"][name]["limit"] = 1.0
    return take_over(memory, Wrench, device)


@pytest.mark.parametrize(
    "is_released", [False, True]
)  # True: it died before its last force reached the device
def test_force_and_torque_of_a_dead_servo_fall_together(is_released: bool) -> None:
    device = Wrench()
    assert taken_over(device, is_released=is_released) == "" and device.closed == 1
    wrenches = np.array(device.wrenches)
    assert wrenches[0, 2] > 0.3 and wrenches[0, 3] > 0.015 and not wrenches[-1].any()
    assert (np.diff(np.abs(wrenches), axis=0) <= 0).all()
    assert len(wrenches) >= 10, "20 ms at the slew limit, by ticks of at most two periods"


def test_opening_waits_for_the_slew_limit_if_it_sets_zero() -> None:
    class Zeroed(Wrench):
        has_force_at_open = False

    device = Zeroed()
    assert taken_over(device) == "" and device.wrenches == [(0.0,) * 6]
    assert device.opened_ns - device.died_ns >= 20e6, "0.4 N at 20 N/s, and 0.02 N m at 1 N m/s"


def test_a_force_that_cannot_be_set_is_reported() -> None:
    device = Wrench()
    device.fails_from = 5
    assert taken_over(device) == "OSError: a broken pipe" and device.closed == 1


def test_a_servo_that_died_before_its_first_tick_has_no_force() -> None:
    device = Wrench()
    assert taken_over(device, ticks=0) == "" and device.wrenches == [(0.0,) * 6] and device.closed == 1


def test_closing_a_driven_device_is_enough() -> None:
    device = Driven()
    assert taken_over(device) == "" and device.is_open and not device.wrenches and device.closed == 1
