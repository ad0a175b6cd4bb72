"""Force laws: how a surface pushes, guides or pulls a point (paper section 4; its [21] gives no formula).

A law is asked for in the metres that the *hand* moves: a wall of 500 N/m feels the same whether the scene is a
room or a coin. phi is the signed distance to the surface (negative inside), d = -phi the penetration depth, n
the outward normal. Laws may be summed: ``penalty+proximity``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from touchfield.errors import InvalidArgument, require_positive
from touchfield.sources.profile import ForceProfile


@dataclass(frozen=True)
class LawSpec:
    """A force law and its numbers, as asked for.

    Parameters
    ----------
    law : str; A name of `LAWS`, or several joined by "+".
    stiffness_n_per_m : float; K, newtons per metre of hand motion; the Phantom Omni can show about 1000 to 2300.
    force_max_n : float; F_max, newtons, where the law saturates.
    thickness_m : float or None; Thickness of a wall behind the surface; ``inf`` for a solid; None lets the source
        choose.
    band_m : float; Reach of the proximity and magnetic laws, metres.
    surface_damping_n_s_per_m : float; b of a moving surface, see `ForceProfile`; 0 for none.
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
        require_positive(**{name: getattr(self, name) for name in ("stiffness_n_per_m", "force_max_n", "band_m")})
        if self.thickness_m is not None and not self.thickness_m > 0:
            raise InvalidArgument("thickness_m", repr(self.thickness_m), "a positive length, or inf for a solid")

    @property
    def names(self) -> tuple[str, ...]:
        """The laws to sum."""
        return tuple(self.law.split("+"))

    @property
    def saturation_m(self) -> float:
        """F_max / K: the depth at which the force reaches its limit; the default thickness of a wall."""
        return self.force_max_n / self.stiffness_n_per_m


def penalty(spec: LawSpec, thickness_m: float) -> ForceProfile:
    """F = min(K d, F_max) n for 0 < d < thickness: a wall that pushes out what has entered it."""
    k, f_max, knee = spec.stiffness_n_per_m, spec.force_max_n, spec.saturation_m
    ramp = (-min(knee, thickness_m), 0.0, 0.0, -k)
    if thickness_m <= knee:
        return ForceProfile((ramp,))
    return ForceProfile(((-thickness_m, -knee, f_max, 0.0), ramp))


def proximity(spec: LawSpec, thickness_m: float) -> ForceProfile:
    """F = F_max/4 (1 - phi/band) n for 0 < phi < band: a gentle guide, felt before the surface is touched."""
    peak = spec.force_max_n / 4
    return ForceProfile(((0.0, spec.band_m, peak, -peak / spec.band_m),))


def magnetic(spec: LawSpec, thickness_m: float) -> ForceProfile:
    """F = -min(K |phi|, F_max) sgn(phi) n fading to 0 at |phi| = band: the surface attracts from both sides.

    The force is zero on the surface, grows as a spring up to half the band (or to F_max, if that is nearer)
    and falls linearly to zero at the band's edge, as the magnet of CHAI3D does.
    """
    band = spec.band_m
    knee = min(spec.saturation_m, band / 2)
    peak = spec.stiffness_n_per_m * knee
    fall = peak / (band - knee)
    return ForceProfile(
        (
            (-band, -knee, fall * band, fall),
            (-knee, knee, 0.0, -spec.stiffness_n_per_m),
            (knee, band, -fall * band, fall),
        )
    )


LAWS: dict[str, Callable[[LawSpec, float], ForceProfile]] = {
    "penalty": penalty,
    "proximity": proximity,
    "magnetic": magnetic,
}
"""The registered laws; a new one is a function of a spec and a thickness."""


def profile_of(spec: LawSpec, natural_thickness_m: float) -> ForceProfile:
    """The profile that `spec` asks for; `natural_thickness_m` is the source's own (inf for a solid)."""
    thickness = natural_thickness_m if spec.thickness_m is None else spec.thickness_m
    first, *rest = (LAWS[name](spec, thickness) for name in spec.names)
    for profile in rest:
        first = first + profile
    return replace(first, surface_damping_n_s_per_m=spec.surface_damping_n_s_per_m)
