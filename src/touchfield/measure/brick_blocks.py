"""Parts of space for a block bootstrap over a field: boxes of its lattice, or groups of the bricks of its support.

Source: S. N. Lahiri, Resampling Methods for Dependent Data, 2003, chapter 12 (blocks of a random field).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["BrickBoxes", "BrickGroups"]


@dataclass(frozen=True)
class BrickGroups:
    """Equal numbers of the bricks of a support, neighbours in the order of the field.

    Attributes
    ----------
    keys : int64 [n]
        `brick_keys` of the support, ascending, at least one.
    most : int
        Blocks that are wanted.
    """

    keys: Int64s
    most: int

    @property
    def count(self) -> int:
        """B."""
        return min(self.most, len(self.keys))

    def owner(self, grid: Grid, bricks: NDArray[np.int32]) -> Int64s:
        """The block of each brick, int64 [m], of int32 [m, 3]; bricks without a symbol may be anywhere."""
        place = np.minimum(np.searchsorted(self.keys, brick_keys(grid, bricks)), len(self.keys) - 1)
        owner: Int64s = place * self.count // len(self.keys)
        return owner


@dataclass(frozen=True)
class BrickBoxes:
    """Boxes of bricks that fill the lattice, `cuts` of them along each axis."""

    cuts: tuple[int, int, int]

    @classmethod
    def of(cls, grid: Grid, most: int) -> BrickBoxes:
        """At most so many, cut again and again across the longest side."""
        cuts = [1, 1, 1]
        while True:
            sides = [n / c for n, c in zip(grid.brick_shape, cuts, strict=True)]
            open_ = [a for a in np.argsort(sides)[::-1] if cuts[a] < grid.brick_shape[a]]
            longest = [a for a in open_ if np.prod(cuts) // cuts[a] * (cuts[a] + 1) <= most]
            if not longest:
                return cls((cuts[0], cuts[1], cuts[2]))
            cuts[longest[0]] += 1

    @property
    def count(self) -> int:
        """B."""
        a, b, c = self.cuts
        return a * b * c

    def owner(self, grid: Grid, bricks: NDArray[np.int32]) -> Int64s:
        """The block of each brick, int64 [m], of int32 [m, 3]."""
        a, b, c = (bricks.astype(np.int64) * self.cuts // grid.brick_shape).T
        owner: Int64s = (a * self.cuts[1] + b) * self.cuts[2] + c
        return owner

    def voxels(self, grid: Grid) -> Int64s:
        """Samples of the lattice in each box, int64 [B]."""
        along = []
        for n, size, cuts in zip(grid.brick_shape, grid.shape, self.cuts, strict=True):
            first = -(-np.arange(cuts + 1, dtype=np.int64) * n // cuts)  # brick i is in box i * cuts // n
            along.append(np.diff(np.minimum(first * BRICK, size)))
        x, y, z = along
        samples: Int64s = (x[:, None, None] * y[:, None] * z).reshape(-1)
        return samples
