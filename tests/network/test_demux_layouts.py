"""Touch is found and in sync in movies as other programs write them, and hostile ones end with one error."""

from __future__ import annotations

import struct
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from movie_makers import (
    box,
    fragmented_mp4,
    full,
    matroska,
    packets,
    pes,
    plain_mp4,
    samples_of,
    stbl,
    trak,
    transport_stream,
    triplet,
    words,
)

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader
from touchfield.errors import CorruptFile, InvalidArgument, SourceError, TouchfieldError
from touchfield.medium import Grid, HapticMedium
from touchfield.network.demux import demux
from touchfield.network.touch_track import KLV, sync_record, with_sync
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A file of six frames in three segments, with vibration: 0.6 s at 10 Hz."""
    path = tmp_path_factory.mktemp("stream") / "rise.touch"
    walls = np.zeros((6, 12, 12, 12, 3), np.float32)
    for i, wall in enumerate(walls):
        wall[:, :, : 4 + i, 2] = 1.0 + 0.1 * i
    medium = HapticMedium.from_array(walls, Grid((12,) * 3, (0.004,) * 3, (-0.022,) * 3), 10.0)
    touch = TouchSpec(segment_frames=2, effort="fast")
    encode(medium, path, EncodeSpec(touch=touch, vibration="gain=0.25,frequency=80..240"))
    return path.read_bytes()


def whole(stream: bytes, start_s: float) -> bytes:
    """The file with the record of its start, as a sidecar or an attachment has it."""
    with TouchReader(BytesIO(stream)) as reader:
        last, first = reader.segments[-1], reader.segments[0].offset
    return with_sync(stream[: last.offset + last.length], first, start_s)


Movie = Callable[[bytes], bytes]
MOVIES: dict[str, tuple[Movie, float]] = {
    "mp4 by ffmpeg": (lambda s: plain_mp4(samples_of(s, 1.021, 1.0)), 1.021),
    "mp4, no record of the start": (lambda s: plain_mp4(samples_of(s, 1.021)), 1.021),
    "mp4, taken for pictures": (lambda s: plain_mp4(samples_of(s, 1.5), b"vide", b"vvc1"), 1.5),
    "mp4, taken for sound": (lambda s: plain_mp4(samples_of(s, 1.5), b"soun", b"mp4a"), 1.5),
    "mov by ffmpeg from ts": (
        lambda s: plain_mp4([(t, triplet(d)) for t, d in samples_of(s, 2.0, 1.979)], label=b"stts"),
        2.0,
    ),
    "mp4, small tables": (lambda s: plain_mp4(samples_of(s, 0.25), kind=b"stz2"), 0.25),
    "fragments": (lambda s: fragmented_mp4(samples_of(s, 1.0, 1.0)), 1.0),
    "fragments, from the start of the file": (lambda s: fragmented_mp4(samples_of(s, 1.0), "file"), 1.0),
    "fragments, after one another": (lambda s: fragmented_mp4(samples_of(s, 1.0), "before"), 1.0),
    "fragments by ffmpeg, first time lost": (
        lambda s: fragmented_mp4(samples_of(s, 1.0, 1.0), first_s=0.0),
        1.0,
    ),
    "fragments by Bento4, edits lost": (lambda s: fragmented_mp4(samples_of(s, 0.0, 1.0)), 1.0),
    "ts by ffmpeg": (lambda s: transport_stream([(t, triplet(d)) for t, d in samples_of(s, 1.0, 1.0)]), 1.0),
    "ts by ffmpeg from mp4": (lambda s: transport_stream(samples_of(s, 1.0, 1.0)), 1.0),
    "ts, taken for pictures": (lambda s: transport_stream(samples_of(s, 1.0, 1.0), stream=0xE1), 1.0),
    "ts, metadata in access units": (
        lambda s: transport_stream(
            [(t, triplet(d)) for t, d in samples_of(s, 1.0)], stream=0xFC, label=b"\0\0\xdf\0\0"
        ),
        1.0,
    ),
    "ts, divided samples": (
        lambda s: transport_stream(
            [(t, triplet(d)) for t, d in samples_of(s, 0.5)], pes_bytes=300, stuffing=7
        ),
        0.5,
    ),
    "ts, divided samples with times": (
        lambda s: transport_stream(
            [
                (t + n / 90000, triplet(d)[a : a + 300])
                for t, d in samples_of(s, 0.5)
                for n, a in enumerate(range(0, len(triplet(d)), 300))
            ]
        ),
        0.5,
    ),
    "ts, divided samples without triplets": (
        lambda s: transport_stream(samples_of(s, 0.5), pes_bytes=300),
        0.5,
    ),
    "ts of a disc": (lambda s: transport_stream(samples_of(s, 0.5), step=192), 0.5),
    "ts with parity": (lambda s: transport_stream(samples_of(s, 0.5), step=204), 0.5),
    "ts by GStreamer, an hour on": (lambda s: transport_stream(samples_of(s, 0.5), picture_s=3600.0), 0.5),
    "ts, clock wraps": (lambda s: transport_stream(samples_of(s, 1.0), picture_s=95443.0), 1.0),
    "ts, packets twice": (lambda s: transport_stream(samples_of(s, 1.0), repeats=2), 1.0),
    "mkv by mkvmerge": (lambda s: matroska([b"a picture", whole(s, 1.0)]), 1.021),
    "mkv, live": (lambda s: matroska([whole(s, 1.0)], is_live=True), 1.021),
}


@pytest.mark.parametrize("name", MOVIES)
def test_touch_is_found_in_sync_and_equal_to_the_byte(stream: bytes, tmp_path: Path, name: str) -> None:
    make, at_s = MOVIES[name]
    (tmp_path / "movie").write_bytes(make(stream))
    done = demux(tmp_path / "movie", tmp_path / "back.touch")
    assert (tmp_path / "back.touch").read_bytes() == stream
    assert done.at_s == pytest.approx(at_s, abs=1.5e-3) and done.segments == 3
    lost = ("The time of the touch is lost in the movie: its own record of the start is used.",)
    assert done.notes == (lost if name == "fragments by Bento4, edits lost" else ())


def test_start_of_a_single_sample_is_that_of_its_record(tmp_path: Path, stream: bytes) -> None:
    """One sample whose time is lost cannot be corrected by others."""
    [(_, part)] = one = [(0.0, b"".join(part for _, part in samples_of(stream, 0.0, 1.0)))]
    assert part.endswith(samples_of(stream, 0.0)[-1][1])
    (tmp_path / "one.mp4").write_bytes(fragmented_mp4(one))
    done = demux(tmp_path / "one.mp4", tmp_path / "back.touch")
    assert done.at_s == 1.0 and "its own record of the start is used" in done.notes[0]
    (tmp_path / "old.mp4").write_bytes(fragmented_mp4([(0.0, part.replace(sync_record(1.0), b""))]))
    assert demux(tmp_path / "old.mp4", tmp_path / "back.touch").at_s == 0.0
    assert (tmp_path / "back.touch").read_bytes() == stream


def test_a_cut_movie_has_the_time_of_its_samples_and_a_note(tmp_path: Path, stream: bytes) -> None:
    (tmp_path / "cut.mp4").write_bytes(plain_mp4(samples_of(stream, 0.4, 1.0), picture_ms=0))
    done = demux(tmp_path / "cut.mp4", tmp_path / "back.touch")
    assert done.at_s == pytest.approx(0.4)
    assert "started 1.000 s after the first picture and now starts 0.400 s after it" in done.notes[0]


def test_a_record_of_another_start_stays_in_the_file(tmp_path: Path, stream: bytes) -> None:
    """A sidecar that is muxed has the record of its own start, which belongs to the file."""
    again = whole(stream, 7.0)
    (tmp_path / "both.mp4").write_bytes(plain_mp4(samples_of(again, 1.021, 1.0)))
    done = demux(tmp_path / "both.mp4", tmp_path / "back.touch")
    assert (tmp_path / "back.touch").read_bytes() == again and done.at_s == pytest.approx(1.021)
    (tmp_path / "again.touch").write_bytes(again)
    with TouchReader(tmp_path / "again.touch") as reader:  # an optional record: format 1.0 skips it
        assert len(reader.segments) == 3 and reader.read_vibration(0) is not None


def test_spare_samples_at_the_end_may_be_lost(tmp_path: Path, stream: bytes) -> None:
    record, whole_track = sync_record(1.0), samples_of(stream, 1.021, 1.0)
    for spare in range(4):
        ends = [(1.7 + 0.01 * i, record) for i in range(spare)]
        (tmp_path / "both.mp4").write_bytes(plain_mp4([*whole_track, *ends]))
        assert demux(tmp_path / "both.mp4", tmp_path / "back.touch").at_s == pytest.approx(1.021)
        assert (tmp_path / "back.touch").read_bytes() == stream
    (tmp_path / "both.mp4").write_bytes(plain_mp4(whole_track[:-1]))
    with pytest.raises(CorruptFile, match="found 4 frames; expected 6"):
        demux(tmp_path / "both.mp4", tmp_path / "back.touch")


def test_the_sidecar_takes_the_place_of_a_dropped_track(
    tmp_path: Path, stream: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    movie, back = tmp_path / "film.mp4", tmp_path / "back.touch"
    movie.write_bytes(plain_mp4([(0.0, b"text"), (1.0, b"more text")]))
    with pytest.raises(SourceError, match=r"no track of touch.*-map 0 -c copy.*film\.touch"):
        demux(movie, back)
    (tmp_path / "film.touch").write_bytes(whole(stream, 1.0))
    done = demux(movie, back)
    assert back.read_bytes() == stream and done.at_s == pytest.approx(1.021)
    assert done.notes == ("The movie has no touch: film.touch next to it is used.",)
    with pytest.raises(InvalidArgument, match="the file that is read"):
        demux(movie, tmp_path / "film.touch")
    (tmp_path / "film.touch").write_bytes(stream)
    assert _exit_code(["demux", str(movie), str(back)]) == 0
    assert "has no record of its start: 0 s is assumed" in " ".join(capsys.readouterr().out.split())
    assert back.read_bytes() == stream


@pytest.mark.parametrize("form", ["ts", "mp4"])
def test_a_playlist_is_read_through_its_parts(tmp_path: Path, stream: bytes, form: str) -> None:
    made = samples_of(stream, 1.0, 1.0)
    data = transport_stream(made) if form == "ts" else fragmented_mp4(made)
    cut = len(data) // 2 // 188 * 188 if form == "ts" else data.index(b"moof") - 4
    (tmp_path / "part 0").write_bytes(data[:cut])
    (tmp_path / "part1").write_bytes(data[cut:])
    first = "part%200\n" if form == "ts" else '#EXT-X-MAP:URI="part%200"\n'
    list_ = tmp_path / "film.m3u8"
    list_.write_text(f"#EXTM3U\n{first}#EXTINF:2,\npart1\n#EXTINF:2,\npart1\n#EXT-X-ENDLIST\n")
    assert demux(list_, tmp_path / "back.touch").at_s == pytest.approx(1.0)
    assert (tmp_path / "back.touch").read_bytes() == stream
    for text, message in (
        ("/etc/hostname", "a file in the folder"),
        ("../outside.ts", "a file in the folder"),
        ("http://example.org/x.ts", "no file 'x.ts'"),
        ("absent.ts", "no file 'absent.ts'"),
        ("#EXT-X-STREAM-INF:BANDWIDTH=1\nlow.m3u8", "a playlist of playlists"),
        ("# nothing", "a playlist without parts"),
    ):
        list_.write_text(f"#EXTM3U\n{text}\n")
        with pytest.raises(SourceError, match=message):
            demux(list_, tmp_path / "x.touch")
    assert not (tmp_path / "x.touch").exists()


def hostile(stream: bytes) -> dict[str, bytes]:
    """Movies that state more than their bytes hold."""
    start = samples_of(stream, 0.0)[0][1]
    ftyp, many = box(b"ftyp", b"isom", words(512)), 0xFFFFFFFF
    mvhd = full(b"mvhd", words(0, 0, 1000, 0), bytes(80))
    mdat = box(b"mdat", start)
    at = len(ftyp) + 8

    def tables(stsz: bytes, offset: int = at, stsc: tuple[int, ...] = (1, many, 1)) -> bytes:
        rows = full(b"stsc", words(1, *stsc)) + full(b"stco", words(1, offset))
        moov = box(b"moov", mvhd, trak(1, b"meta", b"gpmd", stsz + rows))
        return ftyp + mdat + moov

    def fragment(flags: int, run: bytes, header: bytes = b"", default: int = 0) -> bytes:
        trex = full(b"trex", words(1, 1, 0, default, 0))
        moov = box(b"moov", mvhd, trak(1, b"meta", b"gpmd", stbl([], [])), box(b"mvex", trex))
        traf = box(b"traf", full(b"tfhd", words(1), header, flags=0x1), full(b"trun", run, flags=flags))
        return ftyp + mdat + moov + box(b"moof", traf)

    position = struct.pack(">Q", at)
    return {
        "equal sizes": tables(full(b"stsz", words(len(start), many))),
        "one byte each": tables(full(b"stsz", words(17, many)), stsc=(1, many, 1)),
        "one place": ftyp + mdat + box(b"moov", mvhd, trak(1, b"meta", b"gpmd", stbl(
            [(0.1 * i, start) for i in range(3000)], [at] * 3000))),
        "beyond the end": tables(full(b"stsz", words(0, 1, many))),
        "empty samples": tables(full(b"stsz", words(0, 2, len(start), 0))),
        "stated count": tables(full(b"stsz", words(0, many, len(start)))),
        "no chunk": tables(full(b"stsz", words(0, 1, len(start))), stsc=(many, 1, 1)),
        "run without rows": fragment(0, words(many), position, len(start)),
        "run of empty samples": fragment(0, words(many), position, 0),
        "run with too few rows": fragment(0x200, words(many, len(start)), position),
        "box longer than its parent": ftyp + mdat + struct.pack(">I4s", 16, b"moov") + words(many, 0),
        "box of four bytes": ftyp + words(4) + b"free" + mdat,
        "box of 2^64 bytes": ftyp + words(1) + b"moov" + b"\xff" * 8,
        "triplet of 2^32 bytes": b"".join(packets(pes(KLV + words(many) + start, 0xBD, 0), 258)) * 2,
        "attachment cut": matroska([start])[:-20],
        "element without end": matroska([])[:40] + b"\0\0\0",
        "record of a start that is no number": plain_mp4(samples_of(stream, 1.0, float("nan"))),
    }  # fmt: skip


def test_hostile_movies_give_one_error_and_no_file(stream: bytes, tmp_path: Path) -> None:
    back = tmp_path / "back.touch"
    for name, data in hostile(stream).items():
        (tmp_path / "movie").write_bytes(data)
        with pytest.raises(TouchfieldError) as caught:
            demux(tmp_path / "movie", back)
        assert str(tmp_path / "movie") in str(caught.value), name
        assert not back.exists(), name


@pytest.mark.parametrize("name", ["mp4 by ffmpeg", "fragments", "ts by ffmpeg", "mkv by mkvmerge"])
def test_cut_and_changed_movies_give_an_error_or_the_file(stream: bytes, tmp_path: Path, name: str) -> None:
    data, rng = MOVIES[name][0](stream), np.random.default_rng(7)
    cuts = [data[:size] for size in np.linspace(0, len(data) - 1, 60, dtype=int)]
    spoilt = list[bytes]()
    for _ in range(120):
        changed = bytearray(data)
        for at in rng.integers(0, len(data), 5):
            changed[at] = rng.integers(256)
        spoilt.append(bytes(changed))
    refused = 0
    for case in cuts + spoilt:
        (tmp_path / "movie").write_bytes(case)
        try:
            demux(tmp_path / "movie", tmp_path / "back.touch")
        except TouchfieldError:
            refused += 1
        else:
            assert (tmp_path / "back.touch").read_bytes() == stream
            (tmp_path / "back.touch").unlink()
        assert not (tmp_path / "back.touch").exists()
    assert refused > 60


def test_other_files_are_named(tmp_path: Path, stream: bytes) -> None:
    for data in (stream, b"", b"RIFF" + bytes(300)):
        (tmp_path / "movie.avi").write_bytes(data)
        with pytest.raises(SourceError, match=r"movie\.avi: found a file that starts with"):
            demux(tmp_path / "movie.avi", tmp_path / "x.touch")
