"""Finds the rigid bodies of an animated model, and how much of them lies inside others.

For the object representation, bodies are the connected parts whose vertices move as one rigid body. The cause
of the motion (a node, a joint that carries the whole part, several that move alike) does not matter: the
motion is fitted to the vertices, frame by frame, and the part is rigid if no vertex is farther from the fit
than 1e-5 of its extent. Parts that move alike are one body. Closed links that meet in a vertex or an edge, as
at the pivot or the hinge of a joint, are separate parts. Source of the fit: W. Kabsch, A solution for the
best rotation to relate two sets of vectors, Acta Cryst. A32, 1976.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, Int32s, Int64s, lengths_of
from touchfield.medium import PoseTrack
from touchfield.medium.pose_track import quaternions_of
from touchfield.sources.mesh.mesh_scene import union_of
from touchfield.sources.mesh.surface import Edges, Surface

_RIGID: Final = 1e-5
_SAMPLE_TIMES: Final = 16  # number of frames that reject most deforming parts early


def separate_parts(vertex_ids: Int64s, triangles: Int32s) -> tuple[Int64s, Int32s]:
    """Give the closed parts of a surface that meet in vertices or edges vertices of their own.

    Two links of a robot often share the vertex at the pivot of their joint, or the edge of their hinge, and
    are still two bodies. Triangles that meet at an edge stay together if they are two, or if they are more
    and their part would be open there without the others. An open surface stays as it is: its holes are
    closed across such vertices.

    `vertex_ids` int64 [n]: what each vertex is; `triangles` int32 [m, 3]. Returns both, with vertices
    repeated.
    """
    edges = Edges.of(triangles, len(vertex_ids))
    if edges.unbalanced_count:
        return vertex_ids, triangles
    edge_of = edges.edge_of
    is_joined = np.bincount(edge_of.reshape(-1))[edge_of] == 2
    part_of = _connected_over(edge_of, is_joined)
    if not is_joined.all():
        at_edge = part_of[:, None].astype(np.int64) * (int(edge_of.max()) + 1) + edge_of
        group = np.unique(at_edge, return_inverse=True)[1].reshape(-1)
        direction = np.where(triangles < np.roll(triangles, -1, axis=1), 1, -1)
        is_open = np.bincount(group, direction.reshape(-1)) != 0
        part_of = _connected_over(edge_of, is_joined | is_open[group].reshape(-1, 3))
    part_count = int(part_of.max()) + 1
    keys = triangles.astype(np.int64) * part_count + part_of[:, None]
    used, faces = np.unique(keys, return_inverse=True)
    return vertex_ids[used // part_count], faces.reshape(-1, 3).astype(np.int32)


def _connected_over(edge_of: Int64s, is_joined: Bools) -> Int32s:
    """Return the connected part of each triangle, int32 [m].

    `is_joined` bool [m, 3]: whether an edge joins the triangle to the others that it joins.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, (triangle, side) = len(edge_of), np.nonzero(is_joined)
    nodes = count + int(edge_of.max()) + 1
    links = triangle, count + edge_of[triangle, side]
    graph = coo_array((np.ones(len(triangle), np.int8), links), shape=(nodes, nodes))
    parts: Int32s = connected_components(graph, directed=False)[1][:count]
    return parts


def outer_area_m2(surface: Surface) -> float:
    """The area of the boundary of the union of a surface's parts, without what lies inside other parts."""
    corners, union = surface.vertices_m[surface.triangles], union_of(surface)
    if union is None:
        return _area_m2(corners)
    return _area_m2(corners[union.uncut]) + _area_m2(union.corners_m)


def _area_m2(corners: Float64s) -> float:
    """The area of triangles float64 [m, 3, 3]."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(lengths_of(normals).sum() / 2)


class RigidPart(NamedTuple):
    """Connected parts that move alike."""

    has_vertex: Bools  # bool [n]; vertices of the part
    origin_m: Float64s  # float64 [3]; origin of the part's frame in frame 0, where it is not rotated
    track: PoseTrack  # scene from the part's frame


def rigid_parts(
    surface: Surface,
    vertices_m: Callable[[int], Float64s],
    frame_count: int,
    is_turned_over: Bools | None = None,
) -> tuple[list[RigidPart], Bools]:
    """Find the rigid parts of a moving surface, and which vertices deform, bool [n].

    The triangles of `surface` define connectivity; `vertices_m` returns the vertices of a frame, float64 [n,
    3]. `is_turned_over` bool [n]: vertices of parts that change their winding, and so are not rigid.
    """
    part_of = surface.part_of_vertex()
    used = np.unique(surface.triangles)
    order = used[np.argsort(part_of[used], kind="stable")]
    if is_turned_over is not None:
        order = order[~is_turned_over[order]]
    sample_frames = np.unique(np.linspace(0, frame_count - 1, _SAMPLE_TIMES).astype(int)).tolist()
    start = vertices_m(0)
    order, _ = _fit_parts(
        order, part_of, start, vertices_m, sample_frames
    )  # rejects most deforming parts early
    order, poses = _fit_parts(order, part_of, start, vertices_m, range(frame_count))
    deforms = np.zeros(len(part_of), bool)
    deforms[used] = True
    deforms[order] = False
    if not len(order):
        return [], deforms
    # group parts that move alike
    scale = np.ones((3, 4))
    scale[:, 3] = 1 / max(float(np.abs(start[order]).max()), 1e-300)
    rounded = np.round(poses[:, sample_frames] * scale / (10 * _RIGID)).reshape(len(poses), -1)
    _, first, group = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    names, parts = np.unique(part_of[order]), []
    for number in np.argsort(first):
        rotations, shifts = poses[first[number], :, :, :3], poses[first[number], :, :, 3]
        has_vertex = np.isin(part_of, names[group.reshape(-1) == number]) & ~deforms
        has_vertex[np.setdiff1d(np.arange(len(part_of)), used)] = False
        origin, extent = start[has_vertex].mean(axis=0), np.ptp(start[has_vertex], axis=0).max()
        positions_m = rotations @ origin + shifts
        displacement = np.abs(rotations - np.eye(3)).max() * extent + np.abs(positions_m - origin).max(
            initial=0.0
        )
        track = PoseTrack.constant(frame_count, origin)
        if displacement > _RIGID * extent:
            track = PoseTrack(quaternions_of(rotations), positions_m)
        parts.append(RigidPart(has_vertex, origin, track))
    return parts, deforms


def _fit_parts(
    order: Int64s,
    part_of: Int32s,
    start: Float64s,
    vertices_m: Callable[[int], Float64s],
    frames: list[int] | range,
) -> tuple[Int64s, Float64s]:
    """Fit rigid motions x -> R x + t to parts in some frames.

    Returns the vertices of the rigid parts, and their motions, float64 [parts, frames, 3, 4].
    """
    names = part_of[order]
    first = np.flatnonzero(np.append(True, names[1:] != names[:-1]))[: len(names)]
    count = np.diff(np.append(first, len(names)))[:, None]
    if not len(order):
        return order, np.zeros((0, len(frames), 3, 4))
    number = np.repeat(np.arange(len(first)), count[:, 0])
    before = start[order]
    centre = np.add.reduceat(before, first) / count
    offset = before - centre[number]
    extent = np.maximum.reduceat(np.linalg.norm(offset, axis=1), first)
    is_rigid = np.ones(len(first), bool)
    poses = np.zeros((len(first), len(frames), 3, 4))
    for n, frame in enumerate(frames):
        after = vertices_m(frame)[order]
        centre_after = np.add.reduceat(after, first) / count
        offset_after = after - centre_after[number]
        covariance = np.add.reduceat(offset_after[:, :, None] * offset[:, None, :], first)
        u, _, v = np.linalg.svd(covariance)
        u[:, :, 2] *= np.linalg.det(u @ v)[:, None]
        rotation = u @ v
        error = np.linalg.norm(np.einsum("nij,nj->ni", rotation[number], offset) - offset_after, axis=1)
        is_rigid &= np.maximum.reduceat(error, first) <= _RIGID * extent
        poses[:, n, :, :3] = rotation
        poses[:, n, :, 3] = centre_after - np.einsum("pij,pj->pi", rotation, centre)
    return order[is_rigid[number]], poses[is_rigid]
