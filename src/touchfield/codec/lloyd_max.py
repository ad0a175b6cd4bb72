"""Lloyd-Max: the quantiser of a given number of levels with the least mean squared error (paper section 5.2).

The paper quantises the sent amplitudes with 2^n_q levels found "by the Lloyd max algorithm [17]". Here on samples
(`LloydMaxSpec`; each level is the exact mean of its cell, each threshold the midpoint of its levels, and nothing is
random), and on two densities whose optimum is known to many digits (`lloyd_max_density`), which check it.

The quantiser knows nothing of Weber's law: how often it leaves the mask has to be reported beside it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from touchfield.codec.stage import Claim, Table, checked_amplitudes
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]

__all__ = ["DensityQuantiser", "LevelTable", "LloydMaxSpec", "lloyd_max_density", "lloyd_max_levels"]

_TOLERANCE = 1e-7
_ITERATIONS = 1000
_ROUNDS = 32


@dataclass(frozen=True)
class LloydMaxSpec:
    """Lloyd-Max with 2^nq levels.

    Parameters
    ----------
    nq : int
        n_q, bits of a level, 1 to 12.
    """

    nq: int = 6

    def __post_init__(self) -> None:
        if not 1 <= self.nq <= 12:
            raise InvalidArgument("nq", repr(self.nq), "1 to 12 bits of amplitude")

    def fit(self, amplitudes_n: Float32s) -> LevelTable:
        """The levels for these amplitudes; fewer if they have fewer values (one level, zero, for none at all)."""
        amplitudes = checked_amplitudes(amplitudes_n)
        if not len(amplitudes):
            return LevelTable(np.zeros(1, np.float32))
        return LevelTable(lloyd_max_levels(amplitudes, 1 << self.nq) + np.float32(0))  # no negative zero


@dataclass(frozen=True, eq=False)
class LevelTable(Table):
    """Any levels, thresholds midway.

    Parameters
    ----------
    levels_n : float32 [n]
        Newtons, finite, not negative, strictly ascending, 1 to 65536 of them.
    """

    levels_n: Float32s
    kind: ClassVar[int] = 0

    def __post_init__(self) -> None:
        levels = np.array(self.levels_n)
        if levels.dtype != np.float32 or levels.ndim != 1 or not 1 <= len(levels) <= 1 << 16:
            raise InvalidArgument("levels_n", f"{levels.dtype} {levels.shape}", "float32 [1 to 65536]")
        if not np.isfinite(levels).all() or levels[0] < 0 or (levels[1:] <= levels[:-1]).any():
            raise InvalidArgument("levels_n", "levels out of order or range", "finite, ascending from 0 or above")
        levels.flags.writeable = False
        object.__setattr__(self, "levels_n", levels)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LevelTable) and np.array_equal(self.levels_n, other.levels_n)

    def __hash__(self) -> int:
        return hash(self.levels_n.tobytes())

    @property
    def claim(self) -> Claim:
        """Half the widest gap, between the first and the last level."""
        levels = self.levels_n.astype(np.float64)
        gap = float(np.diff(levels).max(initial=0.0)) / 2
        return Claim("absolute", gap * (1 + 2.0**-22), float(levels[0]), float(levels[-1]))

    def _payload(self) -> bytes:
        return struct.pack("<H", len(self.levels_n) - 1) + self.levels_n.astype("<f4").tobytes()

    @classmethod
    def _from_payload(cls, data: bytes) -> LevelTable:
        if len(data) < 2:
            raise TruncatedFile("table of levels", f"{len(data)} bytes", "at least 2")
        count = struct.unpack_from("<H", data)[0] + 1
        if len(data) != 2 + 4 * count:
            kind = TruncatedFile if len(data) < 2 + 4 * count else CorruptFile
            raise kind("table of levels", f"{len(data)} bytes", f"{2 + 4 * count} for {count} levels")
        try:
            return cls(np.frombuffer(data, "<f4", count, 2).astype(np.float32))
        except InvalidArgument as error:
            raise CorruptFile("table of levels", error.found, error.expected) from error


# -- on samples -----------------------------------------------------------------------------------------------


def lloyd_max_levels(samples: NDArray[Any], level_count: int) -> Float32s:
    """Levels of least mean squared error for samples, ascending, float32 [level_count or fewer].

    A local optimum: from a start with as many levels in an interval as the cube root of its density asks for, and
    then by moving levels from where two could be merged cheaply to where a cell gains more by being split.
    Samples with no more than `level_count` different values get exactly these.

    Parameters
    ----------
    samples : float32 [m]
        At least one, finite.
    level_count : int
        1 to 65536.

    Raises
    ------
    InvalidArgument
        If there is no sample, one is not finite, or `level_count` is out of range.
    """
    values = np.sort(np.asarray(samples, np.float32).reshape(-1))
    if not 1 <= level_count <= 1 << 16:
        raise InvalidArgument("level_count", repr(level_count), "1 to 65536")
    if not len(values) or not np.isfinite(values[[0, -1]]).all():  # what is not finite is sorted to the ends
        raise InvalidArgument("samples", "none, or one that is not finite", "at least one finite sample")
    distinct = np.concatenate([values[:1], values[1:][values[1:] != values[:-1]]])
    if len(distinct) <= level_count:
        return distinct
    # about the middle, so that sums of squares keep their digits
    centre = (float(values[0]) + float(values[-1])) / 2
    means = _iterated(values.astype(np.float64) - centre, level_count) + centre
    return np.unique(means.astype(np.float32))


def _iterated(values: Float64s, level_count: int) -> Float64s:
    from touchfield.codec.kernels.quantise import lloyd

    scale = values[-1]
    values = values / scale
    sums = np.concatenate([[0.0], np.cumsum(values), [(values * values).sum()]])
    edges, thresholds = lloyd(values, sums, _companded(values, level_count), _TOLERANCE, _ITERATIONS)
    error, moves = _squared_error(sums, edges), level_count
    for _ in range(_ROUNDS):
        begin = _moved(values, sums, edges, thresholds, level_count - len(thresholds) - 1, moves)
        if len(begin) == len(thresholds) and (begin == thresholds).all():
            break
        new_edges, new_thresholds = lloyd(values, sums, begin, _TOLERANCE, _ITERATIONS)
        new_error = _squared_error(sums, new_edges)
        if len(new_edges) > len(edges) or (len(new_edges) == len(edges) and new_error < error):
            edges, thresholds, error = new_edges, new_thresholds, new_error
        else:
            moves //= 4
    means: Float64s = np.diff(sums[:-1][edges]) / np.diff(edges) * scale
    return means


def _squared_error(sums: Float64s, edges: NDArray[np.int64]) -> float:
    inside = np.diff(sums[:-1][edges])
    return float(sums[-1] - (inside * inside / np.diff(edges)).sum())


def _moved(
    values: Float64s, sums: Float64s, edges: NDArray[np.int64], thresholds: Float64s, missing: int, moves: int
) -> Float64s:
    """Thresholds with `missing` more, and with up to `moves` others taken from where they matter less.

    A threshold is worth what the squared error gains by it. Cells are split at their mean, those with most to gain
    first; beyond the missing ones each split must gain more than the merging of two neighbours costs.
    """
    counts, inside = np.diff(edges), np.diff(sums[:-1][edges])
    means = inside / counts
    middle = np.searchsorted(values, means, "right").clip(edges[:-1] + 1, edges[1:])
    left, below = middle - edges[:-1], sums[:-1][middle] - sums[:-1][edges[:-1]]
    right = np.maximum(counts - left, 1)
    gains = np.where(left < counts, left * right / counts * (below / left - (inside - below) / right) ** 2, 0.0)
    costs = counts[1:] * counts[:-1] / (counts[1:] + counts[:-1]) * np.diff(means) ** 2
    splits, merges = np.argsort(-gains, kind="stable"), iter(np.argsort(costs, kind="stable"))
    touched = set(splits[:missing].tolist())
    added, dropped = [means[i] for i in splits[:missing] if gains[i] > 0], []
    for i in splits[missing : missing + moves].tolist():
        merge = next((m for m in merges if not touched & {int(m), int(m) + 1, int(m) - 1, int(m) + 2}), None)
        if merge is None or i in touched or gains[i] <= 1.01 * costs[merge]:
            break
        touched |= {i, int(merge), int(merge) + 1}
        added.append(means[i])
        dropped.append(merge)
    return np.sort(np.concatenate([np.delete(thresholds, dropped), added]))


def _companded(values: Float64s, level_count: int) -> Float64s:
    """Thresholds at equal steps of the integral of (density)^(1/3), Panter and Dite's rule for many levels."""
    borders = np.linspace(values[0], values[-1], max(256, 4 * level_count) + 1)
    counts = np.diff(np.searchsorted(values, borders))
    counts[-1] += len(values) - counts.sum()
    integral = np.concatenate([[0.0], np.cumsum(np.cbrt(counts))])
    steps = integral[-1] * np.arange(1, level_count) / level_count
    thresholds: Float64s = np.interp(steps, integral, borders)
    return thresholds


# -- on densities ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Density:
    """A density of zero mean and unit variance.

    Attributes
    ----------
    value : callable
        f(x).
    moments : callable
        Integrals of f, x f and x^2 f from minus infinity to x.
    start : callable
        The quantiles of f^(1/3), normalised.
    """

    value: Callable[[float], float]
    moments: Callable[[float], tuple[float, float, float]]
    start: Callable[[float], float]


@dataclass(frozen=True)
class DensityQuantiser:
    """The optimal quantiser of a density of unit variance.

    Attributes
    ----------
    levels : float64 [n]
    thresholds : float64 [n - 1]
    mse : float
        Mean squared error.
    entropy_bits : float
        Entropy of the level, bits.
    """

    levels: Float64s
    thresholds: Float64s
    mse: float
    entropy_bits: float


def _gaussian(x: float) -> float:
    return math.exp(-x * x / 2) / math.sqrt(2 * math.pi)


def _gaussian_moments(x: float) -> tuple[float, float, float]:
    if math.isinf(x):
        return (0.0, 0.0, 0.0) if x < 0 else (1.0, 0.0, 1.0)
    below = math.erfc(-x / math.sqrt(2)) / 2
    return below, -_gaussian(x), below - x * _gaussian(x)


def _laplacian(x: float) -> float:
    return math.exp(-math.sqrt(2) * abs(x)) / math.sqrt(2)


def _laplacian_moments(x: float) -> tuple[float, float, float]:
    if math.isinf(x):
        return (0.0, 0.0, 0.0) if x < 0 else (1.0, 0.0, 1.0)
    b, d = math.sqrt(0.5), abs(x)
    tail = math.exp(-d / b) / 2
    zeroth, first, second = tail, -tail * (d + b), tail * (d * d + 2 * b * d + 2 * b * b)
    return (zeroth, first, second) if x < 0 else (1 - zeroth, first, 1 - second)


def _laplacian_start(p: float) -> float:
    return 3 * math.sqrt(0.5) * (math.log(2 * p) if p < 0.5 else -math.log(2 * (1 - p)))


_DENSITIES = {
    "gaussian": _Density(_gaussian, _gaussian_moments, lambda p: math.sqrt(3) * NormalDist().inv_cdf(p)),
    "laplacian": _Density(_laplacian, _laplacian_moments, _laplacian_start),
}


def lloyd_max_density(density: str, level_count: int) -> DensityQuantiser:
    """The optimal quantiser of the unit Gaussian or Laplacian, to rounding.

    By Newton's method on "every threshold is midway between the means beside it", from Panter and Dite's start;
    the moments of the cells are in closed form. (Lloyd's own iteration needs thousands of steps for 64 levels.)

    Parameters
    ----------
    density : str
        "gaussian" or "laplacian", zero mean, unit variance.
    level_count : int
        2 to 256.

    Raises
    ------
    InvalidArgument
        For another density or number of levels.
    """
    if density not in _DENSITIES:
        raise InvalidArgument("density", repr(density), f"one of {', '.join(_DENSITIES)}")
    if not 2 <= level_count <= 256:
        raise InvalidArgument("level_count", repr(level_count), "2 to 256")
    f = _DENSITIES[density]
    thresholds = np.array([f.start(i / level_count) for i in range(1, level_count)])
    for _ in range(100):
        off, slopes = _off_midpoints(f, thresholds)
        if np.abs(off).max() < 1e-12:
            break
        # least squares: the Laplacian's kink makes the matrix singular, in a mode that symmetry leaves out
        step = np.linalg.lstsq(slopes, -off, rcond=1e-9)[0]
        while (np.diff(thresholds + step) <= 0).any():
            step /= 2
        thresholds = thresholds + step
        thresholds = (thresholds - thresholds[::-1]) / 2  # both densities are symmetric
    m0, m1, m2 = _cell_moments(f, thresholds)
    levels = m1 / m0
    return DensityQuantiser(levels, thresholds, float((m2 - m1 * levels).sum()), float(-(m0 * np.log2(m0)).sum()))


def _cell_moments(f: _Density, thresholds: Float64s) -> tuple[Float64s, Float64s, Float64s]:
    at = np.array([f.moments(x) for x in (-math.inf, *thresholds.tolist(), math.inf)])
    m0, m1, m2 = np.diff(at, axis=0).T
    return m0, m1, m2


def _off_midpoints(f: _Density, thresholds: Float64s) -> tuple[Float64s, Float64s]:
    """How far each threshold is from midway between the means beside it, and the Jacobian of that."""
    m0, m1, _ = _cell_moments(f, thresholds)
    means = m1 / m0
    at = np.array([f.value(x) for x in thresholds.tolist()])
    from_left = at * (thresholds - means[:-1]) / m0[:-1]  # d mean / d threshold of the cell to the left
    from_right = at * (means[1:] - thresholds) / m0[1:]  # and of the cell to the right
    slopes = np.diag(1 - (from_left + from_right) / 2)
    slopes -= np.diag(from_right[:-1] / 2, -1) + np.diag(from_left[1:] / 2, 1)
    return thresholds - (means[1:] + means[:-1]) / 2, slopes
