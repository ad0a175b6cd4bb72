"""Depth videos and stacks: every frame round-trips in any order, and every fault is one clear error."""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.layouts import LAYOUTS
from touchfield.sources.depth.recorders import tiff_stack
from touchfield.sources.images import movies
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from video_makers import depths_mm, write_video

depth_stack, depth_video = LAYOUTS[-2:]
OPTIONS = SourceOptions(depth_scale=1000, intrinsics="40,41,19.5,14.5")
LOSSLESS = [
    ("a.mkv", "ffv1", "gray16le"),
    ("a.avi", "ffv1", "gray16le"),
    ("a.mp4", "ffv1", "gray16le"),
    ("a.mov", "png", "gray16be"),
    ("b.mkv", "ffv1", "gray12le"),
]


@pytest.fixture
def movie(tmp_path: Path) -> Path:
    pytest.importorskip("av")
    return write_video(tmp_path / "depth.mkv", depths_mm(), "gray16le", level="3", slicecrc="1")


def metres(mm: np.ndarray) -> np.ndarray:
    return np.where(mm == 65535, 0, mm / 1000).astype(np.float32)


@pytest.mark.parametrize(("name", "codec", "pixels"), LOSSLESS)
def test_every_frame_round_trips_in_any_order(tmp_path: Path, name: str, codec: str, pixels: str) -> None:
    pytest.importorskip("av")
    stored = depths_mm() & (0x0FFF if pixels == "gray12le" else 0xFFFF)
    path = write_video(tmp_path / name, stored, pixels, codec)
    assert depth_video.kind.recognise(path)
    sequence = depth_video.read_sequence(path, OPTIONS)
    assert (sequence.frame_count, sequence.width, sequence.height, sequence.rate_hz) == (20, 40, 30, 25.0)
    order = [*range(20), 3, 4, 19, 12, 13, 11, 0, 0, 17]
    for frame in order:
        assert np.array_equal(sequence.frames.values(frame), stored[frame]), frame
    assert np.array_equal(sequence.depth_m(7), metres(stored[7]))
    for beyond in (-1, 20):
        with pytest.raises(InvalidArgument, match="0 to 19"):
            sequence.depth_m(beyond)


def test_frames_are_correct_where_seeking_fails(movie: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file with a misleading index is decoded from its start."""
    video = movies.GreyVideo(movie)
    video._stamps = [stamp + 1 for stamp in video._stamps]  # no frame has such a stamp
    assert len(video._keys) > 1
    assert np.array_equal(video.values(15), depths_mm()[15])
    assert video._keys == [0]
    assert np.array_equal(video.values(16), depths_mm()[16])


def test_a_pass_in_order_decodes_each_frame_once(movie: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded = []
    array = movies.GreyVideo._values
    monkeypatch.setattr(
        movies.GreyVideo, "_values", lambda self, p: (decoded.append(p.pts), array(self, p))[1]
    )
    video = movies.GreyVideo(movie)
    for frame in range(20):
        video.values(frame)
        video.values(frame)
    assert len(decoded) == 20


def test_a_returned_frame_may_be_modified(movie: Path) -> None:
    video = movies.GreyVideo(movie)
    video.values(3)[:] = 0
    assert np.array_equal(video.values(3), depths_mm()[3])


def test_a_depth_video_opens_as_a_scene_at_the_requested_rate(movie: Path) -> None:
    scene = open_source(movie, OPTIONS)
    assert isinstance(scene, DepthScene)
    assert (scene.frame_count, scene.rate_hz) == (20, 25.0)
    fast = open_source(movie, SourceOptions(depth_scale=1000, intrinsics=OPTIONS.intrinsics, rate_hz=1000))
    assert (fast.frame_count, fast.rate_hz) == (800, 1000.0)


def test_error_of_a_depth_video_names_the_missing_options(movie: Path) -> None:
    with pytest.raises(SourceError, match="--depth-scale"):
        open_source(movie, SourceOptions(intrinsics="1,1,0,0"))
    with pytest.raises(SourceError, match="--intrinsics"):
        open_source(movie, SourceOptions(depth_scale=1000))
    with pytest.raises(SourceError, match="a folder"):
        depth_video.read_sequence(movie.parent, OPTIONS)


@pytest.mark.parametrize(("pixels", "codec"), [("gray", "ffv1"), ("yuv420p", "libx264"), ("bgr0", "ffv1")])
def test_an_ordinary_video_is_distinguished_from_depth(tmp_path: Path, pixels: str, codec: str) -> None:
    av = pytest.importorskip("av")
    if codec not in av.codecs_available:
        pytest.skip(f"no {codec}")
    frames = (depths_mm() >> 3).astype(np.uint8)
    path = write_video(
        tmp_path / "a.mkv", frames if pixels == "gray" else np.stack([frames] * 3, -1), pixels, codec
    )
    assert not depth_video.kind.recognise(path)
    with pytest.raises(SourceError, match=r"looks like an ordinary video.*saliency.*relative-depth"):
        depth_video.read_sequence(path, OPTIONS)


@pytest.mark.parametrize("name", ["a.mkv", "a.avi", "a.mp4"])
def test_a_video_cut_anywhere_is_a_source_error(tmp_path: Path, name: str) -> None:
    pytest.importorskip("av")
    intact = write_video(tmp_path / name, depths_mm(), "gray16le").read_bytes()
    cut = tmp_path / f"cut{name}"
    for fraction in (0.0, 0.01, 0.1, 0.3, 0.5, 0.7, 0.85):
        cut.write_bytes(intact[: int(len(intact) * fraction)])
        with pytest.raises(SourceError, match="cut"):
            depth_video.read_sequence(cut, OPTIONS)


def test_error_of_an_invalid_video_states_the_reason(movie: Path) -> None:
    intact = movie.read_bytes()
    for data in (b"", b"no video", intact[:200]):
        movie.write_bytes(data)
        with pytest.raises(SourceError, match="a video that cannot be read"):
            open_source(movie, OPTIONS)


def test_error_of_a_cut_video_states_the_number_of_frames(tmp_path: Path) -> None:
    pytest.importorskip("av")
    frames = np.tile(depths_mm()[:1], (10, 1, 1))
    path = write_video(tmp_path / "a.mkv", frames, "gray16le")
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    with pytest.raises(SourceError, match="where its header says 10"):
        depth_video.read_sequence(path, OPTIONS)


def test_a_damaged_frame_is_an_error_that_names_it(tmp_path: Path) -> None:
    pytest.importorskip("av")
    path = write_video(tmp_path / "a.mov", depths_mm(), "gray16be", "png")  # FFmpeg's FFV1 conceals damage
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    sequence = depth_video.read_sequence(path, OPTIONS)
    original, faults = depths_mm(), []
    for frame in range(20):
        try:
            assert np.array_equal(sequence.depth_m(frame), metres(original[frame])), frame
        except SourceError as error:
            faults.append(str(error))
    assert len(faults) == 1
    assert re.search(r"a\.mov, frame (9|10): found a video that cannot be read", faults[0])


def test_a_flipped_byte_gives_frames_or_a_source_error(movie: Path) -> None:
    data, random = movie.read_bytes(), np.random.default_rng(5)
    for at in [*range(0, 400, 7), *random.integers(400, len(data), 20)]:
        bad = bytearray(data)
        bad[at] ^= int(random.integers(1, 256))
        movie.write_bytes(bad)
        try:
            sequence = depth_video.read_sequence(movie, OPTIONS)
            for frame in (0, sequence.frame_count - 1):
                assert sequence.depth_m(frame).shape == (sequence.height, sequence.width)
        except SourceError:
            continue


def test_strange_files_are_source_errors(movie: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    (tmp_path / "text.mkv").write_text("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\ndepth.mkv\n")
    with pytest.raises(SourceError, match="cannot be read"):  # a play list, which could name other files
        movies.GreyVideo(tmp_path / "text.mkv")
    with pytest.raises(SourceError, match=r"\.mkv \.avi"):
        movies.GreyVideo(movie.with_suffix(".wmv"))
    with av.open(str(tmp_path / "sound.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.rate = 8000
        container.mux(stream.encode(sound))
        container.mux(stream.encode())
    with pytest.raises(SourceError, match="no video"):
        movies.GreyVideo(tmp_path / "sound.mkv")


def test_empty_and_endless_videos_are_refused(movie: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(movies, "MAX_FRAMES", 19)
    with pytest.raises(SourceError, match="more than 19 frames"):
        movies.GreyVideo(movie)
    av = pytest.importorskip("av")
    empty = movie.with_name("empty.avi")
    with av.open(str(empty), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 40, 30, "gray16le"
        container.start_encoding()
    with pytest.raises(SourceError, match=r"without a frame|cannot be read"):
        movies.GreyVideo(empty)


def test_a_frame_of_another_size_is_an_error(movie: Path) -> None:
    video = movies.GreyVideo(movie)
    video.header = movies.VideoHeader(41, 30, "gray16le", "ffv1", 25.0)
    with pytest.raises(SourceError, match=r"frame 2: found 40 x 30 pixels; expected 41 x 30"):
        video.values(2)


def test_without_the_library_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    path = tmp_path / "a.mkv"
    path.write_bytes(b"anything")
    assert depth_video.kind.recognise(path)
    with pytest.raises(MissingExtra, match=r"touchfield\[video\]"):
        depth_video.read_sequence(path, OPTIONS)


# -- stacks ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["depth.npy", "depth_f.npy"])
def test_a_stack_round_trips(tmp_path: Path, name: str) -> None:
    stored = depths_mm(5)
    path = tmp_path / name
    np.save(path, np.asfortranarray(stored) if "_f" in name else stored.astype(">u2"))
    assert depth_stack.kind.recognise(path)
    options = SourceOptions(depth_scale=1000, intrinsics=OPTIONS.intrinsics, source_rate_hz=10, rate_hz=40)
    sequence = depth_stack.read_sequence(path, options)
    assert (sequence.frame_count, sequence.rate_hz) == (5, 10.0)
    for frame in (4, 0, 2):
        assert np.array_equal(sequence.depth_m(frame), metres(stored[frame]))
    assert open_source(path, options).frame_count == 20
    with pytest.raises(SourceError, match="--depth-scale"):
        depth_stack.read_sequence(path, SourceOptions(intrinsics="1,1,0,0"))
    with pytest.raises(InvalidArgument, match="0 to 4"):
        sequence.depth_m(5)


@pytest.mark.parametrize("suffix", ["tif", "tiff"])
def test_pages_of_a_tiff_are_frames_and_refused_in_a_folder(tmp_path: Path, suffix: str) -> None:
    """In a folder, where a file is a frame, the error states a remedy."""
    path = tmp_path / f"depth.{suffix}"
    first, second, small = (Image.fromarray(page) for page in (*depths_mm(2), depths_mm(1)[0, ::2, ::2]))
    first.save(path, save_all=True, append_images=[second])
    sequence = tiff_stack.LAYOUT.read_sequence(path, OPTIONS)
    assert [np.array_equal(sequence.depth_m(i), metres(depths_mm(2)[i])) for i in (0, 1)] == [True, True]
    assert open_source(path, replace(OPTIONS, world="frames")).frame_count == 2
    with pytest.raises(SourceError, match=r"depth\.tiff?: found a TIFF of several pages.*NPY \[frames"):
        open_source(tmp_path, replace(OPTIONS, kind="depth-folder"))
    first.save(path, save_all=True, append_images=[small])  # a smaller copy is no further frame
    assert open_source(path, OPTIONS).frame_count == 1


def test_a_stack_of_floats_is_in_metres(tmp_path: Path) -> None:
    values = metres(depths_mm(3))
    values[1, 1, 1] = np.nan
    np.save(tmp_path / "depth.npy", values)
    sequence = depth_stack.read_sequence(tmp_path / "depth.npy", SourceOptions(intrinsics="40,41,19.5,14.5"))
    assert np.array_equal(sequence.depth_m(1), np.nan_to_num(values[1]))


def test_invalid_stacks_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "depth.npy"
    np.save(path, depths_mm(4))
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(SourceError, match=r"depth\.npy: found .* bytes; expected numbers in"):
        depth_stack.read_sequence(path, OPTIONS)
    np.save(path, depths_mm(1)[0])
    assert not depth_stack.kind.recognise(path)  # a single picture belongs to another kind
    with pytest.raises(SourceError, match="frames, height, width"):
        depth_stack.read_sequence(path, OPTIONS)
    np.save(path, depths_mm(2).astype(np.uint8))
    with pytest.raises(SourceError, match="uint8"):
        depth_stack.read_sequence(path, OPTIONS)


def test_frames_at_unequal_times_are_noted_with_a_command() -> None:
    even, rounded = np.full(9, 0.04), 1e-3 * (1 + np.arange(9) % 2)
    assert movies.uneven_note(Path("a.mkv"), even, 25.0) == ()
    assert movies.uneven_note(Path("a.mkv"), rounded, 667.0) == ()  # times in whole milliseconds
    assert movies.uneven_note(Path("a.mkv"), np.zeros(9), None) == ()  # no times
    (note,) = movies.uneven_note(Path("my film.mkv"), np.array([0.04, 0.04, 0.4]), 6.25)
    assert "0.04 to 0.4 s apart, and are read at 6.25 a second" in note
    assert "ffmpeg -i 'my film.mkv' -vf fps=25 -c:v ffv1 even.mkv, then encode even.mkv" in note


@pytest.mark.parametrize("order", [("COLOR", "DEPTH", "IR"), ("IR", "DEPTH"), ("DEPTH", "IR")])
def test_the_track_of_depth_of_an_azure_kinect_is_read(tmp_path: Path, order: tuple[str, ...]) -> None:
    av = pytest.importorskip("av")
    frames, path = depths_mm(4), tmp_path / "recording.mkv"
    tracks = {"COLOR": (frames % 200).astype(np.uint8), "DEPTH": frames, "IR": frames // 2}
    with av.open(str(path), "w") as container:
        streams = {}
        for name in order:
            streams[name] = stream = container.add_stream("ffv1", rate=30)
            stream.height, stream.width = frames.shape[1:]
            stream.pix_fmt = "gray" if name == "COLOR" else "gray16le"
            stream.metadata["title"] = name
        for index in range(len(frames)):
            for name, stream in streams.items():
                picture = av.VideoFrame.from_ndarray(tracks[name][index], format=stream.pix_fmt)
                container.mux(stream.encode(picture))
        for stream in streams.values():
            container.mux(stream.encode())
    scene = open_source(path, OPTIONS)
    assert scene.frame_count == len(frames)
    np.testing.assert_array_equal(movies.GreyVideo(path).values(3), frames[3])
    others = ", ".join(name for name in order if name != "DEPTH")
    assert f"Of {len(order)} video tracks DEPTH is read; not {others}." in scene.notes
