"""Thickens shapes that are too thin for a lattice: plates along one axis, rods across two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.sources.shapes.shapes import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Shape,
    Superquadric,
)
from touchfield.sources.thin_walls import MinThickness

_DIRECTIONS: Final = 16  # across a rod, over half a turn
_FACE_POINTS: Final = 5  # along each side of a plate


def thicken_shape(shape: Shape, others: Sequence[Shape], rule: MinThickness) -> Shape | None:
    """Return a shape with the least thickness that holds; None if it is thick enough.

    A shape that is too small along all its axes is no wall: None. So is a plate that lies on another solid,
    one of `others`.
    """
    sides, needed = _sides_m(shape, rule)
    is_thin = sides < needed
    if not is_thin.any() or is_thin.all() or _is_backed(shape, is_thin, others):
        return None
    return _with_sides(shape, np.where(is_thin, needed, sides))


def thickness_m(shape: Shape) -> float:
    """Return the smallest side of a shape."""
    half = getattr(shape, "half_extents_m", None)
    if half is not None:
        return 2 * float(min(half))
    solid: Any = shape
    return 2 * float(
        min(solid.radius_m, solid.half_length_m) if isinstance(shape, Cylinder) else solid.radius_m
    )


def _sides_m(shape: Shape, rule: MinThickness) -> tuple[Float64s, Float64s]:
    """Return the sides of a shape along its own axes, and the least ones, float64 [3] each.

    Those of a plane or ball, which are no plates or rods, are infinite.
    """
    if isinstance(shape, Box | Ellipsoid | Superquadric):
        return 2 * np.asarray(shape.half_extents_m, np.float64), rule.along(shape.axes.T)
    if not isinstance(shape, Capsule | Cylinder):
        return np.full(3, np.inf), np.zeros(3)
    length = 2 * shape.half_length_m + (2 * shape.radius_m if isinstance(shape, Capsule) else 0.0)
    angles = np.linspace(0, np.pi, _DIRECTIONS, endpoint=False)
    across = np.stack([np.cos(angles), np.sin(angles)], axis=1) @ shape.axes[:, :2].T
    radial = float(rule.along(across).max())
    sides = np.array([2 * shape.radius_m, 2 * shape.radius_m, length])
    return sides, np.array([radial, radial, rule.along(shape.axes[:, 2])])


def _with_sides(shape: Shape, sides_m: Float64s) -> Shape:
    x, y, z = (sides_m / 2).tolist()
    solid: Any = shape
    if isinstance(shape, Cylinder):
        other = replace(solid, radius_m=x, half_length_m=z)
    elif isinstance(shape, Capsule):
        other = replace(solid, radius_m=x)
    else:
        other = replace(solid, half_extents_m=(x, y, z))
    vars(other)["axes"] = solid.axes  # `move_shape` may have rotated them
    changed: Shape = other
    return changed


def _is_backed(shape: Shape, is_thin: Bools, others: Sequence[Shape]) -> bool:
    """Return True if one of its two sides is within another shape, everywhere on a plate."""
    if not others or is_thin.sum() != 1:
        return False
    solid: Any = shape
    axis = int(is_thin.argmax())
    half = _sides_m(shape, MinThickness((0, 0, 0), (0, 0, 0), (0, 0, 0), 0.0))[0] / 2
    steps = np.linspace(-0.95, 0.95, _FACE_POINTS)
    points = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    local = np.insert(points, axis, 0.0, axis=1) * half
    is_within = np.zeros((2, len(local)), np.bool_)
    for side, sign in enumerate((-1.05, 1.05)):
        local[:, axis] = sign * half[axis]
        in_scene = local @ solid.axes.T + np.asarray(solid.center_m)
        for other in others:
            is_within[side] |= other.signed_distance_and_normal(in_scene)[0] < 0
    return bool(is_within.any(axis=0).all())
