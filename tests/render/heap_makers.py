"""A heap of boxes, with edges wherever a hand is pressed."""

from __future__ import annotations

import numpy as np
from proxy_makers import Vector, field_of

from touchfield.medium import ForceField
from touchfield.perception.hand_motion import points_on_surface
from touchfield.sources.shapes.shapes import Box

PRESSED_M = 0.006


def heap_of_boxes(seed: int = 0) -> ForceField:
    """Return the field of 24 boxes of 6 to 16 mm that lie through each other."""
    rng = np.random.default_rng(seed)
    boxes = [
        Box(
            tuple(rng.uniform(-0.02, 0.02, 3) * (1, 1, 0.3)),
            tuple(rng.uniform(0.003, 0.008, 3)),
            tuple(rng.uniform(0, 90, 3)),
        )
        for _ in range(24)
    ]
    return field_of(*boxes, nw=6)


def behind_surface(field: ForceField, count: int) -> tuple[Vector, Vector]:
    """Return points in front of the surface, and as far behind it, each [count, 3]."""
    points = points_on_surface(field, count, np.random.default_rng(1))
    normals = field.sample_n(points).astype(np.float64)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points + PRESSED_M * normals, points - PRESSED_M * normals
