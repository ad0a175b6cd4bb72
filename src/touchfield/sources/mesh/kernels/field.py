"""Compiled loops of the mesh source: the nearest triangle of every sample near a mesh, and the force there.

Which triangles a brick must look at is found by descent from one cell that holds the whole grid: of the
triangles of a cell, its half-sized child with centre c and radius r keeps those with d(c) <= least d(c) + 2 r
that can lie in the band, d(c) <= band + r; no other one can be nearest to any of the child's samples. Nothing
is allocated for the rest of the grid. The search is in float32, in units of the largest spacing and relative
to the brick; distance and direction are then evaluated in float64 for the triangle found.

The damping of a moving surface is b times the velocity of the nearest point (paper 3.2); the velocity within
a triangle is linear between its corners, as their positions are. A wall ends where its surface ends: a force
is multiplied by min(1, s / w), s the distance to the rim of the nearest point of the surface. Where that
point lies on the rim itself, the surface is beside the sample: no force.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int32s, Int64s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium import Grid
from touchfield.sources.mesh.kernels import triangle as tri
from touchfield.sources.mesh.kernels.sign import COLUMN_SHIFT, winding_of_brick
from touchfield.sources.terrain.kernels import amplitude as amplitude_at

CLOSED, ONE_SIDED, TWO_SIDED, LIDDED = 0, 1, 2, 3
"""Signs of a distance: by winding number; by the pseudo-normal; by the wall's half thickness; by the
pseudo-normal, but behind the surface only where the winding number, holes taken as closed, is not 0."""

_SLACK = np.float32(1e-3)  # of the largest spacing: far above the rounding of the search, far below a sample
_0 = np.float32(0)


class Band(NamedTuple):
    """Distances that matter, and their sign."""

    sidedness: int  # `CLOSED`, `ONE_SIDED`, `TWO_SIDED` or `LIDDED`
    # largest distance at which there is a force, on the negative and on the positive side; negative for none
    inner_m: float
    outer_m: float
    half_wall_m: float  # what a two-sided sheet takes off its distances
    pieces: Float64s  # float64 [n, 4]; `ForceProfile.table`


class Motion(NamedTuple):
    """Motion of a surface."""

    # int32 [m, 3]; those that the rows of the table are, or are pieces of, each beginning with its longest
    # edge
    triangles: Int32s
    vertices_m: Float64s  # float64 [n, 3]
    velocities_m_s: Float64s  # float64 [n, 3]; of the vertices
    damping_n_s_per_m: float  # b


@inner(forceinline=True)
def _place(bricks, b, i, j, k, lattice):
    """Where a sample of a brick is, metres."""
    x = lattice[0] + (bricks[b, 0] * 8 + i) * lattice[3]
    y = lattice[1] + (bricks[b, 1] * 8 + j) * lattice[4]
    z = lattice[2] + (bricks[b, 2] * 8 + k) * lattice[5]
    return x, y, z


# -- from the grid down to its bricks
# ------------------------------------------------------------------------------
@kernel
def _descend(begin, end, cells, start, ids, table, lattice, shape, size, limit, keep, counts):
    """Triangles of each cell that its eight children keep: a bit for each child, and their numbers."""
    scale = 1.0 / lattice[3:].max()
    steps = lattice[3:] * scale
    half = size // 2
    block = np.empty(320, np.float32)
    radius = tri.place_centres(block, half, steps)
    reach = 2.0 * radius * size / max(half - 1, 1)
    tiles = tri.tiles_for(begin, end, start[:-1], start[1:])
    for cell in range(begin, end):
        first, count = start[cell], start[cell + 1] - start[cell]
        i, j, k = cells[cell, 0] * size, cells[cell, 1] * size, cells[cell, 2] * size
        x, y, z = lattice[0] + i * lattice[3], lattice[1] + j * lattice[4], lattice[2] + k * lattice[5]
        tri.see_all(ids[first : first + count], table, x, y, z, scale, reach, block, tiles)
        keep[first : first + count] = 0
        for s in range(8):
            ci, cj, ck = i + (s >> 2) * half, j + ((s >> 1) & 1) * half, k + (s & 1) * half
            if ci >= shape[0] or cj >= shape[1] or ck >= shape[2]:
                continue
            least = np.sqrt(tri.least_of(tiles, count, s)[1])
            far = min(least + 2 * radius, limit + radius) * np.float32(1 + 1e-5) + _SLACK
            far = far * far
            kept = 0
            for c in range(count):
                if tri.square_of(tiles, c, s) <= far:
                    keep[first + c] |= 1 << s
                    kept += 1
            counts[cell, s] = kept


@kernel
def _hand_down(begin, end, start, ids, keep, offsets, out):
    for cell in range(begin, end):
        for s in range(8):
            o = offsets[cell, s]
            for c in range(start[cell], start[cell + 1]):
                if (keep[c] >> s) & 1:
                    out[o] = ids[c]
                    o += 1


# -- a brick
# --------------------------------------------------------------------------------------------------------
@inner(forceinline=True)
def _force(table, normals, t, x, y, z, is_inside, rule, pieces):
    """The force at (x, y, z), given its nearest triangle t."""
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
        f = tri.feature(table, t, edge, along)
        return amplitude * normals[t, f, 0], amplitude * normals[t, f, 1], amplitude * normals[t, f, 2]
    share = amplitude / (-distance if is_inside else distance)
    return share * dx, share * dy, share * dz


@inner
def _open_block(block, corner, local, shape, steps, limits, is_closed, winding):
    """Place a block's 64 samples and say how far each one looks (squared; negative: not at all); the
    farthest.
    """
    far = np.float32(-1.0)
    for s in range(64):
        i, j, k = local[0] + (s >> 4), local[1] + ((s >> 2) & 3), local[2] + (s & 3)
        block[tri.X + s], block[tri.Y + s], block[tri.Z + s] = i * steps[0], j * steps[1], k * steps[2]
        span = limits[0]
        if is_closed and winding[(i << 6) | (j << 3) | k] == 0:
            span = limits[1]
        if corner[0] + i >= shape[0] or corner[1] + j >= shape[1] or corner[2] + k >= shape[2]:
            span = np.float32(-1.0)
        span = span * span * np.float32(1 + 1e-4) + _SLACK * _SLACK if span >= _0 else span
        block[tri.D + s] = span
        block[tri.ID + s] = np.float32(-1.0)
        far = max(far, span)
    return far


@inner
def _search_block(block, s, far, count, tiles, radius):
    """Find the nearest triangle of each sample of a block; False if none is near enough."""
    best, least = tri.least_of(tiles, count, s)
    least = np.sqrt(least)
    grown = np.float32(1 + 1e-5)
    if least > (np.sqrt(far) + radius) * grown + _SLACK:
        return False
    tri.sweep_block(tiles, best, block)
    far = _0
    for q in range(64):
        far = max(far, block[tri.D + q])
    reach = min(np.sqrt(far) + radius, least + 2 * radius) * grown + _SLACK
    reach = reach * reach
    for c in range(count):
        if tri.square_of(tiles, c, s) <= reach and c != best:
            tri.sweep_block(tiles, c, block)
    return True


@kernel
def _fill_bricks(begin, end, near, surface, frame, events, rule, pieces, forces, has_force, owners):
    """Forces of bricks; `rule` is sidedness, half wall and the distance (metres) at which directions are
    unsure.

    `owners` is told the nearest triangle of each sample with a force, unless it is empty.
    """
    bricks, spans, ids, columns = near
    table, normals = surface
    lattice, shape, limits = frame
    scale = 1.0 / lattice[3:].max()
    steps = lattice[3:] * scale
    steps32 = steps.astype(np.float32)
    is_closed = rule[0] == CLOSED
    has_inside = is_closed or rule[0] == LIDDED
    centres, block = np.empty(320, np.float32), np.empty(320, np.float32)
    radius = tri.place_centres(centres, 4, steps)
    reach = 7.0 * math.sqrt(steps[0] ** 2 + steps[1] ** 2 + steps[2] ** 2)
    tiles = tri.tiles_for(begin, end, spans[:, 0], spans[:, 1])
    winding = np.zeros(512, np.int32)
    corner, local = np.empty(3, np.int64), np.empty(3, np.int64)
    low = np.empty(3)
    for b in range(begin, end):
        first, count = spans[b, 0], spans[b, 1] - spans[b, 0]
        for c in range(3):
            corner[c] = bricks[b, c] * 8
            low[c] = lattice[c] + corner[c] * lattice[3 + c]
        if has_inside:
            winding_of_brick(events, columns[b, 0], columns[b, 1], corner[0], winding)
        tri.see_all(ids[first : first + count], table, low[0], low[1], low[2], scale, reach, centres, tiles)
        for s in range(8):
            local[0], local[1], local[2] = (s >> 2) * 4, ((s >> 1) & 1) * 4, (s & 1) * 4
            far = _open_block(block, corner, local, shape, steps32, limits, is_closed, winding)
            if far < _0 or not _search_block(block, s, far, count, tiles, radius):
                continue
            for q in range(64):
                if block[tri.ID + q] < _0:
                    continue
                i, j, k = local[0] + (q >> 4), local[1] + ((q >> 2) & 3), local[2] + (q & 3)
                x, y, z = _place(bricks, b, i, j, k, lattice)
                t = ids[first + int(block[tri.ID + q])]
                is_inside = winding[(i << 6) | (j << 3) | k] != 0
                x, y, z = _force(table, normals, t, x, y, z, is_inside, rule, pieces)
                if x != 0.0 or y != 0.0 or z != 0.0:
                    forces[b, i, j, k, 0], forces[b, i, j, k, 1], forces[b, i, j, k, 2] = x, y, z
                    has_force[b] = True
                    if len(owners) > 0:
                        owners[b, i, j, k] = t


# -- what a motion adds, and where a shell ends
# ------------------------------------------------------------------- `owners` int32 [n, 8, 8, 8]: the nearest triangle of each sample with a force, -1 for the others
@inner(forceinline=True)
def _shares(vertices, a, b, c, point):
    """Shares of the corners b and c of a triangle in a point of it; from a to b is its longest edge."""
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
def add_motion(begin, end, bricks, owners, table, lattice, triangles, vertices, velocities, damping, forces):
    """Add the damping of a surface that moves, where there are forces."""
    for b in range(begin, end):
        for i, j, k in np.ndindex(8, 8, 8):
            t = owners[b, i, j, k]
            if t < 0:
                continue
            x, y, z = _place(bricks, b, i, j, k, lattice)
            dx, dy, dz, _, _ = tri.nearest(table, t, x, y, z)
            p, q, r = triangles[t, 0], triangles[t, 1], triangles[t, 2]
            second, third = _shares(vertices, p, q, r, (x - dx, y - dy, z - dz))
            for c in range(3):
                v = velocities[p, c]
                at = v + second * (velocities[q, c] - v) + third * (velocities[r, c] - v)
                forces[b, i, j, k, c] += damping * at


@kernel
def fade(begin, end, bricks, owners, table, lattice, rim, near, width, forces, has_force):
    """Fade forces towards a rim; `has_force` tells which bricks still have any.

    `near` (first, last, ids): the edges of the rim near brick b are ids[first[b]] to before ids[last[b]].
    """
    first, last, ids = near
    for b in range(begin, end):
        if first[b] == last[b] or not has_force[b]:
            continue
        has_force[b] = False
        for i, j, k in np.ndindex(8, 8, 8):
            t = owners[b, i, j, k]
            if t < 0:
                continue
            x, y, z = _place(bricks, b, i, j, k, lattice)
            dx, dy, dz, _, _ = tri.nearest(table, t, x, y, z)
            x, y, z = x - dx, y - dy, z - dz
            least = width * width
            for e in range(first[b], last[b]):
                dx, dy, dz, _, _ = tri.nearest(rim, ids[e], x, y, z)
                least = min(least, dx * dx + dy * dy + dz * dz)
            # what lies on the rim to rounding has no force at all
            share = max(0.0, math.sqrt(least) / width - 1e-6)
            if share < 1.0 - 2e-6:
                for c in range(3):
                    forces[b, i, j, k, c] *= share
            if share > 0.0:
                has_force[b] = True


# -- all of it
# -----------------------------------------------------------------------------------------------------
def _bricks_near(
    table: Float64s, lattice: Float64s, shape: Int64s, limit: np.float32
) -> tuple[Int32s, Int64s, Int32s]:
    """The bricks near a mesh in any order, where the triangles of each begin, and the triangles."""
    size = 8 << int(-(-int(shape.max()) // 8) - 1).bit_length()
    cells = np.zeros((1, 3), np.int32)
    start = np.array([0, len(table)], np.int64)
    ids = np.arange(len(table), dtype=np.int32)
    while size > 8 and len(cells):
        keep = np.empty(len(ids), np.uint8)
        counts = np.zeros((len(cells), 8), np.int64)
        work = (cells, start, ids, table, lattice, shape, size, limit, keep, counts)
        for_chunks(_descend, len(cells), *work)
        ends = np.cumsum(counts)
        children = np.empty(ends[-1], np.int32)
        offsets = (ends - counts.reshape(-1)).reshape(-1, 8)
        for_chunks(_hand_down, len(cells), start, ids, keep, offsets, children, chunk=64)
        parent, child = np.nonzero(counts)
        bits = np.stack([child >> 2, (child >> 1) & 1, child & 1], axis=1)
        cells = (2 * cells[parent] + bits).astype(np.int32)
        start = np.append(offsets[parent, child], ends[-1])
        ids = children
        size //= 2
    return cells, start, ids


def _rim_near(
    rim: Float64s, lattice: Float64s, shape: Int64s, reach_m: float, keys: Int64s
) -> tuple[Int64s, Int64s, Int32s]:
    """Edges of a rim that may be within `reach_m` of the bricks with these keys, ascending."""
    bricks, start, ids = _bricks_near(rim, lattice, shape, np.float32(reach_m / lattice[3:].max()))
    _, by, bz = -(-shape // 8)
    own = (bricks[:, 0].astype(np.int64) * by + bricks[:, 1]) * bz + bricks[:, 2]
    place = np.searchsorted(keys, own)
    first, last = np.zeros((2, len(keys)), np.int64)
    is_there = np.flatnonzero(np.append(keys, -1)[place] == own)
    first[place[is_there]], last[place[is_there]] = start[:-1][is_there], start[1:][is_there]
    return first, last, ids


def forces_near(
    surface: tuple[Float64s, Float64s],
    events: Int64s,
    grid: Grid,
    band: Band,
    tiny_m: float,
    motion: Motion | None = None,
    rim: Float64s | None = None,
) -> tuple[Int32s, Float32s]:
    """The force field of a mesh: bricks int32 [n, 3] ascending, and forces float32 [n, 8, 8, 8, 3] in
    newtons.

    `surface` holds the table of `triangle_table` and normals float64 [m, 7, 3]: outward pseudo-normals of
    each triangle's face, vertices and edges; `events` from `crossings`, empty unless closed or lidded; closer
    than `tiny_m` the direction is a pseudo-normal; `motion` adds the damping of a surface that moves. Towards
    `rim`, the `triangle_table` of edges that are triangles to and fro, the force fades over its own reach.
    """
    lattice = np.array([*grid.origin_m, *grid.spacing_m])
    shape = np.array(grid.shape, np.int64)
    scale = 1 / lattice[3:].max()
    limits = np.array([band.inner_m * scale, band.outer_m * scale], np.float32)
    bricks, start, ids = _bricks_near(surface[0], lattice, shape, limits.max())
    _, by, bz = grid.brick_shape
    columns = bricks[:, 1].astype(np.int64) * bz + bricks[:, 2]
    keys = bricks[:, 0].astype(np.int64) * (by * bz) + columns
    order = np.argsort(keys)
    bricks, columns, keys = bricks[order], columns[order] << COLUMN_SHIFT, keys[order]
    spans = np.stack([start[:-1][order], start[1:][order]], axis=1)
    columns = np.stack([np.searchsorted(events, columns + e) for e in (0, 1 << COLUMN_SHIFT)], axis=1)
    rule = (band.sidedness, band.half_wall_m, tiny_m)
    forces, has_force = np.zeros((len(bricks), 8, 8, 8, 3), np.float32), np.zeros(len(bricks), np.bool_)
    owners = np.full((0 if motion is None and rim is None else len(bricks), 8, 8, 8), -1, np.int32)
    about = ((bricks, spans, ids, columns), surface, (lattice, shape, limits), events, rule, band.pieces)
    for_chunks(_fill_bricks, len(bricks), *about, forces, has_force, owners)
    if motion is not None:
        for_chunks(add_motion, len(bricks), bricks, owners, surface[0], lattice, *motion, forces)
    if rim is not None:
        width_m = max(band.inner_m, band.outer_m)
        near_rim = _rim_near(rim, lattice, shape, 2 * width_m, keys)
        beside = rim, near_rim, width_m
        for_chunks(fade, len(bricks), bricks, owners, surface[0], lattice, *beside, forces, has_force)
    return bricks[has_force], forces[has_force]
