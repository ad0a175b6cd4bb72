"""What comes nearer in a depth map over time, and what is nearer than the scene, for touch of a movie.

Depth counts as ratios only: neither the time to contact nor the nearness depends on the unit of the depth.
The map is small (`reduced_depth`): each of its pixels is the median of up to 16 known samples, since a mean
across an edge is a surface that is not there.

*Approach.* A pixel approaches if its depth z falls over the past `WINDOW_S`, and in each half of it. Speed is
the smaller one of both halves, and the time to contact is z over it. The older depths are the *nearest* ones
within `REACH_PX`: what was as near beside the pixel before has moved sideways, or the camera has turned.
Nothing is known of what was beside the picture, so pixels at its border do not approach. Halves whose speeds
differ by more than `MAX_UNEVEN` are a step in depth: another surface came into view.

*Nearness.* The scene is the upper quartile of the known depths of a picture, low-passed by `SCENE_S`.
Nearness is 0 at half of that depth and 1 at a quarter. What stays near is for `watch_depth`, which adapts.

*Noise and holes.* A pixel is the median of three pictures, and its time that of the middle one. An unknown
pixel keeps its depth for `HOLD_S`. Where more than `CUT_FRACTION` of the pixels change by more than
`CUT_RATIO` at once, the film was cut, and nothing of before counts; nor does it after a gap of more than
`MAX_GAP_S`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Int64s

WINDOW_S: Final = 0.2
"""Noise of a Kinect changes a pixel of the map by some 0.5 %, and 4 s to contact are 5 % in this time."""
REACH_PX: Final = 3
"""For half a window, of 64 along the longer side: what crosses the picture in two seconds."""
MAX_UNEVEN: Final = 3.0
FAR_S: Final = 4.0
"""Time to contact from which an approach counts; as in `guide` (``GuideSpec.contact_s``)."""
FULL_S: Final = 1.0
"""Time to contact of the full urgency; as in `guide`."""
SCENE_QUANTILE: Final = 0.75
SCENE_S: Final = 2.0
NEAR_RATIO, CLOSE_RATIO = 2.0, 4.0
"""The scene's depth over that of a pixel, where nearness begins and where it is 1."""
HOLD_S: Final = 0.5
MAX_GAP_S: Final = 0.5
CUT_RATIO: Final = 1.3
CUT_FRACTION: Final = 0.4

_SAMPLES: Final = 4  # along each side of a pixel of the map
_MIN_KNOWN: Final = 0.5  # of the samples of a pixel
_MEDIAN_FRAMES: Final = 3
_TIME_S: Final = 1e-3  # by which rounded times may differ


class Approach(NamedTuple):
    """What a picture shows, by the pixels of the map, float32 [map height, map width].

    urgency : 0 to 1: from a time to contact of `FAR_S` to one of `FULL_S`; 0 where nothing approaches.
    nearness : 0 to 1.
    is_new : bool; Too little of before counts: the first pictures, also after a cut or a gap.
    """

    urgency: Float32s
    nearness: Float32s
    is_new: bool


def sample_indices(side: int, map_side: int) -> Int64s:
    """Return which rows or columns of a picture of `side` become the samples of `map_side` pixels."""
    return ((np.arange(_SAMPLES * map_side) + 0.5) * side / (_SAMPLES * map_side)).astype(np.int64)


def reduced_depth(samples: Float32s) -> Float32s:
    """Reduce samples, selected by `sample_indices`, to the map: the median of the known ones.

    Both are float32 [rows, columns], 0 where unknown. Fewer than half of the samples known are unknown.
    """
    rows, columns = (side // _SAMPLES for side in samples.shape)
    blocks = samples.reshape(rows, _SAMPLES, columns, _SAMPLES).swapaxes(1, 2).reshape(rows, columns, -1)
    known = (blocks > 0).sum(axis=-1)
    ordered = np.sort(np.where(blocks > 0, blocks, np.inf), axis=-1)
    middle = np.take_along_axis(ordered, np.maximum((known - 1) // 2, 0)[..., None], axis=-1)[..., 0]
    return np.where(known >= _MIN_KNOWN * _SAMPLES**2, middle, 0).astype(np.float32)


@dataclass(frozen=True)
class _Past:
    """A picture of the window: its depths, inf where unknown, and the nearest of their surroundings."""

    time_s: float
    near_half: Float32s
    near_whole: Float32s


class ApproachModel:
    """Computes `Approach` for one map after the other, in the order of time.

    `cuts` counts those after the first picture, with gaps.
    """

    def __init__(self) -> None:
        self.cuts = -1
        self._time_s = -math.inf
        self._start(np.zeros((0, 0), np.float32))

    def update(self, depth: Float32s, time_s: float) -> Approach:
        """Return what the map `depth` of a time shows; its unit is free, and 0 is unknown."""
        if time_s - self._time_s > MAX_GAP_S or self._is_cut(depth):
            self.cuts += 1
            self._start(depth)
        self._time_s = time_s
        known = depth > 0
        self._held[known], self._known_s[known] = depth[known], time_s
        self._held[time_s - self._known_s > HOLD_S] = 0
        self._recent.append((time_s, self._held.copy()))
        times_s, depths = zip(*self._recent, strict=True)
        middle = np.median(np.stack(depths), axis=0).astype(np.float32)
        middle_s = float(np.median(times_s))
        current = np.where(middle > 0, middle, np.float32(np.inf))
        is_new = len(depths) < _MEDIAN_FRAMES
        if is_new:
            self._scene = math.nan
        urgency = self._urgency(current, middle_s, time_s - middle_s)
        return Approach(urgency, self._nearness(current, time_s), is_new)

    def _start(self, depth: Float32s) -> None:
        self._held, self._known_s = depth.copy(), np.full(depth.shape, -math.inf)
        self._recent: deque[tuple[float, Float32s]] = deque(maxlen=_MEDIAN_FRAMES)
        self._window: deque[_Past] = deque()
        self._scene, self._scene_s = math.nan, 0.0  # logarithm of the scene's depth, and when it was found

    def _is_cut(self, depth: Float32s) -> bool:
        both = (depth > 0) & (self._held > 0)
        if not both.any():
            return False
        ratio = depth[both] / self._held[both]
        return float(((ratio > CUT_RATIO) | (ratio < 1 / CUT_RATIO)).mean()) > CUT_FRACTION

    def _urgency(self, current: Float32s, time_s: float, age_s: float) -> Float32s:
        """Return the urgency of the depths of a time, which is `age_s` ago."""
        from scipy.ndimage import minimum_filter

        near_half, near_whole = (
            minimum_filter(current, 2 * n * REACH_PX + 1, mode="nearest") for n in (1, 2)
        )
        self._window.append(_Past(time_s, near_half, near_whole))
        while len(self._window) > 3 and time_s - self._window[1].time_s >= WINDOW_S - _TIME_S:
            self._window.popleft()
        first = self._window[0]
        if len(self._window) < 3 or time_s - first.time_s < WINDOW_S - _TIME_S:
            return np.zeros(current.shape, np.float32)
        middle_s = (first.time_s + time_s) / 2
        middle = min(list(self._window)[1:-1], key=lambda past: abs(past.time_s - middle_s))
        with np.errstate(invalid="ignore", divide="ignore"):  # unknown depths are inf
            before = (first.near_whole - middle.near_half) / (middle.time_s - first.time_s)
            after = (middle.near_half - current) / (time_s - middle.time_s)
            slower, faster = np.minimum(before, after), np.maximum(before, after)
            is_even = np.isfinite(faster) & (slower > 0) & (faster <= MAX_UNEVEN * slower)
            contact_s = np.where(is_even, current / slower - age_s, np.inf)
        return _inside(np.clip((FAR_S - contact_s) / (FAR_S - FULL_S), 0, 1).astype(np.float32))

    def _nearness(self, current: Float32s, time_s: float) -> Float32s:
        known = np.isfinite(current)
        if not known.any():
            return np.zeros(current.shape, np.float32)
        scene = math.log(float(np.quantile(current[known], SCENE_QUANTILE)))
        passed_s, self._scene_s = time_s - self._scene_s, time_s
        if math.isnan(self._scene):
            self._scene = scene
        self._scene += (scene - self._scene) * (1 - math.exp(-passed_s / SCENE_S))
        near, close = math.log(NEAR_RATIO), math.log(CLOSE_RATIO)
        return np.clip((self._scene - np.log(current) - near) / (close - near), 0, 1).astype(np.float32)


def _inside(urgency: Float32s) -> Float32s:
    """Return the urgency of a map without its border."""
    out = np.zeros_like(urgency)
    inside = np.s_[REACH_PX:-REACH_PX, REACH_PX:-REACH_PX]
    out[inside] = urgency[inside]
    return out
