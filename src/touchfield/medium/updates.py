"""`FieldUpdate`: a field as another one with some of its bricks replaced, such as a static world with
a part that moves.

The base is then filtered once, and each frame only where it differs; the other bricks are copied.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from touchfield.arrays import Int32s, Int64s
from touchfield.medium.field import ForceField, brick_keys, bricks_of, slots_of
from touchfield.medium.grid import Grid


@dataclass(frozen=True, eq=False)
class FieldUpdate:
    """A field whose `bricks` are those of `part`, and whose other bricks are those of `base`.

    bricks : int32 [n, 3]; distinct, in any order; all bricks of `part` are among them.
    """

    base: ForceField
    bricks: Int32s
    part: ForceField

    @cached_property
    def field(self) -> ForceField:
        """The field as a whole; the base itself if nothing is replaced."""
        return with_bricks(self.base, self.bricks, self.part) if len(self.bricks) else self.base

    def on_grid(self, grid: Grid) -> FieldUpdate:
        """Return the update on a grid of the same shape (`ForceField.on_grid`)."""
        return replace(self, base=self.base.on_grid(grid), part=self.part.on_grid(grid))

    def between(self, bricks: Int32s) -> ForceField:
        """Return the field without the bricks that are not among `bricks`, int32 [m, 3]."""
        keys = brick_keys(self.base.grid, self.base.bricks)
        is_near = np.isin(keys, brick_keys(self.base.grid, bricks))
        return _merged(
            self.base, keys[is_near & ~np.isin(keys, brick_keys(self.base.grid, self.bricks))], self.part
        )


def with_bricks(field: ForceField, bricks: Int32s, part: ForceField) -> ForceField:
    """Return a field whose `bricks`, int32 [n, 3], are those of `part`.

    All bricks of `part` are among `bricks`; one that `part` does not have is left out.
    """
    keys = brick_keys(field.grid, field.bricks)
    return _merged(field, keys[~np.isin(keys, brick_keys(field.grid, bricks))], part)


def _merged(field: ForceField, kept: Int64s, part: ForceField) -> ForceField:
    """Return the bricks of `field` of the keys `kept`, ascending, and those of `part`, which are others."""
    part_keys = brick_keys(field.grid, part.bricks)
    merged: Int64s = np.sort(np.concatenate([kept, part_keys]))
    forces_n = np.empty((len(merged), *part.forces_n.shape[1:]), np.float32)
    if len(kept):  # one copy of all bricks: what it holds at those of `part` is written over
        slots = slots_of(brick_keys(field.grid, field.bricks), merged)
        np.take(field.forces_n, np.maximum(slots, 0), 0, forces_n, "clip")
    forces_n[np.searchsorted(merged, part_keys)] = part.forces_n
    return ForceField(field.grid, bricks_of(field.grid, merged), forces_n)
