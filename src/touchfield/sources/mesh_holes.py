"""Holes of a mesh: the loops of edges without a partner, which of them are closed, and by what triangles.

The edges that are run through more often in one direction than in the other are a cycle, so that they can always be
walked as loops. The rule: a hole is small if the patch that closes it has at most 5 % of the area of the connected
part it lies in. "small" closes those and leaves the others, "close" closes all, "leave" none. Where triangles face
inconsistently they are turned, but only if what results is closed; else nothing says where a hole has its inside.

Source of the patch: G. Barequet and M. Sharir, Filling gaps in the boundary of a polyhedron, CAGD 12(2), 1995: of all
triangulations of the loop the one of least area. Of a long loop every second corner is first cut off, until 128 are
left. No vertex is added, so that a patch moves with its mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.sources.mesh_surface import Edges, Surface

HOLES: Final = {"small": 0.05, "close": np.inf, "leave": -1.0}  # of its part: the largest hole that is closed
# a part with more of its area missing is a sheet: its wall lies behind its faces, not within what they enclose
_NEARLY_CLOSED: Final = 0.75

_MOST_EDGES: Final = 1 << 18
_LONGEST, _LONGEST_OF_MANY, _MANY = 128, 24, 100
_MOST_TOLD: Final = 5


@dataclass(frozen=True)
class Mended:
    """A surface with holes closed, and what is left open."""

    surface: Surface
    lids: Int32s  # int32 [l, 3]; would close what is left open of a nearly closed mesh: tell inside, and are not felt
    rim: Int32s  # int32 [r, 2]; edges at the holes that are left
    is_oriented: bool  # whether neighbouring triangles face alike
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Hole:
    loop: Int64s
    patch: Int32s
    part: int  # connected part of the surface that it lies in
    area_m2: float
    share: float  # of the area of that part
    across_m: float


def mended(surface: Surface, holes: str) -> Mended:
    """Close the holes of a surface by a rule: "small", "close" or "leave"; `InvalidArgument` for another word."""
    if holes not in HOLES:
        raise InvalidArgument("holes", repr(holes), " or ".join(HOLES))
    none = np.zeros((0, 3), np.int32)
    if surface.is_closed:
        return Mended(surface, none, none[:, :2], True, ())
    notes: tuple[str, ...] = ()
    start = surface
    if surface.edges.repeated_count:
        faces, count, is_two_sided = _turned(surface.triangles, surface.edges)
        start = surface.with_triangles(faces)
        if count:
            notes = (f"{count} triangles turned to face as their neighbours do",)
    loops = _loops(start) if not surface.edges.repeated_count or is_two_sided else None
    if loops is None:  # no side is known, or there are too many
        return Mended(surface, none, none[:, :2], not surface.edges.repeated_count, ())
    gaps = _measured(start, loops)
    share = HOLES[holes]
    taken, left = [h for h in gaps if h.share <= share], [h for h in gaps if h.share > share]
    done = start
    if taken:
        done = start.with_triangles(np.concatenate([start.triangles, *(h.patch for h in taken)]))
    if surface.edges.repeated_count and not done.is_closed:
        return Mended(surface, none, none[:, :2], not surface.edges.repeated_count, ())
    if not left:
        return Mended(done, none, none[:, :2], True, (*notes, *_told(taken, [])))
    lids = none
    rim = np.concatenate([np.stack([h.loop, np.roll(h.loop, -1)], axis=1) for h in left]).astype(np.int32)
    if np.bincount([h.part for h in left], [h.share for h in left]).max() <= _NEARLY_CLOSED:
        lids = np.concatenate([h.patch for h in left])
        if done.with_triangles(np.concatenate([done.triangles, lids])).volume_m3() < 0:
            done, lids = done.with_triangles(done.triangles[:, ::-1]), lids[:, ::-1]
            notes = (*notes, "The triangles faced inwards and are turned over")
    return Mended(done, lids, rim, True, (*notes, *_told(taken, left)))


def _told(taken: list[_Hole], left: list[_Hole]) -> tuple[str, ...]:
    def words(holes: list[_Hole]) -> str:
        largest = sorted(holes, key=lambda h: -h.area_m2)[:_MOST_TOLD]
        sizes = ", ".join(f"{h.across_m:.3g} m across ({h.share:.2%} of its part)" for h in largest)
        return sizes + (", ..." if len(holes) > _MOST_TOLD else "")

    notes = []
    if taken:
        notes.append(f"{len(taken)} hole{'s' * (len(taken) > 1)} closed: {words(taken)}")
    if left:
        text = f"{len(left)} open outline{'s' * (len(left) > 1)} left, where the force falls to 0: {words(left)}"
        notes.append(text + ("; --holes close closes them" if min(h.share for h in left) <= _NEARLY_CLOSED else ""))
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


def _measured(surface: Surface, loops: list[Int64s]) -> list[_Hole]:
    part_of, vertices = surface.part_of_vertex(), surface.vertices_m
    areas = np.bincount(part_of[surface.triangles[:, 0]], _areas(vertices, surface.triangles))
    most = _LONGEST if len(loops) <= _MANY else _LONGEST_OF_MANY
    gaps = []
    for loop in loops:
        patch, part = _patch(loop, vertices, most), int(part_of[loop[0]])
        area, whole = float(_areas(vertices, patch).sum()), float(areas[part])
        across = float(np.linalg.norm(np.ptp(vertices[loop], axis=0)))
        gaps.append(_Hole(loop, patch, part, area, area / whole if whole > 0 else np.inf, across))
    return gaps


def _areas(vertices: Float64s, triangles: NDArray[Any]) -> Float64s:
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    areas: Float64s = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


# -- patches -------------------------------------------------------------------------------------------------
def _patch(loop: Int64s, vertices: Float64s, most: int) -> Int32s:
    """Triangles that close a loop, int32 [len(loop) - 2, 3]."""
    triangles = []
    while len(loop) > most:
        cut = np.arange(0, len(loop) - 2, 2)
        triangles.append(np.stack([loop[cut], loop[cut + 1], loop[cut + 2]], axis=1))
        loop = np.delete(loop, cut + 1)
    triangles.append(loop[_least_area(vertices[loop])])
    return np.concatenate(triangles).astype(np.int32)


def _least_area(points: Float64s) -> Int64s:
    """The triangulation of least area of a loop of points, int64 [n - 2, 3]."""
    n = len(points)
    cost = np.zeros((n, n))
    best = np.zeros((n, n), np.int64)
    for gap in range(2, n):
        i = np.arange(n - gap)[:, None]
        j = i + np.arange(1, gap)
        k = i + gap
        area = np.linalg.norm(np.cross(points[j] - points[i], points[k] - points[i]), axis=2)
        total = cost[i, j] + cost[j, k] + area
        choice = total.argmin(axis=1)
        best[i[:, 0], k[:, 0]] = j[i[:, 0], choice]
        cost[i[:, 0], k[:, 0]] = total[i[:, 0], choice]
    triangles, stack = [], [(0, n - 1)]
    while stack:
        first, last = stack.pop()
        if last - first > 1:
            middle = int(best[first, last])
            triangles.append((first, middle, last))
            stack += [(first, middle), (middle, last)]
    return np.array(triangles, np.int64)


# -- facing --------------------------------------------------------------------------------------------------
def _turned(triangles: Int32s, edges: Edges) -> tuple[Int32s, int, bool]:
    """The triangles turned so that neighbours face alike, most of each part as they were; how many; whether all can.

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
    return np.where(turn[:, None], triangles[:, ::-1], triangles), int(turn.sum()), bool((as_is != over).all())
