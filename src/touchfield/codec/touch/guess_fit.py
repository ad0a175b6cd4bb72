"""The guess that is sent before a frame: a spline where it is smooth, columns where it is a solid with steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from touchfield.codec.touch import columns_fit, spline_fit
from touchfield.codec.touch.guess import COLUMNS, SPLINE

if TYPE_CHECKING:
    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField

__all__ = ["fit"]


def fit(frame: ForceField, lattice: Lattice, limits: Limits) -> tuple[bytes, FixedField] | None:
    """The bytes of a guess, and what `guess.synthesise` makes of them; None where no guess pays."""
    for kind, provider in ((SPLINE, spline_fit.fit), (COLUMNS, columns_fit.fit)):
        found = provider(frame, lattice, limits)
        if found is not None:
            return bytes([kind]) + found[0], found[1]
    return None
