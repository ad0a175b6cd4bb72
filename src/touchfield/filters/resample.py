"""A force field on another lattice: anti-alias and resample, the middle of the mapping M (section 3.1).

One separable low-pass takes the field to any lattice with the same axes: smoothing at the same rate, decimation by a
whole number, or any other ratio and shift. Only output bricks that an input brick reaches are made. What lies beyond
the source's grid counts as zero (a source that should not fade at its border is to be sampled beyond the target's).

A kernel is a function of distance with a cut-off in cycles per metre. For each sample of the target lattice
it is sampled at the source's positions around it and scaled to unit sum, so that a constant passes unchanged
whatever the two spacings are. Departures from the paper: equation 4 is causal and would shift the field by
(N - 1)/2 samples, so the kernels here are centred; the T-shirt's cut-off 2/d is a choice of the caller.

Measured on the continuous kernels (f_c is the cut-off; overshoot is that of a step, in per cent of it):

======== ======== ======= ========= ========= ========= ==========
kernel   -3 dB at at f_c  at 1.5f_c at 2f_c   overshoot half width
======== ======== ======= ========= ========= ========= ==========
spline   0.71 f_c -6.0 dB -14.2 dB  -27.5 dB  0         0.64 / f_c
gaussian 0.71 f_c -6.0 dB -13.5 dB  -24.1 dB  0         0.75 / f_c
box      0.89 f_c -3.9 dB -10.5 dB  none left 0         0.25 / f_c
sinc     0.90 f_c -6.0 dB -54 dB    -78 dB    7.6       2.00 / f_c
======== ======== ======= ========= ========= ========= ==========

The default is the cubic B-spline. A field of forces jumps at a contact, and a kernel with negative lobes rings
there: 7.6 % of the contact force appears as a pull towards the surface outside it, and as much again is added
behind it. A kernel that is never negative gives a mean of the forces around: no force turns round, none
exceeds what was there, and the price is a blunter edge in frequency. Of the two such kernels with -6 dB at
the cut-off the spline is both narrower and steeper than the Gaussian.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

MAX_WEIGHTS: Final = 1 << 24
MAX_PAIRS: Final = 1 << 26
_BATCH: Final = 1 << 14
_SPLINE_KNOT: Final = 0.3189166986852232  # sinc(f T)^4 = 1/2 at f T = this
_GAUSSIAN_SIGMA: Final = math.sqrt(math.log(2) / 2) / math.pi  # exp(-2 (pi sigma f)^2) = 1/2 at f = 1
_SINC_HALF_WIDTH: Final = 2.0
_SINC_KAISER_BETA: Final = 5.0


@dataclass(frozen=True)
class LowPass:
    """A centred, symmetric kernel for the cut-off 1 cycle per unit of length.

    half_width : float; beyond this distance, in units of 1 / cut-off, the kernel is zero.
    shape : callable; ``shape(x, h)``: the weights, not yet normalised, at distances x of samples h apart, in the same
        unit.
    """

    name: str
    half_width: float
    shape: Callable[[Float64s, float], Float64s]


def _spline(x: Float64s, h: float) -> Float64s:
    a = np.abs(x) / _SPLINE_KNOT
    inner: Float64s = 2 / 3 - a * a + a**3 / 2
    outer: Float64s = np.maximum(2 - a, 0) ** 3 / 6
    return np.where(a < 1, inner, outer)


def _gaussian(x: Float64s, h: float) -> Float64s:
    weights: Float64s = np.exp(-0.5 * (x / _GAUSSIAN_SIGMA) ** 2)
    return weights


def _box(x: Float64s, h: float) -> Float64s:
    """The share of each sample's cell in the box, which is one cell of a lattice with that Nyquist rate."""
    overlap: Float64s = np.minimum(x + h / 2, 0.25) - np.maximum(x - h / 2, -0.25)
    return np.maximum(overlap, 0.0)


def _sinc(x: Float64s, h: float) -> Float64s:
    """Windowed by Kaiser."""
    inside = np.maximum(0.0, 1 - (x / _SINC_HALF_WIDTH) ** 2)
    weights: Float64s = np.sinc(2 * x) * np.i0(_SINC_KAISER_BETA * np.sqrt(inside)) * (inside > 0)
    return weights


LOW_PASSES: Final = {
    kernel.name: kernel
    for kernel in (
        LowPass("spline", 2 * _SPLINE_KNOT, _spline),
        LowPass("gaussian", 4 * _GAUSSIAN_SIGMA, _gaussian),
        LowPass("box", 0.25, _box),
        LowPass("sinc", _SINC_HALF_WIDTH, _sinc),
    )
}
"""The kernels by name; a new one is one more entry."""


def low_pass(name: str) -> LowPass:
    """The kernel of a name; `InvalidArgument` if there is none."""
    if name not in LOW_PASSES:
        raise InvalidArgument("low_pass", repr(name), f"one of {', '.join(LOW_PASSES)}")
    return LOW_PASSES[name]


@dataclass(frozen=True)
class AxisWeights:
    """The weights of source samples for each target sample of one axis.

    first : int64 [target]; index of the first source sample, which may lie beyond the source; ascending.
    weights : float32 [target, taps]; weights of that sample and those that follow; what lies beyond the source counts
        as zero.
    """

    first: NDArray[np.int64]
    weights: NDArray[np.float32]

    @property
    def taps(self) -> int:
        """Source samples to one target sample."""
        return int(self.weights.shape[1])

    def dense(self, source_count: int) -> Float64s:
        """The same as a matrix, float64 [target, source]."""
        matrix = np.zeros((len(self.first), source_count))
        columns = self.first[:, None] + np.arange(self.taps)
        rows = np.broadcast_to(np.arange(len(self.first))[:, None], columns.shape)
        held = (columns >= 0) & (columns < source_count)
        matrix[rows[held], columns[held]] = self.weights[held]
        return matrix


def axis_weights(
    source: tuple[int, float, float], target: tuple[int, float, float], kernel: LowPass, cutoff_per_m: float
) -> AxisWeights:
    """The weights that take one axis of a lattice to another through a low-pass.

    source, target : (int, float, float); samples, spacing in metres, and position of the first one in metres.
    cutoff_per_m : float; cycles per metre; a cut-off above the source's own Nyquist rate is taken down to it.
    Raises `InvalidArgument` if the cut-off is not positive, or so low for the source that the table would be too
    large.
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
        raise InvalidArgument(
            "low-pass", f"{taps:.3g} source samples to each of {target_count}", f"up to {MAX_WEIGHTS} weights",
            "Take a coarser source lattice, or resample in several steps.",
        )  # fmt: skip
    centre = (target_origin - origin) / spacing + np.arange(target_count) * (target_spacing / spacing)
    first = np.ceil(centre - radius).astype(np.int64)
    distance = first[:, None] + np.arange(math.floor(taps)) - centre[:, None]
    weights = kernel.shape(distance * step, step) * (np.abs(distance) <= radius)
    weights /= weights.sum(axis=1, keepdims=True)
    return AxisWeights(first, weights.astype(np.float32))


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
    kernel : str or LowPass; a name of `touchfield.filters.LOW_PASSES`, or a kernel.
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
