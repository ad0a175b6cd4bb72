"""Splits data on a lattice into a coarser lattice and the details between, stage by stage, and joins them
again without loss (a lifting transform on quincunx and other sublattices; paper section 3.2).

Paper section 3.2 asks for "optimal quincunx sampling and filtering" and gives no filter; this is the shortest
lifting (after Sweldens). A stage keeps every second site of the lattice before it. The predict step replaces
each dropped site by its difference from the mean of its k nearest kept sites, the detail. The update step
adds 1/(2k) of the sum of the surrounding details to each kept site, which preserves the mean of the field.
Each step is inverted by the same step with the opposite sign, which gives perfect reconstruction. For whole
numbers the mean and the update are rounded (floor of the value plus 1/2), and reconstruction is bit-exact. A
neighbour beyond the border is its mirror image about the site; along an axis with one site there are none,
and the mean is over the others.

In two dimensions the quincunx of D = [[1, 1], [1, -1]] keeps n1 + n2 even (four neighbours), and the next
stage, along the diagonals, both even: two stages an octave. In three (x-y-z, or x-y-t with t on the third
axis) the face-centred cubic lattice (FCC) keeps n1 + n2 + n3 even (six neighbours); the second stage n1 + n2
even and n3 even (eight), the third all even (four). There is no body-centred lattice within the FCC to keep;
of those that lie between it and 2Z^3 we take the one which for x-y-t is a quincunx picture in every second
frame.

Frequencies in the diamond |w1| + |w2| <= pi, or the octahedron |w1| + |w2| + |w3| <= 3 pi / 2, do not alias:
a pattern along an axis passes up to the full Nyquist rate. With P the mean of the cosines of w the response
of the coarse signal is 1 + P/2 - P^2/2, which is far from steep.

The multiresolution filter takes a field down the FCC chain, sets its details to zero and reconstructs it.
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

MAX_STAGES: Final = 60  # any array is down to one site long before; further stages do nothing
_MAX_FILTER_STAGES: Final = 12  # four octaves
_DENSE_BYTES: Final = 60  # per sample: field, coefficients, coefficients of the level, two temporaries
_HEADROOM: Final = 2.0**-16  # of the range of a float: sums of neighbours, stage after stage, stay finite


@dataclass(frozen=True)
class Split:
    """One stage: which sites of a lattice stay, which become details, and the neighbour offsets.

    Offsets are closed under a change of sign, so that a neighbour beyond the border has a mirror image.
    """

    scale: int  # sites of the stage lie at multiples of this, in samples
    coarse: tuple[Site, ...]  # residues modulo 2 of the coordinates in units of `scale`
    details: tuple[Site, ...]
    offsets: tuple[Site, ...]  # from any site to its nearest ones of the other kind

    def offsets_in(self, shape: tuple[int, ...]) -> tuple[Site, ...]:
        """Return the offsets that apply to an array: an axis with a single site has no neighbours."""
        return tuple(
            o for o in self.offsets if all(n > self.scale for n, d in zip(shape, o, strict=True) if d)
        )


def _signed(*sites: Site) -> tuple[Site, ...]:
    """Each place with every choice of signs of its non-zero coordinates."""
    return tuple(sorted(o for site in sites for o in product(*((-d, d) if d else (0,) for d in site))))


@dataclass(frozen=True)
class SublatticeChain:
    """Nested lattices: the splits of one octave, from scale 1, repeated at twice the scale for the next."""

    name: str
    signal_name: str  # an array of as many axes
    octave: tuple[Split, ...]

    @property
    def dimensions(self) -> int:
        """Axes of the lattice, as many as there are stages in an octave."""
        return len(self.octave)

    def splits(self, stages: int) -> list[Split]:
        """The first `stages` splits, finest first."""
        stage_numbers = [divmod(n, len(self.octave)) for n in range(stages)]
        return [replace(self.octave[stage], scale=2**octave) for octave, stage in stage_numbers]

    def forward(self, array: ArrayLike, stages: int) -> NDArray[Any]:
        """Transform an array to coefficients: the coarse signal and the details, each at its own site.

        array : [n1, ..., nd] or [n1, ..., nd, ...]; any real type, any shape without an empty axis; axes
            beyond those of the chain are components.
        stages : int; 0 to 60.
        Returns float32, float64, int32 or int64 of the same shape: Whole numbers of up to 16 bits become
        int32, wider ones int64, because details take a bit more. int64 sums beyond 2^63 wrap round, which the
        inverse undoes. Raises `InvalidArgument` if `array` has too few axes, an empty one, or a number that
        is not real, finite and below 2^-16 of the range of its type; or if `stages` is out of range.
        """
        values = _checked(array, self, self.signal_name)
        for split in self.splits(require_stages(stages)):
            _lift(values, split, self, "predict", -1)
            _lift(values, split, self, "update", 1)
        return values

    def inverse(self, coefficients: ArrayLike, stages: int) -> NDArray[Any]:
        """Invert `forward` with the same number of stages; bit-exact for whole numbers.

        The result has the working type. Raises `InvalidArgument` as `forward` does.
        """
        values = _checked(coefficients, self, "coefficients")
        for split in reversed(self.splits(require_stages(stages))):
            _lift(values, split, self, "update", -1)
            _lift(values, split, self, "predict", 1)
        return values


def require_stages(stages: object, min_stages: int = 0, max_stages: int = MAX_STAGES) -> int:
    """A number of stages; `InvalidArgument` if it is not a whole number from `min_stages` to `max_stages`."""
    if (
        isinstance(stages, bool)
        or not isinstance(stages, (int, np.integer))
        or not min_stages <= stages <= max_stages
    ):
        raise InvalidArgument("stages", repr(stages), f"a whole number from {min_stages} to {max_stages}")
    return int(stages)


def _checked(array: ArrayLike, chain: SublatticeChain, name: str) -> NDArray[Any]:
    """Return a copy in the working type."""
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


def _lift(values: NDArray[Any], split: Split, chain: SublatticeChain, kind: str, sign: int) -> None:
    """Apply one step in place, "predict" or "update"; `sign` is the sign of the mean that is added.

    A step changes sites of one kind by their neighbours of the other kind: it reads nothing that it writes.
    """
    offsets = split.offsets_in(values.shape[: chain.dimensions])
    if not offsets:
        return
    divisor = len(offsets) * (1 if kind == "predict" else 2)
    sites = values[(slice(None, None, split.scale),) * chain.dimensions]
    # a neighbour beyond the border is its mirror image about the site
    margins = [int(n > 1) for n in sites.shape[: chain.dimensions]]
    wide = np.pad(sites, [(r, r) for r in margins] + [(0, 0)] * (values.ndim - len(margins)), mode="reflect")
    for residue in split.details if kind == "predict" else split.coarse:
        target = sites[tuple(slice(r, None, 2) for r in residue)]
        if not target.size:
            continue
        total = np.zeros_like(target)
        for offset in offsets:
            first = [p + r + d for p, r, d in zip(margins, residue, offset, strict=True)]
            total += wide[tuple(slice(f, f + 2 * n - 1, 2) for f, n in zip(first, target.shape))]
        if values.dtype.kind == "f":
            target += values.dtype.type(sign / divisor) * total
        else:
            target += sign * ((total + divisor // 2) // divisor)


QUINCUNX: Final = SublatticeChain(
    "quincunx",
    "image",
    (
        Split(1, ((0, 0), (1, 1)), ((0, 1), (1, 0)), _signed((1, 0), (0, 1))),
        Split(1, ((0, 0),), ((1, 1),), _signed((1, 1))),
    ),
)

FCC: Final = SublatticeChain(
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
        require_stages(self.stages, 1, _MAX_FILTER_STAGES)

    def claims(self, grid: Grid) -> Claims:
        """Linear; a constant passes with gain 1. Short filters overshoot at a contact."""
        reach = [0, 0, 0]
        for split in FCC.splits(
            self.stages
        ):  # each stage takes a coarse site two neighbours far, and back one
            for axis in range(3):
                if grid.shape[axis] > split.scale:
                    reach[axis] += 3 * split.scale * max(o[axis] for o in split.offsets)
        return Claims((reach[0], reach[1], reach[2]), linear=True, dc_gain=1.0, keeps_mean=True)

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`. Needs a dense copy; `InvalidArgument` if the memory budget is too small."""
        require_memory("--multiresolution", "dense samples", _DENSE_BYTES * field.grid.voxel_count)
        values, splits = FCC.forward(field.to_dense(), self.stages), FCC.splits(self.stages)
        coarse, scale = np.zeros_like(values), splits[-1].scale
        for residue in splits[-1].coarse:
            sites = tuple(slice(r * scale, None, 2 * scale) for r in residue)
            coarse[sites] = values[sites]
        for split in reversed(splits):
            _lift(coarse, split, FCC, "predict", 1)  # the prediction in place of the detail
        return ForceField.from_dense(field.grid, coarse)
