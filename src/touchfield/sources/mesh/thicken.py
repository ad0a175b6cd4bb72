"""Thickens the walls of a closed mesh that are too thin for a lattice, by moving their triangles outwards.

`growth_of` measures how far each triangle has to move along its normal, and `grow` moves the vertices so that
the planes of their triangles move by that: a corner of a plate moves along the plate's normal only, because
the triangles of its rim stay where they are. Triangles of thick parts do not move, except those that share a
plane with a thin wall.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, Int32s
from touchfield.compute.threads import for_chunks
from touchfield.sources.mesh.surface import Surface, unit

if TYPE_CHECKING:
    from touchfield.sources.thin_walls import MinThickness

_TINY: Final = 1e-9  # of the extent
_THIN_WEIGHT: Final = 100.0
"""Weight of a triangle that moves, where its neighbour in the same plane does not."""
_REGULAR: Final = 1e-6
_MAX_MOTION: Final = 2.0
"""Longest motion of a vertex, as a multiple of those of its triangles: an acute rim would move far."""


class Growth(NamedTuple):
    """How far the triangles of a mesh move outwards, and its thinnest wall before and after."""

    motions_m: Float64s  # float64 [m]; 0 where the mesh is thick enough
    thickness_m: float
    thickened_m: float


def growth_of(surface: Surface, rule: MinThickness, is_outer: Bools | None) -> Growth | None:
    """Measure a closed surface; None if all its walls are thick enough.

    is_outer : bool [m] or None; triangles on the boundary of the union of overlapping parts; None for all.
    """
    from touchfield.sources.mesh.kernels import sign
    from touchfield.sources.mesh.kernels.thickness import thicknesses

    corners = surface.vertices_m[surface.triangles]
    normals = _normals(surface, corners)
    needed = rule.along(normals)
    if float(np.ptp(surface.bounds_m, axis=0).max()) < needed.max():
        return None  # too small in all directions to be a wall
    is_measured = normals.any(axis=1) if is_outer is None else is_outer & normals.any(axis=1)
    faces: Int32s = np.flatnonzero(is_measured).astype(np.int32)
    boxes = sign.boxes_of(corners)
    found = np.full(len(corners), np.inf)
    tiny = _TINY * float(np.abs(surface.bounds_m).max())
    arguments = (faces, tuple(sign.sorted_into_bins(boxes)), boxes, corners, normals, needed, tiny, found)
    for_chunks(thicknesses, len(faces), *arguments, chunk=256)
    motions = np.where(np.isfinite(found), (needed - found) / 2, 0.0)
    if not motions.any():
        return None
    thinnest = int(found.argmin())
    return Growth(motions, float(found[thinnest]), float(found[thinnest] + 2 * motions[thinnest]))


def grow(surface: Surface, motions_m: Float64s) -> Surface:
    """Return a surface whose triangles are moved outwards along their normals, by motions float64 [m]."""
    triangles = surface.triangles
    normals = _normals(surface, surface.vertices_m[triangles])
    moves = np.zeros(len(surface.vertices_m), np.bool_)
    moves[triangles[motions_m > 0]] = True
    near = np.flatnonzero(moves[triangles].any(axis=1))
    index = np.cumsum(moves) - 1
    count = int(moves.sum())
    matrices, sides = np.zeros((count, 3, 3)), np.zeros((count, 3))
    largest = np.zeros(count)
    weights = np.where(motions_m[near] > 0, _THIN_WEIGHT, 1.0)
    for corner in range(3):
        vertices = triangles[near, corner]
        used = moves[vertices]
        rows, normal = index[vertices[used]], normals[near[used]]
        weight, motion = weights[used], motions_m[near[used]]
        np.add.at(matrices, rows, weight[:, None, None] * normal[:, :, None] * normal[:, None, :])
        np.add.at(sides, rows, (weight * motion)[:, None] * normal)
        np.maximum.at(largest, rows, motion)
    matrices += _REGULAR * np.trace(matrices, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    motion_of_vertex = np.linalg.solve(matrices, sides[:, :, None])[:, :, 0]
    length = np.linalg.norm(motion_of_vertex, axis=1)
    motion_of_vertex *= np.minimum(1.0, _MAX_MOTION * largest / np.maximum(length, 1e-300))[:, None]
    vertices_m = np.array(surface.vertices_m)
    vertices_m[moves] += motion_of_vertex
    return surface.with_vertices(vertices_m)


def _normals(surface: Surface, corners: Float64s) -> Float64s:
    """Return the outward unit normals of the triangles, float64 [m, 3]; zero for one without area."""
    normals = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    return -normals if surface.volume_m3() < 0 else normals
