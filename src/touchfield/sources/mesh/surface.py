"""Checks and repairs triangle meshes: merges equal vertices, closes small holes, finds whether a surface is
closed, and computes normals at vertices and edges.

Source of the pseudo-normals: J. A. Baerentzen and H. Aanaes, Signed distance computation using the angle
weighted pseudonormal, IEEE TVCG 11(3), 2005: at a vertex, the sum of the normals of its faces weighted by
their angles there; on an edge, the sum of the normals of its two faces. They tell on which side of the
surface a point lies whose nearest surface point is on that vertex or edge.

Holes are loops of the edges that are traversed more often in one direction than in the other; such edges form
cycles. A hole is small if the patch that closes it has at most 5 % of the area of its connected part. "small"
closes only those, "close" closes all, "leave" none. Triangles that face inconsistently are flipped, but only
if the result is closed; otherwise the inside of a hole is undefined. Source of the patch: G. Barequet and M.
Sharir, Filling gaps in the boundary of a polyhedron, CAGD 12(2), 1995: the triangulation of the loop with the
least area. In a long loop every second corner is first cut off, until 128 are left. No vertex is added, so
that a patch moves with its mesh.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Bools, Float64s, Int32s, Int64s, lengths_of
from touchfield.errors import SourceError, require_one_of

_LARGEST_M: Final = 1e15
# of the extent: vertices within the first are welded if that closes the mesh (resolution of float32); in a
# moving mesh only if they never separate by more than the second (resolution of 8-bit weights)
_WELD, _TOGETHER = 1e-7, 1e-3

HOLES: Final = {
    "small": 0.05,
    "close": np.inf,
    "leave": -1.0,
}  # largest hole to close, as a fraction of the area of its part
# a part that lacks more of its area is a sheet: its wall lies behind its faces, not in the enclosed volume
_NEARLY_CLOSED: Final = 0.75
_FLAT: Final = 0.999  # least cosine between the normals of a flat polygon and of its triangles
_MAX_OPEN_EDGES: Final = 1 << 18
_LONGEST, _LONGEST_OF_MANY, _MANY = 128, 24, 100
_MAX_NOTED: Final = 5


@dataclass(frozen=True)
class Edges:
    """Edges at which the triangles of a mesh meet."""

    edge_of: Int64s  # int64 [m, 3]; the edge from vertex i to vertex i + 1 of each triangle
    boundary_count: int  # edges of one triangle only
    unbalanced_count: int  # edges traversed more often in one direction than in the other
    # edges traversed twice in one direction: neighbours that face opposite ways, or fans
    repeated_count: int

    @classmethod
    def of(cls, triangles: Int32s, vertex_count: int) -> Edges:
        """Return the edges of triangles int32 [m, 3]."""
        tail, head = triangles.reshape(-1).astype(np.int64), np.roll(triangles, -1, axis=1).reshape(-1)
        key = np.minimum(tail, head) * vertex_count + np.maximum(tail, head)
        keys, edge_of = np.unique(key, return_inverse=True)
        along = np.bincount(edge_of[tail < head], minlength=len(keys))
        against = np.bincount(edge_of[tail > head], minlength=len(keys))
        return cls(
            edge_of.reshape(-1, 3),
            int(np.count_nonzero(along + against == 1)),
            int(np.count_nonzero(along != against)),
            int(np.count_nonzero((along > 1) | (against > 1))),
        )


class Surface:
    """A checked triangle mesh, in metres.

    vertices_m : float array [n, 3]
    triangles : integer array [m, 3]; Vertex numbers, anticlockwise seen from outside.
    name : str; Its name in messages.

    Raises `SourceError` if no triangle is left, or a number is out of range or not finite.

    Attributes
    ----------
    vertices_m : float64 [n, 3], read-only
    triangles : int32 [m, 3], read-only; Each starts with its longest edge; degenerate ones (a vertex twice)
        and exact duplicates are removed.
    is_closed : bool; Whether it encloses a volume: every edge is balanced, and it is not a double sheet.
    duplicate_count : int; Triangles that were removed, as others have the same corners in the same direction.
    """

    def __init__(self, vertices_m: ArrayLike, triangles: ArrayLike, name: str) -> None:
        vertices, faces = np.array(vertices_m, np.float64), np.asarray(triangles)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not len(vertices):
            raise SourceError(name, f"vertices of shape {vertices.shape}", "vertices [n, 3]")
        if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
            raise SourceError(name, "no triangle", "a mesh of triangles", "Export it with its faces.")
        if faces.dtype.kind not in "iu" or faces.min() < 0 or faces.max() >= len(vertices):
            raise SourceError(
                name, "a triangle with a vertex that is not there", f"vertices 0 to {len(vertices) - 1}"
            )
        _check_finite(vertices[np.unique(faces)], name)
        faces = faces.astype(np.int32)
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
        if not len(faces):
            raise SourceError(name, "no triangle with three different corners", "at least one triangle")
        faces, self.duplicate_count = without_duplicates(faces)
        self._name, self._used = name, np.unique(faces)
        # empty until it is asked for; the frames of a moving mesh share the list
        self._part_of: list[Int32s] = []
        self.triangles = np.take_along_axis(faces, from_longest(vertices[faces]), axis=1)
        self.edges = Edges.of(self.triangles, len(vertices))
        self.is_closed = self.edges.unbalanced_count == 0 and not _is_double_sheet(self.triangles)
        self._set_vertices(vertices)

    def _set_vertices(self, vertices: Float64s) -> None:
        used = vertices[self._used]
        self.bounds_m: Float64s = np.stack([used.min(axis=0), used.max(axis=0)])
        self.vertices_m = np.ascontiguousarray(vertices)
        for array in (self.vertices_m, self.triangles, self.bounds_m):
            array.flags.writeable = False

    def with_vertices(self, vertices_m: ArrayLike, is_turned: Bools | None = None) -> Surface:
        """Return the same triangles on other vertices: a frame of a moving mesh.

        Connectivity and closedness are reused; each triangle starts with its new longest edge. Vertices that
        no triangle uses do not matter. `vertices_m` float array [n, 3]: as many as this surface has.
        `is_turned` bool [m]: triangles that face the other way now, whole connected parts.

        Raises `SourceError` if the shape differs, or a coordinate is not finite.
        """
        vertices = np.array(vertices_m, np.float64)
        if vertices.shape != self.vertices_m.shape:
            found = f"vertices of shape {vertices.shape}"
            raise SourceError(self._name, found, f"{self.vertices_m.shape}, as before")
        _check_finite(vertices[self._used], self._name)
        other, faces, edge_of = copy.copy(self), self.triangles, self.edges.edge_of
        if is_turned is not None:
            faces = np.where(is_turned[:, None], faces[:, ::-1], faces)
            edge_of = np.where(is_turned[:, None], edge_of[:, [1, 0, 2]], edge_of)
        order = from_longest(vertices[faces])
        other.triangles = np.take_along_axis(faces, order, axis=1)
        other.edges = replace(self.edges, edge_of=np.take_along_axis(edge_of, order, axis=1))
        other._set_vertices(vertices)
        return other

    def with_triangles(self, triangles: Int32s) -> Surface:
        """Return other triangles on the same vertices, checked again."""
        return Surface(self.vertices_m, triangles, self._name)

    def part_of_vertex(self) -> Int32s:
        """Return the connected part of each vertex, int32 [n], read-only.

        An unused vertex is a part of its own.
        """
        if not self._part_of:
            from scipy.sparse import coo_array
            from scipy.sparse.csgraph import connected_components

            tail, head = self.triangles.reshape(-1), np.roll(self.triangles, -1, axis=1).reshape(-1)
            count = len(self.vertices_m)
            graph = coo_array((np.ones(len(tail), np.int8), (tail, head)), shape=(count, count))
            parts: Int32s = connected_components(graph, directed=False)[1]
            parts.flags.writeable = False
            self._part_of.append(parts)
        return self._part_of[0]

    def volume_m3(self) -> float:
        """Return the signed volume of a closed mesh, negative if its triangles face inwards."""
        a, b, c = ((self.vertices_m - self.bounds_m[0])[self.triangles[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    def pseudo_normals(self) -> Float64s:
        """Return unit pseudo-normals of each triangle, float64 [m, 7, 3].

        They are those of the face, of vertices 0 to 2 and of edges 01, 12, 20.

        Where they cancel (opposite faces that meet), the normal of the face is used.
        """
        corners = self.vertices_m[self.triangles]
        along = unit(np.roll(corners, -1, axis=1) - corners)
        face = unit(np.cross(along[:, 0], -along[:, 2]))
        cosine = -np.einsum("tij,tij->ti", along, np.roll(along, 1, axis=1))
        angle = np.arccos(np.clip(cosine, -1, 1))
        normals = np.empty((len(face), 7, 3))
        normals[:, 0] = face
        for c in range(3):
            at_vertex = np.bincount(self.triangles.reshape(-1), (angle * face[:, None, c]).reshape(-1))
            at_edge = np.bincount(self.edges.edge_of.reshape(-1), np.repeat(face[:, c], 3))
            normals[:, 1:4, c] = at_vertex[self.triangles]
            normals[:, 4:7, c] = at_edge[self.edges.edge_of]
        lengths = lengths_of(normals)
        cancelled = lengths < 1e-9
        normals /= np.where(cancelled, 1.0, lengths)[..., None]
        index = np.nonzero(cancelled)
        normals[index] = face[index[0]]
        return normals


def _check_finite(vertices: Float64s, name: str) -> None:
    bad = int(np.count_nonzero(~(np.abs(vertices) < _LARGEST_M).all(axis=1)))
    if bad:
        raise SourceError(
            name, f"{bad} vertices with a coordinate that is NaN or beyond {_LARGEST_M:g} m", "less"
        )


def from_longest(corners: Float64s) -> Int64s:
    """Return the order of corners that starts with the longest edge, int64 [m, 3].

    `corners` are float64 [m, 3, 3].
    """
    sides = lengths_of(np.roll(corners, -1, axis=1) - corners)
    order: Int64s = (np.arange(3) + sides.argmax(axis=1)[:, None]) % 3
    return order


def unit(vectors: Float64s) -> Float64s:
    """Normalise vectors [..., 3]; those of length 0 stay 0."""
    lengths = lengths_of(vectors)[..., None]
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))


def without_duplicates(triangles: NDArray[Any]) -> tuple[NDArray[Any], int]:
    """Remove all but the first of triangles with the same corners in the same direction.

    Returns the others in their order, and the number removed. `triangles` integer [m, 3], each of three
    different vertices.
    """
    if not _have_same_corners(triangles):  # as in most meshes
        return triangles, 0
    # rows that are equal up to rotation are equal once each starts with its smallest vertex
    start = triangles.argmin(axis=1)[:, None]
    rows = np.take_along_axis(triangles, (start + np.arange(3)) % 3, axis=1)
    order = np.lexsort(rows.T[::-1])
    is_copy = np.zeros(len(rows), bool)
    is_copy[order[1:]] = (rows[order[1:]] == rows[order[:-1]]).all(axis=1)  # a stable sort: the first stays
    return triangles[~is_copy], int(is_copy.sum())


def _have_same_corners(triangles: NDArray[Any]) -> bool:
    """Return False if no two triangles have the same corners; True if two have, or rarely by chance."""
    marks = np.arange(int(triangles.max()) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    marks *= marks ^ (marks >> np.uint64(32))
    sums = marks[triangles[:, 0]] + marks[triangles[:, 1]] + marks[triangles[:, 2]]
    sums.sort()
    return bool((sums[1:] == sums[:-1]).any())


def without_twins(surface: Surface) -> tuple[Surface, tuple[str, ...]]:
    """Remove triangles that a body has once more, facing the other way, with a note.

    Programs without a back of faces export them so. Returns the surface itself if it is closed, or is not
    closed without them either.
    """
    if surface.is_closed or not _have_same_corners(surface.triangles):
        return surface, ()
    first, _ = group_points(np.sort(surface.triangles, axis=1))
    single = surface.with_triangles(surface.triangles[np.sort(first)])
    if not single.is_closed and single.edges.repeated_count:
        single = single.with_triangles(_orient(single.triangles, single.edges)[0])
    count = len(surface.triangles) - len(single.triangles)
    if not single.is_closed or not count:
        return surface, ()
    single.duplicate_count = surface.duplicate_count
    return single, (f"{count} triangles left out, which the file also has facing the other way",)


def _is_double_sheet(triangles: Int32s) -> bool:
    """Return True if every triangle has a twin that faces the other way: balanced edges, no volume."""
    ascending = np.sort(triangles, axis=1)
    _, group = group_points(ascending)
    following = np.take_along_axis(triangles, (triangles.argmin(axis=1)[:, None] + 1) % 3, axis=1)[:, 0]
    return not np.bincount(group, np.where(following != ascending[:, 1], -1.0, 1.0)).any()


def merge_vertices(vertices: NDArray[Any], triangles: NDArray[Any]) -> tuple[Float64s, Int32s]:
    """Merge vertices at the same position."""
    points = np.asarray(vertices, np.float64) + 0.0  # -0.0 is 0.0
    first, number = group_points(points)
    return points[first], number[triangles].astype(np.int32)


def group_points(points: NDArray[Any], tolerance: float = 0.0) -> tuple[Int64s, Int64s]:
    """Group equal points [n, d].

    Returns the index of one point of each group, and the group of each point, int64.
    """
    rounded = np.round(points / tolerance) if tolerance > 0 else points
    order = np.lexsort(rounded.T)
    ordered = rounded[order]
    is_new = np.append(True, (ordered[1:] != ordered[:-1]).any(axis=1))
    number = np.empty(len(points), np.int64)
    number[order] = np.cumsum(is_new) - 1
    return order[is_new].astype(np.int64), number


# -- welding of vertices: those at one position, in a moving mesh only if they stay together ---------------
def weld(
    vertices: NDArray[Any], triangles: NDArray[Any], sizes: Int64s | None = None
) -> tuple[Float64s, Int32s]:
    """Merge equal vertices of a mesh, and nearly equal ones if that closes it.

    `sizes` int64 [p]: number of consecutive triangles of each polygon, which form a fan (see
    `unfold_polygons`).
    """
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        return vertices, triangles.astype(np.int32)  # the scene reports it
    points, faces = merge_vertices(vertices, triangles)
    if sizes is not None:
        faces = unfold_polygons(points, faces, sizes)
    if not np.isfinite(points).all():
        return points, faces  # the scene reports it
    used, faces = weld_in_motion(points[None], faces)
    return points[used], faces


def unfold_polygons(points: Float64s, fans: Int32s, sizes: Int64s) -> Int32s:
    """Triangulate again the concave polygons that were cut as fans.

    In the fan of a concave polygon some triangles are flipped and lie partly outside; `_patch` triangulates
    its outline instead.
    """
    faces, first = fans.copy(), np.cumsum(sizes) - sizes
    corners = points[fans]
    with np.errstate(all="ignore"):  # the scene reports values that are not finite
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        polygon_normals = np.repeat(np.add.reduceat(normals, first), sizes, axis=0)
        along, size = (
            np.einsum("ij,ij->i", normals, polygon_normals),
            lengths_of(normals) * lengths_of(polygon_normals),
        )
        is_flipped, is_flat = along < -_FLAT * size, np.abs(along) >= _FLAT * size
    is_folded = np.logical_or.reduceat(is_flipped, first) & np.logical_and.reduceat(is_flat, first)
    max_corners = _LONGEST if np.count_nonzero(is_folded) <= _MANY else _LONGEST_OF_MANY
    for start, stop in zip(first[is_folded], (first + sizes)[is_folded]):
        loop = np.append(fans[start, :2], fans[start:stop, 2]).astype(np.int64)
        faces[start:stop] = _patch(loop, points, max_corners)
    return faces


def weld_in_motion(poses: Float64s, triangles: NDArray[np.integer[Any]]) -> tuple[Int64s, Int32s]:
    """Weld a moving mesh.

    Returns the vertices to keep, ascending, and the triangles in their numbering.

    Vertices at the same position in every pose are merged. If that leaves the mesh open, those that coincide
    at rest and hardly separate are merged as well, if that closes it. Parts that only touch at rest stay
    separate.

    `poses` float64 [s, n, 3]: some poses, finite; the first is at rest; `triangles` integer [m, 3].
    """
    count = poses.shape[1]
    first, number = group_points(poses.swapaxes(0, 1).reshape(count, -1) + 0.0)  # -0.0 is 0.0
    same = first[number]
    if _unbalanced_count(same[triangles], count) != 0:
        extent = float(np.ptp(poses, axis=1).max())
        first, number = group_points(poses[0], _WELD * extent)
        touching = same[first[number]]
        separation = np.abs(poses[:, same] - poses[:, touching]).max(axis=(0, 2))
        merged = np.where(separation <= _TOGETHER * extent, touching, same)
        if _unbalanced_count(merged[triangles], count) == 0:
            same = merged
    used, faces = np.unique(same[triangles], return_inverse=True)
    return used, faces.reshape(-1, 3).astype(np.int32)


def _unbalanced_count(triangles: NDArray[Any], vertex_count: int) -> int:
    valid = triangles[(triangles != np.roll(triangles, 1, axis=1)).all(axis=1)]
    return Edges.of(without_duplicates(valid)[0], vertex_count).unbalanced_count if len(valid) else 1


# -- holes -------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class RepairedSurface:
    """A surface with holes closed, and the holes left open."""

    surface: Surface
    # int32 [l, 3]; triangles that would close the open holes of a nearly closed mesh: they define its inside
    # and exert no force
    lids: Int32s
    rim: Int32s  # int32 [r, 2]; edges of the open holes
    is_oriented: bool  # whether neighbouring triangles face alike
    notes: tuple[str, ...]


class _Hole(NamedTuple):
    loop: Int64s
    patch: Int32s
    part: int  # connected part of the surface that it lies in
    area_m2: float
    fraction: float  # of the area of that part
    across_m: float


def close_holes(surface: Surface, holes: str) -> RepairedSurface:
    """Close the holes of a surface by a rule: "small", "close" or "leave".

    Raises `InvalidArgument` for another rule.
    """
    require_one_of("holes", holes, HOLES)
    inner_notes: tuple[str, ...] = ()
    if holes != "leave":
        surface, twin_notes = without_twins(surface)
        surface, inner_notes = without_inner_walls(surface)
        inner_notes = (*twin_notes, *inner_notes)
    repaired = _close_holes(surface, holes)
    count, notes = surface.duplicate_count, tuple[str, ...]()
    if count:
        plural = "s" * (count > 1)
        notes = (f"{count} triangle{plural} removed, which the file has twice",)
    return replace(repaired, notes=(*notes, *inner_notes, *repaired.notes))


def _close_holes(surface: Surface, holes: str) -> RepairedSurface:
    empty, is_mixed = np.zeros((0, 3), np.int32), surface.edges.repeated_count > 0
    unchanged = RepairedSurface(surface, empty, empty[:, :2], not is_mixed, ())
    if surface.is_closed:
        return replace(unchanged, is_oriented=True)
    notes: tuple[str, ...] = ()
    oriented, loops = surface, None
    if is_mixed:
        faces, count, is_two_sided = _orient(surface.triangles, surface.edges)
        oriented = surface.with_triangles(faces)
        if count:
            notes = (f"{count} triangles turned to face as their neighbours do",)
    if not is_mixed or is_two_sided:
        loops = _loops(oriented)
    if loops is None:  # the orientation is undefined, or there are too many loops
        return unchanged
    part_of, vertices = oriented.part_of_vertex(), oriented.vertices_m
    areas = np.bincount(part_of[oriented.triangles[:, 0]], _areas(vertices, oriented.triangles))
    gaps = []
    for loop in loops:
        patch = _patch(loop, vertices, _LONGEST if len(loops) <= _MANY else _LONGEST_OF_MANY)
        part = part_of[loop[0]]
        area = float(_areas(vertices, patch).sum())
        across = float(np.linalg.norm(np.ptp(vertices[loop], axis=0)))
        gaps.append(_Hole(loop, patch, part, area, area / areas[part] if areas[part] > 0 else np.inf, across))
    closed_gaps = [hole for hole in gaps if hole.fraction <= HOLES[holes]]
    open_gaps = [hole for hole in gaps if not hole.fraction <= HOLES[holes]]
    if closed_gaps:
        oriented = oriented.with_triangles(
            np.concatenate([oriented.triangles, *(h.patch for h in closed_gaps)])
        )
    if is_mixed and not oriented.is_closed:
        return unchanged
    lids, rim = empty, empty[:, :2]
    if open_gaps:
        rim = np.concatenate([np.stack([h.loop, np.roll(h.loop, -1)], axis=1) for h in open_gaps]).astype(
            np.int32
        )
        if np.bincount([h.part for h in open_gaps], [h.fraction for h in open_gaps]).max() <= _NEARLY_CLOSED:
            lids = np.concatenate([h.patch for h in open_gaps])
            if oriented.with_triangles(np.concatenate([oriented.triangles, lids])).volume_m3() < 0:
                oriented, lids = oriented.with_triangles(oriented.triangles[:, ::-1]), lids[:, ::-1]
                notes = (*notes, "The triangles faced inwards and are turned over")
    return RepairedSurface(oriented, lids, rim, True, (*notes, *_hole_notes(closed_gaps, open_gaps)))


def _hole_notes(closed_gaps: list[_Hole], open_gaps: list[_Hole]) -> tuple[str, ...]:
    notes = []
    for holes, kind, outcome in (
        (closed_gaps, "hole", "closed"),
        (open_gaps, "open outline", "left, where the force falls to 0"),
    ):
        largest = sorted(holes, key=lambda h: -h.area_m2)[:_MAX_NOTED]
        fractions = (f"{h.fraction:.2%} of" if h.fraction < np.inf else "no area in" for h in largest)
        sizes = ", ".join(f"{h.across_m:.3g} m across ({of} its part)" for h, of in zip(largest, fractions))
        if holes:
            more = ", ..." * (len(holes) > _MAX_NOTED)
            notes.append(f"{len(holes)} {kind}{'s' * (len(holes) > 1)} {outcome}: {sizes}{more}")
    if open_gaps and min(h.fraction for h in open_gaps) <= _NEARLY_CLOSED:
        notes[-1] += "; --holes close closes them"
    return tuple(notes)


# -- walls inside a closed body ----------------------------------------------------------------------------
_MAX_PATCHES: Final = 4096
_MAX_CHOICES: Final = 32
_MAX_TESTS: Final = 1 << 26  # pairs of a point and a triangle


def without_inner_walls(surface: Surface) -> tuple[Surface, tuple[str, ...]]:
    """Remove open sheets inside a body that is closed without them, with a note.

    Returns the surface itself if it is closed, has no such sheet, or a sheet reaches outside.
    """
    if surface.edges.unbalanced_count == 0:
        return surface, ()
    patch_of = _patches(surface.edges, len(surface.triangles))
    for is_kept in _closed_choices(surface, patch_of):
        body, sheets = surface.with_triangles(surface.triangles[is_kept]), surface.triangles[~is_kept]
        if body.is_closed and _lie_inside(surface.vertices_m[sheets], body):
            body.duplicate_count = surface.duplicate_count
            text = f"{len(sheets)} triangles inside a closed body are left out, as they enclose nothing"
            return body, (text,)
    return surface, ()


def _patches(edges: Edges, triangle_count: int) -> Int64s:
    """Return the patch of each triangle: connected over edges at which exactly two triangles meet."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    flat = edges.edge_of.reshape(-1)
    order = np.argsort(flat, kind="stable")
    counts = np.bincount(flat)
    first = order[(np.cumsum(counts) - counts)[counts == 2]]
    second = order[(np.cumsum(counts) - 1)[counts == 2]]
    links = (np.ones(len(first), np.int8), (first // 3, second // 3))
    graph = coo_array(links, shape=(triangle_count, triangle_count))
    return np.asarray(connected_components(graph, directed=False)[1], np.int64)


def _closed_choices(surface: Surface, patch_of: Int64s) -> Iterator[Bools]:
    """Yield triangles, bool [m], whose patches are balanced together.

    Patches with an edge of one triangle are removed until there is none. Then those are removed that leave
    fewer unbalanced edges, the innermost first; if a choice leads to no body, the next one is tried.
    """
    triangles, edges = surface.triangles, surface.edges
    if not 1 < int(patch_of.max()) + 1 <= _MAX_PATCHES:
        return
    sign = np.where(triangles < np.roll(triangles, -1, axis=1), 1, -1)
    is_kept = np.ones(len(triangles), bool)
    while is_kept.any():
        at_edge = np.bincount(edges.edge_of[is_kept].reshape(-1), minlength=int(edges.edge_of.max()) + 1)
        is_open = (at_edge[edges.edge_of] == 1).any(axis=1) & is_kept
        if not is_open.any():
            break
        is_kept &= ~np.isin(patch_of, patch_of[is_open])
    pending, tries = [is_kept] if is_kept.any() else [], 0
    while pending and tries < _MAX_CHOICES:
        is_kept, tries = pending.pop(), tries + 1
        unbalanced = _unbalanced(edges, sign, is_kept)
        if not unbalanced.any():
            yield is_kept
            continue
        at_rim = np.unique(patch_of[is_kept & unbalanced[edges.edge_of].any(axis=1)])[:_MAX_CHOICES]
        depths, choices = list[float](), list[Bools]()
        for patch in at_rim:
            others = is_kept & (patch_of != patch)
            after = _unbalanced(edges, sign, others)
            if others.any() and not (after & ~unbalanced).any() and after.sum() < unbalanced.sum():
                centre = surface.vertices_m[triangles[patch_of == patch][0]].mean(axis=0)
                angles = _solid_angles(centre, surface.vertices_m[triangles[others]])
                depths.append(abs(float(angles.sum())))
                choices.append(others)
        pending += [choices[n] for n in np.argsort(depths, kind="stable")]


def _unbalanced(edges: Edges, sign: NDArray[Any], is_kept: Bools) -> Bools:
    """Return the edges, bool, that some of the triangles traverse more often in one direction."""
    count = int(edges.edge_of.max()) + 1
    net = np.bincount(edges.edge_of[is_kept].reshape(-1), sign[is_kept].reshape(-1), count)
    return np.asarray(net != 0)


def _lie_inside(corners: Float64s, body: Surface) -> bool:
    """Return True if triangles float64 [k, 3, 3] lie inside parts of a closed surface, by winding numbers.

    A void in a part counts as its inside, as no hand reaches it. Tested are points near their corners, and
    their centres; some of them if there are many.
    """
    centres = corners.mean(axis=1, keepdims=True)
    points = np.concatenate([centres, centres + (1 - 1e-3) * (corners - centres)], axis=1).reshape(-1, 3)
    points = points[:: max(1, len(points) * len(body.triangles) // _MAX_TESTS)]
    faces, part_of = body.vertices_m[body.triangles], body.part_of_vertex()[body.triangles[:, 0]]
    for point in points:
        turns = np.bincount(part_of, _solid_angles(point, faces))
        if float(np.abs(turns).max()) < 2 * np.pi:  # half of the whole sphere
            return False
    return True


def _solid_angles(point: Float64s, faces: Float64s) -> Float64s:
    """Return the signed solid angles of triangles float64 [m, 3, 3] seen from a point, float64 [m].

    Source: A. van Oosterom and J. Strackee, The solid angle of a plane triangle, IEEE TBME 30(2), 1983.
    """
    a, b, c = (faces[:, i] - point for i in range(3))
    la, lb, lc = lengths_of(a), lengths_of(b), lengths_of(c)
    solid = np.einsum("ij,ij->i", a, np.cross(b, c))
    below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return np.asarray(2 * np.arctan2(solid, below))


# -- loops -------------------------------------------------------------------------------------------------
def _loops(surface: Surface) -> list[Int64s] | None:
    """Find loops of unbalanced edges, each in the direction of the triangles that would close it.

    Returns None if there are too many.
    """
    faces, of = surface.triangles, surface.edges.edge_of.reshape(-1)
    tail, head = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    net = np.bincount(of, np.where(tail < head, 1, -1)).astype(np.int64)
    unbalanced = np.flatnonzero(net)
    if np.abs(net[unbalanced]).sum() > _MAX_OPEN_EDGES:
        return None
    endpoints = np.zeros((len(net), 2), np.int64)
    endpoints[of] = np.sort(np.stack([tail, head], axis=1), axis=1)
    after: dict[int, list[int]] = {}
    for (low, high), excess in zip(endpoints[unbalanced].tolist(), net[unbalanced].tolist()):
        u, v = (high, low) if excess > 0 else (low, high)  # against the existing triangle
        after.setdefault(u, []).extend([v] * abs(excess))
    loops = []
    for first in list(after):
        while after.get(first):
            path, index_of = [first], {first: 0}
            while after.get(path[-1]):
                corner = after[path[-1]].pop()
                if corner in index_of:  # a loop has closed: cut it off
                    loop_start = index_of[corner]
                    loops.append(np.array(path[loop_start:], np.int64))
                    for removed in path[loop_start + 1 :]:
                        del index_of[removed]
                    del path[loop_start + 1 :]
                else:
                    index_of[corner] = len(path)
                    path.append(corner)
    return [loop for loop in loops if len(loop) > 2]


def _areas(vertices: Float64s, triangles: NDArray[Any]) -> Float64s:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.asarray(lengths_of(np.cross(b - a, c - a)) / 2)


# -- patches -----------------------------------------------------------------------------------------------
def _patch(loop: Int64s, vertices: Float64s, max_corners: int) -> Int32s:
    """Triangulate a loop, int32 [len(loop) - 2, 3]."""
    triangles = []
    while len(loop) > max_corners:
        cut = np.arange(0, len(loop) - 2, 2)
        triangles.append(np.stack([loop[cut], loop[cut + 1], loop[cut + 2]], axis=1))
        loop = np.delete(loop, cut + 1)
    points, n = vertices[loop], len(loop)
    cost = np.zeros((n, n))
    best = np.zeros((n, n), np.int64)
    for gap in range(2, n):
        i = np.arange(n - gap)[:, None]
        j = i + np.arange(1, gap)
        k = i + gap
        area = lengths_of(np.cross(points[j] - points[i], points[k] - points[i]))
        total = cost[i, j] + cost[j, k] + area
        choice = total.argmin(axis=1)
        best[i[:, 0], k[:, 0]] = j[i[:, 0], choice]
        cost[i[:, 0], k[:, 0]] = total[i[:, 0], choice]
    stack = [(0, n - 1)]
    while stack:
        first, last = stack.pop()
        if last - first > 1:
            middle = int(best[first, last])
            triangles.append(loop[None, [first, middle, last]])
            stack += [(first, middle), (middle, last)]
    return np.concatenate(triangles).astype(np.int32)


# -- facing ------------------------------------------------------------------------------------------------
def _orient(triangles: Int32s, edges: Edges) -> tuple[Int32s, int, bool]:
    """Flip triangles so that neighbours face alike.

    Returns them, the number flipped, and whether all agree.

    The majority of each part keeps its orientation. Each triangle is two nodes of a graph, as it is and
    flipped; consistent nodes of neighbours are connected.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(triangles)
    flat = edges.edge_of.reshape(-1)
    is_up = (triangles < np.roll(triangles, -1, axis=1)).reshape(-1)
    order = np.argsort(flat, kind="stable")
    pairs = np.flatnonzero(np.bincount(flat) == 2)
    first = order[np.searchsorted(flat[order], pairs)]
    second = order[np.searchsorted(flat[order], pairs) + 1]
    flip = (is_up[first] == is_up[second]).astype(np.int64)
    f, g = first // 3, second // 3
    rows = np.concatenate([2 * f, 2 * f + 1])
    columns = np.concatenate([2 * g + flip, 2 * g + 1 - flip])
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(2 * count, 2 * count))
    _, label = connected_components(graph, directed=False)
    as_is, over = label[0::2], label[1::2]
    votes = np.bincount(as_is, minlength=label.max() + 1)
    is_flipped = (votes[over] > votes[as_is]) | ((votes[over] == votes[as_is]) & (over < as_is))
    return (
        np.where(is_flipped[:, None], triangles[:, ::-1], triangles),
        int(is_flipped.sum()),
        bool((as_is != over).all()),
    )
