"""Limits each force of a field to what a device can exert, and keeps its direction."""

from __future__ import annotations

import numpy as np

from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.medium import BRICK, ForceField
from touchfield.medium.brick_buffer import BATCH_BRICKS, BrickBuffer


def limit_forces(field: ForceField, force_max_n: float, floor_n: float = 0.0) -> ForceField:
    """Shorten forces above `force_max_n` to it, keeping their direction, and drop those below `floor_n`.

    No force of the result is longer than `force_max_n`, and the function is idempotent.
    """
    buffer, flat = BrickBuffer(), field.forces_n.reshape(-1, BRICK**3, 3)
    for start in range(0, len(flat), BATCH_BRICKS):
        part = flat[start : start + BATCH_BRICKS]
        out, has_force = np.empty_like(part), np.zeros(len(part), np.bool_)
        for_chunks(native.limit_bricks, len(part), part, force_max_n, floor_n, out, has_force, chunk=64)
        bricks = field.bricks[start : start + BATCH_BRICKS]
        buffer.append(bricks, out.reshape(-1, BRICK, BRICK, BRICK, 3), has_force)
    return ForceField(field.grid, *buffer.take())
