"""`watch`: makes touch from the picture, the sound and the depth of a movie (paper section 5.1, case 1), and
puts it into the movie as one track for each source.

All sources are read at the same time, each in a pass of its own, so that memory holds some pictures, about
fifty bytes for each hop of the sound, and a few numbers for each depth picture. Everything that is made is
*symbolic* (paper figure 1).
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import Progress, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument, SourceError, require_one_of
from touchfield.files import refuse_overwriting
from touchfield.filters.device_spec import device_grid
from touchfield.network.mux import TimedStream, mux_streams, require_movie
from touchfield.pipeline.encoding import encode_prepared
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.result import Result
from touchfield.pipeline.source import FixedLatticeScene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.depth.movie_depth import depth_of_source, depth_of_track
from touchfield.sources.images.movies import ColourVideo, unfinished_note
from touchfield.sources.images.track_frames import TrackFrames, VideoTracks, video_tracks
from touchfield.sources.sound.analysis import sound_features
from touchfield.sources.sound.soundtrack import MovieTracks, Soundtrack, movie_tracks
from touchfield.sources.video.saliency import EvenPictures, SaliencyScene
from touchfield.tasks.watch_depth import depth_features, depth_medium
from touchfield.tasks.watch_report import MadeTouch, depth_notes, figures_of, notes_of, timelines_of
from touchfield.tasks.watch_sound import RATE_HZ, sound_medium
from touchfield.viewer.watch import draw_timeline

SOURCES: Final = ("picture", "sound", "depth")
PICTURE_TAGS: Final = ("symbolic", "picture")
DEFAULT_DEVICE: Final = "tactsuit-x40"
SOUND_SEGMENT_S: Final = 1.0


@dataclass(frozen=True)
class WatchSpec:
    """What is requested of `watch`.

    device : str
        Name of the profile of an array of motors, or its TOML file.
    only : str or None
        "picture", "sound" or "depth"; None is all of them, as far as the movie has them.
    depth : str, Path or None
        A depth video or a folder of depth pictures; None is the movie's own track of depth, if it has one.
    """

    device: str = DEFAULT_DEVICE
    only: str | None = None
    depth: str | Path | None = None

    def __post_init__(self) -> None:
        if self.only is not None:
            require_one_of("only", self.only, SOURCES)
        if self.depth is not None and self.only not in (None, "depth"):
            mend = "Leave one of the two out."
            raise InvalidArgument("depth", f"a depth that is not used with only {self.only}", "one use", mend)


@dataclass(frozen=True)
class _Movie:
    """A movie, its tracks by kind, and the file or folder of its depth, if that is not a track of it."""

    path: Path
    tracks: MovieTracks
    videos: VideoTracks
    depth: Path | None

    @property
    def has(self) -> dict[str, bool]:
        """Which sources there are."""
        has_depth = self.depth is not None or bool(self.videos.depths)
        return {"picture": bool(self.videos.colours), "sound": self.tracks.sounds > 0, "depth": has_depth}

    @property
    def is_mixed(self) -> bool:
        """True if it has tracks of deep grey, which are no pictures."""
        return bool(self.videos.depths or self.videos.infrared)

    @cached_property
    def pictures(self) -> Any:
        """Its first picture as `ColourVideo` or `TrackFrames`; None without one."""
        if not self.videos.colours:
            return None
        return TrackFrames(self.path, self.videos.colours[0]) if self.is_mixed else ColourVideo(self.path)


def watch(
    movie: str | Path,
    out: str | Path,
    spec: WatchSpec | None = None,
    *,
    plot: str | Path | None = None,
    report: Progress = silent,
) -> Result:
    """Make touch from a movie, and write the movie with it.

    `movie` has the ending of a video (`touchfield.sources.images.movies.MOVIE_SUFFIXES`); `out` is .mp4,
    .m4v, .mov, .ts or .mkv. `plot` is a PNG of the timeline. ``report(done, total)`` counts the pictures, or
    without a picture the hops of the sound, or the depth pictures. Raises TouchfieldError if the movie has
    none of the sources or cannot be read, or the device is no array of motors; no file `out` is then left.
    """
    spec, out = spec or WatchSpec(), Path(out)
    require_movie(out)
    depth = None if spec.depth is None else Path(spec.depth)
    refuse_overwriting(out, movie, *([] if depth is None else [depth]))
    if depth is not None and not os.path.exists(depth):
        raise SourceError(str(depth), "nothing there", "a depth video or a folder", "Check the path.")
    target = _motors(spec.device)
    opened = _Movie(Path(movie), movie_tracks(Path(movie)), video_tracks(Path(movie)), depth)
    sources = _sources(opened, spec)
    if sources != ("sound",):
        _ = opened.pictures  # here, and not in two threads
    with TemporaryDirectory(prefix="touchfield-") as folder:
        made = _make(opened, Path(folder), sources, target, report)
        timed = [TimedStream(touch.path, touch.start_s, name) for name, touch in made.items()]
        sizes, copied = mux_streams(movie, timed, out)
        if plot is not None:
            title = f"{opened.path.name}: touch for {target.name}"
            draw_timeline(Path(plot), timelines_of(made, target), title)
    figures = figures_of(made, dict(zip(made, sizes, strict=True)), out, target, copied)
    notes = (*notes_of(opened.tracks, made, spec.only), *_track_notes(opened, sources))
    return Result(figures, notes)


def _motors(name: str) -> Device:
    target = device(name)
    if not target.is_array or target.shows == "height":
        kind = "a pin display" if target.is_array else "a point"
        raise InvalidArgument("device", f"{target.name}, {kind}", "an array of motors, such as a vest")
    return target


def _sources(movie: _Movie, spec: WatchSpec) -> tuple[str, ...]:
    """The sources that are requested, as far as the movie has them."""
    requested = SOURCES if spec.only is None else (spec.only,)
    sources = tuple(name for name in requested if movie.has[name])
    if spec.only is None and movie.depth is None and sources == ("depth",):
        mend = "Make touch of its depth with --only depth, or encode it: touchfield encode --as depth-video."
        raise SourceError(str(movie.path), "a picture of deep grey", "8 bits a colour", mend)
    if not sources:
        mend = "Name its depth with --depth." if spec.only == "depth" else ""
        missing = " and no ".join(requested[:2])
        raise SourceError(str(movie.path), f"no {missing} in the file", "a movie with picture or sound", mend)
    return sources


def _track_notes(movie: _Movie, sources: tuple[str, ...]) -> list[str]:
    """Notes on tracks of deep grey that are not used."""
    unused = len(movie.videos.depths) - ("depth" in sources and movie.depth is None)
    notes = []
    if unused > 0:
        notes.append(f"{unused} tracks of depth in the movie are copied, and not used.")
    if movie.videos.infrared:
        notes.append(f"{movie.videos.infrared} tracks of infrared are copied, and not used.")
    if movie.is_mixed and len(movie.videos.colours) > 1:
        notes.append(f"Of {len(movie.videos.colours)} pictures the first is used; all are copied.")
    return notes


# -- the touch of each source ------------------------------------------------------------------------------
def _make(
    movie: _Movie, folder: Path, sources: tuple[str, ...], target: Device, report: Progress
) -> dict[str, MadeTouch]:
    """The touch of each source; all but the first are made in threads of their own."""
    makers: dict[str, Callable[[_Movie, Path, Device, Progress], MadeTouch]] = {
        "picture": _picture_touch,
        "sound": _sound_touch,
        "depth": _depth_touch,
    }
    first, *others = (
        partial(makers[name], movie, folder / f"{name}.touch", target, report if not n else silent)
        for n, name in enumerate(sources)
    )
    with ThreadPoolExecutor(max(1, len(others))) as pool:
        futures = [pool.submit(other) for other in others]
        touches = [first(), *(future.result() for future in futures)]
    return dict(zip(sources, touches, strict=True))


def _picture_touch(movie: _Movie, out: Path, target: Device, report: Progress) -> MadeTouch:
    video, notes = movie.pictures, unfinished_note(movie.path)
    if not movie.is_mixed:
        notes = (*filter(None, [video.header.track_note]), *notes)
    pictures = EvenPictures(video)
    scene = SaliencyScene(pictures, pictures.rate_hz or 1.0)
    scene.tags = PICTURE_TAGS
    prepared = prepare(scene, EncodeSpec(device=target.name))
    encoded = encode_prepared(prepared, out, file_provenance(movie.path, prepared), report)
    if pictures.is_uneven:
        notes += (f"The pictures are at unequal times: they are shown at {pictures.rate_hz:g} Hz, in time.",)
    return MadeTouch(out, float(video.times_s[0]), encoded, notes)


def _sound_touch(movie: _Movie, out: Path, target: Device, report: Progress) -> MadeTouch:
    sound = Soundtrack(movie.path)
    features = sound_features(sound.blocks())
    medium = sound_medium(features, device_grid(target), target.force_max_n)
    scene = FixedLatticeScene(medium, target, ())
    # there are no forces to round or to predict: a frame of none takes fewest bytes this way
    frames = round(RATE_HZ * SOUND_SEGMENT_S)
    coding = TouchSpec(segment_frames=frames, mode="lossless", interframe="off")
    prepared = prepare(scene, EncodeSpec(device=target.name, nw=None, touch=coding))
    encoded = encode_prepared(prepared, out, file_provenance(movie.path, prepared), report)
    return MadeTouch(out, sound.start_s, encoded, sound.notes, sound=features)


def _depth_touch(movie: _Movie, out: Path, target: Device, report: Progress) -> MadeTouch:
    pictures = movie.pictures
    size, first_s = (None, 0.0) if pictures is None else (pictures.size, float(pictures.times_s[0]))
    if movie.depth is not None:
        depth = depth_of_source(movie.depth, first_s)
    else:
        depth = depth_of_track(movie.path, movie.videos.depths[0])
    grid = device_grid(target)
    features = depth_features(depth, grid, size, report)
    scene = FixedLatticeScene(depth_medium(features, grid, target.force_max_n), target, ())
    prepared = prepare(scene, EncodeSpec(device=target.name, nw=None, allow_empty=True))
    encoded = encode_prepared(prepared, out, file_provenance(movie.depth or movie.path, prepared))
    notes = (*depth.notes, *depth_notes(features, depth.size, size))
    return MadeTouch(out, float(depth.times_s[0]), encoded, notes, depth=features)
