"""Applies FIR filters that are a product of one filter along each axis (equation 4, paper section 3.2) to
sparse fields, and defines how a field continues beyond its border.

Three passes of N taps replace one of N^3; each adds only the bricks that it reaches along its own axis.
Departure from equation 4: the taps are centred on the sample, so that a filter does not shift the field.

Equation 4 does not define the signal beyond the border. There are four continuations of samples a b c d, with
the names of `scipy.ndimage` (which calls "zero" "constant"):

======== =====================================================
zero     0 0 0 | a b c d | 0 0 0
nearest  a a a | a b c d | d d d
reflect  c b a | a b c d | d c b, about the edge of the cell
wrap     b c d | a b c d | a b c
======== =====================================================

Fields use "zero" by default: there is no force beyond the grid. Another continuation needs a dense copy.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.threads import for_chunks, worker_count
from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.budget import BYTES_PER_BRICK, require_memory
from touchfield.medium.field import brick_keys, bricks_of, frozen, spread_keys

Axes = tuple["AxisTaps", "AxisTaps", "AxisTaps"]

SCIPY_MODES: Final = {"zero": "constant", "nearest": "nearest", "reflect": "reflect", "wrap": "wrap"}
"""The name of each continuation in `scipy.ndimage`."""

NUMPY_MODES: Final[dict[str, Any]] = {
    "zero": "constant",
    "nearest": "edge",
    "reflect": "symmetric",
    "wrap": "wrap",
}
"""The name of each continuation in `numpy.pad`."""

BOUNDARIES: Final = tuple(SCIPY_MODES)


@dataclass(frozen=True)
class AxisTaps:
    """The taps of one axis about their middle: y[n] = sum over k of taps[k] x[n + reach - k]."""

    taps: Float64s  # [N], N odd; the impulse response h of equation 4

    def __post_init__(self) -> None:
        object.__setattr__(self, "taps", frozen(np.array(self.taps, np.float64)))

    @property
    def reach(self) -> int:
        """The distance from a sample to the first one of its sum, and to the last."""
        return len(self.taps) // 2

    def check_fits(self, count: int, where: str) -> None:
        """`InvalidArgument` naming `where` if there are more taps than samples along the axis."""
        if len(self.taps) > count:
            found = f"{len(self.taps)} taps along an axis of {count} samples"
            mend = "Take a shorter kernel, or a finer or larger field."
            raise InvalidArgument(where, found, f"at most {count} taps", mend)


def reach_of(axes: Axes) -> tuple[int, int, int]:
    """The reach of each axis."""
    return (axes[0].reach, axes[1].reach, axes[2].reach)


def factors(kernel: Float64s) -> list[Float64s] | None:
    """One row of taps for each axis whose product is the kernel float64, N-D; None if there are none."""
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
    return rows if np.abs(product - kernel).max() <= 1e-12 * abs(top) else None


def filter_field(field: ForceField, axes: Axes) -> tuple[ForceField, bool]:
    """Filter a field brick by brick on the same grid; also return whether all sums were finite.

    Only bricks that a force reaches are computed; the bits do not depend on the number of threads. A sum that
    is not finite may lie outside the grid. No axis may have more taps than samples (`AxisTaps.check_fits`).
    """
    if not len(field.bricks):
        return field, True
    keys = keys_of_passes(field, axes)
    forces, tops = sums_of_bricks(field.grid, field.forces_n, axes, keys)
    result = brick_field(field.grid, bricks_of(field.grid, keys[3]), forces, tops != 0)
    return result, bool(np.isfinite(tops).all())


def keys_of_passes(field: ForceField, axes: Axes) -> list[Int64s]:
    """Return ascending keys of the field's bricks, and of those reached after the passes along x, y and z."""
    lattice = field.grid.brick_shape
    keys = [brick_keys(field.grid, field.bricks)]
    for axis in range(3):
        margin = -(-axes[axis].reach // BRICK)
        keys.append(spread_keys(keys[-1], lattice, axis, (margin, margin)))
    return keys


def sums_of_bricks(grid: Grid, forces_n: Float32s, axes: Axes, keys: list[Int64s]) -> Any:
    """Return the sums in the bricks ``keys[3]``, float32 [n, 8, 8, 8, 3], and the largest value of each.

    The largest absolute value is 0 for a brick without a force, and infinite or NaN where a sum overflowed
    float32. `forces_n` float32 [m, 8, 8, 8, 3] lie in ``keys[0]``; ``keys[1]`` and ``keys[2]`` are those of
    the intermediate passes.
    """
    from touchfield.filters.kernels import separable as kernels

    # indices from the first sample of a sum, weights, and count, of the taps that are not zero
    shape, counts = (3, max(len(a.taps) for a in axes)), np.zeros(3, np.int64)
    indices, weights = np.zeros(shape, np.int64), np.zeros(shape, np.float32)
    for axis, axis_taps in enumerate(axes):
        row = axis_taps.taps[::-1].astype(np.float32)
        nonzero = np.flatnonzero(row)
        counts[axis] = len(nonzero)
        indices[axis, : len(nonzero)], weights[axis, : len(nonzero)] = nonzero, row[nonzero]
    before, span = [tuple(n) for n in zip(*((a.reach, len(a.taps) - 1) for a in axes), strict=True)]
    count, (_, columns, depth) = len(keys[3]), grid.brick_shape
    require_memory("force field", f"{count} bricks", count * BYTES_PER_BRICK)
    out = np.empty((count, BRICK, BRICK, BRICK, 3), np.float32)  # the kernel sets every row
    tops, flat, masks = (
        np.zeros(count, np.uint32),
        frozen(forces_n).reshape(-1),
        np.empty(len(forces_n), np.uint64),
    )
    for_chunks(kernels.row_masks, len(masks), flat.view(np.uint64), masks, chunk=64)
    tile = min(depth, kernels.TILE)
    tiles, sizes = -(-depth // tile), (tile, -(-max(before[2], span[2] - before[2]) // BRICK))
    slabs = np.unique(keys[3] // (columns * depth) * tiles + keys[3] % depth // tile)
    batch_count = 4 * worker_count()  # the pieces of `for_chunks`; slabs are dealt out in turn for equal cost
    items = np.stack(
        np.divmod(np.concatenate([slabs[batch::batch_count] for batch in range(batch_count)]), tiles), axis=1
    )
    target, geometry = out.reshape(-1), (grid.brick_shape, before, span, sizes, (indices, weights, counts))
    arguments = items, (flat, masks), tuple(keys), *geometry, target, target.view(np.uint32), tops
    for_chunks(kernels.filter_bricks, len(items), *arguments)
    return out, tops.view(np.float32)


def brick_field(grid: Grid, bricks: Int32s, forces_n: Float32s, has_force: Bools) -> ForceField:
    """Build a field from computed bricks: clear samples beyond the grid, and drop empty bricks.

    `forces_n` float32 [n, 8, 8, 8, 3] and `has_force` bool [n], which bricks hold a force, are changed in
    place.
    """
    for axis, count in enumerate(grid.shape):
        rest = count % BRICK
        if rest:
            at_end = np.flatnonzero(bricks[:, axis] == count // BRICK)
            last = forces_n[at_end]
            np.moveaxis(last, axis + 1, 1)[:, rest:] = 0
            forces_n[at_end] = last
            has_force[at_end] &= last.any(axis=(1, 2, 3, 4))
    if not has_force.all():
        bricks, forces_n = bricks[has_force], forces_n[has_force]
    return ForceField(grid, bricks, forces_n)
