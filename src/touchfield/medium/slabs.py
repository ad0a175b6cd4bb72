"""Dense pieces of a sparse field, eight samples thick: what dense file formats are written and read in.

A dense 256^3 frame takes 201 MB, a slab of it 6 MB.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from touchfield.medium.field import ForceField, brick_keys
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["dense_slabs", "field_of_slabs", "slab_depths"]


def slab_depths(grid: Grid, axis: int) -> list[int]:
    """Samples along `axis` in each slab: 8, and what is left in the last."""
    return [min(BRICK, grid.shape[axis] - b * BRICK) for b in range(grid.brick_shape[axis])]


def dense_slabs(field: ForceField, axis: int) -> Iterator[NDArray[np.float32]]:
    """The field in slabs across `axis`, in ascending order.

    Yields
    ------
    float32 [nx, ny, nz, 3]; Newtons; the slab's own depth (8, or less in the last) in place of the samples along
        `axis`.
    """
    order = np.argsort(field.bricks[:, axis], kind="stable")
    edges = np.searchsorted(field.bricks[order, axis], np.arange(field.grid.brick_shape[axis] + 1))
    wide = [n for a, n in enumerate(field.grid.brick_shape) if a != axis]
    for slab, depth in enumerate(slab_depths(field.grid, axis)):
        own = order[edges[slab] : edges[slab + 1]]
        across = np.delete(field.bricks[own], axis, axis=1)
        tiled = np.zeros((*wide, BRICK, BRICK, BRICK, 3), np.float32)
        tiled[tuple(across.T)] = field.forces_n[own]
        tiled = np.expand_dims(tiled, axis).transpose(0, 3, 1, 4, 2, 5, 6)
        shape = [n * BRICK for n in field.grid.brick_shape]
        shape[axis] = BRICK
        nx, ny, nz = (depth if a == axis else n for a, n in enumerate(field.grid.shape))
        yield np.ascontiguousarray(tiled.reshape(*shape, 3)[:nx, :ny, :nz])


def field_of_slabs(
    grid: Grid, slabs: Iterator[NDArray[np.float32]], axis: int, *, to_the_bit: bool = False
) -> ForceField:
    """The inverse of `dense_slabs`: only bricks that hold a force are kept; `to_the_bit` also those of -0.0 alone.

    Raises `InvalidArgument` if a force is not finite.
    """
    bricks, forces = [np.zeros((0, 3), np.int32)], [np.zeros((0, BRICK, BRICK, BRICK, 3), np.float32)]
    for slab, dense in enumerate(slabs):
        short = [(0, -n % BRICK) for n in dense.shape[:3]]
        padded = np.pad(dense, [*short, (0, 0)]) if any(after for _, after in short) else dense
        bx, by, bz = (n // BRICK for n in padded.shape[:3])
        tiled = padded.reshape(bx, BRICK, by, BRICK, bz, BRICK, 3).transpose(0, 2, 4, 1, 3, 5, 6)
        is_held = np.ascontiguousarray(tiled).view(np.uint32) != 0 if to_the_bit else tiled != 0
        held = np.argwhere(is_held.any(axis=(3, 4, 5, 6))).astype(np.int32)
        forces.append(tiled[tuple(held.T)])
        held[:, axis] = slab
        bricks.append(held)
    every, values = np.concatenate(bricks), np.concatenate(forces)
    if not to_the_bit:
        return ForceField.from_bricks(grid, every, values)
    order = np.argsort(brick_keys(grid, every))
    return ForceField(grid, every[order], values[order])
