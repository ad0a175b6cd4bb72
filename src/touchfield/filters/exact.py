"""The field that a lattice samples, at any point of the hand: the mapping M without low-pass and lattice."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from touchfield.filters.placement import Placement
    from touchfield.sources.analytic_scene import AnalyticScene
    from touchfield.sources.profile import ForceProfile

    Float64s = NDArray[np.float64]

__all__ = ["exact_forces"]


def exact_forces(
    scene: AnalyticScene, placement: Placement, profile_hand: ForceProfile, force_max_n: float
) -> Callable[[Float64s], Float64s]:
    """The force of shapes with a formula at points of the hand, clipped to F_max.

    profile_hand : ForceProfile; the force law in hand metres.
    Returns callable: ``forces(points_m float64 [n, 3]) -> newtons float64 [n, 3]``.
    """
    law = profile_hand.rescaled(placement.scale)
    offset_m = np.asarray(placement.offset_m)

    def forces(points_m: Float64s) -> Float64s:
        found = scene.forces_n(points_m / placement.scale + offset_m, law)
        size = np.linalg.norm(found, axis=1, keepdims=True)
        clipped: Float64s = found * (force_max_n / np.maximum(size, force_max_n))
        return clipped

    return forces
