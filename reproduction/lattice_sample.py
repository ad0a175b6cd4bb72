"""Estimates the size of the support and entropies of a lattice too large to compute, from a sample of its
points, with confidence intervals (paper table 1).

The paper's nominal workspace has 10^4 samples along each axis, 12 TB a frame: it is never allocated. The
lattice is cut into cells of s_x x s_y x s_z samples, every cell is a stratum, and one sample is drawn of
each, at the same random place in all: a coarser lattice with a random start, which a scene evaluates as any
other (systematic sampling in three dimensions; W. G. Cochran, Sampling Techniques, 1977, chapter 8). It is
drawn many times, the starts independent of each other. Every sample of the lattice has the same chance to be
drawn, so that counts are unbiased, however small or oddly placed the support is; and as no stratum is left
out because of a guess where there may be forces, no guess can bias it.

Why not bricks of neighbours, as a sparse field has them: in a huge lattice the 512 samples of a brick are
nearly one sample. For as many samples their interval is a hundred times as wide (measured on falling bodies).

Intervals are those of the jackknife over starts, which knows that the samples of one start are not
independent. Entropies of many symbols are corrected for their bias (`touchfield.measure.estimators`, Chao,
Wang and Jost); their interval is widened by as much as the jackknife's own correction differs from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from reproduction.experiment import SEEDS
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import binary_entropy_bits, entropy_bits, estimate_bits
from touchfield.measure.quantity import Interval, Quantity
from touchfield.medium.grid import Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField

    Int64s = NDArray[np.int64]
    Float64s = NDArray[np.float64]

__all__ = ["Counts", "LatticeEntropies", "LatticeSample", "sample_lattice"]

Field = Callable[[Grid], "ForceField"]
Symbols = Callable[["NDArray[np.float32]"], "NDArray[np.int32]"]

LEAST_STARTS: Final = 8
MOST_COUNTS: Final = 1 << 26
"""Starts times different symbols that are kept: 512 MiB."""

_LEVEL = 0.95
_FEW = 10  # samples to a symbol
_ESTIMATOR = "chao-wang-jost"


@dataclass(frozen=True)
class Counts:
    """How often each symbol but 0 was drawn.

    Attributes
    ----------
    symbols : int64 [K]
        Ascending.
    times : int64 [starts, K]
    """

    symbols: Int64s
    times: Int64s


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
    """What was drawn from a lattice.

    Attributes
    ----------
    grid : Grid
        The lattice.
    spread : (int, int, int)
        s_x, s_y, s_z; (1, 1, 1) where the whole lattice was counted.
    held : int64 [starts]
        Samples whose force is not zero.
    counts : mapping of str to Counts
        For each quantiser.
    """

    grid: Grid
    spread: tuple[int, int, int]
    held: Int64s
    counts: Mapping[str, Counts]

    @property
    def is_whole(self) -> bool:
        """Whether every sample of the lattice was looked at, so that nothing is estimated."""
        return self.spread == (1, 1, 1)

    @property
    def count(self) -> Quantity:
        """L, the samples of the lattice whose force is not zero."""
        each = self.held.astype(np.float64) * float(np.prod(self.spread))
        return self._quantity(
            "L", float(each.mean()), _half_width(_without(each)), "sample", int(self.held.sum()), 2
        )

    def entropies(self, words: str) -> LatticeEntropies:
        """Entropies under one of the quantisers.

        Raises
        ------
        InvalidArgument
            If it was not asked for, or no sample that was drawn has a symbol but 0.
        """
        if words not in self.counts:
            raise InvalidArgument("quantiser", repr(words), f"one of {', '.join(self.counts)}")
        times = self.counts[words].times
        if not times.any():
            raise InvalidArgument(
                "entropies", f"no force under {words} in {len(times)} starts", "at least one"
            )
        cell = int(np.prod(self.spread))
        each: Float64s = np.minimum(times.sum(axis=1) * cell / self.grid.voxel_count, 1.0)
        total = times.sum(axis=0)
        object_bits, half = self._object_bits(times, total)
        p, spread = float(each.mean()), _half_width(_without(each))
        voxel_bits = binary_entropy_bits(p) + p * object_bits
        # of h2(p) + p H: what p and H bring, as if they erred together
        slope = abs(math.log2((1 - p) / p) + object_bits) if 0 < p < 1 else object_bits
        n, k = int(total.sum()), int(np.count_nonzero(total))
        few = () if n >= _FEW * k else (f"few samples: {n} for {k} symbols, fewer than {_FEW} to each",)
        made = (
            self._quantity("p", p, spread, "1", n, k),
            self._quantity("H(S)", object_bits, half, "bit/sample", n, k).of(weighting="object"),
            self._quantity("H(S)", voxel_bits, slope * spread + p * half, "bit/sample", n, k + 1),
        )
        estimator = "plug-in" if self.is_whole else _ESTIMATOR
        return LatticeEntropies(*(one.of(quantiser=words, estimator=estimator, notes=few) for one in made))

    def _object_bits(self, times: Int64s, total: Int64s) -> tuple[float, float]:
        """H_object and half its interval."""
        plug_in = entropy_bits(total)
        if self.is_whole:
            return plug_in, 0.0
        bits = estimate_bits(total, _ESTIMATOR)
        rests = [total - one for one in times if total.sum() > one.sum()]
        half = _half_width(np.array([estimate_bits(rest, _ESTIMATOR) for rest in rests]))
        jackknifed = len(rests) * plug_in - (len(rests) - 1) * float(
            np.mean([entropy_bits(rest) for rest in rests])
        )
        return bits, half + abs(bits - jackknifed)

    def _quantity(self, name: str, value: float, half: float, unit: str, n: int, k: int) -> Quantity:
        interval = None
        if not self.is_whole:
            method = (
                f"jackknife over {len(self.held)} starts, every {'x'.join(map(str, self.spread))}th sample"
            )
            interval = Interval(max(0.0, value - half), value + half, _LEVEL, method)
        return Quantity(name, value, unit, "F is not zero", "voxel", "systematic sample", n, k, interval)


def _without(each: Float64s) -> Float64s:
    """The mean without each start."""
    if len(each) == 1:
        return each
    mean: Float64s = (each.sum() - each) / (len(each) - 1)
    return mean


def _half_width(without: Float64s) -> float:
    """Half the interval, of the estimates without one start each."""
    from scipy.special import stdtrit

    n = len(without)
    if n < 2:
        return 0.0
    spread = float(((without - without.mean()) ** 2).sum()) * (n - 1) / n
    return float(stdtrit(n - 1, (1 + _LEVEL) / 2) * np.sqrt(spread))


def sample_lattice(
    field: Field,
    grid: Grid,
    quantisers: Mapping[str, Symbols],
    *,
    per_axis: int = 128,
    starts: int = 32,
    seed: int = SEEDS["lattice_starts"],
    report: Callable[[int, int], None] = lambda done, total: None,
) -> LatticeSample:
    """Draw from a lattice; see the module. One of at most `per_axis` samples along each axis is counted
    whole.

    Parameters
    ----------
    field : callable
        ``field(part)``: the field at the points of any part of the lattice, such as
        ``lambda part: scene.field(0, part, profile)``. It must be the same at a point whatever part that is
        in.
    grid : Grid
        The lattice, of any size.
    quantisers : mapping of str to callable
        What each Q is in words, and its symbols, int32 [m], of force vectors, float32 [m, 3]; 0 is "no
        force".
    per_axis : int
        Samples drawn along each axis and start, about; the memory is that of a field of so many.
    starts : int
        8 or more.
    seed : int
    report : callable
        ``report(done, total)``.

    Raises
    ------
    InvalidArgument
        If a number is out of range, or there are too many different symbols to keep.
    """
    if not 1 <= per_axis <= 1024:
        raise InvalidArgument("per_axis", f"{per_axis}", "1 to 1024")
    if starts < LEAST_STARTS:
        raise InvalidArgument("starts", f"{starts}", f"{LEAST_STARTS} or more")
    sx, sy, sz = (-(-n // per_axis) for n in grid.shape)
    spread = (sx, sy, sz)
    rng = np.random.default_rng(seed)
    held: list[int] = []
    found: dict[str, list[tuple[Int64s, Int64s]]] = {words: [] for words in quantisers}
    total = 1 if spread == (1, 1, 1) else starts
    for done in range(total):
        vectors = _vectors(field, grid, rng.integers(0, spread), spread)
        held.append(len(vectors))
        for words, symbols_of in quantisers.items():
            symbols = symbols_of(vectors)
            seen, times = np.unique(symbols[symbols != 0], return_counts=True)
            found[words].append((seen.astype(np.int64), times))
        report(done + 1, total)
    return LatticeSample(
        grid, spread, np.array(held), {words: _table(parts) for words, parts in found.items()}
    )


def _vectors(field: Field, grid: Grid, first: Int64s, spread: tuple[int, int, int]) -> NDArray[np.float32]:
    """The forces that are not zero, float32 [m, 3], of the samples first, first + s, .."""
    x, y, z = (-(-(n - i) // s) for n, i, s in zip(grid.shape, first.tolist(), spread))
    if min(x, y, z) < 1:
        return np.zeros((0, 3), np.float32)
    spacing = np.asarray(grid.spacing_m) * spread
    part = field(Grid((x, y, z), tuple(spacing.tolist()), tuple(grid.to_m(first).tolist())))
    return part.forces_n[part.mask]


def _table(parts: list[tuple[Int64s, Int64s]]) -> Counts:
    known = np.unique(np.concatenate([seen for seen, _ in parts]))
    if len(known) * len(parts) > MOST_COUNTS:
        found = f"{len(known)} different symbols in {len(parts)} starts"
        raise InvalidArgument(
            "quantiser", found, f"at most {MOST_COUNTS} counts", "Take fewer starts or a coarser Q."
        )
    times = np.zeros((len(parts), len(known)), np.int64)
    for row, (seen, counts) in zip(times, parts):
        row[np.searchsorted(known, seen)] = counts
    return Counts(known, times)
