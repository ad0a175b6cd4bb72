"""Which vertices of a mesh are one: those at one place, and in a mesh that moves only if they stay together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.sources.mesh_surface import Edges, joined, places

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["welded", "welded_in_motion"]

_WELD: Final = 1e-7
"""Vertices this near, of the extent, are joined where that closes the mesh: the digits of float32."""

_TOGETHER: Final = 1e-3
"""And in a mesh that moves, if they never part farther than this, of the extent: the digits of 8-bit weights."""


def welded(vertices: NDArray[Any], triangles: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """The mesh with equal vertices made one; nearly equal ones too, if that closes it."""
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        return vertices, triangles.astype(np.int32)  # the scene will say so
    points, faces = joined(vertices, triangles)
    if not np.isfinite(points).all() or _unbalanced(faces, len(points)) == 0:
        return points, faces
    near_points, near_faces = joined(points, faces, _WELD * float(np.ptp(points, axis=0).max()))
    if _unbalanced(near_faces, len(near_points)) == 0:
        return near_points, near_faces
    return points, faces


def welded_in_motion(
    poses: NDArray[np.float64], triangles: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Which vertices of a mesh in motion to keep, ascending, and the triangles in their numbers.

    Vertices that are at the same place in every pose are one. If that leaves the mesh open, those that meet at rest
    and hardly part are one as well, if that closes it. Parts that only touch at rest stay apart.

    Parameters
    ----------
    poses : float64 [s, n, 3]; Some poses, finite; the first is at rest.
    triangles : int64 [m, 3]
    """
    count = poses.shape[1]
    first, number = places(poses.swapaxes(0, 1).reshape(count, -1) + 0.0)  # -0.0 is 0.0
    same = first[number]
    if _unbalanced(same[triangles], count) != 0:
        extent = float(np.ptp(poses, axis=1).max())
        first, number = places(poses[0], _WELD * extent)
        meets = same[first[number]]
        apart = np.abs(poses[:, same] - poses[:, meets]).max(axis=(0, 2))
        near = np.where(apart <= _TOGETHER * extent, meets, same)
        if _unbalanced(near[triangles], count) == 0:
            same = near
    kept, faces = np.unique(same[triangles], return_inverse=True)
    return kept, faces.reshape(-1, 3).astype(np.int32)


def _unbalanced(triangles: NDArray[Any], vertex_count: int) -> int:
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return Edges.of(triangles[whole], vertex_count).unbalanced_count if whole.any() else 1
