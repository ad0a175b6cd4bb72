"""The fewest points that tell the coefficients of modes: Q-DEIM, a point at a time (paper section 6.2, "multi-view").

A point measures a vector, three rows of the modes U at once, so that the pivots of the QR factorisation are blocks
(Drmac and Gugercin 2016; Manohar et al. 2018). The next point is the one whose rows are farthest from the span of
those chosen. Once they span all coefficients, a further point is that which lessens most the sum of the variances of
the coefficients, trace((P^T U)^T W^2 P^T U)^-1. What the modes cannot write at a point is its noise: W has one over
its deviation there, so that points are sought where the modes tell most of what is felt. With U orthonormal, what
weighted least squares rebuilds is off by at most ||(W P^T U)^+ W|| times what the modes cannot write: `bound`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import scipy.linalg

from touchfield.arrays import Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import frozen

if TYPE_CHECKING:
    from touchfield.reduction.modes import Modes


_LEAST_NOISE: Final = 0.1  # of the mean over all points
_WEAK: Final = 0.1  # of the first row of a point: weaker ones count only where points are too few
_FLAT: Final = 1e-12  # of the first pivot, squared: rows below it lie in the span of those chosen


@dataclass(frozen=True)
class ModePoints:
    """Points whose forces tell the coefficients of modes.

    modes : Modes; of snapshots of d / 3 points, x, y and z of a point side by side.
    points : int64 [n]; which of these points, in the order they were chosen.
    weights : float64 [n]; W, how much each counts; all the same without it.
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
        """||(W P^T U)^+ W||, 1 or more: by how much what the modes cannot write may grow."""
        return max(1.0, float(scipy.linalg.svdvals(self._solver())[0]))

    def coefficients(self, measured_n: Float64s) -> Float64s:
        """What each mode has in each snapshot by least squares, float64 [m, r], of measured forces [m, n, 3]."""
        rows = self.rows
        apart = np.reshape(measured_n, (-1, len(rows))) - self.modes.mean[rows]
        return np.asarray(apart @ self._solver().T)

    def _solver(self) -> Float64s:
        weights = np.ones(len(self.rows)) if self.weights is None else np.repeat(self.weights, 3)
        return np.asarray(np.linalg.pinv(self.modes.basis[self.rows] * weights[:, None]) * weights)


def mode_points(modes: Modes, count: int, missed_n2: Float64s | None = None) -> ModePoints:
    """The points that tell the coefficients of some modes best, chosen one after the other.

    count : int; a third of the number of modes or more, at most the points there are.
    missed_n2 : float64 [d / 3]; mean square of what the modes cannot write at each point; alike without it.
    Raises `InvalidArgument` if the count is out of that range, or modes of d values are no modes of vectors.
    """
    length, rank = modes.basis.shape
    if length % 3:
        raise InvalidArgument("modes", f"{length} values", "three for each point")
    if not -(-rank // 3) <= count <= length // 3:
        raise InvalidArgument("points", f"{count}", f"{-(-rank // 3)} to {length // 3} for {rank} modes")
    weights = np.ones(length // 3)
    if missed_n2 is not None and missed_n2.any():
        weights = 1 / np.sqrt(missed_n2 / missed_n2.mean() + _LEAST_NOISE)
    blocks = modes.basis.reshape(-1, 3, rank) * weights[:, None, None]
    chosen = _pivots(blocks, count)
    if len(chosen) < count:
        _add_for_variance(blocks, chosen, count)
    return ModePoints(modes, frozen(np.array(chosen, np.int64)), frozen(weights[chosen]))


def _pivots(blocks: Float64s, count: int) -> list[int]:
    """Points by block-pivoted QR, until they span all columns."""
    rank = blocks.shape[2]
    left, spanned = blocks.copy(), 0
    chosen: list[int] = []
    squares = np.einsum("pkr,pkr->p", left, left)
    first = squares.max()
    while spanned < rank and len(chosen) < count:
        best = int(np.argmax(squares))
        if not squares[best] > _FLAT * first:
            raise InvalidArgument("modes", f"{rank} of rank {spanned}", "modes that are independent")
        _, sizes, rows = scipy.linalg.svd(left[best], full_matrices=False)
        needed = -(-(rank - spanned) // (count - len(chosen)))  # of each point that is left
        rows = rows[(sizes > _WEAK * sizes[0]) | (np.arange(len(sizes)) < needed) & (sizes**2 > _FLAT * first)]
        left -= (left @ rows.T) @ rows
        squares = np.einsum("pkr,pkr->p", left, left)
        chosen.append(best)
        squares[chosen] = 0.0
        spanned += len(rows)
    return chosen


def _add_for_variance(blocks: Float64s, chosen: list[int], count: int) -> None:
    """Further points, each that which lessens the trace of the inverse of the Gram matrix most."""
    rows = blocks[chosen].reshape(-1, blocks.shape[2])
    inverse = np.linalg.inv(rows.T @ rows)
    while len(chosen) < count:
        half = blocks @ inverse  # [p, 3, r]
        inner = np.eye(3) + half @ blocks.transpose(0, 2, 1)
        gains = np.einsum("pij,pji->p", np.linalg.inv(inner), half @ half.transpose(0, 2, 1))
        gains[chosen] = -np.inf
        best = int(np.argmax(gains))
        inverse -= half[best].T @ np.linalg.solve(inner[best], half[best])
        chosen.append(best)
