"""A field without curl through forces at points: a Gaussian process whose potential has k(r) = exp(-r^2 / 2 l^2).

The forces, the potential's gradient, then have the covariance (I - d d^T / l^2) exp(-r^2 / 2 l^2) / l^2 for two
points d apart (Macedo and Castro 2010; Fuselier and Wright 2017 for the same kernel as an interpolant). What each
force is missed by where it was left out is known in closed form (leave-one-out). Of forces that were recorded,
length and noise are those that miss least.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.parallel import for_chunks

_LENGTHS: Final = (1.0, 1.5, 2.25, 3.5, 5.0)
_NOISES: Final = (1e-4, 1e-2, 0.1, 0.5)
_AT_ONCE: Final = 1024


@dataclass(frozen=True)
class CurlFree:
    """The field of some forces."""

    points_m: Float64s  # float64 [n, 3]
    weights: Float64s  # float64 [n, 3]
    length_m: float  # l of the kernel
    missed: float  # RMS of what each force is missed by where it was left out, over that of the forces
    noise: float  # variance of what is no such field, over that of the field
    scale_n: float  # standard deviation of a component where nothing is known: as the forces have it

    @classmethod
    def through(cls, points_m: Float64s, forces_n: Float64s, length_m: float, noise: float) -> CurlFree:
        """The field of forces, `points_m` and `forces_n` float64 [n, 3], with this kernel."""
        return cls._solved(points_m, forces_n, covariances(points_m / length_m), length_m, noise)

    @classmethod
    def fitted(cls, points_m: Float64s, forces_n: Float64s, spacing_m: float) -> CurlFree:
        """The field that misses least of forces left out.

        `points_m`, `forces_n` float64 [n, 3]: at least 4, some force among them, no two points in one place;
        `spacing_m` float: how far points are apart, of which the lengths that are tried are multiples.
        """
        fits = []
        for length_m in (length * spacing_m for length in _LENGTHS):
            kernel = covariances(points_m / length_m)
            fits += [cls._solved(points_m, forces_n, kernel, length_m, noise) for noise in _NOISES]
        return min(fits, key=lambda one: one.missed)

    @classmethod
    def _solved(
        cls, points_m: Float64s, forces_n: Float64s, kernel: Float64s, length_m: float, noise: float
    ) -> CurlFree:
        count, size = len(points_m), float(np.sqrt(np.mean(forces_n**2))) or 1.0
        target = forces_n.reshape(-1) / size
        inverse = np.linalg.inv(kernel + noise * np.eye(len(target)))
        solved = inverse @ target
        own = inverse.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)]
        left = np.linalg.solve(own, solved.reshape(-1, 3, 1))
        missed = float(np.sqrt(np.mean(left**2)))
        return cls(points_m, size * solved.reshape(-1, 3), length_m, missed, noise, size / math.sqrt(1 + noise))

    def forces_n(self, at_m: Float64s, reach_m: float = math.inf) -> Float64s:
        """Newtons, float64 [n, 3], at points, float64 [n, 3]; 0 where no point of the field is within reach."""
        from touchfield.sources.kernels.points import add_forces

        at, points = np.ascontiguousarray(at_m / self.length_m), self.points_m / self.length_m
        forces = np.zeros((len(at), 3))
        reach = reach_m / self.length_m
        for_chunks(add_forces, len(at), at, points, self.weights, reach, forces, chunk=_AT_ONCE)
        return forces


def covariances(points: Float64s, others: Float64s | None = None) -> Float64s:
    """Covariances of the forces at points and at others (or the same), all in lengths of the kernel.

    Float64 [3 n, 3 m] of float64 [n, 3] and [m, 3]; times l^2, so that a point's own are 1.
    """
    apart = points[:, None] - (points if others is None else others)[None]
    near = np.exp(-0.5 * (apart**2).sum(axis=-1))
    both = (np.eye(3) - apart[..., :, None] * apart[..., None, :]) * near[..., None, None]
    merged: Float64s = both.transpose(0, 2, 1, 3).reshape(3 * apart.shape[0], 3 * apart.shape[1])
    return merged
