"""Scenes captured while they are played, and live streams through a pipe."""

from __future__ import annotations

import io
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from PIL import Image

from live_makers import medium
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.medium import Grid
from touchfield.medium.stores.npz import write_npz
from touchfield.network import live
from touchfield.network.live import LiveReceiver, LiveSegment, messages, write_message
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import CodedSequence, DepthCode
from touchfield.sources.depth import capture
from touchfield.sources.depth.capture import (
    CapturedSequence,
    CaptureEnd,
    GrowingFolder,
    PipedPictures,
    open_capture,
)
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedScene, FusedVolume
from touchfield.sources.depth.kernels.planes import SurfacePlanes
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions
from touchfield.tasks.live import LiveSpec, broadcast, open_sender
from touchfield.tasks.play import MAX_STALLED_FRACTION

OPTIONS = SourceOptions(intrinsics="60,60,31.5,23.5", depth_scale=1000.0, source_rate_hz=50.0, world="causal")


def depth_mm(number: int) -> np.ndarray:
    """A wall with a step that comes nearer."""
    picture = np.full((48, 64), 900 - 5 * number, np.uint16)
    picture[:, 32:] += 60
    return picture


def png(number: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(depth_mm(number)).save(file, "PNG")
    return file.getvalue()


def put(folder: Path, number: int) -> None:
    (folder / "being-written").write_bytes(png(number))
    os.rename(folder / "being-written", folder / f"depth{8 + number}.png")  # 8, 9, 10, ...


def until(condition: Callable[[], bool]) -> None:
    for _ in range(2000):
        if condition():
            return
        time.sleep(0.005)
    raise AssertionError("not in ten seconds")


def piped(data: bytes, options: SourceOptions = OPTIONS) -> CapturedSequence:
    return CapturedSequence(PipedPictures(io.BytesIO(data)), options)


def test_a_growing_folder_returns_the_newest_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture, "TIMEOUT_S", 60.0)  # enough for a slow machine
    put(tmp_path, 0)
    scene = open_capture(f"watch:{tmp_path}", OPTIONS)
    assert isinstance(scene, FusedScene) and scene.is_captured
    sequence = scene.sequence
    np.testing.assert_array_equal(sequence.depth_m(0), depth_mm(0) / np.float32(1000))
    np.testing.assert_array_equal(sequence.depth_m(1), sequence.depth_m(0))  # nothing is new
    put(tmp_path, 1)
    put(tmp_path, 2)
    frames = iter(range(2, 10_000))
    until(lambda: bool((sequence.depth_m(next(frames)) == depth_mm(2) / np.float32(1000)).all()))
    monkeypatch.setattr(capture, "TIMEOUT_S", 0.3)
    finished = CapturedSequence(GrowingFolder(tmp_path), OPTIONS)
    with pytest.raises(CaptureEnd, match=r"no new picture for 0\.3 s"):
        until(lambda: finished.depth_m(next(frames)) is None)


def test_a_removed_folder_ends_the_capture_at_once(tmp_path: Path) -> None:
    (tmp_path / "watched").mkdir()
    put(tmp_path / "watched", 0)
    folder = GrowingFolder(tmp_path / "watched")
    folder.next()
    shutil.rmtree(tmp_path / "watched")
    with pytest.raises(CaptureEnd, match="no folder any more"):  # not the error of a wait
        folder.next()


def test_an_unfinished_picture_is_skipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture, "TIMEOUT_S", 5.0)
    monkeypatch.setattr(capture, "_WRITE_GRACE_S", 0.05)
    (tmp_path / "depth8.png").write_bytes(png(0)[:-30])
    folder = GrowingFolder(tmp_path)
    Thread(target=lambda: (time.sleep(0.2), put(tmp_path, 1)), daemon=True).start()  # type: ignore[func-returns-value]
    np.testing.assert_array_equal(folder.next(), depth_mm(1))


def test_every_picture_of_a_pipe_is_returned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    sequence = piped(b"".join(png(i) for i in range(5)))
    for i in range(5):
        np.testing.assert_array_equal(sequence.depth_m(i), depth_mm(i) / np.float32(1000))
    np.testing.assert_array_equal(sequence.depth_m(3), depth_mm(3) / np.float32(1000))  # a second request
    with pytest.raises(CaptureEnd, match="its end"):
        sequence.depth_m(5)
    until(lambda: not list(tmp_path.iterdir()))  # no temporary file remains


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "its end"),
        (b"GIF89a and more", "PNG pictures one behind the other"),
        (png(0)[:40], "in the middle of a picture"),
        (png(0)[:8] + struct.pack(">I4s", 1 << 31, b"IDAT"), "more than 268435456 bytes"),
        (png(0)[:20] + b"\xff" + png(0)[21:], "picture"),
    ],
)
def test_data_that_are_no_picture_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        piped(data)


def test_a_picture_of_another_size_is_refused() -> None:
    file = io.BytesIO()
    Image.fromarray(depth_mm(1)[:-1]).save(file, "PNG")
    scene = DepthScene(piped(png(0) + file.getvalue()), "camera")
    grid, profile = (
        Grid.over_box((-0.4, -0.3, 0.7), (0.4, 0.3, 1.1), (8, 8, 8)),
        ForceProfile(((-0.1, 0, 0, -18.0),)),
    )
    assert scene.field(0, grid, profile).support_count
    with pytest.raises(
        SourceError, match=r"frame 1: found a picture of shape \(47, 64\); expected \(48, 64\)"
    ):
        scene.field(1, grid, profile)


def test_pictures_that_are_no_depth_are_refused(tmp_path: Path) -> None:
    file = io.BytesIO()
    Image.fromarray(np.zeros((48, 64), np.uint8)).save(file, "PNG")
    with pytest.raises(SourceError, match="16-bit"):
        piped(file.getvalue())
    with pytest.raises(SourceError, match="no camera intrinsics"):
        piped(png(0), SourceOptions(depth_scale=1000.0))
    with pytest.raises(SourceError, match="no depth scale"):
        piped(png(0), SourceOptions(intrinsics="60,60,31.5,23.5"))
    with pytest.raises(SourceError, match="no folder"):
        open_capture(f"watch:{tmp_path / 'absent'}", OPTIONS)
    for options in ({"reading": "height"}, {"segment": "step=0.1"}, {"poses": "a.txt"}):
        with pytest.raises(InvalidArgument, match="all there"):
            open_capture(f"watch:{tmp_path}", SourceOptions(**options))
    assert open_capture("room.ply", OPTIONS) is None and open_capture("sample:terrain", OPTIONS) is None


def test_causal_fusion_of_a_pipe_equals_that_of_the_stored_sequence() -> None:
    class Stored:
        frame_count, size = 6, (64, 48)

        def values(self, frame: int) -> np.ndarray:
            return depth_mm(frame)

    captured = FusedScene(piped(b"".join(png(i) for i in range(6))), "causal")
    sequence = CodedSequence("stored", Stored(), DepthCode(1000.0), captured.sequence.intrinsics, 50.0)
    stored = FusedScene(sequence, "causal")
    np.testing.assert_allclose(captured.bounds_m()[0, 2], 0.9, atol=0.01)  # of the first picture
    grid = Grid.over_box((-0.4, -0.3, 0.7), (0.4, 0.3, 1.1), (32, 32, 32))
    profile = ForceProfile(((-0.05, 0.0, 0.0, -18.0),))
    for frame in range(6):
        now = captured.field(frame, grid, profile)
        assert now == stored.field(frame, grid, profile) and now.support_count


def test_frames_that_are_left_out_take_pictures_of_a_pipe_and_are_not_fused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sequence = piped(b"".join(png(i) for i in range(6)))
    scene = FusedScene(sequence, "causal")
    views = list[float]()
    integrate = FusedVolume.integrate

    def count_view(volume: FusedVolume, surface: SurfacePlanes, pose: np.ndarray) -> None:
        views.append(float(surface.tiles[..., 0].max()))
        integrate(volume, surface, pose)

    monkeypatch.setattr(FusedVolume, "integrate", count_view)
    grid = Grid.over_box((-0.4, -0.3, 0.7), (0.4, 0.3, 1.1), (32, 32, 32))
    profile = ForceProfile(((-0.05, 0.0, 0.0, -18.0),))
    first = scene.field(0, grid, profile)
    for frame in (1, 2):
        until(lambda: bool(sequence._pending))
        scene.skip_frame(frame)
    assert scene.field(3, grid, profile) != first
    np.testing.assert_array_equal(sequence.depth_m(3), depth_mm(3) / np.float32(1000))
    assert len(views) == 2 and views[1] > views[0]


def test_a_capture_is_broadcast_until_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = io.BytesIO(b"".join(png(i) for i in range(12)))
    monkeypatch.setattr(capture, "standard_input", lambda: data)
    prepared, _ = open_sender("-", EncodeSpec(nw=4, source=OPTIONS))
    assert any("in the first picture" in note for note in prepared.notes)
    now, sent, notes = [0.0], list[LiveSegment](), list[str]()
    statistics = broadcast(
        prepared, lambda segment: sent.append(segment), LiveSpec(1.0), notes.append, lambda: now[0],
        lambda seconds: now.__setitem__(0, now[0] + seconds),
    )  # fmt: skip
    assert statistics.frames == 12 and statistics.left_out == 0
    assert [(sent_segment.first_frame, sent_segment.frame_count) for sent_segment in sent] == [(0, 12)]
    assert notes == ["standard input: its end"]


def test_opencv_reads_a_sequence_of_pictures(tmp_path: Path) -> None:
    pytest.importorskip("cv2", reason="opencv-python-headless is not installed")
    for i in range(4):
        (tmp_path / f"f{i}.png").write_bytes(png(i))
    camera = capture.OpencvCamera(str(tmp_path / "f%d.png"))
    for i in range(4):
        np.testing.assert_array_equal(camera.next(), depth_mm(i))
    with pytest.raises(CaptureEnd, match="no further picture"):
        camera.next()
    camera.close()
    with pytest.raises(SourceError, match="no camera that OpenCV can open"):
        open_capture("camera:99", OPTIONS)


def test_a_camera_needs_opencv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(MissingExtra, match=r"touchfield\[camera\]"):
        open_capture("camera:0", OPTIONS)


# -- through a pipe ----------------------------------------------------------------------------------------


def test_messages_of_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "MAX_BYTES", 70000)
    file = io.BytesIO()
    for message in (b"one", b"", b"x" * 70000):
        write_message(file, message)
    data = file.getvalue()
    assert list(messages(io.BytesIO(data), "pipe")) == [b"one", b"", b"x" * 70000]
    for bad in (data[:-1], data[:2], struct.pack("<I", 70001) + bytes(70001)):
        with pytest.raises(SourceError):
            list(messages(io.BytesIO(bad), "pipe"))
    read, write = os.pipe()
    with open(read, "rb", buffering=0) as read_end, open(write, "wb") as write_end:
        write_message(write_end, b"at once")
        os.set_blocking(read, False)
        assert next(messages(read_end, "pipe")) == b"at once"


def test_one_process_renders_what_another_sends_through_a_pipe() -> None:
    program = [sys.executable, "-c", "from touchfield.cli.main import run; run()"]
    camera = [
        "--intrinsics",
        "60,60,31.5,23.5",
        "--depth-scale",
        "1000",
        "--source-rate-hz",
        "50",
        "--nw",
        "4",
    ]
    sender = subprocess.Popen(
        [*program, "live", "-", "-", *camera],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    hand = subprocess.Popen(
        [*program, "play", "-", "--device", "sim", "--seconds", "9", "--json"],
        stdin=sender.stdout,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert sender.stdin is not None and sender.stdout is not None
    sender.stdout.close()
    sender.stdin.write(b"".join(png(i % 12) for i in range(100)))
    sender.stdin.close()
    out, report = hand.communicate(timeout=120)
    assert sender.wait(60) == 0, report
    played = json.loads(out)
    assert played["frames_used"] > 0 and any("the sender has ended" in note for note in played["notes"])
    # frames may come too late on a busy machine; the command then fails and says so
    is_late = played["stalled_share"] > MAX_STALLED_FRACTION
    assert hand.returncode == is_late == any("this has failed" in note for note in played["notes"])


def test_a_pipe_gets_the_opening_the_segments_and_the_end(
    tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_npz(tmp_path / "m.npz", medium()[:10])
    out = io.TextIOWrapper(io.BytesIO())
    monkeypatch.setattr(sys, "stdout", out)
    assert _exit_code(["live", str(tmp_path / "m.npz"), "-", "--segment-s", "0.1", "--nw", "4"]) == 0
    receiver, events = LiveReceiver(), list[live.Event]()
    for message in messages(io.BytesIO(out.buffer.getvalue()), "-"):  # type: ignore[attr-defined]
        events += receiver.receive(message)
    kinds = [type(event).__name__ for event in events]
    assert kinds[0] == "Opened" and kinds[-1] == "Ended" and 1 <= kinds.count("LiveSegment") <= 2
    assert b"10 frames" in capfdbinary.readouterr().err


def test_datagrams_are_sent_in_parallel_to_the_server(tmp_path: Path) -> None:
    write_npz(tmp_path / "m.npz", medium()[:10])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        to = f"127.0.0.1:{receiver.getsockname()[1]}"
        arguments = [
            "live",
            str(tmp_path / "m.npz"),
            "--port",
            "0",
            "--udp",
            to,
            "--segment-s",
            "0.1",
            "--nw",
            "4",
        ]
        assert _exit_code(arguments) == 0
        sizes = dict[int, int]()  # of messages, by their numbers
        with suppress(BlockingIOError):
            while True:
                number, size = struct.unpack_from("<II", receiver.recv(1 << 16), 6)
                sizes[number] = size
    opening, *segments, end = (sizes[number] for number in range(len(sizes)))
    assert opening > 600 and 1 <= len(segments) <= 2 and min(segments) > 100 and end == 1
