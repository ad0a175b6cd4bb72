"""Chooses the few points of a static field from whose forces the whole field can be interpolated (paper
section 6.2).

A static field has no modes over time, but a field of forces has no curl, which a curl-free kernel expresses
(`CurlFree`). Two criteria:

* variance: the next point leaves the smallest mean posterior variance of the Gaussian process, which is
  independent of the forces (D. A. Cohn, Neural Networks 9, 1996). It tells a robot or a hand where to record
  next. The point of largest variance, the usual choice, lies at the rim of the candidates, where a
  measurement tells least about the rest.
* error: for known forces, the next point is the one that leaves the smallest error of the field. Candidates
  are those with the largest residual and as many random ones ("stochastic greedy", Mirzasoleiman et al.
  2015); the error is summed over an evenly spaced subset of the points.

Both add rows to a Cholesky factor point by point: the time of a step is proportional to the number of
candidates times the number of chosen points, and no matrix of all candidates is built.
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


_MAX_BYTES: Final = 1 << 29
_SHORTLIST: Final = 48
_VARIANCE_SHORTLIST: Final = 64
_VARIANCE_POINTS: Final = 600
_ERROR_POINTS: Final = 1500
_AT_ONCE: Final = 32  # number of known points that are added to the factor at once
_PILOT: Final = 600
_LENGTHS: Final = (0.025, 0.05, 0.1, 0.2, 0.4, 0.8)  # lengths to try, as fractions of the field's extent
_NOISES: Final = (1e-3, 3e-2)


def max_candidates(count: int) -> int:
    """Maximum number of candidates for `count` points.

    It limits the factor to half a gigabyte.
    """
    return min(20_000, _MAX_BYTES // (72 * max(1, count)))


@dataclass(frozen=True)
class Kernel:
    """Parameters of a covariance.

    `length_m`: length, metres. `noise`: variance of the noise over that of a component of the field.
    """

    length_m: float
    noise: float


class _Posterior:
    """Posterior covariances of the candidates, given those that are measured."""

    def __init__(self, points_m: Float64s, kernel: Kernel, max_points: int) -> None:
        require_between(1, len(points_m), points=max_points)
        self.points, self.noise = points_m / kernel.length_m, kernel.noise
        self.factor = np.empty((3 * max_points, 3 * len(points_m)))  # rows of L^-1 K
        self.variances = np.full(len(points_m), 3.0)  # trace of the 3 x 3 covariance of each candidate
        self.selected: list[int] = []

    def columns(self, at: Sequence[int] | Int64s, subset: slice = slice(None)) -> Float64s:
        """Posterior covariances of candidates with those `at`, float64 [3 m, 3 s].

        `subset` selects the m candidates of the rows.
        """
        prior, factor = (
            covariances(self.points[subset], self.points[at]),
            self.factor[: 3 * len(self.selected)],
        )
        if not len(factor):
            return prior
        rows = factor.reshape(len(factor), len(self.points), 3)[:, subset].reshape(len(factor), -1)
        return np.asarray(prior - (factor[:, _components(at)].T @ rows).T)

    def measurement_covariances(self, at: Int64s) -> Float64s:
        """Return the covariances of measurements at candidates, with noise.

        float64 [s, 3, 3].
        """
        rows = self.factor[: 3 * len(self.selected)].reshape(3 * len(self.selected), len(self.points), 3)[
            :, at
        ]
        return np.asarray((1 + self.noise) * np.eye(3) - np.einsum("ksi,ksj->sij", rows, rows))

    def measure(self, candidates: Sequence[int]) -> Float64s:
        """Measure candidates and update the posterior.

        Returns their rows of the factor, [3 s, 3 m], followed by the corner [3 s, 3 s].
        """
        columns, count = self.columns(candidates), 3 * len(candidates)
        corner = np.linalg.cholesky(columns[_components(candidates)] + self.noise * np.eye(count))
        rows = scipy.linalg.solve_triangular(corner, columns.T, lower=True)
        at = 3 * len(self.selected)
        self.factor[at : at + count] = rows
        self.variances -= (rows**2).reshape(count, -1, 3).sum(axis=(0, 2))
        self.selected += candidates
        return np.concatenate([rows, corner], axis=1)


def _components(at: Sequence[int] | Int64s) -> Int64s:
    """Indices of the three components of each point."""
    return (3 * np.asarray(at)[:, None] + np.arange(3)).reshape(-1)


def variance_points(
    points_m: Float64s, count: int, kernel: Kernel, measured: int = 0
) -> tuple[Int64s, Float64s]:
    """Choose points greedily by the mean posterior variance that they leave.

    `points_m`: candidates, float64 [m, 3]; the first `measured` of them are known already. The next point is
    the best of those with the largest variance and of as many random ones; the mean is that of an evenly
    spaced subset of the candidates. Returns the indices of the points, int64 [count], and the variance that
    each had once those before it were measured, float64 [count]: the sum over three components of a field of
    variance 1. InvalidArgument if there are fewer candidates.
    """
    require_between(1, len(points_m) - measured, points=count)
    posterior, rng = _Posterior(points_m, kernel, measured + count), np.random.default_rng(0)
    for first in range(0, measured, _AT_ONCE):
        posterior.measure(range(first, min(first + _AT_ONCE, measured)))
    subset, found = slice(None, None, -(-len(points_m) // _VARIANCE_POINTS)), np.empty(count)
    for n in range(count):
        shortlist = _shortlist(posterior.variances, posterior.selected, _VARIANCE_SHORTLIST, rng)
        columns = posterior.columns(shortlist, subset).reshape(-1, len(shortlist), 3)
        solved = np.linalg.solve(posterior.measurement_covariances(shortlist), columns.transpose(1, 2, 0))
        best = int(shortlist[np.argmax(np.einsum("tsi,sit->s", columns, solved))])
        found[n] = posterior.variances[best]
        posterior.measure([best])
    return np.array(posterior.selected[measured:], np.int64), found


def _shortlist(sizes: Float64s, selected: list[int], length: int, rng: np.random.Generator) -> Int64s:
    """Return the open candidates with the largest sizes, and as many random ones, sorted."""
    sizes = sizes.copy()
    sizes[selected] = -np.inf
    is_open = np.flatnonzero(sizes > -np.inf)
    length = min(length, len(is_open))
    largest = np.argpartition(sizes, -length)[-length:]
    return np.union1d(largest, rng.choice(is_open, length, replace=False))


def error_points(
    points_m: Float64s, forces_n: Float64s, count: int, kernel: Kernel, targets: int = _ERROR_POINTS
) -> Int64s:
    """Choose points of a known field greedily by the remaining error; int64 [count].

    `points_m`, `forces_n`: float64 [m, 3]. `targets`: approximate number of points over which the error is
    summed.
    """
    posterior, rng = _Posterior(points_m, kernel, count), np.random.default_rng(0)
    residual, subset = forces_n.reshape(-1).copy(), slice(None, None, -(-len(points_m) // targets))
    for _ in range(count):
        sizes = (residual**2).reshape(-1, 3).sum(axis=1)
        shortlist = _shortlist(sizes, posterior.selected, _SHORTLIST, rng)
        columns = posterior.columns(shortlist, subset).reshape(-1, len(shortlist), 3)
        steps = np.linalg.solve(
            posterior.measurement_covariances(shortlist), residual.reshape(-1, 3)[shortlist][..., None]
        )[..., 0]
        change = np.einsum("tsi,si->ts", columns, steps)
        gains = 2 * residual.reshape(-1, 3)[subset].reshape(-1) @ change - (change**2).sum(axis=0)
        best = int(shortlist[np.argmax(gains)])
        rows = posterior.measure([best])
        step = scipy.linalg.solve_triangular(rows[:, -3:], residual[3 * best : 3 * best + 3], lower=True)
        residual -= step @ rows[:, :-3]
    return np.array(posterior.selected, np.int64)


def best_kernels(points_m: Float64s, forces_n: Float64s, count: int) -> list[Kernel]:
    """Return kernels by the error that `count` points leave of a known field, the best one first.

    `points_m`, `forces_n`: [m, 3]. All are tried on a subset of the points, which ranks them only roughly.
    """
    subset = slice(None, None, -(-len(points_m) // max(_PILOT, min(4 * count, len(points_m)))))
    points, forces = points_m[subset], forces_n[subset]
    extent, tried = float(np.ptp(points, axis=0).max()) or 1.0, []
    for kernel in (Kernel(part * extent, noise) for part in _LENGTHS for noise in _NOISES):
        indices = error_points(points, forces, min(count, len(points)), kernel, _PILOT // 2)
        estimate = CurlFree.through(points[indices], forces[indices], kernel.length_m, kernel.noise).forces_n(
            points
        )
        tried.append((float(((estimate - forces) ** 2).sum()), kernel))
    return [kernel for _, kernel in sorted(tried, key=itemgetter(0))]
