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
from touchfield.tasks.touch_tracks import TrackFile, is_movie, touch_tracks

_RENEW_PAGE: Final = "Make the page of this file again (touchfield view), and edit there."


@dataclass
class _Summary:
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
        summary = _Summary(notes=list(notes))
        pairs = _paired(tracks, read_timeline(edits), summary)
        audible = [(track, track_edits) for track, track_edits in pairs if not track_edits.is_muted]
        if not audible:
            raise InvalidArgument(str(edits), "every track muted", "a track that is left")
        summary.notes += [
            f"{track.name}: muted, and left out" for track, track_edits in pairs if track_edits.is_muted
        ]
        paths = [_edited_file(*pair, Path(name), spec, report, summary) for pair in audible]
        if is_movie(source) and out.suffix.lower() != ".touch":
            _write_movie(source, audible, paths, out, report)
        else:
            _write_touch(audible, paths, out)
    figures = {"file": str(out), "tracks": summary.rows, "file_bytes": out.stat().st_size}
    return Result(figures, tuple(summary.notes))


def _check_forms(source: Path, out: Path) -> None:
    if is_movie(source) and out.suffix.lower() != ".touch":
        require_movie(out)
    else:
        hint = "" if is_movie(source) else f"Put it into a movie with touchfield mux; {source.name} has none."
        require_ending(out, "OUT.touch", hint=hint)


def _paired(
    tracks: Sequence[TrackFile], edits: Sequence[TrackEdits], summary: _Summary
) -> list[tuple[TrackFile, TrackEdits]]:
    """Each track with its edits, which must be those of a track with as many frames at the same rate."""
    by_name = {track.name: track for track in tracks}
    for track_edits in edits:
        track = by_name.get(track_edits.name)
        if track is None:
            expected = f"one of {', '.join(by_name)}"
            raise InvalidArgument(
                f"{track_edits.location}.name", repr(track_edits.name), expected, _RENEW_PAGE
            )
        if (track_edits.frame_count, track_edits.rate_hz) != (track.frame_count, track.rate_hz):
            edited = f"{track_edits.frame_count} frames at {track_edits.rate_hz:g} Hz"
            expected = f"{track.frame_count} at {track.rate_hz:g} Hz, as the track has"
            raise InvalidArgument(track_edits.location, edited, expected, _RENEW_PAGE)
        if track_edits.crc32 != track.crc32:
            summary.notes.append(f"{track.name}: another file of the same frames was edited")
    named = {track_edits.name: track_edits for track_edits in edits}
    for track in tracks:
        if track.name not in named:
            summary.notes.append(f"{track.name}: not in the edit list, and kept as it is")
    return [(track, named.get(track.name) or _no_edits(track)) for track in tracks]


def _no_edits(track: TrackFile) -> TrackEdits:
    return TrackEdits(track.name, track.frame_count, track.rate_hz, track.crc32)


def _edited_file(
    track: TrackFile,
    edits: TrackEdits,
    folder: Path,
    spec: EncodeSpec | None,
    report: Progress,
    summary: _Summary,
) -> Path:
    """The ``.touch`` file of a track with its strengths: its own, if there are none."""
    path, limited = track.path, 0
    if edits.strengths:
        # strengths of 0 % may silence every frame
        prepared = read_medium(track.path, replace(spec or EncodeSpec(), allow_empty=True))
        force_max_n = prepared.device.force_max_n
        limited = count_limited(prepared.medium, edits.strengths, force_max_n)
        medium = scale_frames(prepared.medium, edits.strengths, force_max_n)
        path = folder / f"edited-{len(summary.rows)}.touch"
        written = write_result(prepared, [track.path], medium, path, report)
        summary.notes += [f"{track.name}: {note}" for note in written.notes]
        if prepared.spec.touch.mode != "lossless":
            note = "frames without a strength are coded again: --mode lossless keeps their bits"
            summary.notes.append(f"{track.name}: {note}")
    if limited:
        summary.notes.append(f"{track.name}: {limited} frames are limited to the largest force of the device")
    summary.rows.append(
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
    pairs: Sequence[tuple[TrackFile, TrackEdits]],
    paths: Sequence[Path],
    out: Path,
    report: Progress,
) -> None:
    streams = [
        TimedStream(path, after_picture_s(source, track.at_s + edits.offset_ms / 1000), track.name)
        for (track, edits), path in zip(pairs, paths, strict=True)
    ]
    mux_streams(source, streams, out, report)


def _write_touch(pairs: Sequence[tuple[TrackFile, TrackEdits]], paths: Sequence[Path], out: Path) -> None:
    if len(pairs) > 1:
        found = f"{len(pairs)} tracks of touch"
        raise InvalidArgument(str(out), found, "a movie, which holds several: OUT.mp4")
    (_, edits), path = pairs[0], paths[0]
    if edits.offset_ms:
        found = f"an offset of {edits.offset_ms} ms"
        raise InvalidArgument(str(out), found, "a movie, which has the time of its touch: OUT.mp4")
    with atomic_path(out) as temporary:
        shutil.copyfile(path, temporary)
