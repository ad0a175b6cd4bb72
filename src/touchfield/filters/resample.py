"""A force field on another lattice: anti-alias and resample, the middle of the mapping M (section 3.1).

One separable low-pass (`lowpass`) takes the field to any lattice with the same axes: smoothing at the same
rate, decimation by a whole number, or any other ratio and shift. Only output bricks that an input brick
reaches are made. What lies beyond the source's grid counts as zero (a source that should not fade at its
border is to be sampled beyond the target's).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.lowpass import AxisWeights, LowPass, axis_weights, low_pass
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["grid_weights", "nyquist_per_m", "resample"]

MAX_PAIRS: Final = 1 << 26
_BATCH: Final = 1 << 14

Weights = tuple[AxisWeights, AxisWeights, AxisWeights]


def nyquist_per_m(grid: Grid) -> tuple[float, float, float]:
    """The highest frequency that each axis of a lattice carries, 1/(2 spacing), cycles per metre."""
    x, y, z = grid.spacing_m
    return (0.5 / x, 0.5 / y, 0.5 / z)


def grid_weights(source: Grid, target: Grid, kernel: LowPass, cutoffs_per_m: tuple[float, float, float]) -> Weights:
    """The weights of the three axes from one lattice to another."""
    ends = [[(g.shape[a], g.spacing_m[a], g.origin_m[a]) for a in range(3)] for g in (source, target)]
    x, y, z = (axis_weights(ends[0][a], ends[1][a], kernel, cutoffs_per_m[a]) for a in range(3))
    return (x, y, z)


def resample(
    field: ForceField,
    grid: Grid,
    kernel: str | LowPass = "spline",
    cutoffs_per_m: tuple[float, float, float] | None = None,
) -> ForceField:
    """The field on another lattice, through a low-pass.

    grid : Grid; the target, with the same axes and in the same metres.
    kernel : str or LowPass; A name of `touchfield.filters.lowpass.LOW_PASSES`, or a kernel.
    cutoffs_per_m : (float, float, float), optional; cut-off along each axis, cycles per metre; the lower of the two
        Nyquist rates where none is given.
    Returns ForceField: On `grid`. A constant stays itself where the kernel lies within the source's grid. The result
    is linear in the field, and the same bit for bit for any number of threads.
    Raises `InvalidArgument` if the kernel or a cut-off is not possible, or the target is too fine for a field of that
    size.
    """
    chosen = low_pass(kernel) if isinstance(kernel, str) else kernel
    weights = grid_weights(field.grid, grid, chosen, cutoffs_per_m or nyquist_per_m(grid))
    keys = _reached_keys(field, grid, weights)
    if not len(keys):
        return ForceField.empty(grid)
    return _made(field, grid, weights, keys)


def _reached_keys(field: ForceField, grid: Grid, weights: Weights) -> NDArray[np.int64]:
    """Keys of the bricks of `grid` that the field may reach, ascending."""
    from touchfield.filters.kernels import resample as kernels

    reach: list[Any] = [_reach(weights[a], field.grid.brick_shape[a]) for a in range(3)]
    spans = [np.maximum(0, r[:, 1] - r[:, 0])[field.bricks[:, a]] for a, r in enumerate(reach)]
    pairs = float((spans[0].astype(np.float64) * spans[1] * spans[2]).sum())
    if pairs > MAX_PAIRS:
        raise InvalidArgument("grid", f"{pairs:.3g} bricks reached", f"up to {MAX_PAIRS}", "Take a coarser lattice.")
    return kernels.reached(field.bricks, (reach[0], reach[1], reach[2]), grid.brick_shape, int(pairs))


def _reach(weights: AxisWeights, source_bricks: int) -> NDArray[np.int64]:
    """For each source brick of one axis, the range of target bricks it may reach, int64 [source_bricks, 2]."""
    count = len(weights.first)
    last = np.minimum(np.arange(BRICK - 1, count + BRICK - 1, BRICK), count - 1)
    lowest = weights.first[::BRICK]
    highest = weights.first[last] + weights.taps - 1
    edges = np.arange(source_bricks, dtype=np.int64) * BRICK
    begin = np.searchsorted(highest, edges, side="left")
    end = np.searchsorted(lowest, edges + BRICK - 1, side="right")
    return np.stack([begin, end], axis=1).astype(np.int64)


def _made(field: ForceField, grid: Grid, weights: Weights, keys: NDArray[np.int64]) -> ForceField:
    """The bricks of these keys, in batches, so that what proves empty is never held all at once."""
    from touchfield.filters.kernels import resample as kernels

    bricks = np.stack(np.unravel_index(keys, grid.brick_shape), axis=1).astype(np.int32)
    own = brick_keys(field.grid, field.bricks)
    firsts = (weights[0].first, weights[1].first, weights[2].first)
    tables = (weights[0].weights, weights[1].weights, weights[2].weights)
    kept_bricks, kept_forces = [], []
    for begin in range(0, len(bricks), _BATCH):
        batch = bricks[begin : begin + _BATCH]
        forces, held = kernels.resampled(batch, field.grid.shape, own, field.forces_n, firsts, tables)
        kept_bricks.append(batch if held.all() else batch[held])
        kept_forces.append(forces if held.all() else forces[held])
    if len(kept_bricks) == 1:
        return ForceField(grid, kept_bricks[0], kept_forces[0])
    return ForceField(grid, np.concatenate(kept_bricks), np.concatenate(kept_forces))
