"""Reduces a cloud to discs of a surface: spacing, cells, outliers, normals and the side that they face.

1. *Spacing.* Of points with an area s^2 each, the eighth neighbour lies at s sqrt(8 / pi) on average. It is
   measured on some of the points; s of all follows from their number.
2. *Cells* have an edge of two spacings, or 1/512 of the longest side if that is longer, so that 10^7 points
   take no more memory than the surface does. An edge that is too short for the scatter of the points is
   doubled.
3. *Outliers.* Points of a group of cells, none of which is within two cells of another group, are left out if
   the group has fewer than `MIN_GROUP` cells.
4. *Normals* are those of the file, or of the plane of least squares through the neighbours
   (`touchfield.sources.clouds.kernels.planes`). Their side is that of the file, of the scanner, or spreads
   from cell to cell (`touchfield.sources.clouds.kernels.graph`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s, Int32s
from touchfield.compute.threads import for_chunks, worker_count
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.clouds.cloud import Cloud, unit_rows
from touchfield.sources.clouds.kernels import graph
from touchfield.sources.clouds.kernels.cells import HALF_RANGE, Cells, Table, sum_points, table_of
from touchfield.sources.clouds.kernels.planes import fit_planes
from touchfield.sources.clouds.kernels.surface import Surfels

MIN_GROUP: Final = 8
"""Fewest cells of a group of points that is no outlier."""
_CELL_SPACINGS: Final = 2.0  # edge of a cell
_MAX_CELLS: Final = 512  # along the longest side
_SAMPLE: Final = 1 << 16  # points whose neighbours give the spacing
_NEIGHBOURS: Final = 8
_SPARSE: Final = 0.8  # fraction of the points whose spacing the cells are made for ...
_SPARSE_OF_EVEN: Final = 1.15  # ... and that spacing over the median of evenly spread points
_MAX_SCATTER: Final = 0.35  # of an edge: scatter of the points about their planes
_MAX_DOUBLINGS: Final = 2
_UNLIKE: Final = 0.05  # part of neighbours that face apart, above which sides are not trusted
_BALANCED: Final = 0.05  # part of the area that remains of the sum of a closed surface's normals
_UNDECIDED: Final = 0.05
_EDGES_PER_ROW: Final = 8
_APART: Final = -0.7  # cosine of normals that face apart
_BACK_TO_BACK: Final = -0.87  # cosine of normals of the two sides of a wall
_BULKY: Final = 0.1  # part of the cells above which a volume is noted
_ROWS_PER_CELL: Final = 6
_MAX_FLATNESS: Final = 0.3
"""Variance across the plane of the neighbours over that along it, above which they make no surface."""


class Facing(NamedTuple):
    """Normals of discs and how their side was decided."""

    normals: Float64s
    is_trusted: bool
    text: str


@dataclass(frozen=True)
class CloudSurface:
    """The discs of a cloud, and what is known of them.

    spacing_m, scatter_m : float; Median distance of neighbouring points, and of the points from their planes.
    is_trusted : bool; Whether normals of neighbours face alike.
    is_closed : bool; Whether the surface encloses a volume.
    is_bulky : bool; Whether many points fill a volume, as those of vegetation, and lie on no surface.
    notes : tuple of str.
    """

    surfels: Surfels
    spacing_m: float
    scatter_m: float
    is_trusted: bool
    is_closed: bool
    is_bulky: bool
    notes: tuple[str, ...]


class _Fit(NamedTuple):
    """Cells of one edge, and the planes of their points."""

    cells: Cells
    table: Table
    normals: Float64s
    spreads: Float64s
    edge_m: float

    @property
    def scatter(self) -> float:
        """Median scatter about the planes, in edges."""
        return float(np.sqrt(np.median(self.spreads[:, 0])))

    @property
    def bulky(self) -> float:
        """Part of the cells around which the points fill a volume."""
        return float((self.spreads[:, 0] > _MAX_FLATNESS * self.spreads[:, 1]).mean())


def surface_of(cloud: Cloud, side: str, where: str) -> CloudSurface:
    """Reduce a cloud in metres to discs; `side` is the option `normals` of `SourceOptions`.

    Raises `SourceError` if the points make no surface; `InvalidArgument` if `side` needs what the file lacks.
    """
    method, directions = _directions(cloud, side, where)
    spacing_m, sparse_m, longest_m = spacing(cloud.points, where)
    edge_m = max(_CELL_SPACINGS * max(spacing_m, sparse_m / _SPARSE_OF_EVEN), longest_m / _MAX_CELLS)
    origin_m = np.median(cloud.points[:: max(1, len(cloud.points) // _SAMPLE)], axis=0)
    fit, far = _fit(cloud.points, directions, origin_m, edge_m)
    for _ in range(_MAX_DOUBLINGS):
        if fit.scatter < _MAX_SCATTER:
            break
        coarser, coarser_far = _fit(cloud.points, directions, origin_m, 2 * fit.edge_m)
        if coarser.scatter > fit.scatter / 1.4:
            break  # the points fill a volume at any size of cells
        fit, far = coarser, coarser_far
    fit, groups, relative, outliers = _without_outliers(fit)
    facing = _facing(fit, method, cloud.side, groups, relative)
    surfels = _surfels(fit, facing.normals, origin_m)
    bulky = fit.bulky
    is_trusted = facing.is_trusted and bulky < 0.5
    is_closed = is_trusted and _is_closed(surfels)
    scatter_m = fit.scatter * fit.edge_m
    sizes = (
        f"{len(cloud.points)} points, {spacing_m:.3g} m apart (median), scatter by {scatter_m:.2g} m; "
        f"{len(surfels.weights)} discs of cells of {fit.edge_m:.3g} m."
    )
    removed = outliers + far
    rule = f"in groups of fewer than {MIN_GROUP} cells"
    outlier_note = f"{removed} points are left out as outliers, {rule}." if removed else ""
    bulk_note = (
        f"Around {bulky:.0%} of the cells the points fill a volume, which has no normal."
        if bulky > _BULKY
        else ""
    )
    notes = tuple(filter(None, (sizes, outlier_note, bulk_note, f"Normals {facing.text}.")))
    return CloudSurface(surfels, spacing_m, scatter_m, is_trusted, is_closed, bulky > _BULKY, notes)


def spacing(points: Float64s, where: str) -> tuple[float, float, float]:
    """Measure a cloud: median spacing, that of its sparse parts, and its longest side, metres.

    Raises `SourceError` if all points lie at one position.
    """
    from scipy.spatial import cKDTree

    sample = points
    if len(points) > _SAMPLE:
        sample = points[np.unique(np.random.default_rng(0).integers(0, len(points), _SAMPLE))]
    low, high = np.percentile(sample, (1, 99), axis=0)
    longest_m = float((high - low).max()) / 0.98
    distances, _ = cKDTree(sample).query(sample, _NEIGHBOURS + 1, workers=worker_count())
    scale = np.sqrt(np.pi / _NEIGHBOURS) * np.sqrt(len(sample) / len(points))
    median_m, sparse_m = scale * np.quantile(distances[:, -1], (0.5, _SPARSE))
    if not longest_m > 0 or not max(median_m, longest_m / _MAX_CELLS) > 0:
        found = "points of which most lie at one position"
        raise SourceError(where, found, "points of a surface", "Check --unit-m, and the file.")
    return float(median_m), float(sparse_m), longest_m


# -- cells and planes --------------------------------------------------------------------------------------
def _directions(cloud: Cloud, side: str, where: str) -> tuple[str, Float32s]:
    """Return what decides the side, and the direction of each point, float32 [n, 3] or [0, 3]."""
    has_normals, has_scanner = len(cloud.normals) > 0, bool(cloud.scanners)
    needs = {"given": (has_normals, "normals"), "scanner": (has_scanner, "positions of a scanner")}
    if side in needs and not needs[side][0]:
        mend = "Take auto, up, outward or inward."
        raise InvalidArgument("--normals", f"{side} for {where}, which has no {needs[side][1]}", "", mend)
    if side == "given" or (side == "auto" and has_normals):
        return "given", np.asarray(unit_rows(cloud.normals), np.float32)
    if side == "scanner" or (side == "auto" and has_scanner):
        return "scanner", cloud.directions_to_scanner()
    return (cloud.side if side == "auto" else side), np.zeros((0, 3), np.float32)


def _fit(points: Float64s, directions: Float32s, origin_m: Float64s, edge_m: float) -> tuple[_Fit, int]:
    cells, far = sum_points(points, directions, origin_m, edge_m)
    table, count = table_of(cells), len(cells.keys)
    normals, spreads, occupied = np.empty((count, 3)), np.empty((count, 3)), np.empty(count, np.int32)
    for_chunks(fit_planes, count, cells, table, normals, spreads, occupied, chunk=256)
    return _Fit(cells, table, normals, spreads, edge_m), far


def _without_outliers(fit: _Fit) -> tuple[_Fit, Int32s, Float64s, int]:
    """Leave out points of small groups of cells.

    Returns the rest, the group of each row int32 [n], the sign [n] with which its normal agrees with those of
    its group, and the number of points left out.
    """
    count = len(fit.cells.keys)
    parents, signs = np.arange(count, dtype=np.int32), np.ones(count, np.int8)
    roots, relative = np.empty(count, np.int32), np.empty(count, np.int8)
    nothing: Int32s = np.zeros(0, np.int32)
    _join(fit, 1, np.ones(count, np.bool_), nothing, parents, signs)
    graph.roots_of(parents, signs, roots, relative)
    size = np.bincount(roots, minlength=count)[roots]
    if (size < MIN_GROUP).any():
        _join(fit, 2, size < MIN_GROUP, roots.copy(), parents, signs)
        graph.roots_of(parents, signs, roots, relative)
        size = np.bincount(roots, minlength=count)[roots]
    is_kept = size >= MIN_GROUP if size.max() >= MIN_GROUP else np.ones(count, np.bool_)
    outliers = int(fit.cells.moments[~is_kept, 0].sum())
    if not is_kept.all():
        cells = fit.cells.selected(is_kept)
        fit = _Fit(cells, table_of(cells), fit.normals[is_kept], fit.spreads[is_kept], fit.edge_m)
    _, groups = np.unique(roots[is_kept], return_inverse=True)
    return fit, groups.astype(np.int32), relative[is_kept].astype(np.float64), outliers


def _join(
    fit: _Fit, reach: int, is_start: Bools, roots: Int32s, parents: Int32s, signs: NDArray[np.int8]
) -> None:
    """Join neighbours into groups, those with the most similar normals first."""
    edges, levels = _edges(fit, reach, is_start, roots)
    order = np.argsort(levels, kind="stable")
    graph.join(edges, order, fit.normals, parents, signs)


def _edges(fit: _Fit, reach: int, is_start: Bools, roots: Int32s) -> tuple[Int32s, NDArray[np.uint8]]:
    capacity = _EDGES_PER_ROW * (int(np.count_nonzero(is_start)) + 64)
    while True:
        edges, levels = np.empty((capacity, 2), np.int32), np.empty(capacity, np.uint8)
        arguments = (fit.cells, fit.table, fit.normals, reach, is_start, roots, edges, levels)
        count = graph.find_edges(*arguments)
        if count <= capacity:
            return edges[:count], levels[:count]
        capacity = count


# -- the side that the surface faces -----------------------------------------------------------------------
def _facing(fit: _Fit, method: str, default_side: str, groups: Int32s, relative: Float64s) -> Facing:
    """Decide the sides of normals."""
    if method not in ("given", "scanner"):
        normals = _spread(fit, method, groups, relative)
        unlike = _unlike(fit, normals)
        text = f"are estimated from the neighbours and face {method}"
        return Facing(normals, unlike <= _UNLIKE, text + _doubt(unlike))
    normals, sums = fit.normals.copy(), fit.cells.moments[:, 10:13]
    lengths = np.linalg.norm(sums, axis=1)
    if method == "given":
        is_clear = lengths > 0.5 * fit.cells.moments[:, 0]
        normals[is_clear] = sums[is_clear] / lengths[is_clear, None]
    is_blind = lengths == 0  # no direction in this cell: as its group
    sides = np.sign((normals * fit.normals).sum(axis=1)) * relative
    votes = np.bincount(groups, np.where(is_blind, 0.0, sides * fit.cells.moments[:, 0]))
    agreed = np.where(votes[groups] < 0, -1.0, 1.0) * relative
    normals[is_blind] = fit.normals[is_blind] * agreed[is_blind, None]
    unlike = _unlike(fit, normals)
    text = "are those of the file" if method == "given" else "are estimated and face the scanner"
    if unlike <= _UNLIKE:
        return Facing(normals, True, text)
    spread = _spread(fit, default_side, groups, relative)
    left = _unlike(fit, spread)
    if left > _UNLIKE:
        return Facing(normals, False, text + _doubt(unlike))
    axis = np.where((spread * normals).sum(axis=1) < 0, -1.0, 1.0)[:, None] * normals
    text += f", but {unlike:.0%} of neighbours face apart: turned to face {default_side}"
    return Facing(axis, True, text)


def _doubt(unlike: float) -> str:
    """Return how many neighbours face apart, if that is notable."""
    return f" ({unlike:.0%} of neighbours face apart)" if unlike > _UNLIKE / 5 else ""


def _spread(fit: _Fit, side: str, groups: Int32s, relative: Float64s) -> Float64s:
    """Return normals whose sides agree within each group; a group faces up, outward or inward as a whole."""
    normals = fit.normals * relative[:, None]
    weights = _areas(normals)
    positions = _positions(fit.cells)
    total = np.maximum(np.bincount(groups, weights), 1e-300)
    centres = np.stack([np.bincount(groups, weights * x) / total for x in positions.T], axis=1)
    offsets = positions - centres[groups]
    out = np.bincount(groups, weights * (normals * offsets).sum(axis=1))
    out_size = np.bincount(groups, weights * np.linalg.norm(offsets, axis=1))
    mean = np.stack([np.bincount(groups, weights * n) for n in normals.T], axis=1)
    up = mean[:, 2]
    main = np.take_along_axis(mean, np.abs(mean).argmax(axis=1)[:, None], axis=1)[:, 0]
    is_out_clear, is_up_clear = np.abs(out) > _UNDECIDED * out_size, np.abs(up) > _UNDECIDED * total
    if side == "up":
        vote = np.where(is_up_clear, up, np.where(is_out_clear, out, main))
    else:
        vote = np.where(is_out_clear, out, np.where(is_up_clear, up, main)) * (-1 if side == "inward" else 1)
    return normals * np.where(vote < 0, -1.0, 1.0)[groups][:, None]


def _unlike(fit: _Fit, normals: Float64s) -> float:
    """Return the part of the rows that contradict a neighbour: they face apart and are not back to back.

    Neighbours lie in the same cell or in the next one along an axis; of the rows of a cell, whose points face
    apart, the most similar one counts.
    """
    keys, positions, bad = np.append(fit.cells.keys, -1), _positions(fit.cells), 0
    for step in (0, 1, 1 << 21, 1 << 42):
        first = np.searchsorted(fit.cells.keys, fit.cells.keys + step)
        cosines, fronts = np.full(len(first), -np.inf), np.zeros(len(first))
        for row in range(_ROWS_PER_CELL):
            at = np.minimum(first + row, len(first))
            pairs = np.flatnonzero((keys[at] == fit.cells.keys + step) & (at != np.arange(len(at))))
            if not len(pairs) and step:
                break
            others = at[pairs]
            cosine = (normals[pairs] * normals[others]).sum(axis=1)
            front = ((positions[pairs] - positions[others]) * normals[pairs]).sum(axis=1)
            is_better = cosine > cosines[pairs]
            cosines[pairs[is_better]], fronts[pairs[is_better]] = cosine[is_better], front[is_better]
        bad += int(np.count_nonzero(np.isfinite(cosines) & (cosines < _APART) & (fronts <= 0)))
    return bad / len(normals)


# -- discs -------------------------------------------------------------------------------------------------
def _positions(cells: Cells) -> Float64s:
    """Return the means of the points of each row relative to the origin of the cells, in edges, [n, 3]."""
    keys, mask = cells.keys, 2 * HALF_RANGE - 1
    index = np.stack([keys >> 42, (keys >> 21) & mask, keys & mask], axis=1) - HALF_RANGE
    return np.asarray(index + 0.5 + cells.moments[:, 1:4] / cells.moments[:, :1])


def _areas(normals: Float64s) -> Float64s:
    """Return the area of a surface per cell that it meets, in squared edges: an oblique one meets more."""
    return np.asarray(1.0 / np.abs(normals).sum(axis=1))


def _surfels(fit: _Fit, normals: Float64s, origin_m: Float64s) -> Surfels:
    positions_m = origin_m + fit.edge_m * _positions(fit.cells)
    weights = fit.cells.moments[:, 0].copy()
    return Surfels(positions_m, normals, weights, fit.cells, fit.table, origin_m, fit.edge_m)


def coarser(surfels: Surfels, factor: int) -> Surfels:
    """Return discs of cells that are `factor` times as long; each holds the mean of those within it.

    Discs that face opposite ways stay apart.
    """
    directions = np.asarray(surfels.normals, np.float32)
    cells, _ = sum_points(surfels.positions_m, directions, surfels.origin_m, factor * surfels.edge_m)
    sums, table, edge_m = cells.moments[:, 10:13], table_of(cells), factor * surfels.edge_m
    normals = np.asarray(unit_rows(sums), np.float64)
    positions_m = surfels.origin_m + edge_m * _positions(cells)
    return Surfels(positions_m, normals, cells.moments[:, 0].copy(), cells, table, surfels.origin_m, edge_m)


class Growth(NamedTuple):
    """How far discs move along their normals, and the wall that grows most, before and after."""

    motions_m: Float64s  # float64 [n]; 0 where the wall is thick enough
    thickness_m: float
    thickened_m: float


def growth_of(surfels: Surfels, needed_m: Float64s) -> Growth | None:
    """Measure the walls between discs that lie back to back; None if all are thick enough.

    A disc counts if half of its neighbours are as thin.

    needed_m : float64 [n]; the least thickness of a wall along the normal of each disc.
    """
    from scipy.spatial import cKDTree

    tree, thickness_m = cKDTree(surfels.positions_m), np.full(len(needed_m), np.inf)
    for depth_m in np.arange(0.5, needed_m.max() / surfels.edge_m + 0.5) * surfels.edge_m:
        is_open = np.flatnonzero(np.isinf(thickness_m) & (needed_m > depth_m - surfels.edge_m))
        if not len(is_open):
            break
        normals = surfels.normals[is_open]
        at = surfels.positions_m[is_open] - depth_m * normals
        distance, found = tree.query(at, distance_upper_bound=surfels.edge_m, workers=worker_count())
        is_found = np.isfinite(distance)
        discs, behind, normals = is_open[is_found], found[is_found], normals[is_found]
        is_back = (surfels.normals[behind] * normals).sum(axis=1) < _BACK_TO_BACK
        discs, behind, normals = discs[is_back], behind[is_back], normals[is_back]
        thickness_m[discs] = ((surfels.positions_m[discs] - surfels.positions_m[behind]) * normals).sum(
            axis=1
        )
    is_thin = (thickness_m >= 0) & (thickness_m < needed_m)
    thin = np.flatnonzero(is_thin)
    if len(thin):  # a wall is more than a disc
        _, near = tree.query(surfels.positions_m[thin], min(_NEIGHBOURS + 1, len(is_thin)))
        is_thin[thin] = is_thin[near].mean(axis=1) >= 0.5
    if not is_thin.any():
        return None
    motions_m = np.where(is_thin, (needed_m - np.where(is_thin, thickness_m, 0.0)) / 2, 0.0)
    worst = int(motions_m.argmax())
    return Growth(motions_m, float(thickness_m[worst]), float(needed_m[worst]))


def grown(surfels: Surfels, motions_m: Float64s) -> Surfels:
    """Return discs that are moved along their normals by motions float64 [n]."""
    moved = surfels._replace(positions_m=surfels.positions_m + motions_m[:, None] * surfels.normals)
    return coarser(moved, 1)


def _is_closed(surfels: Surfels) -> bool:
    """Return True if the areas of all discs cancel, and enclose a positive volume."""
    areas = _areas(surfels.normals)[:, None] * surfels.normals
    total = float(np.linalg.norm(areas, axis=1).sum())
    offsets = surfels.positions_m - surfels.positions_m.mean(axis=0)
    is_balanced = float(np.linalg.norm(areas.sum(axis=0))) < _BALANCED * total
    return is_balanced and float((areas * offsets).sum()) > 0
