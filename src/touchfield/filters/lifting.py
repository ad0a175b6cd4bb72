"""Lifting on a chain of sublattices (paper section 3.2).

Paper section 3.2 asks for "optimal quincunx sampling and filtering" and gives no filter; this is the shortest
lifting (after Sweldens). A stage keeps every second site of the lattice before it. It first predicts each
site that is dropped from the mean of its k nearest kept ones and leaves the difference there, the detail;
then it adds to each kept site 1/(2k) of the sum of the details around it, which keeps the mean of the field.
Each of the two steps is undone by the same step with the other sign: perfect reconstruction needs nothing
else. With whole numbers the mean and the share are rounded (floor of the value plus 1/2), and the same bits
come back. A neighbour beyond the border is its mirror image about the site; along an axis with one site there
are none, and the mean is over the others.

In two dimensions the quincunx of D = [[1, 1], [1, -1]] keeps n1 + n2 even (four neighbours), and the next
stage, along the diagonals, both even: two stages an octave. In three (x-y-z, or x-y-t with t on the third
axis) the face-centred cubic lattice (FCC) keeps n1 + n2 + n3 even (six neighbours); the second stage n1 + n2
even and n3 even (eight), the third all even (four). There is no body-centred lattice within the FCC to keep;
of those that lie between it and 2Z^3 we take the one which for x-y-t is a quincunx picture in every second
frame.

What lies in the diamond |w1| + |w2| <= pi, or the octahedron |w1| + |w2| + |w3| <= 3 pi / 2, can be told from
its image: a pattern along an axis passes up to the full Nyquist rate. With P the mean of the cosines of w the
coarse signal is seen through 1 + P/2 - P^2/2, which is far from steep.

The multiresolution filter takes a field down the FCC chain, puts its details to zero and rebuilds it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.errors import InvalidArgument
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import require_memory

Site = tuple[int, ...]

MAX_STAGES: Final = (
    60  # one site is left of any array long before; a stage without sites to drop does nothing
)
_MAX_FILTER_STAGES: Final = 12  # four octaves
_DENSE_BYTES: Final = (
    60  # of a sample: a field, its coefficients, those of the level, and two of what is on its way
)
_HEADROOM: Final = 2.0**-16  # of the range of a float: sums of neighbours, stage after stage, stay finite


@dataclass(frozen=True)
class Split:
    """One stage: which sites of a lattice stay, which become details, and who is whose neighbour.

    Offsets are closed under a change of sign, so that a neighbour beyond the border has a mirror image.
    """

    scale: int  # sites of the stage lie at multiples of this, in samples
    kept: tuple[Site, ...]  # residues modulo 2 of the coordinates in units of `scale`
    details: tuple[Site, ...]
    offsets: tuple[Site, ...]  # from any site to its nearest ones of the other kind

    def offsets_in(self, shape: tuple[int, ...]) -> tuple[Site, ...]:
        """The offsets that an array has room for: an axis with a single site has no neighbours along it."""
        return tuple(
            o for o in self.offsets if all(n > self.scale for n, d in zip(shape, o, strict=True) if d)
        )


def _signed(*places: Site) -> tuple[Site, ...]:
    """Each place with every choice of signs of its non-zero coordinates."""
    return tuple(sorted(o for p in places for o in product(*((-d, d) if d else (0,) for d in p))))


@dataclass(frozen=True)
class Chain:
    """Lattices within lattices: the splits of one octave, from scale 1, repeated at twice the scale for the
    next.
    """

    name: str
    what: str  # an array of as many axes
    octave: tuple[Split, ...]

    @property
    def dimensions(self) -> int:
        """Axes of the lattice, as many as there are stages in an octave."""
        return len(self.octave)

    def splits(self, stages: int) -> list[Split]:
        """The first `stages` splits, finest first."""
        places = [divmod(n, len(self.octave)) for n in range(stages)]
        return [replace(self.octave[stage], scale=2**octave) for octave, stage in places]

    def forward(self, array: ArrayLike, stages: int) -> NDArray[Any]:
        """The coefficients of an array: the coarse signal and the details, each at its own site.

        array : [n1, ..., nd] or [n1, ..., nd, ...]; any real type, any shape without an empty axis; axes
            beyond those of the chain are components.
        stages : int; 0 to 60.
        Returns float32, float64, int32 or int64 of the same shape: Whole numbers of up to 16 bits become
        int32, wider ones int64, because details take a bit more. int64 sums beyond 2^63 wrap round, which the
        inverse undoes. Raises `InvalidArgument` if `array` has too few axes, an empty one, or a number that
        is not real, finite and below 2^-16 of the range of its type; or if `stages` is out of range.
        """
        values = _checked(array, self, self.what)
        for split in self.splits(whole_stages(stages)):
            _lift(values, split, self, "predict", -1)
            _lift(values, split, self, "update", 1)
        return values

    def inverse(self, coefficients: ArrayLike, stages: int) -> NDArray[Any]:
        """The array whose coefficients `forward` gave for as many stages: bit-exact for whole numbers.

        It is of the working type. Raises `InvalidArgument` as `forward`.
        """
        values = _checked(coefficients, self, "coefficients")
        for split in reversed(self.splits(whole_stages(stages))):
            _lift(values, split, self, "update", -1)
            _lift(values, split, self, "predict", 1)
        return values


def whole_stages(stages: object, least: int = 0, most: int = MAX_STAGES) -> int:
    """A number of stages; `InvalidArgument` if it is not a whole number from `least` to `most`."""
    if isinstance(stages, bool) or not isinstance(stages, (int, np.integer)) or not least <= stages <= most:
        raise InvalidArgument("stages", repr(stages), f"a whole number from {least} to {most}")
    return int(stages)


def _checked(array: ArrayLike, chain: Chain, name: str) -> NDArray[Any]:
    """A copy in the working type."""
    numbers = np.asarray(array)
    axes = chain.dimensions
    if numbers.ndim < axes or numbers.size == 0:
        raise InvalidArgument(name, f"shape {numbers.shape}", f"{axes} axes or more, none of them empty")
    kind, size = numbers.dtype.kind, numbers.dtype.itemsize
    if kind == "f" and size <= 8:
        working = np.float32 if size <= 4 else np.float64
        largest = float(np.finfo(working).max) * _HEADROOM
        low, high = float(numbers.min()), float(numbers.max())
        if not (low >= -largest and high <= largest):  # so also where one is NaN
            raise InvalidArgument(
                name, f"numbers from {low} to {high}", f"finite numbers up to {largest:.2g}"
            )
        return np.array(numbers, working, order="C")
    if kind in "iub":
        return np.array(numbers, np.int32 if size <= 2 else np.int64, order="C")
    raise InvalidArgument(name, f"type {numbers.dtype}", "whole numbers, or floats of up to 64 bits")


def _lift(values: NDArray[Any], split: Split, chain: Chain, kind: str, sign: int) -> None:
    """One step in place, "predict" or "update": `sign` is that of the mean that is added to each site of the
    kind.

    A step changes sites of one kind by what their neighbours of the other kind hold: it reads nothing that it
    writes.
    """
    offsets = split.offsets_in(values.shape[: chain.dimensions])
    if not offsets:
        return
    divisor = len(offsets) * (1 if kind == "predict" else 2)
    sites = values[(slice(None, None, split.scale),) * chain.dimensions]
    # a neighbour beyond the border is its mirror image about the site
    room = [int(n > 1) for n in sites.shape[: chain.dimensions]]
    wide = np.pad(sites, [(r, r) for r in room] + [(0, 0)] * (values.ndim - len(room)), mode="reflect")
    for residue in split.details if kind == "predict" else split.kept:
        here = sites[tuple(slice(r, None, 2) for r in residue)]
        if not here.size:
            continue
        total = np.zeros_like(here)
        for offset in offsets:
            first = [p + r + d for p, r, d in zip(room, residue, offset, strict=True)]
            total += wide[tuple(slice(f, f + 2 * n - 1, 2) for f, n in zip(first, here.shape))]
        if values.dtype.kind == "f":
            here += values.dtype.type(sign / divisor) * total
        else:
            here += sign * ((total + divisor // 2) // divisor)


QUINCUNX: Final = Chain(
    "quincunx",
    "image",
    (
        Split(1, ((0, 0), (1, 1)), ((0, 1), (1, 0)), _signed((1, 0), (0, 1))),
        Split(1, ((0, 0),), ((1, 1),), _signed((1, 1))),
    ),
)

FCC: Final = Chain(
    "fcc",
    "volume",
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

quincunx_forward, quincunx_inverse = QUINCUNX.forward, QUINCUNX.inverse
fcc_forward, fcc_inverse = FCC.forward, FCC.inverse


@dataclass(frozen=True)
class MultiresolutionFilter(FieldFilter):
    """The field at a coarser level of detail, on the same lattice.

    stages : int; 1 to 12; each halves the number of independent samples, three halve the resolution along
        each axis.
    """

    name: ClassVar[str] = "multiresolution"
    summary: ClassVar[str] = "a level of detail by FCC lifting, three stages to half the resolution: stages=3"
    example: ClassVar[str] = "stages=3"

    stages: int = 3

    def __post_init__(self) -> None:
        whole_stages(self.stages, 1, _MAX_FILTER_STAGES)

    def claims(self, grid: Grid) -> Claims:
        """Linear; a constant passes with gain 1. Short filters overshoot at a contact."""
        far = [0, 0, 0]
        for split in FCC.splits(
            self.stages
        ):  # each stage takes a coarse site two neighbours far, and back one
            for axis in range(3):
                if grid.shape[axis] > split.scale:
                    far[axis] += 3 * split.scale * max(o[axis] for o in split.offsets)
        return Claims((far[0], far[1], far[2]), linear=True, dc_gain=1.0, keeps_mean=True)

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`; dense on the way, `InvalidArgument` where the memory allowed is too small for
        that.
        """
        require_memory("--multiresolution", "dense samples", _DENSE_BYTES * field.grid.voxel_count)
        values, splits = FCC.forward(field.to_dense(), self.stages), FCC.splits(self.stages)
        coarse, scale = np.zeros_like(values), splits[-1].scale
        for residue in splits[-1].kept:
            sites = tuple(slice(r * scale, None, 2 * scale) for r in residue)
            coarse[sites] = values[sites]
        for split in reversed(splits):
            _lift(coarse, split, FCC, "predict", 1)  # the prediction in place of the detail
        return ForceField.from_dense(field.grid, coarse)
