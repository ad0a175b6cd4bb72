"""Stores the fields of moving bodies in the layout that the compiled force queries read.

Each brick of 8^3 samples is stored as a block of 9^3 samples: its own and the first samples of the next
bricks along each axis. The eight samples around any point are then in one block. Blocks are found through a
hash table. The code calls these blocks *cells*.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float32s, Float64s, Int32s, Int64s
from touchfield.compute.threads import for_chunks
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium.budget import memory_budget_bytes, require_memory, zero_forces
from touchfield.medium.field import ForceField, bricks_of, slots_of
from touchfield.medium.grid import BRICK, CORNERS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from touchfield.medium.grid import Grid
    from touchfield.medium.medium import HapticScene

_FLOOR_FRACTION: Final = 1e-9
"""Forces of one object below this fraction of F_max are rounding errors at the edge of its support."""

_MEETINGS_FREE: Final = 4096
_MEETINGS_PER_BYTE: Final = 32
"""Limit on the pairs of brick and object in a frame: `_MEETINGS_FREE` + 32 n for a file of n bytes."""

_JOINED: Final = ("lattices", "bricks", "cells", "supported")
_ANY: Final = 1 << 50
_COLUMNS: Final = 33
_POINTS_AT_ONCE: Final = 2048
_BRICKS_AT_ONCE: Final = 8
_BYTES_PER_CELLS: Final = (BRICK + 1) ** 3 * 3 * 4


@dataclass(frozen=True)
class CellPool:
    """The concatenated fields of some objects, in the layout of `kernels.placed`."""

    # float64 [objects, 6]; spacing, and corner of the object's box of bricks in its body frame, metres
    lattices: Float64s
    boxes: Int64s  # int64 [objects, 5]
    starts: Int64s  # int64 [objects + 1]
    bricks: Int32s  # int32 [n, 3]; brick coordinates of the cells, counted from the corner of the box
    cells: Float32s  # float32 [n * 9 * 9 * 9 * 3]
    supported: NDArray[np.uint64]  # uint64 [n, 8]
    tables: Int64s  # int64 [m, 2]

    @classmethod
    def of(cls, field: ForceField, paired: ForceField | None = None) -> CellPool:
        """Return the pool of one field.

        If `paired` is given, the pool also has cells for the bricks of that field, so that the pools of both
        fields have their cells in the same order.
        """
        from touchfield.medium.kernels import placed as kernels

        spacing = np.asarray(field.grid.spacing_m)
        parts = [part for part in (field, paired) if part is not None and len(part.bricks)]
        if not parts:
            lattice = np.concatenate([spacing, field.grid.origin_m])[None]
            none = np.zeros((0, 3), np.int32), np.zeros(0, np.float32), np.zeros((0, 8), np.uint64)
            return cls(
                lattice, np.zeros((1, 5), np.int64), np.zeros(2, np.int64), *none, np.zeros((0, 2), np.int64)
            )
        candidates = [part.bricks for part in parts]
        for part in parts:  # the first samples of a brick are also stored in the cells of the previous brick
            for corner in CORNERS[1:]:
                first_samples = tuple(0 if c else slice(None) for c in corner)
                has_mask = part.mask[(slice(None), *first_samples)].reshape(len(part.bricks), -1).any(axis=1)
                candidates.append(part.bricks[has_mask] - corner)
        all_bricks = np.concatenate(candidates).astype(np.int64)
        low = all_bricks.min(axis=0)
        box = all_bricks.max(axis=0) - low + 1
        keys = np.unique(_keys(all_bricks - low, box))
        bricks = np.stack(np.unravel_index(keys, tuple(box)), axis=1)
        field_keys = _keys(field.bricks - low, box)
        sources = np.empty((len(bricks), 8), np.int64)
        for c, corner in enumerate(CORNERS):
            neighbours = bricks + corner
            sources[:, c] = np.where(
                (neighbours < box).all(axis=1), slots_of(field_keys, _keys(neighbours, box)), -1
            )
        require_memory("haptic objects", f"{len(bricks)} bricks", len(bricks) * _BYTES_PER_CELLS)
        cells = np.zeros((len(bricks), *[BRICK + 1] * 3, 3), np.float32)
        supported = np.zeros((len(bricks), BRICK), np.uint64)
        for_chunks(kernels.cells_of, len(bricks), sources, field.forces_n, cells, supported, chunk=64)
        shift = 64 - max(2, (4 * len(keys) - 1).bit_length())
        table = np.full((1 << (64 - shift), 2), -1, np.int64)
        kernels.hash_table(keys, shift, table)
        corner_m = field.grid.to_m(low * BRICK)
        return cls(
            np.concatenate([spacing, corner_m])[None],
            np.array([[*box, 0, shift]]),
            np.array([0, len(bricks)]),
            bricks.astype(np.int32),
            cells.reshape(-1),
            supported,
            table,
        )

    @classmethod
    def joined(cls, pools: Sequence[CellPool]) -> CellPool:
        """Concatenate pools in their order."""
        if len(pools) == 1:
            return pools[0]
        starts = np.cumsum([0, *(len(p.bricks) for p in pools)])
        require_memory("haptic objects", f"{starts[-1]} bricks", int(starts[-1]) * _BYTES_PER_CELLS)
        tables = np.concatenate([p.tables for p in pools])
        boxes = np.concatenate([p.boxes for p in pools])
        boxes[:, 3] = np.cumsum([0, *(len(p.tables) for p in pools[:-1])])
        for start, first_brick, pool in zip(boxes[:, 3], starts, pools):
            slots = tables[start : start + len(pool.tables), 1]
            slots[slots >= 0] += first_brick
        arrays = {name: np.concatenate([getattr(p, name) for p in pools]) for name in _JOINED}
        return cls(boxes=boxes, starts=starts, tables=tables, **arrays)


class PlacedFields:
    """The fields of a haptic scene at their poses."""

    def __init__(self, scene: HapticScene) -> None:
        self._scene, self._limit_n = scene, float(scene.force_max_n)
        self._rigid: dict[int, CellPool] = {}
        self._pool: CellPool | None = None
        self._latest: tuple[int, CellPool, Float64s] | None = None

    def sample_n(self, frame: int, positions_m: ArrayLike) -> Float32s:
        """See `HapticScene.sample_n`."""
        from touchfield.medium.kernels import placed as kernels

        points = np.ascontiguousarray(positions_m, np.float64)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise InvalidArgument("positions_m", f"shape {points.shape}", "points [..., 3] in metres")
        pool, placed = self._at(frame)
        out = np.empty(points.shape, np.float32)
        flat, forces, floor = points.reshape(-1, 3), out.reshape(-1, 3), self._limit_n * _FLOOR_FRACTION
        if not flat.flags.writeable:
            flat = flat.copy()  # numba treats read-only arrays as another type
        tables = (pool.boxes, placed, pool.tables, pool.cells, pool.supported, floor, self._limit_n)
        for_chunks(kernels.at_points, len(flat), flat, *tables, forces, chunk=_POINTS_AT_ONCE)
        return out

    def voxels(self, frame: int, grid: Grid, file_bytes: int | None = None) -> ForceField:
        """Return one frame on a lattice; see `HapticScene.voxelise`.

        Each sample equals `sample_n` at its position.

        """
        from touchfield.medium.kernels import placed as kernels

        pool, placed = self._at(frame)
        lattice, shape = np.array([*grid.origin_m, *grid.spacing_m]), np.array(grid.shape)
        brick_count, allowed = math.prod(grid.brick_shape), memory_budget_bytes() // 4
        if brick_count > allowed:
            raise InvalidArgument(
                "grid shape", f"{grid.shape}, {brick_count} bricks", f"at most {allowed} bricks"
            )
        stamps = np.zeros(brick_count, np.int32)
        max_pairs = _MEETINGS_FREE + _MEETINGS_PER_BYTE * file_bytes if file_bytes is not None else _ANY
        tables = pool.boxes, placed, pool.starts, pool.bricks, stamps, max_pairs
        count, pairs = kernels.meetings(lattice, shape, *tables)
        if count < 0:
            found = f"objects that reach more than {max_pairs} bricks of the {grid.shape} samples"
            raise CorruptFile(
                f"objects, frame {frame}", found, f"at most that in a file of {file_bytes} bytes"
            )
        reached = np.unique(pairs[:count, 0])
        stamps[reached] = np.arange(len(reached))
        slots = stamps[pairs[:count, 0]]
        object_indices = pairs[np.argsort(slots, kind="stable"), 1]
        starts = np.cumsum(np.append(0, np.bincount(slots, minlength=len(reached))))
        bricks = bricks_of(grid, reached)
        forces, filled = zero_forces(len(bricks)), np.zeros(len(bricks), np.bool_)
        objects: tuple[Any, ...] = (pool.boxes, placed, pool.tables, pool.cells, pool.supported)
        limits = (self._limit_n * _FLOOR_FRACTION, self._limit_n)
        work = (bricks, starts, object_indices, lattice, shape, *objects, limits, forces, filled)
        for_chunks(kernels.fill, len(bricks), *work, chunk=_BRICKS_AT_ONCE)
        return ForceField(grid, bricks[filled], forces[filled])

    def _at(self, frame: int) -> tuple[CellPool, Float64s]:
        """Return the tables of one frame for the kernels; the latest is cached."""
        from touchfield.medium.kernels import placed as kernels

        latest, scene = self._latest, self._scene
        if latest is not None and latest[0] == frame:
            return latest[1:]
        if not 0 <= frame < len(scene):
            raise InvalidArgument("frame", str(frame), f"0 to {len(scene) - 1}")
        pool = self._pool_of(frame)
        tracks = [scene_object.track for scene_object in scene.objects]
        poses = np.array([[*track.quaternions[frame], *track.positions_m[frame]] for track in tracks])
        motions, placed = np.zeros((len(tracks), 6)), np.empty((len(tracks), _COLUMNS))
        if scene.surface_damping_n_s_per_m:
            with np.errstate(over="ignore"):  # the kernels handle forces that overflow
                motions[:] = scene.surface_damping_n_s_per_m * self._motions[frame]
        kernels.fill_placements(poses, pool.lattices, motions, placed)
        self._latest = frame, pool, placed
        return pool, placed

    @cached_property
    def _motions(self) -> Float64s:
        """Linear and angular velocity of each object, float64 [frame, object, 6]."""
        motions = [
            np.hstack(scene_object.track.velocities(self._scene.rate_hz))
            for scene_object in self._scene.objects
        ]
        return np.stack(motions, axis=1)

    def _pool_of(self, frame: int) -> CellPool:
        """Return the fields of one frame; those of rigid objects are computed once."""
        if self._pool is not None:
            return self._pool
        rigid_pools, objects = self._rigid, self._scene.objects
        pools = [
            rigid_pools.get(n) or CellPool.of(scene_object.field(frame))
            for n, scene_object in enumerate(objects)
        ]
        self._rigid = {n: pool for n, pool in enumerate(pools) if objects[n].is_rigid}
        joined = CellPool.joined(pools)
        if len(self._rigid) == len(pools):
            self._pool, self._rigid = joined, {}
        return joined


def _keys(bricks: NDArray[np.integer[Any]], box: Int64s) -> Int64s:
    """Return raster indices of bricks within a box, x slowest, int64 [n]."""
    return np.asarray((bricks[:, 0] * box[1] + bricks[:, 1]) * box[2] + bricks[:, 2])
