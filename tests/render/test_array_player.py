"""The player of arrays: in time, linear between frames, and off at any end."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.devices import device
from touchfield.errors import DeviceError, InvalidArgument, SourceError
from touchfield.render.array_player import MAX_LOOKAHEAD_FRAMES, ArrayDevice, ArrayPlayer, DrivePrefetcher

VEST = replace(device("tactsuit-x40"), lattice=(2, 3, 1), panels=2)
SHAPE = (2, 3, 2)


class Recorder(ArrayDevice):
    """Records its drives; fails after a given number of frames, or is slow."""

    def __init__(
        self, gone_after: int | None = None, error: Exception | None = None, slow_s: float = 0.0
    ) -> None:
        self.profile = VEST
        self.gone_after, self.slow_s = gone_after, slow_s
        self.error = error or DeviceError("recorder", "that it is gone")
        self.sent_drives: list[np.ndarray] = []
        self.frequencies: list[np.ndarray | None] = []
        self.opened = self.closed = 0

    def open(self) -> None:
        self.opened += 1
        if self.gone_after == -1:
            raise self.error

    def put_drives(self, drives: np.ndarray, frequencies_hz: np.ndarray | None, seconds: float) -> None:
        assert self.opened and not self.closed
        assert drives.dtype == np.float32 and drives.shape == SHAPE and 0 < seconds <= 10
        if self.gone_after is not None and len(self.sent_drives) >= self.gone_after:
            raise self.error
        time.sleep(self.slow_s)
        self.sent_drives.append(drives.copy())
        self.frequencies.append(frequencies_hz)

    def close(self) -> None:
        self.closed += 1


class Frames:
    """Frames computed by a function of their number."""

    def __init__(self, make: Callable[[int], object], count: int, rate_hz: float = 100.0) -> None:
        self.make, self.frame_count, self.rate_hz = make, count, rate_hz
        self.requested_frames: list[int] = []

    def drives(self, frame: int) -> np.ndarray:
        self.requested_frames.append(frame)
        levels = self.make(frame)
        if isinstance(levels, Exception):
            raise levels
        return np.broadcast_to(np.asarray(levels, np.float32), SHAPE)

    def frequencies(self, frame: int) -> np.ndarray | None:
        return None


def played(frames: Frames, recorder: Recorder, **options: object) -> tuple[list[float], ArrayPlayer]:
    """The first drive of each frame that was sent."""
    with ArrayPlayer(frames, recorder, **options) as player:
        assert player.wait(20.0)
    assert recorder.closed and not recorder.sent_drives[-1].any()
    return [float(drives[0, 0, 0]) for drives in recorder.sent_drives], player


def test_frames_are_played_in_order_and_end_all_off() -> None:
    levels, player = played(Frames(lambda i: (i + 1) / 10, 5), recorder := Recorder(), rate_hz=100)
    assert recorder.opened == recorder.closed == 1
    steps, statistics = [s for s in levels if s], player.statistics()
    assert steps == sorted(set(steps)) and set(steps) <= {float(np.float32(n / 10)) for n in range(1, 6)}
    assert len(steps) == statistics["sent"] - statistics["stalled"] == len(levels) - 1 - statistics["stalled"]
    assert len(steps) + statistics["skipped"] >= 5 and statistics["mean_rate_hz"] > 0
    assert len(player.notes) == (statistics["stalled"] > 0)


def test_the_mean_rate_is_that_of_the_intervals_between_frames() -> None:
    player = ArrayPlayer(Frames(lambda i: 0.5, 5), Recorder())
    assert player.statistics()["mean_rate_hz"] == 0
    player._counts["sent"], player._span_s = 11, 2.0
    assert player.statistics()["mean_rate_hz"] == 5.0


def drives_at(
    levels: list[float], positions: list[float], start: float = 0.0, **options: bool
) -> list[float]:
    """Drives at positions after `start`, of a player of 50 Hz that takes a quarter of a frame each time."""
    frames = Frames(lambda i: levels[i], len(levels))
    loop, is_blended = options.get("loop", False), options.get("is_blended", True)
    prefetcher = DrivePrefetcher(frames, SHAPE, start, 0.25, 50, loop, is_blended)
    prefetcher.thread.start()
    found = []
    for position in positions:
        prefetcher.wait_for(start + position)
        if loop:  # the frame after the last one is used if it is there
            prefetcher.wait_for(start + np.floor(position) + 1.0)
        sample = prefetcher.at(start + position)
        assert sample is not None and sample[1] is None and np.ptp(sample[0]) == 0
        found.append(float(sample[0].flat[0]))
    prefetcher.stop()
    prefetcher.thread.join(5.0)
    return found


def test_drives_are_linear_between_frames_and_the_last_one_stays() -> None:
    positions = [0.0, 0.25, 0.75, 1.0, 1.5, 2.0, 2.75]
    assert drives_at([0.0, 1.0, 0.5], positions) == [0.0, 0.25, 0.75, 1.0, 0.75, 0.5, 0.5]


@pytest.mark.parametrize("round_of_loop", [1, 2, 7])
def test_a_loop_that_goes_on_is_interpolated(round_of_loop: int) -> None:
    turn = [0.5 + 0.5 * float(np.sin(2 * np.pi * n / 24)) for n in range(24)]
    positions = [float(n) for n in range(23)] + [23.5, 24.0]
    found = drives_at(turn, positions, 24.0 * round_of_loop, loop=True)
    assert found == pytest.approx([*turn[:23], (turn[23] + turn[0]) / 2, turn[0]], abs=1e-6)


def test_a_loop_that_jumps_fades_from_its_last_frame() -> None:
    """A fade of 0.1 s is one and a quarter frames of the medium here."""
    levels = [0.0, 0.0, 0.0, 0.9, 1.0]
    positions = [0.25 * n for n in range(2 * len(levels) * 4)]
    stepped = drives_at(levels, positions, loop=True, is_blended=False)
    faded = drives_at(levels, positions, loop=True)
    end = len(levels) * 4
    assert stepped[end - 4 : end + 1] == pytest.approx([1.0] * 4 + [0.0])
    weights = 0.5 + 0.5 * np.cos(np.pi * np.arange(6) / 5)
    assert faded[end - 4 : end] == stepped[end - 4 : end]
    assert faded[end : end + 6] == pytest.approx(weights, abs=1e-6)
    assert faded[:end] == stepped[:end] and faded[end + 6 :] == stepped[end + 6 :]


def test_a_fade_takes_half_of_a_short_loop_and_keeps_its_frequencies() -> None:
    class Vibrating(Frames):
        def frequencies(self, frame: int) -> np.ndarray:
            return np.full(SHAPE, [0.0, 0.0, 150.0][frame], np.float32)

    prefetcher = DrivePrefetcher(Vibrating(lambda i: [0.0, 0.9, 1.0][i], 3), SHAPE, 0.0, 1.0, 500, True)
    prefetcher.thread.start()
    for position, drive, frequency_hz in ((2.0, 1.0, 150.0), (3.75, 0.8375, 150.0), (4.5, 0.95, 150.0)):
        prefetcher.wait_for(position)
        sample = prefetcher.at(position)
        assert sample is not None and sample[1] is not None
        assert sample[0].flat[0] == pytest.approx(drive, abs=1e-6)
        assert (sample[1] == frequency_hz).all()
    prefetcher.stop()
    prefetcher.thread.join(5.0)


def test_frequencies_are_those_of_the_nearest_vibrating_frame() -> None:
    class Vibrating(Frames):
        def frequencies(self, frame: int) -> np.ndarray:
            return np.broadcast_to(np.array([[100.0, 0.0], [200.0, 150.0]][frame], np.float32), SHAPE)

    prefetcher = DrivePrefetcher(Vibrating(lambda i: 0.5, 2), SHAPE, 0.0, 0.25, 50, False)
    prefetcher.thread.start()
    prefetcher.wait_for(0.25)
    for position, expected in ((0.0, [100, 0]), (0.25, [100, 150]), (0.75, [200, 150])):
        sample = prefetcher.at(position)
        assert sample is not None and sample[1] is not None and (sample[1][0, 0] == expected).all()
    prefetcher.stop()
    prefetcher.thread.join(5.0)


def test_the_number_of_frames_is_that_of_the_duration() -> None:
    """Steps of 0.6 frames, which have no exact sum."""
    _, player = played(Frames(lambda i: 0.5, 60, 300.0), Recorder(), rate_hz=500)
    statistics = player.statistics()
    assert (
        statistics["sent"] - statistics["stalled"] + statistics["skipped"] >= 100
        and statistics["sent"] - statistics["stalled"] <= 100
    )


def test_usual_rates() -> None:
    recorder = Recorder()
    for stated, rate in ((20.0, 20.0), (None, 50.0), (1000.0, 100.0)):
        recorder.profile = replace(VEST, rate_hz=stated)
        assert ArrayPlayer(Frames(lambda i: 0.0, 1), recorder).rate_hz == rate


def test_speed_start_and_loop() -> None:
    levels, _ = played(
        Frames(lambda i: i / 100, 100, 1000.0), Recorder(), rate_hz=100, speed=2.0, start_s=0.02
    )
    steps = [s for s in levels if s]
    assert steps[0] == np.float32(0.2) and len(steps) <= 4
    assert all(b - a > 0.19 for a, b in zip(steps, steps[1:]))  # 20 frames of the medium to one of the player
    recorder, frames = Recorder(), Frames(lambda i: (i + 1) / 10, 3)
    with ArrayPlayer(frames, recorder, rate_hz=200, loop=True) as player:
        while len(recorder.sent_drives) < 25:
            assert not player.wait(0.005)
    assert len({float(s[0, 0, 0]) for s in recorder.sent_drives}) >= 3 and not recorder.sent_drives[-1].any()
    assert set(frames.requested_frames) == {0, 1, 2} and len(frames.requested_frames) > 3


def test_skipped_frames_of_a_fast_medium_are_not_decoded() -> None:
    frames = Frames(lambda i: 0.5, 100000, 10000.0)
    _, player = played(frames, Recorder(), rate_hz=100, start_s=9.7, speed=1.0)
    assert len(frames.requested_frames) < 100 and player.statistics()["stalled"] < 20


def test_the_lookahead_is_bounded() -> None:
    frames = Frames(lambda i: 0.5, 1 << 30, 1e6)
    prefetcher = DrivePrefetcher(frames, SHAPE, 0.0, 0.5, 2000.0, True)
    prefetcher.thread.start()
    prefetcher.wait_for(200.0)
    time.sleep(0.05)
    assert (
        len(frames.requested_frames) <= MAX_LOOKAHEAD_FRAMES
        and len(prefetcher._buffer) <= MAX_LOOKAHEAD_FRAMES
    )
    prefetcher.stop()
    prefetcher.thread.join(5.0)


def test_a_stall_turns_all_off_and_skips_nothing() -> None:
    released = threading.Event()

    def make(frame: int) -> float:
        if frame == 2:
            assert released.wait(20)
        return (frame + 1) / 10

    recorder = Recorder()
    with ArrayPlayer(Frames(make, 4), recorder, rate_hz=200) as player:
        while player.statistics()["stalled"] < 3:
            assert not player.wait(0.005)
        assert not recorder.sent_drives[-1].any()
        released.set()
        assert player.wait(20)
    (note,) = player.notes
    assert "Frames are not ready in time: the actuators are off until they are." in note
    assert (
        max(float(drives.max()) for drives in recorder.sent_drives) == pytest.approx(0.4)
        and not recorder.sent_drives[-1].any()
    )


@pytest.mark.parametrize("loop", [False, True])
def test_a_single_frame_is_played_until_the_end_and_decoded_once(loop: bool) -> None:
    frames, recorder = Frames(lambda i: 0.5, 1), Recorder()
    with ArrayPlayer(frames, recorder, rate_hz=200, loop=loop) as player:
        while len(recorder.sent_drives) < 40:
            assert not player.wait(0.005)  # a frame of 100 Hz lasts for two of these
    assert frames.requested_frames == [0] and player.statistics()["stalled"] == 0
    assert (
        all((drives == np.float32(0.5)).all() for drives in recorder.sent_drives[:-1])
        and not recorder.sent_drives[-1].any()
    )


def test_preparation_is_distinguished_from_play() -> None:
    released = threading.Event()
    frames = Frames(lambda i: 0.5 if released.wait(20) else 0.0, 1)
    with ArrayPlayer(frames, Recorder(), rate_hz=200) as player:
        assert not player.wait_started(0.05)
        released.set()
        assert player.wait_started(20)
    with (
        pytest.raises(SourceError),
        ArrayPlayer(Frames(lambda i: SourceError("a", "b"), 1), Recorder()) as player,
    ):
        assert player.wait_started(20) and player.wait(20)


def test_a_close_waits_for_the_frame_that_is_being_decoded() -> None:
    begun = threading.Event()

    def make(frame: int) -> float:
        begun.set()
        time.sleep(0.1)
        return 0.5

    with ArrayPlayer(Frames(make, 1), Recorder()):
        assert begun.wait(20)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("touchfield-array")]


def test_start_raises_the_error_of_a_missing_device() -> None:
    recorder = Recorder(gone_after=-1)
    player = ArrayPlayer(Frames(lambda i: 1.0, 5), recorder)
    with pytest.raises(DeviceError, match="gone"):
        player.start()
    player.close()
    assert recorder.closed == 1 and not recorder.sent_drives
    with pytest.raises(InvalidArgument, match="started before"):
        player.start()


def test_a_slow_device_gets_fewer_frames_in_the_same_time() -> None:
    began = time.monotonic()
    levels, player = played(Frames(lambda i: 0.5, 30, 100.0), Recorder(slow_s=0.03), rate_hz=200)
    statistics = player.statistics()
    assert len(levels) < 20 and statistics["skipped"] >= 30 and time.monotonic() - began >= 0.25


def test_frames_of_another_shape_or_with_bad_numbers_are_errors() -> None:
    class Wrong(Frames):
        def drives(self, frame: int) -> np.ndarray:
            return np.zeros((1, 3, 2), np.float32)

    with (
        ArrayPlayer(Wrong(lambda i: 0, 3), Recorder()) as player,
        pytest.raises(InvalidArgument, match="frame 0"),
    ):
        player.wait(20)
    for options in (
        {"rate_hz": 0.0},
        {"rate_hz": float("nan")},
        {"speed": -1.0},
        {"start_s": 9.0},
        {"start_s": -1.0},
    ):
        with pytest.raises(InvalidArgument, match=next(iter(options))):
            ArrayPlayer(Frames(lambda i: 0.0, 3), Recorder(), **options)


FORGOTTEN = """
import time
from dataclasses import replace
import numpy as np
from touchfield.devices import device
from touchfield.render.array_player import ArrayDevice
from touchfield.render.array_player import ArrayPlayer

class Told(ArrayDevice):
    profile = replace(device("tactile-vest-8x8"), lattice=(1, 1, 1))
    def open(self): pass
    def put_drives(self, drives, frequencies_hz, seconds): print(drives.max(), flush=True)
    def close(self): print("closed", flush=True)

class Frames:
    frame_count, rate_hz = 1000, 10.0
    def drives(self, frame): return np.ones((1, 1, 1), np.float32)
    def frequencies(self, frame): return None

player = ArrayPlayer(Frames(), Told())
player.start()
while not player.statistics()["sent"]:
    time.sleep(0.01)
"""


def test_a_program_that_ends_without_close_leaves_no_actuator_on() -> None:
    done = subprocess.run(
        [sys.executable, "-c", FORGOTTEN], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split()[0] == "1.0" and done.stdout.split()[-2:] == ["0.0", "closed"]


ODD = st.one_of(st.floats(width=32), st.floats(-0.5, 1.5, width=32))


@given(
    drives=st.lists(ODD, min_size=1, max_size=6),
    broken=st.none() | st.integers(0, 5),
    gone_after=st.none() | st.integers(0, 6),
    close_after_s=st.none() | st.floats(0.0, 0.01),
    slow=st.booleans(),
    loop=st.booleans(),
)
def test_drives_are_always_bounded_and_end_off(
    drives: list[float],
    broken: int | None,
    gone_after: int | None,
    close_after_s: float | None,
    slow: bool,
    loop: bool,
) -> None:
    def make(frame: int) -> object:
        if slow and frame % 2:
            time.sleep(0.004)  # a feed that stalls
        return SourceError("frame", "damage") if frame == broken else drives[frame]

    recorder = Recorder(gone_after, slow_s=0.002 if slow else 0.0)
    player = ArrayPlayer(Frames(make, len(drives), 500.0), recorder, rate_hz=500, loop=loop)
    player.start()
    will_end = (
        not (loop or len(drives) == 1)
        or gone_after is not None
        or (broken is not None and broken < len(drives))
    )
    if close_after_s is None and will_end:
        with_error = gone_after is not None or broken is not None
        try:
            assert player.wait(20)
        except (DeviceError, SourceError):
            assert with_error
    elif close_after_s is not None:
        time.sleep(close_after_s)
    player.close()
    player.close()
    assert recorder.closed == 1
    assert all(
        np.isfinite(levels).all() and levels.min() >= 0 and levels.max() <= 1
        for levels in recorder.sent_drives
    )
    if gone_after is None or len(recorder.sent_drives) < gone_after:
        assert recorder.sent_drives and not recorder.sent_drives[-1].any()
