"""The outer surface of closed meshes that overlap: what of each triangle bounds the union, by the winding number.

Inside is where the winding number is not 0; a wall with inside on both of its sides is not felt. Triangles that cross
others are cut there (`touchfield.sources.kernels.mesh_union`), so that the distance to what remains is that to the
surface of the union. Triangles that share a vertex are not cut by one another.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.mesh_surface import Surface

__all__ = ["Union", "union_of"]

_TOUCHING: Final = 1e-9
_BESIDE: Final = 1e-7
"""Of the extent: heights that count as 0, and how far beside a triangle one looks."""


class Union(NamedTuple):
    """The boundary of a union."""

    kept: NDArray[np.int64]  # int64 [k]; triangles that are whole in it
    corners_m: NDArray[np.float64]  # float64 [p, 3, 3]; pieces of others, each beginning with its longest edge
    parents: NDArray[np.int32]  # int32 [p]; the triangle that each is a piece of
    dropped_count: int  # triangles of which nothing is left


def union_of(surface: Surface) -> Union | None:
    """The boundary of the union of a closed surface's parts; None where that is the surface as it is."""
    from touchfield.sources.kernels import mesh_union as kernel

    faces = surface.triangles
    corners = surface.vertices_m[faces]
    extent = float(np.abs(surface.bounds_m).max()) + float(np.ptp(surface.bounds_m, axis=0).max())
    normals = surface.face_normals()
    boxes = kernel.boxes_of(corners)
    bins = kernel.sorted_into_bins(boxes)
    pairs = kernel.crossing_pairs(bins, boxes, corners, normals, faces, _TOUCHING * extent)
    if not len(pairs) and not _parts_meet(surface, boxes):
        return None
    starts = np.flatnonzero(np.append(True, pairs[1:, 0] != pairs[:-1, 0])) if len(pairs) else np.zeros(0, np.int64)
    cut_corners, parents = kernel.cut(np.append(starts, len(pairs)), pairs, corners, normals, _TOUCHING * extent)
    is_cut = np.zeros(len(faces), bool)
    is_cut[parents] = True
    whole = np.flatnonzero(~is_cut)
    pieces = kernel.Pieces(
        np.concatenate([corners[whole], cut_corners]), np.concatenate([whole.astype(np.int32), parents])
    )
    is_outer = kernel.inner_and_outer(pieces, normals, bins, surface.vertices_m, faces, _BESIDE * extent)
    if is_outer.all():
        return None
    kept, ours = whole[is_outer[: len(whole)]], is_outer[len(whole) :]
    dropped = len(faces) - len(kept) - len(np.unique(parents[ours]))
    return Union(kept, _from_longest(cut_corners[ours]), parents[ours], dropped)


def _parts_meet(surface: Surface, boxes: NDArray[np.float64]) -> bool:
    """True if the boxes of two connected parts overlap."""
    part_of = surface.part_of_vertex()[surface.triangles[:, 0]]
    order = np.argsort(part_of, kind="stable")
    first = np.flatnonzero(np.append(True, np.diff(part_of[order]) != 0))
    if len(first) == 1:
        return False
    low = np.minimum.reduceat(boxes[order, 0::2], first)
    high = np.maximum.reduceat(boxes[order, 1::2], first)
    order = np.argsort(low[:, 0])
    low, high = low[order], high[order]
    for i in range(len(low) - 1):
        until = np.searchsorted(low[:, 0], high[i, 0], side="right")
        if ((low[i + 1 : until] <= high[i]) & (high[i + 1 : until] >= low[i])).all(axis=1).any():
            return True
    return False


def _from_longest(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    order = (np.arange(3) + sides.argmax(axis=1)[:, None]) % 3
    turned: NDArray[np.float64] = np.take_along_axis(corners, order[:, :, None], axis=1)
    return turned
