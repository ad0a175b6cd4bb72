"""Adds a ``.touch`` file to a movie as a track in time with sound and picture (paper section 6).

The samples of the track are the file, divided after each of its segments; the time of a sample is that of its
first frame. Index and end are rebuilt on extraction (`demux`), so that the extracted file equals the original
byte for byte. Several programs lose the start of a track when they copy it, so the touch states it as well.
Players without support for touch play the other tracks as before. Receivers may join an MPEG-TS stream at any
time. Each sample of it therefore starts with the head, and is the value of a KLV triplet (SMPTE 336M), since
ffmpeg takes some data without a registered name for video. In Matroska, which has no tracks for data, the
touch is an attachment.

A DASH manifest (ISO/IEC 23009-1) has sound and picture as ffmpeg segments them. The touch is an AdaptationSet
whose single Representation is the whole ``.touch`` file, as for captions; receivers read ranges of it. A
SupplementalProperty gives the time of the movie, in seconds, at which the touch starts.
"""

from __future__ import annotations

import os
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from fractions import Fraction
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import escape

from touchfield.atomic import atomic_path, temporary_folder
from touchfield.compute.threads import Progress, silent
from touchfield.container import TouchReader
from touchfield.container.records import OBJECTS_CODER
from touchfield.errors import InvalidArgument, import_extra, warn_unbounded
from touchfield.files import file_error, readable, refuse_overwriting
from touchfield.network.live import MEDIA_TYPE
from touchfield.network.touch_track import KLV, sync_record, with_sync
from touchfield.pipeline.decoding import stream_of

START_SCHEME: Final = "urn:touchfield:begins-s"
_CLOCK: Final = Fraction(1, 90000)
_PES_BYTES: Final = 60_000
"""GStreamer drops data of an MPEG-TS that is longer than a PES packet of stated length, 65535 bytes."""

_MAX_BYTES: Final = 1 << 62
_WEBM_ONLY: Final = {"vp8", "vorbis"}
_SPARE_SAMPLES: Final = 8
_SPARE_S: Final = 0.01
"""Each time that ffmpeg 5 copies its own copy of an MP4, it drops the last sample of a track for data. So
many samples at the end, at this distance, hold only the record of the start, and are no loss.
"""

_FILES: Final = (".mp4", ".m4v", ".mov", ".ts", ".mkv")
_FORMS: Final = (*_FILES, ".mpd")
_WITHOUT_TOUCH: Final = (".webm", ".avi")
_NO_TOUCH: Final = "It has neither tracks of data nor attachments; .mkv holds the same picture and sound."
_LABEL: Final = "touch: {}"
_DASH_TYPES: Final = ("video", "audio")
_COPIED_TYPES: Final = (*_DASH_TYPES, "subtitle")


@dataclass(frozen=True)
class Muxed:
    """Counts of a stream that was muxed into a movie or extracted from it."""

    file: str
    segments: int
    touch_bytes: int
    touch_seconds: float
    at_s: float
    other_tracks: tuple[str, ...] = ()
    sidecars: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Return the counts as a dictionary, without the notes; its keys are stable."""
        values = {**self.__dict__, "other_tracks": list(self.other_tracks), "sidecars": list(self.sidecars)}
        del values["notes"]
        return values


@dataclass(frozen=True)
class TimedStream:
    """A ``.touch`` file for a movie.

    path : Path
    start_s : float
        When frame 0 shows on the clock of the movie's tracks, seconds.
    name : str
        Label of its track, such as "sound".
    """

    path: Path
    start_s: float
    name: str


def mux(
    movie: str | Path,
    stream: str | Path,
    out: str | Path,
    at_s: float = 0.0,
    report: Progress = silent,
    has_sidecar: bool = False,
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
        .mp4 (fragmented, for streaming), .mov or .ts; .mkv, where the touch is an attachment; or .mpd, a DASH
        manifest, written with the files that it names.
    at_s : float
        The movie's time at which the touch begins, 0 or later.
    report : callable
        ``report(done, total)`` in segments.
    has_sidecar : bool
        Write the touch also to a file next to `out`, with the ending .touch, for programs that drop its
        track. It contains the time at which it begins.
    """
    out = Path(out)
    kind = out.suffix.lower()
    sidecar = out.with_suffix(".touch") if has_sidecar else None
    _check(out, at_s, sidecar)
    refuse_overwriting(out, movie, stream)
    if sidecar is not None:
        refuse_overwriting(sidecar, movie, stream)
    with TouchReader(stream) as reader, _opened(movie) as source:
        warn_unbounded(stream_of(reader).error_bound().get("error_bound_note"))
        seconds = reader.head.frame_count / reader.head.rate_hz
        if kind == ".mpd":
            names = _write_dash(source, Path(stream), out, at_s, 8 * reader.size / seconds)
            notes = _left_out_notes(source, _DASH_TYPES)
            return Muxed(str(out), len(reader.segments), reader.size, seconds, at_s, names, notes=notes)
        notes = _left_out_notes(source, _COPIED_TYPES)
        zero_s, picture_s = _starts_s(source)
        start_s = zero_s + at_s - picture_s
        touch = _Touch(reader, zero_s + at_s, start_s)
        sizes, names = _write_movie(source, [touch], out, report)
        if sidecar is not None:
            with atomic_path(sidecar) as temporary:
                temporary.write_bytes(_with_sync(reader, start_s))
    files = () if sidecar is None else (str(sidecar),)
    return Muxed(str(out), len(reader.segments), sizes[0], seconds, at_s, names, files, notes)


def mux_streams(
    movie: str | Path, streams: Sequence[TimedStream], out: str | Path, report: Progress = silent
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Mux several ``.touch`` files with the tracks of a movie, which are copied unchanged; each has a track.

    `out` is .mp4, .m4v, .mov, .ts or .mkv. Returns the bytes of each touch in the movie, and the types of the
    tracks that were copied. Raises as `mux` does.
    """
    out = Path(out)
    require_movie(out)
    refuse_overwriting(out, movie, *(stream.path for stream in streams))
    with ExitStack() as stack:
        source = stack.enter_context(_opened(movie))
        _, picture_s = _starts_s(source)
        touches = list[_Touch]()
        for stream in streams:
            reader = stack.enter_context(TouchReader(stream.path))
            warn_unbounded(stream_of(reader).error_bound().get("error_bound_note"))
            touches.append(_Touch(reader, stream.start_s, stream.start_s - picture_s, stream.name))
        return _write_movie(source, touches, out, report)


def after_picture_s(movie: str | Path, at_s: float) -> float:
    """Convert a second of a movie to seconds after its first picture, as `TimedStream` has them."""
    with _opened(movie) as source:
        zero_s, picture_s = _starts_s(source)
    return zero_s + at_s - picture_s


def require_movie(out: Path) -> None:
    """Raise InvalidArgument unless `out` ends as a movie that holds several tracks of touch does."""
    if out.suffix.lower() not in _FILES:
        hint = _NO_TOUCH if out.suffix.lower() in _WITHOUT_TOUCH else ""
        raise InvalidArgument(str(out), f"the ending {out.suffix!r}", f"one of {', '.join(_FILES)}", hint)


def _check(out: Path, at_s: float, sidecar: Path | None) -> None:
    kind = out.suffix.lower()
    if kind not in _FORMS:
        hint = _NO_TOUCH if kind in _WITHOUT_TOUCH else ""
        raise InvalidArgument(str(out), f"the ending {out.suffix!r}", f"one of {', '.join(_FORMS)}", hint)
    if not 0 <= at_s < 1e6:
        raise InvalidArgument("--at-s", f"{at_s:g}", "0 or more seconds of the movie")
    if sidecar is not None and kind == ".mpd":
        hint = "The manifest has the touch in a file of its own already."
        raise InvalidArgument("--sidecar", "a DASH manifest", "a movie in one file", hint)


def _left_out_notes(source: Any, types: Sequence[str]) -> tuple[str, ...]:
    """A note on the tracks of a movie that are of none of these types, and so are not copied."""
    counts = Counter(track.type or "unknown" for track in source.streams if track.type not in types)
    if not counts:
        return ()
    kinds = ", ".join(f"{count} of type {kind}" for kind, count in counts.items())
    return (f"Not all tracks of the movie are copied: {kinds} left out.",)


def _starts_s(source: Any) -> tuple[float, float]:
    """When a movie starts on the clock of its tracks, and when its first picture or else sound shows."""
    starts = {"video": list[float](), "audio": list[float]()}
    for track in source.streams:
        if track.type in starts and track.start_time is not None:
            starts[track.type].append(float(track.start_time * track.time_base))
    picture_s = min(starts["video"] or starts["audio"] or [0.0])
    return picture_s if source.format.name == "mpegts" else 0.0, picture_s


@dataclass(frozen=True)
class _Touch:
    """A stream that starts at `first_s` on the clock of a movie, and at `start_s` after its first picture."""

    reader: TouchReader
    first_s: float
    start_s: float
    name: str = ""


def _write_movie(
    source: Any, touches: Sequence[_Touch], out: Path, report: Progress
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Write a movie with touch; return the bytes of each touch, and the types of the other tracks."""
    kind = out.suffix.lower()
    form = {".ts": "mpegts", ".mkv": "matroska"}.get(kind, "mp4")
    options = {"movflags": "frag_keyframe+delay_moov+default_base_moof"} if form == "mp4" else {}
    tracks = [track for track in source.streams if track.type in _COPIED_TYPES]
    timed, attached = list[_TimedTrack](), list[tuple[str, bytes]]()
    for touch in touches:
        if form == "matroska":
            data = _with_sync(touch.reader, touch.start_s)
            attached.append((f"{touch.name or 'movie'}.touch", data))
        else:
            timed.append((touch.name, list(_samples(touch, is_ts=form == "mpegts"))))
    with atomic_path(out) as temporary:
        _copy(source, tracks, out, temporary, form, options, timed, report, attached)
    sizes = tuple(
        [len(data) for _, data in attached]
        or [sum(len(data) for _, _, data in samples) for _, samples in timed]
    )
    return sizes, tuple(track.type for track in tracks)


_Sample = tuple[float, float, bytes]
"""Start in the movie in seconds, duration in seconds, and bytes."""

_TimedTrack = tuple[str, list[_Sample]]
"""Name of a track of touch, and its samples in the order of time."""


def _samples(touch: _Touch, is_ts: bool) -> Iterator[_Sample]:
    reader, first_s, start_s = touch.reader, touch.first_s, touch.start_s
    data, position, rate_hz = reader.read_all(), 0, reader.head.rate_hz
    head = data[: reader.segments[0].offset] + sync_record(start_s)
    for i, entry in enumerate(reader.segments):
        stop = entry.offset + entry.length
        sample = data[position:stop] if i else head + data[entry.offset : stop]
        if is_ts:
            again = head if i and reader.head.coder != OBJECTS_CODER else b""
            sample = KLV + (len(again) + len(sample)).to_bytes(4, "big") + again + sample
        yield first_s + entry.first_frame / rate_hz, entry.frame_count / rate_hz, sample
        position = stop
    sync = sync_record(start_s)
    end = KLV + len(sync).to_bytes(4, "big") + sync if is_ts else sync
    for i in range(_SPARE_SAMPLES):
        yield first_s + reader.head.frame_count / rate_hz + i * _SPARE_S, _SPARE_S, end


def _with_sync(reader: TouchReader, start_s: float) -> bytes:
    """The whole file with the record of its start."""
    last = reader.segments[-1]
    return with_sync(reader.read_all()[: last.offset + last.length], reader.segments[0].offset, start_s)


def _copy(
    source: Any,
    source_tracks: list[Any],
    out: Path,
    temporary: Path,
    form: str,
    options: dict[str, str],
    timed: Sequence[_TimedTrack] = (),
    report: Progress = silent,
    attached: Sequence[tuple[str, bytes]] = (),
) -> None:
    """Copy the packets of some tracks of a movie and, between them in time, the tracks of touch."""
    import av

    if attached and not hasattr(av.container.OutputContainer, "add_attachment"):
        hint = "Upgrade it: pip install --upgrade av"
        raise InvalidArgument(str(out), f"PyAV {av.__version__}", "one that can attach files", hint)
    try:
        with av.open(str(temporary), "w", format=form, options=options) as sink:
            tracks = {track.index: sink.add_stream_from_template(track) for track in source_tracks}
            writer = _TouchTracks(sink, timed, form, report)
            for name, data in attached:
                sink.add_attachment(name, MEDIA_TYPE, data)
            for packet in source.demux(source_tracks):
                if packet.dts is None:
                    continue
                writer.write(float(packet.dts * packet.time_base))
                packet.stream = tracks[packet.stream.index]
                sink.mux(packet)
            writer.write(float("inf"))
    except (av.FFmpegError, ValueError) as error:
        raise InvalidArgument(str(out), str(error), "a form that holds the tracks of the movie") from None


class _TouchTracks:
    """The tracks of touch of a movie that is written, and their samples that are not written yet."""

    def __init__(self, sink: Any, timed: Sequence[_TimedTrack], form: str, report: Progress) -> None:
        self._sink, self._report = sink, report
        self._piece = _PES_BYTES if form == "mpegts" else _MAX_BYTES
        self._tracks = [_touch_track(sink, name, form) for name, _ in timed]
        numbered = [[(*sample, n) for sample in samples] for n, (_, samples) in enumerate(timed)]
        self._waiting = list(merge(*numbered, key=itemgetter(0)))[::-1]
        self._total = len(self._waiting) - _SPARE_SAMPLES * len(timed)
        self._written = 0

    def write(self, until_s: float) -> None:
        """Write the samples that start up to a time of the movie, seconds."""
        import av

        while self._waiting and self._waiting[-1][0] <= until_s:
            start_s, length_s, data, number = self._waiting.pop()
            for i, start in enumerate(range(0, len(data), self._piece)):
                packet = av.Packet(data[start : start + self._piece])
                packet.stream, packet.time_base = self._tracks[number], _CLOCK
                packet.pts = packet.dts = round(start_s / _CLOCK) + i
                packet.duration = round(length_s / _CLOCK)
                self._sink.mux(packet)
            self._written += 1
            if self._written <= self._total:
                self._report(self._written, self._total)


def _touch_track(sink: Any, name: str, form: str) -> Any:
    track = sink.add_data_stream("klv" if form == "mpegts" else "bin_data")
    track.time_base = _CLOCK
    if name:
        track.metadata["handler_name"] = _LABEL.format(name)
    return track


@contextmanager
def _opened(movie: str | Path) -> Iterator[Any]:
    av = import_extra("av", "touch in a movie", "av", "video")
    try:
        source = av.open(str(movie))
    except (av.FFmpegError, OSError, ValueError) as error:
        raise file_error(movie, error, "a movie that ffmpeg reads") from None
    with source:
        yield source


def _write_dash(source: Any, stream: Path, out: Path, at_s: float, rate_bits: float) -> tuple[str, ...]:
    """Write NAME.mpd, tracks as NAME-N.mp4 and the stream as NAME.touch; return the types of the tracks."""
    tracks = [track for track in source.streams if track.type in _DASH_TYPES]
    names = {
        "single_file": "1",
        "single_file_name": f"{out.stem}-$RepresentationID$.mp4",
        "global_sidx": "1",
    }
    if not {track.codec_context.name for track in tracks} & _WEBM_ONLY:  # else the choice is ffmpeg's
        names["dash_segment_type"] = "mp4"
    with temporary_folder(out) as folder:
        manifest = folder / out.name
        _copy(source, tracks, out, manifest, "dash", names)
        text = _with_segment_bases(manifest.read_text("utf-8"), folder)
        manifest.write_text(_with_touch(text, out.stem, at_s, rate_bits), "utf-8")
        with readable(out, "a folder that can be written"):
            shutil.copyfile(stream, folder / f"{out.stem}.touch")
            for path in folder.iterdir():
                if (out.parent / path.name).exists() and (out.parent / path.name).samefile(source.name):
                    raise InvalidArgument(
                        str(out.parent / path.name), "the movie that is read", "another name"
                    )
            for path in sorted(
                folder.iterdir(), key=lambda path: path.suffix == ".mpd"
            ):  # the manifest last, after the files that it names
                os.replace(path, out.parent / path.name)
    return tuple(track.type for track in tracks)


def _with_segment_bases(manifest: str, folder: Path) -> str:
    """A manifest that refers to the index in each file (`sidx`) in place of ffmpeg's list of segments.

    ffmpeg itself does not read its lists of ranges, and other players need the times of the segments.
    """
    names = iter(re.findall(r"<BaseURL>([^<]*)</BaseURL>", manifest))

    def base(match: re.Match[str]) -> str:
        with (folder / next(names)).open("rb") as file:
            start = file.read(int(match[1]) + 1)
        index = start.rfind(b"sidx") - 4
        if index < 0:  # an ffmpeg that does not write one
            return match[0]
        return (
            f'<SegmentBase indexRange="{index}-{len(start) - 1}">'
            f'<Initialization range="0-{index - 1}"/></SegmentBase>'
        )

    lists = r'<SegmentList[^>]*>\s*<Initialization range="0-(\d+)" />.*?</SegmentList>'
    text = re.sub(lists, base, manifest, flags=re.DOTALL)
    text = text.replace("isoff-live:2011", "isoff-on-demand:2011")
    return text.replace("segmentAlignment=", "subsegmentAlignment=").replace(
        "startWithSAP=", "subsegmentStartsWithSAP="
    )


def _with_touch(manifest: str, stem: str, at_s: float, rate_bits: float) -> str:
    """A manifest of one period that ffmpeg wrote, with the AdaptationSet of the touch."""
    escaped = escape(stem)
    touch = f"""\t<AdaptationSet contentType="application" mimeType="{MEDIA_TYPE}">
\t\t\t<SupplementalProperty schemeIdUri="{START_SCHEME}" value="{at_s:g}"/>
\t\t\t<Representation id="touch" bandwidth="{max(1, round(rate_bits))}">
\t\t\t\t<BaseURL>{escaped}.touch</BaseURL>
\t\t\t</Representation>
\t\t</AdaptationSet>
\t</Period>"""
    return manifest.replace(stem, escaped).replace("</Period>", touch)  # ffmpeg does not escape the name
