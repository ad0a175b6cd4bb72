"""A force field that passes near given forces and is the gradient of a potential (so has no curl).

The potential is a Gaussian process with k(r) = exp(-r^2 / 2 l^2); the forces, its gradient, then have the covariance
(I - d d^T / l^2) exp(-r^2 / 2 l^2) / l^2 for two points d apart (Macedo and Castro 2010; Fuselier and Wright 2017 for
the same kernel as an interpolant). What a probe met of friction is no gradient: it is left over, and the share of the
forces that is missed where they were left out (leave-one-out, in closed form) tells how much that is.

Length and noise are those that miss least of what was left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["CurlFree", "thinned_contacts"]

MOST_POINTS: Final = 350
_LENGTHS: Final = (1.0, 1.5, 2.25, 3.5, 5.0)
_NOISES: Final = (1e-4, 1e-2, 0.1, 0.5)
_AT_ONCE: Final = 1024


@dataclass(frozen=True)
class CurlFree:
    """The field of some forces.

    Attributes
    ----------
    points_m : float64 [n, 3]
    weights : float64 [n, 3]
    length_m : float; l of the kernel.
    missed : float; RMS of what each force is missed by where it was left out, over that of the forces.
    """

    points_m: Float64s
    weights: Float64s
    length_m: float
    missed: float

    @classmethod
    def fitted(cls, points_m: Float64s, forces_n: Float64s, spacing_m: float) -> CurlFree:
        """The field that misses least of forces left out.

        Parameters
        ----------
        points_m, forces_n : float64 [n, 3]; At least 4, some force among them, no two points in one place.
        spacing_m : float; How far points are apart, of which the lengths that are tried are multiples.
        """
        size = float(np.sqrt(np.mean(forces_n**2)))
        target = forces_n.reshape(-1) / size
        best: CurlFree | None = None
        for length in _LENGTHS:
            length_m = length * spacing_m
            kernel = _covariances(points_m / length_m)
            for noise in _NOISES:
                inverse = np.linalg.inv(kernel + noise * np.eye(len(target)))
                solved = inverse @ target
                own = inverse.reshape(len(points_m), 3, len(points_m), 3)[
                    np.arange(len(points_m)), :, np.arange(len(points_m))
                ]
                left = np.linalg.solve(own, solved.reshape(-1, 3, 1))
                missed = float(np.sqrt(np.mean(left**2)))
                if best is None or missed < best.missed:
                    best = cls(points_m, size * solved.reshape(-1, 3), length_m, missed)
        assert best is not None
        return best

    def forces_n(self, at_m: Float64s, reach_m: float = math.inf) -> Float64s:
        """Newtons, float64 [n, 3], at points, float64 [n, 3]; 0 where no point of the field is within reach."""
        from touchfield.sources.kernels.contacts import add_forces

        at, points = np.ascontiguousarray(at_m / self.length_m), self.points_m / self.length_m
        found = np.zeros((len(at), 3))
        reach = reach_m / self.length_m
        for_chunks(add_forces, len(at), at, points, self.weights, reach, found, chunk=_AT_ONCE)
        return found


def _covariances(points: Float64s) -> Float64s:
    """l^2 times the covariances of the forces at points in lengths of the kernel, float64 [3 n, 3 n]."""
    apart = points[:, None] - points[None]
    near = np.exp(-0.5 * (apart**2).sum(axis=-1))
    both = (np.eye(3) - apart[..., :, None] * apart[..., None, :]) * near[..., None, None]
    merged: Float64s = both.transpose(0, 2, 1, 3).reshape(3 * len(points), 3 * len(points))
    return merged


def thinned_contacts(points_m: Float64s, forces_n: Float64s) -> tuple[Float64s, Float64s, float]:
    """Means over the cells of a lattice, as fine as `MOST_POINTS` allow.

    Returns
    -------
    points_m, forces_n : float64 [m, 3]; m at most `MOST_POINTS`.
    spacing_m : float; The side of a cell, or less where the points lie closer than that.
    """
    low = points_m.min(axis=0)
    extent = float((points_m.max(axis=0) - low).max())
    side = extent / 256
    while True:
        cells = np.floor((points_m - low) / side).astype(np.int64)
        _, of, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        if len(counts) <= MOST_POINTS:
            break
        side *= 1.15
    of = of.reshape(-1)
    sums = (np.zeros((len(counts), 3)), np.zeros((len(counts), 3)))
    for total, values in zip(sums, (points_m, forces_n)):
        np.add.at(total, of, values)
    means = tuple(total / counts[:, None] for total in sums)
    return means[0], means[1], side
