"""Resamples a force field to another lattice, either through a low-pass that prevents aliasing (the middle
step of the mapping M, paper section 3.1) or by trilinear interpolation.

One separable low-pass takes the field to any lattice with the same axes: smoothing at the same rate,
decimation by a whole number, or any other ratio and shift. Only output bricks that an input brick reaches are
computed. The force beyond the source's grid counts as zero (sample a source beyond the target's border if it
should not fade there).

A kernel is a function of distance with a cut-off in cycles per metre. For each sample of the target lattice
it is sampled at the source's positions around it and scaled to unit sum, so that a constant passes unchanged.
Departure from the paper: equation 4 is causal, the kernels here are centred. Measured on the continuous
kernels (f_c is the cut-off; overshoot in per cent of a step):

======== ======== ======= ========= ========= ========= ==========
kernel   -3 dB at at f_c  at 1.5f_c at 2f_c   overshoot half width
======== ======== ======= ========= ========= ========= ==========
spline   0.71 f_c -6.0 dB -14.2 dB  -27.5 dB  0         0.64 / f_c
box      0.89 f_c -3.9 dB -10.5 dB  none left 0         0.25 / f_c
sinc     0.90 f_c -6.0 dB -54 dB    -78 dB    7.6       2.00 / f_c
======== ======== ======= ========= ========= ========= ==========

The default is the cubic B-spline. A field of forces jumps at a contact, and a kernel with negative lobes
rings there. A kernel that is never negative gives a mean of the surrounding forces: no force is reversed or
exceeds the input's maximum. The price is a less steep frequency response.

Trilinear interpolation is what a receiver renders between samples; it has no low-pass.

Levels of detail (paper section 4): level 0 is the field; each next level keeps every second sample of the one
before along each axis, unchanged. A low-pass would spread the discontinuity of the force at a surface to the
samples around it (`bench/bench_detail.py`). A lattice twice as coarse can miss a wall that passes between its
samples. Therefore a sample without a force directly behind such a wall takes the mean of the wall's forces:
the wall stays closed, thicker behind and never in front.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.filters.region import RigidMotion
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.brick_buffer import BATCH_BRICKS, BrickBuffer
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import (
    brick_keys,
    bricks_of,
    bricks_reached,
    bricks_within,
    dilated,
    field_of_points,
    padded_blocks,
)
from touchfield.medium.grid import CORNERS, ON_A_SAMPLE
from touchfield.medium.samples import sample
from touchfield.medium.updates import FieldUpdate

MAX_WEIGHTS: Final = 1 << 24
_SPLINE_KNOT: Final = 0.3189166986852232  # sinc(f T)^4 = 1/2 at f T = this
_SINC_HALF_WIDTH: Final = 2.0
_SINC_KAISER_BETA: Final = 5.0


@dataclass(frozen=True)
class LowPass:
    """A centred, symmetric kernel for the cut-off 1 cycle per unit of length."""

    name: str
    half_width: float  # beyond this distance, in units of 1 / cut-off, the kernel is zero
    shape: Callable[
        [Float64s, float], Float64s
    ]  # (x, h): weights at distances x of samples h apart, in that unit


def _spline(x: Float64s, h: float) -> Float64s:
    a = np.abs(x) / _SPLINE_KNOT
    inner: Float64s = 2 / 3 - a * a + a**3 / 2
    outer: Float64s = np.maximum(2 - a, 0) ** 3 / 6
    return np.where(a < 1, inner, outer)


def _box(x: Float64s, h: float) -> Float64s:
    """The fraction of each sample's cell in the box, one cell of a lattice with that Nyquist rate."""
    overlap: Float64s = np.minimum(x + h / 2, 0.25) - np.maximum(x - h / 2, -0.25)
    return np.maximum(overlap, 0.0)


def _sinc(x: Float64s, h: float) -> Float64s:
    """A sinc with a Kaiser window."""
    inside = np.maximum(0.0, 1 - (x / _SINC_HALF_WIDTH) ** 2)
    return np.asarray(np.sinc(2 * x) * np.i0(_SINC_KAISER_BETA * np.sqrt(inside)) * (inside > 0))


LOW_PASSES: Final = {
    kernel.name: kernel
    for kernel in (
        LowPass("spline", 2 * _SPLINE_KNOT, _spline),
        LowPass("box", 0.25, _box),
        LowPass("sinc", _SINC_HALF_WIDTH, _sinc),
    )
}
"""The kernels by name."""


def low_pass(name: str) -> LowPass:
    """Return the kernel of a name; `InvalidArgument` if there is none."""
    require_one_of("low_pass", name, LOW_PASSES)
    return LOW_PASSES[name]


class AxisWeights(NamedTuple):
    """The weights of source samples for each target sample of one axis; zero beyond the source."""

    first: Int64s  # [target]; the first source sample, which may lie beyond the source; ascending
    weights: Float32s  # [target, taps]; of that sample and the following ones

    def dense(self, source_count: int) -> Float64s:
        """Return the weights as a matrix, float64 [target, source]."""
        matrix = np.zeros((len(self.first), source_count))
        columns = self.first[:, None] + np.arange(self.weights.shape[1])
        rows, taps = np.nonzero((columns >= 0) & (columns < source_count))
        matrix[rows, columns[rows, taps]] = self.weights[rows, taps]
        return matrix


def axis_weights(
    source: tuple[int, float, float], target: tuple[int, float, float], kernel: LowPass, cutoff_per_m: float
) -> AxisWeights:
    """Return the weights that resample one axis through a low-pass.

    source, target : (int, float, float); samples, spacing in metres, and position of the first one in metres.
    cutoff_per_m : float; cycles per metre; limited to the source's own Nyquist rate.
    Raises `InvalidArgument` if the cut-off is not positive, or so low for the source that the table would be
    too large.
    """
    source_count, spacing, origin = source
    target_count, target_spacing, target_origin = target
    if source_count == target_count == 1 and abs(target_origin - origin) <= 1e-9 * spacing:
        return AxisWeights(np.zeros(1, np.int64), np.ones((1, 1), np.float32))  # nothing to filter
    if not cutoff_per_m > 0:
        raise InvalidArgument("cutoff_per_m", repr(cutoff_per_m), "a positive number of cycles per metre")
    cutoff = min(cutoff_per_m, 0.5 / spacing)
    step = spacing * cutoff
    radius = (kernel.half_width / step) + (0.5 if kernel.name == "box" else 0.0)
    taps = 2 * radius + 1
    if not taps * target_count <= MAX_WEIGHTS:
        expected = f"up to {MAX_WEIGHTS} weights"
        mend = "Take a coarser source lattice, or resample in several steps."
        raise InvalidArgument(
            "low-pass", f"{taps:.3g} source samples to each of {target_count}", expected, mend
        )
    centre = (target_origin - origin) / spacing + np.arange(target_count) * (target_spacing / spacing)
    first = np.ceil(centre - radius).astype(np.int64)
    distance = first[:, None] + np.arange(math.floor(taps)) - centre[:, None]
    weights = kernel.shape(distance * step, step) * (np.abs(distance) <= radius)
    weights /= weights.sum(axis=1, keepdims=True)
    return AxisWeights(first, weights.astype(np.float32))


def grid_weights(source: Grid, target: Grid, kernel: LowPass) -> list[AxisWeights]:
    """Return the weights of the three axes from one lattice to another."""
    axes = [[(g.shape[a], g.spacing_m[a], g.origin_m[a]) for a in range(3)] for g in (source, target)]
    return [axis_weights(axes[0][a], axes[1][a], kernel, 0.5 / target.spacing_m[a]) for a in range(3)]


def resample(field: ForceField, grid: Grid, kernel: str = "spline") -> ForceField:
    """Resample a field through a low-pass that cuts off at the lower of the two Nyquist rates.

    grid : Grid; the target, with the same axes and in the same metres.
    kernel : str; a name of `touchfield.filters.LOW_PASSES`.
    Returns ForceField: On `grid`, linear in the field, the same bits for any number of threads.
    Raises `InvalidArgument` if there is no such kernel, or the target is too fine for a field of that size.
    """
    weights = grid_weights(field.grid, grid, low_pass(kernel))
    return _resample_to(_reached(field.grid, field.bricks, grid, weights), field, grid, weights)


def resample_update(update: FieldUpdate, grid: Grid, kernel: str = "spline") -> tuple[Int32s, ForceField]:
    """Resample a field where it differs from its base.

    Returns the bricks of `grid` that may differ from those of the resampled base, int32 [m, 3], and a field
    with these bricks, in the bits of ``resample(update.field, grid, kernel)``. Raises as `resample` does.
    """
    source = update.base.grid
    weights = grid_weights(source, grid, low_pass(kernel))
    bricks = _reached(source, update.bricks, grid, weights)
    spans = [_samples_of(axis_weight, count) for axis_weight, count in zip(weights, source.shape)]
    near = bricks_within(source, np.stack([row[bricks[:, a]] for a, row in enumerate(spans)], axis=1))
    return bricks, _resample_to(bricks, update.between(near), grid, weights)


def _reached(source: Grid, bricks: Int32s, grid: Grid, weights: Sequence[AxisWeights]) -> Int32s:
    """Return the bricks of `grid` that bricks of the source may reach, int32 [n, 3], ascending."""
    reach = [_reach(axis_weight, count) for axis_weight, count in zip(weights, source.brick_shape)]
    return bricks_within(grid, np.stack([row[bricks[:, a]] for a, row in enumerate(reach)], axis=1))


def _resample_to(bricks: Int32s, field: ForceField, grid: Grid, weights: Sequence[AxisWeights]) -> ForceField:
    """Resample a field to some bricks of `grid`, int32 [n, 3], ascending."""
    source = field.grid.shape, brick_keys(field.grid, field.bricks), field.forces_n
    buffer = BrickBuffer()
    for start in range(0, len(bricks), BATCH_BRICKS):
        batch = bricks[start : start + BATCH_BRICKS]
        buffer.append(batch, *_resample_bricks(batch, source, weights))
    return ForceField(grid, *buffer.take())


def _resample_bricks(
    bricks: Int32s, source: tuple[Any, Int64s, Float32s], weights: Sequence[AxisWeights]
) -> tuple[Float32s, Bools]:
    """Resample to output bricks int32 [n, 3]: float32 [n, 8, 8, 8, 3], and which have a force, bool [n].

    `source` is shape, keys and forces of the input.
    """
    out, has_force = zero_forces(len(bricks)), np.zeros(len(bricks), np.bool_)
    axes = tuple((np.ascontiguousarray(axis.first), np.ascontiguousarray(axis.weights)) for axis in weights)
    for_chunks(native.resample_bricks, len(bricks), bricks, source, axes, out, has_force, chunk=16)
    return out, has_force


def _reach(weights: AxisWeights, source_bricks: int) -> Int64s:
    """Return the range of target bricks that each source brick may reach, int64 [source_bricks, 2]."""
    count = len(weights.first)
    last = np.minimum(np.arange(BRICK - 1, count + BRICK - 1, BRICK), count - 1)
    lowest = weights.first[::BRICK]
    highest = weights.first[last] + weights.weights.shape[1] - 1
    edges = np.arange(source_bricks, dtype=np.int64) * BRICK
    start = np.searchsorted(highest, edges, side="left")
    stop = np.searchsorted(lowest, edges + BRICK - 1, side="right")
    return np.stack([start, stop], axis=1).astype(np.int64)


def _samples_of(weights: AxisWeights, source_count: int) -> Int64s:
    """Return the range of source bricks of which each target brick is made, int64 [target_bricks, 2]."""
    last = np.minimum(np.arange(BRICK - 1, len(weights.first) + BRICK - 1, BRICK), len(weights.first) - 1)
    stop = np.clip(weights.first[last] + weights.weights.shape[1], 0, source_count)
    start = np.clip(weights.first[::BRICK], 0, source_count)
    return np.stack([start // BRICK, -(-stop // BRICK)], axis=1).astype(np.int64)


BORDERS: Final = ("zero", "cell")


def interpolate(
    field: ForceField, grid: Grid, motion: RigidMotion | None = None, border: str = "zero"
) -> ForceField:
    """Interpolate a field trilinearly at the samples of another lattice.

    grid : Grid; the target, in the same metres.
    motion : RigidMotion, optional; applied to the field first.
    border : str; "zero": beyond the outermost samples the force falls to zero over one spacing, as
        `ForceField.sample_n` does. "cell": the outermost sample stands for all of its cell.
    Raises `InvalidArgument` if the border is unknown, or the target is too fine for a field of that size.
    """
    require_one_of("border", border, BORDERS)
    motion = None if motion == RigidMotion() else motion
    bricks = bricks_reached(field, grid, None if motion is None else motion.points_m)
    keys, last = brick_keys(field.grid, field.bricks), np.array(field.grid.shape) - 1.0

    def forces_n(points_m: Float64s) -> NDArray[Any]:
        index = field.grid.to_index(points_m if motion is None else motion.inverse.points_m(points_m))
        nearest = np.rint(index)
        index = np.where(np.abs(index - nearest) < ON_A_SAMPLE, nearest, index)
        if border == "cell":
            is_outside = ((index < -0.5 - ON_A_SAMPLE) | (index > last + 0.5 + ON_A_SAMPLE)).any(axis=-1)
            index = np.clip(index, 0.0, last)
            index[is_outside] = -2.0
        forces = sample(index, field.grid, keys, field.forces_n)
        return forces if motion is None else motion.vectors(forces)

    return field_of_points(grid, bricks, forces_n)


_OFFSETS: Final = tuple(o for o in product((-1, 0, 1), repeat=3) if any(o))
_MIN_WALL_NEIGHBOURS: Final = 3  # neighbours with a force, from which on they are a wall


def half_grid(grid: Grid) -> Grid:
    """Return the grid of every second sample of `grid` along each axis, starting with the first."""
    nx, ny, nz = (-(-n // 2) for n in grid.shape)
    x, y, z = (h * (1 + (n > 1)) for h, n in zip(grid.spacing_m, grid.shape, strict=True))
    return Grid((nx, ny, nz), (x, y, z), grid.origin_m)


def max_levels(grid: Grid) -> int:
    """Return the number of halvings of a grid until one sample is left."""
    return (max(grid.shape) - 1).bit_length()


def pyramid(field: ForceField, levels: int) -> tuple[ForceField, ...]:
    """Return the levels of detail of a field, the finest first.

    levels : int; the number of halvings, 0 to `max_levels`; each level has 1/8 of the samples of the one
        before.
    Raises `InvalidArgument` if the grid cannot be halved so often.
    """
    max_count = max_levels(field.grid)
    if isinstance(levels, bool) or not isinstance(levels, int) or not 0 <= levels <= max_count:
        raise InvalidArgument("levels", repr(levels), f"0 to {max_count} for {field.grid.shape} samples")
    fields = [field]
    for _ in range(levels):
        last, grid = fields[-1], half_grid(fields[-1].grid)
        # a kept sample looks one sample back, into the brick before
        candidates = np.concatenate([last.bricks + corner for corner in CORNERS])
        candidates = candidates[(candidates < last.grid.brick_shape).all(axis=1)]
        bricks = bricks_of(last.grid, np.unique(brick_keys(last.grid, candidates)))
        home, quarter = np.divmod(bricks, 2)
        coarse, slot = np.unique(brick_keys(grid, home), return_inverse=True)
        forces = np.zeros((len(coarse), 2, 4, 2, 4, 2, 4, 3), np.float32)
        for span, wide in padded_blocks(last, last.forces_n, bricks, (2, 2, 2), (1, 1, 1)):
            (x, y, z), at = quarter[span].T, slot.reshape(-1)[span]
            forces[at, x, :, y, :, z] = _next_level(wide, np.asarray(last.grid.spacing_m, np.float32))
        fields.append(
            ForceField.from_bricks(grid, bricks_of(grid, coarse), forces.reshape(-1, *[BRICK] * 3, 3))
        )
    return tuple(fields)


def _next_level(wide: NDArray[Any], spacing: Float32s) -> Float32s:
    """Return the next level [n, 4, 4, 4, 3] of bricks with two samples before and one after [n, 11, ..]."""
    has_force: Bools = np.asarray(wide.any(axis=-1))

    def at(values: NDArray[Any], offset: tuple[int, ...]) -> NDArray[Any]:
        x, y, z = (slice(2 + o, 9 + o, 2) for o in offset)
        return values[:, x, y, z]

    samples, is_supported = at(wide, (0, 0, 0)).copy(), at(has_force, (0, 0, 0))
    total, count = np.zeros(samples.shape), np.zeros(is_supported.shape, np.int32)
    for offset in _OFFSETS:
        force, has_force_behind = (
            at(wide, offset),
            at(has_force, (2 * offset[0], 2 * offset[1], 2 * offset[2])),
        )
        # on a wall before this sample: the force points away from it, and the kept sample beyond the wall has
        # none
        is_wall = ~has_force_behind & ((force * (spacing * np.array(offset, np.float32))).sum(axis=-1) > 0)
        total += np.where(is_wall[..., None], force, 0.0)
        count += is_wall
    is_closed = ~is_supported & (count >= _MIN_WALL_NEIGHBOURS)
    samples[is_closed] = total[is_closed] / count[is_closed][:, None]
    return samples


def rebuild_level(level: ForceField, grid: Grid) -> ForceField:
    """Interpolate a level of detail trilinearly at a finer grid, as a receiver renders it."""
    if level.grid == half_grid(grid) and all(n > 1 for n in grid.shape):
        return _doubled(level, grid)
    return interpolate(level, grid, border="cell")


def _doubled(level: ForceField, grid: Grid) -> ForceField:
    """Interpolate at the next finer grid: along each axis a sample, or the mean of two.

    The outermost sample is repeated beyond the border.
    """
    bricks = dilated(level.grid, level.bricks, (1, 1, 1))
    parts = [np.empty((0, 8, BRICK, BRICK, BRICK, 3), np.float32)]
    for span, wide in padded_blocks(level, level.forces_n, bricks, (0, 0, 0), (1, 1, 1)):
        for axis in range(3):
            along_axis = np.moveaxis(wide, axis + 1, 1)  # a view, to be filled beyond the border
            last = level.grid.shape[axis] - 1 - BRICK * bricks[span, axis]
            at_end = np.flatnonzero(last < BRICK)
            along_axis[at_end, last[at_end] + 1] = along_axis[at_end, last[at_end]]
            fine = np.empty((len(along_axis), 2 * BRICK, *along_axis.shape[2:]), np.float32)
            fine[:, 0::2] = along_axis[:, :-1]
            fine[:, 1::2] = np.float32(0.5) * (along_axis[:, :-1] + along_axis[:, 1:])
            wide = np.moveaxis(fine, 1, axis + 1)
        cut = wide.reshape(-1, 2, BRICK, 2, BRICK, 2, BRICK, 3).transpose(0, 1, 3, 5, 2, 4, 6, 7)
        parts.append(cut.reshape(-1, 8, BRICK, BRICK, BRICK, 3))
    fine_bricks = (2 * bricks[:, None] + np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1)).reshape(
        -1, 3
    )
    inside = (fine_bricks < np.array(grid.brick_shape)).all(axis=1)
    forces = np.concatenate(parts).reshape(-1, BRICK, BRICK, BRICK, 3)[inside]
    return ForceField.from_bricks(grid, fine_bricks[inside], forces)
