"""The fewest points of a field that stands still: greedy choice with a curl-free kernel (paper section 6.2).

There are no modes over time to go by, but a field of forces has no curl (`CurlFree`). Two criteria:

* variance: the next point is where the Gaussian process knows least, whatever the forces are. It tells a
  robot or a hand where to record next. What is known shrinks everywhere, so the variances of those chosen
  never grow.
* error: where the forces are known, and the fewest are to be kept, the next point is the one after which
  least of the field is missed. It is looked for among those of the greatest residual and as many drawn at
  random ("stochastic greedy", Mirzasoleiman et al. 2015), and what is missed is added up over some places
  spread over all.

Both go by rows of a Cholesky factor that are added a point at a time: a step takes time in proportion to
candidates times points chosen, and no matrix of all candidates is made.
"""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from typing import TYPE_CHECKING, Final

import numpy as np
import scipy.linalg

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import require_between
from touchfield.sources.recordings.contact_trace import CurlFree, covariances

if TYPE_CHECKING:
    from collections.abc import Sequence


_MOST_BYTES: Final = 1 << 29
_SHORTLIST: Final = 48
_TARGETS: Final = 1500
_AT_ONCE: Final = 32  # points measured already
_PILOT: Final = 600
_LENGTHS: Final = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8)  # of the extent of the field
_NOISES: Final = (1e-3, 3e-2)


def most_candidates(count: int) -> int:
    """The most candidates for so many points: the factor takes half a gigabyte at most."""
    return min(20_000, _MOST_BYTES // (72 * max(1, count)))


@dataclass(frozen=True)
class Kernel:
    """A covariance: length, metres, and the variance of noise over that of a component of the field."""

    length_m: float
    noise: float


class _Posterior:
    """Knowledge at candidates once some are measured."""

    def __init__(self, points_m: Float64s, kernel: Kernel, most: int) -> None:
        require_between(1, len(points_m), points=most)
        self.points, self.noise = points_m / kernel.length_m, kernel.noise
        self.factor = np.empty((3 * most, 3 * len(points_m)))  # rows of L^-1 K
        self.variances = np.full(len(points_m), 3.0)  # traces of each own 3 x 3
        self.chosen: list[int] = []

    def columns(self, at: Sequence[int] | Int64s, places: slice = slice(None)) -> Float64s:
        """Covariances of the places with those `at`, as they are now, float64 [3 m, 3 s]."""
        prior, known = covariances(self.points[places], self.points[at]), self.factor[: 3 * len(self.chosen)]
        if not len(known):
            return prior
        rows = known.reshape(len(known), len(self.points), 3)[:, places].reshape(len(known), -1)
        return np.asarray(prior - (known[:, _components(at)].T @ rows).T)

    def own(self, at: Int64s) -> Float64s:
        """Covariances of what is measured at each of these places, noise in it, float64 [s, 3, 3]."""
        rows = self.factor[: 3 * len(self.chosen)].reshape(3 * len(self.chosen), len(self.points), 3)[:, at]
        return np.asarray((1 + self.noise) * np.eye(3) - np.einsum("ksi,ksj->sij", rows, rows))

    def take(self, some: Sequence[int]) -> Float64s:
        """Measure candidates: the rows that are added to the factor, [3 s, 3 m], and their corner [3 s, 3 s]."""
        columns, count = self.columns(some), 3 * len(some)
        corner = np.linalg.cholesky(columns[_components(some)] + self.noise * np.eye(count))
        rows = scipy.linalg.solve_triangular(corner, columns.T, lower=True)
        at = 3 * len(self.chosen)
        self.factor[at : at + count] = rows
        self.variances -= (rows**2).reshape(count, -1, 3).sum(axis=(0, 2))
        self.chosen += some
        return np.concatenate([rows, corner], axis=1)


def _components(at: Sequence[int] | Int64s) -> Int64s:
    """Places of the three components of each of some points."""
    return (3 * np.asarray(at)[:, None] + np.arange(3)).reshape(-1)


def variance_points(
    points_m: Float64s, count: int, kernel: Kernel, measured: int = 0
) -> tuple[Int64s, Float64s]:
    """Candidates, each the one of greatest variance once those before it are measured, int64 [count], and the
    variance that each had, the sum over three components, of a field of variance 1. `points_m` float64 [m,
    3]; the first `measured` of them are known already. InvalidArgument if there are fewer candidates.
    """
    require_between(1, len(points_m) - measured, points=count)
    known = _Posterior(points_m, kernel, measured + count)
    for first in range(0, measured, _AT_ONCE):
        known.take(range(first, min(first + _AT_ONCE, measured)))
    found = np.empty(count)
    for n in range(count):
        open_ = known.variances.copy()
        open_[known.chosen] = -np.inf
        best = int(np.argmax(open_))
        found[n] = known.variances[best]
        known.take([best])
    return np.array(known.chosen[measured:], np.int64), found


def error_points(
    points_m: Float64s, forces_n: Float64s, count: int, kernel: Kernel, targets: int = _TARGETS
) -> Int64s:
    """Points of a known field, each the one after which least of it is missed; int64 [count].

    `points_m`, `forces_n` float64 [m, 3]. `targets`: how many places the error is added up over.
    """
    known, rng = _Posterior(points_m, kernel, count), np.random.default_rng(0)
    left, places = forces_n.reshape(-1).copy(), slice(None, None, -(-len(points_m) // targets))
    for _ in range(count):
        size = (left**2).reshape(-1, 3).sum(axis=1)
        size[known.chosen] = -1.0
        drawn = np.flatnonzero(size >= 0)
        first = np.argpartition(size, -min(_SHORTLIST, len(drawn)))[-min(_SHORTLIST, len(drawn)) :]
        some = np.union1d(first, rng.choice(drawn, min(_SHORTLIST, len(drawn)), replace=False))
        columns = known.columns(some, places).reshape(-1, len(some), 3)
        steps = np.linalg.solve(known.own(some), left.reshape(-1, 3)[some][..., None])[..., 0]
        change = np.einsum("tsi,si->ts", columns, steps)
        gains = 2 * left.reshape(-1, 3)[places].reshape(-1) @ change - (change**2).sum(axis=0)
        best = int(some[np.argmax(gains)])
        rows = known.take([best])
        step = scipy.linalg.solve_triangular(rows[:, -3:], left[3 * best : 3 * best + 3], lower=True)
        left -= step @ rows[:, :-3]
    return np.array(known.chosen, np.int64)


def best_kernel(points_m: Float64s, forces_n: Float64s, count: int) -> Kernel:
    """The kernel with which so many points miss least of a known field [m, 3], by trying on some of its
    places.
    """
    some = slice(None, None, -(-len(points_m) // max(_PILOT, min(4 * count, len(points_m)))))
    points, forces = points_m[some], forces_n[some]
    extent, tried = float(np.ptp(points, axis=0).max()) or 1.0, []
    for kernel in (Kernel(part * extent, noise) for part in _LENGTHS for noise in _NOISES):
        chosen = error_points(points, forces, min(count, len(points)), kernel, _PILOT // 2)
        back = CurlFree.through(points[chosen], forces[chosen], kernel.length_m, kernel.noise).forces_n(
            points
        )
        tried.append((float(((back - forces) ** 2).sum()), kernel))
    return min(tried, key=itemgetter(0))[1]
