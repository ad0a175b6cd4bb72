"""Reads the edit list that the page of a movie's touch saves: strengths by frames, mute and offset by track.

A run of strengths counts frames of its own track, so it moves with the track when the offset changes. All
numbers are whole: the page plays what the command writes.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from touchfield.filters.strength import MAX_PERCENT, Strength, require_ascending
from touchfield.json_values import JsonValue, read_json

FORMAT: Final = "touchfield-timeline"
VERSION: Final = 1
MAX_OFFSET_MS: Final = 3_600_000
_MAX_BYTES: Final = 1 << 24
_MAX_TRACKS: Final = 64
_MAX_FRAMES: Final = (1 << 32) - 1
_EXPECTED: Final = "the edit list of a movie, saved by the page of touchfield view"


@dataclass(frozen=True)
class TrackEdits:
    """Edits of one track of touch.

    `frame_count`, `rate_hz` and `crc32` (of the ``.touch`` file) are those of the track for which the edits
    were made. `offset_ms` moves the track to a later time of the movie. `location` is its place in the edit
    list, for errors.
    """

    name: str
    frame_count: int
    rate_hz: float
    crc32: int
    is_muted: bool = False
    offset_ms: int = 0
    strengths: tuple[Strength, ...] = ()
    location: str = ""

    @property
    def has_effect(self) -> bool:
        """True if the edits change the track."""
        return self.is_muted or self.offset_ms != 0 or bool(self.strengths)


def read_timeline(path: str | Path) -> tuple[TrackEdits, ...]:
    """Read the edits of each track.

    Raises SourceError, which names the place in the file, if it is no edit list or a value is out of range.
    """
    document = read_json(path, _MAX_BYTES, _EXPECTED)
    document.at("format").text((FORMAT,))
    document.at("version").bounded_integer(VERSION, VERSION)
    document.only(("format", "version", "movie", "tracks"))
    values = list(document.at("tracks").elements(min_count=1))
    if len(values) > _MAX_TRACKS:
        raise document.at("tracks").wrong(f"{len(values)} tracks", f"at most {_MAX_TRACKS}")
    tracks = tuple(_track(value) for value in values)
    names = [track.name for track in tracks]
    for track, value in zip(tracks, values, strict=True):
        if names.count(track.name) > 1:
            raise value.at("name").wrong(f"{track.name!r} twice", "each track once")
    return tracks


def _track(value: JsonValue) -> TrackEdits:
    keys = ("name", "frames", "rate_hz", "crc32", "is_muted", "offset_ms", "strengths")
    value.only(keys)
    muted = value.at("is_muted", False)
    if not isinstance(muted.value, bool):
        raise muted.refused("true or false")
    frame_count = value.at("frames").bounded_integer(1, _MAX_FRAMES)
    strengths = tuple(_strength(run) for run in value.at("strengths", []).elements())
    location = f"{value.file}: {value.location}"
    require_ascending(f"{location}.strengths", strengths, frame_count)
    return TrackEdits(
        name=value.at("name").text(),
        frame_count=frame_count,
        rate_hz=value.at("rate_hz").number(low=0.0),
        crc32=value.at("crc32").bounded_integer(0, _MAX_FRAMES),
        is_muted=muted.value,
        offset_ms=value.at("offset_ms", 0).bounded_integer(-MAX_OFFSET_MS, MAX_OFFSET_MS),
        strengths=strengths,
        location=location,
    )


def _strength(run: JsonValue) -> Strength:
    run.only(("first_frame", "stop_frame", "percent"))
    first_frame = run.at("first_frame").bounded_integer(0, _MAX_FRAMES - 1)
    return Strength(
        first_frame,
        run.at("stop_frame").bounded_integer(first_frame + 1, _MAX_FRAMES),
        run.at("percent").bounded_integer(0, MAX_PERCENT),
    )
