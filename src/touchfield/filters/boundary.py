"""What a filter sees beyond the border (paper section 3.2, equation 4, which leaves it open).

Four continuations of samples a b c d, with the names of `scipy.ndimage`, which calls "zero" "constant":

======== =====================================================
zero     0 0 0 | a b c d | 0 0 0
nearest  a a a | a b c d | d d d
reflect  c b a | a b c d | d c b, about the edge of the cell
wrap     b c d | a b c d | a b c
======== =====================================================

"zero" is what a field means: there is no force beyond its grid. A field of bricks is continued by copying the forces
that lie near its border to a wider grid; where there are none, nothing is done.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["BOUNDARIES", "SCIPY_MODES", "checked_boundary", "continued_index", "cropped", "widened"]

SCIPY_MODES: Final = {"zero": "constant", "nearest": "nearest", "reflect": "reflect", "wrap": "wrap"}
"""What `scipy.ndimage` calls each of them."""

BOUNDARIES: Final = tuple(SCIPY_MODES)


def checked_boundary(boundary: str, where: str = "boundary") -> str:
    """The boundary itself.

    Raises `InvalidArgument` if it is not one of `BOUNDARIES`.
    """
    if boundary not in BOUNDARIES:
        raise InvalidArgument(where, repr(boundary), f"one of {', '.join(BOUNDARIES)}")
    return boundary


def continued_index(count: int, before: int, after: int, boundary: str) -> NDArray[np.int64]:
    """Which sample stands at each place of an axis continued beyond its ends, int64 [before + count + after].

    count : int; samples of the axis.
    before, after : int; places to add, each at most `count`.
    boundary : str; one of `BOUNDARIES`; "zero" gives -1 beyond the ends.
    """
    place = np.arange(-before, count + after, dtype=np.int64)
    if boundary == "zero":
        return np.where((place >= 0) & (place < count), place, -1)
    if boundary == "nearest":
        return np.clip(place, 0, count - 1)
    if boundary == "wrap":
        return place % count
    mirrored = place % (2 * count)
    return np.minimum(mirrored, 2 * count - 1 - mirrored)


def widened(field: ForceField, before: tuple[int, ...], after: tuple[int, ...], boundary: str) -> ForceField:
    """The field on a grid with more samples around it, filled as the boundary says.

    The grid grows by whole bricks at its beginning, at least `before` samples, so that bricks stay bricks.
    """
    grid = field.grid
    low = tuple(-(-b // BRICK) * BRICK for b in before)
    nx, ny, nz = (n + b + a for n, b, a in zip(grid.shape, low, after, strict=True))
    wide = Grid((nx, ny, nz), grid.spacing_m, tuple(grid.to_m(np.negative(low)).tolist()))
    moved = ForceField(wide, (field.bricks + np.floor_divide(low, BRICK)).astype(np.int32), field.forces_n)
    positions, slots = _near_border(field, before, after, boundary)
    if not len(positions):
        return moved
    for axis in range(3):
        more, of = _copies(positions[:, axis], grid.shape[axis], (before[axis], after[axis]), boundary)
        beyond = positions[of]
        beyond[:, axis] = more
        positions, slots = np.concatenate([positions, beyond]), np.concatenate([slots, slots[of]])
    outside = ((positions < 0) | (positions >= grid.shape)).any(axis=1)
    return _with_samples(moved, positions[outside] + low, field.forces_n.reshape(-1, 3)[slots[outside]])


def cropped(field: ForceField, grid: Grid) -> ForceField:
    """The part of a `widened` field that lies on the grid it was made from."""
    low = np.rint(np.asarray(field.grid.to_index(grid.origin_m)) / BRICK).astype(np.int32)
    bricks = field.bricks - low
    inside = ((bricks >= 0) & (bricks < grid.brick_shape)).all(axis=1)
    return ForceField.from_bricks(grid, bricks[inside], field.forces_n[inside])


def _near_border(
    field: ForceField, before: tuple[int, ...], after: tuple[int, ...], boundary: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices, int64 [n, 3], and places, int64 [n], of the forces that have a copy beyond the border."""
    shape, reach = np.array(field.grid.shape), np.maximum(before, after)
    near = (field.bricks * BRICK < reach) | ((field.bricks + 1) * BRICK > shape - reach)
    brick, i, j, k = np.nonzero(field.mask[near.any(axis=1)])
    brick = np.flatnonzero(near.any(axis=1))[brick]
    positions = field.bricks[brick].astype(np.int64) * BRICK + np.stack([i, j, k], axis=1)
    held = ((positions < reach) | (positions >= shape - reach)).any(axis=1)
    slots = ((brick * BRICK + i) * BRICK + j) * BRICK + k
    return positions[held], slots[held]


def _copies(
    index: NDArray[np.int64], count: int, reach: tuple[int, int], boundary: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places beyond the ends of an axis that samples of this index are copied to, and which sample each one is of."""
    continued = continued_index(count, *reach, boundary)
    place = np.arange(-reach[0], count + reach[1])
    places: list[Any] = [np.zeros(0, np.int64)]
    of: list[Any] = [np.zeros(0, np.int64)]
    for p in place[(place < 0) | (place >= count)]:
        same = np.flatnonzero(index == continued[p + reach[0]])
        places.append(np.full(len(same), p))
        of.append(same)
    return np.concatenate(places), np.concatenate(of)


def _with_samples(field: ForceField, positions: NDArray[np.int64], forces_n: NDArray[np.float32]) -> ForceField:
    """The field with the forces at these indices set."""
    own = brick_keys(field.grid, field.bricks)
    there = brick_keys(field.grid, positions // BRICK)
    keys = np.union1d(own, there)
    forces = zero_forces(len(keys))
    forces[np.searchsorted(keys, own)] = field.forces_n
    forces[(np.searchsorted(keys, there), *(positions % BRICK).T)] = forces_n
    bricks = np.stack(np.unravel_index(keys, field.grid.brick_shape), axis=1).astype(np.int32)
    return ForceField(field.grid, bricks, forces)
