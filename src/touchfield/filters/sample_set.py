"""A set of lattice samples: which points belong to it, and how far the others are from it.

Only the set's own samples are held, never the lattice. The sample of the set nearest to one outside has a neighbour
outside, and the other way round (a step along one axis would otherwise come nearer), so that the two shells hold
every nearest sample.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.medium import Grid

    Int64s = NDArray[np.int64]

__all__ = ["SampleSet"]


@dataclass(frozen=True, eq=False)
class SampleSet:
    """Samples of a grid by their places in raster order (x slowest), int64 [m], strictly ascending."""

    grid: Grid
    places: Int64s

    @classmethod
    def of(cls, grid: Grid, positions: ArrayLike) -> SampleSet:
        """From indices, int [m, 3], in any order and perhaps several times.

        Raises `InvalidArgument` if they are not whole numbers within the grid.
        """
        given = np.asarray(positions)
        if given.size and (given.ndim != 2 or given.shape[1] != 3 or given.dtype.kind not in "iu"):
            raise InvalidArgument("voxels", f"{given.dtype} {given.shape}", "whole numbers [m, 3]")
        p = given.reshape(-1, 3).astype(np.int64)
        if len(p) and (p.min() < 0 or (p.max(axis=0) >= grid.shape).any()):
            raise InvalidArgument("voxels", "an index outside the grid", f"below {grid.shape}")
        return cls(grid, np.unique(_places(grid, p)))

    def __len__(self) -> int:
        return len(self.places)

    def holds(self, points_m: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points [..., 3] have their nearest sample in the set, bool [...]."""
        index = np.rint(self.grid.to_index(points_m))
        inside = ((index >= 0) & (index < self.grid.shape)).all(axis=-1)
        held = np.zeros(points_m.shape[:-1], np.bool_)
        held[inside] = self._among(_places(self.grid, index[inside].astype(np.int64)))
        return held

    def distance_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """From a point outside to the nearest sample of the set; of one inside, minus that to the nearest without.

        Infinite where there is no such sample. float64 [...], metres.
        """
        held = self.holds(points_m)
        distance = np.full(points_m.shape[:-1], np.inf)
        for which, tree in ((~held, self._trees[0]), (held, self._trees[1])):
            if tree is not None and which.any():
                distance[which] = tree.query(points_m[which])[0]
        return np.where(held, -distance, distance)

    def _among(self, places: Int64s) -> NDArray[np.bool_]:
        if not len(self.places):
            return np.zeros(len(places), np.bool_)
        slot = np.minimum(np.searchsorted(self.places, places), len(self.places) - 1)
        found: NDArray[np.bool_] = self.places[slot] == places
        return found

    @cached_property
    def _trees(self) -> tuple[Any, Any]:
        """Of the samples of the set that have a neighbour outside, and of those neighbours; None for none."""
        from scipy.spatial import cKDTree

        positions = np.stack(np.unravel_index(self.places, self.grid.shape), axis=1)
        edge = np.zeros(len(positions), np.bool_)
        outside = [positions[:0]]
        for axis in range(3):
            for step in (-1, 1):
                beside = positions.copy()
                beside[:, axis] += step
                free = (beside[:, axis] >= 0) & (beside[:, axis] < self.grid.shape[axis])
                free[free] = ~self._among(_places(self.grid, beside[free]))
                edge |= free
                outside.append(beside[free])
        shells = (positions[edge], np.unique(np.concatenate(outside), axis=0))
        first, second = (cKDTree(self.grid.to_m(s)) if len(s) else None for s in shells)
        return first, second


def _places(grid: Grid, positions: Int64s) -> Int64s:
    _, ny, nz = grid.shape
    places: Int64s = (positions[:, 0] * ny + positions[:, 1]) * nz + positions[:, 2]
    return places
