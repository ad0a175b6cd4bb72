"""The chains of sublattices of multiresolution (paper section 3.2, "optimal quincunx sampling"): geometry only.

A stage keeps every second site of the lattice before it. In two dimensions the quincunx of D = [[1, 1], [1, -1]]
keeps n1 + n2 even, and the next stage keeps both even: two stages an octave. In three dimensions (x-y-z, or x-y-t)
the face-centred cubic lattice (FCC) keeps n1 + n2 + n3 even, and three stages make an octave.

Between the FCC and 2Z^3 there is no body-centred lattice to keep: the one of that density, however it is turned, has
sites at the square distance 3, and those of the FCC lie at even ones. Of the lattices that do lie between them, all
alike but for the axis, we take the one of the third: n1 + n2 even and n3 even, which for x-y-t is a quincunx picture
in every second frame.

A site that is dropped is predicted from the nearest sites that stay; there are 4, 6 or 8 of them, all equally far.
Seen from a site that stays, the dropped ones around it lie at the same offsets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CHAINS", "FCC", "MAX_STAGES", "QUINCUNX", "Chain", "Split", "coarse_mask", "whole_stages"]

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
    """Which sites hold the coarse signal after some stages.

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
