"""What `watch` reports of the touch that it made: figures, notes, and a timeline of each source."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float32s
from touchfield.devices import Device
from touchfield.network.opening import open_stream
from touchfield.pipeline.array_medium import Drives
from touchfield.pipeline.encoding import Encoded
from touchfield.sources.sound.analysis import SoundFeatures
from touchfield.sources.sound.soundtrack import MovieTracks
from touchfield.tasks.watch_depth import DepthFeatures
from touchfield.tasks.watch_sound import low_drives
from touchfield.viewer.watch import Timeline

_NOTED_S: Final = 0.5
_TIMELINE_BINS: Final = 1200


@dataclass(frozen=True)
class MadeTouch:
    """A touch that was made of a source: its file, the time of frame 0 on the movie's clock, and notes."""

    path: Path
    start_s: float
    encoded: Encoded
    notes: tuple[str, ...]
    sound: SoundFeatures | None = None
    depth: DepthFeatures | None = None

    @property
    def seconds(self) -> float:
        """Duration."""
        medium = self.encoded.prepared.medium
        return len(medium) / medium.rate_hz

    @property
    def tags(self) -> tuple[str, ...]:
        """Tags of its head."""
        return self.encoded.prepared.medium.tags


Made = Mapping[str, MadeTouch]
"""The touch of each source by its name: "picture", "sound", "depth"."""


def figures_of(
    made: Made, sizes: Mapping[str, int], out: Path, target: Device, copied: tuple[str, ...]
) -> dict[str, Any]:
    """Return the figures of a movie with touch; their keys are stable."""
    figures: dict[str, Any] = {"device": target.name, "file_bytes": out.stat().st_size}
    for name, touch in made.items():
        figures |= {
            f"{name}_seconds": touch.seconds,
            f"{name}_rate_hz": touch.encoded.prepared.medium.rate_hz,
            f"{name}_touch_bytes": sizes[name],
            f"{name}_bytes_per_s": sizes[name] / touch.seconds,
        }
    if (sound := _sound(made)) is not None:
        figures |= {
            "onsets": len(sound.onsets),
            "onsets_per_minute": 60 * len(sound.onsets) / sound.duration_s,
            "low_fraction": float((low_drives(sound) > 0).mean()),
            "silent_fraction": sound.silent_fraction,
        }
    if (depth := _depth(made)) is not None:
        figures |= {
            "approaches": depth.approaches,
            "approaches_per_minute": 60 * depth.approaches / made["depth"].seconds,
            "depth_felt_fraction": float((depth.drives > 0).any(axis=(1, 2)).mean()),
            "depth_known_fraction": depth.known_fraction,
            "depth_cuts": depth.cuts,
        }
    return {**figures, "tags": {name: list(touch.tags) for name, touch in made.items()}, "copied": copied}


def _sound(made: Made) -> SoundFeatures | None:
    return made["sound"].sound if "sound" in made else None


def _depth(made: Made) -> DepthFeatures | None:
    return made["depth"].depth if "depth" in made else None


# -- notes -------------------------------------------------------------------------------------------------
def notes_of(tracks: MovieTracks, made: Made, only: str | None) -> tuple[str, ...]:
    """Return the notes of each source, and those on what the movie lacks or has besides."""
    notes = [note for touch in made.values() for note in touch.notes]
    if only is None:
        notes += _missing_notes(made)
    if (sound := _sound(made)) is not None:
        if sound.silent_fraction == 1:
            notes.append("The sound is silent throughout: its touch does nothing.")
        if tracks.sounds > 1:
            notes.append(f"Of {tracks.sounds} sounds the first is used ({tracks.sound}); all are copied.")
    if tracks.subtitles:
        notes.append(f"{tracks.subtitles} tracks of subtitles are copied, and not used.")
    if tracks.covers:
        notes.append(f"{tracks.covers} still pictures (covers) are copied, and not used.")
    if tracks.others:
        notes.append(f"{tracks.others} tracks of data or attachments are not copied.")
    if "picture" in made:
        for name in ("sound", "depth"):
            if name in made:
                notes += _difference_notes(name, made[name], made["picture"])
    return tuple(notes)


def _missing_notes(made: Made) -> Iterator[str]:
    used = " and ".join(name for name in made if name != "depth")
    for name in ("picture", "sound"):
        if name not in made and used:
            yield f"The movie has no {name}: the touch is that of the {used}."


def _difference_notes(name: str, touch: MadeTouch, picture: MadeTouch) -> Iterator[str]:
    """Notes on a source that starts or ends at another time than the picture."""
    late_s = touch.start_s - picture.start_s
    over_s = late_s + touch.seconds - picture.seconds
    for event, seconds in (("starts", late_s), ("ends", over_s)):
        if abs(seconds) > _NOTED_S:
            word = "after" if seconds > 0 else "before"
            yield f"The {name} {event} {abs(seconds):.2f} s {word} the picture."


def depth_notes(
    depth: DepthFeatures, size: tuple[int, int], picture: tuple[int, int] | None
) -> Iterator[str]:
    """Notes on a depth of width and height `size` for a picture of another size or none."""
    if picture is None:
        yield "Without a picture, the depth's own edges are those of the array."
    elif abs(size[0] * picture[1] / (size[1] * picture[0]) - 1) > 0.02:
        shapes = f"{size[0]} x {size[1]}, the picture {picture[0]} x {picture[1]}"
        yield f"The depth is {shapes}: it is stretched over the whole picture."
    if depth.is_uneven:
        yield f"The depth is at unequal times: it is shown at {depth.rate_hz:g} Hz, in time."
    if depth.rate_hz < 5:
        yield f"The depth has {depth.rate_hz:.3g} pictures a second: approaches are found late below 5."
    if depth.known_fraction == 0:
        yield "No depth is known in any picture: its touch does nothing."
    elif not depth.drives.any():
        yield "Nothing approaches or becomes near: the touch of the depth does nothing."


# -- timelines ---------------------------------------------------------------------------------------------
def timelines_of(made: Made, target: Device) -> dict[str, Timeline]:
    """Return the drives of each touch, read back from its file, with what the sound was found to hold."""
    start_s = min(touch.start_s for touch in made.values())
    timelines = {}
    for name, touch in made.items():
        with open_stream(touch.path) as stream:
            drives = Drives(stream.medium, target, target.force_max_n)
            bins = _binned(drives, min(_TIMELINE_BINS, len(drives)))
        timelines[name] = Timeline(touch.start_s - start_s, touch.seconds, bins)
    if (sound := _sound(made)) is not None:
        onsets_s = np.array([onset.time_s for onset in sound.onsets])
        first_s = made["sound"].start_s - start_s
        timelines["sound"] = replace(timelines["sound"], onsets_s=first_s + onsets_s, levels=sound.levels)
    return timelines


def _binned(drives: Drives, count: int) -> Float32s:
    """The greatest drive of each actuator of the first panel in `count` spans, float32 [actuators, count]."""
    frames = np.arange(len(drives)) * count // len(drives)
    rows, columns = drives.drives(0)[0].shape
    image = np.zeros((rows * columns, count), np.float32)
    for i, span in enumerate(frames.tolist()):
        image[:, span] = np.maximum(image[:, span], drives.drives(i)[0].ravel())
    return image
