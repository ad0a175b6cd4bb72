"""Represents vectors (*snapshots*, such as the frames of a medium) as sums of a few *modes*, found by
singular value decomposition, and finds few points whose forces determine the coefficients.

Paper sections 6.1 and 6.2. A snapshot is a vector of d values: a frame on the union of its bricks, or one
brick. The r vectors that best represent n snapshots are the first r right singular vectors of the n x d
matrix. The squared error is the sum of the squared singular values beyond r (Eckart and Young), and is
therefore known in advance. The smaller Gram matrix is decomposed, summed in float64 block by block: n x n for
few long snapshots (Sirovich's method of snapshots, `pod`), d x d for many short ones (`klt`). It squares the
singular values, so that values below about 1e-8 of the first are noise; no modes are made of these.

Points are chosen one at a time by Q-DEIM. A point measures a vector, three rows of the modes U at once, so
that the pivots of the QR factorisation are blocks (Drmac and Gugercin 2016; Manohar et al. 2018). The next
point is the one whose rows are farthest from the span of those chosen. Once these span all coefficients, a
further point is the one that most reduces the sum of the variances of the coefficients, trace((P^T U)^T W^2
P^T U)^-1. The part of the field at a point that the modes cannot represent acts as noise. W is the reciprocal
of its standard deviation, so that points are preferred where the modes explain most of the force. With U
orthonormal, the error of the weighted least-squares reconstruction is at most ||(W P^T U)^+ W|| times the
part that the modes cannot represent: `bound`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument, require_between
from touchfield.medium.field import frozen

_BLOCK_VALUES: Final = 1 << 21
_NOISE: Final = (
    1e-15  # times the largest eigenvalue and the order of the matrix: smaller eigenvalues are rounding
)
_MIN_NOISE: Final = 0.1  # added to the noise of a point, relative to the mean over all points
_WEAK: Final = 0.1  # of the strongest row of a point: weaker rows count only if there are too few points
_FLAT: Final = 1e-12  # of the first pivot, squared: smaller rows lie in the span of those chosen


@dataclass(frozen=True)
class Modes:
    """Orthonormal modes of n snapshots of d values.

    `basis` float64 [d, r]: a mode in each column, the one with the most energy first. `values` float64
    [min(n, d)]: all singular values of the snapshots, descending. `count`: n.
    """

    basis: Float64s
    values: Float64s
    count: int

    @property
    def rank(self) -> int:
        """The number of modes, r."""
        return int(self.basis.shape[1])

    @property
    def energy(self) -> float:
        """Sum of the squares of all snapshots."""
        return self.tail(0)

    def first(self, rank: int) -> Modes:
        """Return the first `rank` modes."""
        return replace(self, basis=self.basis[:, :rank])

    def coefficients(self, snapshots: ArrayLike) -> Float64s:
        """Return the coefficient of each mode in snapshots [n, d], float64 [n, r]."""
        matrix = _matrix(snapshots)
        if matrix.shape[1] != len(self.basis):
            found, expected = matrix.shape[1], len(self.basis)
            raise InvalidArgument("snapshots", f"{found} values each", f"{expected}, as the modes have")
        return np.asarray(
            sum((matrix[:, p] @ self.basis[p] for p in _pieces(matrix)), np.zeros((1, self.rank)))
        )

    def rebuild(self, coefficients: ArrayLike) -> Float64s:
        """Return the snapshots of coefficients [n, r], float64 [n, d]."""
        matrix = np.asarray(coefficients, np.float64)
        if matrix.ndim != 2 or matrix.shape[1] != self.rank:
            raise InvalidArgument(
                "coefficients", f"shape {matrix.shape}", f"[n, {self.rank}], one for each mode"
            )
        return matrix @ self.basis.T

    def tail(self, rank: int) -> float:
        """Return the sum of squared errors of all snapshots with the first `rank` modes."""
        return float((self.values[rank:] ** 2).sum())

    def rank_for(self, decibels: float) -> int:
        """Return the fewest modes whose relative error is at most `decibels`, such as -30.

        The error is relative to the energy.
        """
        tail_energy = np.append(np.cumsum((self.values**2)[::-1])[::-1], 0.0)  # summed from the smallest
        return int(np.argmax(tail_energy <= 10 ** (decibels / 10) * self.energy))


def pod(snapshots: ArrayLike, rank: int | None = None) -> Modes:
    """Return the modes of n long snapshots [n, d], from the n x n Gram matrix.

    `rank`: number of modes, all by default. A few columns are converted to float64 at a time. InvalidArgument
    if there is no value, one is not finite, or the rank is outside 1 to n.
    """
    matrix = _matrix(snapshots)
    if not matrix.size:
        raise InvalidArgument("snapshots", "no value", "at least one snapshot of one value")
    gram = np.zeros((len(matrix), len(matrix)))
    for p in _pieces(matrix):
        block = matrix[:, p].astype(np.float64)
        gram += block @ block.T
    squares, vectors, mode_count = _decompose(gram, rank)
    weights = vectors[:, :mode_count] / np.sqrt(squares[:mode_count])
    basis = np.concatenate([matrix[:, p].astype(np.float64).T @ weights for p in _pieces(matrix)])
    if mode_count:  # orthonormalise by Cholesky QR; modes of small singular values are hardly orthogonal
        corner = scipy.linalg.cholesky(basis.T @ basis)
        basis = scipy.linalg.solve_triangular(corner, basis.T, trans="T", overwrite_b=True).T
    return Modes(frozen(basis), frozen(np.sqrt(squares[: min(matrix.shape)])), len(matrix))


def klt(rows: Iterable[NDArray[Any]], rank: int | None = None) -> Modes:
    """Return the modes of many short snapshots, from the d x d Gram matrix.

    `rows`: blocks [m, d], each read once. Rank and errors are as in `pod`.
    """
    gram, count = np.zeros((0, 0)), 0
    for part in rows:
        block = _matrix(part).astype(np.float64)
        if len(gram) and len(gram) != block.shape[1]:
            raise InvalidArgument(
                "snapshots", f"{block.shape[1]} values each", f"{len(gram)}, as the first have"
            )
        gram = block.T @ block if not len(gram) else gram + block.T @ block
        count += len(block)
    if not count:
        raise InvalidArgument("snapshots", "none", "at least one")
    squares, vectors, mode_count = _decompose(gram, rank)
    values = np.sqrt(squares[: min(count, len(gram))])
    return Modes(frozen(np.ascontiguousarray(vectors[:, :mode_count])), frozen(values), count)


def _matrix(snapshots: ArrayLike) -> NDArray[Any]:
    array = np.asarray(snapshots)
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise InvalidArgument("snapshots", f"{array.dtype} of shape {array.shape}", "numbers [n, d]")
    if not math.isfinite(float(np.abs(array).max(initial=0.0))):
        raise InvalidArgument("snapshots", "a value that is not finite", "finite numbers")
    return array


def _pieces(snapshots: NDArray[Any]) -> list[slice]:
    """Slices of a few columns at a time."""
    step = max(1, _BLOCK_VALUES // max(1, len(snapshots)))
    return [slice(a, a + step) for a in range(0, snapshots.shape[1], step)]


def _decompose(gram: Float64s, rank: int | None) -> tuple[Float64s, Float64s, int]:
    """Return eigenvalues and eigenvectors of a Gram matrix, and the number of modes.

    Eigenvalues descend and are not negative; eigenvectors are columns. The number counts those above the
    noise, up to `rank`.
    """
    eigenvalues, vectors = scipy.linalg.eigh(gram, overwrite_a=True, check_finite=False)
    squares, vectors = np.maximum(eigenvalues[::-1], 0.0), vectors[:, ::-1]
    mode_count = int(np.count_nonzero(squares > _NOISE * len(squares) * squares[0]))
    if rank is not None:
        require_between(1, len(squares), rank=rank)
    return squares, vectors, min(mode_count, rank or mode_count)


# -- points


@dataclass(frozen=True)
class ModePoints:
    """Points whose forces determine the coefficients of modes.

    `modes`: modes of snapshots of d / 3 points; x, y and z of a point are adjacent. `points` int64 [n]:
    indices of the chosen points, in the order of their choice. `weights` float64 [n]: W, the weight of each;
    equal weights if None.
    """

    modes: Modes
    points: Int64s
    weights: Float64s | None = None

    @property
    def rows(self) -> Int64s:
        """The rows of the modes that are measured, int64 [3 n]."""
        return (3 * self.points[:, None] + np.arange(3)).reshape(-1)

    @property
    def bound(self) -> float:
        """||(W P^T U)^+ W||, 1 or more.

        It is the largest amplification of the part outside the modes.
        """
        return max(1.0, float(scipy.linalg.svdvals(self._solver())[0]))

    def coefficients(self, measured_n: Float64s) -> Float64s:
        """Coefficients of each mode by least squares, float64 [m, r].

        `measured_n`: measured forces [m, n, 3].
        """
        return np.asarray(np.reshape(measured_n, (-1, len(self.rows))) @ self._solver().T)

    def _solver(self) -> Float64s:
        weights = np.ones(len(self.rows)) if self.weights is None else np.repeat(self.weights, 3)
        return np.asarray(np.linalg.pinv(self.modes.basis[self.rows] * weights[:, None]) * weights)


def mode_points(modes: Modes, count: int, missed_n2: Float64s | None = None) -> ModePoints:
    """Choose greedily the points that best determine the coefficients of modes.

    `count`: from a third of the number of modes to the number of points. `missed_n2` float64 [d / 3]: mean
    square of what the modes cannot represent at each point; equal if None. InvalidArgument if the count is
    out of that range, or the modes are not modes of vectors.
    """
    length, rank = modes.basis.shape
    if length % 3:
        raise InvalidArgument("modes", f"{length} values", "three for each point")
    if not -(-rank // 3) <= count <= length // 3:
        raise InvalidArgument("points", f"{count}", f"{-(-rank // 3)} to {length // 3} for {rank} modes")
    weights = np.ones(length // 3)
    if missed_n2 is not None and missed_n2.any():
        weights = 1 / np.sqrt(missed_n2 / missed_n2.mean() + _MIN_NOISE)
    blocks = modes.basis.reshape(-1, 3, rank) * weights[:, None, None]
    selected = _pivots(blocks, count)
    if len(selected) < count:
        _add_for_variance(blocks, selected, count)
    return ModePoints(modes, frozen(np.array(selected, np.int64)), frozen(weights[selected]))


def _pivots(blocks: Float64s, count: int) -> list[int]:
    """Points by block-pivoted QR, until they span all columns."""
    rank = blocks.shape[2]
    residual, spanned = blocks.copy(), 0
    selected: list[int] = []
    squares = np.einsum("pkr,pkr->p", residual, residual)
    first = squares.max()
    while spanned < rank and len(selected) < count:
        best = int(np.argmax(squares))
        if not squares[best] > _FLAT * first:
            raise InvalidArgument("modes", f"{rank} of rank {spanned}", "modes that are independent")
        _, sizes, rows = scipy.linalg.svd(residual[best], full_matrices=False)
        needed = -(-(rank - spanned) // (count - len(selected)))  # rows needed from each remaining point
        rows = rows[
            (sizes > _WEAK * sizes[0]) | (np.arange(len(sizes)) < needed) & (sizes**2 > _FLAT * first)
        ]
        residual -= (residual @ rows.T) @ rows
        squares = np.einsum("pkr,pkr->p", residual, residual)
        selected.append(best)
        squares[selected] = 0.0
        spanned += len(rows)
    return selected


def _add_for_variance(blocks: Float64s, selected: list[int], count: int) -> None:
    """Add points, each of which most reduces the trace of the inverse Gram matrix."""
    rows = blocks[selected].reshape(-1, blocks.shape[2])
    inverse = np.linalg.inv(rows.T @ rows)
    while len(selected) < count:
        half = blocks @ inverse  # [p, 3, r]
        inner = np.eye(3) + half @ blocks.transpose(0, 2, 1)
        gains = np.einsum("pij,pji->p", np.linalg.inv(inner), half @ half.transpose(0, 2, 1))
        gains[selected] = -np.inf
        best = int(np.argmax(gains))
        inverse -= half[best].T @ np.linalg.solve(inner[best], half[best])
        selected.append(best)
