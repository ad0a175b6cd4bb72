"""The rule of an encoder: how what was asked for becomes a lattice, and the error that may be made.

A cell with three equal edges s has the half diagonal s sqrt(3) / 2: it lies within the ball of the mask where
s <= 2 / sqrt(3) max(F_0, k |F|) (docs/theory.md 31). Along and across differ in mode "mask-direction", whose ball is
a disc of directions times a span of lengths.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.touch.fixed_field import TOP
from touchfield.codec.touch.lattice import FLOOR_LIMIT, LEAST_UNIFORM, RATE_LIMIT, SMALLEST_UNIT_N, Lattice

if TYPE_CHECKING:
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.spec import TouchSpec

__all__ = ["lattice_for", "limits_for"]

_CELL: Final = 1.17
"""Edge of a cell over max(F_0, k |F|).

2 / sqrt(3) = 1.1547 fits without any rounding. Of a somewhat larger cell only the corners are beyond the ball, and
an encoder goes to another point there; from 1.25 on too many voxels are sent apart.
"""

_SPAN: Final = 1.8
"""The same along the force in mode "mask-direction", whose span of lengths alone would take 2; measured."""

_SPAN_FLOOR: Final = 1.25
"""The same where F_0 rules there, a ball again for short forces."""

_DISC: Final = 0.97 * math.sqrt(2)
"""Edge of a square cell over the radius of the disc that holds it, with room for rounding."""

_THRIFT: Final = 0.1
"""What a bit may cost in mode "nmse", squared steps; measured."""


def lattice_for(spec: TouchSpec, longest_n: float) -> Lattice:
    """The lattice of a segment whose longest force has `longest_n` newtons.

    A uniform step is at least `LEAST_UNIFORM` units, 1/3120 of the longest force.
    """
    unit_n = float(np.float32(max(longest_n / TOP, SMALLEST_UNIT_N)))
    if spec.mode == "nmse":
        step = max(_floor(spec.step_n / unit_n), LEAST_UNIFORM)
        return Lattice(unit_n, step, 0, step, 0)
    floor, rate = _floor(_CELL * spec.f0_n / unit_n), _rate(_CELL * spec.k)
    if spec.mode == "mask":
        return Lattice(unit_n, floor, rate, floor, rate)
    cross_rate = _rate(_DISC * math.sin(math.radians(spec.direction_jnd_deg)))
    return Lattice(unit_n, _floor(_SPAN_FLOOR * spec.f0_n / unit_n), _rate(_SPAN * spec.k), floor, cross_rate)


def limits_for(spec: TouchSpec, lattice: Lattice) -> Limits:
    """The error that the passes may make, in units of the lattice."""
    from touchfield.codec.touch.kernels.choice import Limits

    free = spec.mode == "nmse"
    sine = math.sin(math.radians(spec.direction_jnd_deg)) if spec.mode == "mask-direction" else 0.0
    f0 = lattice.floor * 0.5 if free else spec.f0_n / lattice.unit_n
    exact, thorough = spec.support == "exact", spec.effort == "max"
    return Limits(0.0 if free else spec.k, f0, sine, _THRIFT, free, exact, thorough)


def _floor(units: float) -> int:
    return int(min(max(units, 1), FLOOR_LIMIT - 1))


def _rate(share: float) -> int:
    return min(int(share * 65536), RATE_LIMIT - 1)
