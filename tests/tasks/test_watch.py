"""`watch`: a movie gets touch in time with its picture and its sound, or one clear error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from soundtrack_makers import pictures, strokes, write_movie
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import HapticMedium
from touchfield.network.demux import demux
from touchfield.network.mux import Muxed
from touchfield.network.opening import open_stream
from touchfield.sources.sound.analysis import SoundFeatures, sound_features
from touchfield.sources.video.saliency import MAX_EVEN_HZ
from touchfield.tasks.watch import WatchSpec, watch
from touchfield.tasks.watch_sound import PULSE_S, chest_rows, low_drives, onset_drives, sound_medium

TIMES_S = (0.4, 1.1, 1.7)
ROWS, COLUMNS = 5, 4


@pytest.fixture(scope="module")
def movie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_movie(tmp_path_factory.mktemp("movie") / "movie.mp4", pictures(50), strokes(TIMES_S, 2.0))


def onsets_s(medium: HapticMedium) -> NDArray[np.float64]:
    """When the lowest row begins to vibrate, seconds after frame 0: it shows onsets alone."""
    assert medium.vibration is not None
    is_on = [bool((medium.vibration(i).positions[:, 1] == 0).any()) for i in range(len(medium))]
    starts = np.flatnonzero(np.diff([False, *is_on]) & np.array(is_on))
    return np.asarray(starts / medium.rate_hz)


def first_picture_s(path: Path) -> float:
    """When the first picture shows, on the clock that `demux` counts on: that of a TS starts with it."""
    av = pytest.importorskip("av")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return 0.0 if path.suffix == ".ts" else float(stream.start_time * stream.time_base)


def packets(path: Path, kind: str) -> list[bytes]:
    av = pytest.importorskip("av")
    with av.open(str(path)) as container:
        track = next(track for track in container.streams if track.type == kind)
        return [bytes(packet) for packet in container.demux(track) if packet.size]


def extracted(both: Path, folder: Path, track: str) -> tuple[Muxed, Path]:
    out = folder / f"{track}.touch"
    return demux(both, out, track), out


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".mov", ".ts"])
def test_each_source_has_a_symbolic_track_in_time(movie: Path, suffix: str, tmp_path: Path) -> None:
    both = tmp_path / f"both{suffix}"
    done = watch(movie, both)
    sound, path = extracted(both, tmp_path, "sound")
    picture, picture_path = extracted(both, tmp_path, "picture")
    with open_stream(path) as stream:
        assert stream.reader.head.tags == ("symbolic", "sound")
        found = sound.at_s - picture.at_s + onsets_s(stream.medium)
        assert found == pytest.approx(TIMES_S, abs=0.01)
        assert not any(len(stream.medium[i].bricks) for i in range(len(stream.medium)))
    assert picture.at_s == pytest.approx(first_picture_s(both), abs=0.002)
    with open_stream(picture_path) as stream:
        assert stream.reader.head.tags == ("symbolic", "picture") and stream.medium.vibration is None
        assert len(stream.medium) == 50 and stream.medium.rate_hz == 25
        assert stream.medium[40].support_count > 0
    assert done.figures["onsets"] == 3 and done.figures["onsets_per_minute"] == pytest.approx(90, rel=0.05)
    assert done.notes == ()


@pytest.mark.parametrize(
    ("suffix", "codecs", "out"),
    [
        (".m4v", ("mpeg4", "aac"), ".m4v"),
        (".ts", ("mpeg4", "mp2"), ".ts"),
        (".webm", ("libvpx", "libopus"), ".mkv"),
    ],
)
def test_movies_of_other_forms_are_read(
    suffix: str, codecs: tuple[str, str], out: str, tmp_path: Path
) -> None:
    path = write_movie(tmp_path / f"movie{suffix}", pictures(25), strokes((0.4,), 1.0), codecs=codecs)
    both = tmp_path / f"both{out}"
    done = watch(path, both)
    sound, file = extracted(both, tmp_path, "sound")
    picture, _ = extracted(both, tmp_path, "picture")
    with open_stream(file) as stream:
        found = sound.at_s - picture.at_s + onsets_s(stream.medium)
    assert found == pytest.approx([0.4], abs=0.05)  # an encoder of sound may start before 0
    assert done.figures["picture_seconds"] == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("suffix", [".webm", ".avi"])
def test_form_without_touch_names_one_with_it(movie: Path, suffix: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match=r"\.mkv holds the same picture and sound"):
        watch(movie, tmp_path / f"both{suffix}")
    assert not list(tmp_path.iterdir())


def test_cover_is_no_picture_of_the_movie(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    path = tmp_path / "cover.mp4"
    plain = write_movie(tmp_path / "plain.mp4", pictures(25), strokes((0.4,), 1.0))
    with av.open(str(plain)) as source, av.open(str(path), "w") as sink:
        cover = sink.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 32, 32, "yuvj420p"
        cover.disposition = av.stream.Disposition.attached_pic
        tracks = {track.index: sink.add_stream_from_template(track) for track in source.streams}
        frame = av.VideoFrame.from_ndarray(np.zeros((32, 32, 3), np.uint8), format="rgb24")
        sink.mux([*cover.encode(frame), *cover.encode(None)])
        for packet in source.demux():
            if packet.dts is not None:
                packet.stream = tracks[packet.stream.index]
                sink.mux(packet)
    done = watch(path, tmp_path / "both.mkv")
    assert any(note.startswith("1 still pictures (covers) are copied") for note in done.notes)
    assert done.figures["picture_seconds"] == pytest.approx(1)


def test_sound_and_picture_of_the_movie_stay_as_they_are(movie: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    watch(movie, tmp_path / "both.mp4")
    with av.open(str(tmp_path / "both.mp4")) as after:
        kinds = [stream.type for stream in after.streams]
        assert sorted(kinds) == ["audio", "data", "data", "video"]
        names = [stream.metadata.get("handler_name") for stream in after.streams.data]
        assert names == ["touch: picture", "touch: sound"]

    for kind in ("video", "audio"):
        assert packets(tmp_path / "both.mp4", kind) == packets(movie, kind) != []


def test_demux_takes_the_first_track_or_the_named_one(movie: Path, tmp_path: Path) -> None:
    both = tmp_path / "both.mp4"
    watch(movie, both)
    first = demux(both, tmp_path / "first.touch")
    assert any("2 tracks of touch" in note for note in first.notes)
    for track, other in (("1", "picture"), ("2", "sound")):
        done = demux(both, tmp_path / "a.touch", track)
        demux(both, tmp_path / "b.touch", other)
        assert (tmp_path / "a.touch").read_bytes() == (tmp_path / "b.touch").read_bytes()
        assert done.notes == ()
    assert (tmp_path / "first.touch").read_bytes() != (tmp_path / "b.touch").read_bytes()
    with pytest.raises(InvalidArgument, match="'smell'; expected one of symbolic, picture, sound, or a"):
        demux(both, tmp_path / "none.touch", "smell")
    assert not (tmp_path / "none.touch").exists()


def test_sound_that_starts_before_a_late_picture_with_b_frames(tmp_path: Path) -> None:
    """Times that do not begin at 0: the touch of each source starts where the source does."""
    path = write_movie(
        tmp_path / "cut.mkv", pictures(50), strokes(TIMES_S, 2.0), picture_s=3.0, sound_s=2.4,
        has_b_frames=True,
    )  # fmt: skip
    done = watch(path, tmp_path / "both.mkv")
    sound, file = extracted(tmp_path / "both.mkv", tmp_path, "sound")
    picture, _ = extracted(tmp_path / "both.mkv", tmp_path, "picture")
    with open_stream(file) as stream:
        found = sound.at_s - picture.at_s + onsets_s(stream.medium)
    assert found == pytest.approx(np.array(TIMES_S) - 0.6, abs=0.01)
    assert any(note.startswith("The sound starts 0.6") for note in done.notes)
    assert any(note.startswith("The sound ends 0.") and "before" in note for note in done.notes)


def test_pictures_at_unequal_times_stay_in_time(tmp_path: Path) -> None:
    """Ten pictures a second, then thirty: the last second is still the last one."""
    times_s = [*np.arange(20) / 10, *(2 + np.arange(30) / 30)]
    frames = [np.full((48, 64, 3), 90, np.uint8) for _ in range(50)]
    for frame in frames[20:]:
        frame[8:24, 30:50] = (255, 255, 0)
    path = write_movie(tmp_path / "uneven.mkv", frames, picture_times_s=times_s)
    done = watch(path, tmp_path / "both.mkv", WatchSpec(only="picture"))
    _, file = extracted(tmp_path / "both.mkv", tmp_path, "picture")
    with open_stream(file) as stream:
        medium = stream.medium
        assert len(medium) / medium.rate_hz == pytest.approx(3, abs=0.15) and medium.rate_hz <= MAX_EVEN_HZ
        strongest = [float(np.abs(medium[i].forces_n).max(initial=0)) for i in range(len(medium))]
    rise_s = int(np.argmax(np.array(strongest) > 0.5 * max(strongest))) / medium.rate_hz
    assert rise_s == pytest.approx(2, abs=0.05)
    assert any("unequal times" in note for note in done.notes)


def test_long_pause_between_pictures_is_an_error(tmp_path: Path) -> None:
    path = write_movie(tmp_path / "pause.mkv", pictures(5), picture_times_s=[0, 0.04, 0.08, 0.12, 9000])
    with pytest.raises(SourceError, match=r"5 pictures in 9000 s; expected pictures without long pauses"):
        watch(path, tmp_path / "both.mkv")
    assert not (tmp_path / "both.mkv").exists()


def test_movie_with_one_source_says_so(tmp_path: Path) -> None:
    silent = write_movie(tmp_path / "silent.mp4", pictures(10))
    done = watch(silent, tmp_path / "a.mp4")
    assert done.notes == ("The movie has no sound: the touch is that of the picture.",)
    assert "onsets" not in done.figures
    dark = write_movie(tmp_path / "dark.mp4", (), strokes(TIMES_S, 2.0))
    done = watch(dark, tmp_path / "b.mp4")
    assert done.notes == ("The movie has no picture: the touch is that of the sound.",)
    assert done.figures["onsets"] == 3
    with pytest.raises(SourceError, match=r"dark\.mp4: found no picture in the file"):
        watch(dark, tmp_path / "c.mp4", WatchSpec(only="picture"))
    assert not (tmp_path / "c.mp4").exists()


def test_sound_of_zeros_says_so(tmp_path: Path) -> None:
    movie = write_movie(tmp_path / "a.mp4", pictures(10), np.zeros((2, 20000), np.float32))
    notes = watch(movie, tmp_path / "b.mp4").notes
    assert any("silent throughout" in note for note in notes)


def test_tracks_that_the_form_does_not_hold_are_to_be_converted(tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    with av.open(str(tmp_path / "a.gif"), "w") as container:
        track = container.add_stream("gif", rate=10)
        track.width, track.height, track.pix_fmt = 64, 48, "rgb8"
        for values in pictures(10):
            container.mux(track.encode(av.VideoFrame.from_ndarray(values, format="rgb24")))
        container.mux(track.encode(None))
    with pytest.raises(InvalidArgument, match=r"gif.*Convert the movie first"):
        watch(tmp_path / "a.gif", tmp_path / "b.mp4")
    assert not (tmp_path / "b.mp4").exists()


@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"#EXTM3U\n/etc/passwd\n"])
def test_no_movie_is_one_line(content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.mp4").write_bytes(content)
    out = tmp_path / "both.mp4"
    assert _exit_code(["watch", str(tmp_path / "bad.mp4"), "-o", str(out)]) != 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "bad.mp4: found" in lines[0] and not out.exists()


@pytest.mark.parametrize(
    ("device", "found"), [("dotpad", "a pin display"), ("phantom-omni", "a point"), ("nothing", "nothing")]
)
def test_only_motors_get_touch(movie: Path, device: str, found: str, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match=found):
        watch(movie, tmp_path / "both.mp4", WatchSpec(device))
    with pytest.raises(InvalidArgument, match=r"'\.avi'; expected one of \.mp4"):
        watch(movie, tmp_path / "both.avi")


def test_timeline_is_drawn(movie: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from PIL import Image

    assert _exit_code([
        "watch", str(movie), "-o", str(tmp_path / "both.mp4"), "--plot", str(tmp_path / "both.png")
    ]) == 0  # fmt: skip
    with Image.open(tmp_path / "both.png") as image:
        assert np.asarray(image.convert("RGB")).std() > 20


# -- the rule ----------------------------------------------------------------------------------------------
def features(times_s: tuple[float, ...] = TIMES_S, low: float = 0.1) -> SoundFeatures:
    samples = strokes(times_s, 2.0, 24000)[0]
    t = np.arange(len(samples)) / 24000
    return sound_features([samples + (low * np.sin(2 * np.pi * 60 * t) * (t > 1)).astype(np.float32)])


def test_low_frequencies_are_on_the_chest_and_onsets_everywhere() -> None:
    from touchfield.devices import device
    from touchfield.filters.device_spec import device_grid

    grid = device_grid(device("tactsuit-x40"))
    medium = sound_medium(features(), grid, 3.3)
    assert medium.vibration is not None
    low, pulse = medium.vibration(300), medium.vibration(round(0.4 * 200))
    assert len(pulse) == ROWS * COLUMNS and len(low) == chest_rows(ROWS) * COLUMNS == 12
    assert low.positions[:, 1].min() == ROWS - 3  # y points up
    assert low.frequencies_hz == pytest.approx(60, rel=0.15)
    assert pulse.amplitudes_n.max() <= np.float32(3.3) and pulse.amplitudes_n.min() >= np.float32(1.65)


def test_pulse_has_its_length_and_quieter_movies_vibrate_less() -> None:
    found = features(low=0.0)
    drives = onset_drives(found)
    assert (drives > 0).sum() == 3 * round(PULSE_S * 200) and drives.max() == 1
    loud, quiet = (low_drives(features((), low)) for low in (0.1, 0.001))
    assert loud[300:].max() == pytest.approx(1, abs=0.05)
    assert 0 < quiet[300:].max() == pytest.approx(np.sqrt(0.001 / 10 ** (-1.5)), rel=0.3)
