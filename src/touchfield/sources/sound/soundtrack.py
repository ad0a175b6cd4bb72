"""The sound of a movie as blocks of samples, in time with its picture, through PyAV (the extra ``video``).

Packets are decoded one after the other, so that memory does not depend on the duration. Channels are
averaged: FFmpeg's own mix leaves out the channel of low frequencies. The time stamps decide where a sample
belongs. Where they leave a gap, the sound is silent; where they go back, samples are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float32s
from touchfield.errors import SourceError
from touchfield.sources.images.movies import is_cover, opened_container
from touchfield.sources.sound.analysis import RATE_HZ

_TOLERANCE_S: Final = 0.02
"""Time stamps may be off by so much: those of some containers are whole milliseconds, or packets."""

_MIN_GAP_S: Final = 60.0
"""Silence that a gap in the time stamps may always ask for; more is bounded by the sound that is there."""

_MAX_SECONDS: Final = 12 * 3600.0
_MAX_CHANNELS: Final = 64


@dataclass(frozen=True)
class MovieTracks:
    """The numbers of a movie's tracks by kind, and a description of its first sound, empty without any.

    `covers` are still pictures that are no video, and not counted in `pictures`.
    """

    pictures: int
    sounds: int
    subtitles: int
    others: int
    covers: int
    sound: str


def movie_tracks(path: Path) -> MovieTracks:
    """Count the tracks of a movie; SourceError if it cannot be read, MissingExtra without PyAV."""
    with opened_container(path) as container:
        streams = container.streams
        covers = sum(map(is_cover, streams.video))
        pictures, sounds, subtitles = len(streams.video) - covers, len(streams.audio), len(streams.subtitles)
        others = len(streams) - pictures - covers - sounds - subtitles
        sound = _description(streams.audio[0]) if streams.audio else ""
        return MovieTracks(pictures, sounds, subtitles, others, covers, sound)


def _description(stream: Any) -> str:
    context = stream.codec_context
    if context is None:
        return "unknown"
    return f"{context.name}, {context.channels} channels, {context.sample_rate} Hz"


class Soundtrack:
    """The first sound of a movie, averaged over its channels.

    path : Path
    start_s : float
        Of the first sample on the clock of the movie, seconds; known once `blocks` has yielded.
    duration_s : float
        Seconds of the samples that `blocks` has yielded.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.start_s = path, 0.0
        self._next_s: float | None = None  # when the next frame is expected, on the clock of the movie
        self._written = self._silent = self._dropped = self._damaged = 0  # samples; packets
        self._resampler: Any = None
        self._form: tuple[str, int, int] | None = None

    @property
    def duration_s(self) -> float:
        """Seconds of the samples that `blocks` has yielded."""
        return self._written / RATE_HZ

    @property
    def notes(self) -> tuple[str, ...]:
        """What was silent or left out, for people; complete once `blocks` has ended."""
        notes = list[str]()
        if self._damaged:
            notes.append(f"{self._damaged} packets of the sound are damaged, and silent in the touch.")
        if self._silent:
            notes.append(f"The sound has gaps of {self._silent / RATE_HZ:.3g} s, silent in the touch.")
        if self._dropped:
            notes.append(f"{self._dropped / RATE_HZ:.3g} s of the sound overlap others in time: left out.")
        return tuple(notes)

    def blocks(self) -> Iterator[Float32s]:
        """Yield the samples once, float32 [n] at `RATE_HZ`, full scale 1.

        SourceError if the movie has no sound that can be decoded, or its time stamps are implausible.
        """
        with opened_container(self.path) as container:
            if not container.streams.audio:
                raise SourceError(str(self.path), "no sound in the file", "a movie with sound")
            stream = container.streams.audio[0]
            if stream.codec_context is None:
                mend = "Copy it again."
                raise SourceError(str(self.path), "a sound of no codec that is known", "a whole movie", mend)
            for frame in self._frames(container, stream):
                yield from self._placed(frame)
            yield from self._flushed()
        if not self._written:
            raise SourceError(str(self.path), "a sound track without a sample", "a movie with sound")

    def _frames(self, container: Any, stream: Any) -> Iterator[Any]:
        from av.error import FFmpegError

        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except FFmpegError:
                self._damaged += 1
                continue
            yield from (frame for frame in frames if frame.samples and frame.sample_rate)

    def _placed(self, frame: Any) -> Iterator[Float32s]:
        """The samples of a frame at their time: after silence, or none if they come too late."""
        stamped_s = None if frame.pts is None else float(frame.pts * frame.time_base)
        if self._next_s is None:
            self._next_s = self.start_s = stamped_s or 0.0
        late_s = 0.0 if stamped_s is None else stamped_s - self._next_s
        if late_s < -_TOLERANCE_S:
            self._dropped += round(frame.samples * RATE_HZ / frame.sample_rate)
            return
        if late_s > _TOLERANCE_S:
            yield from self._flushed()
            yield from self._silence(late_s)
            self._next_s += late_s
        yield from self._resampled(frame)
        self._next_s += frame.samples / frame.sample_rate

    def _silence(self, seconds: float) -> Iterator[Float32s]:
        silent_s = self._silent / RATE_HZ + seconds
        if silent_s > max(_MIN_GAP_S, self.duration_s):
            found = f"{silent_s:.4g} s of gaps in {self.duration_s:.4g} s of sound"
            mend = "Repair its time stamps: ffmpeg -i MOVIE -c:v copy -af aresample=async=1 NEW"
            raise SourceError(str(self.path), found, "a sound in time with the picture", mend)
        count = round(seconds * RATE_HZ)
        self._silent += count
        for start in range(0, count, RATE_HZ):
            yield self._counted(np.zeros(min(RATE_HZ, count - start), np.float32))

    def _resampled(self, frame: Any) -> Iterator[Float32s]:
        import av

        form = frame.format.name, frame.layout.nb_channels, frame.sample_rate
        if form != self._form:
            yield from self._flushed()
            if form[1] > _MAX_CHANNELS:
                raise SourceError(str(self.path), f"{form[1]} channels", f"at most {_MAX_CHANNELS}")
            self._resampler, self._form = av.AudioResampler(format="flt", rate=RATE_HZ), form
        frame.pts = None  # gaps are filled above
        for resampled in self._resampler.resample(frame):
            yield self._mixed(resampled)

    def _flushed(self) -> Iterator[Float32s]:
        """What the resampler still holds; the next frame starts another one."""
        resampler, self._resampler, self._form = self._resampler, None, None
        for resampled in resampler.resample(None) if resampler is not None else ():
            yield self._mixed(resampled)

    def _mixed(self, frame: Any) -> Float32s:
        samples = frame.to_ndarray().reshape(-1, frame.layout.nb_channels)
        samples = np.nan_to_num(samples, nan=0.0, posinf=1.0, neginf=-1.0)
        return self._counted(np.clip(samples, -1, 1).mean(axis=1, dtype=np.float32))

    def _counted(self, samples: Float32s) -> Float32s:
        self._written += len(samples)
        if self._written > _MAX_SECONDS * RATE_HZ:
            expected = f"at most {_MAX_SECONDS / 3600:g} hours"
            raise SourceError(str(self.path), "a longer sound", expected, "Cut the movie into parts.")
        return samples
