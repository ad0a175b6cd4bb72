"""Computes triangles of bodies for pictures, where their signed distance is zero."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.paper.directions import Codebook
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, rotation_matrix

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.scene import Scene
    from touchfield.sources.shapes.shapes import Shape

    Float64s = NDArray[np.float64]

__all__ = ["polygons"]

DIRECTIONS: Final = "ico6"
_HALVINGS = 30
_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)
_FACES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])


def polygons(scene: Scene) -> Float64s | None:
    """Corners of the faces of one body in its own frame, metres, float64 [faces, 3 or 4, 3], anticlockwise
    outside.

    None of a body that is neither a mesh nor one shape. A round shape is seen from its middle in the
    directions of a codebook, so that it must be star-shaped.
    """
    if isinstance(scene, MeshScene):
        found: Float64s = scene.surface.vertices_m[scene.surface.triangles]
        return found
    if not isinstance(scene, AnalyticScene) or len(scene.shapes) != 1:
        return None
    shape = scene.shapes[0]
    if isinstance(shape, Box):
        corners = (_CORNERS * shape.half_extents_m) @ rotation_matrix(shape.rotation_deg).T + shape.center_m
        faces: Float64s = corners[_FACES]
        return faces
    codebook = Codebook.get(DIRECTIONS)
    points = _on_surface(shape, codebook.vertices)
    triangles = points[codebook.faces]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inward = (normal * (triangles.mean(axis=1) - shape.box_m().mean(axis=0))).sum(axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return triangles


def _on_surface(shape: Shape, directions: Float64s) -> Float64s:
    """Where rays from the middle of the shape leave it, float64 [n, 3]."""
    box = shape.box_m()
    middle = box.mean(axis=0)
    low, high = np.zeros(len(directions)), np.full(len(directions), np.linalg.norm(np.ptp(box, axis=0)))
    for _ in range(_HALVINGS):
        half = (low + high) / 2
        inside = shape.signed_distance_and_normal(middle + half[:, None] * directions)[0] < 0
        low, high = np.where(inside, half, low), np.where(inside, high, half)
    return np.asarray(middle + high[:, None] * directions)
