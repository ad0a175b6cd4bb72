"""The promise of the composed field, checked: bodies where the decoded poses have them, all frames, all
voxels.

|F_decoded - F| <= max(F_0, k |F|), F being the source's force with its bodies where the file has them. Poses are
coded such that this moves no point of a body by more than a *tolerance in place* (`displacement_m`): where a
field jumps, as at the edge of a wall, no pose of finite accuracy keeps a rule voxel by voxel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.compute.threads import for_chunks
from touchfield.medium import ForceField, HapticObject, HapticScene, PoseTrack
from touchfield.medium.cells import CellPool
from touchfield.medium.field import brick_keys

_FLOOR_SHARE: Final = (
    1e-9  # of F_max: a body's own force below it is the rounding of a place, as the receiver has it
)
_FRAMES_AT_ONCE: Final = 32


@dataclass(frozen=True)
class Found:
    """Result of a check."""

    ratios: Float64s  # [bodies]; the largest |error| / mask at the voxels that each body has a part in
    places: Int64s  # [bodies, 4]; frame and voxel of it; -1 for none
    beyond: int  # voxels of all frames whose error is beyond the mask

    @classmethod
    def none(cls, body_count: int) -> Found:
        """Result of no frame."""
        return cls(np.zeros(body_count), np.full((body_count, 4), -1), 0)

    @property
    def worst(self) -> tuple[float, int, tuple[int, int, int]]:
        """The largest ratio, its frame and its voxel; zeros where nothing is felt."""
        n = int(np.argmax(self.ratios))
        frame, x, y, z = np.maximum(self.places[n], 0).tolist()
        return float(self.ratios[n]), frame, (x, y, z)

    def joined(self, other: Found) -> Found:
        """This and what was found in frames behind it."""
        later = other.ratios > self.ratios
        places = np.where(later[:, None], other.places, self.places)
        return Found(np.maximum(self.ratios, other.ratios), places, self.beyond + other.beyond)


@dataclass(frozen=True)
class Pair:
    """The source and the decoded field of a body, on one lattice."""

    source: ForceField
    decoded: ForceField

    @cached_property
    def pools(self) -> tuple[CellPool, CellPool]:
        """Both as cells, in one order."""
        return CellPool.of(self.source, self.decoded), CellPool.of(self.decoded, self.source)

    def inexact_corners(self, marks: NDArray[np.uint8]) -> Int64s:
        """Corners of marked cells at which the decoded force is not the source's.

        `marks` uint8 [bricks of the pools, 512]. Returns numbers of samples, int64 [m], ascending: 512 times
        the key of the brick (`field.brick_keys`), plus the sample within it.
        """
        pool, grid = self.pools[0], self.source.grid
        slots, cells = np.nonzero(marks)
        corner_m = pool.lattices[0, 3:]
        first = np.rint((corner_m - grid.origin_m) / grid.spacing_m).astype(np.int64)
        low = (
            first
            + 8 * pool.bricks[slots].astype(np.int64)
            + np.stack(np.unravel_index(cells, (8, 8, 8)), axis=-1)
        )
        samples = (low[:, None] + np.array(list(np.ndindex(2, 2, 2)))).reshape(-1, 3)
        samples = samples[((samples >= 0) & (samples < grid.shape)).all(axis=1)]
        bricks, local = samples >> 3, samples & 7
        within = (local[:, 0] * 8 + local[:, 1]) * 8 + local[:, 2]
        numbers = np.unique(512 * brick_keys(grid, bricks) + within)
        keys, place = np.unique(numbers >> 9, return_inverse=True), numbers & 511
        ours, theirs = (
            field.forces_at(keys[0]).reshape(-1, 512, 3)[keys[1], place]
            for field in (self.source, self.decoded)
        )
        inexact: Int64s = numbers[(ours != theirs).any(axis=1)]
        return inexact


class Moves(NamedTuple):
    """Decoded poses float64 [frames, bodies, 7], and b (v, omega) of the source and the decoded tracks [...,
    6].
    """

    poses: Float64s
    source: Float64s
    decoded: Float64s

    @classmethod
    def of(cls, scene: HapticScene, decoded: Sequence[PoseTrack]) -> Moves:
        """Of a scene whose bodies have these decoded tracks."""
        b = scene.surface_damping_n_s_per_m

        def motions(tracks: Sequence[PoseTrack]) -> Float64s:
            if not b:
                return np.zeros((scene.frame_count, len(tracks), 6))
            with np.errstate(over="ignore"):  # the kernels cut what is beyond all bounds
                return np.stack([b * np.hstack(track.velocities(scene.rate_hz)) for track in tracks], axis=1)

        poses = np.stack([np.hstack([track.quaternions, track.positions_m]) for track in decoded], axis=1)
        return cls(poses, motions([one.track for one in scene.objects]), motions(decoded))


@dataclass(frozen=True)
class ComposedRule:
    """The rule for the composed field of a scene: `f0_n` in newtons, 0 or more."""

    scene: HapticScene
    k: float
    f0_n: float

    def check(self, pairs: Sequence[Pair], moves: Moves, frames: Sequence[int]) -> Found:
        """Compare frames of the scene, whose bodies have these fields and moves."""
        return self._compare(pairs, moves, frames, is_marking=False)[0]

    def violating_samples(self, pairs: Sequence[Pair], moves: Moves, frames: Sequence[int]) -> list[Int64s]:
        """Samples of each body that are not exact and have a part in a voxel beyond the rule.

        Numbers as of `Pair.inexact_corners`. With these sent exactly no error is left there but that of the
        motion, which a surface damping turns into a force.
        """
        marks = self._compare(pairs, moves, frames, is_marking=True)[1]
        starts = np.cumsum([0, *(len(pair.pools[0].bricks) for pair in pairs)])
        return [
            pair.inexact_corners(marks[a:b])
            for pair, a, b in zip(pairs, starts[:-1], starts[1:], strict=True)
        ]

    def _compare(
        self, pairs: Sequence[Pair], moves: Moves, frames: Sequence[int], *, is_marking: bool
    ) -> tuple[Found, NDArray[np.uint8]]:
        """What `check` finds; and cells that have a part in a violation, uint8 [bricks of all bodies, 512]."""
        from touchfield.codec.objects import kernels

        grid, limit_n = self.scene.grid, self.scene.force_max_n
        rule = kernels.Rule(self.k, self.f0_n, limit_n * _FLOOR_SHARE, limit_n)
        source, decoded = (
            CellPool.joined(pools) for pools in zip(*(pair.pools for pair in pairs), strict=True)
        )
        count, is_damped = len(source.bricks), self.scene.surface_damping_n_s_per_m != 0
        # with a damping the motion is in the error, too, of which no cell has a bound
        bounds = np.full((count, 512), np.inf if is_damped else 0.0, np.float32)
        if not is_damped:
            for_chunks(kernels.bound_cells, count, source.cells, decoded.cells, rule, bounds, chunk=64)
        marks = np.zeros((count if is_marking else 0, 512), np.uint8)
        bodies = kernels.Bodies(
            source.lattices, source.boxes, source.starts, source.bricks, source.tables, source.held | decoded.held,
            source.cells, decoded.cells, bounds, bounds.max(axis=1, initial=0.0), marks,
        )  # fmt: skip
        own = np.asarray(frames)
        here = Moves(*(column[own] for column in moves))
        stays = np.zeros((len(own), len(pairs)), np.bool_)
        stays[1:] = np.all([(column[1:] == column[:-1]).all(axis=2) for column in here], axis=0)
        beside = bodies, here, stays, np.array([grid.origin_m, grid.spacing_m, grid.shape]), rule
        total = Found.none(len(pairs))
        for found in for_chunks(kernels.compare_frames, len(own), *beside, chunk=_FRAMES_AT_ONCE):
            total = total.joined(Found(*found))
        total.places[:, 0] = np.where(total.places[:, 0] >= 0, own[total.places[:, 0]], -1)
        return total, marks


def compare_scenes(source: HapticScene, decoded: HapticScene, k: float, f0_n: float) -> tuple[Found, float]:
    """How a decoded scene keeps the rule in all its frames, and how far a point of a body is from its place,
    metres.

    `source` and `decoded`: of the same objects on the same lattices. `f0_n`: newtons, 0 or more.
    """
    rule, moves = ComposedRule(source, k, f0_n), Moves.of(source, [one.track for one in decoded.objects])
    bodies = list(zip(source.objects, decoded.objects, strict=True))
    still = [Pair(one.field(0), other.field(0)) if one.is_rigid else None for one, other in bodies]
    away_m = [displacement_m(one.track, other.track, reach_m(one)).max() for one, other in bodies]
    total = Found.none(len(bodies))
    every = range(source.frame_count)
    for frames in [every] if all(still) else [[i] for i in every]:
        now = [pair or Pair(a.field(frames[0]), b.field(frames[0])) for pair, (a, b) in zip(still, bodies)]
        total = total.joined(rule.check(now, moves, frames))
    return total, float(max(away_m))


def displacement_m(source: PoseTrack, decoded: PoseTrack, reach_m: float) -> Float64s:
    """How far a point within `reach_m` of the body's origin may lie from its place, metres, float64 [n]."""
    q, p = source.quaternions, decoded.quaternions
    turn = 2 * np.linalg.norm(p - (p * q).sum(axis=1, keepdims=True) * q, axis=1)
    far: Float64s = np.linalg.norm(decoded.positions_m - source.positions_m, axis=1) + turn * reach_m
    return far


def reach_m(one: HapticObject) -> float:
    """How far the fields of an object reach from its origin, with one cell, metres; 0 for one that never
    turns.
    """
    if (one.track.quaternions == [1.0, 0.0, 0.0, 0.0]).all():
        return 0.0
    far_m = 0.0
    for field in one.medium:
        corners = np.abs(field.grid.to_m(field.positions())) + np.asarray(field.grid.spacing_m)
        far_m = max(far_m, math.sqrt((corners * corners).sum(axis=1).max(initial=0.0)))
    return far_m
