"""Equation 4 where its kernel is a product of one row of taps for each axis (paper section 3.2), and the border.

Three passes of N taps instead of one of N^3. For dense arrays the three are fused block by block, so that what lies
between them never leaves the processor's cache; for bricks each pass adds only the bricks that it reaches along its
own axis. Departure from equation 4: the origin of the taps is free, so that a filter need not shift the field.

What a filter sees beyond the border equation 4 leaves open. Four continuations of samples a b c d, with the names of
`scipy.ndimage`, which calls "zero" "constant":

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

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys, frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Axes = tuple["AxisTaps", "AxisTaps", "AxisTaps"]

SCIPY_MODES: Final = {"zero": "constant", "nearest": "nearest", "reflect": "reflect", "wrap": "wrap"}
"""The name of each in `scipy.ndimage`."""

BOUNDARIES: Final = tuple(SCIPY_MODES)


def checked_boundary(boundary: str, where: str = "boundary") -> str:
    """The boundary itself.

    Raises `InvalidArgument` if it is not one of `BOUNDARIES`.
    """
    if boundary not in BOUNDARIES:
        raise InvalidArgument(where, repr(boundary), f"one of {', '.join(BOUNDARIES)}")
    return boundary


def continued_index(count: int, before: int, after: int, boundary: str) -> NDArray[np.int64]:
    """The sample at each place of an axis continued beyond its ends, int64 [before + count + after].

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


_MAX_PAIRS = 1 << 27


@dataclass(frozen=True)
class AxisTaps:
    """The taps of one axis: y[n] = sum over k of taps[k] x[n + origin - k].

    taps : float64 [N]; the impulse response h of equation 4.
    origin : int; the tap that stands over the sample itself: 0 for the causal form of equation 4, (N - 1) / 2 for the
        centred.
    """

    taps: NDArray[np.float64]
    origin: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "taps", frozen(np.array(self.taps, np.float64)))

    @classmethod
    def centred(cls, taps: ArrayLike) -> AxisTaps:
        """An odd number of taps about their middle."""
        row = np.asarray(taps, np.float64)
        return cls(row, len(row) // 2)

    @property
    def before(self) -> int:
        """The distance back from a sample to the first one of its sum."""
        return len(self.taps) - 1 - self.origin

    @property
    def after(self) -> int:
        """The distance ahead from a sample to the last one of its sum."""
        return self.origin

    @property
    def reach(self) -> int:
        """The greater of the two."""
        return max(self.before, self.after)

    def check_fits(self, count: int, where: str) -> None:
        """Raise if there are more taps than samples along the axis.

        Raises `InvalidArgument` naming `where`.
        """
        if len(self.taps) > count:
            raise InvalidArgument(
                where, f"{len(self.taps)} taps along an axis of {count} samples", f"at most {count} taps",
                "Take a shorter kernel, or a finer or larger field.",
            )  # fmt: skip


def factors(kernel: NDArray[np.float64], tolerance: float = 1e-12) -> list[NDArray[np.float64]] | None:
    """One row of taps for each axis whose product is the kernel; None if there are none.

    kernel : float64, N-D
    tolerance : float; how far the product may be from the kernel, of its greatest tap.
    """
    peak = np.unravel_index(np.abs(kernel).argmax(), kernel.shape)
    top = kernel[peak]
    if top == 0:
        return None
    rows = []
    for axis in range(kernel.ndim):
        line = kernel[tuple(slice(None) if a == axis else peak[a] for a in range(kernel.ndim))]
        rows.append(line / (top if axis else 1.0))
    product = rows[0]
    for row in rows[1:]:
        product = np.multiply.outer(product, row)
    return rows if np.abs(product - kernel).max() <= tolerance * abs(top) else None


def filter_array(signal: NDArray[np.float32], axes: Axes, boundary: str) -> NDArray[np.float32]:
    """A dense array filtered along its first three axes, float32 [nx, ny, nz, parts].

    No axis may have more taps than samples (`AxisTaps.check_fits`).
    """
    from touchfield.filters.kernels import separable_dense as kernels

    x, y, z = (continued_index(n, a.before, a.after, boundary) for n, a in zip(signal.shape[:3], axes, strict=True))
    return kernels.dense_filtered(signal, (x, y, z), axes[2].before, packed(axes))


def filter_field(field: ForceField, axes: Axes, boundary: str = "zero") -> tuple[ForceField, bool]:
    """A field filtered brick by brick, on the same grid, and whether all sums were finite while they were made.

    Only bricks that a force reaches are made; the same bits for any number of threads. A sum that is not finite may
    be one outside the grid. No axis may have more taps than samples (`AxisTaps.check_fits`).
    """
    if not len(field.bricks):
        return field, True
    if boundary == "zero":
        return _filtered(field, axes)
    # the taps of a sum look `before` back and `after` ahead, beyond the grid's two ends
    wide = widened(field, tuple(a.before for a in axes), tuple(a.after for a in axes), boundary)
    made, finite = _filtered(wide, axes)
    return cropped(made, field.grid), finite


def _filtered(field: ForceField, axes: Axes) -> tuple[ForceField, bool]:
    from touchfield.filters.kernels import separable_bricks as kernels

    grid = field.grid
    keys = [brick_keys(grid, field.bricks)]
    for axis in range(3):
        keys.append(spread(keys[-1], grid.brick_shape, axis, axes[axis]))
    bricks = np.stack(np.unravel_index(keys[3], grid.brick_shape), axis=1).astype(np.int32)
    before = (axes[0].before, axes[1].before, axes[2].before)
    x, y, z = (len(a.taps) - 1 for a in axes)
    forces, tops = kernels.bricks_filtered_and_tops(
        field.forces_n, (keys[0], keys[1], keys[2], keys[3]), grid.brick_shape, before, (x, y, z), packed(axes)
    )
    return brick_field(grid, bricks, forces, tops != 0), bool(np.isfinite(tops).all())


def spread(keys: NDArray[np.int64], lattice: tuple[int, int, int], axis: int, taps: AxisTaps) -> NDArray[np.int64]:
    """Keys of the bricks that hold something after a pass along one axis, ascending, each once."""
    back, ahead = -(-taps.after // BRICK), -(-taps.before // BRICK)
    if len(keys) * (back + ahead + 1) > _MAX_PAIRS:
        raise InvalidArgument(
            "filter reach", f"{taps.reach} samples around {len(keys)} bricks", "a smaller reach",
            "Take a coarser grid.",
        )  # fmt: skip
    step = int(np.prod(lattice[axis + 1 :]))
    place = keys // step % lattice[axis]
    moved = [
        keys[(place + d >= 0) & (place + d < lattice[axis])] + d * step
        for d in range(max(-back, 1 - lattice[axis]), min(ahead, lattice[axis] - 1) + 1)
    ]
    every = np.sort(np.concatenate(moved), kind="stable")  # several ascending rows: quickly merged
    found: NDArray[np.int64] = every[np.append(True, np.diff(every) > 0)]
    return found


def brick_field(
    grid: Grid, bricks: NDArray[np.int32], forces_n: NDArray[np.float32], held: NDArray[np.bool_]
) -> ForceField:
    """The field of the bricks that a kernel made: without what lies beyond the grid, and without empty bricks.

    `forces_n` float32 [n, 8, 8, 8, 3] and `held` bool [n], which bricks hold a force, are changed in place.
    """
    for axis, count in enumerate(grid.shape):
        rest = count % BRICK
        if rest:
            at_end = np.flatnonzero(bricks[:, axis] == count // BRICK)
            last = forces_n[at_end]
            np.moveaxis(last, axis + 1, 1)[:, rest:] = 0
            forces_n[at_end] = last
            held[at_end] &= last.any(axis=(1, 2, 3, 4))
    if not held.all():
        bricks, forces_n = bricks[held], forces_n[held]
    return ForceField(grid, bricks, forces_n)


def packed(axes: Axes) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Taps as the kernels take them: places int64 [3, n] and weights float32 [3, n].

    A row begins with two counts: of samples that stand alone, and of mirrored pairs that share a weight. Then come
    the places of those that stand alone, of one half of each pair, and of the other halves, which have no weight of
    their own. Places count from the first sample of the sum; taps of weight zero are left out.
    """
    longest = 2 + max(len(a.taps) for a in axes)
    places, weights = np.zeros((3, longest), np.int64), np.zeros((3, longest), np.float32)
    for axis, a in enumerate(axes):
        w = a.taps[::-1].astype(np.float32)
        low = np.arange(len(w) // 2)
        low = low[(w[low] == w[len(w) - 1 - low]) & (w[low] != 0)]
        high = len(w) - 1 - low
        alone = np.setdiff1d(np.flatnonzero(w), np.concatenate([low, high]))
        row = np.concatenate([[len(alone), len(low)], alone, low, high])
        places[axis, : len(row)] = row
        weights[axis, 2 : 2 + len(alone) + len(low)] = w[row[2 : 2 + len(alone) + len(low)]]
    return places, weights


def places_of(bricks: NDArray[np.int32], axis: int) -> NDArray[np.int32]:
    """Indices of the samples of each brick along one axis, int32 [n, 8]."""
    return np.asarray(bricks[:, axis, None] * BRICK + np.arange(BRICK), np.int32)


def within_grid(grid: Grid, bricks: NDArray[np.int32]) -> NDArray[np.bool_]:
    """The samples of the bricks that are those of the grid, bool [n, 8, 8, 8]."""
    x, y, z = (places_of(bricks, axis) < count for axis, count in enumerate(grid.shape))
    return np.asarray(x[:, :, None, None] & y[:, None, :, None] & z[:, None, None, :])
