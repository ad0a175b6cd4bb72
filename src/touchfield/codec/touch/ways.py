"""What a frame may be predicted from: nothing, the frame before, blocks of it moved, or a surface.

All is weighed before anything is coded, by the share of voxels at which a guess keeps the rule already.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.body import GuessKind
from touchfield.codec.touch.models import guess_provider

if TYPE_CHECKING:
    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.medium import ForceField

__all__ = ["REACHING", "Guess", "Way", "made", "may_be_solid"]

REACHING: Final = 0.2
"""Share of the columns of bricks that reach the inner border, from which on a solid is possible."""

_LOOKED_AT: Final = 64
"""Bricks whose forces tell the main axis."""


@dataclass(frozen=True)
class Guess:
    """A field made for a frame from some bytes."""

    kind: GuessKind
    data: bytes
    field: FixedField


@dataclass(frozen=True)
class Way:
    """Whether the frame model knows the previous frame, and the guess it is given."""

    inter: bool
    guess: Guess | None = None


def made(kind: GuessKind, function: str, *arguments: Any) -> Guess | None:
    """The guess of the module that makes this kind; None where it has none, or there is no such module."""
    provider = guess_provider(kind.name.lower())
    found = None if provider is None else getattr(provider, function)(*arguments)
    return None if found is None else Guess(kind, *found)


def may_be_solid(frame: ForceField, least: float = REACHING) -> bool:
    """Whether a surface could tell the frame: quick, from its bricks and some of their forces.

    Behind the surface of a solid there is force down to the inner border of the grid (`surface`); behind that of a
    wall there is not. `least` is the share of the columns of bricks that reach it.
    """
    if not len(frame.bricks):
        return False
    forces = frame.forces_n[:: -(-len(frame.bricks) // _LOOKED_AT)]
    total = forces.reshape(-1, 3).sum(axis=0, dtype=np.float64)
    axis = int(np.abs(total).argmax())
    inner = 0 if total[axis] > 0 else frame.grid.brick_shape[axis] - 1
    across = [c for c in range(3) if c != axis]
    columns = (
        frame.bricks[:, across[0]].astype(np.int64) * frame.grid.brick_shape[across[1]] + frame.bricks[:, across[1]]
    )
    reaching = int(np.count_nonzero(frame.bricks[:, axis] == inner))
    return reaching >= least * len(np.unique(columns))
