"""Lifting on a chain of sublattices: a medium at half, a quarter, an eighth of its samples and what is missing.

Paper section 3.2 asks for multiresolution and gives no filter; this is the shortest lifting (after Sweldens) on the
lattices of `touchfield.filters.sublattices`. A stage first predicts each site that is dropped from the mean of its k
nearest kept ones and leaves the difference there, the detail; then it adds to each kept site 1/(2k) of the sum of the
details around it, which keeps the mean of the field. Every number stays at its site. Each of the two steps is undone
by the same step with the other sign, whatever the shape of the array: perfect reconstruction needs nothing else. With
whole numbers the mean and the share are rounded (floor of the value plus 1/2), and the same bits come back.

At the border a neighbour that is missing is replaced by its mirror image about the site; along an axis with one site
there are no neighbours, and the mean is over the others. An array of one row is thus lifted in one dimension.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.sublattices import Chain, Site, Split, whole_stages
from touchfield.medium.field import frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["LatticeSamples", "coarse_only", "coarse_samples", "forward", "inverse", "sites_of", "stage_mean_squares"]


_HEADROOM = 2.0**-16
"""Of the range of a float: sums of neighbours, stage after stage, stay finite."""


@dataclass(frozen=True)
class LatticeSamples:
    """Values at the sites of a sublattice, in raster order.

    positions : int64 [m, dimensions]; indices into the array.
    values : [m, ...]; with the components of the array.
    """

    positions: NDArray[np.int64]
    values: NDArray[Any]


def forward(array: ArrayLike, chain: Chain, stages: int, name: str = "array") -> NDArray[Any]:
    """The coefficients of an array: the coarse signal and the details, each at its own site.

    array : [n1, ..., nd] or [n1, ..., nd, ...]; any real type, any shape without an empty axis; axes beyond those of
        the chain are components.
    stages : int; 0 to 60.
    name : str; what an error calls the array.
    Returns float32, float64, int32 or int64 of the same shape: Whole numbers of up to 16 bits become int32, wider
    ones int64, because details take a bit more; float16 becomes float32. int64 sums beyond 2^63 wrap round, which the
    inverse undoes.
    Raises `InvalidArgument` if `array` has too few axes, an empty one, or a number that is not real, finite and below
    2^-16 of the range of its type; or if `stages` is out of range.
    """
    made = _checked(array, chain, name)
    _analyse(made, chain, chain.splits(whole_stages(stages)))
    return made


def inverse(
    coefficients: ArrayLike, chain: Chain, stages: int, dtype: Any = None, name: str = "coefficients"
) -> NDArray[Any]:
    """The array of which these are the coefficients: the same bits for whole numbers, else to rounding.

    coefficients : [n1, ..., nd, ...]; as `forward` gave them.
    stages : int; as given to `forward`.
    dtype : optional; the type to return, such as the one that `forward` was given; the working type by default.
    name : str; what an error calls the array.
    Raises `InvalidArgument` as `forward`.
    """
    made = _checked(coefficients, chain, name)
    for split in reversed(chain.splits(whole_stages(stages))):
        _lift(made, split, chain, "update", -1)
        _lift(made, split, chain, "predict", 1)
    return made if dtype is None else made.astype(dtype, copy=False)


def coarse_only(array: ArrayLike, chain: Chain, stages: int, name: str = "array") -> NDArray[Any]:
    """The array rebuilt from its coarse signal, every detail being zero: a level of detail.

    Parameters and errors are those of `forward`; a constant passes unchanged, to rounding.
    """
    made = _checked(array, chain, name)
    splits = chain.splits(whole_stages(stages))
    _analyse(made, chain, splits)
    for split in splits:
        for residue in split.details:
            made[split.slices(residue)] = 0
    for split in reversed(splits):
        _lift(made, split, chain, "predict", 1)  # the update would subtract zeros
    return made


def coarse_samples(coefficients: ArrayLike, chain: Chain, stages: int) -> LatticeSamples:
    """The coarse signal alone: its sites and values.

    coefficients : [n1, ..., nd, ...]; as `forward` gave them for as many stages.
    stages : int; 0 to 60.
    Raises `InvalidArgument` as `forward`.
    """
    values = _checked(coefficients, chain, "coefficients")
    shape = values.shape[: chain.dimensions]
    held = np.ones(shape, np.bool_)
    for split in chain.splits(whole_stages(stages))[-1:]:
        held = split.mask(shape, split.kept)
    return LatticeSamples(frozen(np.argwhere(held)), frozen(values[held]))


def stage_mean_squares(coefficients: ArrayLike, chain: Chain, stages: int) -> NDArray[np.float64]:
    """How strong each stage is: the mean square of its details, and last that of the coarse signal.

    coefficients : [n1, ..., nd, ...]; as `forward` gave them for as many stages. Components are summed: with a force,
        the unit is N^2.
    stages : int; 0 to 60.
    Returns float64 [stages + 1]: 0 for a stage that has no sites in so small an array. The transform is not
    orthogonal: these tell which stage matters, and do not add up to the mean square of the array.
    Raises `InvalidArgument` as `forward`.
    """
    values = _checked(coefficients, chain, "coefficients")
    found = [_mean_square(values, split, split.details) for split in chain.splits(whole_stages(stages))]
    found += [_mean_square(values, s, s.kept) for s in chain.splits(stages)[-1:]]
    if not stages:
        found = [float(np.square(values, dtype=np.float64).sum()) / math.prod(values.shape[: chain.dimensions])]
    return np.array(found)


def _mean_square(values: NDArray[Any], split: Split, residues: tuple[Site, ...]) -> float:
    parts = [values[split.slices(residue)] for residue in residues]
    count = sum(math.prod(p.shape[: len(residues[0])]) for p in parts)
    return float(sum(np.square(p, dtype=np.float64).sum() for p in parts)) / max(count, 1)


def _analyse(made: NDArray[Any], chain: Chain, splits: list[Split]) -> None:
    for split in splits:
        _lift(made, split, chain, "predict", -1)
        _lift(made, split, chain, "update", 1)


def _checked(array: ArrayLike, chain: Chain, name: str) -> NDArray[Any]:
    """A copy in the working type."""
    given = np.asarray(array)
    axes = chain.dimensions
    if given.ndim < axes or given.size == 0:
        raise InvalidArgument(name, f"shape {given.shape}", f"{axes} axes or more, none of them empty")
    kind, size = given.dtype.kind, given.dtype.itemsize
    if kind == "f" and size <= 8:
        working = np.float32 if size <= 4 else np.float64
        largest = float(np.finfo(working).max) * _HEADROOM
        low, high = float(given.min()), float(given.max())
        if not (low >= -largest and high <= largest):  # so also where one is NaN
            raise InvalidArgument(name, f"numbers from {low} to {high}", f"finite numbers up to {largest:.2g}")
        return np.array(given, working, order="C")
    if kind in "iub":
        return np.array(given, np.int32 if size <= 2 else np.int64, order="C")
    raise InvalidArgument(name, f"type {given.dtype}", "whole numbers, or floats of up to 64 bits")


def _lift(made: NDArray[Any], split: Split, chain: Chain, kind: str, sign: int) -> None:
    """One step in place: `sign` is that of the mean that is added to each site of the kind."""
    from touchfield.filters.kernels import lifting as kernels

    shape = made.shape[: chain.dimensions]
    sites, divisor = sites_of(split, shape, kind)
    if divisor:
        n0, n1, n2 = (*shape[:1], 1, *shape[1:]) if len(shape) == 2 else shape
        width = math.prod(made.shape[len(shape) :])
        kernels.step(made.reshape(n0, n1, n2 * width), width, split.scale, sites, (sign, divisor))


def sites_of(
    split: Split, shape: tuple[int, ...], kind: str
) -> tuple[tuple[NDArray[np.int64], NDArray[np.int64]], int]:
    """The tables of one step, "predict" or "update", as the kernels take them, and the divisor of its sums.

    The divisor is 0 where an array of this shape has but one site left.
    """
    residues = split.details if kind == "predict" else split.kept
    starts = np.full((2, 2), -1, np.int64)
    for residue in residues:
        first, second, third = _in_space(residue)
        starts[first, second] = third
    offsets = split.offsets_in(shape)
    around = np.array([_in_space(o) for o in offsets], np.int64).reshape(-1, 3)
    return (starts, around), len(offsets) * (1 if kind == "predict" else 2)


def _in_space(site: Site) -> tuple[int, int, int]:
    """A site of the plane as one of space, its second axis last, where an array is contiguous."""
    return (site[0], 0, site[1]) if len(site) == 2 else (site[0], site[1], site[2])
