"""Scales the touch of a medium over time: a strength in percent for runs of frames.

Forces and vibrations of a frame are multiplied by the same factor and keep their directions and frequencies.
A result above the largest force of the device is limited to it. Frames without a strength keep their bits.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.limit import limit_forces
from touchfield.filters.registry import add_note
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.medium import VibrationFrame

MAX_PERCENT: Final = 200
_UNCHANGED: Final = 100


@dataclass(frozen=True)
class Strength:
    """A strength in percent (0 to `MAX_PERCENT`) of frames `first_frame` to `stop_frame` - 1.

    Raises `InvalidArgument` if the run has no frame, or the strength is out of range.
    """

    first_frame: int
    stop_frame: int
    percent: int

    def __post_init__(self) -> None:
        if not 0 <= self.first_frame < self.stop_frame:
            found = f"frames {self.first_frame} to {self.stop_frame}"
            raise InvalidArgument("strength", found, "a first frame from 0 on, and a later stop frame")
        if not 0 <= self.percent <= MAX_PERCENT:
            raise InvalidArgument("strength", f"{self.percent} %", f"0 to {MAX_PERCENT} %")


def require_ascending(where: str, strengths: Sequence[Strength], frame_count: int) -> None:
    """Raise `InvalidArgument` unless runs ascend without overlap, within the frames of a medium."""
    for before, after in zip(strengths, strengths[1:]):
        if after.first_frame < before.stop_frame:
            found = f"frame {after.first_frame} after a run that stops at {before.stop_frame}"
            raise InvalidArgument(where, found, "runs of frames in order, without overlap")
    if strengths and strengths[-1].stop_frame > frame_count:
        raise InvalidArgument(where, f"frame {strengths[-1].stop_frame}", f"at most {frame_count} frames")


def scale_frames(medium: HapticMedium, strengths: Sequence[Strength], force_max_n: float) -> HapticMedium:
    """Return a medium whose frames have the given strengths; frames of no run have 100 %.

    `strengths` ascend and do not overlap; `force_max_n` is the largest force of the result, newtons. Raises
    InvalidArgument if the runs overlap, or have frames that the medium has not.
    """
    require_ascending("strengths", strengths, medium.frame_count)
    runs = tuple(strengths)
    starts = [run.first_frame for run in runs]

    def percent_of(frame: int) -> int:
        index = bisect_right(starts, frame) - 1
        return runs[index].percent if index >= 0 and frame < runs[index].stop_frame else _UNCHANGED

    def make_frame(frame: int) -> ForceField:
        percent = percent_of(frame)
        return medium[frame] if percent == _UNCHANGED else _scaled(medium[frame], percent, force_max_n)

    def vibration(frame: int) -> VibrationFrame:
        assert medium.vibration is not None
        percent, band = percent_of(frame), medium.vibration(frame)
        return band if percent == _UNCHANGED else _scaled_band(band, percent, force_max_n)

    text = ", ".join(f"{run.first_frame}-{run.stop_frame}: {run.percent} %" for run in runs)
    return replace(
        medium,
        make_frame=make_frame,
        vibration=None if medium.vibration is None else vibration,
        segments=None,
        provenance=add_note(medium.provenance, "edits", f"strength ({text})") if runs else medium.provenance,
    )


def _scaled(field: ForceField, percent: int, force_max_n: float) -> ForceField:
    scaled = ForceField.empty(field.grid) if percent == 0 else field.scaled(percent / 100)
    return limit_forces(scaled, force_max_n) if percent > _UNCHANGED else scaled


def _scaled_band(band: VibrationFrame, percent: int, force_max_n: float) -> VibrationFrame:
    amplitudes_n = band.amplitudes_n * np.float32(percent / 100)
    if percent > _UNCHANGED:
        amplitudes_n = np.minimum(amplitudes_n, np.float32(force_max_n))
    is_driven = amplitudes_n > 0
    return VibrationFrame(
        band.grid, band.positions[is_driven], amplitudes_n[is_driven], band.frequencies_hz[is_driven]
    )


def count_limited(medium: HapticMedium, strengths: Sequence[Strength], force_max_n: float) -> int:
    """Count the frames that `scale_frames` limits to `force_max_n`."""
    return sum(
        _peak_n(medium, frame) * run.percent / 100 > force_max_n
        for run in strengths
        if run.percent > _UNCHANGED
        for frame in range(run.first_frame, run.stop_frame)
    )


def _peak_n(medium: HapticMedium, frame: int) -> float:
    peak_n = float(medium[frame].support().amplitudes_n.max(initial=0.0))
    if medium.vibration is None:
        return peak_n
    return max(peak_n, float(medium.vibration(frame).amplitudes_n.max(initial=0.0)))
