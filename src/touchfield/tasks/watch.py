"""`watch`: makes touch from the picture and the sound of an ordinary movie (paper section 5.1, case 1), and
puts it into the movie as one track for each source.

Sound and picture are read at the same time, each in a pass of its own, so that memory holds some pictures and
about fifty bytes for each hop of the sound. Everything that is made is *symbolic* (paper figure 1).
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from touchfield.codec.touch.spec import TouchSpec
from touchfield.compute.threads import Progress, silent
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument, SourceError, require_one_of
from touchfield.files import refuse_overwriting
from touchfield.filters.device_spec import device_grid
from touchfield.network.mux import TimedStream, mux_streams, require_movie
from touchfield.network.opening import open_stream
from touchfield.pipeline.array_medium import Drives
from touchfield.pipeline.encoding import Encoded, encode_prepared
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.result import Result
from touchfield.pipeline.source import FixedLatticeScene
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.images.movies import ColourVideo, unfinished_note, video_header
from touchfield.sources.sound.analysis import SoundFeatures, sound_features
from touchfield.sources.sound.soundtrack import MovieTracks, Soundtrack, movie_tracks
from touchfield.sources.video.saliency import EvenPictures, SaliencyScene
from touchfield.tasks.watch_sound import RATE_HZ, low_drives, sound_medium
from touchfield.viewer.watch import Timeline, draw_timeline

SOURCES: Final = ("picture", "sound")
PICTURE_TAGS: Final = ("symbolic", "picture")
DEFAULT_DEVICE: Final = "tactsuit-x40"
SOUND_SEGMENT_S: Final = 1.0
_NOTED_S: Final = 0.5
_TIMELINE_BINS: Final = 1200


@dataclass(frozen=True)
class WatchSpec:
    """What is requested of `watch`.

    device : str
        Name of the profile of an array of motors, or its TOML file.
    only : str or None
        "picture" or "sound"; None is both, as far as the movie has them.
    """

    device: str = DEFAULT_DEVICE
    only: str | None = None

    def __post_init__(self) -> None:
        if self.only is not None:
            require_one_of("only", self.only, SOURCES)


@dataclass(frozen=True)
class _Made:
    """A touch that was made of a source: its file, the time of frame 0 on the movie's clock, and notes."""

    path: Path
    start_s: float
    encoded: Encoded
    notes: tuple[str, ...]
    features: SoundFeatures | None = None

    @property
    def seconds(self) -> float:
        """Duration."""
        medium = self.encoded.prepared.medium
        return len(medium) / medium.rate_hz


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
    without a picture the hops of the sound. Raises TouchfieldError if the movie has neither picture nor sound
    or cannot be read, or the device is no array of motors; no file `out` is then left.
    """
    spec, movie, out = spec or WatchSpec(), Path(movie), Path(out)
    require_movie(out)
    refuse_overwriting(out, movie)
    target = _motors(spec.device)
    tracks = movie_tracks(movie)
    sources = _sources(movie, tracks, spec)
    with TemporaryDirectory(prefix="touchfield-") as folder:
        made = _make(movie, Path(folder), sources, target, report)
        timed = [TimedStream(touch.path, touch.start_s, name) for name, touch in made.items()]
        sizes, copied = mux_streams(movie, timed, out)
        if plot is not None:
            title = f"{movie.name}: touch for {target.name}"
            draw_timeline(Path(plot), _timelines(made, target), title)
    figures = _figures(made, dict(zip(made, sizes, strict=True)), out, target, copied)
    return Result(figures, _notes(movie, tracks, made, spec))


def _motors(name: str) -> Device:
    target = device(name)
    if not target.is_array or target.shows == "height":
        kind = "a pin display" if target.is_array else "a point"
        raise InvalidArgument("device", f"{target.name}, {kind}", "an array of motors, such as a vest")
    return target


def _sources(movie: Path, tracks: MovieTracks, spec: WatchSpec) -> tuple[str, ...]:
    """The sources that are requested, as far as the movie has them."""
    has = {"picture": tracks.pictures > 0, "sound": tracks.sounds > 0}
    requested = SOURCES if spec.only is None else (spec.only,)
    sources = tuple(name for name in requested if has[name])
    if not sources:
        missing = " and no ".join(requested)
        raise SourceError(str(movie), f"no {missing} in the file", "a movie with picture or sound")
    return sources


def _make(
    movie: Path, folder: Path, sources: tuple[str, ...], target: Device, report: Progress
) -> dict[str, _Made]:
    """The touch of each source; the sound is made in a thread of its own."""
    if len(sources) == 1:
        maker = {"picture": _picture_touch, "sound": _sound_touch}[sources[0]]
        return {sources[0]: maker(movie, folder / f"{sources[0]}.touch", target, report)}
    with ThreadPoolExecutor(1) as pool:
        sound = pool.submit(_sound_touch, movie, folder / "sound.touch", target, silent)
        picture = _picture_touch(movie, folder / "picture.touch", target, report)
        return {"picture": picture, "sound": sound.result()}


def _picture_touch(movie: Path, out: Path, target: Device, report: Progress) -> _Made:
    if video_header(movie).is_deep_grey:
        mend = "Encode it as depth: touchfield encode --as depth-video."
        raise SourceError(str(movie), "a picture of deep grey", "8 bits a colour", mend)
    video = ColourVideo(movie)
    pictures = EvenPictures(video)
    scene = SaliencyScene(pictures, pictures.rate_hz or 1.0)
    scene.tags = PICTURE_TAGS
    prepared = prepare(scene, EncodeSpec(device=target.name))
    encoded = encode_prepared(prepared, out, file_provenance(movie, prepared), report)
    notes = (*filter(None, [video.header.track_note]), *unfinished_note(movie))
    if pictures.is_uneven:
        notes += (f"The pictures are at unequal times: they are shown at {pictures.rate_hz:g} Hz, in time.",)
    return _Made(out, float(video.times_s[0]), encoded, notes)


def _sound_touch(movie: Path, out: Path, target: Device, report: Progress) -> _Made:
    sound = Soundtrack(movie)
    features = sound_features(sound.blocks())
    medium = sound_medium(features, device_grid(target), target.force_max_n)
    scene = FixedLatticeScene(medium, target, ())
    # there are no forces to round, and a frame of none takes fewest bytes in mode "lossless"
    coding = TouchSpec(segment_frames=round(RATE_HZ * SOUND_SEGMENT_S), mode="lossless")
    prepared = prepare(scene, EncodeSpec(device=target.name, nw=None, touch=coding))
    encoded = encode_prepared(prepared, out, file_provenance(movie, prepared), report)
    return _Made(out, sound.start_s, encoded, sound.notes, features)


# -- report ------------------------------------------------------------------------------------------------
def _figures(
    made: dict[str, _Made], sizes: dict[str, int], out: Path, target: Device, copied: tuple[str, ...]
) -> dict[str, Any]:
    figures: dict[str, Any] = {"device": target.name, "file_bytes": out.stat().st_size}
    for name, touch in made.items():
        figures |= {
            f"{name}_seconds": touch.seconds,
            f"{name}_rate_hz": touch.encoded.prepared.medium.rate_hz,
            f"{name}_touch_bytes": sizes[name],
            f"{name}_bytes_per_s": sizes[name] / touch.seconds,
        }
    if (features := _sound_features(made)) is not None:
        figures |= {
            "onsets": len(features.onsets),
            "onsets_per_minute": 60 * len(features.onsets) / features.duration_s,
            "low_fraction": float((low_drives(features) > 0).mean()),
            "silent_fraction": features.silent_fraction,
        }
    return {**figures, "tags": {name: list(_tags(touch)) for name, touch in made.items()}, "copied": copied}


def _sound_features(made: dict[str, _Made]) -> SoundFeatures | None:
    return made["sound"].features if "sound" in made else None


def _tags(touch: _Made) -> tuple[str, ...]:
    return touch.encoded.prepared.medium.tags


def _notes(movie: Path, tracks: MovieTracks, made: dict[str, _Made], spec: WatchSpec) -> tuple[str, ...]:
    notes = [note for touch in made.values() for note in touch.notes]
    if tracks.sounds and not tracks.pictures and spec.only is None:
        notes.append("The movie has no picture: the touch is that of the sound.")
    if tracks.pictures and not tracks.sounds and spec.only is None:
        notes.append("The movie has no sound: the touch is that of the picture.")
    if (features := _sound_features(made)) is not None and features.silent_fraction == 1:
        notes.append("The sound is silent throughout: its touch does nothing.")
    if tracks.sounds > 1 and "sound" in made:
        notes.append(f"Of {tracks.sounds} sounds the first is used ({tracks.sound}); all are copied.")
    if tracks.subtitles:
        notes.append(f"{tracks.subtitles} tracks of subtitles are copied, and not used.")
    if tracks.covers:
        notes.append(f"{tracks.covers} still pictures (covers) are copied, and not used.")
    if tracks.others:
        notes.append(f"{tracks.others} tracks of data or attachments are not copied.")
    if len(made) == len(SOURCES):
        notes += _difference_notes(made["picture"], made["sound"])
    return tuple(notes)


def _difference_notes(picture: _Made, sound: _Made) -> Iterator[str]:
    """Notes on a sound that starts or ends at another time than the picture."""
    late_s = sound.start_s - picture.start_s
    over_s = late_s + sound.seconds - picture.seconds
    if abs(late_s) > _NOTED_S:
        word = "after" if late_s > 0 else "before"
        yield f"The sound starts {abs(late_s):.2f} s {word} the picture."
    if abs(over_s) > _NOTED_S:
        word = "after" if over_s > 0 else "before"
        yield f"The sound ends {abs(over_s):.2f} s {word} the picture."


def _timelines(made: dict[str, _Made], target: Device) -> dict[str, Timeline]:
    """The drives of each touch, read back from its file, with what the sound was found to hold."""
    start_s = min(touch.start_s for touch in made.values())
    timelines = {}
    for name, touch in made.items():
        with open_stream(touch.path) as stream:
            drives = Drives(stream.medium, target, target.force_max_n)
            bins = _binned(drives, min(_TIMELINE_BINS, len(drives)))
        first_s = touch.start_s - start_s
        timelines[name] = Timeline(first_s, touch.seconds, bins)
    if (features := _sound_features(made)) is not None:
        onsets_s = np.array([onset.time_s for onset in features.onsets])
        first_s = made["sound"].start_s - start_s
        timelines["sound"] = replace(timelines["sound"], onsets_s=first_s + onsets_s, levels=features.levels)
    return timelines


def _binned(drives: Drives, count: int) -> Any:
    """The greatest drive of each actuator of the first panel in `count` spans, float32 [actuators, count]."""
    frames = np.arange(len(drives)) * count // len(drives)
    rows, columns = drives.drives(0)[0].shape
    image = np.zeros((rows * columns, count), np.float32)
    for i, span in enumerate(frames.tolist()):
        image[:, span] = np.maximum(image[:, span], drives.drives(i)[0].ravel())
    return image
