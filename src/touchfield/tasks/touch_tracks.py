"""Lists the touch of a file: the tracks of a movie, or a ``.touch`` file itself."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from touchfield.container import TouchReader
from touchfield.network.demux import demux_all

PLAYED_MOVIES: Final = {".mp4": "video/mp4", ".m4v": "video/mp4", ".mov": "video/mp4"}
"""Media types of movies that every browser plays, by ending."""

MOVIES: Final = (*PLAYED_MOVIES, ".mkv", ".webm", ".ts", ".mts", ".m2ts", ".m3u8", ".mpd")
"""Endings of files that have their touch as a track with picture and sound."""


@dataclass(frozen=True)
class TrackFile:
    """A track of touch, as a file.

    path : Path
        Its ``.touch`` file.
    name : str
        Its source, such as "sound", by the tag in its head; unique within a movie.
    at_s : float
        Second of the movie at which it begins.
    frame_count, rate_hz : int, float
        Of its head.
    crc32 : int
        Of all bytes of the file.
    """

    path: Path
    name: str
    at_s: float
    frame_count: int
    rate_hz: float
    crc32: int


def is_movie(path: str | Path) -> bool:
    """True for the name of a movie, whose touch is a track of it."""
    return Path(path).suffix.lower() in MOVIES


def touch_tracks(source: str | Path, folder: Path) -> tuple[tuple[TrackFile, ...], tuple[str, ...]]:
    """Return the tracks of a movie, written to `folder`, or the ``.touch`` file `source`; and notes.

    Raises SourceError or FormatError if it cannot be read.
    """
    if not is_movie(source):
        return (_track(Path(source), 0.0, ()),), ()
    extracted = demux_all(source, folder)
    tracks = list[TrackFile]()
    for muxed in extracted:
        tracks.append(_track(Path(muxed.file), muxed.at_s, [track.name for track in tracks]))
    notes = dict.fromkeys(note for muxed in extracted for note in muxed.notes)
    return tuple(tracks), tuple(notes)


def _track(path: Path, at_s: float, used_names: Sequence[str]) -> TrackFile:
    with TouchReader(path) as reader:
        head, data = reader.head, reader.read_all()
    tag = next((tag for tag in head.tags if tag not in ("direct", "symbolic")), "touch")
    copies = sum(name == tag or name.startswith(f"{tag} ") for name in used_names)
    name = f"{tag} {copies + 1}" if copies else tag
    return TrackFile(path, name, at_s, head.frame_count, head.rate_hz, zlib.crc32(data))
