"""Force laws: how strongly a surface pushes, guides or attracts a point at a signed distance from it (paper
section 4). All scenes compute their forces by one.

The paper gives no formula, nor does its reference [21]. Every law acts along the outward surface normal n and
depends on the signed distance phi alone (negative inside, d = -phi the penetration depth), so that F = f(phi)
n. f is piecewise linear and may jump. Kernels evaluate such pieces, so a new law needs no new kernel. Lengths
of a law are metres of *hand* motion: a wall of 500 N/m feels the same whether the scene is a room or a coin.
Laws can be summed: ``penalty+proximity``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, require_positive


@dataclass(frozen=True)
class ForceProfile:
    """f(phi), piecewise linear: on each piece f = intercept + slope * phi.

    f is zero elsewhere.

    pieces : tuple of (low_m, high_m, intercept_n, slope_n_per_m); A piece applies to low_m < phi <= high_m.
        The pieces are in ascending order and do not overlap; the first low_m may be -inf.
    surface_damping_n_s_per_m : float; Damping b of a moving surface: where f acts, b times the velocity of
        the surface is added to the force, so that with the receiver's own damping b (paper section 3.2) F_d =
        -b (v_hand - v_surface). A static scene adds nothing.
    """

    pieces: tuple[tuple[float, float, float, float], ...]
    surface_damping_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        if not self.pieces:
            raise InvalidArgument("force profile", "no piece", "at least one")
        end = -np.inf
        for low, high, intercept, slope in self.pieces:
            if not (end <= low < high < np.inf and np.isfinite(intercept) and np.isfinite(slope)):
                raise InvalidArgument(
                    "force profile", f"piece {(low, high, intercept, slope)}", "ascending pieces"
                )
            end = high
        if not (self.surface_damping_n_s_per_m >= 0 and np.isfinite(self.surface_damping_n_s_per_m)):
            found = repr(self.surface_damping_n_s_per_m)
            raise InvalidArgument("surface_damping_n_s_per_m", found, "0 or a positive number")

    def __call__(self, phi_m: ArrayLike) -> Float64s:
        """Return f, newtons, positive along the outward normal, at signed distances in metres."""
        phi = np.asarray(phi_m, np.float64)
        amplitude = np.zeros_like(phi)
        for low, high, intercept, slope in self.pieces:
            is_on_piece = (phi > low) & (phi <= high)
            amplitude[is_on_piece] = intercept + slope * phi[is_on_piece]
        return amplitude

    @property
    def low_m(self) -> float:
        """Signed distance below which there is no force; -inf for a solid."""
        return self.pieces[0][0]

    @property
    def high_m(self) -> float:
        """Signed distance above which there is no force."""
        return self.pieces[-1][1]

    def table(self) -> Float64s:
        """Return the pieces for a kernel, float64 [pieces, 4]: low, high, intercept, slope."""
        return np.array(self.pieces, np.float64)

    def rescaled(self, scale: float) -> ForceProfile:
        """Return the profile g(phi) = f(scale * phi).

        It is for distances in a space that is `scale` times smaller.
        """
        pieces = tuple((a / scale, b / scale, c, s * scale) for a, b, c, s in self.pieces)
        return ForceProfile(pieces, self.surface_damping_n_s_per_m * scale)

    def __add__(self, other: ForceProfile) -> ForceProfile:
        both = (*self.pieces, *other.pieces)
        edges = sorted({edge for piece in both for edge in piece[:2]})
        pieces = []
        for low, high in zip(edges, edges[1:], strict=False):
            inside = [p for p in both if p[0] <= low and high <= p[1]]
            if inside:
                pieces.append((low, high, sum(p[2] for p in inside), sum(p[3] for p in inside)))
        return ForceProfile(
            tuple(pieces), max(self.surface_damping_n_s_per_m, other.surface_damping_n_s_per_m)
        )


# -- laws --------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class LawSpec:
    """A force law and its parameters.

    Parameters
    ----------
    law : str; A name of `LAWS`, or several joined by "+".
    stiffness_n_per_m : float; K, newtons per metre of hand motion; a Phantom Omni can render about 1000 to
        2300.
    force_max_n : float; F_max, newtons, where the law saturates.
    thickness_m : float or None; Thickness of a wall behind the surface; ``inf`` for a solid; None for
        the default of the source.
    band_m : float; Reach of the proximity and magnetic laws, metres.
    surface_damping_n_s_per_m : float; Damping b of a moving surface (see `ForceProfile`); 0 for none.
    """

    law: str = "penalty"
    stiffness_n_per_m: float = 500.0
    force_max_n: float = 3.3
    thickness_m: float | None = None
    band_m: float = 0.004
    surface_damping_n_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        for name in self.names:
            if name not in LAWS:
                raise InvalidArgument("force law", repr(name), f"one of {', '.join(LAWS)}, joined by +")
        require_positive(
            **{name: getattr(self, name) for name in ("stiffness_n_per_m", "force_max_n", "band_m")}
        )
        if self.thickness_m is not None and not self.thickness_m > 0:
            raise InvalidArgument(
                "thickness_m", repr(self.thickness_m), "a positive length, or inf for a solid"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The laws to sum."""
        return tuple(self.law.split("+"))

    @property
    def saturation_m(self) -> float:
        """F_max / K: the depth at which the force reaches F_max.

        It is the default thickness of a wall.
        """
        return self.force_max_n / self.stiffness_n_per_m


def penalty(spec: LawSpec, thickness_m: float) -> ForceProfile:
    """Return the law of a wall: F = min(K d, F_max) n for 0 < d < thickness.

    It pushes a penetrating point out.
    """
    k, f_max, knee = spec.stiffness_n_per_m, spec.force_max_n, spec.saturation_m
    ramp = (-min(knee, thickness_m), 0.0, 0.0, -k)
    if thickness_m <= knee:
        return ForceProfile((ramp,))
    return ForceProfile(((-thickness_m, -knee, f_max, 0.0), ramp))


def proximity(spec: LawSpec, thickness_m: float) -> ForceProfile:
    """Return a guide in front of a surface: F = F_max/4 (1 - phi/band) n.

    It acts for 0 < phi < band.
    """
    peak = spec.force_max_n / 4
    return ForceProfile(((0.0, spec.band_m, peak, -peak / spec.band_m),))


def magnetic(spec: LawSpec, thickness_m: float) -> ForceProfile:
    """Return an attraction from both sides: F = -min(K |phi|, F_max) sgn(phi) n.

    It fades to 0 at |phi| = band.

    The force is zero on the surface, grows like a spring up to half the band (or up to F_max, if that is
    nearer) and falls linearly to zero at the edge of the band, as does the magnet of CHAI3D.
    """
    band = spec.band_m
    knee = min(spec.saturation_m, band / 2)
    peak = spec.stiffness_n_per_m * knee
    fall = peak / (band - knee)
    middle = (-knee, knee, 0.0, -spec.stiffness_n_per_m)
    return ForceProfile(((-band, -knee, fall * band, fall), middle, (knee, band, -fall * band, fall)))


LAWS: dict[str, Callable[[LawSpec, float], ForceProfile]] = {
    "penalty": penalty,
    "proximity": proximity,
    "magnetic": magnetic,
}
"""The registered laws; a law is a function of a spec and a thickness."""


def profile_of(spec: LawSpec, natural_thickness_m: float) -> ForceProfile:
    """Return the profile of `spec`.

    `natural_thickness_m` is the default of the source (inf for a solid).
    """
    thickness = natural_thickness_m if spec.thickness_m is None else spec.thickness_m
    total, *others = (LAWS[name](spec, thickness) for name in spec.names)
    for profile in others:
        total = total + profile
    return replace(total, surface_damping_n_s_per_m=spec.surface_damping_n_s_per_m)
