"""Parts of a mesh in motion that keep their shape: connected parts whose vertices move as one rigid body.

What moves a part (a node, a joint that carries all of it, several joints that move alike) does not matter: its motion
is fitted from its vertices, frame by frame, and it is rigid where no vertex is farther from the fit than 1e-5 of the
part's extent. Parts that move alike are one.

Source of the fit: W. Kabsch, A solution for the best rotation to relate two sets of vectors, Acta Cryst. A32, 1976.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, Int32s, Int64s
from touchfield.medium import PoseTrack
from touchfield.medium.pose_track import quaternions_of
from touchfield.sources.mesh_surface import Surface

_RIGID: Final = 1e-5
_LOOKS: Final = 16


class RigidPart(NamedTuple):
    """Connected parts that move alike."""

    has_vertex: Bools  # bool [n]; which vertices are its own
    origin_m: Float64s  # float64 [3]; where the origin of its own frame lies in frame 0, in which it is not turned
    track: PoseTrack  # scene from its own frame


def rigid_parts(
    surface: Surface, vertices_m: Callable[[int], Float64s], frame_count: int
) -> tuple[list[RigidPart], Bools]:
    """The rigid parts of a surface in motion, and which vertices deform, bool [n].

    `surface` Surface: its triangles tell what is connected; `vertices_m` callable: the vertices of a frame, float64
    [n, 3].
    """
    part_of = surface.part_of_vertex()
    used = np.unique(surface.triangles)
    order = used[np.argsort(part_of[used], kind="stable")]
    looks = np.unique(np.linspace(0, frame_count - 1, _LOOKS).astype(int)).tolist()
    start = vertices_m(0)
    order, _ = _fitted(order, part_of, start, vertices_m, looks)  # what deforms mostly shows soon
    order, poses = _fitted(order, part_of, start, vertices_m, range(frame_count))
    deforms = np.zeros(len(part_of), bool)
    deforms[used] = True
    deforms[order] = False
    parts = []
    for names, rotations, shifts in _alike(np.unique(part_of[order]), poses, start[order]):
        has_vertex = np.isin(part_of, names) & ~deforms
        has_vertex[np.setdiff1d(np.arange(len(part_of)), used)] = False
        origin, extent = start[has_vertex].mean(axis=0), np.ptp(start[has_vertex], axis=0).max()
        places = rotations @ origin + shifts
        moved = np.abs(rotations - np.eye(3)).max() * extent + np.abs(places - origin).max(initial=0.0)
        track = PoseTrack.still(frame_count, origin)
        if moved > _RIGID * extent:
            track = PoseTrack(quaternions_of(rotations), places)
        parts.append(RigidPart(has_vertex, origin, track))
    return parts, deforms


def _fitted(
    order: Int64s,
    part_of: Int32s,
    start: Float64s,
    vertices_m: Callable[[int], Float64s],
    frames: list[int] | range,
) -> tuple[Int64s, Float64s]:
    """The vertices of those parts that are rigid in these frames, and x -> R x + t of each, [parts, frames, 3, 4]."""
    names = part_of[order]
    first = np.flatnonzero(np.append(True, names[1:] != names[:-1]))[: len(names)]
    count = np.diff(np.append(first, len(names)))[:, None]
    if not len(order):
        return order, np.zeros((0, len(frames), 3, 4))
    number = np.repeat(np.arange(len(first)), count[:, 0])
    before = start[order]
    centre = np.add.reduceat(before, first) / count
    off = before - centre[number]
    extent = np.maximum.reduceat(np.linalg.norm(off, axis=1), first)
    is_rigid = np.ones(len(first), bool)
    poses = np.zeros((len(first), len(frames), 3, 4))
    for at, frame in enumerate(frames):
        after = vertices_m(frame)[order]
        there = np.add.reduceat(after, first) / count
        gone = after - there[number]
        together = np.add.reduceat(gone[:, :, None] * off[:, None, :], first)
        u, _, v = np.linalg.svd(together)
        u[:, :, 2] *= np.linalg.det(u @ v)[:, None]
        turn = u @ v
        error = np.linalg.norm(np.einsum("nij,nj->ni", turn[number], off) - gone, axis=1)
        is_rigid &= np.maximum.reduceat(error, first) <= _RIGID * extent
        poses[:, at, :, :3] = turn
        poses[:, at, :, 3] = there - np.einsum("pij,pj->pi", turn, centre)
    return order[is_rigid[number]], poses[is_rigid]


def _alike(names: Int32s, poses: Float64s, points: Float64s) -> list[tuple[Int32s, Float64s, Float64s]]:
    """Parts in groups that move alike: their names, and the rotations [f, 3, 3] and shifts [f, 3] of each group."""
    if not len(names):
        return []
    scale = np.ones((3, 4))
    scale[:, 3] = 1 / max(float(np.abs(points).max()), 1e-300)
    looks = np.unique(np.linspace(0, poses.shape[1] - 1, _LOOKS).astype(int))
    rounded = np.round(poses[:, looks] * scale / (10 * _RIGID)).reshape(len(poses), -1)
    _, first, group = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    group = group.reshape(-1)
    groups = []
    for number in np.argsort(first):
        mine = poses[first[number]]
        groups.append((names[group == number], mine[:, :, :3], mine[:, :, 3]))
    return groups
