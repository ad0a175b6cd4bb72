"""Compiled loops of the depth reading: which bricks lie near the planes of a depth map, and their forces.

The force is told in `touchfield.sources.depth_scene`, and how the loops are laid out in `planes` beside this file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import njit

from touchfield.medium.budget import BYTES_PER_BRICK, memory_budget_bytes, zero_forces
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.kernels.planes import SurfacePlanes

    Float32s = NDArray[np.float32]

__all__ = ["B3", "Query", "all_nodes", "brick_forces", "brick_offsets", "holds_force", "may_hold_force"]

_0, _1, _HALF, _BIG = np.float32(0), np.float32(1), np.float32(0.5), np.float32(1e30)

B3 = 512  # samples of a brick
_NX, _NY, _NZ, _C, _PHI, _FORCE, _SCRATCH = (B3 * q for q in range(7))


class Query(NamedTuple):
    """A depth map's planes and the lattice on which their force is asked for.

    Attributes
    ----------
    lattice_m : float64 [4, 3]; In camera axes: the position of sample (0, 0, 0), and the steps along the three axes
        of the grid, whose samples are `shape`.
    turn : float32 [3, 3]; From camera axes to those of the force.
    pieces : float32 [n, 4]; The force profile.
    reach : float32 [3]; How far in front of and behind a plane a force may be, metres, and how many times as far
        along the ray.
    """

    surface: SurfacePlanes
    lattice_m: NDArray[np.float64]
    shape: tuple[int, int, int]
    turn: Float32s
    pieces: Float32s
    reach: Float32s


def all_nodes(shape: tuple[int, int, int]) -> NDArray[np.int32]:
    """All index triples below `shape`, the last fastest, int32 [n, 3]."""
    return np.indices(shape, np.int32).reshape(3, -1).T.copy()


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _box_in_view(x0, y0, z0, corners, camera, height, width, out):
    """The pixels that a box may fall on (u0, u1, v0, v1 into `out`) and its nearest and farthest z.

    Nothing (z from 1 to 0) where the box lies behind the camera or beside the picture.
    """
    z_low = z0 + corners[8, 2]
    z_high = z0 + corners[9, 2]
    if z_high <= 0.0:
        return 1.0, 0.0
    out[0], out[1], out[2], out[3] = 0, width - 1, 0, height - 1
    if z_low > 1e-3 * z_high:  # else the box touches the camera's plane and may fall anywhere
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
            return 1.0, 0.0
        out[0], out[1] = int(max(u0, 0.0)), int(min(u1, width - 1.0))
        out[2], out[3] = int(max(v0, 0.0)), int(min(v1, height - 1.0))
    return z_low, z_high


@njit(nogil=True, error_model="numpy")
def _near_surface(z_low, z_high, pixels, tiles, places, reach):
    """True if a box of these pixels and depths may hold a sample within reach of a surface."""
    level, shift = 0, 3
    while level + 1 < places.shape[0] and max(pixels[1] - pixels[0], pixels[3] - pixels[2]) >> shift > 4:
        level, shift = level + 1, shift + 1
    start, columns = places[level, 0], places[level, 1]
    near, far, flat = _0, _BIG, _BIG
    for t in range(pixels[2] >> shift, (pixels[3] >> shift) + 1):
        row = tiles[start + t * columns : start + t * columns + columns]
        for s in range(pixels[0] >> shift, (pixels[1] >> shift) + 1):
            x, y, z = row[s, 0], row[s, 1], row[s, 2]
            near = x if x > near else near
            far = y if y < far else far
            flat = z if z < flat else flat
    if near <= _0:
        return False
    z_far = 1.0 / far
    front = reach[0] * min(reach[2], z_far / flat)
    behind = reach[1] * min(reach[2], z_far / flat)
    slack = 1e-5 * z_high
    return z_high >= 1.0 / near - front - slack and z_low <= z_far + behind + slack


@njit(cache=True, nogil=True)
def _may_hold(begin, end, nodes, span, lattice, camera, height, width, tiles, places, reach, hits):
    corners = np.empty((10, 3))
    for q in range(8):
        for c in range(3):
            corners[q, c] = (8 * span - 1) * (
                (q >> 2) * lattice[1, c] + (q >> 1 & 1) * lattice[2, c] + (q & 1) * lattice[3, c]
            )
    corners[8] = corners[:8, 2].min()
    corners[9] = corners[:8, 2].max()
    pixels = np.empty(4, np.int64)
    for n in range(begin, end):
        a, b, d = 8.0 * span * nodes[n, 0], 8.0 * span * nodes[n, 1], 8.0 * span * nodes[n, 2]
        x = lattice[0, 0] + a * lattice[1, 0] + b * lattice[2, 0] + d * lattice[3, 0]
        y = lattice[0, 1] + a * lattice[1, 1] + b * lattice[2, 1] + d * lattice[3, 1]
        z = lattice[0, 2] + a * lattice[1, 2] + b * lattice[2, 2] + d * lattice[3, 2]
        z_low, z_high = _box_in_view(x, y, z, corners, camera, height, width, pixels)
        hits[n] = z_low <= z_high and _near_surface(z_low, z_high, pixels, tiles, places, reach)


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def pixels_of(x0, y0, z0, offsets, count, camera, height, width, index):
    fx, fy, cx, cy = camera[0], camera[1], camera[2] + _HALF, camera[3] + _HALF
    w, h = np.float32(width), np.float32(height)
    for s in range(count):
        z = z0 + offsets[s + 2 * B3]
        per_z = _1 / z
        u = (x0 + offsets[s]) * per_z * fx + cx
        v = (y0 + offsets[s + B3]) * per_z * fy + cy
        ok = (z > _0) & (u >= _0) & (u < w) & (v >= _0) & (v < h)
        inside = np.int32(v if ok else _0) * np.int32(width) + np.int32(u if ok else _0)
        index[s] = inside if ok else np.int32(height * width)


@njit(nogil=True)
def gather(planes, index, count, r):
    for s in range(count):
        p = np.uintp(4) * np.uintp(np.uint32(index[s]))  # unsigned: no question of counting from the end
        r[s + _NX] = planes[p]
        r[s + _NY] = planes[p + np.uintp(1)]
        r[s + _NZ] = planes[p + np.uintp(2)]
        r[s + _C] = planes[p + np.uintp(3)]


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _amplitudes(x0, y0, z0, offsets, count, pieces, reach, r):
    """Amplitudes, newtons, into ``r[_FORCE:]``."""
    low, high, intercept, slope = pieces[0, 0], pieces[0, 1], pieces[0, 2], pieces[0, 3]
    low2, high2, intercept2, slope2 = pieces[1, 0], pieces[1, 1], pieces[1, 2], pieces[1, 3]
    front, behind = reach[0] * reach[2], reach[1] * reach[2]
    for s in range(count):
        x = x0 + offsets[s]
        y = y0 + offsets[s + B3]
        z = z0 + offsets[s + 2 * B3]
        facing = r[s + _NX] * x + r[s + _NY] * y + r[s + _NZ] * z
        phi = facing - r[s + _C]
        # z * phi / facing is the distance in z from where the sample's own ray meets the plane
        is_near = (facing < _0) & (z * abs(phi) <= -facing * (behind if phi <= _0 else front))
        phi = phi if is_near else _BIG
        r[s + _PHI] = phi
        f = intercept + slope * phi if (phi > low) & (phi <= high) else _0
        r[s + _FORCE] = intercept2 + slope2 * phi if (phi > low2) & (phi <= high2) else f
    for p in range(2, pieces.shape[0]):
        low, high, intercept, slope = pieces[p, 0], pieces[p, 1], pieces[p, 2], pieces[p, 3]
        for s in range(count):
            phi = r[s + _PHI]
            f = intercept + slope * phi
            r[s + _FORCE] = f if (phi > low) & (phi <= high) else r[s + _FORCE]


@njit(nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _any_force(r, count):
    total = _0
    for s in range(count):
        total += abs(r[s + _FORCE])
    return total > _0


@njit(nogil=True)
def _trim(r, order, count, ni, nj, nk):
    """Take away the samples beyond the grid."""
    for q in range(count):
        s = order[q]
        if (s >> 6) >= ni or (s >> 3 & 7) >= nj or (s & 7) >= nk:
            r[q + _FORCE] = _0


@njit(nogil=True)
def _evaluate(brick, count, order, offsets, lattice, shape, camera, height, width, planes, pieces, reach, index, r):
    """Planes and amplitudes, into `r`, of `count` samples of a brick in the given order."""
    a, b, d = 8.0 * brick[0], 8.0 * brick[1], 8.0 * brick[2]
    x = np.float32(lattice[0, 0] + a * lattice[1, 0] + b * lattice[2, 0] + d * lattice[3, 0])
    y = np.float32(lattice[0, 1] + a * lattice[1, 1] + b * lattice[2, 1] + d * lattice[3, 1])
    z = np.float32(lattice[0, 2] + a * lattice[1, 2] + b * lattice[2, 2] + d * lattice[3, 2])
    pixels_of(x, y, z, offsets, count, camera, height, width, index)
    gather(planes, index, count, r)
    _amplitudes(x, y, z, offsets, count, pieces, reach, r)
    ni, nj, nk = shape[0] - 8 * brick[0], shape[1] - 8 * brick[1], shape[2] - 8 * brick[2]
    if min(ni, nj, nk) < 8:
        _trim(r, order, count, ni, nj, nk)


@njit(cache=True, nogil=True)
def _holds(begin, end, nodes, order, offsets, lattice, shape, camera, height, width, planes, pieces, reach, hits):
    index, r = np.empty(B3, np.int32), np.empty(_SCRATCH, np.float32)
    for n in range(begin, end):
        hits[n] = False
        for first in range(0, B3, 64):
            _evaluate(
                nodes[n], 64, order[first:], offsets[first:], lattice, shape, camera, height, width, planes, pieces,
                reach, index, r,
            )  # fmt: skip
            if _any_force(r, 64):
                hits[n] = True
                break


@njit(nogil=True, fastmath={"contract"})
def _write(r, turn, out):
    a, b, c = turn[0, 0], turn[0, 1], turn[0, 2]
    d, e, f = turn[1, 0], turn[1, 1], turn[1, 2]
    g, h, i = turn[2, 0], turn[2, 1], turn[2, 2]
    for s in range(B3):
        q = r[s + _FORCE]
        x, y, z = q * r[s + _NX], q * r[s + _NY], q * r[s + _NZ]
        out[3 * s] = a * x + b * y + c * z
        out[3 * s + 1] = d * x + e * y + f * z
        out[3 * s + 2] = g * x + h * y + i * z


@njit(cache=True, nogil=True)
def _fill(begin, end, nodes, order, offsets, lattice, shape, camera, height, width, planes, pieces, reach, turn, out):
    index, r = np.empty(B3, np.int32), np.empty(_SCRATCH, np.float32)
    for n in range(begin, end):
        _evaluate(
            nodes[n], B3, order, offsets, lattice, shape, camera, height, width, planes, pieces, reach, index, r
        )  # fmt: skip
        _write(r, turn, out[1536 * n : 1536 * n + 1536])


_IN_ORDER = np.arange(B3)
_IJK = np.stack(np.unravel_index(_IN_ORDER, (8, 8, 8))).astype(np.float64)
# Every second sample along each axis first: a brick that holds any force then shows it early.
_SPREAD = _IN_ORDER.reshape(4, 2, 4, 2, 4, 2).transpose(1, 3, 5, 0, 2, 4).ravel().copy()


def brick_offsets(query: Query, order: NDArray[np.int64] = _IN_ORDER) -> Float32s:
    """Positions in camera axes of a brick's samples relative to its first, x of all, then y, then z, metres."""
    return (query.lattice_m[1:].T @ _IJK[:, order]).astype(np.float32).reshape(-1)


def _of(query: Query, order: NDArray[np.int64]) -> tuple[Any, ...]:
    surface = query.surface
    view = (query.lattice_m, query.shape, surface.camera_px, *surface.size_px)
    return (order, brick_offsets(query, order), *view, surface.planes.reshape(-1), query.pieces, query.reach)


def may_hold_force(nodes: NDArray[np.int32], span: int, query: Query) -> NDArray[np.bool_]:
    """Cubes of `span` x `span` x `span` bricks that cannot be ruled out, bool [n]; `nodes` in units of `span`."""
    hits = np.empty(len(nodes), np.bool_)
    surface = query.surface
    view = (query.lattice_m, surface.camera_px, *surface.size_px, surface.tiles, surface.places, query.reach)
    for_chunks(_may_hold, len(nodes), nodes, span, *view, hits, chunk=64)
    return hits


def holds_force(bricks: NDArray[np.int32], query: Query) -> NDArray[np.bool_]:
    """Bricks that hold at least one force, bool [n]."""
    hits = np.empty(len(bricks), np.bool_)
    for_chunks(_holds, len(bricks), bricks, *_of(query, _SPREAD), hits, chunk=16)
    return hits


def brick_forces(bricks: NDArray[np.int32], query: Query) -> Float32s:
    """The forces of bricks, newtons, float32 [n, 8, 8, 8, 3]."""
    if len(bricks) * BYTES_PER_BRICK > memory_budget_bytes():
        return zero_forces(len(bricks))  # which refuses; else every number is written below, and zeros cost time
    out = np.empty((len(bricks), 8, 8, 8, 3), np.float32)
    for_chunks(_fill, len(bricks), bricks, *_of(query, _IN_ORDER), query.turn, out.reshape(-1), chunk=16)
    return out
