"""Limits each force of a field to what a device can exert, and keeps its direction."""

from __future__ import annotations

import numpy as np

from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.medium import BRICK, ForceField


def limit_forces(field: ForceField, force_max_n: float, floor_n: float = 0.0) -> ForceField:
    """Shorten forces above `force_max_n` to it, keeping their direction, and drop those below `floor_n`.

    No force of the result is longer than `force_max_n`, and the function is idempotent.
    """
    forces, has_force = np.empty_like(field.forces_n), np.zeros(len(field.bricks), np.bool_)
    flat, out = (array.reshape(-1, BRICK**3, 3) for array in (field.forces_n, forces))
    for_chunks(native.limit_bricks, len(flat), flat, force_max_n, floor_n, out, has_force, chunk=64)
    return ForceField(field.grid, field.bricks[has_force], forces[has_force])
