"""Finds the plane of the ground in the points of a depth picture, and with it the wearer's frame.

Points whose surface is nearly level are selected, and planes through three random ones are scored (RANSAC;
Fischler and Bolles 1981). At the start, a plane scores by the points near it, less those below; the best is
refined by least squares. It is the ground if it is nearly level and at a height at which a wearer carries the
camera (`GuideSpec`).

From then on the tilt and the height are found one after the other. The tilt is that of two parallel planes
(`parallel`), near that of the last frame or of the poses. The height is that of the plane near the mean
height of the camera, which is as far above a step as above the floor before. While no plane is there, as when
a wearer steps up, the mean is used. After `MAX_LOST_S` without a tilt, or `MAX_UNSEEN_S` without a height,
the search starts anew.

The wearer's frame has x to the right, y up and z forward, where the camera looks (left-handed axes); its
origin is the point of the ground below the camera.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.guidance.parallel import parallel_normal, parallel_scores, plane_height_m, tolerance_m
from touchfield.guidance.spec import GuideSpec

MAX_LOST_S: Final = 1.0
"""How long the last ground is used without any level surface; its tilt is unknown later."""
MAX_UNSEEN_S: Final = 2.5
"""How long the mean height is used without a plane there: longer than what is on a step takes to pass."""

_HEIGHTS_M: Final = (0.4, 2.3)  # of a camera that a person wears
_FREE_TILT_DEG, _NEXT_TILT_DEG = 30.0, 8.0  # from what is expected at the start, and from frame to frame
_POSED_TILT_DEG: Final = 1.5  # from the mean of the last frames; poses err by some tenths of a degree
_HEIGHT_STEP_M: Final = 0.07  # between frames: a wearer bobs by 2 to 3 cm, and a step is 10 to 20 cm high
_STATED_HEIGHT_M: Final = 0.15
_PLANES, _SCORED_POINTS = 96, 1200
_MIN_POINTS, _MIN_FRACTION, _MIN_SPREAD_M = 40, 0.03, 0.12
_MAX_GROUND_M: Final = 4.5  # farther away the noise of a depth camera is larger than a step
_BELOW_WEIGHT: Final = 0.6
_BASELINE_PX: Final = 3  # on both sides of a pixel, for its normal
_LEVEL_COSINE: Final = math.cos(math.radians(35.0))
_MAX_OTHER_M: Final = 0.7  # between the ground and other level surfaces
_FOLLOW: Final = 0.03  # weight of a new height in the mean: within a step of 0.3 s the mean stays


@dataclass(frozen=True)
class Ground:
    """A plane of the ground: unit vector `up` in camera axes, float64 [3], and the camera's height above it.

    `age_s` is the time since it was seen; `is_seen` is False for one that is only assumed from the options.
    """

    up: Float64s
    height_m: float
    age_s: float = 0.0
    is_seen: bool = True

    @property
    def wearer_from_camera(self) -> Float64s:
        """The axes of the wearer in those of the camera, float64 [3, 3], a row each: right, up, forward."""
        forward = np.array([0.0, 0.0, 1.0]) - self.up[2] * self.up
        if np.linalg.norm(forward) < 0.2:  # straight down: forward is where the top of the picture is
            forward = -np.array([0.0, 1.0, 0.0]) + self.up[1] * self.up
        forward /= np.linalg.norm(forward)
        return np.stack([np.cross(forward, self.up), self.up, forward])

    def to_wearer(self, points: Float32s) -> Float32s:
        """Convert points [n, 3] in camera axes to the wearer's frame, metres, float32 [n, 3]."""
        moved = points @ self.wearer_from_camera.T.astype(np.float32)
        moved[:, 1] += np.float32(self.height_m)
        return moved


class GroundFinder:
    """Finds the ground frame after frame."""

    def __init__(self, spec: GuideSpec) -> None:
        pitch = math.radians(spec.pitch_deg)
        self._level = np.array([0.0, -math.cos(pitch), -math.sin(pitch)])
        self._stated_m = spec.camera_height_m
        self._ground: Ground | None = None
        self._level_s = self._seen_s = -math.inf  # last tilt, last height
        self._mean_m = 0.0
        self._random = np.random.default_rng(0)

    def find(self, points: Float32s, now_s: float, level: Float64s | None = None) -> Ground:
        """Return the ground of a frame at the time `now_s`.

        `points` float32 [height, width, 3] are in camera axes, 0 if unknown. `level` float64 [3] is the mean
        of the last `up`, turned to this frame, if its pose is known. The ground that was seen last is
        returned while there is none, then an assumed one.
        """
        last = self._ground
        if last is not None and level is not None:
            last = replace(last, up=level)
        is_lost = now_s - self._level_s > MAX_LOST_S or now_s - self._seen_s > MAX_UNSEEN_S
        if last is None or is_lost:
            self._ground = self._search(points, self._level, _FREE_TILT_DEG, self._free_heights())
            if self._ground is None:
                return Ground(self._level, self._stated_m or 1.3, math.inf, is_seen=False)
            self._level_s, self._mean_m = now_s, self._ground.height_m
        else:
            tilt_deg = _NEXT_TILT_DEG if level is None else _POSED_TILT_DEG
            self._ground = self._follow(points, last.up, tilt_deg, now_s)
        if self._ground.age_s == 0:
            self._seen_s = now_s
            self._mean_m += _FOLLOW * (self._ground.height_m - self._mean_m)
        return self._ground

    def _free_heights(self) -> tuple[float, float]:
        if self._stated_m is None:
            return _HEIGHTS_M
        return self._stated_m - _STATED_HEIGHT_M, self._stated_m + _STATED_HEIGHT_M

    def _search(
        self, points: Float32s, expected_up: Float64s, tilt_deg: float, heights_m: tuple[float, float]
    ) -> Ground | None:
        """Return the best plane near `expected_up` whose height is within `heights_m`, or None."""
        low = _level_points(points, expected_up, 0.5 * heights_m[0])
        if len(low) < _MIN_POINTS:
            return None
        some = low[self._random.integers(0, len(low), min(len(low), _SCORED_POINTS))]
        ups, heights = self._planes(low, expected_up, tilt_deg, heights_m)
        if not len(ups):
            return None
        above_m = some @ ups.T + heights
        margin_m = tolerance_m(some)[:, None]
        weight = 1 / some[:, 2:]  # the wearer stands on the nearest of two grounds
        scores = ((np.abs(above_m) < margin_m) * weight).sum(axis=0)
        scores -= _BELOW_WEIGHT * ((above_m < -2 * margin_m) * weight).sum(axis=0)
        best = int(np.argmax(scores))
        ground = _refined(low, Ground(ups[best], float(heights[best])))
        is_level = ground is not None and ground.up @ expected_up >= math.cos(math.radians(tilt_deg))
        if ground is None or not is_level or not heights_m[0] <= ground.height_m <= heights_m[1]:
            return None
        inliers = np.abs(low @ ground.up + ground.height_m) < tolerance_m(low)
        min_inliers = max(_MIN_POINTS, _MIN_FRACTION * points[..., 0].size)
        return ground if np.count_nonzero(inliers) >= min_inliers else None

    def _follow(self, points: Float32s, expected_up: Float64s, tilt_deg: float, now_s: float) -> Ground:
        """Return the ground whose tilt is near `expected_up`; its height is the mean if it is not seen."""
        age_s = now_s - self._seen_s
        low = _level_points(points, expected_up, 0.5 * self._mean_m)
        up = self._common_up(low, expected_up, tilt_deg)
        if up is None:
            return Ground(expected_up, self._mean_m, age_s)
        self._level_s = now_s
        min_points = max(_MIN_POINTS, _MIN_FRACTION * points[..., 0].size)
        height_m = plane_height_m(low, up, self._mean_m, _HEIGHT_STEP_M, min_points)
        return Ground(up, self._mean_m, age_s) if height_m is None else Ground(up, height_m)

    def _common_up(self, low: Float64s, expected_up: Float64s, tilt_deg: float) -> Float64s | None:
        """Return the normal of the level points [n, 3] near `expected_up`, or None."""
        if len(low) < _MIN_POINTS:
            return None
        some = low[self._random.integers(0, len(low), min(len(low), _SCORED_POINTS))]
        heights_m = (self._mean_m - _MAX_OTHER_M, self._mean_m + _MAX_OTHER_M)
        ups, heights = self._planes(low, expected_up, tilt_deg, heights_m)
        if not len(ups):
            return None
        up = parallel_normal(low, ups[np.argmax(parallel_scores(some, ups, heights))])
        is_near = up is not None and up @ expected_up >= math.cos(math.radians(tilt_deg))
        return up if is_near else None

    def _planes(
        self, low: Float64s, expected_up: Float64s, tilt_deg: float, heights_m: tuple[float, float]
    ) -> tuple[Float64s, Float64s]:
        """Return the planes through three random points that are level and high enough."""
        a, b, c = low[self._random.integers(0, len(low), (3, _PLANES))]
        ups = np.cross(b - a, c - a)
        lengths = np.linalg.norm(ups, axis=1)
        ups = ups[lengths > 1e-6] / lengths[lengths > 1e-6, None]
        ups *= np.where(ups @ expected_up < 0, -1.0, 1.0)[:, None]
        heights = -np.einsum("ij,ij->i", ups, a[lengths > 1e-6])
        is_level = ups @ expected_up >= math.cos(math.radians(tilt_deg))
        fits = is_level & (heights >= heights_m[0]) & (heights <= heights_m[1])
        return ups[fits], heights[fits]


def _level_points(points: Float32s, up: Float64s, min_below_m: float) -> Float64s:
    """Return the points at least `min_below_m` below the camera whose surface is nearly level, [n, 3]."""
    known = points[..., 2] > 0
    s = _BASELINE_PX
    along, down = (
        points[s:-s, 2 * s :] - points[s:-s, : -2 * s],
        points[2 * s :, s:-s] - points[: -2 * s, s:-s],
    )
    is_whole = known[s:-s, 2 * s :] & known[s:-s, : -2 * s] & known[2 * s :, s:-s] & known[: -2 * s, s:-s]
    middle = points[s:-s, s:-s]
    is_low = is_whole & known[s:-s, s:-s] & (middle[..., 2] < _MAX_GROUND_M)
    is_low &= middle @ up.astype(np.float32) < -min_below_m
    normals = np.cross(down[is_low], along[is_low]).astype(np.float64)
    cosines = normals @ up / np.maximum(np.linalg.norm(normals, axis=1), 1e-9)
    return np.asarray(middle[is_low][np.abs(cosines) > _LEVEL_COSINE], np.float64)


def _refined(points: Float64s, ground: Ground) -> Ground | None:
    """Fit the plane to its inliers by least squares, twice; None if these do not determine it."""
    for _ in range(2):
        inliers = points[np.abs(points @ ground.up + ground.height_m) < tolerance_m(points)]
        if len(inliers) < _MIN_POINTS:
            return None
        centre = inliers.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((inliers - centre).T))
        if values[1] < _MIN_SPREAD_M**2:  # points on a line, such as a skirting board
            return None
        up = vectors[:, 0] * np.sign(vectors[:, 0] @ ground.up)
        ground = Ground(up, float(-(up @ centre)))
    return ground
