"""Levels of detail: a pyramid of fields (paper section 4).

Level 0 is the field; each next level keeps every second sample of the one before along each axis, as it is. A force
ends at a surface and bends there: a low-pass, which the usual pyramid begins with, takes the bend to all that is
around, and of the voxels of a scan leaves half as many again beyond the mask (`bench/bench_detail.py`). What a
sample lattice twice as coarse misses is a wall that passes between its samples. So a sample without a force, right
behind such a wall, takes the mean of the forces on it: the wall stays closed, thicker behind and never in front.
"""

from __future__ import annotations

from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s
from touchfield.errors import InvalidArgument
from touchfield.filters.resample import interpolated
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.field import blocks_around, brick_keys, bricks_of, dilated

_OFFSETS: Final = tuple(o for o in product((-1, 0, 1), repeat=3) if any(o))
_A_WALL: Final = 3  # neighbours with a force, from which on they are a wall


def halved(grid: Grid) -> Grid:
    """The grid of every second sample of `grid` along each axis, the first among them."""
    nx, ny, nz = (-(-n // 2) for n in grid.shape)
    x, y, z = (h * (1 + (n > 1)) for h, n in zip(grid.spacing_m, grid.shape, strict=True))
    return Grid((nx, ny, nz), (x, y, z), grid.origin_m)


def most_levels(grid: Grid) -> int:
    """The number of halvings of a grid until one sample is left."""
    return (max(grid.shape) - 1).bit_length()


def pyramid(field: ForceField, levels: int) -> tuple[ForceField, ...]:
    """The levels of detail of a field, the finest first.

    levels : int; how often it is halved, 0 to `most_levels`; each level has 1/8 of the samples of the one before.
    Raises `InvalidArgument` if the grid cannot be halved so often.
    """
    most = most_levels(field.grid)
    if isinstance(levels, bool) or not isinstance(levels, int) or not 0 <= levels <= most:
        raise InvalidArgument("levels", repr(levels), f"0 to {most} for {field.grid.shape} samples")
    fields = [field]
    for _ in range(levels):
        fields.append(_next(fields[-1]))
    return tuple(fields)


def _next(field: ForceField) -> ForceField:
    """The next level of a field."""
    grid, spacing = halved(field.grid), np.asarray(field.grid.spacing_m, np.float32)
    # a kept sample looks one sample back, into the brick before
    around = np.concatenate([field.bricks + np.array(o, np.int32) for o in product((0, 1), repeat=3)])
    around = around[(around < field.grid.brick_shape).all(axis=1)]
    bricks = bricks_of(field.grid, np.unique(brick_keys(field.grid, around)))
    home, quarter = np.divmod(bricks, 2)
    coarse, slot = np.unique(brick_keys(grid, home), return_inverse=True)
    forces = np.zeros((len(coarse), 2, 4, 2, 4, 2, 4, 3), np.float32)
    for span, wide in blocks_around(field, field.forces_n, bricks, (2, 2, 2), (1, 1, 1)):
        (x, y, z), at = quarter[span].T, slot.reshape(-1)[span]
        forces[at, x, :, y, :, z] = _kept(wide, spacing)
    made = forces.reshape(-1, BRICK, BRICK, BRICK, 3)
    return ForceField.from_bricks(grid, bricks_of(grid, coarse), made)


def _kept(wide: NDArray[Any], spacing: Float32s) -> Float32s:
    """Next samples [n, 4, 4, 4, 3] in bricks [n, 11, 11, 11, 3] that have two samples before and one after."""
    held: Bools = np.asarray(wide.any(axis=-1))

    def at(values: NDArray[Any], offset: tuple[int, ...]) -> NDArray[Any]:
        x, y, z = (slice(2 + o, 9 + o, 2) for o in offset)
        return values[:, x, y, z]

    samples, there = at(wide, (0, 0, 0)).copy(), at(held, (0, 0, 0))
    total, count = np.zeros(samples.shape), np.zeros(there.shape, np.int32)
    for offset in _OFFSETS:
        force, beyond = at(wide, offset), at(held, (2 * offset[0], 2 * offset[1], 2 * offset[2]))
        # on a wall before this sample: the force points away from here, and the kept sample behind the wall has none
        is_wall = ~beyond & ((force * (spacing * np.array(offset, np.float32))).sum(axis=-1) > 0)
        total += np.where(is_wall[..., None], force, 0.0)
        count += is_wall
    closes = ~there & (count >= _A_WALL)
    samples[closes] = total[closes] / count[closes][:, None]
    return samples


def rebuilt(level: ForceField, grid: Grid) -> ForceField:
    """A level of detail as a receiver renders it: trilinear between its samples, at those of a finer grid."""
    if level.grid == halved(grid) and all(n > 1 for n in grid.shape):
        return _doubled(level, grid)
    return interpolated(level, grid, border="cell")


def _doubled(level: ForceField, grid: Grid) -> ForceField:
    """The same at the samples of the next finer grid: axis by axis a sample, or the mean of two.

    Beyond the outermost sample that one stands.
    """
    bricks = dilated(level.grid, level.bricks, (1, 1, 1))
    made = [np.empty((0, 8, BRICK, BRICK, BRICK, 3), np.float32)]
    for span, wide in blocks_around(level, level.forces_n, bricks, (0, 0, 0), (1, 1, 1)):
        for axis in range(3):
            lane = np.moveaxis(wide, axis + 1, 1)  # a view, to be filled beyond the border
            last = level.grid.shape[axis] - 1 - BRICK * bricks[span, axis]
            ends = np.flatnonzero(last < BRICK)
            lane[ends, last[ends] + 1] = lane[ends, last[ends]]
            fine = np.empty((len(lane), 2 * BRICK, *lane.shape[2:]), np.float32)
            fine[:, 0::2] = lane[:, :-1]
            fine[:, 1::2] = np.float32(0.5) * (lane[:, :-1] + lane[:, 1:])
            wide = np.moveaxis(fine, 1, axis + 1)
        cut = wide.reshape(-1, 2, BRICK, 2, BRICK, 2, BRICK, 3).transpose(0, 1, 3, 5, 2, 4, 6, 7)
        made.append(cut.reshape(-1, 8, BRICK, BRICK, BRICK, 3))
    places = (2 * bricks[:, None] + np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1)).reshape(-1, 3)
    inside = (places < np.array(grid.brick_shape)).all(axis=1)
    forces = np.concatenate(made).reshape(-1, BRICK, BRICK, BRICK, 3)[inside]
    return ForceField.from_bricks(grid, places[inside], forces)
