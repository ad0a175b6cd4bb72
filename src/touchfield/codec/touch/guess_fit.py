"""The guess that is sent before a frame: a spline where it is smooth, columns where it is a solid with steps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.touch import columns_fit, spline_fit
from touchfield.codec.touch.guess import COLUMNS, SPLINE
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField

__all__ = ["fit", "kept"]

_LEAST_KEPT: Final = 0.75
"""Of the forces by a guess that is worth a trial; measured: 0.82 was 2 % dearer to 13 % cheaper than none."""


def fit(frame: ForceField, lattice: Lattice, limits: Limits) -> tuple[bytes, FixedField] | None:
    """The bytes of a guess, and what `guess.synthesise` makes of them; None where no guess pays.

    Parameters
    ----------
    frame : ForceField
    lattice : Lattice
        Gives the unit.
    limits : Limits
        The mask that the guess should keep where it can.
    """
    for kind, provider in ((SPLINE, spline_fit.fit), (COLUMNS, columns_fit.fit)):
        found = provider(frame, lattice, limits)
        if found is not None and kept(frame, found[1], lattice, limits) >= _LEAST_KEPT:
            return bytes([kind]) + found[0], found[1]
    return None


def kept(frame: ForceField, guess: FixedField, lattice: Lattice, limits: Limits) -> float:
    """The share of a frame's forces, at least one, that a guess is within the mask of."""
    own, keys = brick_keys(frame.grid, guess.bricks), brick_keys(frame.grid, frame.bricks)
    good = count = 0
    for forces, key, slot in zip(frame.forces_n, keys, np.searchsorted(own, keys), strict=True):
        exact = forces / np.float32(lattice.unit_n)
        square = np.einsum("...i,...i", exact, exact)
        if slot < len(own) and own[slot] == key:
            exact -= guess.vectors[slot]
        k, f0 = (0.0, lattice.floor) if limits.free else (limits.k, limits.f0)
        within = np.einsum("...i,...i", exact, exact) <= np.maximum(k * np.sqrt(square), f0) ** 2
        good += int(np.count_nonzero(within & (square > 0)))
        count += int(np.count_nonzero(square))
    return good / max(count, 1)
