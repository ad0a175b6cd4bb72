"""Lifting on a chain of sublattices: a medium at half, a quarter, an eighth of its samples and what is missing.

Paper section 3.2 asks for "optimal quincunx sampling and filtering" and gives no filter; this is the shortest lifting
(after Sweldens). A stage keeps every second site of the lattice before it. It first predicts each site that is
dropped from the mean of its k nearest kept ones and leaves the difference there, the detail; then it adds to each
kept site 1/(2k) of the sum of the details around it, which keeps the mean of the field. Every number stays at its
site. Each of the two steps is undone by the same step with the other sign, whatever the shape of the array: perfect
reconstruction needs nothing else. With whole numbers the mean and the share are rounded (floor of the value plus
1/2), and the same bits come back. At the border a neighbour that is missing is replaced by its mirror image about the
site; along an axis with one site there are no neighbours, and the mean is over the others. An array of one row is
thus lifted in one dimension.

The lattices. In two dimensions the quincunx of D = [[1, 1], [1, -1]] keeps n1 + n2 even (four neighbours), and the
next stage, along the diagonals, both even: two stages an octave. In three (x-y-z, or x-y-t with t on the third axis)
the face-centred cubic lattice (FCC) keeps n1 + n2 + n3 even (six neighbours); the second stage n1 + n2 even and n3
even (eight), the third all even (four): an octave, densities 1/2, 1/4 and 1/8. Between the FCC and 2Z^3 there is no
body-centred lattice to keep: the one of that density, however it is turned, has sites at the square distance 3, and
those of the FCC lie at even ones. Of the lattices that do lie between them, all alike but for the axis, we take the
one of the third, which for x-y-t is a quincunx picture in every second frame.

In frequency. Dropping half of the samples takes the spectrum to 1/2 [X(w) + X(w + (pi, pi))]. What lies in the
diamond |w1| + |w2| <= pi can be told from its image: a pattern along an axis passes up to the full Nyquist rate pi,
where decimation by 2 along each axis ends at pi/2 and folds it to a slow one; a diagonal pattern passes up to pi/2
along each axis, as there. In space it is the truncated octahedron |w1| + |w2| + |w3| <= 3 pi / 2 within the cube,
half of its volume. The predictor is the shortest filter for that cell, and far from steep: with P the mean of the
cosines of w it is 2 H0, H0 = 1/2 + P/2, halfband (H0(w) + H0(w + (pi, pi)) = 1); the coarse signal is seen through 1
+ P/2 - P^2/2, which is 1 both at w = 0 and on the edge of the diamond, and 0 at (pi, pi).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.field import frozen

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

Site = tuple[int, ...]

MAX_STAGES: Final = 60
"""Far beyond the point where one site is left of any array; a stage without sites to drop does nothing."""


@dataclass(frozen=True)
class Split:
    """One stage: which sites of a lattice stay, which become details, and who is whose neighbour.

    scale : int; sites of the stage lie at multiples of this, in samples.
    kept, details : tuple of sites; residues modulo 2 of the coordinates in units of `scale`.
    offsets : tuple of sites; from any site to its nearest ones of the other kind, in units of `scale`; closed under a
        change of sign along any axis, so that a neighbour beyond the border has a mirror image.
    """

    scale: int
    kept: tuple[Site, ...]
    details: tuple[Site, ...]
    offsets: tuple[Site, ...]

    def slices(self, residue: Site) -> tuple[slice, ...]:
        """The sites of one residue as slices of an array."""
        return tuple(slice(r * self.scale, None, 2 * self.scale) for r in residue)

    def offsets_in(self, shape: tuple[int, ...]) -> tuple[Site, ...]:
        """The offsets that an array has room for: an axis with a single site has no neighbours along it."""
        return tuple(o for o in self.offsets if all(n > self.scale for n, d in zip(shape, o, strict=True) if d))

    def mask(self, shape: tuple[int, ...], residues: tuple[Site, ...]) -> NDArray[np.bool_]:
        """Where the sites of some residues lie, bool [shape]."""
        held = np.zeros(shape, np.bool_)
        for residue in residues:
            held[self.slices(residue)] = True
        return held


def _signed(*places: Site) -> tuple[Site, ...]:
    """Each place with every choice of signs of its non-zero coordinates."""
    return tuple(sorted(o for p in places for o in product(*((-d, d) if d else (0,) for d in p))))


@dataclass(frozen=True)
class Chain:
    """Lattices within lattices: the splits of one octave, repeated at twice the scale for the next.

    octave : tuple of Split; at scale 1; the last leaves the sites whose coordinates are all even.
    """

    name: str
    octave: tuple[Split, ...]

    @property
    def dimensions(self) -> int:
        """Axes of the lattice, as many as there are stages in an octave."""
        return len(self.octave)

    def splits(self, stages: int) -> list[Split]:
        """The first `stages` splits, finest first."""
        count = len(self.octave)
        found = [self.octave[n % count] for n in range(stages)]
        return [Split(2 ** (n // count), s.kept, s.details, s.offsets) for n, s in enumerate(found)]


QUINCUNX: Final = Chain(
    "quincunx",
    (
        Split(1, ((0, 0), (1, 1)), ((0, 1), (1, 0)), _signed((1, 0), (0, 1))),
        Split(1, ((0, 0),), ((1, 1),), _signed((1, 1))),
    ),
)

FCC: Final = Chain(
    "fcc",
    (
        Split(
            1,
            ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 0)),
            ((0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 1)),
            _signed((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ),
        Split(1, ((0, 0, 0), (1, 1, 0)), ((0, 1, 1), (1, 0, 1)), _signed((1, 0, 1), (0, 1, 1))),
        Split(1, ((0, 0, 0),), ((1, 1, 0),), _signed((1, 1, 0))),
    ),
)

CHAINS: Final = {2: QUINCUNX, 3: FCC}
"""The chain of each number of dimensions."""


def whole_stages(stages: object, least: int = 0, most: int = MAX_STAGES) -> int:
    """`stages` as a number of stages.

    Raises `InvalidArgument` if it is not a whole number from `least` to `most`.
    """
    if isinstance(stages, bool) or not isinstance(stages, (int, np.integer)) or not least <= stages <= most:
        raise InvalidArgument("stages", repr(stages), f"a whole number from {least} to {most}")
    return int(stages)


def coarse_mask(shape: tuple[int, ...], stages: int) -> NDArray[np.bool_]:
    """The sites that hold the coarse signal after some stages.

    shape : (int, int) or (int, int, int); samples along the axes of the lattice, without components: two for the
        quincunx, three for the FCC.
    stages : int; 0 (all sites) to 60; each stage keeps half of the sites.
    Returns bool [shape].
    Raises `InvalidArgument` if the shape is not of two or three positive counts, or `stages` is out of range.
    """
    if len(shape) not in CHAINS or math.prod(shape) == 0 or min(shape) < 0:
        raise InvalidArgument("shape", repr(shape), "two or three positive counts of samples")
    if whole_stages(stages) == 0:
        return np.ones(shape, np.bool_)
    last = CHAINS[len(shape)].splits(stages)[-1]
    return last.mask(tuple(shape), last.kept)


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
    """The strength of each stage: the mean square of its details, and last that of the coarse signal.

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
    """One step in place, "predict" or "update": `sign` is that of the mean that is added to each site of the kind.

    A step changes sites of one kind by what their neighbours of the other kind hold: it reads nothing that it writes.
    """
    offsets = split.offsets_in(made.shape[: chain.dimensions])
    if not offsets:
        return
    divisor = len(offsets) * (1 if kind == "predict" else 2)
    sites = made[(slice(None, None, split.scale),) * chain.dimensions]
    # a neighbour beyond the border is its mirror image about the site
    room = [int(n > 1) for n in sites.shape[: chain.dimensions]]
    wide = np.pad(sites, [(r, r) for r in room] + [(0, 0)] * (made.ndim - len(room)), mode="reflect")
    for residue in split.details if kind == "predict" else split.kept:
        here = sites[tuple(slice(r, None, 2) for r in residue)]
        if not here.size:
            continue
        total = np.zeros_like(here)
        for offset in offsets:
            first = [p + r + d for p, r, d in zip(room, residue, offset, strict=True)]
            total += wide[tuple(slice(f, f + 2 * n - 1, 2) for f, n in zip(first, here.shape))]
        if made.dtype.kind == "f":
            here += made.dtype.type(sign / divisor) * total
        else:
            here += sign * ((total + divisor // 2) // divisor)


def quincunx_forward(image: ArrayLike, stages: int) -> NDArray[Any]:
    """The quincunx coefficients of an image [n1, n2, ...], each at its site; see `forward`."""
    return forward(image, QUINCUNX, stages, "image")


def quincunx_inverse(coefficients: ArrayLike, stages: int, dtype: Any = None) -> NDArray[Any]:
    """The image of quincunx coefficients; bit-exact for whole numbers. See `inverse`."""
    return inverse(coefficients, QUINCUNX, stages, dtype)


def quincunx_coarse(coefficients: ArrayLike, stages: int) -> LatticeSamples:
    """The coarse signal of quincunx coefficients with its positions [m, 2]; see `coarse_samples`."""
    return coarse_samples(coefficients, QUINCUNX, stages)


def fcc_forward(volume: ArrayLike, stages: int) -> NDArray[Any]:
    """The FCC coefficients of a volume [n1, n2, n3, ...], each at its site; see `forward`."""
    return forward(volume, FCC, stages, "volume")


def fcc_inverse(coefficients: ArrayLike, stages: int, dtype: Any = None) -> NDArray[Any]:
    """The volume of FCC coefficients; bit-exact for whole numbers. See `inverse`."""
    return inverse(coefficients, FCC, stages, dtype)


def fcc_coarse(coefficients: ArrayLike, stages: int) -> LatticeSamples:
    """The coarse signal of FCC coefficients with its positions [m, 3]; see `coarse_samples`."""
    return coarse_samples(coefficients, FCC, stages)


def stage_responses(*omegas: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The filters of the first stage of either chain at frequencies in radians a sample, as of the whole array.

    Returns two float64 [...]: the analysis, 1 + P/2 - P^2/2, before the sites are dropped; the synthesis, 1 + P.
    """
    p = np.asarray(sum(np.cos(np.asarray(w, np.float64)) for w in omegas) / len(omegas))
    return np.asarray(1 + p / 2 - p * p / 2), np.asarray(1 + p)


def stage_passband(*omegas: ArrayLike) -> NDArray[np.bool_]:
    """Test frequencies (radians a sample, any real): do they lie in the cell that one stage of either chain keeps?"""
    folded = [np.abs((np.asarray(w, np.float64) + np.pi) % (2 * np.pi) - np.pi) for w in omegas]
    return np.asarray(sum(folded) <= len(omegas) * np.pi / 2)
