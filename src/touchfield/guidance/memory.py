"""The world around the wearer that left the picture: the causal world of live senders
(`touchfield.sources.depth.fused_scene`), in a box that moves along.

A camera sees about 60 of 360 degrees. With the poses of the camera, its pictures are fused into the lattice
of a `FusedVolume` of 7.7 x 2.6 x 7.7 m, which keeps a surface until a later picture looks through it, and
knows where rays have passed. Here all bricks of the box exist, so that free space differs from unknown space.
What was not in the picture for `GuideSpec.memory_s` is unknown again, since somebody may have come; where
something that moves left the picture (`movers`), at once.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s, Int64s
from touchfield.guidance.directions import BIN_DEG, BINS, MIN_BODY_M, azimuths_deg, bins_of
from touchfield.guidance.movers import Movers
from touchfield.guidance.view import DepthView
from touchfield.medium import BRICK, Grid
from touchfield.sources.camera import noise_step_per_m
from touchfield.sources.depth.fused_scene import FIRST_WEIGHT, FusedVolume
from touchfield.sources.depth.kernels.planes import surface_planes
from touchfield.sources.laws import ForceProfile

SPACING_M: Final = 0.08
_BRICKS: Final = (12, 4, 12)
_FLOOR_M: Final = -0.4  # lowest sample: a hole in the ground
_BRICK_M: Final = SPACING_M * BRICK
_WALL: Final = ForceProfile(((-2 * SPACING_M, SPACING_M, 1.0, 0.0),))
"""Samples up to this far from a surface store their distance."""
_IJK: Final = np.indices((BRICK,) * 3).reshape(3, -1).T  # [512, 3]
_BODY_ROWS: Final = slice(9, 24)  # samples from 0.3 to 1.5 m above the ground
_MIN_KNOWN: Final = 0.95
_CHANGE_S: Final = 3.0  # what was seen for so long without a change stands
_FEET_M, _MAX_RAISED_M, _MIN_FLOOR_SAMPLES = 0.4, 0.45, 8


class Memory:
    """Surfaces and free space around the wearer, in axes with y up.

    `view` is the reduced camera, `memory_s` the time after which what is not in the picture is forgotten, and
    `warn_m` the distance up to which a direction must be known to be free, at most 3.5 m.
    """

    def __init__(self, view: DepthView, memory_s: float, warn_m: float) -> None:
        self._ray_m = np.arange(0.3, warn_m + 0.01, SPACING_M)
        self._view, self._memory_s, self._warn_m = view, memory_s, warn_m
        self._step_per_m: float | None = None
        self._bricks = np.stack(np.unravel_index(np.arange(np.prod(_BRICKS)), _BRICKS), 1).astype(np.int32)
        self._shift: Int64s = np.zeros(3, np.int64)
        self._volume: FusedVolume | None = None
        self._seen_s = np.full((_BRICKS[0] * BRICK, _BRICKS[2] * BRICK), -np.inf)
        self._movers = Movers((_BRICKS[0] * BRICK, _BRICKS[2] * BRICK))
        self._changed_s: Float64s = np.full((len(self._bricks), BRICK**3), -np.inf)

    def add(self, reduced_m: Float32s, anchor_from_camera: Float64s, position_m: Float64s) -> None:
        """Add a picture; `position_m` float64 [3] is the wearer's place on the ground, anchor axes."""
        if self._step_per_m is None:
            self._step_per_m = noise_step_per_m(reduced_m)
        volume = self._centred(position_m)
        volume.integrate(
            surface_planes(reduced_m, self._view.intrinsics, self._step_per_m), anchor_from_camera
        )

    def mark_seen(self, wearer_from_anchor: Float64s, seen: Bools, now_s: float) -> None:
        """Note the time of what is in the picture: the directions of 5 degrees `seen`, bool [72]."""
        bins = bins_of(azimuths_deg(self._columns(wearer_from_anchor)))
        self._seen_s.reshape(-1)[seen[bins]] = now_s

    def find_surfaces(self, wearer_from_anchor: Float64s, now_s: float) -> tuple[Float32s, Bools]:
        """Find what moves; return the points of remembered surfaces and which of them have moved.

        They are float32 [n, 3] in the wearer's frame, and bool [n]. What lies below the wearer is floor:
        heights are above that.
        """
        if self._volume is None:
            return np.empty((0, 3), np.float32), np.empty(0, np.bool_)
        samples = self._volume.samples
        is_near = (samples.has_surface > 0) & (np.abs(samples.distance_m) <= 0.6 * SPACING_M)
        rows, inner = np.nonzero(is_near)
        index = self._bricks[rows] * BRICK + _IJK[inner]
        is_recent = now_s - self._seen_s[index[:, 0], index[:, 2]] <= self._memory_s
        rows, inner, index = rows[is_recent], inner[is_recent], index[is_recent]
        normal = samples.normal[rows, :, inner]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-6)
        points = self._volume.grid.to_m(index) - normal * samples.distance_m[rows, inner, None]
        placed = _moved(points, wearer_from_anchor)
        placed[:, 1] -= _standing_m(placed)
        self._note_changes(samples.changes, now_s)
        last_seen_s = self._seen_s[index[:, 0], index[:, 2]]
        has_changed = last_seen_s - self._changed_s[rows, inner] <= _CHANGE_S
        columns = index[:, [0, 2]]
        is_body = placed[:, 1] > MIN_BODY_M
        self._movers.update(columns[is_body], has_changed[is_body], self._seen_s == now_s, now_s)
        return placed, self._movers.has_moved(columns)

    def known_bins(self, wearer_from_anchor: Float64s, now_s: float) -> Bools:
        """Return the directions of 5 degrees that are known up to `warn_m` or to a surface, bool [72]."""
        if self._volume is None:
            return np.zeros(BINS, np.bool_)
        surface, free = (_dense(a) for a in (self._volume.samples.has_surface, self._volume.samples.free))
        is_recent = now_s - self._seen_s <= self._memory_s
        has_surface = (surface[:, _BODY_ROWS] > 0).sum(axis=1) >= 2
        is_known = ((free[:, _BODY_ROWS] > 0).any(axis=1) | has_surface) & is_recent
        angles = np.radians((np.arange(BINS) + 0.5) * BIN_DEG - 180.0)
        rays = np.stack([np.sin(angles), np.zeros(BINS), np.cos(angles)], 1)
        places = np.asarray(rays[:, None] * self._ray_m[:, None], np.float64).reshape(-1, 3)
        anchor = _moved(places, np.asarray(np.linalg.inv(wearer_from_anchor)))
        index = np.rint(self._volume.grid.to_index(anchor)).astype(np.int64)
        index = np.clip(index, 0, np.array(self._volume.grid.shape) - 1)
        known = is_known[index[:, 0], index[:, 2]].reshape(BINS, -1)
        before = np.cumsum(has_surface[index[:, 0], index[:, 2]].reshape(BINS, -1), axis=1) == 0
        counted = np.maximum(before.sum(axis=1), 1)
        is_whole = (known & before).sum(axis=1) >= _MIN_KNOWN * counted
        columns = self._columns(wearer_from_anchor)
        return np.asarray(is_whole & ~self._movers.reached_bins(columns, now_s, self._warn_m))

    def _note_changes(self, changes: NDArray[np.uint8], now_s: float) -> None:
        """Note when samples changed; the volume keeps its `changes` [bricks, 512] until they are cleared."""
        self._changed_s[changes > 0] = now_s
        changes[:] = 0

    def _columns(self, wearer_from_anchor: Float64s) -> Float32s:
        """Return the positions of all columns of the lattice, float32 [n, 3], wearer's frame."""
        if self._volume is None:
            return np.zeros((self._seen_s.size, 3), np.float32)
        x, z = np.meshgrid(self._volume.grid.axis_m(0), self._volume.grid.axis_m(2), indexing="ij")
        columns: Float64s = np.stack([x.reshape(-1), np.zeros(x.size), z.reshape(-1)], 1)
        return _moved(columns, wearer_from_anchor)

    def _centred(self, position_m: Float64s) -> FusedVolume:
        """Return the volume whose box has the wearer in the middle: by whole bricks, with what it shares."""
        wanted = np.rint(position_m / _BRICK_M).astype(np.int64)
        is_inside = np.abs(position_m / _BRICK_M - self._shift).max() <= 0.75
        if self._volume is not None and is_inside:
            return self._volume
        nx, ny, nz = _BRICKS
        low = np.array([-nx / 2 * _BRICK_M, _FLOOR_M, -nz / 2 * _BRICK_M]) + wanted * _BRICK_M
        grid = Grid((nx * BRICK, ny * BRICK, nz * BRICK), (SPACING_M,) * 3, tuple(low.tolist()))
        volume = FusedVolume(grid, _WALL, self._step_per_m or 0.0, FIRST_WEIGHT)
        volume.add(self._bricks)
        if self._volume is not None:
            self._copy(self._volume, volume, wanted - self._shift)
        self._volume, self._shift = volume, wanted
        return volume

    def _copy(self, before: FusedVolume, after: FusedVolume, moved: Int64s) -> None:
        """Copy the bricks and the times that two boxes share; the second is `moved` by bricks."""
        sources = self._bricks + moved
        is_shared = ((sources >= 0) & (sources < _BRICKS)).all(axis=1)
        rows = np.ravel_multi_index(tuple(sources[is_shared].T), _BRICKS)
        for new, old in zip(_arrays(after), _arrays(before), strict=True):
            new[is_shared] = old[rows]
        changed_s = np.full_like(self._changed_s, -np.inf)
        changed_s[is_shared] = self._changed_s[rows]
        self._changed_s = changed_s
        self._seen_s = _shifted(self._seen_s, moved)
        self._movers.last_s = _shifted(self._movers.last_s, moved)


def _arrays(volume: FusedVolume) -> tuple[NDArray[Any], ...]:
    """Return the state of the samples, an array for each quantity [bricks, ...]."""
    arrays: tuple[NDArray[Any], ...] = tuple(volume.samples)
    return arrays


def _shifted(times_s: Float64s, moved: Int64s) -> Float64s:
    """Return the times of the columns of a box that is `moved` by bricks, -inf where it is new."""
    out = np.full_like(times_s, -np.inf)
    x, z = (np.arange(n) + BRICK * int(m) for n, m in zip(out.shape, moved[[0, 2]], strict=True))
    valid_x, valid_z = ((a >= 0) & (a < n) for a, n in zip((x, z), out.shape, strict=True))
    out[np.ix_(valid_x, valid_z)] = times_s[np.ix_(x[valid_x], z[valid_z])]
    return out


def _standing_m(points: Float32s) -> float:
    """Return the height of a raised floor below the wearer above the ground that is seen ahead; 0 if none."""
    below = points[np.hypot(points[:, 0], points[:, 2]) < _FEET_M, 1]
    below = below[(below > 0.05) & (below < _MAX_RAISED_M)]
    return float(np.median(below)) if len(below) >= _MIN_FLOOR_SAMPLES else 0.0


def _dense(samples: NDArray[Any]) -> NDArray[Any]:
    """Return samples [bricks, 512] as a lattice [x, y, z]."""
    nx, ny, nz = _BRICKS
    bricks = samples.reshape(nx, ny, nz, BRICK, BRICK, BRICK)
    return bricks.transpose(0, 3, 1, 4, 2, 5).reshape(nx * BRICK, ny * BRICK, nz * BRICK)


def _moved(points: NDArray[Any], pose: Float64s) -> Float32s:
    """Return points [n, 3] moved by a pose [4, 4], float32."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3], np.float32)
