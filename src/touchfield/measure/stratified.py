"""A huge lattice by samples of it: the size of the support and entropies, with intervals (paper table 1).

The paper's nominal workspace has 10^4 samples along each axis, 12 TB a frame: it is never allocated. The lattice is
cut into cells of 8 s samples along each axis, and a *block* is one of the s^3 ways to take every s-th sample of a
cell along each axis, 8^3 samples in all. Two neighbours in a huge lattice are nearly the same sample; those of a
block lie apart.

Stratified random sampling (W. G. Cochran, Sampling Techniques, 1977, chapter 5). A coarse pass, two samples to a cell
along each axis, sorts the cells: *full* where those of the cell and of all its neighbours hold a force, *empty* where
none does, *border* otherwise. From each stratum cells are drawn at random with replacement, and of each a block. All
strata are sampled, the empty one too, so that every sample of the lattice has a known chance to be drawn whatever the
coarse pass saw: the count is unbiased. What is in the stratum taken for empty and was never hit is not in the
interval; `LatticeSample.empty_note` says how much of it there may be.

Intervals and the bias of the plug-in entropy come from the jackknife over groups of blocks (Cochran, section 6.16):
blocks are independent, samples within one are not. The bias that the jackknife takes off is that of order 1/n.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.plug_in import binary_entropy_bits, entropy_bits
from touchfield.measure.quantity import Interval, Quantity
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField

    Int64s = NDArray[np.int64]
    Float64s = NDArray[np.float64]

__all__ = ["GROUPS", "LatticeEntropies", "LatticeSample", "draw_blocks"]

Field = Callable[[Grid], "ForceField"]
Symbols = Callable[["NDArray[np.float32]"], "NDArray[np.int32]"]

GROUPS: Final = 32
"""Of the jackknife; the blocks of a stratum are a multiple of it."""

LEVEL: Final = 0.95

_MOST_CELLS: Final = 1 << 18
_STRATA: Final = ("full", "border", "empty")
_SHARES: Final = (0.4, 0.45, 0.15)
_COARSE = 2  # samples to a cell along each axis


@dataclass(frozen=True)
class LatticeEntropies:
    """Entropies of Q(F) on a lattice, X uniform over its samples.

    Attributes
    ----------
    density : Quantity
        p, the share of samples whose Q(F) is not zero.
    object : Quantity
        H(S) over those samples.
    voxel : Quantity
        H(S) over all samples: h2(p) + p H_object of the two above, exactly.
    """

    density: Quantity
    object: Quantity
    voxel: Quantity


@dataclass(frozen=True, eq=False)
class LatticeSample:
    """Blocks drawn from a lattice, and the forces in them.

    Attributes
    ----------
    grid : Grid
        The lattice.
    cells : (int, int, int)
        Cells in the strata "full", "border" and "empty".
    stratum : int64 [B]
        Of each block.
    weight : float64 [B]
        For how many samples of the lattice each sample of the block stands.
    counts : int64 [B]
        Samples of the block whose force is not zero.
    vectors_n : float32 [m, 3]
        Their forces, newtons, block after block.
    """

    grid: Grid
    cells: tuple[int, int, int]
    stratum: Int64s
    weight: Float64s
    counts: Int64s
    vectors_n: NDArray[np.float32]

    @cached_property
    def count(self) -> Quantity:
        """L, the samples of the lattice whose force is not zero."""
        per_group = self._grouped(self.counts * self.weight)
        estimate = float(per_group.sum())
        without = (estimate - per_group) * GROUPS / (GROUPS - 1)
        held = estimate, _half_width(without)
        return self._quantity("L", held, "sample", (0.0, float(self.grid.voxel_count)), len(self.vectors_n), 2)

    @property
    def empty_note(self) -> str:
        """What may have been missed in the stratum taken for empty."""
        drawn = int((self.stratum == 2).sum())
        hit = int(((self.stratum == 2) & (self.counts > 0)).sum())
        if not drawn:
            return "no cell was taken for empty"
        if hit:
            return f"{hit} of {drawn} blocks taken for empty held a force; they count with their weight"
        share = 1 - (1 - LEVEL) ** (1 / drawn)
        return f"none of {drawn} blocks taken for empty held a force: at {LEVEL:.0%}, at most {share:.2%} of them do"

    def entropies(
        self, symbols_of: Callable[[NDArray[np.float32]], NDArray[np.int32]], words: str
    ) -> LatticeEntropies:
        """Entropies under a quantiser.

        Parameters
        ----------
        symbols_of : callable
            Q: symbols int32 [m] of force vectors float32 [m, 3]; 0 is "no force".
        words : str
            What Q is.

        Raises
        ------
        InvalidArgument
            If no sample that was drawn has a symbol but 0.
        """
        symbols = symbols_of(self.vectors_n)
        held = symbols != 0
        if not held.any():
            raise InvalidArgument("entropies", f"no force among {len(symbols)} samples drawn", "at least one")
        known, place = np.unique(symbols[held], return_inverse=True)
        owner = np.repeat(np.arange(len(self.counts)), self.counts)[held]
        cell = self._group[owner] * len(known) + place
        groups = np.bincount(cell, self.weight[owner], GROUPS * len(known)).reshape(GROUPS, len(known))
        total = groups.sum(axis=0)
        without = (total - groups) * GROUPS / (GROUPS - 1)
        voxels = float(self.grid.voxel_count)
        n, k = int(held.sum()), len(known)
        notes = () if n >= 10 * k else (f"few samples: {n} for {k} symbols, fewer than 10 to each",)

        objects = _jackknife(entropy_bits(total), np.array([entropy_bits(one) for one in without]))
        shares = np.minimum(without.sum(axis=1) / voxels, 1.0)
        p = min(float(total.sum()) / voxels, 1.0)
        object_bits = max(0.0, objects[0])
        voxel_bits = binary_entropy_bits(p) + p * object_bits
        mixed = np.array([binary_entropy_bits(q) + q * entropy_bits(one) for q, one in zip(shares, without)])
        described = {"quantiser": words, "notes": notes}
        most = float(np.log2(voxels)) + 1
        return LatticeEntropies(
            self._quantity("p", (p, _half_width(shares)), "1", (0.0, 1.0), n, k).of(**described),
            self._quantity("H(S)", (object_bits, objects[1]), "bit/sample", (0.0, most), n, k).of(
                **described, weighting="object", estimator=_ESTIMATOR
            ),
            self._quantity("H(S)", (voxel_bits, _half_width(mixed)), "bit/sample", (0.0, most), n, k + 1).of(
                **described, weighting="voxel", estimator=_ESTIMATOR
            ),
        )

    @cached_property
    def _group(self) -> Int64s:
        """The jackknife's group of each block: those of a stratum in turn."""
        group = np.zeros(len(self.stratum), np.int64)
        for stratum in range(len(_STRATA)):
            own = np.flatnonzero(self.stratum == stratum)
            group[own] = np.arange(len(own)) % GROUPS
        return group

    def _grouped(self, values: Float64s) -> Float64s:
        total: Float64s = np.bincount(self._group, values, GROUPS)
        return total

    def _quantity(
        self, name: str, held: tuple[float, float], unit: str, bounds: tuple[float, float], n: int, k: int
    ) -> Quantity:
        value, half = held
        method = f"jackknife over {GROUPS} groups of {len(self.counts)} blocks"
        low, high = max(bounds[0], value - half), min(bounds[1], value + half)
        interval = Interval(low, high, LEVEL, method)
        return Quantity(name, value, unit, "F is not zero", "voxel", "stratified", n, k, interval)


_ESTIMATOR: Final = "plug-in of weighted counts, less its jackknife bias"


def _half_width(without: Float64s) -> float:
    """Half the interval, of the estimates without one group each."""
    from scipy.special import stdtrit

    spread = float(((without - without.mean()) ** 2).sum()) * (GROUPS - 1) / GROUPS
    return float(stdtrit(GROUPS - 1, (1 + LEVEL) / 2) * np.sqrt(spread))


def _jackknife(estimate: float, without: Float64s) -> tuple[float, float]:
    """The estimate less its bias, and half its interval."""
    return GROUPS * estimate - (GROUPS - 1) * float(without.mean()), _half_width(without)


def draw_blocks(
    field: Field,
    grid: Grid,
    blocks: int = 2048,
    seed: int = 0,
    report: Callable[[int, int], None] = lambda done, total: None,
) -> LatticeSample:
    """Draw blocks of a lattice; see the module.

    Parameters
    ----------
    field : callable
        ``field(part)``: the field at the points of a part of the lattice, such as
        ``lambda part: scene.field(0, part, profile)``. It must be the same at one point whatever part that is in.
    grid : Grid
        The lattice, of any size.
    blocks : int
        About as many are drawn, of 8^3 samples each; at least 32 of each stratum.
    seed : int
    report : callable
        ``report(done, total)``.

    Raises
    ------
    InvalidArgument
        If there are fewer than 96 blocks to draw.
    """
    if blocks < len(_STRATA) * GROUPS:
        raise InvalidArgument("blocks", f"{blocks}", f"{len(_STRATA) * GROUPS} or more")
    spread = _spread(grid.shape)
    cell_count, strata = _strata(field, grid, spread)
    drawn = _allocated(cell_count, blocks)
    rng = np.random.default_rng(seed)
    stratum, weight, counts = [], [], []
    vectors = [np.zeros((0, 3), np.float32)]
    for number, n in enumerate(drawn):
        own = np.flatnonzero(strata.reshape(-1) == number)
        for place in own[rng.integers(0, len(own), n)] if n else own[:0]:
            cell = np.array(np.unravel_index(place, strata.shape))
            found = _block(field, grid, cell * BRICK * spread + rng.integers(0, spread, 3), spread)
            stratum.append(number)
            weight.append(len(own) * spread**3 / n)
            counts.append(len(found))
            vectors.append(found)
            report(len(counts), sum(drawn))
    return LatticeSample(
        grid, cell_count, np.array(stratum), np.array(weight), np.array(counts), np.concatenate(vectors)
    )


def _spread(shape: tuple[int, int, int]) -> int:
    """s: the least for which the cells can be kept in a table."""
    s = 1
    while np.prod([-(-n // (BRICK * s)) for n in shape]) > _MOST_CELLS:
        s += 1
    return s


def _strata(field: Field, grid: Grid, spread: int) -> tuple[tuple[int, int, int], NDArray[np.uint8]]:
    """How many cells each stratum has, and the stratum of each, uint8 [cells along x, y, z]."""
    from scipy.ndimage import maximum_filter, minimum_filter

    step = BRICK * spread // _COARSE
    start = np.minimum(step // 2, np.array(grid.shape) - 1)
    x, y, z = (-(-(n - first) // step) for n, first in zip(grid.shape, start.tolist()))
    spacing = np.asarray(grid.spacing_m) * step
    coarse = Grid((x, y, z), tuple(spacing.tolist()), tuple(grid.to_m(start).tolist()))
    held = np.zeros([-(-n // (BRICK * spread)) * _COARSE for n in grid.shape], np.bool_)
    held[tuple(field(coarse).positions().T)] = True
    a, b, c = (n // _COARSE for n in held.shape)
    seen = held.reshape(a, _COARSE, b, _COARSE, c, _COARSE).sum(axis=(1, 3, 5))
    strata = np.ones(seen.shape, np.uint8)
    strata[minimum_filter(seen, 3, mode="nearest") == _COARSE**3] = 0
    strata[maximum_filter(seen, 3, mode="nearest") == 0] = 2
    full, border, empty = np.bincount(strata.reshape(-1), minlength=3).tolist()
    return (full, border, empty), strata


def _allocated(cells: tuple[int, int, int], blocks: int) -> list[int]:
    """Blocks to draw of each stratum, multiples of `GROUPS`; none of one without cells."""
    shares = np.array([share if n else 0.0 for share, n in zip(_SHARES, cells)])
    wanted = np.maximum(1, np.rint(blocks * shares / shares.sum() / GROUPS)).astype(int) * GROUPS
    return [int(w) if n else 0 for w, n in zip(wanted, cells)]


def _block(field: Field, grid: Grid, first: Int64s, spread: int) -> NDArray[np.float32]:
    """The forces, float32 [m, 3], of the samples first, first + s, .. of a cell, as far as the lattice reaches."""
    x, y, z = (min(BRICK, -(-(n - i) // spread)) for n, i in zip(grid.shape, first.tolist()))
    if min(x, y, z) < 1:
        return np.zeros((0, 3), np.float32)
    spacing = tuple((np.asarray(grid.spacing_m) * spread).tolist())
    part = field(Grid((x, y, z), spacing, tuple(grid.to_m(first).tolist())))
    return part.forces_n[part.mask]
