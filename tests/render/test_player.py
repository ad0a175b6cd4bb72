"""The player with its process: orders, the end, and no leftovers after any end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from player_makers import (
    GRID,
    OMNI,
    Absent,
    Failing,
    Hung,
    Noted,
    RestingDevice,
    Simulated,
    numbered_field,
    numbered_medium,
)

from touchfield.errors import CorruptFile, DeviceError, InvalidArgument
from touchfield.medium import ForceField, HapticObject, HapticScene, PoseTrack
from touchfield.render.block import FLAGS, PREFIX, aligned, shared_folder
from touchfield.render.feeder import FrameSource
from touchfield.render.player import Player
from touchfield.render.servo import zero_by_reconnecting


@pytest.fixture(autouse=True)
def no_leftovers() -> object:
    """No block in shared memory and no process after each test."""
    before = set(shared_folder().glob(PREFIX + "*"))
    yield
    assert set(shared_folder().glob(PREFIX + "*")) <= before
    if os.path.exists("/proc"):
        assert not _children()


def _children() -> list[str]:
    """Processes started by this one that serve a device."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((path / "stat").read_text().rsplit(")", 1)[1].split()[1])
            command = (path / "cmdline").read_text()
        except (OSError, ValueError, IndexError):
            continue
        if parent == os.getpid() and "spawn_main" in command:
            found.append(command)
    return found


def test_a_medium_is_played_to_its_end_and_again() -> None:
    with Player(numbered_medium(10), OMNI, RestingDevice, start_s=0.1) as player:
        assert (
            not player.wait(0.05)
            and player.media_s == pytest.approx(0.1)
            and not player.log()["force_n"].any()
        )
        player.play()
        assert player.wait(30) and player.is_ended and player.error is None
        assert player.media_s == pytest.approx(0.2)
        for wrong in (None, "0", -1.0, float("nan")):
            with pytest.raises(InvalidArgument, match="time"):
                player.seek(wrong)  # type: ignore[arg-type]
            with pytest.raises(InvalidArgument, match="speed"):
                player.set_speed(wrong)  # type: ignore[arg-type]
        player.seek(0.0)
        player.set_speed(0.5)
        assert player.wait(30)
        player.pause()
        player.seek(0.0)
        assert not player.wait(0.2) and player.media_s == 0.0
    log, counts = player.log(), player.statistics()
    assert (
        counts["ticks"] == len(log) + counts["log_rows_lost"]
        and counts["underruns"] == 0
        and counts["frames_used"] >= 15
    )
    assert log["force_n"][:, 2].max() == pytest.approx(0.5 + 9 / 64, abs=1e-6)
    assert not log["force_n"][-1].any() and log["flags"][-1] & FLAGS["stopping"]
    assert np.linalg.norm(log["force_n"], axis=1).max() <= 4.0
    assert counts["priority"] and counts["memory"] and counts["processors"] and counts["decode_median_s"] > 0
    player.close()  # a second call does nothing
    assert player.is_ended
    assert not [
        thread
        for thread in threading.enumerate()
        if thread.name in ("touchfield-feeder", "touchfield-player")
    ]
    assert player.servo_pid is None
    for use in (player.play, player.pause, player.__enter__):
        with pytest.raises(InvalidArgument, match="player"):
            use()


def test_a_failing_device_is_an_error_and_its_force_goes_to_zero() -> None:
    with Player(numbered_medium(1), OMNI, Failing) as player:
        player.play()
        with pytest.raises(
            DeviceError, match=r"fake device: found no answer; expected a position. Plug it in."
        ):
            player.wait(30)
    assert isinstance(player.error, DeviceError)
    log = player.log()
    assert not log["force_n"][-1].any() and log["flags"][-1] & FLAGS["stopping"]


def slow(frame: int) -> ForceField:
    """Takes ten times the duration of a frame, too long even for a servo on a busy machine."""
    time.sleep(0.2)
    return numbered_field(frame)


def test_a_slow_stream_is_noted_during_play_and_keeps_time() -> None:
    medium = replace(numbered_medium(30), make_frame=slow)
    frame_bytes = aligned(FrameSource(medium).prepare(0).size_bytes)
    # capacity for some frames, so that not all are decoded while a device opens slowly
    with Player(medium, OMNI, RestingDevice, memory_bytes=6 * frame_bytes) as player:
        player.play()
        assert player.wait(60)
        assert any("left out" in note for note in player.notes)
        assert player.media_s == pytest.approx(30 / 50)
    assert player.statistics()["frames_left_out"] > 10


def test_a_missing_device_is_an_error_at_once() -> None:
    with pytest.raises(DeviceError, match="nothing on the bus"), Player(numbered_medium(1), OMNI, Absent):
        pytest.fail("there is no device")


def test_a_corrupt_segment_in_the_middle_is_an_error() -> None:
    with Player(numbered_medium(20, corrupt_from=6), OMNI, Simulated) as player:
        player.play()
        with pytest.raises(CorruptFile, match="segment 3"):
            player.wait(30)
        assert isinstance(player.error, CorruptFile)
    log = player.log()
    assert log["media_s"].max() >= 4 / 50 and not log["force_n"][-1].any()
    with pytest.raises(CorruptFile), Player(numbered_medium(20, corrupt_from=0), OMNI, Simulated):
        pytest.fail("there is no first frame")


def test_an_error_is_raised_at_the_end_even_without_the_watch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Player, "_watch", lambda player: None)
    with Player(numbered_medium(20, corrupt_from=6), OMNI, Simulated) as player:
        player.play()
        with pytest.raises(CorruptFile, match="segment 3"):
            player.wait(30)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
def test_a_killed_process_is_an_error() -> None:
    with Player(numbered_medium(1), OMNI, RestingDevice) as player:
        player.play()
        assert not player.wait(0.1)
        assert player.servo_pid is not None
        os.kill(player.servo_pid, signal.SIGKILL)
        with pytest.raises(DeviceError, match="exit code -9"):
            player.wait(30)
    assert any("set to zero through a new connection" in note for note in player.notes)


def test_a_hanging_read_is_an_error_and_zero_is_written_by_reconnecting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = tmp_path / "noted"
    monkeypatch.setenv("NOTED_FORCES", str(record))
    with Player(numbered_medium(1), OMNI, Noted) as player:
        player.play()
        with pytest.raises(DeviceError, match="no answer for"):
            player.wait(30)
    assert record.read_text().splitlines() == ["open", "force 0 0 0", "open", "force 0 0 0"]
    assert any("set to zero through a new connection" in note for note in player.notes)


def test_a_failed_reconnection_is_reported() -> None:
    assert "nothing on the bus" in zero_by_reconnecting(Absent)


def test_a_hanging_device_does_not_block_close(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchfield.render.player._JOIN_S", 0.1)
    monkeypatch.setattr("touchfield.render.servo._TERMINATE_S", 0.1)
    with Player(numbered_medium(1), OMNI, Hung) as player:
        player.play()
        with pytest.raises(DeviceError, match="no answer for"):
            player.wait(30)
    assert isinstance(player.error, DeviceError) and player.statistics()["ticks"] == 0


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
def test_a_signal_to_the_process_is_a_stop() -> None:
    with Player(numbered_medium(1), OMNI, RestingDevice, is_realtime=False) as player:
        player.play()
        assert not player.wait(0.1)
        assert player.servo_pid is not None
        os.kill(player.servo_pid, signal.SIGTERM)
        assert player.wait(30) and player.error is None
        assert player.statistics()["priority"].startswith("normal")
    assert not player.log()["force_n"][-1].any()


def test_invalid_options_are_refused_before_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InvalidArgument, match="from_frames"):
        Player(numbered_medium()[0], OMNI, RestingDevice)  # type: ignore[arg-type]
    for options in ({"memory_bytes": 0}, {"speed": -1.0}, {"start_s": float("inf")}):
        with pytest.raises(InvalidArgument):
            Player(numbered_medium(), OMNI, RestingDevice, **options)  # type: ignore[arg-type]
    with (
        pytest.raises(InvalidArgument, match="pickled"),
        Player(numbered_medium(), OMNI, lambda: RestingDevice()),
    ):
        pytest.fail("a lambda cannot be sent to another process")
    with (
        pytest.raises(InvalidArgument, match="memory_bytes"),
        Player(numbered_medium(), OMNI, RestingDevice, memory_bytes=5000),
    ):
        pytest.fail("no frame fits")
    monkeypatch.setattr(
        "touchfield.render.player.free_bytes", lambda: 5000
    )  # of which nine tenths may be used
    body = HapticScene(GRID, 50.0, (HapticObject("body", numbered_medium(1), PoseTrack.constant(2)),), 4.0)
    with pytest.raises(InvalidArgument, match=r"memory_bytes: found 0\.00 MiB of room"):
        Player(body, OMNI, RestingDevice)


ORPHAN = """
import signal
import sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job would ignore it
sys.path.insert(0, {folder!r})
from player_makers import OMNI, RestingDevice, numbered_medium
from touchfield.render.player import Player
if __name__ == "__main__":
    with Player(numbered_medium(1), OMNI, RestingDevice) as player:
        player.play()
        player.wait(0.05)
        print(player.servo_pid, flush=True)
        player.wait(60)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals are those of POSIX")
@pytest.mark.parametrize("name", ["SIGKILL", "SIGINT"])
def test_the_servo_ends_with_its_player(name: str, tmp_path: Path) -> None:
    script = tmp_path / "orphan.py"
    script.write_text(ORPHAN.format(folder=str(Path(__file__).parent)))
    with subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None and program.stderr is not None
        servo = int(program.stdout.readline())
        program.send_signal(getattr(signal, name))
        program.wait(30)
        stderr = program.stderr.read()
    assert "leaked" not in stderr and "BufferError" not in stderr
    deadline_s = time.monotonic() + 20
    while _runs(servo) and time.monotonic() < deadline_s:
        time.sleep(0.02)
    assert not _runs(servo)


UNGUARDED = """
import sys
from functools import partial
import numpy as np
sys.path.insert(0, {folder!r})
from player_makers import OMNI, numbered_medium
from touchfield.devices.drivers.simulated import SimHand
from touchfield.medium.trace import Trace
from touchfield.render.player import Player
with Player(numbered_medium(1), OMNI, partial(SimHand, Trace.regular(np.zeros((100_000, 3))))) as player:
    player.play()
"""


def test_a_program_without_a_main_guard_is_a_clear_error(tmp_path: Path) -> None:
    script = tmp_path / "unguarded.py"
    script.write_text(UNGUARDED.format(folder=str(Path(__file__).parent)))
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 1
    assert done.stderr.rstrip().endswith(
        'Start the player under `if __name__ == "__main__":` of your program.'
    )


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
