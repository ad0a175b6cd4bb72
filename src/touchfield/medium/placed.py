"""Fields in motion: the force that the objects of a haptic scene make at points, and on a lattice.

What the query needs of an object is made when first asked for and kept: about twice the bytes of its bricks.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium.budget import memory_budget_bytes, zero_forces
from touchfield.medium.cells import CellPool
from touchfield.medium.field import ForceField
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.medium.grid import Grid
    from touchfield.medium.haptic_scene import HapticScene

    Int64s = NDArray[np.int64]
    Float64s = NDArray[np.float64]

__all__ = ["PlacedFields"]

_FLOOR_SHARE: Final = 1e-9
"""An object's own force below this share of F_max is the rounding of a place on the edge of its support."""

_MEETINGS_FREE: Final = 4096
_MEETINGS_PER_BYTE: Final = 32
"""A frame of a file of n bytes meets at most `_MEETINGS_FREE` + 32 n bricks of the workspace, each once an object."""

_ANY: Final = 1 << 50
_COLUMNS: Final = 33
_POINTS_AT_ONCE: Final = 2048
_BRICKS_AT_ONCE: Final = 8


class PlacedFields:
    """The fields of a haptic scene where they lie."""

    def __init__(self, scene: HapticScene) -> None:
        self._objects = scene.objects
        self._frame_count, self._rate_hz = scene.frame_count, scene.rate_hz
        self._limit_n, self._damping = float(scene.force_max_n), float(scene.surface_damping_n_s_per_m)
        self._rigid: dict[int, CellPool] = {}
        self._pool: CellPool | None = None
        self._velocities: list[tuple[Float64s, Float64s]] = []
        self._latest: tuple[int, CellPool, Float64s] | None = None

    def sample_n(self, frame: int, positions_m: ArrayLike) -> NDArray[np.float32]:
        """See `HapticScene.sample_n`."""
        from touchfield.medium.kernels import placed as kernels

        points = np.ascontiguousarray(positions_m, np.float64)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise InvalidArgument("positions_m", f"shape {points.shape}", "points [..., 3] in metres")
        pool, placed = self._at(frame)
        out = np.empty(points.shape, np.float32)
        flat, forces, floor = points.reshape(-1, 3), out.reshape(-1, 3), self._limit_n * _FLOOR_SHARE
        if not flat.flags.writeable:
            flat = flat.copy()  # to the compiler read-only arrays are another type
        beside = (pool.boxes, placed, pool.tables, pool.cells, pool.held, floor, self._limit_n)
        for_chunks(kernels.at_points, len(flat), flat, *beside, forces, chunk=_POINTS_AT_ONCE)
        return out

    def voxels(self, frame: int, grid: Grid, file_bytes: int | None = None) -> ForceField:
        """One frame on a lattice: each sample is `sample_n` at its point; see `HapticScene.voxelise`."""
        from touchfield.medium.kernels import placed as kernels

        pool, placed = self._at(frame)
        lattice, shape = np.array([*grid.origin_m, *grid.spacing_m]), np.array(grid.shape)
        stamps = _stamps(grid)
        most = _MEETINGS_FREE + _MEETINGS_PER_BYTE * file_bytes if file_bytes is not None else _ANY
        beside = pool.boxes, placed, pool.starts, pool.bricks, stamps, most
        count, pairs = kernels.meetings(lattice, shape, *beside)
        if count < 0:
            found = f"objects that reach more than {most} bricks of the {grid.shape} samples"
            raise CorruptFile(f"objects, frame {frame}", found, f"at most that in a file of {file_bytes} bytes")
        reached = np.unique(pairs[:count, 0])
        stamps[reached] = np.arange(len(reached))
        slots = stamps[pairs[:count, 0]]
        which = pairs[np.argsort(slots, kind="stable"), 1]
        starts = np.cumsum(np.append(0, np.bincount(slots, minlength=len(reached))))
        bricks = np.stack(np.unravel_index(reached, grid.brick_shape), axis=1).astype(np.int32)
        forces, filled = zero_forces(len(bricks)), np.zeros(len(bricks), np.bool_)
        objects: tuple[Any, ...] = (pool.boxes, placed, pool.tables, pool.cells, pool.held)
        limits = (self._limit_n * _FLOOR_SHARE, self._limit_n)
        work = (bricks, starts, which, lattice, shape, *objects, limits, forces, filled)
        for_chunks(kernels.fill, len(bricks), *work, chunk=_BRICKS_AT_ONCE)
        count = kernels.close_up(bricks, forces, filled)
        return ForceField(grid, bricks[:count], forces[:count])

    def _at(self, frame: int) -> tuple[CellPool, Float64s]:
        """What the kernels read of one frame; the latest is kept."""
        from touchfield.medium.kernels import placed as kernels

        latest = self._latest
        if latest is not None and latest[0] == frame:
            return latest[1:]
        if not 0 <= frame < self._frame_count:
            raise InvalidArgument("frame", str(frame), f"0 to {self._frame_count - 1}")
        pool = self._pool_of(frame)
        count = len(self._objects)
        poses, motions = np.empty((count, 7)), np.zeros((count, 6))
        for n, one in enumerate(self._objects):
            poses[n, :4], poses[n, 4:] = one.track.quaternions[frame], one.track.positions_m[frame]
        if self._damping:
            if not self._velocities:
                self._velocities = [one.track.velocities(self._rate_hz) for one in self._objects]
            for n, (velocity, spin) in enumerate(self._velocities):
                motions[n, :3], motions[n, 3:] = velocity[frame], spin[frame]
            with np.errstate(over="ignore"):  # the kernels cut what is beyond all bounds
                motions *= self._damping
        placed = np.empty((count, _COLUMNS))
        kernels.place(poses, pool.lattices, motions, placed)
        self._latest = frame, pool, placed
        return pool, placed

    def _pool_of(self, frame: int) -> CellPool:
        """The fields of one frame; those of rigid objects are made once."""
        if self._pool is not None:
            return self._pool
        pools, rigid = [], self._rigid  # the same for threads that come meanwhile: what they make is made twice
        for n, one in enumerate(self._objects):
            pool = rigid.get(n) or CellPool.of(one.field(frame))
            if one.is_rigid:
                rigid[n] = pool
            pools.append(pool)
        joined = CellPool.joined(pools)
        if len(rigid) == len(self._objects):
            self._pool, self._rigid = joined, {}
        return joined


def _stamps(grid: Grid) -> NDArray[np.int32]:
    """Zero for each brick of the lattice."""
    count, allowed = math.prod(grid.brick_shape), memory_budget_bytes() // 4
    if count > allowed:
        raise InvalidArgument("grid shape", f"{grid.shape}, {count} bricks", f"at most {allowed} bricks")
    return np.zeros(count, np.int32)
