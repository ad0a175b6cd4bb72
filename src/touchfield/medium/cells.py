"""Stores fields in *cells*, the layout that the force queries in C read, and evaluates a scene of bodies.

Each brick of 8^3 samples is stored as a block of 9^3 samples: its own and the first samples of the next
bricks along each axis. The eight samples around any point are then in one block. Blocks are found through a
hash table. ``c/touch_cells.h`` writes and reads them, ``c/touch_placed.h`` adds up bodies at their poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float32s, Float64s, Int32s, Int64s
from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium.budget import memory_budget_bytes, require_memory, zero_forces
from touchfield.medium.field import ForceField, bricks_of
from touchfield.medium.grid import BRICK

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
_FIRST_PAIRS: Final = 1 << 14
_TOO_MANY_PAIRS: Final = -1  # of `native.find_reached`
_PLACEMENT_COLUMNS: Final = 33  # numbers of a `touch_placement` in c/touch_placed.h
_POINTS_PER_THREAD: Final = 2048
_BRICKS_PER_THREAD: Final = 64
_LATTICE_BRICKS_PER_THREAD: Final = 8
"""Smallest ranges worth a thread."""
_BYTES_PER_CELLS: Final = (BRICK + 1) ** 3 * 3 * 4


@dataclass(frozen=True)
class CellPool:
    """The fields of some objects as cells, joined; arrays as in `touch_cells` of ``c/touch_receiver.h``."""

    # float64 [objects, 6]; spacing, and corner of the object's box of bricks in its body frame, metres
    lattices: Float64s
    # int64 [objects, 5]; bricks of the box along x, y and z; start of its hash table in `tables`; 64 minus
    # the number of bits of an index in it
    boxes: Int64s
    starts: Int64s  # int64 [objects + 1]
    bricks: Int32s  # int32 [n, 3]; brick coordinates of the cells, counted from the corner of the box
    cells: Float32s  # float32 [n * 9 * 9 * 9 * 3]
    supported: NDArray[np.uint64]  # uint64 [n, 8]
    tables: Int64s  # int64 [m, 2]
    data: NDArray[np.uint8] | None = None  # the `touch_cells` of one object, in which the arrays lie

    @classmethod
    def of(cls, field: ForceField, paired: ForceField | None = None) -> CellPool:
        """Return the pool of one field.

        If `paired` is given, the pool also has cells for the bricks of that field, so that the pools of both
        fields have their cells in the same order.
        """
        spacing, origin = field.grid.spacing_m, field.grid.origin_m
        of_field = field.bricks, field.forces_n
        of_paired = (None, None) if paired is None else (paired.bricks, paired.forces_n)
        found, corner, box, size_bytes = native.find_cells(*of_field, *of_paired)
        bricks = np.frombuffer(found, np.int32).reshape(-1, 3)
        require_memory("haptic objects", f"{len(bricks)} bricks", len(bricks) * _BYTES_PER_CELLS)
        data = np.empty(size_bytes, np.uint8)
        header = native.start_cells(data, corner, box, bricks, spacing, origin)
        corner_m, shift, table, supported, samples = header
        for_chunks(native.fill_cells, len(bricks), data, corner, bricks, *of_field, chunk=_BRICKS_PER_THREAD)
        return cls(
            np.array([[*spacing, *corner_m]]),
            np.array([[*box, 0, shift]]),
            np.array([0, len(bricks)]),
            bricks,
            data[samples : samples + _BYTES_PER_CELLS * len(bricks)].view(np.float32),
            data[supported:samples].view(np.uint64).reshape(-1, BRICK),
            data[table:supported].view(np.int64).reshape(-1, 2),
            data,
        )

    @property
    def field_data(self) -> NDArray[np.uint8]:
        """`data` of a pool of one field, uint8 [n]; ValueError for one of several."""
        if self.data is None:
            raise ValueError("a pool of several fields")
        return self.data

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
        points = np.ascontiguousarray(positions_m, np.float64)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise InvalidArgument("positions_m", f"shape {points.shape}", "points [..., 3] in metres")
        objects = self._objects(self._at(frame))
        out = np.empty(points.shape, np.float32)
        count = points.size // 3
        for_chunks(native.placed_at_points, count, points, objects, out, chunk=_POINTS_PER_THREAD)
        return out

    def voxels(self, frame: int, grid: Grid, file_bytes: int | None = None) -> ForceField:
        """Return one frame on a lattice; see `HapticScene.voxelise`.

        Each sample equals `sample_n` at its position.
        """
        placed = self._at(frame)
        objects = self._objects(placed)
        lattice = tuple(map(float, grid.origin_m)), tuple(map(float, grid.spacing_m)), tuple(grid.shape)
        pairs, stamps = self._reached(frame, grid, lattice, placed[0], objects, file_bytes)
        reached = np.unique(pairs[:, 0])
        stamps[reached] = np.arange(len(reached))
        slots = stamps[pairs[:, 0]]
        object_indices = pairs[np.argsort(slots, kind="stable"), 1]
        starts = np.cumsum(np.append(0, np.bincount(slots, minlength=len(reached))))
        bricks = bricks_of(grid, reached)
        forces, has_force = zero_forces(len(bricks)), np.zeros(len(bricks), np.bool_)
        arguments = (bricks, starts, object_indices, lattice, objects, forces, has_force)
        for_chunks(native.fill_lattice, len(bricks), *arguments, chunk=_LATTICE_BRICKS_PER_THREAD)
        return ForceField(grid, bricks[has_force], forces[has_force])

    def _reached(
        self,
        frame: int,
        grid: Grid,
        lattice: tuple[Any, ...],
        pool: CellPool,
        objects: tuple[Any, ...],
        file_bytes: int | None,
    ) -> tuple[Int64s, Int32s]:
        """Return the pairs of a brick of the lattice and an object that may reach it, int64 [m, 2].

        Objects are ascending. Also returns an array with a number for each brick of the lattice, to be
        overwritten. Raises `CorruptFile` if there are more pairs than a file of `file_bytes` may have.
        """
        brick_count, allowed = math.prod(grid.brick_shape), memory_budget_bytes() // 4
        if brick_count > allowed:
            raise InvalidArgument(
                "grid shape", f"{grid.shape}, {brick_count} bricks", f"at most {allowed} bricks"
            )
        max_pairs = _MEETINGS_FREE + _MEETINGS_PER_BYTE * file_bytes if file_bytes is not None else _ANY
        capacity = _FIRST_PAIRS
        while True:
            stamps, pairs = np.zeros(brick_count, np.int32), np.empty((capacity, 2), np.int64)
            count = native.find_reached(lattice, objects, pool.starts, pool.bricks, stamps, max_pairs, pairs)
            if count == _TOO_MANY_PAIRS:
                found = f"objects that reach more than {max_pairs} bricks of the {grid.shape} samples"
                raise CorruptFile(
                    f"objects, frame {frame}", found, f"at most that in a file of {file_bytes} bytes"
                )
            if count >= 0:
                return pairs[:count], stamps
            capacity *= 4
            del stamps, pairs  # before there are new ones: a grid may have 2^27 bricks

    def _objects(self, placed: tuple[CellPool, Float64s]) -> tuple[Any, ...]:
        """Return the objects of a frame as the functions in C take them."""
        pool, placements = placed
        arrays = pool.boxes, placements, pool.tables, pool.cells, pool.supported
        return (*arrays, self._limit_n * _FLOOR_FRACTION, self._limit_n)

    def _at(self, frame: int) -> tuple[CellPool, Float64s]:
        """Return the fields of one frame and their placements, float64 [objects, 33].

        The latest frame is cached.
        """
        latest, scene = self._latest, self._scene
        if latest is not None and latest[0] == frame:
            return latest[1:]
        if not 0 <= frame < len(scene):
            raise InvalidArgument("frame", str(frame), f"0 to {len(scene) - 1}")
        pool = self._pool_of(frame)
        quaternions, positions_m, motions, _ = scene.poses(frame)
        placements = np.empty((len(quaternions), _PLACEMENT_COLUMNS))
        native.place_objects(
            np.hstack([quaternions, positions_m]), pool.lattices, np.array(motions), placements
        )
        self._latest = frame, pool, placements
        return pool, placements

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
