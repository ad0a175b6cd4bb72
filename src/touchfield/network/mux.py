"""Adds a ``.touch`` file to a movie as a track in time with sound and picture, and extracts it again (paper
section 6).

The samples of the track are the file, divided after each of its segments; the time of a sample is that of its
first frame. Index and end are rebuilt on extraction, so that the extracted file equals the original byte for
byte. Players without support for touch play the other tracks as before. Receivers may join an MPEG-TS stream
at any time. Each sample of it therefore starts with the head, and is the value of a KLV triplet (SMPTE 336M),
since ffmpeg takes some data without a registered name for video.

A DASH manifest (ISO/IEC 23009-1) has sound and picture as ffmpeg segments them. The touch is an AdaptationSet
whose single Representation is the whole ``.touch`` file, as for captions; receivers read ranges of it. A
SupplementalProperty gives the time of the movie, in seconds, at which the touch starts.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final
from xml.sax.saxutils import escape

from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.container import SegmentEntry, TouchReader
from touchfield.container.records import MAGIC, OBJECTS_CODER, Segment
from touchfield.container.wire import (
    CRC_SIZE,
    OPENING_SIZE,
    ByteSource,
    read_opening,
    read_record,
    records_between,
)
from touchfield.container.writer import index_and_end
from touchfield.errors import (
    CorruptFile,
    InvalidArgument,
    SourceError,
    import_extra,
    reason,
    require_ending,
    warn_unbounded,
)
from touchfield.files import readable, refuse_overwriting
from touchfield.network.live import MEDIA_TYPE
from touchfield.pipeline.decoding import stream_of

START_SCHEME: Final = "urn:touchfield:begins-s"
_CLOCK: Final = Fraction(1, 90000)
_MAX_BYTES: Final = 1 << 30
"""Maximum size of the touch that is extracted from a movie."""

_KLV: Final = bytes.fromhex("060e2b34010101010f00") + b"touch\1\x84"
"""Key of a triplet, and the first byte of its length: four bytes follow, big-endian."""

_FORMS: Final = (".mp4", ".m4v", ".mov", ".ts", ".mpd")


@dataclass(frozen=True)
class Muxed:
    """Counts of a stream that was muxed into a movie or extracted from it."""

    file: str
    segments: int
    touch_bytes: int
    touch_seconds: float
    at_s: float
    other_tracks: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Return the counts as a dictionary; its keys are stable."""
        return {**self.__dict__, "other_tracks": list(self.other_tracks)}


def mux(
    movie: str | Path, stream: str | Path, out: str | Path, at_s: float = 0.0, report: Progress = silent
) -> Muxed:
    """Mux a ``.touch`` file with the tracks of a movie, which are copied unchanged.

    Raises InvalidArgument if the suffix of `out` is not supported, or the format cannot contain a track of
    the movie; SourceError, FormatError if the movie or the stream cannot be read.

    Parameters
    ----------
    movie : path
        A movie that ffmpeg reads.
    stream : path
    out : path
        .mp4 (fragmented, for streaming), .mov or .ts; or .mpd, a DASH manifest, written with the files that
        it names.
    at_s : float
        The movie's time at which the touch begins, 0 or later.
    report : callable
        ``report(done, total)`` in segments.
    """
    out = Path(out)
    if out.suffix.lower() not in _FORMS:
        raise InvalidArgument(str(out), f"the ending {out.suffix!r}", f"one of {', '.join(_FORMS)}")
    if not 0 <= at_s < 1e6:
        raise InvalidArgument("--at-s", f"{at_s:g}", "0 or more seconds of the movie")
    refuse_overwriting(out, movie, stream)
    kind = out.suffix.lower()
    with TouchReader(stream) as reader, _opened(movie) as source:
        warn_unbounded(stream_of(reader).error_bound().get("error_bound_note"))
        seconds = reader.head.frame_count / reader.head.rate_hz
        if kind == ".mpd":
            names = _write_dash(source, Path(stream), out, at_s, 8 * reader.size / seconds)
            return Muxed(str(out), len(reader.segments), reader.size, seconds, at_s, names)
        samples = list(_samples(reader, at_s, is_ts=kind == ".ts"))
        options = {"movflags": "frag_keyframe+delay_moov+default_base_moof"} if kind != ".ts" else {}
        tracks = [track for track in source.streams if track.type in ("video", "audio", "subtitle")]
        names = tuple(track.type for track in tracks)
        with atomic_path(out) as temporary:
            _copy(
                source, tracks, out, temporary, "mpegts" if kind == ".ts" else "mp4", options, samples, report
            )
    size = sum(len(data) for _, _, data in samples)
    return Muxed(str(out), len(samples), size, seconds, at_s, names)


def demux(movie: str | Path, out: str | Path) -> Muxed:
    """Extract the ``.touch`` file of a movie; each segment is checked.

    Raises SourceError if the movie cannot be read, or has no touch; FormatError if the touch is damaged, or
    its beginning is missing.
    """
    require_ending(out, "OUT.touch")
    if Path(movie).suffix.lower() == ".mpd":
        hint = f"Its touch is in the file next to it: {Path(movie).with_suffix('.touch').name}."
        raise InvalidArgument(str(movie), "a DASH manifest", "a movie with touch in it", hint)
    with _opened(movie) as source:
        samples, at_s = _touch_samples(source, str(movie))
    file: Any = BytesIO(_join_samples(samples, str(movie)))
    file.name = str(movie)
    with TouchReader(file) as reader, atomic_path(Path(out)) as temporary:
        for i in range(reader.object_count):
            reader.read_object(i)
        for i in range(len(reader.segments)):
            reader.read_vibration(i)
        temporary.write_bytes(file.getvalue())
        seconds = reader.head.frame_count / reader.head.rate_hz
    return Muxed(str(out), len(reader.segments), sum(map(len, samples)), seconds, at_s)


_Sample = tuple[float, float, bytes]
"""Start in the movie in seconds, duration in seconds, and bytes."""


def _samples(reader: TouchReader, at_s: float, is_ts: bool) -> Iterator[_Sample]:
    data, start, rate_hz = reader.read_all(), 0, reader.head.rate_hz
    head_end = reader.segments[0].offset
    for i, entry in enumerate(reader.segments):
        stop = entry.offset + entry.length
        sample = data[start:stop]
        if is_ts:
            head = data[:head_end] if i and reader.head.coder != OBJECTS_CODER else b""
            sample = _KLV + (len(head) + len(sample)).to_bytes(4, "big") + head + sample
        yield at_s + entry.first_frame / rate_hz, entry.frame_count / rate_hz, sample
        start = stop


def _copy(
    source: Any,
    source_tracks: list[Any],
    out: Path,
    temporary: Path,
    form: str,
    options: dict[str, str],
    samples: Sequence[_Sample] = (),
    report: Progress = silent,
) -> None:
    """Copy the packets of some tracks of a movie and, between them in time, the samples, if there are any."""
    import av

    waiting = list(reversed(samples))
    try:
        with av.open(str(temporary), "w", format=form, options=options) as sink:
            tracks = {track.index: sink.add_stream_from_template(track) for track in source_tracks}
            touch: Any = sink.add_data_stream("klv" if form == "mpegts" else "bin_data") if samples else None

            def put(until_s: float) -> None:
                while waiting and waiting[-1][0] <= until_s:
                    start_s, length_s, data = waiting.pop()
                    packet = av.Packet(data)
                    packet.stream, packet.time_base = touch, _CLOCK
                    packet.pts = packet.dts = round(start_s / _CLOCK)
                    packet.duration = round(length_s / _CLOCK)
                    sink.mux(packet)
                    report(len(samples) - len(waiting), len(samples))

            if touch is not None:
                touch.time_base = _CLOCK
            for packet in source.demux(source_tracks):
                if packet.dts is None:
                    continue
                put(float(packet.dts * packet.time_base))
                packet.stream = tracks[packet.stream.index]
                sink.mux(packet)
            put(float("inf"))
    except (av.FFmpegError, ValueError) as error:
        raise InvalidArgument(str(out), str(error), "a form that holds the tracks of the movie") from None


def _touch_samples(source: Any, name: str) -> tuple[list[bytes], float]:
    """Return the samples of the first touch track from its first head on, and their start in the movie, s."""
    movie_start_s = min(
        (
            float(sample_track.start_time * sample_track.time_base)
            for sample_track in source.streams
            if sample_track.start_time
        ),
        default=0.0,
    )
    times: dict[int, float] = {}
    data = [sample_track for sample_track in source.streams if sample_track.type == "data"]
    tracks: dict[int, list[bytearray]] = {}
    size = 0
    for packet in source.demux(data) if data else ():
        track = tracks.setdefault(packet.stream.index, [])
        start = len(_KLV) + 4 if bytes(packet).startswith(_KLV) else 0
        if not packet.size or not (track or bytes(packet)[start:].startswith(MAGIC)):
            continue
        times.setdefault(packet.stream.index, float((packet.pts or 0) * packet.time_base))
        size += packet.size
        if size > _MAX_BYTES:
            raise SourceError(name, f"more than {_MAX_BYTES} bytes of touch", "less")
        if packet.pts is None and track:  # MPEG-TS stores a long sample in several packets
            track[-1] += bytes(packet)
        else:
            track.append(bytearray(packet)[start:])
    first = next(((index, track) for index, track in tracks.items() if track), None)
    if first is None:
        raise SourceError(name, "no track of touch", "a movie that touchfield mux made")
    return [bytes(sample_track) for sample_track in first[1]], max(
        0.0, times[first[0]] - (movie_start_s if name.endswith(".ts") else 0.0)
    )


def _join_samples(samples: list[bytes], name: str) -> bytes:
    """Join samples, the first of which starts with the head, to a file; index and end are rebuilt."""

    def source_of(data: bytes, where: str) -> ByteSource:
        file: Any = BytesIO(data)
        file.name = where
        return ByteSource(file)

    first = source_of(samples[0], f"{name}: sample 0")
    read_opening(first)
    records = records_between(first, OPENING_SIZE, first.size)
    head = samples[0][: next((found.offset for found in records if found.tag == "SEGM"), None)]
    for number, sample in enumerate(samples):
        if sample.startswith(MAGIC) and not sample.startswith(head):
            raise CorruptFile(f"{name}: sample {number}", "another head", "the first one's")
    data = head + b"".join(sample.removeprefix(head) for sample in samples)
    entries, chain, source = list[SegmentEntry](), data[:OPENING_SIZE], source_of(data, name)
    for found in records_between(source, OPENING_SIZE, source.size):
        if found.tag in ("HEAD", "OBJT"):
            chain += source.read_at(found.crc_offset, CRC_SIZE)
        elif found.tag == "SEGM":
            segment, crc32 = read_record(source, found, Segment)
            frames = {"first_frame": segment.first_frame, "frame_count": segment.frame_count}
            length = found.end - found.offset
            entries.append(SegmentEntry(**frames, offset=found.offset, length=length, crc32=crc32))
    if entries and entries[0].first_frame:
        found_late = f"touch from frame {entries[0].first_frame} on"
        raise CorruptFile(name, found_late, "its beginning", "Take the whole movie.")
    return data + index_and_end(entries, len(data), chain)


@contextmanager
def _opened(movie: str | Path) -> Iterator[Any]:
    av = import_extra("av", "touch in a movie", "av", "video")
    try:
        source = av.open(str(movie))
    except (av.FFmpegError, OSError, ValueError) as error:
        raise SourceError(str(movie), reason(error), "a movie that ffmpeg reads") from None
    with source:
        yield source


def _write_dash(source: Any, stream: Path, out: Path, at_s: float, rate_bits: float) -> tuple[str, ...]:
    """Write NAME.mpd, tracks as NAME-N.mp4 and the stream as NAME.touch; return the types of the tracks."""
    tracks = [track for track in source.streams if track.type in ("video", "audio")]
    names = {"single_file": "1", "single_file_name": f"{out.stem}-$RepresentationID$.mp4"}
    with TemporaryDirectory(prefix=".touchfield-", dir=out.parent) as folder:
        manifest = Path(folder) / out.name
        _copy(source, tracks, out, manifest, "dash", names)
        _add_touch(manifest, at_s, rate_bits)
        with readable(out, "a folder that can be written"):
            shutil.copyfile(stream, Path(folder) / f"{out.stem}.touch")
            for path in Path(folder).iterdir():
                if (out.parent / path.name).exists() and (out.parent / path.name).samefile(source.name):
                    raise InvalidArgument(
                        str(out.parent / path.name), "the movie that is read", "another name"
                    )
            for path in sorted(
                Path(folder).iterdir(), key=lambda path: path.suffix == ".mpd"
            ):  # the manifest last, after the files that it names
                os.replace(path, out.parent / path.name)
    return tuple(track.type for track in tracks)


def _add_touch(manifest: Path, at_s: float, rate_bits: float) -> None:
    """Add the AdaptationSet of the touch to a manifest of one period that ffmpeg wrote."""
    stem = escape(manifest.stem)
    touch = f"""\t<AdaptationSet contentType="application" mimeType="{MEDIA_TYPE}">
\t\t\t<SupplementalProperty schemeIdUri="{START_SCHEME}" value="{at_s:g}"/>
\t\t\t<Representation id="touch" bandwidth="{max(1, round(rate_bits))}">
\t\t\t\t<BaseURL>{stem}.touch</BaseURL>
\t\t\t</Representation>
\t\t</AdaptationSet>
\t</Period>"""
    text = manifest.read_text("utf-8").replace(manifest.stem, stem)  # ffmpeg does not escape the name
    manifest.write_text(text.replace("</Period>", touch), "utf-8")
