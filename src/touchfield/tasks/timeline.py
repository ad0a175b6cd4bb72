"""Applies the edit list of a movie's touch: strengths by frames, mute and offset of each track.

A track without strengths keeps its bytes. One with strengths is decoded, scaled and coded again; an offset
changes the second of the movie at which a track begins, and a muted track is left out.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, require_ending
from touchfield.files import refuse_overwriting
from touchfield.filters.strength import count_limited, scale_frames
from touchfield.network.mux import TimedStream, after_picture_s, mux_streams, require_movie
from touchfield.pipeline.result import Result
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.editing import write_result
from touchfield.tasks.matching import read_medium
from touchfield.tasks.timeline_edits import TrackEdits, read_timeline
from touchfield.tasks.touch_tracks import TouchTrack, is_movie, touch_tracks

_MADE_AGAIN: Final = "Make the page of this file again (touchfield view), and edit there."


@dataclass
class _Report:
    """Figures of each track, and notes."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def edit_timeline(
    source: str | Path,
    out: str | Path,
    edits: str | Path,
    spec: EncodeSpec | None = None,
    report: Progress = silent,
) -> Result:
    """Write a movie, or a ``.touch`` file, with the edits that its page saved.

    `source` is the movie whose touch was edited, or a ``.touch`` file; `out` is a movie (.mp4, .m4v, .mov,
    .ts, .mkv), whose picture and sound are copied, or OUT.touch for a source with one track. `edits` is the
    edit list, and `spec` that of the coder of tracks that change.

    Raises SourceError if a file cannot be read; InvalidArgument if the edits are those of other tracks, every
    track is muted, or `out` cannot hold the result. No file `out` is then left.
    """
    source, out = Path(source), Path(out)
    refuse_overwriting(out, source, edits)
    _check_forms(source, out)
    with tempfile.TemporaryDirectory() as name:
        tracks, notes = touch_tracks(source, Path(name))
        found = _Report(notes=list(notes))
        pairs = _paired(tracks, read_timeline(edits), found)
        audible = [(track, wanted) for track, wanted in pairs if not wanted.is_muted]
        if not audible:
            raise InvalidArgument(str(edits), "every track muted", "a track that is left")
        found.notes += [f"{track.name}: muted, and left out" for track, wanted in pairs if wanted.is_muted]
        paths = [_edited(*pair, Path(name), spec, report, found) for pair in audible]
        if is_movie(source) and out.suffix.lower() != ".touch":
            _write_movie(source, audible, paths, out, report)
        else:
            _write_touch(audible, paths, out)
    figures = {"file": str(out), "tracks": found.rows, "file_bytes": out.stat().st_size}
    return Result(figures, tuple(found.notes))


def _check_forms(source: Path, out: Path) -> None:
    if is_movie(source) and out.suffix.lower() != ".touch":
        require_movie(out)
    else:
        hint = "" if is_movie(source) else f"Put it into a movie with touchfield mux; {source.name} has none."
        require_ending(out, "OUT.touch", hint=hint)


def _paired(
    tracks: Sequence[TouchTrack], edits: Sequence[TrackEdits], found: _Report
) -> list[tuple[TouchTrack, TrackEdits]]:
    """Each track with its edits, which must be those of a track with as many frames at the same rate."""
    by_name = {track.name: track for track in tracks}
    for wanted in edits:
        track = by_name.get(wanted.name)
        if track is None:
            expected = f"one of {', '.join(by_name)}"
            raise InvalidArgument(f"{wanted.location}.name", repr(wanted.name), expected, _MADE_AGAIN)
        if (wanted.frame_count, wanted.rate_hz) != (track.frame_count, track.rate_hz):
            edited = f"{wanted.frame_count} frames at {wanted.rate_hz:g} Hz"
            expected = f"{track.frame_count} at {track.rate_hz:g} Hz, as the track has"
            raise InvalidArgument(wanted.location, edited, expected, _MADE_AGAIN)
        if wanted.crc32 != track.crc32:
            found.notes.append(f"{track.name}: another file of the same frames was edited")
    named = {wanted.name: wanted for wanted in edits}
    for track in tracks:
        if track.name not in named:
            found.notes.append(f"{track.name}: not in the edit list, and kept as it is")
    return [(track, named.get(track.name) or _no_edits(track)) for track in tracks]


def _no_edits(track: TouchTrack) -> TrackEdits:
    return TrackEdits(track.name, track.frame_count, track.rate_hz, track.crc32)


def _edited(
    track: TouchTrack,
    edits: TrackEdits,
    folder: Path,
    spec: EncodeSpec | None,
    report: Progress,
    found: _Report,
) -> Path:
    """The ``.touch`` file of a track with its strengths: its own, if there are none."""
    path, limited = track.path, 0
    if edits.strengths:
        # a track that is silent in all its frames is what was wanted
        prepared = read_medium(track.path, replace(spec or EncodeSpec(), allow_empty=True))
        force_max_n = prepared.device.force_max_n
        limited = count_limited(prepared.medium, edits.strengths, force_max_n)
        medium = scale_frames(prepared.medium, edits.strengths, force_max_n)
        path = folder / f"edited-{len(found.rows)}.touch"
        written = write_result(prepared, [track.path], medium, path, report)
        found.notes += [f"{track.name}: {note}" for note in written.notes]
        if prepared.spec.touch.mode != "lossless":
            note = "frames without a strength are coded again: --mode lossless keeps their bits"
            found.notes.append(f"{track.name}: {note}")
    if limited:
        found.notes.append(f"{track.name}: {limited} frames are limited to the largest force of the device")
    found.rows.append(
        {
            "name": track.name,
            "frames": track.frame_count,
            "regions": len(edits.strengths),
            "limited_frames": limited,
            "offset_ms": edits.offset_ms,
            "touch_bytes": path.stat().st_size,
        }
    )
    return path


def _write_movie(
    source: Path,
    pairs: Sequence[tuple[TouchTrack, TrackEdits]],
    paths: Sequence[Path],
    out: Path,
    report: Progress,
) -> None:
    streams = [
        TimedStream(path, after_picture_s(source, track.at_s + edits.offset_ms / 1000), track.name)
        for (track, edits), path in zip(pairs, paths, strict=True)
    ]
    mux_streams(source, streams, out, report)


def _write_touch(pairs: Sequence[tuple[TouchTrack, TrackEdits]], paths: Sequence[Path], out: Path) -> None:
    if len(pairs) > 1:
        found = f"{len(pairs)} tracks of touch"
        raise InvalidArgument(str(out), found, "a movie, which holds several: OUT.mp4")
    (_, edits), path = pairs[0], paths[0]
    if edits.offset_ms:
        found = f"an offset of {edits.offset_ms} ms"
        raise InvalidArgument(str(out), found, "a movie, which has the time of its touch: OUT.mp4")
    with atomic_path(out) as temporary:
        shutil.copyfile(path, temporary)
