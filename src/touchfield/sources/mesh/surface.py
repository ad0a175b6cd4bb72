"""Triangle meshes: edges, closedness, angle-weighted pseudo-normals, vertices that are one, and holes.

Source of the pseudo-normals: J. A. Baerentzen and H. Aanaes, Signed distance computation using the angle
weighted pseudonormal, IEEE TVCG 11(3), 2005: at a vertex the normals of its faces weighted by their angles
there, on an edge the sum of its two. Their sign tells on which side a point is whose nearest point is there.

Holes are loops of the edges that are run through more often in one direction than in the other, which are a
cycle. The rule: a hole is small if the patch that closes it has at most 5 % of the area of the connected part
it lies in. "small" closes those and leaves the others, "close" closes all, "leave" none. Where triangles face
inconsistently they are turned, but only if what results is closed; else nothing says where a hole has its
inside. Source of the patch: G. Barequet and M. Sharir, Filling gaps in the boundary of a polyhedron, CAGD
12(2), 1995: of all triangulations of the loop the one of least area. Of a long loop every second corner is
first cut off, until 128 are left. No vertex is added, so that a patch moves with its mesh.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float64s, Int32s, Int64s, lengths_of
from touchfield.errors import SourceError, require_one_of

_LARGEST_M: Final = 1e15
# of the extent: vertices this near are joined where that closes the mesh (the digits of float32), in a mesh
# that moves only if they never part farther than the second (those of 8-bit weights)
_WELD, _TOGETHER = 1e-7, 1e-3

HOLES: Final = {"small": 0.05, "close": np.inf, "leave": -1.0}  # of its part: the largest hole that is closed
# a part with more of its area missing is a sheet: its wall lies behind its faces, not within what they
# enclose
_NEARLY_CLOSED: Final = 0.75
_FLAT: Final = 0.999  # cosine between the triangles of a polygon and its whole, of one that counts as flat
_MOST_EDGES: Final = 1 << 18
_LONGEST, _LONGEST_OF_MANY, _MANY = 128, 24, 100
_MOST_TOLD: Final = 5


@dataclass(frozen=True)
class Edges:
    """Edges at which the triangles of a mesh meet."""

    edge_of: Int64s  # int64 [m, 3]; the edge from vertex i to vertex i + 1 of each triangle
    boundary_count: int  # edges of one triangle only
    unbalanced_count: int  # edges that are not run through as often in one direction as in the other
    repeated_count: (
        int  # edges run through twice in one direction: neighbours that face opposite ways, or fans
    )

    @classmethod
    def of(cls, triangles: Int32s, vertex_count: int) -> Edges:
        """The edges of triangles int32 [m, 3]."""
        begin, end = triangles.reshape(-1).astype(np.int64), np.roll(triangles, -1, axis=1).reshape(-1)
        key = np.minimum(begin, end) * vertex_count + np.maximum(begin, end)
        keys, edge_of = np.unique(key, return_inverse=True)
        along = np.bincount(edge_of[begin < end], minlength=len(keys))
        against = np.bincount(edge_of[begin > end], minlength=len(keys))
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
    name : str; What to call it in messages.

    Raises `SourceError` if there is no triangle left, or a number is out of range or not finite.

    Attributes
    ----------
    vertices_m : float64 [n, 3], read-only
    triangles : int32 [m, 3], read-only; Each begins with its longest edge; those with a vertex twice are left
        out.
    is_closed : bool; Whether it encloses something: every edge is balanced, and it is not a sheet laid
        double.
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
        self._name, self._used = name, np.unique(faces)
        self.triangles = np.take_along_axis(faces, from_longest(vertices[faces]), axis=1)
        self.edges = Edges.of(self.triangles, len(vertices))
        self.is_closed = self.edges.unbalanced_count == 0 and not _is_double_sheet(self.triangles)
        self._hold(vertices)

    def _hold(self, vertices: Float64s) -> None:
        used = vertices[self._used]
        self.bounds_m: Float64s = np.stack([used.min(axis=0), used.max(axis=0)])
        self.vertices_m = np.ascontiguousarray(vertices)
        for array in (self.vertices_m, self.triangles, self.bounds_m):
            array.flags.writeable = False

    def with_vertices(self, vertices_m: ArrayLike) -> Surface:
        """The same triangles on other vertices: a frame of a mesh that moves.

        Which edges meet and whether it is closed is taken over; each triangle begins with what is now its
        longest edge. Vertices that no triangle uses do not matter.

        `vertices_m` float array [n, 3]: as many as this surface has.

        Raises `SourceError` if the shape differs, or a coordinate is not finite.
        """
        vertices = np.array(vertices_m, np.float64)
        if vertices.shape != self.vertices_m.shape:
            found = f"vertices of shape {vertices.shape}"
            raise SourceError(self._name, found, f"{self.vertices_m.shape}, as before")
        _check_finite(vertices[self._used], self._name)
        other = copy.copy(self)
        turn = from_longest(vertices[self.triangles])
        other.triangles = np.take_along_axis(self.triangles, turn, axis=1)
        other.edges = replace(self.edges, edge_of=np.take_along_axis(self.edges.edge_of, turn, axis=1))
        other._hold(vertices)
        return other

    def with_triangles(self, triangles: Int32s) -> Surface:
        """Other triangles on the same vertices, checked anew."""
        return Surface(self.vertices_m, triangles, self._name)

    def part_of_vertex(self) -> Int32s:
        """The connected part of each vertex, int32 [n]; a vertex of no triangle is a part of its own."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        begin, end = self.triangles.reshape(-1), np.roll(self.triangles, -1, axis=1).reshape(-1)
        count = len(self.vertices_m)
        graph = coo_array((np.ones(len(begin), np.int8), (begin, end)), shape=(count, count))
        parts: Int32s = connected_components(graph, directed=False)[1]
        return parts

    def volume_m3(self) -> float:
        """The signed volume of a closed mesh: negative where its triangles face inwards."""
        a, b, c = ((self.vertices_m - self.bounds_m[0])[self.triangles[:, i]] for i in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    def pseudo_normals(self) -> Float64s:
        """Unit normals of each triangle's face, vertices 0 to 2 and edges 01, 12, 20, float64 [m, 7, 3].

        Where they cancel (opposite faces that meet), the face's own normal stands.
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
        which = np.nonzero(cancelled)
        normals[which] = face[which[0]]
        return normals


def _check_finite(vertices: Float64s, name: str) -> None:
    bad = int(np.count_nonzero(~(np.abs(vertices) < _LARGEST_M).all(axis=1)))
    if bad:
        raise SourceError(
            name, f"{bad} vertices with a coordinate that is NaN or beyond {_LARGEST_M:g} m", "less"
        )


def from_longest(corners: Float64s) -> Int64s:
    """The order of the corners of triangles, [m, 3, 3], that begins with the longest edge of each, int64 [m,
    3].
    """
    sides = lengths_of(np.roll(corners, -1, axis=1) - corners)
    order: Int64s = (np.arange(3) + sides.argmax(axis=1)[:, None]) % 3
    return order


def unit(vectors: Float64s) -> Float64s:
    """Vectors [..., 3] of length 1; 0 for those without length."""
    lengths = lengths_of(vectors)[..., None]
    return np.asarray(vectors / np.where(lengths > 0, lengths, 1.0))


def _is_double_sheet(triangles: Int32s) -> bool:
    """True if every triangle has a twin that faces the other way: balanced edges, but nothing within."""
    ascending = np.sort(triangles, axis=1)
    _, group = places(ascending)
    after_least = np.take_along_axis(triangles, (triangles.argmin(axis=1)[:, None] + 1) % 3, axis=1)[:, 0]
    return not np.bincount(group, np.where(after_least != ascending[:, 1], -1.0, 1.0)).any()


def joined(vertices: NDArray[Any], triangles: NDArray[Any]) -> tuple[Float64s, Int32s]:
    """The mesh with vertices at one place made one."""
    points = np.asarray(vertices, np.float64) + 0.0  # -0.0 is 0.0
    first, number = places(points)
    return points[first], number[triangles].astype(np.int32)


def places(points: NDArray[Any], tolerance: float = 0.0) -> tuple[Int64s, Int64s]:
    """Places of points [n, d]: one of the points at each, and the place of each point, int64 [n]."""
    rounded = np.round(points / tolerance) if tolerance > 0 else points
    order = np.lexsort(rounded.T)
    ordered = rounded[order]
    is_new = np.append(True, (ordered[1:] != ordered[:-1]).any(axis=1))
    number = np.empty(len(points), np.int64)
    number[order] = np.cumsum(is_new) - 1
    return order[is_new].astype(np.int64), number


# -- which vertices are one: those at one place, and in a mesh that moves only if they stay together ---------
def welded(
    vertices: NDArray[Any], triangles: NDArray[Any], sizes: Int64s | None = None
) -> tuple[Float64s, Int32s]:
    """The mesh with equal vertices made one; nearly equal ones too, if that closes it.

    `sizes` int64 [p]: how many triangles in a row are a polygon each, cut as a fan; these are `unfolded`.
    """
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        return vertices, triangles.astype(np.int32)  # the scene will say so
    points, faces = joined(vertices, triangles)
    if sizes is not None:
        faces = unfolded(points, faces, sizes)
    if not np.isfinite(points).all():
        return points, faces  # the scene will say so
    kept, faces = welded_in_motion(points[None], faces)
    return points[kept], faces


def unfolded(points: Float64s, fans: Int32s, sizes: Int64s) -> Int32s:
    """Polygons cut as fans from their first corner, with those that are concave cut anew.

    Of a concave one some triangles of the fan lie upside down, partly outside; `_patch` cuts it along its
    outline.
    """
    faces, first = fans.copy(), np.cumsum(sizes) - sizes
    corners = points[fans]
    with np.errstate(all="ignore"):  # what is not finite, the scene will say
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        whole = np.repeat(np.add.reduceat(normals, first), sizes, axis=0)
        along, size = np.einsum("ij,ij->i", normals, whole), lengths_of(normals) * lengths_of(whole)
        is_turned, is_flat = along < -_FLAT * size, np.abs(along) >= _FLAT * size
    is_folded = np.logical_or.reduceat(is_turned, first) & np.logical_and.reduceat(is_flat, first)
    most = _LONGEST if np.count_nonzero(is_folded) <= _MANY else _LONGEST_OF_MANY
    for begin, end in zip(first[is_folded], (first + sizes)[is_folded]):
        loop = np.append(fans[begin, :2], fans[begin:end, 2]).astype(np.int64)
        faces[begin:end] = _patch(loop, points, most)
    return faces


def welded_in_motion(poses: Float64s, triangles: NDArray[np.integer[Any]]) -> tuple[Int64s, Int32s]:
    """Vertices of a mesh in motion to keep, ascending, and the triangles in their numbers.

    Vertices that are at the same place in every pose are one. If that leaves the mesh open, those that meet
    at rest and hardly part are one as well, if that closes it. Parts that only touch at rest stay apart.

    `poses` float64 [s, n, 3]: some poses, finite; the first is at rest; `triangles` integer [m, 3].
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


# -- holes -------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Mended:
    """A surface with holes closed, and what is left open."""

    surface: Surface
    # int32 [l, 3]; would close what is left open of a nearly closed mesh: tell inside, and are not felt
    lids: Int32s
    rim: Int32s  # int32 [r, 2]; edges at the holes that are left
    is_oriented: bool  # whether neighbouring triangles face alike
    notes: tuple[str, ...]


class _Hole(NamedTuple):
    loop: Int64s
    patch: Int32s
    part: int  # connected part of the surface that it lies in
    area_m2: float
    share: float  # of the area of that part
    across_m: float


def mended(surface: Surface, holes: str) -> Mended:
    """Close the holes of a surface by a rule: "small", "close" or "leave"; `InvalidArgument` for another
    word.
    """
    require_one_of("holes", holes, HOLES)
    none, is_mixed = np.zeros((0, 3), np.int32), surface.edges.repeated_count > 0
    as_it_is = Mended(surface, none, none[:, :2], not is_mixed, ())
    if surface.is_closed:
        return replace(as_it_is, is_oriented=True)
    notes: tuple[str, ...] = ()
    done, loops = surface, None
    if is_mixed:
        faces, count, is_two_sided = _turned(surface.triangles, surface.edges)
        done = surface.with_triangles(faces)
        if count:
            notes = (f"{count} triangles turned to face as their neighbours do",)
    if not is_mixed or is_two_sided:
        loops = _loops(done)
    if loops is None:  # no side is known, or there are too many
        return as_it_is
    part_of, vertices = done.part_of_vertex(), done.vertices_m
    areas = np.bincount(part_of[done.triangles[:, 0]], _areas(vertices, done.triangles))
    gaps = []
    for loop in loops:
        patch, part = (
            _patch(loop, vertices, _LONGEST if len(loops) <= _MANY else _LONGEST_OF_MANY),
            part_of[loop[0]],
        )
        area, across = (
            float(_areas(vertices, patch).sum()),
            float(np.linalg.norm(np.ptp(vertices[loop], axis=0))),
        )
        gaps.append(_Hole(loop, patch, part, area, area / areas[part] if areas[part] > 0 else np.inf, across))
    taken, left = ([h for h in gaps if (h.share <= HOLES[holes]) == is_small] for is_small in (True, False))
    if taken:
        done = done.with_triangles(np.concatenate([done.triangles, *(h.patch for h in taken)]))
    if is_mixed and not done.is_closed:
        return as_it_is
    lids, rim = none, none[:, :2]
    if left:
        rim = np.concatenate([np.stack([h.loop, np.roll(h.loop, -1)], axis=1) for h in left]).astype(np.int32)
        if np.bincount([h.part for h in left], [h.share for h in left]).max() <= _NEARLY_CLOSED:
            lids = np.concatenate([h.patch for h in left])
            if done.with_triangles(np.concatenate([done.triangles, lids])).volume_m3() < 0:
                done, lids = done.with_triangles(done.triangles[:, ::-1]), lids[:, ::-1]
                notes = (*notes, "The triangles faced inwards and are turned over")
    return Mended(done, lids, rim, True, (*notes, *_told(taken, left)))


def _told(taken: list[_Hole], left: list[_Hole]) -> tuple[str, ...]:
    notes = []
    for holes, kind, what in (
        (taken, "hole", "closed"),
        (left, "open outline", "left, where the force falls to 0"),
    ):
        largest = sorted(holes, key=lambda h: -h.area_m2)[:_MOST_TOLD]
        shares = (f"{h.share:.2%} of" if h.share < np.inf else "no area in" for h in largest)
        sizes = ", ".join(f"{h.across_m:.3g} m across ({of} its part)" for h, of in zip(largest, shares))
        if holes:
            more = ", ..." * (len(holes) > _MOST_TOLD)
            notes.append(f"{len(holes)} {kind}{'s' * (len(holes) > 1)} {what}: {sizes}{more}")
    if left and min(h.share for h in left) <= _NEARLY_CLOSED:
        notes[-1] += "; --holes close closes them"
    return tuple(notes)


# -- loops ---------------------------------------------------------------------------------------------------
def _loops(surface: Surface) -> list[Int64s] | None:
    """The loops of the edges that lack a partner, each in the direction of the triangles that would close it.

    None if they are too many.
    """
    faces, of = surface.triangles, surface.edges.edge_of.reshape(-1)
    begin, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    net = np.bincount(of, np.where(begin < end, 1, -1)).astype(np.int64)
    open_ = np.flatnonzero(net)
    if np.abs(net[open_]).sum() > _MOST_EDGES:
        return None
    ends = np.zeros((len(net), 2), np.int64)
    ends[of] = np.sort(np.stack([begin, end], axis=1), axis=1)
    after: dict[int, list[int]] = {}
    for (low, high), much in zip(ends[open_].tolist(), net[open_].tolist()):
        u, v = (high, low) if much > 0 else (low, high)  # against the triangle that is there
        after.setdefault(u, []).extend([v] * abs(much))
    loops = []
    for first in list(after):
        while after.get(first):
            path, place = [first], {first: 0}
            while after.get(path[-1]):
                corner = after[path[-1]].pop()
                if corner in place:  # a loop is closed: cut it off
                    begin_at = place[corner]
                    loops.append(np.array(path[begin_at:], np.int64))
                    for gone in path[begin_at + 1 :]:
                        del place[gone]
                    del path[begin_at + 1 :]
                else:
                    place[corner] = len(path)
                    path.append(corner)
    return [loop for loop in loops if len(loop) > 2]


def _areas(vertices: Float64s, triangles: NDArray[Any]) -> Float64s:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.asarray(lengths_of(np.cross(b - a, c - a)) / 2)


# -- patches -------------------------------------------------------------------------------------------------
def _patch(loop: Int64s, vertices: Float64s, most: int) -> Int32s:
    """Triangles that close a loop, int32 [len(loop) - 2, 3]."""
    triangles = []
    while len(loop) > most:
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


# -- facing --------------------------------------------------------------------------------------------------
def _turned(triangles: Int32s, edges: Edges) -> tuple[Int32s, int, bool]:
    """The triangles turned so that neighbours face alike, most of each part as they were; how many; whether
    all can.

    Each triangle is two nodes of a graph, as it is and turned over; nodes that fit together are joined.
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
    turn = (votes[over] > votes[as_is]) | ((votes[over] == votes[as_is]) & (over < as_is))
    return (
        np.where(turn[:, None], triangles[:, ::-1], triangles),
        int(turn.sum()),
        bool((as_is != over).all()),
    )
