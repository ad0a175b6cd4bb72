"""Shows a stream in Rerun, a viewer of robotics data (extra: rerun): ``touchfield view STREAM --rerun``.

A recording has, on the timeline "media" (seconds of the medium), the samples of the field as points and some
of their forces as arrows, the pose of each body, and the hand and its force from a log of ``play``. The field
of a rigid body is stored once, in the frame of the body. What is left out is bounded by the limits below, and
reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.errors import import_extra
from touchfield.medium import ForceField, HapticMedium, HapticScene
from touchfield.medium.pose_track import PoseTrack
from touchfield.network.opening import open_stream
from touchfield.render.point_device import axes_of_text
from touchfield.tasks.play_log import read_log
from touchfield.tasks.play_mcap import is_mcap
from touchfield.tasks.play_mcap_log import read_mcap_log

TIMELINE: Final = "media"
MAX_POINTS: Final = 20_000
"""Samples of a field that are shown."""

MAX_ARROWS: Final = 2_000
"""Forces of a field that are shown."""

MAX_FIELDS: Final = 200
"""Frames of fields that change, of all bodies together; a body has at least one."""

MAX_POSES: Final = 20_000
"""Poses of a body, and ticks of a log."""

_ARROW_SAMPLES: Final = 4.0  # length of the largest force, in samples of the lattice
_DIRECTIONS: Final = (("L", "R"), ("D", "U"), ("F", "B"))  # of the box: negative, positive


@dataclass(frozen=True)
class RerunScene:
    """What a recording holds; `summary` has stable keys, `notes` name what was left out."""

    summary: dict[str, Any]
    notes: tuple[str, ...]


def view_in_rerun(
    stream: str | Path, out: Path | None = None, log: Path | None = None, report: Progress = silent
) -> RerunScene:
    """Write a stream as a recording of Rerun, atomically, or open the viewer if `out` is None.

    log : CSV or MCAP of ``play --log``, or None

    Raises MissingExtra if rerun-sdk is not installed, InvalidArgument or SourceError if the log or the output
    is unusable, FormatError if the stream cannot be read.
    """
    ticks = None if log is None else read_mcap_log(log) if is_mcap(log) else read_log(log)
    rerun = import_extra("rerun", f"{stream} in Rerun", "rerun-sdk", "rerun")
    with open_stream(stream) as opened:
        recording = rerun.RecordingStream("touchfield")
        logger = _Logger(rerun, recording, report)
        if out is None:
            recording.spawn()
            logger.add(opened.scene or opened.medium, ticks)
            recording.flush()
        else:
            # `save` only prints that a disk is full, and may wait for ever; only a single read makes a valid
            # file, whose bytes are bounded by the limits
            written = recording.binary_stream()
            logger.add(opened.scene or opened.medium, ticks)
            with atomic_path(out) as temporary:
                temporary.write_bytes(written.read() or b"")
    return RerunScene(logger.counts, tuple(logger.notes))


class _Logger:
    """Adds parts of a scene to a recording, and counts them."""

    def __init__(self, rerun: Any, recording: Any, report: Progress) -> None:
        self._rerun, self._recording, self._report = rerun, recording, report
        self.counts = dict.fromkeys(("fields", "points", "arrows", "bodies", "poses", "ticks"), 0)
        self.notes: dict[str, None] = {}
        self._rng = np.random.default_rng(0)

    def add(self, shown: HapticMedium | HapticScene, ticks: Float64s | None) -> None:
        """Add a medium or a scene of bodies, and the ticks of a log."""
        self._add_axes(shown.axes)
        if isinstance(shown, HapticScene):
            changing = sum(not body.is_rigid for body in shown.objects)
            limit = max(1, MAX_FIELDS // max(1, changing))
            for number, body in enumerate(shown.objects):
                entity = f"/field/bodies/{number}"
                self._add_track(entity, body.track, shown.rate_hz)
                self._add_medium(f"{entity}/field", body.medium, shown.rate_hz, limit)
            self.counts["bodies"] = len(shown.objects)
        else:
            self._add_medium("/field", shown, shown.rate_hz, MAX_FIELDS)
        if ticks is not None:
            self._add_ticks(ticks)

    def _add_axes(self, axes: str) -> None:
        """Tell the viewer which axis is up, if the text of the axes names directions; north is away."""
        box = axes_of_text(axes.replace("east", "right").replace("north", "away"))
        if box is None:
            self.notes[f"axes {axes!r}: no direction is known as up"] = None
            return
        rows = np.abs(box).argmax(axis=0)
        letters = "".join(_DIRECTIONS[row][int(box[row, n] > 0)] for n, row in enumerate(rows))
        self._recording.log("/", getattr(self._rerun.ViewCoordinates, letters), static=True)

    def _add_medium(self, entity: str, medium: HapticMedium, rate_hz: float, limit: int) -> None:
        """Add at most `limit` frames of a medium; a single one is static."""
        frames = _thinned(len(medium), limit)
        if len(frames) < len(medium):
            self.notes[f"{len(frames)} of {len(medium)} frames of a field are shown"] = None
        for shown, frame in enumerate(frames):
            if len(medium) > 1:
                self._recording.set_time(TIMELINE, duration=frame / rate_hz)
            self._add_field(entity, medium[frame], is_static=len(medium) == 1)
            self._report(shown + 1, len(frames))

    def _add_field(self, entity: str, field: ForceField, *, is_static: bool) -> None:
        """Add samples as points that are coloured by their force, and the forces of some as arrows."""
        forces_n, count = field.vectors_n(), field.support_count
        index = self._rng.permutation(count)[:MAX_POINTS]
        if len(index) < count:
            self.notes[f"at most {MAX_POINTS:,} samples of a field are shown, at random"] = None
        forces_n, points_m = forces_n[index], field.grid.to_m(field.positions()[index])
        size_n = np.linalg.norm(forces_n, axis=1)
        peak_n = float(size_n.max(initial=0.0)) or 1.0
        spacing_m = max(field.grid.spacing_m)
        colors = _colors(size_n / peak_n)
        points = self._rerun.Points3D(points_m, colors=colors, radii=0.25 * spacing_m)
        arrows = self._rerun.Arrows3D(
            origins=points_m[:MAX_ARROWS],
            vectors=forces_n[:MAX_ARROWS] * (_ARROW_SAMPLES * spacing_m / peak_n),
            colors=colors[:MAX_ARROWS],
        )
        self._recording.log(f"{entity}/samples", points, static=is_static)
        self._recording.log(f"{entity}/forces", arrows, static=is_static)
        self.counts["fields"] += 1
        self.counts["points"] += len(points_m)
        self.counts["arrows"] += min(len(points_m), MAX_ARROWS)

    def _add_track(self, entity: str, track: PoseTrack, rate_hz: float) -> None:
        frames = np.array(_thinned(len(track), MAX_POSES))
        if len(frames) < len(track):
            self.notes[f"{len(frames)} of {len(track)} poses of a body are shown"] = None
        poses = self._rerun.Transform3D.columns(
            translation=track.positions_m[frames], quaternion=track.quaternions[frames][:, [1, 2, 3, 0]]
        )
        self._send(entity, frames / rate_hz, poses)
        self.counts["poses"] += len(frames)

    def _add_ticks(self, ticks: Float64s) -> None:
        """Add the hand as a point, its force as an arrow of 10 mm for a newton, and as a curve."""
        some = ticks[_thinned(len(ticks), MAX_POSES)]
        if len(some) < len(ticks):
            self.notes[f"{len(some)} of {len(ticks)} ticks of the log are shown"] = None
        media_s, points_m, forces_n = some[:, 0], some[:, 1:4], some[:, 4:]
        red = (217, 77, 26)
        self._recording.log("/hand/position", self._rerun.Points3D.from_fields(radii=0.002), static=True)
        self._recording.log("/hand/force", self._rerun.Arrows3D.from_fields(colors=red), static=True)
        self._send("/hand/position", media_s, self._rerun.Points3D.columns(positions=points_m))
        arrows = self._rerun.Arrows3D.columns(origins=points_m, vectors=0.01 * forces_n)
        self._send("/hand/force", media_s, arrows)
        size_n = np.linalg.norm(forces_n, axis=1)
        self._send("/hand/force_n", media_s, self._rerun.Scalars.columns(scalars=size_n))
        self.counts["ticks"] = len(some)

    def _send(self, entity: str, times_s: Float64s, columns: Any) -> None:
        times = self._rerun.TimeColumn(TIMELINE, duration=times_s)
        self._recording.send_columns(entity, indexes=[times], columns=columns)


def _thinned(count: int, limit: int) -> list[int]:
    """Return at most `limit` of `count` indices, evenly spaced, with the first and the last."""
    indices: list[int] = np.linspace(0, count - 1, min(count, limit)).astype(np.int64).tolist()
    return indices


def _colors(fractions: Float64s) -> Any:
    """Return colours from blue to yellow, uint8 [n, 3], for fractions of the largest force."""
    low, high = np.array([40.0, 60.0, 150.0]), np.array([255.0, 210.0, 60.0])
    return (low + (high - low) * fractions[:, None]).astype(np.uint8)
