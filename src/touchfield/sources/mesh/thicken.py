"""Thickens the walls of a closed mesh that are too thin for a lattice, by moving their triangles outwards.

`growth_of` measures how far each triangle has to move along its normal, and `grow` moves the vertices so that
the planes of their triangles move by that: a corner of a plate moves along the plate's normal only, because
the triangles of its rim stay where they are. Triangles of thick parts do not move, except those that share a
plane with a thin wall.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, Int32s, Int64s
from touchfield.compute.threads import for_chunks
from touchfield.sources.mesh.surface import Surface

if TYPE_CHECKING:
    from touchfield.sources.thin_walls import MinThickness

_TINY: Final = 1e-9  # of the extent
_MAX_CELLS: Final = 100  # along the longest side
_CELLS_ALONG_RAY: Final = 3
_CELLS_PER_TRIANGLE, _FREE_CELLS = 32, 1 << 18  # that the boxes of the triangles meet, at most
_STRIDE, _MAX_STRIDE = (
    0.25,
    8,
)  # every nth triangle first, if n of them are smaller than this part of the thickness
_DOUBT: Final = 1.05  # of the least thickness: what a look at some of the triangles must find
_LEAST_WIDTH: Final = 0.5
"""Side of the smallest square that counts as a wall, as a multiple of the least thickness."""
_THIN_WEIGHT: Final = 100.0
"""Weight of a triangle that moves, where its neighbour in the same plane does not."""
_REGULAR: Final = 1e-6
_MAX_MOTION: Final = 2.0
"""Longest motion of a vertex, as a multiple of those of its triangles: an acute rim would move far."""


class Growth(NamedTuple):
    """How far the triangles of a mesh move outwards, and the wall that grows most, before and after."""

    motions_m: Float64s  # float64 [m]; 0 where the mesh is thick enough
    thickness_m: float
    thickened_m: float


def growth_of(
    surface: Surface, normals: Float64s, rule: MinThickness, is_outer: Bools | None
) -> Growth | None:
    """Measure a closed surface; None if all its walls are thick enough.

    normals : float64 [m, 3]; outward unit normals of the triangles; zero for one without area.
    is_outer : bool [m] or None; triangles on the boundary of the union of overlapping parts; None for all.
    """
    from touchfield.sources.mesh.kernels import sign
    from touchfield.sources.mesh.kernels.thickness import thicknesses

    corners = surface.vertices_m[surface.triangles]
    needed = rule.along(normals)
    if float(np.ptp(surface.bounds_m, axis=0).max()) < needed.max():
        return None  # too small in all directions to be a wall
    boxes = sign.boxes_of(corners)
    frame = _frame_of_cells(surface, boxes, float(needed.max()))
    is_measured = _suspects(frame, boxes, normals, needed)
    if is_outer is not None:
        is_measured &= is_outer
    faces: Int32s = np.flatnonzero(is_measured).astype(np.int32)
    if not len(faces):
        return None
    tiny = _TINY * float(np.abs(surface.bounds_m).max())
    cells = _cells(_frame_of_cells(surface, boxes, float(needed.max()) / _CELLS_ALONG_RAY), boxes)
    every = _stride(corners[faces], float(needed.max()))

    def measured(some: Int32s, far_m: Float64s) -> Float64s:
        found = np.full(len(corners), np.inf)
        for_chunks(
            thicknesses, len(some), some, cells, boxes, corners, normals, far_m, tiny, found, chunk=256
        )
        return found

    if every > 1 and np.isinf(measured(faces[::every], _DOUBT * needed)).all():
        return None
    found = measured(faces, needed)
    if np.isinf(found).all():
        return None
    if _areas(corners[np.isfinite(found)]).sum() < (_LEAST_WIDTH * float(needed.max())) ** 2:
        return None  # slivers at a seam of the mesh, whose corners would move far
    motions = np.where(np.isfinite(found), (needed - found) / 2, 0.0)
    worst = int(motions.argmax())
    return Growth(motions, float(found[worst]), float(found[worst] + 2 * motions[worst]))


def _frame_of_cells(surface: Surface, boxes: Float64s, size_m: float) -> Float64s:
    """Return cells over a surface: low corner, 1 / size, and number along each axis, float64 [7].

    They are larger than `size_m` where the boxes of the triangles would meet too many.
    """
    low, high = surface.bounds_m
    size = max(size_m, float((high - low).max()) / _MAX_CELLS)
    sides = boxes[:, 1::2] - boxes[:, 0::2]
    while float((sides / size + 1).prod(axis=1).sum()) > _CELLS_PER_TRIANGLE * len(boxes) + _FREE_CELLS:
        size *= 2
    return np.array([*low, 1 / size, *np.floor((high - low) / size) + 1])


def _suspects(frame: Float64s, boxes: Float64s, normals: Float64s, needed_m: Float64s) -> Bools:
    """Return which triangles may have a far side within the least thickness, bool [m]."""
    from touchfield.sources.mesh.kernels.thickness import mark_directions, mark_suspects, opposite_directions

    directions = np.zeros(tuple(frame[4:].astype(int).tolist()), np.int64)
    mark_directions(boxes, normals, frame, directions)
    is_suspect = np.zeros(len(boxes), np.bool_)
    arguments = (boxes, normals, needed_m, frame, directions, opposite_directions(), is_suspect)
    for_chunks(mark_suspects, len(boxes), *arguments, chunk=4096)
    return is_suspect


def _stride(corners: Float64s, needed_m: float) -> int:
    """Return n if every nth of the triangles shows whether any is thin, as where they are far smaller."""
    mean_m2 = max(float(_areas(corners).mean()), 1e-300)
    return int(min(max((needed_m * _STRIDE) ** 2 / mean_m2, 1.0), _MAX_STRIDE))


def _areas(corners: Float64s) -> Float64s:
    """Return the areas of triangles float64 [m, 3, 3], float64 [m]."""
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(np.linalg.norm(doubled, axis=1) / 2)


def _cells(frame: Float64s, boxes: Float64s) -> tuple[Float64s, Int64s, Int32s]:
    """Return a frame of cells, and the triangles of each: `starts` and `ids` of `thicknesses`."""
    from touchfield.sources.mesh.kernels.thickness import put_in_cells

    counts = np.zeros(int(frame[4:].prod()), np.int64)
    put_in_cells(boxes, frame, counts, np.empty(0, np.int32))
    starts = np.append(0, np.cumsum(counts))
    ids = np.empty(int(starts[-1]), np.int32)
    put_in_cells(boxes, frame, starts[:-1].copy(), ids)
    return frame, starts, ids


def grow(surface: Surface, normals: Float64s, motions_m: Float64s) -> Surface:
    """Return a surface whose triangles are moved along their normals [m, 3] by motions float64 [m]."""
    triangles = surface.triangles
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
