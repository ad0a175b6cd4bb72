"""Compiled inner loops of `MeshScene`: find the nearest triangle of every sample near a mesh, and compute the
force there.

The candidate triangles of a brick are found by descent from one cell that holds the whole grid. A child cell
of half the size, with centre c and radius r, keeps the triangles of its parent with d(c) <= min d(c) + 2 r
that are also within the band, d(c) <= band + r; no other triangle can be nearest to a sample of the child.
Nothing is allocated for the rest of the grid. The search uses float32, in units of the largest spacing and
relative to the brick; distance and direction to the triangle found are then evaluated in float64.

The damping of a moving surface is b times the velocity of the nearest point (paper 3.2); within a triangle
the velocity is interpolated linearly between the corners, like their positions. A wall ends with its surface:
the force is multiplied by min(1, s / w), with s the distance of the nearest surface point to the rim. If that
point lies on the rim itself, the sample lies beside the surface and there is no force.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium import Grid
from touchfield.medium.brick_buffer import BATCH_BRICKS, BrickBuffer
from touchfield.sources.mesh.kernels import triangle as tri
from touchfield.sources.mesh.kernels.sign import COLUMN_SHIFT, bricks_inside, winding_of_brick
from touchfield.sources.terrain.kernels import amplitude as amplitude_at

CLOSED, ONE_SIDED, TWO_SIDED, LIDDED = 0, 1, 2, 3
"""Source of the sign of a distance: the winding number; the pseudo-normal; the half thickness of the wall;
the pseudo-normal, but behind the surface only where the winding number of the mesh with closed holes is not
0.
"""

_SLACK = np.float32(1e-3)  # of the largest spacing: far above the rounding of the search, far below a sample
_0 = np.float32(0)


class Band(NamedTuple):
    """The range of distances with forces, and their sign."""

    sidedness: int  # `CLOSED`, `ONE_SIDED`, `TWO_SIDED` or `LIDDED`
    # largest distance with a force, on the negative and on the positive side; negative if there is no force
    # on that side
    inner_m: float
    outer_m: float
    half_wall_m: float  # subtracted from the distances to a two-sided sheet
    pieces: Float64s  # float64 [n, 4]; `ForceProfile.table`


class Motion(NamedTuple):
    """Motion of a surface."""

    # int32 [m, 3]; triangle of each row of the table (of a piece: its parent), starting with its longest edge
    triangles: Int32s
    vertices_m: Float64s  # float64 [n, 3]
    velocities_m_s: Float64s  # float64 [n, 3]; of the vertices
    damping_n_s_per_m: float  # b


@inner(forceinline=True)
def _sample_position(bricks, b, i, j, k, lattice):
    """Return the position of a sample of a brick, metres."""
    x = lattice[0] + (bricks[b, 0] * 8 + i) * lattice[3]
    y = lattice[1] + (bricks[b, 1] * 8 + j) * lattice[4]
    z = lattice[2] + (bricks[b, 2] * 8 + k) * lattice[5]
    return x, y, z


# -- from the grid down to its bricks ----------------------------------------------------------------------
@kernel
def _descend(start, stop, cells, starts, ids, table, lattice, shape, size, limit, needed, keep, counts):
    """Select the triangles of each cell for its eight children: a bit for each child, and counts.

    `needed` bool [x, y, z]: children that may have a force; empty for all.
    """
    scale = 1.0 / lattice[3:].max()
    steps = lattice[3:] * scale
    half = size // 2
    block = np.empty(320, np.float32)
    radius = tri.set_centres(block, half, steps)
    reach = 2.0 * radius * size / max(half - 1, 1)
    tiles = tri.tiles_for(start, stop, starts[:-1], starts[1:])
    for cell in range(start, stop):
        first, count = starts[cell], starts[cell + 1] - starts[cell]
        i, j, k = cells[cell, 0] * size, cells[cell, 1] * size, cells[cell, 2] * size
        x, y, z = lattice[0] + i * lattice[3], lattice[1] + j * lattice[4], lattice[2] + k * lattice[5]
        tri.localise_all(ids[first : first + count], table, x, y, z, scale, reach, block, tiles)
        keep[first : first + count] = 0
        for s in range(8):
            ci, cj, ck = i + (s >> 2) * half, j + ((s >> 1) & 1) * half, k + (s & 1) * half
            if ci >= shape[0] or cj >= shape[1] or ck >= shape[2]:
                continue
            if needed.size > 0 and not needed[ci // half, cj // half, ck // half]:
                continue
            nearest = np.sqrt(tri.nearest_to_centre(tiles, count, s)[1])
            max_square = min(nearest + 2 * radius, limit + radius) * np.float32(1 + 1e-5) + _SLACK
            max_square = max_square * max_square
            counts[cell, s] = tri.keep_near(tiles, count, s, max_square, keep[first : first + count])


@kernel
def _distribute(start, stop, starts, ids, keep, offsets, out):
    for cell in range(start, stop):
        for s in range(8):
            o = offsets[cell, s]
            for c in range(starts[cell], starts[cell + 1]):
                if (keep[c] >> s) & 1:
                    out[o] = ids[c]
                    o += 1


# -- a brick -----------------------------------------------------------------------------------------------
@inner(forceinline=True)
def _force(table, normals, t, x, y, z, is_inside, rule, pieces):
    """Return the force at (x, y, z), given its nearest triangle t.

    Its x is NaN if the direction is that of a normal, and there are no normals.
    """
    sidedness, half_wall, tiny = rule
    dx, dy, dz, edge, along = tri.nearest(table, t, x, y, z)
    distance = math.sqrt(dx * dx + dy * dy + dz * dz)
    if sidedness in (ONE_SIDED, LIDDED):
        f = tri.feature(table, t, edge, along)
        is_enclosed = is_inside or sidedness == ONE_SIDED
        is_inside = dx * normals[t, f, 0] + dy * normals[t, f, 1] + dz * normals[t, f, 2] < 0.0
        if is_inside and not is_enclosed:
            return 0.0, 0.0, 0.0
    is_inside = is_inside and sidedness != TWO_SIDED
    amplitude = amplitude_at(-distance if is_inside else distance - half_wall, pieces)
    if distance <= tiny:
        if len(normals) == 0:
            return np.nan, 0.0, 0.0
        f = tri.feature(table, t, edge, along)
        return amplitude * normals[t, f, 0], amplitude * normals[t, f, 1], amplitude * normals[t, f, 2]
    scale = amplitude / (-distance if is_inside else distance)
    return scale * dx, scale * dy, scale * dz


@inner(forceinline=True)
def _local_of(local, q):
    """Return the position in a brick of sample q of a block: four groups of 2 x 2 x 4 samples."""
    i, j = ((q >> 5) << 1) | ((q >> 3) & 1), (((q >> 4) & 1) << 1) | ((q >> 2) & 1)
    return local[0] + i, local[1] + j, local[2] + (q & 3)


@inner
def _open_block(block, corner, local, shape, steps, limits, is_closed, winding):
    """Set the positions of a block's 64 samples and their squared search radii (negative: no search).

    Returns the largest one.
    """
    max_square = np.float32(-1.0)
    for s in range(64):
        i, j, k = _local_of(local, s)
        block[tri.X + s], block[tri.Y + s], block[tri.Z + s] = i * steps[0], j * steps[1], k * steps[2]
        span = limits[0]
        if is_closed and winding[(i << 6) | (j << 3) | k] == 0:
            span = limits[1]
        if corner[0] + i >= shape[0] or corner[1] + j >= shape[1] or corner[2] + k >= shape[2]:
            span = np.float32(-1.0)
        span = span * span * np.float32(1 + 1e-4) + _SLACK * _SLACK if span >= _0 else span
        block[tri.D + s] = span
        block[tri.ID + s] = np.float32(-1.0)
        max_square = max(max_square, span)
    return max_square


@inner
def _search_block(block, s, max_square, count, tiles, centres, radius, steps, scratch):
    """Find the nearest triangle of each sample of a block.

    `scratch` is as `_search_scratch` allocates it. Returns False if no triangle is near enough.
    """
    heights, groups, selected = scratch
    best, nearest = tri.nearest_to_centre(tiles, count, s)
    nearest = np.sqrt(nearest)
    margin = np.float32(1 + 1e-5)
    if nearest > (np.sqrt(max_square) + radius) * margin + _SLACK:
        return False
    tri.sweep_block(tiles, best, block)
    max_square = _0
    for q in range(64):
        max_square = max(max_square, block[tri.D + q])
    reach = min(np.sqrt(max_square) + radius, nearest + 2 * radius) * margin + _SLACK
    gradient = tri.gradient_of(tiles, best, centres, s)
    tri.raise_planes(block, gradient, heights)
    planes = gradient, heights
    found = tri.select_near(tiles, count, s, reach * reach, centres, planes, steps, groups, selected)
    for n in range(found):
        c, bits = selected[n, 0], selected[n, 1]
        if c == best:
            continue
        if bits == tri.ALL_GROUPS:
            tri.sweep_block(tiles, c, block)
            continue
        for group in range(4):
            if (bits >> group) & 1:
                tri.sweep_group(tiles, c, block, group)
    return True


@inner
def _search_scratch(spans):
    """Allocate heights, groups and a list of triangles for the searches of some bricks."""
    max_count = 0
    for b in range(len(spans)):
        max_count = max(max_count, spans[b, 1] - spans[b, 0])
    return np.empty(4, np.float32), np.empty(32, np.int32), np.empty((max_count + 1, 2), np.int32)


@kernel
def _fill_bricks(
    start, stop, candidates, surface, frame, events, rule, pieces, forces, has_force, owners, needs_normals
):
    """Compute the forces of bricks.

    `rule` is sidedness, half wall, and the distance (metres) below which directions are inaccurate. `owners`
    receives the nearest triangle of each sample with a force, unless it is empty. `needs_normals` bool [1] is
    set if normals are missing (empty) and a direction depends on them.
    """
    bricks, spans, ids, columns = candidates
    table, normals = surface
    lattice, shape, limits = frame
    scale = 1.0 / lattice[3:].max()
    steps = lattice[3:] * scale
    steps32 = steps.astype(np.float32)
    is_closed = rule[0] == CLOSED
    has_inside = is_closed or rule[0] == LIDDED
    centres, block = np.empty(320, np.float32), np.empty(320, np.float32)
    radius = tri.set_centres(centres, 4, steps)
    reach = 7.0 * math.sqrt(steps[0] ** 2 + steps[1] ** 2 + steps[2] ** 2)
    tiles = tri.tiles_for(start, stop, spans[:, 0], spans[:, 1])
    scratch = _search_scratch(spans[start:stop])
    winding = np.zeros(512, np.int32)
    corner, local = np.empty(3, np.int64), np.empty(3, np.int64)
    low = np.empty(3)
    for b in range(start, stop):
        first, count = spans[b, 0], spans[b, 1] - spans[b, 0]
        for c in range(3):
            corner[c] = bricks[b, c] * 8
            low[c] = lattice[c] + corner[c] * lattice[3 + c]
        if has_inside:
            winding_of_brick(events, columns[b, 0], columns[b, 1], corner[0], winding)
        tri.localise_all(
            ids[first : first + count], table, low[0], low[1], low[2], scale, reach, centres, tiles
        )
        for s in range(8):
            local[0], local[1], local[2] = (s >> 2) * 4, ((s >> 1) & 1) * 4, (s & 1) * 4
            max_square = _open_block(block, corner, local, shape, steps32, limits, is_closed, winding)
            if max_square < _0 or not _search_block(
                block, s, max_square, count, tiles, centres, radius, steps32, scratch
            ):
                continue
            for q in range(64):
                if block[tri.ID + q] < _0:
                    continue
                i, j, k = _local_of(local, q)
                x, y, z = _sample_position(bricks, b, i, j, k, lattice)
                t = ids[first + int(block[tri.ID + q])]
                is_inside = winding[(i << 6) | (j << 3) | k] != 0
                x, y, z = _force(table, normals, t, x, y, z, is_inside, rule, pieces)
                if x != x and len(normals) == 0:
                    needs_normals[0] = True
                if x != 0.0 or y != 0.0 or z != 0.0:
                    forces[b, i, j, k, 0], forces[b, i, j, k, 1], forces[b, i, j, k, 2] = x, y, z
                    has_force[b] = True
                    if len(owners) > 0:
                        owners[b, i, j, k] = t


# -- damping of a motion, and the rim of a shell -----------------------------------------------------------
# `owners` int32 [n, 8, 8, 8]: the nearest triangle of each sample with a force, -1 for the others
@inner(forceinline=True)
def _barycentric(vertices, a, b, c, point):
    """Return the barycentric weights of the corners b and c at a point of a triangle.

    The edge from a to b is the longest one.
    """
    bb = bc = cc = bp = cp = 0.0
    for i in range(3):
        first = vertices[a, i]
        to_b, to_c, to_p = vertices[b, i] - first, vertices[c, i] - first, point[i] - first
        bb, bc, cc = bb + to_b * to_b, bc + to_b * to_c, cc + to_c * to_c
        bp, cp = bp + to_b * to_p, cp + to_c * to_p
    area = bb * cc - bc * bc
    third = min(max((bb * cp - bc * bp) / area, 0.0), 1.0) if area > 0.0 else 0.0
    return min(max((bp - third * bc) / bb, 0.0), 1.0 - third) if bb > 0.0 else 0.0, third


@kernel
def add_motion(start, stop, bricks, owners, table, lattice, triangles, vertices, velocities, damping, forces):
    """Add the damping of a moving surface wherever there are forces."""
    for b in range(start, stop):
        for i, j, k in np.ndindex(8, 8, 8):
            t = owners[b, i, j, k]
            if t < 0:
                continue
            x, y, z = _sample_position(bricks, b, i, j, k, lattice)
            dx, dy, dz, _, _ = tri.nearest(table, t, x, y, z)
            p, q, r = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            second, third = _barycentric(vertices, p, q, r, (x - dx, y - dy, z - dz))
            for c in range(3):
                v = velocities[p, c]
                velocity = v + second * (velocities[q, c] - v) + third * (velocities[r, c] - v)
                forces[b, i, j, k, c] += damping * velocity


@kernel
def fade(start, stop, bricks, owners, table, lattice, rim, rim_edges, width, forces, has_force):
    """Fade forces towards a rim; `has_force` is updated.

    `rim_edges` (first, last, ids): the edges of the rim near brick b are ``ids[first[b]:last[b]]``.
    """
    first, last, ids = rim_edges
    for b in range(start, stop):
        if first[b] == last[b] or not has_force[b]:
            continue
        has_force[b] = False
        for i, j, k in np.ndindex(8, 8, 8):
            t = owners[b, i, j, k]
            if t < 0:
                continue
            x, y, z = _sample_position(bricks, b, i, j, k, lattice)
            dx, dy, dz, _, _ = tri.nearest(table, t, x, y, z)
            x, y, z = x - dx, y - dy, z - dz
            min_square = width * width
            for e in range(first[b], last[b]):
                dx, dy, dz, _, _ = tri.nearest(rim, ids[e], x, y, z)
                min_square = min(min_square, dx * dx + dy * dy + dz * dz)
            # no force on the rim, to within rounding
            factor = max(0.0, math.sqrt(min_square) / width - 1e-6)
            if factor < 1.0 - 2e-6:
                for c in range(3):
                    forces[b, i, j, k, c] *= factor
            if factor > 0.0:
                has_force[b] = True


# -- complete fields ---------------------------------------------------------------------------------------
def _find_bricks(
    table: Float64s, lattice: Float64s, shape: Int64s, limit: np.float32, needed: Bools | None = None
) -> tuple[Int32s, Int64s, Int32s]:
    """Find the bricks near a mesh, in any order, the start of the triangles of each, and the triangles.

    `needed` bool [x, y, z]: bricks that may have a force; None for all.
    """
    levels = [] if needed is None else _levels_of(needed)
    size = 8 << int(-(-int(shape.max()) // 8) - 1).bit_length()
    cells = np.zeros((1, 3), np.int32)
    starts = np.array([0, len(table)], np.int64)
    ids = np.arange(len(table), dtype=np.int32)
    while size > 8 and len(cells):
        keep = np.empty(len(ids), np.uint8)
        counts = np.zeros((len(cells), 8), np.int64)
        needed_children = levels[size.bit_length() - 5] if levels else np.zeros((0, 0, 0), np.bool_)
        arguments = (cells, starts, ids, table, lattice, shape, size, limit, needed_children, keep, counts)
        for_chunks(_descend, len(cells), *arguments)
        stops = np.cumsum(counts)
        children = np.empty(stops[-1], np.int32)
        offsets = (stops - counts.reshape(-1)).reshape(-1, 8)
        for_chunks(_distribute, len(cells), starts, ids, keep, offsets, children, chunk=64)
        parent, child = np.nonzero(counts)
        bits = np.stack([child >> 2, (child >> 1) & 1, child & 1], axis=1)
        cells = (2 * cells[parent] + bits).astype(np.int32)
        starts = np.append(offsets[parent, child], stops[-1])
        ids = children
        size //= 2
    return cells, starts, ids


def _levels_of(needed: Bools) -> list[Bools]:
    """Return which cells have a needed brick: of one brick, of two along each axis, of four, and so on."""
    levels = [needed]
    while max(levels[-1].shape) > 1:
        cells = np.pad(levels[-1], [(0, n % 2) for n in levels[-1].shape])
        x, y, z = (n // 2 for n in cells.shape)
        levels.append(np.asarray(cells.reshape(x, 2, y, 2, z, 2).any(axis=(1, 3, 5))))
    return levels


def _find_rim_edges(
    rim: Float64s | None, lattice: Float64s, shape: Int64s, reach_m: float, keys: Int64s
) -> tuple[Int64s, Int64s, Int32s]:
    """Find the edges of a rim that may be within `reach_m` of the bricks with these ascending keys."""
    if rim is None:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int32)
    bricks, starts, ids = _find_bricks(rim, lattice, shape, np.float32(reach_m / lattice[3:].max()))
    _, by, bz = -(-shape // 8)
    rim_keys = (bricks[:, 0].astype(np.int64) * by + bricks[:, 1]) * bz + bricks[:, 2]
    index = np.searchsorted(keys, rim_keys)
    first, last = np.zeros((2, len(keys)), np.int64)
    found = np.flatnonzero(np.append(keys, -1)[index] == rim_keys)
    first[index[found]], last[index[found]] = starts[:-1][found], starts[1:][found]
    return first, last, ids


class _Scratch:
    """Forces, flags and owners of a batch of bricks; the memory is used again by the next batch."""

    def __init__(self, brick_count: int, has_owners: bool) -> None:
        count = min(brick_count, BATCH_BRICKS)
        self._is_used = False
        self._forces_n = np.zeros(
            (count, 8, 8, 8, 3), np.float32
        )  # the system clears pages as threads touch them
        self._has_force = np.empty(count, np.bool_)
        self._owners = np.empty((count if has_owners else 0, 8, 8, 8), np.int32)

    def cleared(self, count: int) -> tuple[Float32s, Bools, Int32s]:
        """Return the arrays of `count` bricks: forces 0, no brick with a force, owners -1 (or none)."""
        forces_n, has_force, owners = self._forces_n[:count], self._has_force[:count], self._owners[:count]
        has_force[:], owners[:] = False, -1
        if self._is_used:
            forces_n[:] = 0
        self._is_used = True
        return forces_n, has_force, owners


def mesh_forces(
    surface: tuple[Float64s, Callable[[], Float64s]],
    events: Int64s,
    grid: Grid,
    band: Band,
    tiny_m: float,
    motion: Motion | None = None,
    rim: Float64s | None = None,
) -> tuple[Int32s, Float32s]:
    """Compute the force field of a mesh.

    Returns bricks int32 [n, 3], ascending, and forces float32 [n, 8, 8, 8, 3] in newtons. `surface` is the
    table of `triangle_table` and a function that returns normals float64 [m, 7, 3], m above 0: outward
    pseudo-normals of each triangle's face, vertices and edges. It is called only if normals are needed.
    `events` are those of `crossings`, empty unless closed or lidded. At distances below
    `tiny_m` metres, forces point along a pseudo-normal. `motion` adds the damping of a moving surface.
    Towards `rim`, the `triangle_table` of edges as degenerate triangles, the force fades over a distance
    equal to the reach of the force law. Candidates are computed in batches, of which only the bricks with a
    force are kept. Raises `InvalidArgument` if these take more than `memory_budget_bytes`.
    """
    lattice = np.array([*grid.origin_m, *grid.spacing_m])
    shape = np.array(grid.shape, np.int64)
    scale = 1 / lattice[3:].max()
    limits = np.array([band.inner_m * scale, band.outer_m * scale], np.float32)
    # a sample outside a closed mesh has no force if the law has none there
    is_inside_only = band.sidedness == CLOSED and band.outer_m < 0
    needed = bricks_inside(events, grid) if is_inside_only else None
    bricks, starts, ids = _find_bricks(surface[0], lattice, shape, limits.max(), needed)
    _, by, bz = grid.brick_shape
    columns = bricks[:, 1].astype(np.int64) * bz + bricks[:, 2]
    keys = bricks[:, 0].astype(np.int64) * (by * bz) + columns
    order = np.argsort(keys)
    bricks, columns, keys = bricks[order], columns[order] << COLUMN_SHIFT, keys[order]
    spans = np.stack([starts[:-1][order], starts[1:][order]], axis=1)
    columns = np.stack([np.searchsorted(events, columns + e) for e in (0, 1 << COLUMN_SHIFT)], axis=1)
    rule = (band.sidedness, band.half_wall_m, tiny_m)
    width_m = max(band.inner_m, band.outer_m)
    first, last, rim_ids = _find_rim_edges(rim, lattice, shape, 2 * width_m, keys)
    buffer, scratch = BrickBuffer(), _Scratch(len(bricks), motion is not None or rim is not None)
    table, normals_of = surface
    # of a closed mesh, few samples need them: those on its surface
    normals = np.zeros((0, 7, 3)) if band.sidedness in (CLOSED, TWO_SIDED) else normals_of()
    for start in range(0, len(bricks), BATCH_BRICKS):
        batch = slice(start, start + BATCH_BRICKS)
        near = bricks[batch]
        candidates = near, spans[batch], ids, columns[batch]
        is_complete = False
        while not is_complete:
            forces, has_force, owners = scratch.cleared(len(near))
            needs_normals, results = np.zeros(1, np.bool_), (forces, has_force, owners)
            arguments = (candidates, (table, normals), (lattice, shape, limits), events, rule, band.pieces)
            for_chunks(_fill_bricks, len(near), *arguments, *results, needs_normals)
            is_complete = not needs_normals[0]
            normals = normals if is_complete else normals_of()
        if motion is not None:
            for_chunks(add_motion, len(near), near, owners, table, lattice, *motion, forces)
        if rim is not None:
            edges = rim, (first[batch], last[batch], rim_ids), width_m
            for_chunks(fade, len(near), near, owners, table, lattice, *edges, forces, has_force)
        buffer.append(near, forces, has_force)
    return buffer.take()
