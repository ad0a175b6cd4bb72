"""The relative lattice of the coder `touch`: steps that grow with the force, so that a cell fits the mask's ball.

Paper section 4.2 (a Weber law of what is felt) and docs/theory.md 31: a cell of half diagonal max(F_0, k |F|).
Everything here is in whole units (`fixed_field`), and travels in the segment.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Lattice"]


@dataclass(frozen=True)
class Lattice:
    """Steps of the residual along and across the prediction.

    At a force of `a` units the step along it is max(`floor`, `rate` * a / 65536), and across it
    max(`cross_floor`, `cross_rate` * a / 65536); at least 1. Rates of 0 make it uniform.

    Attributes
    ----------
    unit_n : float
        Newtons of one unit; a float32.
    floor, cross_floor : int
        Units, 1 to 65535.
    rate, cross_rate : int
        0 to 131071: steps of up to twice the force.
    """

    unit_n: float
    floor: int
    rate: int
    cross_floor: int
    cross_rate: int
