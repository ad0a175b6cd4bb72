"""Snapshots as a few modes: proper orthogonal decomposition (paper section 6.1, "dimensionality reduction").

A snapshot is a vector of d values: a frame on the union of its bricks, or one brick. The best r vectors to write n of
them with are the first r right singular vectors of the n x d matrix, and the squared error is the sum of the squared
singular values beyond r (Eckart and Young), known before anything is written. What is decomposed is the smaller Gram
matrix, added up in float64 block by block: n x n of few long snapshots (Sirovich's method of snapshots, `pod`),
d x d of many short ones (`klt`). It squares the singular values, so that those below 1e-8 of the first are noise;
modes of them are not made.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import frozen

_BLOCK_VALUES: Final = 1 << 21
_NOISE: Final = 1e-15  # of the greatest eigenvalue, times the order of the matrix: below it there is rounding only


@dataclass(frozen=True)
class Modes:
    """Orthonormal modes of n snapshots of d values.

    mean : float64 [d]; what is taken from each snapshot first, zeros where nothing is.
    basis : float64 [d, r]; a mode a column, the one with most energy first.
    values : float64 [min(n, d)]; all singular values of the snapshots less the mean, descending.
    count : int; n.
    """

    mean: Float64s
    basis: Float64s
    values: Float64s
    count: int

    @property
    def rank(self) -> int:
        """r."""
        return int(self.basis.shape[1])

    @property
    def energy(self) -> float:
        """Sum of the squares of all snapshots, the mean in them."""
        return float(self.values @ self.values + self.count * (self.mean @ self.mean))

    def first(self, rank: int) -> Modes:
        """The same with the first modes alone."""
        return Modes(self.mean, self.basis[:, :rank], self.values, self.count)

    def coefficients(self, snapshots: ArrayLike) -> Float64s:
        """What each mode has in each snapshot, float64 [n, r], of snapshots [n, d]."""
        given = _matrix(snapshots)
        if given.shape[1] != len(self.mean):
            raise InvalidArgument(
                "snapshots", f"{given.shape[1]} values each", f"{len(self.mean)}, as the modes have"
            )
        found = np.zeros((len(given), self.rank))
        step = max(1, _BLOCK_VALUES // max(1, len(given)))
        for a in range(0, len(self.mean), step):
            found += (given[:, a : a + step] - self.mean[a : a + step]) @ self.basis[a : a + step]
        return found

    def rebuild(self, coefficients: ArrayLike) -> Float64s:
        """The snapshots of these coefficients [n, r], float64 [n, d]."""
        given = np.asarray(coefficients, np.float64)
        if given.ndim != 2 or given.shape[1] != self.rank:
            raise InvalidArgument("coefficients", f"shape {given.shape}", f"[n, {self.rank}], one for each mode")
        return given @ self.basis.T + self.mean

    def tail(self, rank: int) -> float:
        """Sum of the squared errors of all snapshots when the first `rank` modes are kept, known beforehand."""
        return float((self.values[rank:] ** 2).sum())

    def rank_for(self, decibels: float) -> int:
        """The fewest modes whose error is at most so many decibels of the snapshots' energy, such as -30."""
        left = np.append(np.cumsum((self.values**2)[::-1])[::-1], 0.0)  # added from the small ones
        return int(np.argmax(left <= 10 ** (decibels / 10) * self.energy))


def pod(snapshots: NDArray[Any] | Iterable[NDArray[Any]], rank: int | None = None, centred: bool = False) -> Modes:
    """The modes of n snapshots that are longer than many: the Gram matrix is n x n.

    snapshots : float [n, d], or blocks of their columns [n, d_b], which are gone through twice and made float64 one
        at a time (an iterator's are kept, as they are, for the second time).
    rank : int, optional; modes to make, at most as many as are above the rounding; all of those without it.
    centred : bool; the mean snapshot is taken from each first.
    Raises `InvalidArgument` if the shapes do not fit, a value is not finite, or the rank is none of 1 to n.
    """
    blocks = list(snapshots) if isinstance(snapshots, Iterator) else snapshots
    gram, means = np.zeros((0, 0)), []
    for block in _pieces(blocks):
        means.append(block.mean(axis=0) if centred else np.zeros(block.shape[1]))
        apart = block - means[-1]
        gram = apart @ apart.T if not len(gram) else gram + apart @ apart.T
    if not len(gram):
        raise InvalidArgument("snapshots", "no value", "at least one snapshot of one value")
    squares, left, kept = _decomposed(gram, rank)
    weights = left[:, :kept] / np.sqrt(squares[:kept])
    mean = np.concatenate(means)
    basis, at = np.empty((len(mean), kept)), 0
    for block in _pieces(blocks):
        stop = at + block.shape[1]
        basis[at:stop] = (block - mean[at:stop]).T @ weights
        at = stop
    values = np.sqrt(squares[: min(len(gram), len(mean))])
    return Modes(frozen(mean), frozen(_orthonormal(basis)), frozen(values), len(gram))


def klt(rows: Iterable[NDArray[Any]], rank: int | None = None) -> Modes:
    """The modes of many short snapshots, blocks [m, d] that are gone through once; rank and errors as of `pod`."""
    gram, count = np.zeros((0, 0)), 0
    for given in rows:
        block = _matrix(given).astype(np.float64)
        if len(gram) and len(gram) != block.shape[1]:
            raise InvalidArgument("snapshots", f"{block.shape[1]} values each", f"{len(gram)}, as the first have")
        gram = block.T @ block if not len(gram) else gram + block.T @ block
        count += len(block)
    if not count:
        raise InvalidArgument("snapshots", "none", "at least one")
    squares, right, kept = _decomposed(gram, rank)
    values = np.sqrt(squares[: min(count, len(gram))])
    return Modes(frozen(np.zeros(len(gram))), frozen(np.ascontiguousarray(right[:, :kept])), frozen(values), count)


def _matrix(given: ArrayLike) -> NDArray[Any]:
    array = np.asarray(given)
    if array.ndim != 2 or array.dtype.kind not in "fiu":
        raise InvalidArgument("snapshots", f"{array.dtype} of shape {array.shape}", "numbers [n, d]")
    if not math.isfinite(float(np.abs(array).max(initial=0.0))):
        raise InvalidArgument("snapshots", "a value that is not finite", "finite numbers")
    return array


def _pieces(snapshots: Any) -> Iterator[Float64s]:
    """The columns as float64, a few at a time."""
    is_matrix = isinstance(snapshots, np.ndarray)
    count = None
    for given in (snapshots,) if is_matrix else snapshots:
        block = _matrix(given)
        if count is not None and len(block) != count:
            raise InvalidArgument("snapshots", f"{len(block)} in a block", f"{count}, as in the first")
        count = len(block)
        step = max(1, _BLOCK_VALUES // max(1, count))
        for a in range(0, block.shape[1] if count else 0, step):
            yield block[:, a : a + step].astype(np.float64)


def _decomposed(gram: Float64s, rank: int | None) -> tuple[Float64s, Float64s, int]:
    """Eigenvalues, descending, none negative; eigenvectors as columns; the modes of those asked that can be made."""
    found, vectors = scipy.linalg.eigh(gram, overwrite_a=True, check_finite=False)
    squares, vectors = np.maximum(found[::-1], 0.0), vectors[:, ::-1]
    kept = int(np.count_nonzero(squares > _NOISE * len(squares) * squares[0]))
    if rank is not None and not 1 <= rank <= len(squares):
        raise InvalidArgument("rank", f"{rank}", f"1 to {len(squares)}")
    return squares, vectors, min(kept, rank or kept)


def _orthonormal(basis: Float64s) -> Float64s:
    """The columns made orthonormal, each against those before it, as small ones hardly are: Cholesky's QR, twice."""
    for _ in range(2):
        if basis.shape[1]:
            corner = scipy.linalg.cholesky(basis.T @ basis)
            basis = scipy.linalg.solve_triangular(corner, basis.T, trans="T", overwrite_b=True).T
    return basis
