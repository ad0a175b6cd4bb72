"""Collects the bricks that have a force from batches of candidates, so that memory follows the field and not
the candidates.

A source finds more candidates than bricks with a force: near a scan on a fine lattice, four times as many.
"""

from __future__ import annotations

import numpy as np

from touchfield.arrays import Bools, Float32s, Int32s
from touchfield.medium.budget import BYTES_PER_BRICK, require_memory
from touchfield.medium.grid import BRICK

BATCH_BRICKS = 1 << 13
"""Candidates of a batch: 50 MB of forces, enough for many threads."""


class BrickBuffer:
    """Bricks and their forces, which grow by batches."""

    def __init__(self) -> None:
        self._count = 0
        self._bricks = np.empty((0, 3), np.int32)
        self._forces_n = np.empty((0, BRICK, BRICK, BRICK, 3), np.float32)

    def append(self, bricks: Int32s, forces_n: Float32s, has_force: Bools) -> None:
        """Copy the bricks of a batch that have a force.

        bricks : int32 [n, 3]; in the order of the field.
        forces_n : float32 [n, 8, 8, 8, 3]; newtons.
        has_force : bool [n].
        Raises `InvalidArgument` if the bricks so far take more than `memory_budget_bytes`.
        """
        selected = np.flatnonzero(has_force)
        first, self._count = self._count, self._count + len(selected)
        if self._count > len(self._bricks):
            needed = self._count * BYTES_PER_BRICK
            require_memory("force field", f"{self._count} bricks or more", needed)
            if first == 0:  # often the only batch: no page is cleared, nor copied twice
                self._bricks, self._forces_n = bricks[selected], forces_n[selected]
                return
            self._resize(self._count + self._count // 8)
        # the mode "raise" would make a copy
        np.take(bricks, selected, 0, self._bricks[first : self._count], "clip")
        np.take(forces_n, selected, 0, self._forces_n[first : self._count], "clip")

    def take(self) -> tuple[Int32s, Float32s]:
        """Return bricks int32 [n, 3] and forces float32 [n, 8, 8, 8, 3]. Call it once, at the end."""
        if self._count < len(self._bricks):
            self._resize(self._count)
        return self._bricks, self._forces_n

    def _resize(self, capacity: int) -> None:
        # in place: systems that move pages need no second copy of the forces
        self._bricks.resize((capacity, 3), refcheck=False)
        self._forces_n.resize((capacity, BRICK, BRICK, BRICK, 3), refcheck=False)
