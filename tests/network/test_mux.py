"""Touch muxed with sound and video: written, played by other programs, and extracted byte for byte."""

from __future__ import annotations

import base64
import re
import shlex
import warnings
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from map_makers import town, write_geojson
from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader
from touchfield.container.wire import OPENING_SIZE, ByteSource, records_between
from touchfield.errors import InvalidArgument, TouchfieldError, UnboundedError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.network import ts_streams
from touchfield.network.dash import START_SCHEME
from touchfield.network.demux import demux
from touchfield.network.mux import mux
from touchfield.network.touch_track import KLV, TouchTrack, sync_record
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.map import MapSpec, make_map
from touchfield.tasks.view import view

av = pytest.importorskip("av", reason="movies need the extra video")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A movie of two seconds with sound, and streams of voxels (some samples above 200 kB) and of bodies."""
    folder = tmp_path_factory.mktemp("movies")
    rng = np.random.default_rng(5)
    grid = Grid((40, 40, 40), (0.003,) * 3, (-0.06,) * 3)
    frames = [
        ForceField.from_dense(grid, rng.normal(0, 1, (40, 40, 40, 3)).astype(np.float32)) for _ in range(9)
    ]
    medium = HapticMedium.from_frames(frames, 10.0)
    encode(
        medium,
        folder / "noise.touch",
        EncodeSpec(touch=TouchSpec(segment_frames=3, effort="fast"), vibration=None),
    )
    walls = np.zeros((6, 16, 16, 16, 3), np.float32)
    for i, wall in enumerate(walls):
        wall[:, :, : 4 + i, 2] = 1.0 + 0.1 * i
    sinking = HapticMedium.from_array(walls, Grid((16,) * 3, (0.004,) * 3, (-0.03,) * 3), 10.0)
    touch = TouchSpec(segment_frames=2, effort="fast")
    encode(
        sinking, folder / "vibrating.touch", EncodeSpec(touch=touch, vibration="gain=0.25,frequency=80..240")
    )
    encode("sample:falling-4", folder / "bodies.touch", EncodeSpec(nw=5, frames=(0, 900)))
    with av.open(str(folder / "movie.mp4"), "w") as sink:
        video, audio = sink.add_stream("mpeg4", rate=25), sink.add_stream("aac", rate=8000)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        for i in range(50):
            picture = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 5 * i % 255, np.uint8), format="rgb24")
            sink.mux(video.encode(picture))
        sink.mux(video.encode(None))
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 16000), np.float32), format="fltp", layout="mono")
        sound.sample_rate, sound.pts = 8000, 0
        sink.mux(audio.encode(sound))
        sink.mux(audio.encode(None))
    return folder


def pictures(path: Path) -> list[tuple[Fraction, bytes]]:
    """Times and packets of the video track."""
    with av.open(str(path)) as movie:
        track = movie.streams.video[0]
        return [(p.pts * p.time_base, bytes(p)) for p in movie.demux(track) if p.pts is not None]


@pytest.mark.parametrize("form", [".mp4", ".mov", ".ts"])
@pytest.mark.parametrize("name", ["noise.touch", "bodies.touch"])
def test_demux_returns_the_muxed_stream(folder: Path, tmp_path: Path, form: str, name: str) -> None:
    out, back = tmp_path / f"both{form}", tmp_path / "back.touch"
    done = mux(folder / "movie.mp4", folder / name, out, 0.4)
    demuxed = demux(out, back)
    assert done.other_tracks == ("video", "audio") and done.at_s == 0.4 == pytest.approx(
        demuxed.at_s, abs=2e-3
    )
    with TouchReader(back) as reader:
        layout = len(reader.segments), reader.head.frame_count / reader.head.rate_hz
        end = reader.segments[-1].offset + reader.segments[-1].length  # the rest is written anew
    assert (done.segments, done.touch_seconds) == (demuxed.segments, demuxed.touch_seconds) == layout
    added = 9 * len(sync_record(0.0))  # after the head and in the spare samples
    assert demuxed.touch_bytes >= end + added
    assert form == ".ts" or done.touch_bytes == demuxed.touch_bytes == end + added
    assert back.read_bytes() == (folder / name).read_bytes()
    assert (b"moof" in out.read_bytes()) == (form != ".ts")  # fragments, for streaming
    if form == ".mp4":
        assert 'data-type="video/mp4" data-at="0.400000"' in view(out).html
    before, after = pictures(folder / "movie.mp4"), pictures(out)
    assert len(before) == len(after) and [b for _, b in before] == [b for _, b in after]
    shifts = {round(float(a - b), 3) for (a, _), (b, _) in zip(after, before, strict=True)}
    assert len(shifts) == 1  # the clock of MPEG-TS starts a little later
    with TouchReader(folder / name) as reader, av.open(str(out)) as movie:
        assert [s.type for s in movie.streams].count("data") == 1
        touch = movie.streams.data[0]
        packets = [p for p in movie.demux(touch) if p.pts is not None]
        assert all(len(bytes(p)) < 64 for p in packets[-8:])  # spare samples
        packets = packets[:-8]
        if form == ".ts":  # a long sample is divided among several
            packets = [p for p in packets if bytes(p).startswith(KLV)]
        times = [float(p.pts * p.time_base) - shifts.copy().pop() for p in packets]
        expected = [0.4 + entry.first_frame / reader.head.rate_hz for entry in reader.segments]
        np.testing.assert_allclose(times, expected, atol=2e-3)
        if form == ".ts":  # ffmpeg may take data without a registered name for video, by its content
            assert out.read_bytes().count(b"KLVA") >= 1
        else:  # which has a duration
            lasts = [float(p.duration * p.time_base) for p in packets]
            expected = [entry.frame_count / reader.head.rate_hz for entry in reader.segments]
            np.testing.assert_allclose(lasts, expected, atol=2e-3)


def test_the_movie_is_decoded_as_before(folder: Path, tmp_path: Path) -> None:
    out, notes, decoded = tmp_path / "both.mp4", list[tuple[int, int]](), list[list[bytes]]()
    mux(
        folder / "movie.mp4", folder / "noise.touch", out, 1.5, lambda *at: notes.append(at)
    )  # also beyond its end
    assert notes == [(1, 3), (2, 3), (3, 3)]
    demux(out, tmp_path / "back.TOUCH")
    assert (tmp_path / "back.TOUCH").read_bytes() == (folder / "noise.touch").read_bytes()
    for path in (folder / "movie.mp4", out):
        with av.open(str(path)) as movie:
            decoded.append([f.to_ndarray(format="rgb24").tobytes() for f in movie.decode(video=0)])
    assert decoded[0] == decoded[1] and len(decoded[0]) == 50


@pytest.mark.parametrize("form", [".mkv", ".ts"])
def test_the_touch_of_a_movie_that_browsers_do_not_play_is_viewed(
    folder: Path, tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    mux(folder / "movie.mp4", folder / "noise.touch", f"my film{form}", 0.4)
    page, stream = view(f"my film{form}"), (folder / "noise.touch").read_bytes()
    assert 'data-type=""' in page.html and base64.b64encode(stream).decode() in page.html
    (note,) = page.figures["movie_notes"]
    assert note.startswith(f"only the touch of the movie is shown, as not every browser plays {form}: ")
    assert _exit_code(["info", f"my film{form}"]) == 1
    assert "touchfield demux MOVIE OUT.touch" in capsys.readouterr().err


def test_the_note_on_a_movie_without_pictures_names_commands_that_show_them(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mux(folder / "movie.mp4", folder / "noise.touch", "my film.mkv", 0.4)
    (note,) = view("my film.mkv").figures["movie_notes"]
    *commands, last = [shlex.split(command) for command in note.partition(": ")[2].split("; ")]
    for program, *words in commands:
        assert program == "touchfield" and _exit_code(words) == 0
    assert last == ["touchfield", "view", "my film.mp4"]
    at_s = re.search('data-type="video/mp4" data-at="([0-9.]+)"', view("my film.mp4").html)
    first_s = min(time_s for time_s, _ in pictures(Path("my film.mp4")))  # ffmpeg makes room for the sound
    assert at_s is not None and float(at_s[1]) - float(first_s) == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize("stem", ["film", "sight & touch"])
def test_a_manifest_names_the_movie_and_the_touch(folder: Path, tmp_path: Path, stem: str) -> None:
    out = tmp_path / f"{stem}.mpd"
    done, size = (
        mux(folder / "movie.mp4", folder / "noise.touch", out, 0.5),
        (folder / "noise.touch").stat().st_size,
    )
    assert (done.other_tracks, done.at_s, done.touch_bytes) == (("video", "audio"), 0.5, size)
    space = "{urn:mpeg:dash:schema:mpd:2011}"
    sets = ElementTree.parse(out).getroot().findall(f"{space}Period/{space}AdaptationSet")
    assert [adaptation.get("contentType") for adaptation in sets] == ["video", "audio", "application"]
    named = [adaptation.findtext(f"{space}Representation/{space}BaseURL") for adaptation in sets]
    assert {path.name for path in tmp_path.iterdir()} == {out.name, *map(str, named)}
    assert sets[2].get("mimeType") == "haptics/vnd.touchfield" and named[2] == f"{stem}.touch"
    representation = sets[2].find(f"{space}Representation")
    assert representation is not None and representation.get("bandwidth") == str(round(8 * size / 0.9))
    supplement = sets[2].find(f"{space}SupplementalProperty")
    assert supplement is not None and (supplement.get("schemeIdUri"), supplement.get("value")) == (
        START_SCHEME,
        "0.5",
    )
    assert (tmp_path / f"{stem}.touch").read_bytes() == (folder / "noise.touch").read_bytes()
    assert [data for _, data in pictures(tmp_path / str(named[0]))] == [
        data for _, data in pictures(folder / "movie.mp4")
    ]
    with pytest.raises(InvalidArgument, match=rf"a DASH manifest; .* next to it: {stem}\.touch"):
        demux(out, tmp_path / "back.touch")
    with pytest.raises(InvalidArgument, match="the movie that is read"):
        mux(tmp_path / str(named[0]), folder / "noise.touch", out)


def test_each_error_is_one_clear_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    movie, touch = str(folder / "movie.mp4"), str(folder / "noise.touch")
    (tmp_path / "text.mp4").write_text("no movie")
    out, also = tmp_path / "out.mp4", tmp_path / "touch.mp4"
    also.write_bytes((folder / "noise.touch").read_bytes())  # a stream with another suffix
    for arguments, message in (
        (["mux", movie, touch, str(tmp_path / "out.avi")], ".avi"),
        (["mux", str(tmp_path / "text.mp4"), touch, str(out)], "a movie that ffmpeg reads"),
        (["mux", movie, movie, str(out)], "movie.mp4"),
        (["mux", touch, movie, str(out)], "The movie comes first"),
        (["mux", movie, touch, movie], "the file that is read"),
        (["mux", movie, str(also), str(also)], "the file that is read"),
        (["mux", movie, touch, str(out), "--at-s", "-1"], "--at-s"),
        (["mux", movie, touch, str(out), "--at-s", "nan"], "--at-s"),
        (["demux", movie, str(tmp_path / "x.touch")], "no track of touch"),
        (["demux", str(tmp_path / "absent.mp4"), str(tmp_path / "x.touch")], "absent.mp4"),
    ):
        assert _exit_code(arguments) != 0
        stderr = capsys.readouterr().err
        assert message in stderr and stderr.count("\n") == 1 and "Traceback" not in stderr
    assert not out.exists() and not (tmp_path / "x.touch").exists()
    assert also.read_bytes() == (folder / "noise.touch").read_bytes()
    assert _exit_code(["mux", movie, touch, str(out), "--json"]) == 0


def test_a_movie_that_was_cut_or_changed_gives_an_error_and_no_file(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, back = tmp_path / "both.ts", tmp_path / "back.touch"
    mux(folder / "movie.mp4", folder / "noise.touch", out)
    data, rng = out.read_bytes(), np.random.default_rng(3)
    (tmp_path / "late.ts").write_bytes(data[len(data) // 2 // 188 * 188 :])
    with pytest.raises(TouchfieldError, match=r"late\.ts"):
        demux(tmp_path / "late.ts", back)
    refused = 0
    for _ in range(25):
        spoilt = bytearray(data)
        for at in rng.integers(0, len(data), 6):
            spoilt[at] ^= 1 << rng.integers(8)
        (tmp_path / "spoilt.ts").write_bytes(spoilt)
        try:
            demux(tmp_path / "spoilt.ts", back)
        except TouchfieldError:
            refused += 1
            assert not back.exists()
        else:
            assert back.read_bytes() == (folder / "noise.touch").read_bytes()
            back.unlink()
    assert refused > 5
    found = ts_streams.find_touch

    def without_third_segment(source: ByteSource) -> tuple[TouchTrack, ...]:
        (track,) = found(source)
        starts = [n for n, sample in enumerate(track.samples) if KLV in sample.data]
        return (replace(track, samples=track.samples[: starts[2]]),)

    monkeypatch.setattr(ts_streams, "find_touch", without_third_segment)
    with pytest.raises(TouchfieldError, match=r"both\.ts: INDX\.segments: found 6 frames; expected 9"):
        demux(out, back)
    assert not back.exists()


@pytest.mark.parametrize("name", ["vibrating.touch", "bodies.touch"])
def test_each_damaged_record_in_a_movie_is_an_error_and_leaves_no_file(
    folder: Path, tmp_path: Path, name: str
) -> None:
    """The head, objects, and the forces and the vibration of each segment including the last one."""
    movie, back, spoilt = tmp_path / "both.mp4", tmp_path / "back.touch", tmp_path / "spoilt.mp4"
    mux(folder / "movie.mp4", folder / name, movie)
    data, stream = movie.read_bytes(), (folder / name).read_bytes()
    with (folder / name).open("rb") as file:
        records = list(records_between(ByteSource(file), OPENING_SIZE, len(stream)))
    tags = [record.tag for record in records]
    assert min(tags.count(tag) for tag in (("SEGM", "VIBR") if name == "vibrating.touch" else ("OBJT",))) >= 3
    for record in records:
        if record.tag in ("INDX", "TEND"):  # which are written anew
            continue
        at = data.index(stream[record.offset : record.end])
        changed = bytearray(data)
        changed[at + (record.end - record.offset) // 2] ^= 1
        spoilt.write_bytes(changed)
        with pytest.raises(TouchfieldError, match=r"spoilt\.mp4"):
            demux(spoilt, back)
        assert not back.exists(), record
    demux(movie, back)
    assert back.read_bytes() == stream


def test_a_stream_without_an_error_bound_is_muxed_with_a_warning(folder: Path, tmp_path: Path) -> None:
    with open_file(folder / "noise.touch") as stream:
        medium = stream.medium.between(0, 1)
        with pytest.warns(UnboundedError):
            encode(medium, tmp_path / "free.touch", EncodeSpec(touch=TouchSpec(mode="nmse")))
    with pytest.warns(UnboundedError, match="mode nmse keeps a mean squared error"):
        mux(folder / "movie.mp4", tmp_path / "free.touch", tmp_path / "free.mp4")
    with warnings.catch_warnings():
        warnings.simplefilter("error", UnboundedError)
        mux(folder / "movie.mp4", folder / "noise.touch", tmp_path / "both.mp4")


def test_the_track_of_a_map_is_reported_to_be_its_frame_alone(folder: Path, tmp_path: Path) -> None:
    town_map = tmp_path / "town.touch"
    source = write_geojson(tmp_path / "town.geojson", *town())
    make_map(source, town_map, MapSpec(has_labels=False, zooms=2))
    done = mux(folder / "movie.mp4", town_map, tmp_path / "both.mp4")
    assert done.notes == ("town.touch: the zoom levels and names of the map are left out",)
    demux(tmp_path / "both.mp4", tmp_path / "back.touch")
    with TouchReader(tmp_path / "back.touch") as reader:
        assert not reader.has_map
    assert mux(folder / "movie.mp4", town_map, tmp_path / "both.mpd").notes == ()
    with TouchReader(tmp_path / "both.touch") as reader:
        assert reader.has_map
    assert mux(folder / "movie.mp4", folder / "noise.touch", tmp_path / "noise.mp4").notes == ()


def test_tracks_that_are_not_copied_are_named(folder: Path, tmp_path: Path) -> None:
    """The touch of an earlier run is a track of data, which no form copies."""
    first = tmp_path / "first.mp4"
    assert mux(folder / "movie.mp4", folder / "noise.touch", first).notes == ()
    for form in (".mp4", ".mkv", ".mpd"):
        done = mux(first, folder / "noise.touch", tmp_path / f"second{form}")
        assert done.notes == ("Not all tracks of the movie are copied: 1 of type data left out.",)
