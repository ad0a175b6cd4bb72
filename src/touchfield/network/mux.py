"""Adds a ``.touch`` file to a movie as a track in time with sound and picture (paper section 6).

The samples of the track are the file, divided after each of its segments; the time of a sample is that of its
first frame. Index and end are rebuilt on extraction (`demux`), so that the extracted file equals the original
byte for byte. Several programs lose the start of a track when they copy it, so the touch states it as well.
Players without support for touch play the other tracks as before. Receivers may join an MPEG-TS stream at any
time. Each sample of it therefore starts with the head, and is the value of a KLV triplet (SMPTE 336M), since
ffmpeg takes some data without a registered name for video. In Matroska, which has no tracks for data, the
touch is an attachment. `touchfield.network.dash` writes a movie as a DASH manifest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.container import TouchReader
from touchfield.container.map_record import MAP_LEFT_OUT
from touchfield.container.records import OBJECTS_CODER
from touchfield.errors import InvalidArgument, warn_unbounded
from touchfield.files import refuse_overwriting
from touchfield.network.dash import write_dash
from touchfield.network.movie_copy import (
    SPARE_S,
    SPARE_SAMPLES,
    MovieFile,
    MovieTouch,
    Sample,
    copy_movie,
    open_movie,
    tracks_of,
)
from touchfield.network.touch_track import KLV, sync_record, with_sync
from touchfield.pipeline.decoding import stream_of

_FILES: Final = (".mp4", ".m4v", ".mov", ".ts", ".mkv")
_FORMS: Final = (*_FILES, ".mpd")
_WITHOUT_TOUCH: Final = (".webm", ".avi")
_NO_TOUCH: Final = "It has neither tracks of data nor attachments; .mkv holds the same picture and sound."
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
    if Path(movie).suffix.lower() == ".touch":
        raise InvalidArgument(
            str(movie), "a .touch file", "a movie", "The movie comes first: mux MOVIE STREAM OUT."
        )
    sidecar = out.with_suffix(".touch") if has_sidecar else None
    _check(out, at_s, sidecar)
    refuse_overwriting(out, movie, stream)
    if sidecar is not None:
        refuse_overwriting(sidecar, movie, stream)
    with TouchReader(stream) as reader, open_movie(movie) as source:
        warn_unbounded(stream_of(reader).error_bound().get("error_bound_note"))
        seconds = reader.head.frame_count / reader.head.rate_hz
        if kind == ".mpd":
            names = write_dash(source, Path(stream), out, at_s, 8 * reader.size / seconds)
            notes = _left_out_notes(source, _DASH_TYPES)  # the whole file is beside it, with its map
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
    if reader.has_map:
        notes = (*notes, f"{Path(stream).name}: {MAP_LEFT_OUT}")
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
        source = stack.enter_context(open_movie(movie))
        _, picture_s = _starts_s(source)
        touches = list[_Touch]()
        for stream in streams:
            reader = stack.enter_context(TouchReader(stream.path))
            warn_unbounded(stream_of(reader).error_bound().get("error_bound_note"))
            touches.append(_Touch(reader, stream.start_s, stream.start_s - picture_s, stream.name))
        return _write_movie(source, touches, out, report)


def after_picture_s(movie: str | Path, at_s: float) -> float:
    """Convert a second of a movie to seconds after its first picture, as `TimedStream` has them."""
    with open_movie(movie) as source:
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
    form = {".ts": "mpegts", ".mkv": "matroska"}.get(out.suffix.lower(), "mp4")
    options = {"movflags": "frag_keyframe+delay_moov+default_base_moof"} if form == "mp4" else {}
    tracks = tracks_of(source, *_COPIED_TYPES)
    movie_touch = _movie_touch(touches, form)
    with atomic_path(out) as temporary:
        copy_movie(source, tracks, MovieFile(temporary, str(out), form, options), movie_touch, report)
    return movie_touch.sizes, tuple(track.type for track in tracks)


def _movie_touch(touches: Sequence[_Touch], form: str) -> MovieTouch:
    """The touch of a movie as its format contains it."""
    if form == "matroska":
        files = [
            (f"{touch.name or 'movie'}.touch", _with_sync(touch.reader, touch.start_s)) for touch in touches
        ]
        return MovieTouch(attachments=files)
    return MovieTouch([(touch.name, list(_samples(touch, is_ts=form == "mpegts"))) for touch in touches])


def _samples(touch: _Touch, is_ts: bool) -> Iterator[Sample]:
    """Yield the samples of a track: one for each segment, then the spare ones."""
    reader, first_s, start_s = touch.reader, touch.first_s, touch.start_s
    data, position, rate_hz = reader.read_all(), 0, reader.head.rate_hz
    head = data[: reader.segments[0].offset] + sync_record(start_s)
    for i, entry in enumerate(reader.segments):
        stop = entry.offset + entry.length
        sample = data[position:stop] if i else head + data[entry.offset : stop]
        if is_ts:
            again = head if i and reader.head.coder != OBJECTS_CODER else b""
            sample = _klv(again + sample)
        yield first_s + entry.first_frame / rate_hz, entry.frame_count / rate_hz, sample
        position = stop
    sync = sync_record(start_s)
    end = _klv(sync) if is_ts else sync
    for i in range(SPARE_SAMPLES):
        yield first_s + reader.head.frame_count / rate_hz + i * SPARE_S, SPARE_S, end


def _klv(value: bytes) -> bytes:
    """A KLV triplet of touch."""
    return KLV + len(value).to_bytes(4, "big") + value


def _with_sync(reader: TouchReader, start_s: float) -> bytes:
    """The whole file with the record of its start."""
    last = reader.segments[-1]
    return with_sync(reader.read_all()[: last.offset + last.length], reader.segments[0].offset, start_s)
