"""Checks a decoded scene of moving bodies against its source: in every frame and at every voxel, the sum of
the decoded forces of all bodies must be within the error bound. The encoder of coder `objects` calls it.

The bound is |F_decoded - F| <= max(F_0, k |F|), where F is the force of the source with its bodies at their
decoded poses. The poses themselves have another bound: coding moves no point of a body by more than a
*tolerance in place* (`displacement_m`). Where a field jumps, as at the edge of a wall, no pose of finite
accuracy could satisfy a bound voxel by voxel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.medium import ForceField, HapticObject, HapticScene, PoseTrack
from touchfield.medium.cells import CellPool
from touchfield.medium.field import brick_keys

# fraction of F_max; the receiver also treats a body's own force below it as the rounding of a position
_FLOOR_FRACTION: Final = 1e-9
_CHUNK_FRAMES: Final = 32
_BLOCK_FRAMES: Final = 2048  # frames whose moves are in memory at once, 152 bytes for each body and frame


@dataclass(frozen=True)
class BoundCheck:
    """Result of checking frames against the error bound."""

    ratios: Float64s  # [bodies]; the largest |error| / mask at the voxels that each body contributes to
    voxels: Int64s  # [bodies, 4]; frame and voxel of the largest ratio; -1 for none
    violations: int  # voxels of all frames whose error exceeds the mask

    @classmethod
    def empty(cls, body_count: int) -> BoundCheck:
        """Result for no frames."""
        return cls(np.zeros(body_count), np.full((body_count, 4), -1), 0)

    @property
    def max_error(self) -> tuple[float, int, tuple[int, int, int]]:
        """The largest ratio, its frame and its voxel; zeros if there is no force."""
        n = int(np.argmax(self.ratios))
        frame, x, y, z = np.maximum(self.voxels[n], 0).tolist()
        return float(self.ratios[n]), frame, (x, y, z)

    def merged(self, other: BoundCheck) -> BoundCheck:
        """Combine with the result of later frames."""
        is_larger = other.ratios > self.ratios
        voxels = np.where(is_larger[:, None], other.voxels, self.voxels)
        return BoundCheck(np.maximum(self.ratios, other.ratios), voxels, self.violations + other.violations)


@dataclass(frozen=True)
class Pair:
    """The source and the decoded field of a body, on one lattice."""

    source: ForceField
    decoded: ForceField

    @cached_property
    def pools(self) -> tuple[CellPool, CellPool]:
        """Both fields as cells, in the same order."""
        return CellPool.of(self.source, self.decoded), CellPool.of(self.decoded, self.source)

    def inexact_corners(self, marks: NDArray[np.uint8]) -> Int64s:
        """Corners of marked cells at which the decoded force differs from the source's.

        `marks`: uint8 [bricks of the pools, 512]. Returns the numbers of samples, int64 [m], ascending; a
        number is 512 times the key of the brick (`field.brick_keys`) plus the index of the sample within it.
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
        sample = (local[:, 0] * 8 + local[:, 1]) * 8 + local[:, 2]
        numbers = np.unique(512 * brick_keys(grid, bricks) + sample)
        keys, local_index = np.unique(numbers >> 9, return_inverse=True), numbers & 511
        source_forces, decoded_forces = (
            field.forces_at(keys[0]).reshape(-1, 512, 3)[keys[1], local_index]
            for field in (self.source, self.decoded)
        )
        inexact: Int64s = numbers[(source_forces != decoded_forces).any(axis=1)]
        return inexact


class BlockMoves(NamedTuple):
    """Decoded poses, and damping times velocity of source and decoded tracks, in some frames.

    `poses`: float64 [frames, bodies, 7]. `source`, `decoded`: b (v, omega), float64 [frames, bodies, 6], with
    b the surface damping, v the velocity and omega the angular velocity.
    """

    poses: Float64s
    source: Float64s
    decoded: Float64s


class Moves:
    """Moves of a scene, made for one block of frames at a time; the latest block is cached.

    ``decode(start, stop)`` returns the decoded track of each body in frames start to stop - 1.
    """

    def __init__(self, scene: HapticScene, decode: Callable[[int, int], Sequence[PoseTrack]]) -> None:
        self._scene, self._decode = scene, decode
        self._latest: tuple[int, BlockMoves] | None = None  # start of a block, and its moves

    @classmethod
    def of(cls, scene: HapticScene, decoded: Sequence[PoseTrack]) -> Moves:
        """Moves of a scene whose bodies have the tracks `decoded`."""
        return cls(scene, lambda start, stop: [track.between(start, stop) for track in decoded])

    def blocks(self, frames: Sequence[int]) -> Iterator[tuple[Int64s, BlockMoves]]:
        """Yield the given ascending frames in blocks, and the moves of each block."""
        indices = np.asarray(frames, np.int64)
        numbers = indices // _BLOCK_FRAMES
        for selected in np.split(indices, np.flatnonzero(np.diff(numbers)) + 1):
            start = int(selected[0]) // _BLOCK_FRAMES * _BLOCK_FRAMES
            if self._latest is None or self._latest[0] != start:
                self._latest = start, self._make_block(start)
            yield selected, BlockMoves(*(column[selected - start] for column in self._latest[1]))

    def _make_block(self, start: int) -> BlockMoves:
        """Moves of the block from `start`; its velocities need a frame more on each side."""
        scene = self._scene
        stop = min(start + _BLOCK_FRAMES, scene.frame_count)
        first = max(start - 1, 0)
        decoded = self._decode(first, min(stop + 1, scene.frame_count))
        inner = slice(start - first, stop - first)
        poses = [np.hstack([track.quaternions[inner], track.positions(inner)]) for track in decoded]
        source = self._motions([body.track for body in scene.objects], slice(start, stop))
        return BlockMoves(np.stack(poses, axis=1), source, self._motions(decoded, inner))

    def _motions(self, tracks: Sequence[PoseTrack], frames: slice) -> Float64s:
        """Damping times velocity of each track, float64 [frames, bodies, 6]."""
        rate_hz, damping = self._scene.rate_hz, self._scene.surface_damping_n_s_per_m
        return np.stack([track.surface_motions(rate_hz, damping, frames) for track in tracks], axis=1)


@dataclass(frozen=True)
class ComposedRule:
    """Error bound of the composed field of a scene; `f0_n` in newtons, 0 or more."""

    scene: HapticScene
    k: float
    f0_n: float

    def check(self, pairs: Sequence[Pair], moves: Moves, frames: Sequence[int]) -> BoundCheck:
        """Check ascending frames of the scene, given the fields and the moves of its bodies."""
        return self._compare(pairs, moves, frames, is_marking=False)[0]

    def violating_samples(self, pairs: Sequence[Pair], moves: Moves, frames: Sequence[int]) -> list[Int64s]:
        """Inexact samples of each body that contribute to a voxel outside the bound.

        Samples are numbered as by `Pair.inexact_corners`. If these are sent exactly, the only error left
        there comes from the motion, which a surface damping turns into a force.
        """
        marks = self._compare(pairs, moves, frames, is_marking=True)[1]
        starts = np.cumsum([0, *(len(pair.pools[0].bricks) for pair in pairs)])
        return [
            pair.inexact_corners(marks[a:b])
            for pair, a, b in zip(pairs, starts[:-1], starts[1:], strict=True)
        ]

    def _compare(
        self, pairs: Sequence[Pair], moves: Moves, frames: Sequence[int], *, is_marking: bool
    ) -> tuple[BoundCheck, NDArray[np.uint8]]:
        """Result of `check`, and marks of the cells that contribute to a violation.

        The marks are uint8 [bricks, 512], with no rows unless `is_marking`.
        """
        grid, limit_n = self.scene.grid, self.scene.force_max_n
        rule = self.k, self.f0_n, limit_n * _FLOOR_FRACTION, limit_n
        source, decoded = (
            CellPool.joined(pools) for pools in zip(*(pair.pools for pair in pairs), strict=True)
        )
        count, is_damped = len(source.bricks), self.scene.surface_damping_n_s_per_m != 0
        # with damping the error includes that of the motion, for which cells have no bound
        bounds = np.full((count, 512), np.inf if is_damped else 0.0, np.float32)
        if not is_damped:
            for_chunks(native.bound_cells, count, source.cells, decoded.cells, rule, bounds, chunk=64)
        marks = np.zeros((count if is_marking else 0, 512), np.uint8)
        bodies = (
            source.lattices, source.boxes, source.starts, source.bricks, source.tables,
            source.supported | decoded.supported, source.cells, decoded.cells,
            bounds, bounds.max(axis=1, initial=0.0), marks,
        )  # fmt: skip
        lattice, total = (grid.origin_m, grid.spacing_m, grid.shape), BoundCheck.empty(len(pairs))
        for block_frames, block_moves in moves.blocks(frames):
            total = total.merged(_compare_block(bodies, block_frames, block_moves, lattice, rule))
        return total, marks


def _compare_block(
    bodies: tuple[Any, ...],
    frames: Int64s,
    moves: BlockMoves,
    lattice: tuple[Any, ...],
    rule: tuple[float, float, float, float],
) -> BoundCheck:
    """Compare the frames of a block on all cores; arguments as of `native.compare_frames`.

    A frame in which no body moves equals the one before, and is counted with it.
    """
    body_count = moves.poses.shape[1]
    stays = np.zeros((len(frames), body_count), np.bool_)
    stays[1:] = np.all([(column[1:] == column[:-1]).all(axis=2) for column in moves], axis=0)
    moved = np.flatnonzero(~stays.all(axis=1))
    columns: Any = *moves, stays
    if len(moved) < len(frames):
        columns = [column[moved] for column in columns]
    columns = *columns, np.diff(np.append(moved, len(frames)))  # how many frames each stands for

    def compare_some(start: int, stop: int) -> BoundCheck:
        result = BoundCheck.empty(body_count)
        found = result.ratios, result.voxels
        violations = native.compare_frames(start, stop, bodies, columns, lattice, rule, *found)
        return replace(result, violations=violations)

    total = BoundCheck.empty(body_count)
    for result in for_chunks(compare_some, len(moved), chunk=_CHUNK_FRAMES):
        total = total.merged(result)
    total.voxels[:, 0] = np.where(total.voxels[:, 0] >= 0, frames[moved[total.voxels[:, 0]]], -1)
    return total


def compare_scenes(
    source: HapticScene, decoded: HapticScene, k: float, f0_n: float
) -> tuple[BoundCheck, float]:
    """Check all frames of a decoded scene; also return the largest displacement.

    The displacement is that of a point of a body, in metres.

    `source` and `decoded` have the same objects on the same lattices. `f0_n`: newtons, 0 or more.
    """
    rule, moves = ComposedRule(source, k, f0_n), Moves.of(source, [body.track for body in decoded.objects])
    bodies = list(zip(source.objects, decoded.objects, strict=True))
    rigid_pairs = [Pair(body.field(0), other.field(0)) if body.is_rigid else None for body, other in bodies]
    displacements_m = [displacement_m(body.track, other.track, reach_m(body)).max() for body, other in bodies]
    total = BoundCheck.empty(len(bodies))
    all_frames = range(source.frame_count)
    for frames in [all_frames] if all(rigid_pairs) else [[i] for i in all_frames]:
        pairs = [
            pair or Pair(body.field(frames[0]), other.field(frames[0]))
            for pair, (body, other) in zip(rigid_pairs, bodies)
        ]
        total = total.merged(rule.check(pairs, moves, frames))
    return total, float(max(displacements_m))


def displacement_m(
    source: PoseTrack, decoded: PoseTrack, reach_m: float, frames: slice = slice(None)
) -> Float64s:
    """Upper bound of the displacement of points within `reach_m` of the origin.

    Metres, float64 [n], one for each pose of `decoded`, which are those of `frames` of the source.
    """
    q, p = source.quaternions[frames], decoded.quaternions
    turn = 2 * np.linalg.norm(p - (p * q).sum(axis=1, keepdims=True) * q, axis=1)
    distance_m: Float64s = (
        np.linalg.norm(decoded.positions_m - source.positions(frames), axis=1) + turn * reach_m
    )
    return distance_m


def reach_m(body: HapticObject) -> float:
    """Largest distance of an object's samples from its origin, plus one cell.

    Metres; 0 for an object that never rotates.
    """
    if (body.track.quaternions == [1.0, 0.0, 0.0, 0.0]).all():
        return 0.0
    farthest_m = 0.0
    for field in body.medium:
        corners = np.abs(field.grid.to_m(field.positions())) + np.asarray(field.grid.spacing_m)
        farthest_m = max(farthest_m, math.sqrt((corners * corners).sum(axis=1).max(initial=0.0)))
    return farthest_m
