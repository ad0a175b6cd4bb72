"""The depth that goes with a movie: from a depth video, a folder of depth pictures, or a track of the movie.

The readers are those of `encode` (``depth.layouts``, ``depth.recorders``). Neither the unit of depth nor the
camera is needed, since only ratios of depths count (`depth.approach`), and neither is asked for. Only the
samples that `approach` uses are converted to depth.

Times are on the clock of the movie. A track of the movie is on it. A file or folder has a clock of its own:
its first picture shows with the first one of the movie, unless a video starts later by its own stamps, or
``rgb.txt`` of a TUM folder states when the colour began.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.errors import SourceError
from touchfield.files import readable, recorded_reads
from touchfield.sources.camera import CodedSequence, DepthCode, DepthSequence
from touchfield.sources.depth.approach import reduced_depth, sample_indices
from touchfield.sources.depth.layouts import LAYOUTS, Layout, unread_note
from touchfield.sources.images.movies import GreyVideo, map_size
from touchfield.sources.images.track_frames import TrackFrames
from touchfield.sources.options import SourceOptions
from touchfield.sources.poses import MAX_TIME_S, read_text, split_lines
from touchfield.sources.registry import open_source

_ANY_CAMERA: Final = "1,1,0,0"  # the readers need one, and nothing here depends on it
_ANY_SCALE: Final = 1000.0
_EXPECTED: Final = "a video of 16-bit grey depth, or a folder of depth pictures"


class _Selected(Protocol):
    """``selected(frame, rows, columns)``: those samples of a frame as depths, float32, 0 where unknown."""

    def __call__(self, frame: int, rows: Any, columns: Any) -> Float32s: ...


@dataclass(frozen=True)
class MovieDepth:
    """Depth over time.

    name : str
        Of the source, for messages.
    size : (int, int)
        Width and height of a depth picture.
    times_s : float64 [frames]
        On the clock of the movie, ascending.
    notes : tuple of str
        What was found, for people.
    """

    name: str
    size: tuple[int, int]
    times_s: Float64s
    notes: tuple[str, ...]
    selected: _Selected

    @property
    def map_size(self) -> tuple[int, int]:
        """Width and height of a map."""
        return map_size(*self.size)

    def maps(self) -> Iterator[Float32s]:
        """Yield the map of each picture in order, float32 [map height, map width]; 0 is unknown."""
        width, height = self.map_size
        grid = np.ix_(sample_indices(self.size[1], height), sample_indices(self.size[0], width))
        for frame in range(len(self.times_s)):
            yield reduced_depth(self.selected(frame, *grid))


def depth_of_track(movie: Path, index: int) -> MovieDepth:
    """Return the depth of the track `index` of a movie; SourceError if it cannot be read."""
    frames, code = TrackFrames(movie, index), DepthCode(_ANY_SCALE)

    def selected(frame: int, rows: Any, columns: Any) -> Float32s:
        return code(frames.at(frame)[rows, columns])

    note = f"The depth is that of track {index} of the movie ({frames.pixels})."
    return MovieDepth(str(movie), frames.size, frames.times_s, (note,), selected)


def depth_of_source(source: Path, first_s: float) -> MovieDepth:
    """Return the depth of a file or folder beside a movie whose first picture shows at `first_s`.

    Raises SourceError if there are no depth pictures, or one cannot be read.
    """
    with readable(source, "files that can be read"), recorded_reads() as read_files:
        sequence, stamps_s = _opened(source)
        times_s, note = _on_movie(source, sequence, stamps_s, first_s)
        unread = unread_note(source, read_files)
    if (np.diff(times_s) < 0).any():
        raise SourceError(str(source), "depth pictures whose times go back", "ascending times")
    notes = (*sequence.notes, *filter(None, [note]), *unread)
    return MovieDepth(str(source), (sequence.width, sequence.height), times_s, notes, _samples_of(sequence))


def _on_movie(
    source: Path, sequence: DepthSequence, stamps_s: Float64s | None, first_s: float
) -> tuple[Float64s, str]:
    """Return the times of a sequence on the clock of the movie, and a note."""
    if stamps_s is None:
        note = f"The depth states no times: its pictures are {sequence.rate_hz:.4g} a second."
        return first_s + np.arange(sequence.frame_count) / sequence.rate_hz, note
    if _is_video(sequence):
        return stamps_s + max(0.0, first_s - float(stamps_s[0])), ""
    lag_s, note = _lag_of_colour(source, float(stamps_s[0]))
    return first_s + lag_s + stamps_s - stamps_s[0], note


def _opened(source: Path) -> tuple[DepthSequence, Float64s | None]:
    """Return the sequence of a source, and the times of its frames if it states them."""
    from touchfield.sources.depth.depth_scene import DepthScene

    layout = next((layout for layout in LAYOUTS if layout.kind.recognise(source)), None)
    if layout is not None:
        return _of_layout(layout, source)
    options = SourceOptions(intrinsics=_ANY_CAMERA, frame="camera", world="frames")
    scene = open_source(source, options)
    if not isinstance(scene, DepthScene):
        hint = "Colours, and grey of 8 bits a pixel, are no depth."
        raise SourceError(str(source), "a source without depth pictures", _EXPECTED, hint)
    return scene.sequence, None


def _of_layout(layout: Layout, source: Path) -> tuple[DepthSequence, Float64s | None]:
    options = SourceOptions(
        intrinsics=_ANY_CAMERA,
        depth_scale=layout.units_per_m or _ANY_SCALE,
        depth_encoding="rotated" if layout.is_rotated else "plain",
        frame="camera",
    )
    sequence = layout.read_sequence(source, options)
    if isinstance(sequence, CodedSequence) and isinstance(sequence.frames, GreyVideo):
        times_s = sequence.frames.times_s
    else:
        stated = layout.list_pictures(source).times_s
        times_s = np.zeros(0) if stated is None else stated
    if len(times_s) != sequence.frame_count or not np.isfinite(times_s).all():
        return sequence, None
    return sequence, times_s if len(times_s) == 1 or times_s[-1] > times_s[0] else None


def _is_video(sequence: DepthSequence) -> bool:
    return isinstance(sequence, CodedSequence) and isinstance(sequence.frames, GreyVideo)


def _samples_of(sequence: DepthSequence) -> _Selected:
    if isinstance(sequence, CodedSequence) and isinstance(sequence.metres, DepthCode):
        code, stored = sequence.metres, sequence
        return lambda frame, rows, columns: code(stored.stored_values(frame)[rows, columns])
    return lambda frame, rows, columns: sequence.depth_m(frame)[rows, columns]


def _lag_of_colour(source: Path, depth_s: float) -> tuple[float, str]:
    """Return how long after the first colour picture of a TUM folder the depth begins, and a note."""
    listing = source / "rgb.txt"
    alone = "The first depth picture shows with the first picture of the movie"
    if not listing.is_file():
        return 0.0, f"{alone}: no rgb.txt states when the colour began."
    stamps = list[float]()
    for where, tokens in split_lines(read_text(listing), str(listing)):
        try:
            stamp, name = float(tokens[0]), tokens[1]
        except (ValueError, IndexError):
            raise SourceError(where, repr(" ".join(tokens)[:60]), "a time and a file name") from None
        if abs(stamp) < MAX_TIME_S and (source / name).is_file():
            stamps.append(stamp)
    if not stamps:
        return 0.0, f"{alone}: rgb.txt names no picture that is there."
    lag_s = depth_s - min(stamps)
    return lag_s, f"By rgb.txt, the depth begins {lag_s:.3f} s after the first colour picture."
