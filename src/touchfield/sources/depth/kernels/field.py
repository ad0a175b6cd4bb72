"""Compiled inner loops of `DepthScene`: find the bricks (blocks of 8x8x8 samples) near the surface of a depth
image, and compute the forces there.

`touchfield.sources.depth.depth_scene` defines the force; `planes` describes the layout of the loops.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.cuda import filled, for_each, on_device, on_host, uses_gpu
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium.budget import BYTES_PER_BRICK, memory_budget_bytes, zero_forces
from touchfield.medium.field import bricks_of
from touchfield.medium.grid import CORNERS

if TYPE_CHECKING:
    from touchfield.medium import Grid
    from touchfield.sources.depth.kernels.planes import SurfacePlanes


_0, _1, HALF, _BIG = np.float32(0), np.float32(1), np.float32(0.5), np.float32(1e30)

B3 = 512  # samples of a brick
_NX, _NY, _NZ, _C, _PHI, _FORCE, _SCRATCH = (B3 * q for q in range(7))
_GPU_BRICKS = 1 << 26  # bricks that a GPU tests at once


class Query(NamedTuple):
    """The planes of a depth map, and the lattice on which their force is evaluated."""

    surface: SurfacePlanes
    # [4, 3], camera axes: sample (0, 0, 0), and the steps along the three axes of the grid
    lattice_m: Float64s
    shape: tuple[int, int, int]  # samples of the lattice
    # [1536], samples of a brick relative to its first, camera axes: x of all, then y, then z
    offsets_m: Float32s
    rotation: Float32s  # [3, 3], from camera axes to those of the force
    pieces: Float32s  # [n, 4], the force profile
    reach: Float32s  # [2], metres along the ray in front of and behind a plane
    first_m: float  # depth below which there is no force


@inner(fastmath={"contract"}, error_model="numpy")
def _box_in_view(x0, y0, z0, corners, query):
    """Return the nearest and farthest z of a box, and the pixels u0, u1, v0, v1 it projects to.

    The range of z is empty (1 to 0) if the box lies in front of all forces, behind the camera or outside the
    picture.
    """
    camera, (height, width) = query.surface.camera_px, query.surface.size_px
    z_low = z0 + corners[8, 2]
    z_high = z0 + corners[9, 2]
    if z_high <= query.first_m:
        return 1.0, 0.0, (0, 0, 0, 0)
    pixels = (0, width - 1, 0, height - 1)
    if z_low > 1e-3 * z_high:  # else the box touches the camera's plane and may project anywhere
        u0, u1, v0, v1 = 1e9, -1e9, 1e9, -1e9
        for q in range(8):
            per_z = 1.0 / (z0 + corners[q, 2])
            u = (x0 + corners[q, 0]) * per_z
            v = (y0 + corners[q, 1]) * per_z
            u0, u1 = min(u0, u), max(u1, u)
            v0, v1 = min(v0, v), max(v1, v)
        # rounded to the nearest pixel, with a margin for the single precision of the samples
        u0, u1 = u0 * camera[0] + camera[2] + 0.49, u1 * camera[0] + camera[2] + 0.51
        v0, v1 = v0 * camera[1] + camera[3] + 0.49, v1 * camera[1] + camera[3] + 0.51
        if u1 < 0.0 or v1 < 0.0 or u0 >= width or v0 >= height:
            return 1.0, 0.0, pixels
        columns, rows = (max(u0, 0.0), min(u1, width - 1.0)), (max(v0, 0.0), min(v1, height - 1.0))
        pixels = (int(columns[0]), int(columns[1]), int(rows[0]), int(rows[1]))
    return z_low, z_high, pixels


@inner(error_model="numpy")
def _may_reach_surface(z_low, z_high, pixels, tiles, reach):
    """Return True if a box of these pixels and depths may hold a sample within reach of a surface."""
    largest, smallest = _0, _BIG
    for t in range(pixels[2] >> 3, (pixels[3] >> 3) + 1):
        for s in range(pixels[0] >> 3, (pixels[1] >> 3) + 1):
            x, y = tiles[t, s, 0], tiles[t, s, 1]
            largest = x if x > largest else largest
            smallest = y if y < smallest else smallest
    slack = 1e-5 * z_high
    return (
        largest > _0
        and z_high >= 1.0 / largest - reach[0] - slack
        and z_low <= 1.0 / smallest + reach[1] + slack
    )


@kernel
def _may_hold(start, stop, nodes, span, corners, query, hits):
    lattice = query.lattice_m
    for n in range(start, stop):
        a, b, d = 8.0 * span * nodes[n, 0], 8.0 * span * nodes[n, 1], 8.0 * span * nodes[n, 2]
        x = lattice[0, 0] + a * lattice[1, 0] + b * lattice[2, 0] + d * lattice[3, 0]
        y = lattice[0, 1] + a * lattice[1, 1] + b * lattice[2, 1] + d * lattice[3, 1]
        z = lattice[0, 2] + a * lattice[1, 2] + b * lattice[2, 2] + d * lattice[3, 2]
        z_low, z_high, pixels = _box_in_view(x, y, z, corners, query)
        hits[n] = z_low <= z_high and _may_reach_surface(
            z_low, z_high, pixels, query.surface.tiles, query.reach
        )


@kernel
def _in_view(start, stop, nodes, span, corners, query, hits):
    lattice = query.lattice_m
    for n in range(start, stop):
        a, b, d = 8.0 * span * nodes[n, 0], 8.0 * span * nodes[n, 1], 8.0 * span * nodes[n, 2]
        x = lattice[0, 0] + a * lattice[1, 0] + b * lattice[2, 0] + d * lattice[3, 0]
        y = lattice[0, 1] + a * lattice[1, 1] + b * lattice[2, 1] + d * lattice[3, 1]
        z = lattice[0, 2] + a * lattice[1, 2] + b * lattice[2, 2] + d * lattice[3, 2]
        z_low, z_high, _ = _box_in_view(x, y, z, corners, query)
        hits[n] = z_low <= z_high


@inner(fastmath={"contract"}, error_model="numpy", forceinline=True)
def pixel_of(x, y, z, fx, fy, cx, cy, height, width):
    """Return the pixel of a point in camera axes.

    Returns `height` * `width` if it lies outside the picture.
    """
    per_z = _1 / z
    u = x * per_z * fx + cx
    v = y * per_z * fy + cy
    ok = (z > _0) & (u >= _0) & (u < np.float32(width)) & (v >= _0) & (v < np.float32(height))
    inside = np.int32(v if ok else _0) * np.int32(width) + np.int32(u if ok else _0)
    return inside if ok else np.int32(height * width)


@inner(fastmath={"contract"}, error_model="numpy")
def pixels_of(x0, y0, z0, offsets, count, camera, height, width, index):
    fx, fy, cx, cy = camera[0], camera[1], camera[2] + HALF, camera[3] + HALF
    for s in range(count):
        x, y, z = x0 + offsets[s], y0 + offsets[s + B3], z0 + offsets[s + 2 * B3]
        index[s] = pixel_of(x, y, z, fx, fy, cx, cy, height, width)


@inner
def gather(planes, index, count, r):
    for s in range(count):
        p = np.uintp(4) * np.uintp(np.uint32(index[s]))  # unsigned: no test for negative indices
        r[s + _NX] = planes[p]
        r[s + _NY] = planes[p + np.uintp(1)]
        r[s + _NZ] = planes[p + np.uintp(2)]
        r[s + _C] = planes[p + np.uintp(3)]


@inner(fastmath={"contract"}, error_model="numpy", forceinline=True)
def distance_at(x, y, z, plane, reach_front, reach_back):
    """Return the signed distance of a point to the plane (nx, ny, nz, c) of its pixel, metres.

    Returns 1e30 if the point is out of reach.
    """
    facing = plane[0] * x + plane[1] * y + plane[2] * z
    phi = facing - plane[3]
    # z * phi / facing is the distance in z from the point where the sample's own ray meets the plane
    is_in_reach = (facing < _0) & (z * abs(phi) <= -facing * (reach_back if phi <= _0 else reach_front))
    return phi if is_in_reach else _BIG


@inner(fastmath={"contract"}, error_model="numpy")
def _amplitudes(x0, y0, z0, offsets, count, pieces, reach, r):
    """Write amplitudes, newtons, into ``r[_FORCE:]``."""
    reach_front, reach_back = reach[0], reach[1]
    for s in range(count):
        x, y, z = x0 + offsets[s], y0 + offsets[s + B3], z0 + offsets[s + 2 * B3]
        r[s + _PHI] = distance_at(
            x, y, z, (r[s + _NX], r[s + _NY], r[s + _NZ], r[s + _C]), reach_front, reach_back
        )
        r[s + _FORCE] = _0
    for p in range(pieces.shape[0]):
        low, high, intercept, slope = pieces[p, 0], pieces[p, 1], pieces[p, 2], pieces[p, 3]
        for s in range(count):
            phi = r[s + _PHI]
            f = intercept + slope * phi
            r[s + _FORCE] = f if (phi > low) & (phi <= high) else r[s + _FORCE]


@inner(fastmath={"contract", "reassoc", "nsz"})
def _any_force(r, count):
    total = _0
    for s in range(count):
        total += abs(r[s + _FORCE])
    return total > _0


@inner(forceinline=True)
def first_sample(brick, lattice):
    """Return the first sample of a brick in camera axes, metres, float32."""
    a, b, d = 8.0 * brick[0], 8.0 * brick[1], 8.0 * brick[2]
    x = np.float32(lattice[0, 0] + a * lattice[1, 0] + b * lattice[2, 0] + d * lattice[3, 0])
    y = np.float32(lattice[0, 1] + a * lattice[1, 1] + b * lattice[2, 1] + d * lattice[3, 1])
    z = np.float32(lattice[0, 2] + a * lattice[1, 2] + b * lattice[2, 2] + d * lattice[3, 2])
    return x, y, z


@inner(forceinline=True)
def _evaluate(brick, first, count, query, index, r):
    """Write planes and amplitudes of `count` samples of a brick, from the `first` on, into `r`."""
    surface, offsets, shape = query.surface, query.offsets_m[first:], query.shape
    x, y, z = first_sample(brick, query.lattice_m)
    pixels_of(x, y, z, offsets, count, surface.camera_px, surface.size_px[0], surface.size_px[1], index)
    gather(surface.planes, index, count, r)
    _amplitudes(x, y, z, offsets, count, query.pieces, query.reach, r)
    ni, nj, nk = shape[0] - 8 * brick[0], shape[1] - 8 * brick[1], shape[2] - 8 * brick[2]
    for q in range(count if min(ni, nj, nk) < 8 else 0):  # outside the grid
        s = first + q
        if (s >> 6) >= ni or (s >> 3 & 7) >= nj or (s & 7) >= nk:
            r[q + _FORCE] = _0


@kernel
def _holds(start, stop, nodes, query, hits):
    index, r = np.empty(B3, np.int32), np.empty(_SCRATCH, np.float32)
    for n in range(start, stop):
        hits[n] = False
        for first, count in ((0, 64), (64, B3 - 64)):
            _evaluate(nodes[n], first, count, query, index, r)
            if _any_force(r, count):
                hits[n] = True
                break


@inner(fastmath={"contract"})
def _write(r, rotation, out):
    a, b, c = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    d, e, f = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    g, h, i = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    for s in range(B3):
        q = r[s + _FORCE]
        x, y, z = q * r[s + _NX], q * r[s + _NY], q * r[s + _NZ]
        out[3 * s] = a * x + b * y + c * z
        out[3 * s + 1] = d * x + e * y + f * z
        out[3 * s + 2] = g * x + h * y + i * z


@kernel
def _fill(start, stop, nodes, query, out):
    index, r = np.empty(B3, np.int32), np.empty(_SCRATCH, np.float32)
    for n in range(start, stop):
        _evaluate(nodes[n], 0, B3, query, index, r)
        _write(r, query.rotation, out[1536 * n : 1536 * n + 1536])


# -- the same on a GPU: each thread computes one sample, or some samples of a brick ------------------------
@inner(forceinline=True)
def _is_beyond(brick, s, shape):
    """Return True if a sample of a brick lies outside the grid."""
    is_beyond = 8 * brick[0] + (s >> 6) >= shape[0] or 8 * brick[1] + (s >> 3 & 7) >= shape[1]
    return is_beyond or 8 * brick[2] + (s & 7) >= shape[2]


@inner(fastmath={"contract"})
def _force_of_sample(first, s, query):
    """Return amplitude, newtons, and normal at sample `s` of a brick whose first sample is at `first`."""
    offsets, pieces = query.offsets_m, query.pieces
    camera, planes, (height, width) = query.surface.camera_px, query.surface.planes, query.surface.size_px
    x, y, z = first[0] + offsets[s], first[1] + offsets[s + B3], first[2] + offsets[s + 2 * B3]
    p = 4 * pixel_of(x, y, z, camera[0], camera[1], camera[2] + HALF, camera[3] + HALF, height, width)
    plane = planes[p], planes[p + 1], planes[p + 2], planes[p + 3]
    phi = distance_at(x, y, z, plane, query.reach[0], query.reach[1])
    f = _0
    if phi < _BIG:
        for i in range(pieces.shape[0]):
            if pieces[i, 0] < phi <= pieces[i, 1]:
                f = pieces[i, 2] + pieces[i, 3] * phi
    return f, (plane[0], plane[1], plane[2])


@kernel
def _each_holds(start, stop, first_brick, shape, corners, query, hits):
    """Test bricks of a grid of `shape` bricks, from number `first_brick` on, with eight threads a brick.

    Each thread tests every eighth sample. Testing the boxes of all bricks is faster than halving blocks.
    Threads that find a force may all write the same hit.
    """
    for q in range(start, stop):
        n = q >> 3
        row = (first_brick + n) // shape[2]
        brick = row // shape[1], row % shape[1], (first_brick + n) % shape[2]
        first = first_sample(brick, query.lattice_m)
        z_low, z_high, pixels = _box_in_view(first[0], first[1], first[2], corners, query)
        if z_low > z_high or not _may_reach_surface(z_low, z_high, pixels, query.surface.tiles, query.reach):
            continue
        for s in range(q & 7, B3, 8):
            if not _is_beyond(brick, s, query.shape) and _force_of_sample(first, s, query)[0] != _0:
                hits[n] = True
                break


@kernel
def _each_fill(start, stop, nodes, query, out):
    rotation = query.rotation
    for q in range(start, stop):
        n, s = q >> 9, q & 511
        f, normal = _force_of_sample(first_sample(nodes[n], query.lattice_m), s, query)
        f = _0 if _is_beyond(nodes[n], s, query.shape) else f
        x, y, z = f * normal[0], f * normal[1], f * normal[2]
        for c in range(3):
            out[3 * q + c] = rotation[c, 0] * x + rotation[c, 1] * y + rotation[c, 2] * z


def may_hold_force(nodes: Int32s, span: int, query: Query) -> Bools:
    """Test cubes of `span`^3 bricks, bool [n]: False if they cannot hold a force.

    `nodes` int32 [n, 3] are positions in units of `span`.
    """
    hits = np.empty(len(nodes), np.bool_)
    for_chunks(_may_hold, len(nodes), nodes, span, _corners(span, query.lattice_m), query, hits, chunk=64)
    return hits


def nodes_in_view(nodes: Int32s, span: int, query: Query) -> Int64s:
    """Return which cubes of `span`^3 bricks the camera may see, int64 [m]: indices, ascending.

    `nodes` int32 [n, 3] are positions in units of `span`. A point that the camera sees lies within one sample
    of one of them if it does so of any.
    """
    hits, corners = np.empty(len(nodes), np.bool_), _corners(span, query.lattice_m, margin=1)
    for_chunks(_in_view, len(nodes), nodes, span, corners, query._replace(first_m=0.0), hits, chunk=64)
    return np.flatnonzero(hits)


def _corners(span: int, lattice_m: Float64s, margin: int = 0) -> Float64s:
    """Return the corners of a cube of bricks, camera axes, relative to its first sample.

    The cube is `margin` samples larger on each side. Float64 [10, 3]; the last two rows are the smallest and
    the largest z.
    """
    corners = ((8 * span - 1 + 2 * margin) * CORNERS - margin) @ lattice_m[1:]
    return np.vstack([corners, np.full((1, 3), corners[:, 2].min()), np.full((1, 3), corners[:, 2].max())])


def holds_force(bricks: Int32s, query: Query) -> Bools:
    """Test bricks for at least one force, bool [n]."""
    hits = np.empty(len(bricks), np.bool_)
    for_chunks(_holds, len(bricks), bricks, query, hits, chunk=16)
    return hits


def bricks_by_gpu(query: Query, grid: Grid) -> Int32s:
    """Find bricks with at least one force on the GPU, int32 [n, 3], ascending."""
    device_query, shape = on_device(query), grid.brick_shape
    corners = _corners(1, on_host(device_query.lattice_m))
    count, keys = math.prod(shape), [np.empty(0, np.int64)]
    for first in range(0, count, _GPU_BRICKS):
        block = min(_GPU_BRICKS, count - first)
        hits = on_device(np.zeros(block, np.bool_))
        for_each(_each_holds, 8 * block, first, shape, on_device(corners), device_query, hits)
        keys.append(first + np.flatnonzero(on_host(hits)))
    return bricks_of(grid, np.concatenate(keys))


def brick_forces(bricks: Int32s, query: Query) -> Float32s:
    """Return the forces of bricks, newtons, float32 [n, 8, 8, 8, 3]."""
    if len(bricks) * BYTES_PER_BRICK > memory_budget_bytes():
        return zero_forces(len(bricks))  # raises; otherwise all values are written below, without zeroing
    if uses_gpu():
        return on_host(forces_on_device(bricks, query)).reshape(-1, 8, 8, 8, 3)
    out = np.empty((len(bricks), 8, 8, 8, 3), np.float32)
    for_chunks(_fill, len(bricks), bricks, query, out.reshape(-1), chunk=16)
    return out


def forces_on_device(bricks: Int32s, query: Query) -> Any:
    """Compute the forces in GPU memory, float32 [1536 n] (``__cuda_array_interface__``)."""
    return filled(_each_fill, B3 * len(bricks), (bricks, query), 3 * B3 * len(bricks), np.float32)
