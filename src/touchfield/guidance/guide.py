"""The situation around a wearer, frame after frame: `Guide` applies the chain of the package to pictures.

A direction is *near* if a surface is nearer than `GuideSpec.warn_m` in two of the last three frames, *free*
if at least half of it is seen or remembered, has no such surface, and none may have come into it from beside
the picture (`lost`, `movers`); else it is *unknown*: unknown is never free. A picture of which less than a
quarter is known is *blind*: a depth camera returns nothing for what is nearer than its shortest range, so a
blind picture may be a wall.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s
from touchfield.errors import InvalidArgument
from touchfield.guidance.contact import ContactTimer, times_to_contact
from touchfield.guidance.directions import (
    MIN_BODY_M,
    MIN_SAMPLES,
    RANGE_M,
    azimuths_deg,
    bins_of,
    in_the_way,
    min_points_of,
    nearest_beside_m,
    nearest_m,
    seen_bins,
    seen_fraction,
)
from touchfield.guidance.ground import Ground, GroundFinder
from touchfield.guidance.lost import LostSurfaces
from touchfield.guidance.spec import GuideSpec
from touchfield.guidance.steps import HALF_WIDTH_M, GroundAhead, ground_ahead
from touchfield.guidance.view import DepthView, known_points
from touchfield.sources.camera import Intrinsics

if TYPE_CHECKING:
    from touchfield.guidance.memory import Memory

MIN_KNOWN: Final = 0.25
MIN_SEEN: Final = 0.5
HOLD_S: Final = 1.0
"""How long a step is shown after it left the picture, without poses."""
_MAX_JUMP_M: Final = 0.5
"""Larger changes of the position between frames are errors of the poses, and the memory starts anew."""
_MARGIN_M: Final = 0.1  # for the noise of distances, and the frame that confirms a surface
_HYSTERESIS_M: Final = 0.1
_UP_FRAMES: Final = 300
"""Frames whose mean says what is level, with poses: with 30, two seconds before a kerb tilted it."""
_SAME_UP_COSINE: Final = math.cos(math.radians(4.0))


class State(IntEnum):
    """What is known of a direction."""

    UNKNOWN = 0
    FREE = 1
    NEAR = 2


@dataclass(frozen=True)
class Situation:
    """What a frame shows: eight directions as in `directions`, and the ground ahead.

    Attributes
    ----------
    time_s : float
        Time of the frame.
    states : tuple of State
        Of the eight directions.
    distances_m : float64 [8]
        Distance of the nearest surface; inf if none is within 5 m or the direction is unknown.
    contact_s : float64 [8]
        Time to contact; inf if the surface does not come nearer.
    ground : Ground
        Plane of the ground; its `is_seen` is False if it is only assumed (`GroundFinder`).
    ahead : GroundAhead
        Distance of the next step up and of the next drop.
    is_blind : bool
        Less than a quarter of the picture is known.
    known_fraction : float
        Fraction of the pixels with a depth.
    """

    time_s: float
    states: tuple[State, ...]
    distances_m: Float64s
    contact_s: Float64s
    ground: Ground
    ahead: GroundAhead
    is_blind: bool
    known_fraction: float


class Guide:
    """Computes the situation of each picture of a camera of `width` x `height` pixels.

    Memory and time of a frame are bounded, whatever the pictures hold. Raises `InvalidArgument` for pictures
    that are too small.
    """

    def __init__(
        self, intrinsics: Intrinsics, width: int, height: int, spec: GuideSpec | None = None
    ) -> None:
        self.spec = spec or GuideSpec()
        self.view = DepthView(intrinsics, width, height)
        self.shape = (height, width)
        self._finder = GroundFinder(self.spec)
        self._min_points = min_points_of(self.view.intrinsics.fx)
        self._near: deque[Bools] = deque(maxlen=3)
        self._ahead: deque[GroundAhead] = deque(maxlen=3)
        self._held = _HeldSteps()
        self._lost = LostSurfaces()
        self._timers = [ContactTimer() for _ in range(8)]
        self._track = _Track(self.view, self.spec)

    @property
    def pose_jumps(self) -> int:
        """How often the position jumped, and the memory started anew."""
        return self._track.jumps

    def update(self, depth_m: Float32s, time_s: float, pose: Float64s | None = None) -> Situation:
        """Return the situation of a picture.

        Parameters
        ----------
        depth_m : float32 [height, width]
            Depth along the optical axis, metres; 0 is unknown.
        time_s : float
            Time of the picture; must not go back.
        pose : float64 [4, 4], optional
            World from camera, metres. Without it, nothing is remembered that is not in the picture.
        """
        if depth_m.shape != self.shape:
            raise InvalidArgument("depth picture", f"shape {depth_m.shape}", f"{self.shape}")
        reduced = self.view.reduced_m(depth_m)
        points, is_known = known_points(self.view, reduced)
        known_fraction = float(is_known.mean())
        jumps = self.pose_jumps
        level = self._track.level(pose)
        if self.pose_jumps > jumps:
            self._forget()
        if known_fraction < MIN_KNOWN:
            return self._blind(time_s, known_fraction)
        grid = (self.view.rays * reduced.reshape(-1, 1)).reshape(*self.view.size_px, 3)
        ground = self._finder.find(grid, time_s, level)
        placed = ground.to_wearer(points)
        ways = placed[in_the_way(placed, self.spec.head_m)]
        distances, beside = nearest_m(ways, self._min_points), np.full(8, np.inf)
        bins = self._seen(ground, is_known)
        is_lost = self._lost.update(distances, time_s, self.spec.warn_m + _MARGIN_M)
        if pose is not None and self._track.add(reduced, pose, ground, bins, time_s):
            surfaces, known = self._track.remembered(time_s)
            distances = np.minimum(distances, nearest_m(surfaces, MIN_SAMPLES))
            beside, is_lost = nearest_beside_m(surfaces, MIN_SAMPLES, bins), np.zeros(8, np.bool_)
            bins = bins | known
        ahead = ground_ahead(
            ground, self.view.rays[is_known], reduced.reshape(-1)[is_known], placed, self.spec.step_m
        )
        ahead = self._held.update(self._confirmed_steps(ahead), time_s, self._track.wearer_from_anchor)
        may_be_free = (seen_fraction(bins) >= MIN_SEEN) & ~is_lost & (beside > self.spec.warn_m)
        states = self._states(distances, may_be_free)
        contact = times_to_contact(self._timers, time_s, distances)
        return Situation(time_s, states, distances, contact, ground, ahead, False, known_fraction)

    def _seen(self, ground: Ground, is_known: Bools) -> Bools:
        """Return the directions of 5 degrees that the picture sees, bool [72]."""
        rays = self.view.rays @ ground.wearer_from_camera.T.astype(np.float32)
        across = np.maximum(np.hypot(rays[:, 0], rays[:, 2]), 1e-6)
        height_m = ground.height_m + self.spec.warn_m * rays[:, 1] / across  # of the ray at that distance
        is_useful = (height_m > -1.0) & (height_m < self.spec.head_m)
        return seen_bins(azimuths_deg(rays), is_known, is_useful)

    def _states(self, distances_m: Float64s, may_be_free: Bools) -> tuple[State, ...]:
        was_near = self._near[-1] if self._near else np.zeros(8, np.bool_)
        limit_m = self.spec.warn_m + _MARGIN_M + np.where(was_near, _HYSTERESIS_M, 0.0)
        self._near.append(distances_m < limit_m)
        is_near = np.sum(self._near, axis=0) >= min(2, len(self._near))
        known = np.where(may_be_free, State.FREE, State.UNKNOWN)
        known[np.sum(self._near, axis=0) == 1] = State.UNKNOWN  # seen once, and neither confirmed nor free
        return tuple(State(int(s)) for s in np.where(is_near, State.NEAR, known))

    def _confirmed_steps(self, ahead: GroundAhead) -> GroundAhead:
        """Return the steps that two of the last three frames show."""
        self._ahead.append(ahead)
        middle = [sorted(values)[min(1, len(values) - 1)] for values in zip(*self._ahead, strict=True)]
        return GroundAhead(*middle)

    def _forget(self) -> None:
        """Forget the last frames, which were seen from elsewhere."""
        self._near.clear()
        self._ahead.clear()
        self._held = _HeldSteps()
        self._lost = LostSurfaces()

    def _blind(self, time_s: float, known_fraction: float) -> Situation:
        """Return the situation of a picture in which hardly anything is known."""
        nothing = np.full(8, np.inf)
        self._near.clear()
        self._ahead.clear()
        ground = Ground(np.array([0.0, -1.0, 0.0]), self.spec.camera_height_m or 1.3, math.inf, False)
        states = (State.UNKNOWN,) * 8
        return Situation(time_s, states, nothing, nothing, ground, GroundAhead(), True, known_fraction)


@dataclass
class _HeldSteps:
    """Steps that left the picture below: with poses until they are passed, else for `HOLD_S`."""

    _times_s: list[float] = field(default_factory=lambda: [-math.inf, -math.inf])
    _distances_m: list[float] = field(default_factory=lambda: [math.inf, math.inf])
    _places: list[Float64s | None] = field(default_factory=lambda: [None, None])

    def update(self, ahead: GroundAhead, now_s: float, wearer_from_anchor: Float64s | None) -> GroundAhead:
        """Return the steps of this frame, and those held where it has none."""
        return GroundAhead(*(self._one(i, d, now_s, wearer_from_anchor) for i, d in enumerate(ahead)))

    def _one(self, i: int, distance_m: float, now_s: float, wearer_from_anchor: Float64s | None) -> float:
        if math.isfinite(distance_m):
            self._times_s[i], self._distances_m[i], self._places[i] = now_s, distance_m, None
            if wearer_from_anchor is not None:
                place = np.array([0.0, 0.0, distance_m, 1.0])
                self._places[i] = np.linalg.inv(wearer_from_anchor) @ place
            return distance_m
        place_m = self._places[i]
        if place_m is not None and wearer_from_anchor is not None:
            x, _, z, _ = wearer_from_anchor @ place_m
            is_ahead = abs(x) < HALF_WIDTH_M and 0.0 < z < 1.6  # farther ones would be in the picture
            return float(z) if is_ahead else math.inf
        return self._distances_m[i] if now_s - self._times_s[i] < HOLD_S else math.inf


class _Track:
    """The way of the camera: its turns between frames, and the memory of what it saw."""

    def __init__(self, view: DepthView, spec: GuideSpec) -> None:
        self.jumps = 0
        self.wearer_from_anchor: Float64s | None = None
        self._view, self._spec = view, spec
        self._pose: Float64s | None = None
        self._up: Float64s = np.zeros(3)  # mean of the last grounds, world axes
        self._grounds = 0
        self._anchor_from_world: Float64s | None = None
        self._memory: Memory | None = None  # made with the first pose, since it needs compiled kernels

    def level(self, pose: Float64s | None) -> Float64s | None:
        """Return the mean of the last `Ground.up`, camera axes of this pose; None if it is unknown."""
        last, self._pose = self._pose, pose
        if pose is None:
            self.wearer_from_anchor = None
        if pose is None or last is None:
            return None
        if np.linalg.norm(pose[:3, 3] - last[:3, 3]) > _MAX_JUMP_M:
            self.jumps += 1
            self._anchor_from_world = self.wearer_from_anchor = None
            self._memory = None
            self._grounds = 0
        return np.asarray(pose[:3, :3].T @ self._up) if self._grounds else None

    def add(self, reduced_m: Float32s, pose: Float64s, ground: Ground, bins: Bools, now_s: float) -> bool:
        """Add a picture to the memory; returns False while there is no ground to which it refers."""
        if not ground.is_seen:
            return False
        self._add_up(pose, ground)
        if self._spec.memory_s == 0:
            return False
        if self._memory is None:
            from touchfield.guidance.memory import Memory

            self._memory = Memory(self._view, self._spec.memory_s, self._spec.warn_m)
        wearer_from_camera: Float64s = np.eye(4)
        wearer_from_camera[:3, :3] = replace(ground, up=pose[:3, :3].T @ self._up).wearer_from_camera
        wearer_from_camera[1, 3] = ground.height_m
        if self._anchor_from_world is None:
            self._anchor_from_world = wearer_from_camera @ np.linalg.inv(pose)
        anchor_from_camera = self._anchor_from_world @ pose
        self.wearer_from_anchor = wearer_from_camera @ np.linalg.inv(anchor_from_camera)
        position_m = np.asarray(np.linalg.inv(self.wearer_from_anchor)[:3, 3], np.float64)
        self._memory.add(reduced_m, anchor_from_camera, position_m)
        self._memory.mark_seen(self.wearer_from_anchor, bins, now_s)
        return True

    def _add_up(self, pose: Float64s, ground: Ground) -> None:
        """Add a ground to the mean: one frame alone is tilted by a kerb, and what is remembered with it."""
        if ground.age_s > 0 and self._grounds:
            return
        up = pose[:3, :3] @ ground.up
        is_other = self._up @ up < _SAME_UP_COSINE  # found anew after it was lost
        self._grounds = 1 if is_other else self._grounds + 1
        self._up = self._up + (up - self._up) / min(self._grounds, _UP_FRAMES)
        self._up /= np.linalg.norm(self._up)

    def remembered(self, now_s: float) -> tuple[Float32s, Bools]:
        """Return the points of remembered surfaces, [n, 3], and the known directions of 5 degrees."""
        assert self._memory is not None and self.wearer_from_anchor is not None
        points, has_moved = self._memory.find_surfaces(self.wearer_from_anchor, now_s)
        is_near = (points[:, 1] > MIN_BODY_M) & (points[:, 1] < self._spec.head_m)
        is_near &= np.hypot(points[:, 0], points[:, 2]) < min(RANGE_M, self._spec.warn_m + 0.3)
        known = self._memory.known_bins(self.wearer_from_anchor, now_s)
        # what moves is not where it was: there, nothing is known
        known[np.unique(bins_of(azimuths_deg(points[is_near & has_moved])))] = False
        return points[is_near & ~has_moved], known
