"""Guidance in real time and from recordings: devices, logs, and the warning where nothing is known."""

from __future__ import annotations

import csv
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import corridor_makers as makers
from corridor_makers import Body, cylinder
from osc_listener import Listener, listening
from touchfield.cli.main import _exit_code
from touchfield.devices import device
from touchfield.errors import DeviceError, InvalidArgument, SourceError
from touchfield.guidance import Guide, GuideSpec, Patterns
from touchfield.guidance.feed import CameraFeed, ReplayFeed
from touchfield.render.array_player import ArrayDevice
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.capture import CapturedSequence, Pictures
from touchfield.sources.options import SourceOptions
from touchfield.tasks import guide as task, guide_log
from touchfield.tasks.guide import GuideRun, guide, open_sequence
from touchfield.tasks.guide_log import columns
from touchfield.tasks.guide_output import Counts, Output, Shown

SIZE, CAMERA = makers.REDUCED, makers.kinect(makers.REDUCED)
INTRINSICS = f"{CAMERA.fx},{CAMERA.fy},{CAMERA.cx},{CAMERA.cy}"
READ = SourceOptions(depth_scale=1000.0, intrinsics=INTRINSICS, source_rate_hz=30.0, world="frames")
VEST = device("tactsuit-x40")
BODIES = [
    Body((-9.0, -0.3, -9.0), (9.0, 0.0, 9.0), "floor"),
    Body((-9.0, -0.3, 4.0), (9.0, 3.0, 4.2), "wall"),
    cylinder(0.45, 1.9, 0.2, 1.7, "person"),
]


def depth_mm(number: int) -> np.ndarray:
    """A person ahead to the right, whom the wearer approaches."""
    pose = makers.Corridor(BODIES[:1], 3.0, 1.0, 0.0, look_deg=0.0).pose(0.0)
    pose[2, 3] += 0.02 * number
    exact, _ = makers.exact_depth(BODIES, pose, CAMERA, SIZE)
    return np.rint(1000 * makers.with_noise(exact, np.random.default_rng(number))).astype(np.uint16)


def write_folder(folder: Path, frames: int = 6) -> Path:
    (folder / "depth").mkdir(parents=True)
    for n in range(frames):
        Image.fromarray(depth_mm(n)).save(folder / "depth" / f"{n:04d}.png")
    return folder


def until(condition: Callable[[], bool]) -> None:
    for _ in range(4000):
        if condition():
            return
        time.sleep(0.005)
    raise AssertionError("not in twenty seconds")


class Vest(ArrayDevice):
    """Keeps all drives."""

    title = "vest of the test"

    def __init__(self) -> None:
        self.profile, self.shown, self.is_gone = VEST, list[np.ndarray](), False

    def open(self) -> None:
        self._line = self

    def put_drives(self, drives: np.ndarray, frequencies_hz: np.ndarray | None, seconds: float) -> None:
        if self.is_gone:
            raise DeviceError(self.title, "that it is gone")
        self.shown.append(drives.copy())


def is_warning(drives: np.ndarray) -> bool:
    return bool(drives[:, (0, -1)].all() and not drives[:, 1:-1].any())


# -- recordings --------------------------------------------------------------------------------------------
def test_a_recording_gives_a_row_for_each_frame(tmp_path: Path) -> None:
    folder, log = write_folder(tmp_path / "walk"), tmp_path / "log.csv"
    figures, notes = guide(folder, GuideRun(offline=True), READ, log)
    with log.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == columns((2, 5, 4)) and len(rows) == figures["evaluated"] == 6
    assert [row["front_right_state"] for row in rows[2:]] == ["near"] * 4
    assert [row["front_left_state"] for row in rows] == ["free"] * 6
    assert float(rows[-1]["front_right_m"]) == pytest.approx(1.65, abs=0.1)
    assert float(rows[-1]["drive_0_0_2"]) > 0.25 and float(rows[-1]["drive_0_0_1"]) == 0
    assert figures["near_share"] == pytest.approx(1 / 8, abs=0.03) and not figures["has_poses"]
    assert any("no mobility aid" in note for note in notes) and any(
        "No camera poses" in note for note in notes
    )


@pytest.mark.parametrize("is_level", [True, False])
def test_a_recording_without_ground_says_that_no_steps_are_shown(tmp_path: Path, is_level: bool) -> None:
    folder = tmp_path / "walk"
    if is_level:
        write_folder(folder, 12)
    else:  # a wall that fills the picture
        (folder / "depth").mkdir(parents=True)
        for n in range(12):
            wall = np.full((SIZE[1], SIZE[0]), 1500, np.uint16)
            Image.fromarray(wall).save(folder / "depth" / f"{n:04d}.png")
    figures, notes = guide(folder, GuideRun(offline=True), READ)
    stated = [note for note in notes if "No ground was found" in note]
    assert bool(stated) == (figures["without_ground"] > 1) == (not is_level)
    assert not stated or f"in {figures['without_ground']} of 12 frames" in stated[0]


def test_poses_of_a_folder_are_used(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walk")
    (folder / "poses.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 6)
    figures, notes = guide(folder, GuideRun(offline=True), READ)
    assert figures["has_poses"] and any("remembered for 10 s" in note for note in notes)


def test_poses_that_contradict_the_depth_are_not_used(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walk", 8)
    away = [f"1 0 0 0 0 1 0 0 0 0 1 {-0.2 * n}" for n in range(8)]  # the depth comes nearer
    (folder / "poses.txt").write_text("\n".join(away) + "\n")
    figures, notes = guide(folder, GuideRun(offline=True), READ)
    assert not figures["has_poses"] and any("not used" in note for note in notes)


def test_rows_beyond_the_limit_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guide_log, "MAX_ROWS", 4)
    _, notes = guide(write_folder(tmp_path / "walk"), GuideRun(offline=True), READ, tmp_path / "log.csv")
    assert (tmp_path / "log.csv").read_text().count("\n") == 5 and any(
        "2 rows after" in note for note in notes
    )


def test_a_damaged_picture_ends_a_recording_without_a_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, log = write_folder(tmp_path / "walk"), tmp_path / "log.csv"
    damaged = folder / "depth" / "0004.png"
    damaged.write_bytes(damaged.read_bytes()[:300])
    arguments = ["guide", str(folder), "--offline", "--depth-scale", "1000", "--intrinsics", INTRINSICS]
    assert _exit_code([*arguments, "--log", str(log)]) == 1
    error = capsys.readouterr().err
    assert "0004.png" in error and error.count("\n") == 1 and not list(tmp_path.glob("*log*"))


def test_sources_and_devices_that_do_not_fit(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walk", 1)
    with pytest.raises(InvalidArgument, match="tactsuit-x16, a profile without a driver"):
        guide(folder, GuideRun(device="tactsuit-x16"), READ)
    with pytest.raises(InvalidArgument, match="pins, which show heights"):
        guide(folder, GuideRun(device="dotpad", offline=True), READ)
    with pytest.raises(InvalidArgument, match="Did you mean tactsuit-x40"):
        guide(folder, GuideRun(device="tactsuit-x4"), READ)
    (tmp_path / "shape.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(SourceError, match="no sequence of depth pictures"):
        guide(tmp_path / "shape.obj", GuideRun(offline=True), SourceOptions(unit_m=1.0))
    with pytest.raises(DeviceError, match="bHaptics Player"):
        guide(folder, GuideRun(device="bhaptics:127.0.0.1:9", wait="0s"), READ)


# -- in real time ------------------------------------------------------------------------------------------
def test_a_folder_drives_an_array_and_switches_it_off(tmp_path: Path) -> None:
    folder = write_folder(tmp_path / "walk", 12)
    rows: list[Shown] = []
    listener = Listener(VEST)
    with listening() as line:
        run = GuideRun(device=f"osc:127.0.0.1:{line.getsockname()[1]}", profile="tactsuit-x40")
        figures, _ = guide(folder, run, READ, on_shown=lambda time_s, shown: rows.append(shown))
        line.settimeout(0.5)
        with suppress(TimeoutError):
            while True:
                listener.take(line.recv(1 << 16))
    assert figures["frames"] == 12 == figures["evaluated"] + figures["dropped"]
    assert figures["delay_max_ms"] > 0 and len(listener.frames) >= figures["evaluated"]
    assert any(frame["drives"].any() for frame in listener.frames)
    assert not listener.frames[-1]["drives"].any(), "off at the end"
    assert rows[0].warning in ("no frame", "") and rows[-1].situation is not None


def posted(output: Output, number: int = 0, late_s: float = 0.0) -> None:
    situation = Guide(CAMERA, *SIZE).update(depth_mm(number).astype(np.float32) / 1000, 0.0)
    output.post(situation, number, time.monotonic() - late_s)


def test_the_warning_is_shown_until_a_frame_comes_and_after_the_last() -> None:
    vest, counts = Vest(), Counts()
    output = Output(vest, Patterns(VEST), counts, GuideSpec(timeout_s=0.5), lambda time_s, shown: None)
    output.start()
    until(lambda: any(is_warning(drives) for drives in vest.shown))
    posted(output)
    until(lambda: any(drives.any() and not is_warning(drives) for drives in vest.shown))
    count = len(vest.shown)
    until(lambda: any(is_warning(drives) for drives in vest.shown[count:]))
    until(lambda: not vest.shown[-1].any() or is_warning(vest.shown[-1]))
    output.close()
    assert counts.timeouts == 1 and counts.warning_s > 0 and not counts.late


def test_a_late_frame_is_a_warning() -> None:
    vest, counts, rows = Vest(), Counts(), list[Shown]()
    spec = GuideSpec(timeout_s=2.0)
    output = Output(vest, Patterns(VEST), counts, spec, lambda time_s, shown: rows.append(shown))
    posted(output, late_s=0.15)
    output.start()
    until(lambda: bool(rows))
    output.close()
    assert rows[0].warning == "late" and counts.late == 1 and is_warning(vest.shown[0])


def test_a_blind_frame_is_a_warning() -> None:
    vest, rows = Vest(), list[Shown]()
    output = Output(vest, Patterns(VEST), Counts(), GuideSpec(), lambda time_s, shown: rows.append(shown))
    situation = Guide(CAMERA, *SIZE).update(np.zeros(SIZE[::-1], np.float32), 0.0)
    output.post(situation, 0, time.monotonic())
    output.start()
    until(lambda: bool(rows))
    output.close()
    assert rows[0].warning in ("blind", "late") and is_warning(vest.shown[0])


def test_a_device_that_is_lost_ends_the_guidance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vest = Vest()
    vest.is_gone = True
    monkeypatch.setattr(task, "_array_of", lambda run: (VEST, vest))
    with pytest.raises(DeviceError, match="gone"):
        guide(write_folder(tmp_path / "walk", 40), GuideRun(), READ)


class Recorded(DepthSequence):
    """Pictures that are made quickly."""

    name, rate_hz, intrinsics = "recorded", 200.0, Intrinsics(130.0, 130.0, 80.0, 60.0)
    width, height = SIZE

    def __init__(self, count: int) -> None:
        self.frame_count = count

    def depth_m(self, frame: int) -> np.ndarray:
        if frame % 4 == 3:
            raise SourceError("recorded", f"a damaged picture {frame}")
        return np.full((120, 160), 1.0 + frame, np.float32)


def test_frames_that_nobody_takes_are_dropped_and_damaged_ones_counted() -> None:
    feed = ReplayFeed(Recorded(20))
    feed.start()
    until(lambda: feed.received + feed.unreadable == 20)
    frame = feed.take(0.0)
    assert frame is not None and frame.depth_m[0, 0] == 1.0 + frame.number and feed.is_over
    assert feed.received + feed.unreadable == 20 and feed.dropped == feed.received - 1
    assert feed.take(0.0) is None and feed.error is None


class Given(Pictures):
    """Pictures that a test puts, one by one."""

    name = "given"

    def __init__(self) -> None:
        self.pictures, self.changed = [depth_mm(0)], threading.Condition()

    def put(self, picture: np.ndarray) -> None:
        with self.changed:
            self.pictures.append(picture)
            self.changed.notify_all()

    def next(self) -> np.ndarray:
        with self.changed:
            self.changed.wait_for(lambda: bool(self.pictures), 20)
            return self.pictures.pop(0)


def test_a_camera_gives_each_new_picture_once_with_its_arrival() -> None:
    given = Given()
    sequence = CapturedSequence(given, READ)
    feed = CameraFeed(sequence)
    feed.start()
    assert feed.take(0.2) is None, "the first picture is from before"
    before_s = time.monotonic()
    given.put(depth_mm(1))
    frame = feed.take(20)
    assert frame is not None and before_s <= frame.arrived_s <= time.monotonic()
    assert np.array_equal(frame.depth_m, sequence.depth_m(frame.number)) and feed.take(0.05) is None
    feed.close()


def test_a_picture_of_another_size_is_not_seen() -> None:
    given = Given()
    sequence = CapturedSequence(given, READ)
    feed, vest, counts = CameraFeed(sequence), Vest(), Counts()
    output = Output(vest, Patterns(VEST), counts, GuideSpec(), lambda time_s, shown: None)
    feed.start()
    given.put(np.full((50, 70), 1000, np.uint16))
    worker = threading.Thread(
        target=task._evaluate_frames, args=(feed, Guide(CAMERA, *SIZE), output, counts, 20.0, print)
    )
    worker.start()
    until(lambda: counts.other_size == 1)
    given.put(depth_mm(2))
    until(lambda: counts.evaluated == 1)
    feed.close()
    worker.join(20)
    assert not worker.is_alive()


def test_recordings_of_public_sets(shared_data: Path) -> None:
    for name in ("rgbd_iclnuim_livingroom1", "rgbd_tum_fr1_rpy"):
        sequence = open_sequence(shared_data / name, SourceOptions(world="frames"))
        assert sequence.poses is not None
        walk = Guide(sequence.intrinsics, sequence.width, sequence.height, GuideSpec(pitch_deg=30.0))
        for n in range(4):
            situation = walk.update(sequence.depth_m(n), n / 30, sequence.poses[n])
        assert not situation.is_blind and 2 in situation.states[3:5]


def test_a_log_is_csv(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match=r"'\.mcap'; expected LOG\.csv"):
        guide(tmp_path, log=tmp_path / "log.mcap")
