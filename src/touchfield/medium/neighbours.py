"""Neighbours of bricks, for filters and predictors that look over the edge of a brick."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.field import brick_keys, slots_around
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["dilated", "neighbour_slots"]

_MAX_PAIRS = 1 << 27


def dilated(grid: Grid, bricks: NDArray[np.int32], reach: tuple[int, int, int]) -> NDArray[np.int32]:
    """The bricks that a force may reach from `bricks` by moving up to `reach` samples along each axis.

    Parameters
    ----------
    bricks : int32 [n, 3]
    reach : (int, int, int); Samples, 0 or more.

    Returns
    -------
    int32 [m, 3]; Ascending, all within the grid, `bricks` among them.

    Raises `InvalidArgument` if the reach makes more than 2^27 pairs of bricks.
    """
    reached = bricks
    for axis in range(3):
        margin = min(-(-int(reach[axis]) // BRICK), grid.brick_shape[axis])
        if len(reached) * (2 * margin + 1) > _MAX_PAIRS:
            asked = f"{reach} samples around {len(bricks)} bricks"
            raise InvalidArgument("filter reach", asked, "a smaller reach", "Take a coarser grid.")
        moved = np.repeat(reached[:, None], 2 * margin + 1, axis=1)
        moved[:, :, axis] += np.arange(-margin, margin + 1, dtype=np.int32)
        inside = (moved[:, :, axis] >= 0) & (moved[:, :, axis] < grid.brick_shape[axis])
        keys = np.unique(brick_keys(grid, moved[inside]))
        reached = np.stack(np.unravel_index(keys, grid.brick_shape), axis=1).astype(np.int32)
    return reached


def neighbour_slots(grid: Grid, bricks: NDArray[np.int32]) -> NDArray[np.int32]:
    """For each brick the places in `bricks` of the 27 around it, int32 [n, 27]; -1 where there is none.

    Neighbour ``(di + 1) * 9 + (dj + 1) * 3 + dk + 1`` lies at offset (di, dj, dk); 13 is the brick itself.
    `bricks` must be ascending.
    """
    return slots_around(bricks, bricks, grid.brick_shape).astype(np.int32)
