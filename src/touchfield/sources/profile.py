"""The amplitude of a force as a function of the signed distance to a surface.

Every force law of touchfield acts along the surface normal n and depends on the signed distance phi alone
(negative inside), so that F = f(phi) n. f is piecewise linear and may jump; that is what kernels evaluate,
so a new law needs no new kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument


@dataclass(frozen=True)
class ForceProfile:
    """f(phi), piecewise linear: on each piece f = intercept + slope * phi; zero elsewhere.

    pieces : tuple of (low_m, high_m, intercept_n, slope_n_per_m); A piece holds for low_m < phi <= high_m. The
        pieces are in ascending order and do not overlap; the first low_m may be -inf.
    surface_damping_n_s_per_m : float; b of a moving surface: where f acts, b times the velocity of the surface is
        added to the force, so that with the receiver's own damping b (paper section 3.2) F_d = -b (v_hand -
        v_surface). A scene that stands still has nothing to add.
    """

    pieces: tuple[tuple[float, float, float, float], ...]
    surface_damping_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        if not self.pieces:
            raise InvalidArgument("force profile", "no piece", "at least one")
        end = -np.inf
        for low, high, intercept, slope in self.pieces:
            if not (end <= low < high < np.inf and np.isfinite(intercept) and np.isfinite(slope)):
                raise InvalidArgument("force profile", f"piece {(low, high, intercept, slope)}", "ascending pieces")
            end = high
        if not (self.surface_damping_n_s_per_m >= 0 and np.isfinite(self.surface_damping_n_s_per_m)):
            found = repr(self.surface_damping_n_s_per_m)
            raise InvalidArgument("surface_damping_n_s_per_m", found, "0 or a positive number")

    def __call__(self, phi_m: ArrayLike) -> Float64s:
        """f at signed distances in metres, newtons, positive along the outward normal."""
        phi = np.asarray(phi_m, np.float64)
        amplitude = np.zeros_like(phi)
        for low, high, intercept, slope in self.pieces:
            held = (phi > low) & (phi <= high)
            amplitude[held] = intercept + slope * phi[held]
        return amplitude

    @property
    def low_m(self) -> float:
        """Below this signed distance there is no force; -inf for a solid."""
        return self.pieces[0][0]

    @property
    def high_m(self) -> float:
        """Above this signed distance there is no force."""
        return self.pieces[-1][1]

    def table(self) -> Float64s:
        """The pieces for a kernel, float64 [pieces, 4]: low, high, intercept, slope."""
        return np.array(self.pieces, np.float64)

    def rescaled(self, scale: float) -> ForceProfile:
        """The profile of g(phi) = f(scale * phi): for distances measured in a space `scale` times smaller."""
        pieces = tuple((a / scale, b / scale, c, s * scale) for a, b, c, s in self.pieces)
        return ForceProfile(pieces, self.surface_damping_n_s_per_m * scale)

    def __add__(self, other: ForceProfile) -> ForceProfile:
        edges = sorted({e for p in (*self.pieces, *other.pieces) for e in p[:2]})
        pieces = []
        for low, high in zip(edges, edges[1:], strict=False):
            inside = [p for p in (*self.pieces, *other.pieces) if p[0] <= low and high <= p[1]]
            if inside:
                pieces.append((low, high, sum(p[2] for p in inside), sum(p[3] for p in inside)))
        return ForceProfile(tuple(pieces), max(self.surface_damping_n_s_per_m, other.surface_damping_n_s_per_m))
