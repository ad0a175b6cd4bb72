"""The forces of an array of motors that stand for the depth of a movie: what approaches, and what is near.

Each motor has a region of the picture, the same as that of the track of the picture, and feels what
`REGION_FRACTION` of its pixels show (`sources.depth.approach`):

- an *approach*: from `MIN_APPROACH` at a time to contact of 4 s to 1 at 1 s, as `guide` drives a vest;
- what is *near* and has become so: up to `MAX_NEAR`, and nothing for what was near all along. The mean
  nearness of a region over its past `ADAPT_S` is subtracted, as skin gets used to a pressure that stays.
  After a cut of the film nearness starts as adapted: not every new shot is felt.

A drive falls by at most 1 in `RELEASE_S`, and below `MIN_DRIVE` a motor is off. Between two depth pictures
the drive stays, for at most `MAX_GAP_S`. All of this is our choice, felt by nobody yet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int64s
from touchfield.compute.threads import Progress, silent
from touchfield.errors import SourceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.sources.depth.approach import MAX_GAP_S, Approach, ApproachModel
from touchfield.sources.depth.movie_depth import MovieDepth
from touchfield.sources.scene import UP_Y_AXES
from touchfield.sources.video.saliency import MAX_EVEN_HZ, MAX_PAUSE_S, MAX_REPEATED

TAGS: Final = ("symbolic", "depth")
REGION_FRACTION: Final = 0.08
"""Of the pixels of a region that must approach: fewer are edges and noise."""
MIN_APPROACH: Final = 0.25
MAX_NEAR: Final = 0.5
NEAR_FRACTION: Final = 0.25
"""Of a region that must be fully near for its motor to be so: a mean, which noise and holes hardly change."""
ADAPT_S: Final = 3.0
MIN_DRIVE: Final = 0.15
RELEASE_S: Final = 0.3
MIN_OVERLAP: Final = 0.25
"""Of the area of a motor that the picture must cover for the motor to have a region."""


@dataclass(frozen=True)
class DepthFeatures:
    """What the depth of a movie shows.

    rate_hz : float
        Of `drives`.
    drives : float32 [frames, rows, columns]
        0 to 1, from the top left; frame 0 is the first depth picture.
    approaches : int
        How often a motor began to feel an approach while no other did.
    known_fraction : float
        Of the pixels of all maps.
    cuts : int
        How often everything changed at once, or depth was missing.
    is_uneven : bool
        The pictures are at unequal times.
    """

    rate_hz: float
    drives: Float32s
    approaches: int
    known_fraction: float
    cuts: int
    is_uneven: bool


@dataclass(frozen=True)
class Regions:
    """Which pixels of a map belong to which motor.

    index : int64 [map height, map width]
        Number of the motor, row by row from the top left; -1 for none.
    shape : (int, int)
        Rows and columns of motors.
    """

    index: Int64s
    shape: tuple[int, int]

    @classmethod
    def of(cls, grid: Grid, picture: tuple[int, int], map_size: tuple[int, int]) -> Regions:
        """Return the regions of the motors of `grid` for a picture of width and height `picture`.

        The whole picture is shown, as large as the array allows, in its middle.
        """
        columns, rows, _ = grid.shape
        pitch = grid.spacing_m[0], grid.spacing_m[1]
        scale = min(columns * pitch[0] / picture[0], rows * pitch[1] / picture[1])
        across = _nearest(columns, pitch[0], scale * picture[0], map_size[0])
        down = _nearest(rows, pitch[1], scale * picture[1], map_size[1])
        index = down[:, None] * columns + across
        return cls(np.where((down[:, None] < 0) | (across < 0), -1, index), (rows, columns))

    def strongest(self, values: Float32s, fraction: float) -> Float32s:
        """Return the value that `fraction` of the pixels of each motor reach, float32 [rows, columns]."""
        out, flat = np.zeros(self.shape[0] * self.shape[1], np.float32), values.ravel()
        if flat.any():
            for motor, pixels in enumerate(self._pixels):
                if len(pixels):
                    place = len(pixels) - math.ceil(fraction * len(pixels))
                    out[motor] = np.partition(flat[pixels], place)[place]
        return out.reshape(self.shape)

    @cached_property
    def _pixels(self) -> list[Int64s]:
        """Pixels of each motor."""
        motors = range(self.shape[0] * self.shape[1])
        return [np.flatnonzero(self.index.ravel() == motor) for motor in motors]

    def mean(self, values: Float32s) -> Float32s:
        """Return the mean of the pixels of each motor, float32 [rows, columns]."""
        count = self.shape[0] * self.shape[1]
        flat = self.index.ravel() + 1
        sums = np.bincount(flat, values.ravel(), count + 1)[1:]
        means = sums / np.maximum(np.bincount(flat, minlength=count + 1)[1:], 1)
        return means.reshape(self.shape).astype(np.float32)


def _nearest(motors: int, pitch_m: float, side_m: float, pixels: int) -> Int64s:
    """Return the motor of each pixel along one axis, int64 [pixels]; -1 for none."""
    position = (np.arange(pixels) + 0.5) / pixels * side_m + (motors * pitch_m - side_m) / 2
    motor = np.clip(np.floor(position / pitch_m), 0, motors - 1).astype(np.int64)
    covered_m = np.bincount(motor, minlength=motors) * side_m / pixels
    return np.where(covered_m[motor] >= MIN_OVERLAP * pitch_m, motor, -1)


class DepthDrives:
    """The drives of one map after the other, in the order of time."""

    def __init__(self, regions: Regions) -> None:
        self._regions, self._model = regions, ApproachModel()
        self._usual = self._drives = np.zeros(regions.shape, np.float32)
        self._time_s = 0.0

    @property
    def cuts(self) -> int:
        """Cuts and gaps after the first picture."""
        return self._model.cuts

    def update(self, depth: Float32s, time_s: float) -> tuple[Float32s, bool]:
        """Return the drives of a map, float32 [rows, columns], and whether something approaches."""
        approach = self._model.update(depth, time_s)
        passed_s, self._time_s = time_s - self._time_s, time_s
        urgency = self._regions.strongest(approach.urgency, REGION_FRACTION)
        drives = np.where(urgency > 0, MIN_APPROACH + (1 - MIN_APPROACH) * urgency, 0)
        drives = np.maximum(drives, self._near(approach, passed_s))
        if not approach.is_new:
            drives = np.maximum(drives, self._drives - passed_s / RELEASE_S)
        self._drives = np.where(drives >= MIN_DRIVE, drives, 0).astype(np.float32)
        return self._drives, bool(urgency.any())

    def _near(self, approach: Approach, passed_s: float) -> Float32s:
        nearness = np.minimum(self._regions.mean(approach.nearness) / NEAR_FRACTION, 1)
        if approach.is_new:
            self._usual = nearness
        self._usual = self._usual + (nearness - self._usual) * (1 - math.exp(-passed_s / ADAPT_S))
        return np.asarray(MAX_NEAR * np.maximum(nearness - self._usual, 0), np.float32)


def depth_features(
    depth: MovieDepth, grid: Grid, picture: tuple[int, int] | None, report: Progress = silent
) -> DepthFeatures:
    """Return what a depth shows to the motors of `grid`.

    `picture` is width and height of the movie's picture; without it, the depth's own are used. The depth
    covers the whole picture. Raises SourceError if a depth picture cannot be read.
    """
    regions = Regions.of(grid, picture or depth.size, depth.map_size)
    rule, count = DepthDrives(regions), len(depth.times_s)
    drives = np.zeros((count, *regions.shape), np.float32)
    is_approach, known = np.zeros(count, np.bool_), 0.0
    for frame, (depth_map, time_s) in enumerate(zip(depth.maps(), depth.times_s.tolist(), strict=True)):
        drives[frame], is_approach[frame] = rule.update(depth_map, time_s)
        known += float((depth_map > 0).mean()) / count
        report(frame + 1, count)
    shown, rate_hz, is_uneven = even_frames(depth)
    even = np.where((shown >= 0)[:, None, None], drives[shown], 0)
    return DepthFeatures(rate_hz, even, _starts(is_approach), known, rule.cuts, is_uneven)


def _starts(flags: Bools) -> int:
    return int((flags & ~np.concatenate([[False], flags[:-1]])).sum())


def even_frames(depth: MovieDepth) -> tuple[Int64s, float, bool]:
    """Return the depth picture of each frame at one rate, that rate, and whether the times are unequal.

    A picture stays until the next one, for at most `MAX_GAP_S`, after which the number is -1. SourceError if
    few pictures would become very many frames.
    """
    times_s: Float64s = depth.times_s - depth.times_s[0]
    gaps_s = np.diff(times_s)
    gaps_s = gaps_s[gaps_s > 0]
    if not len(gaps_s):
        return np.zeros(1, np.int64), 1.0, False
    even_hz = _even_rate(times_s)
    if even_hz is not None and even_hz <= MAX_EVEN_HZ:
        return np.arange(len(times_s)), even_hz, False
    rate_hz = float(np.clip(round(1 / max(float(np.quantile(gaps_s, 0.1)), 1e-3)), 1, MAX_EVEN_HZ))
    count = max(1, round((times_s[-1] + float(np.median(gaps_s))) * rate_hz))
    if count > max(MAX_PAUSE_S * rate_hz, MAX_REPEATED * len(times_s)):
        found = f"{len(times_s)} depth pictures in {times_s[-1]:.4g} s"
        raise SourceError(depth.name, found, "depth without long pauses", "Cut the movie.")
    now_s = np.arange(count) / rate_hz + 0.5 / rate_hz
    shown = np.maximum(np.searchsorted(times_s, now_s, "right") - 1, 0)
    return np.where(now_s - times_s[shown] <= MAX_GAP_S + 1 / rate_hz, shown, -1), rate_hz, True


def _even_rate(times_s: Float64s) -> float | None:
    """Return the rate of times that are equal but for rounding, if possible a usual one; else None."""
    mean_hz = (len(times_s) - 1) / float(times_s[-1])
    for rate_hz in (float(round(mean_hz)), round(mean_hz * 1.001) / 1.001, mean_hz):
        if rate_hz and (np.abs(times_s - np.arange(len(times_s)) / rate_hz) <= 0.5 / rate_hz).all():
            return rate_hz
    return None


def depth_medium(features: DepthFeatures, grid: Grid, force_max_n: float) -> HapticMedium:
    """Return the forces along z on (columns, rows, 1) samples, y up; there is no vibration."""
    rows = features.drives.shape[1]

    def make(frame: int) -> ForceField:
        row, column = np.nonzero(features.drives[frame])
        if not len(row):
            return ForceField.empty(grid)
        forces_n = np.zeros((len(row), 3), np.float32)
        forces_n[:, 2] = features.drives[frame][row, column] * np.float32(force_max_n)
        return ForceField.from_support(grid, np.stack([column, rows - 1 - row, 0 * row], axis=1), forces_n)

    count = len(features.drives)
    return HapticMedium(grid, features.rate_hz, count, make, axes=UP_Y_AXES, tags=TAGS)
