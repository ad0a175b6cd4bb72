"""Copies the tracks of a movie, with touch between their packets in time, by PyAV (the extra ``video``)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from heapq import merge
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, import_extra
from touchfield.files import file_error
from touchfield.network.live import MEDIA_TYPE

SPARE_SAMPLES: Final = 8
SPARE_S: Final = 0.01
"""Each time that ffmpeg 5 copies its own copy of an MP4, it drops the last sample of a track for data. So
many samples at the end, at this distance, hold only the record of the start, and are no loss.
"""

_CLOCK: Final = Fraction(1, 90000)
_PES_BYTES: Final = 60_000
"""GStreamer drops data of an MPEG-TS that is longer than a PES packet of stated length, 65535 bytes."""

_MAX_BYTES: Final = 1 << 62
_LABEL: Final = "touch: {}"
_PROTOCOLS: Final = "file,crypto,data"
"""A playlist of a stranger may name files beside it, and no address."""
_CONVERT: Final = "Convert the movie first: ffmpeg -i MOVIE -pix_fmt yuv420p NEW.mp4."

Sample = tuple[float, float, bytes]
"""Start in the movie in seconds, duration in seconds, and bytes."""


@dataclass(frozen=True)
class MovieFile:
    """A movie that is written.

    path : Path
        Where it is written; `name` is its final path, for errors.
    form : str
        ffmpeg's name of the container format.
    options : dict
        Options of that format.
    """

    path: Path
    name: str
    form: str
    options: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class MovieTouch:
    """The touch of a movie: as tracks, or as attachments where the format has no tracks for data.

    tracks : (label, samples) each
        The samples are in the order of time, the last `SPARE_SAMPLES` of them spare. "" is no label.
    attachments : (file name, bytes) each
    """

    tracks: Sequence[tuple[str, Sequence[Sample]]] = ()
    attachments: Sequence[tuple[str, bytes]] = ()

    @property
    def sizes(self) -> tuple[int, ...]:
        """Bytes of each touch."""
        in_tracks = [sum(len(data) for _, _, data in samples) for _, samples in self.tracks]
        return (*in_tracks, *(len(data) for _, data in self.attachments))


@contextmanager
def open_movie(movie: str | Path) -> Iterator[Any]:
    """Open a movie in any format that ffmpeg reads, as a container of PyAV.

    Raises SourceError if it cannot be read, `MissingExtra` if PyAV is not installed.
    """
    av = import_extra("av", "touch in a movie", "av", "video")
    try:
        source = av.open(str(movie), options={"protocol_whitelist": _PROTOCOLS})
    except (av.FFmpegError, OSError, ValueError) as error:
        raise file_error(movie, error, "a movie that ffmpeg reads") from None
    with source:
        yield source


def tracks_of(source: Any, *kinds: str) -> list[Any]:
    """Return the tracks of a movie of some kinds: "video", "audio", "subtitle"."""
    return [track for track in source.streams if track.type in kinds]


def copy_movie(
    source: Any,
    source_tracks: Sequence[Any],
    out: MovieFile,
    touch: MovieTouch | None = None,
    report: Progress = silent,
) -> None:
    """Copy the packets of some tracks of `source` and, between them in time, the samples of `touch`.

    ``report(done, total)`` counts samples of touch that are not spare. Raises InvalidArgument if the format
    cannot contain one of the tracks, or this PyAV attaches no files.
    """
    import av

    touch = touch or MovieTouch()
    if touch.attachments and not hasattr(av.container.OutputContainer, "add_attachment"):
        hint = "Upgrade it: pip install --upgrade av"
        raise InvalidArgument(out.name, f"PyAV {av.__version__}", "one that can attach files", hint)
    try:
        with av.open(str(out.path), "w", format=out.form, options=out.options) as sink:
            tracks = {track.index: sink.add_stream_from_template(track) for track in source_tracks}
            writer = _SampleWriter(sink, touch.tracks, out.form, report)
            for name, data in touch.attachments:
                sink.add_attachment(name, MEDIA_TYPE, data)
            for packet in source.demux(source_tracks):
                if packet.dts is None:
                    continue
                writer.write(float(packet.dts * packet.time_base))
                packet.stream = tracks[packet.stream.index]
                sink.mux(packet)
            writer.write(float("inf"))
    except (av.FFmpegError, ValueError) as error:
        expected = "a form that holds the tracks of the movie"
        raise InvalidArgument(out.name, str(error), expected, _CONVERT) from None


class _SampleWriter:
    """Writes the samples of several tracks of touch in the order of time."""

    def __init__(
        self, sink: Any, tracks: Sequence[tuple[str, Sequence[Sample]]], form: str, report: Progress
    ) -> None:
        self._sink, self._report = sink, report
        self._piece_bytes = _PES_BYTES if form == "mpegts" else _MAX_BYTES
        self._tracks = [_add_track(sink, label, form) for label, _ in tracks]
        numbered = [[(*sample, n) for sample in samples] for n, (_, samples) in enumerate(tracks)]
        self._waiting = list(merge(*numbered, key=itemgetter(0)))[::-1]
        self._total = len(self._waiting) - SPARE_SAMPLES * len(tracks)
        self._written = 0

    def write(self, until_s: float) -> None:
        """Write the samples that start up to a time of the movie, seconds."""
        import av

        while self._waiting and self._waiting[-1][0] <= until_s:
            start_s, length_s, data, number = self._waiting.pop()
            for i, start in enumerate(range(0, len(data), self._piece_bytes)):
                packet = av.Packet(data[start : start + self._piece_bytes])
                packet.stream, packet.time_base = self._tracks[number], _CLOCK
                packet.pts = packet.dts = round(start_s / _CLOCK) + i
                packet.duration = round(length_s / _CLOCK)
                self._sink.mux(packet)
            self._written += 1
            if self._written <= self._total:
                self._report(self._written, self._total)


def _add_track(sink: Any, label: str, form: str) -> Any:
    track = sink.add_data_stream("klv" if form == "mpegts" else "bin_data")
    track.time_base = _CLOCK
    if label:
        track.metadata["handler_name"] = _LABEL.format(label)
    return track
