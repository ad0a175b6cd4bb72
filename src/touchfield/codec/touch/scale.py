"""The lattice and the rule of a segment: how the mask becomes steps in whole units (docs/theory.md 31).

A cell with three equal edges s has the half diagonal s sqrt(3) / 2: it lies within the ball of the mask where
s <= 2 / sqrt(3) max(F_0, k |F|). Along and across differ in mode "mask-direction", whose ball is a disc of
directions times a span of lengths.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.touch.fixed_field import TOP
from touchfield.codec.touch.frame_model import Rule
from touchfield.codec.touch.lattice import Lattice

if TYPE_CHECKING:
    from touchfield.codec.touch.spec import TouchSpec

__all__ = [
    "CELL",
    "FLOOR_LIMIT",
    "LEAST_RATE",
    "LEAST_UNIFORM",
    "MOST_NEWTONS",
    "RATE_LIMIT",
    "SMALLEST_UNIT_N",
    "lattice_for",
    "rule_for",
]

CELL: Final = {"fast": 1.155, "default": 1.17, "max": 1.2}
"""Edge of a cell over max(F_0, k |F|), by effort.

2 / sqrt(3) = 1.1547 fits without any rounding. Of a somewhat larger cell only the corners are beyond the ball, and
an encoder goes to another point there: measured, the fewest bytes are at 1.2, and from 1.25 on too many voxels are
sent apart. Each of these costs another look at all frames, so that there shall be none in `fast`.
"""

_SPAN: Final = 1.8
"""The same along the force in mode "mask-direction", whose span of lengths alone would take 2; measured."""

_SPAN_FLOOR: Final = 1.25
"""The same where F_0 rules there, a ball again for short forces."""

_DISC: Final = 0.97 * math.sqrt(2)
"""Edge of a square cell over the radius of the disc that holds it, with room for rounding."""

LEAST_UNIFORM: Final = 21
LEAST_RATE: Final = 64
"""A lattice has a floor of at least `LEAST_UNIFORM` units or a rate of at least `LEAST_RATE`.

So its table of warped amplitudes has at most 200,000 entries, whatever a file asks for: 2^22 / floor where it is
uniform, and 2^20 / rate (1 + ln(4 rate / floor)) where it is not.
"""

FLOOR_LIMIT: Final = 1 << 16
RATE_LIMIT: Final = 1 << 17

SMALLEST_UNIT_N: Final = 2.0**-126
"""The least normal float32: products with it are exact on machines that flush smaller numbers, too."""

MOST_NEWTONS: Final = 2.0**120
"""No longer force is coded: three times as much is still a float32."""


def lattice_for(spec: TouchSpec, longest_n: float) -> Lattice:
    """The lattice of a segment whose longest force has `longest_n` newtons.

    A uniform step is at least `LEAST_UNIFORM` units, 1/3120 of the longest force.
    """
    unit_n = float(np.float32(max(longest_n / TOP, SMALLEST_UNIT_N)))
    if spec.mode == "nmse":
        step = max(_floor(spec.step_n / unit_n), LEAST_UNIFORM)
        return Lattice(unit_n, step, 0, step, 0)
    cell = CELL[spec.effort]
    floor, rate = _floor(cell * spec.f0_n / unit_n), _rate(cell * spec.k)
    if spec.mode == "mask":
        return Lattice(unit_n, floor, rate, floor, rate)
    cross_rate = _rate(_DISC * math.sin(math.radians(spec.direction_jnd_deg)))
    return Lattice(unit_n, _floor(_SPAN_FLOOR * spec.f0_n / unit_n), _rate(_SPAN * spec.k), floor, cross_rate)


def rule_for(spec: TouchSpec) -> Rule:
    """What error the frame models may make."""
    free = spec.mode == "nmse"
    sine = math.sin(math.radians(spec.direction_jnd_deg)) if spec.mode == "mask-direction" else 0.0
    return Rule(0.0 if free else spec.k, spec.f0_n, sine, free=free, movable=spec.support == "movable")


def _floor(units: float) -> int:
    return int(min(max(units, 1), FLOOR_LIMIT - 1))


def _rate(share: float) -> int:
    return min(int(share * 65536), RATE_LIMIT - 1)
