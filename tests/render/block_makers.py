"""Writes fields and frames into a block, for the tests of the renderer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from touchfield.medium import ForceField, Grid
from touchfield.medium.cells import CellPool
from touchfield.render.block import Memory
from touchfield.render.block.frames import FramePart, field_bytes, frame_bytes, write_field, write_frame


class Block:
    """A block filled from front to back."""

    def __init__(self, size_bytes: int = 3_200_000) -> None:
        self.memory = Memory.empty(size_bytes)
        self.top = 64

    def field(self, field: ForceField) -> int:
        """Write a field; return its offset."""
        pool, at = CellPool.of(field), self.top
        write_field(self.memory, at, pool)
        self.top += field_bytes(pool)
        return at

    def frame(self, parts: Sequence[FramePart], force_max_n: float = np.inf, vibration_at: int = 0) -> int:
        """Write a frame; return its offset."""
        at = self.top
        write_frame(self.memory, at, parts, force_max_n, vibration_at)
        self.top += frame_bytes(len(parts))
        return at

    def voxels(self, field: ForceField) -> int:
        """Write a field and its frame of voxels; return the offset of the frame."""
        return self.frame([FramePart.voxels(self.field(field))])


def some_field(rng: np.random.Generator, grid: Grid | None = None) -> ForceField:
    """Random forces, possibly none, on a small lattice whose sides are not multiples of a brick."""
    if grid is None:
        grid = Grid(
            tuple(rng.integers(1, 20, 3)), tuple(rng.uniform(0.003, 0.02, 3)), tuple(rng.normal(0, 0.05, 3))
        )
    dense = rng.normal(size=(*grid.shape, 3))
    dense[rng.random(grid.shape) > rng.choice([0.0, 0.02, 0.6, 1.0])] = 0
    return ForceField.from_dense(grid, dense)
