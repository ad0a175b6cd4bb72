"""Makes the page that plays and edits the touch of a movie, from the drives of an array for each track."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import UInt8s
from touchfield.compute.threads import Progress, silent
from touchfield.container import TouchReader
from touchfield.devices import Device
from touchfield.errors import InvalidArgument
from touchfield.files import read_bytes
from touchfield.network.opening import open_stream
from touchfield.pipeline.array_medium import Drives, array_drives
from touchfield.pipeline.stream import stream_device
from touchfield.tasks.touch_tracks import TrackFile, is_movie, touch_tracks
from touchfield.viewer.timeline import timeline_page

MAX_TABLE_BYTES: Final = 1 << 28
MAX_MOVIE_BYTES: Final = 1 << 28
"""Of a movie within a page: as text it takes a third more, and browsers open texts up to 2^29 characters."""
_FULL: Final = 255
_ARRAY: Final = 2


class TimelinePage(NamedTuple):
    """A page, and what it shows of each track."""

    html: str
    figures: dict[str, Any]


def movie_bytes(path: str | Path) -> bytes:
    """Return a movie that is put into a page; SourceError if it has more than `MAX_MOVIE_BYTES`."""
    return read_bytes(path, MAX_MOVIE_BYTES, "a movie that fits into a page")


def is_for_array(path: str | Path) -> bool:
    """True if a ``.touch`` file was made for an array of actuators."""
    with TouchReader(path) as reader:
        return reader.head.device_type == _ARRAY


def view_timeline(source: str | Path, kind: str | None, report: Progress = silent) -> TimelinePage:
    """Return the page of a movie's touch, or of a ``.touch`` file alone.

    `kind` is the media type of a movie that browsers play, else None. Every track is shown on the device of
    the first one that was made for an array. Raises TouchfieldError if the movie cannot be read, no track is
    for an array, or the drives take more than `MAX_TABLE_BYTES`.
    """
    with tempfile.TemporaryDirectory() as folder:
        tracks, notes = touch_tracks(source, Path(folder))
        if kind is None and is_movie(source):
            ending = Path(source).suffix
            notes += (f"Without picture: not every browser plays {ending}. In .mp4 it plays with the touch.",)
        device = _device_of(tracks, str(source))
        _check_size(tracks, device, str(source))
        total, done = sum(track.frame_count for track in tracks), 0
        rows, tables = list[dict[str, Any]](), list[UInt8s]()
        for track in tracks:
            parts = _drive_tables(track, device, report, done, total)
            done += track.frame_count
            tables += parts.values()
            rows.append(_row(track, parts))
    columns, lattice_rows, _ = device.lattice
    description = {
        "movie": Path(source).name,
        "device": device.title,
        "columns": columns,
        "rows": lattice_rows,
        "notes": list(notes),
        "tracks": rows,
    }
    movie = None if kind is None else (movie_bytes(source), kind)
    figures = {"tracks": [{key: row[key] for key in ("name", "frames", "rate_hz", "at_s")} for row in rows]}
    page = timeline_page(description, tables, movie)
    return TimelinePage(page, figures | ({"movie_notes": list(notes)} if notes else {}))


def _row(track: TrackFile, parts: dict[str, UInt8s]) -> dict[str, Any]:
    return {
        "name": track.name,
        "frames": track.frame_count,
        "rate_hz": track.rate_hz,
        "crc32": track.crc32,
        "at_s": track.at_s,
        "parts": list(parts),
    }


def _device_of(tracks: tuple[TrackFile, ...], name: str) -> Device:
    for track in tracks:
        with open_stream(track.path) as opened:
            device = stream_device(opened)
        if device.is_array:
            return device
    hint = "Show it in the page of a field: --page field."
    raise InvalidArgument(name, "touch for a point device", "touch for an array of actuators", hint)


def _check_size(tracks: tuple[TrackFile, ...], device: Device, name: str) -> None:
    columns, rows, _ = device.lattice
    size = 2 * columns * rows * sum(track.frame_count for track in tracks)
    if size > MAX_TABLE_BYTES:
        hint = "Take fewer frames, or show it in the page of a field: --page field."
        raise InvalidArgument(name, f"{size:,} bytes of drives", f"at most {MAX_TABLE_BYTES:,}", hint)


def _drive_tables(
    track: TrackFile, device: Device, report: Progress, done: int, total: int
) -> dict[str, UInt8s]:
    """Drives by "force" and "vibration", uint8 [frames, actuators]; a part that is always 0 is left out."""
    columns, rows, _ = device.lattice
    force, vibration = (np.zeros((track.frame_count, columns * rows), np.uint8) for _ in range(2))
    with open_stream(track.path) as opened:
        drives: Drives = array_drives(opened, device)
        for frame in range(track.frame_count):
            for table, part in zip((force, vibration), drives.parts(frame), strict=True):
                table[frame] = np.rint(_FULL * part[0]).ravel()
            report(done + frame + 1, total)
    parts = {"force": force, "vibration": vibration}
    used = {name: table for name, table in parts.items() if table.any()}
    return used or {"force": force}
