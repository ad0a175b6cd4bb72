"""The guess that is sent before a frame: a spline where it is smooth, columns where it is a solid with steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from touchfield.codec.touch import columns_fit, spline_fit
from touchfield.codec.touch.guess import COLUMNS, SPLINE
from touchfield.codec.touch.promise import agreement

if TYPE_CHECKING:
    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.medium import ForceField

__all__ = ["fit"]

_LEAST: Final = 0.5
"""The share of voxels at which a guess worth a trial keeps the rule; in mode "nmse" any is worth one."""

_ENOUGH: Final = 0.75
"""The share from which on no other kind is looked for."""

_FINENESS: Final = 0.35
"""Error of a guess in mode "nmse", steps: errors of a guess are many alike, and finer ones are told cheaply."""


def fit(
    frame: ForceField, lattice: Lattice, limits: Limits, spec: TouchSpec
) -> tuple[tuple[bytes, FixedField] | None, float]:
    """The bytes of a guess and what `guess.synthesise` makes of them, or None; and how often it keeps the rule.

    Parameters
    ----------
    frame : ForceField
    lattice : Lattice
        Gives the unit.
    limits : Limits
        The mask that the guess should keep where it can.
    spec : TouchSpec
    """
    best, most = None, 0.0 if limits.free else _LEAST
    if limits.free:
        limits = limits._replace(free=False, k=0.0, f0=_FINENESS * lattice.floor)
    for kind, provider in ((SPLINE, spline_fit.fit), (COLUMNS, columns_fit.fit)):
        found = provider(frame, lattice, limits) if most < _ENOUGH else None
        if found is not None:
            share = agreement(frame, found[1], lattice.unit_n, spec)
            if share >= most:
                best, most = (bytes([kind]) + found[0], found[1]), share
    return best, most if best else 0.0
