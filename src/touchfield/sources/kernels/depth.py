"""Compiled loops of the depth reading: tangent planes of a depth map, and forces on bricks near them.

Section 4 of the paper leaves the field of a scene to its [21], which gives no formula; the estimate of the planes
is told in `touchfield.sources.normals`, the force that they make in `touchfield.sources.depth_scene`. Loops run
without branches over contiguous float32, so that LLVM turns them into vector code. Two things would prevent it:
an array for each quantity (LLVM would have to ask whether any two overlap), so that they lie in one scratch array
at constant distances; and Python's error for a division by zero, so that numpy's rule is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from touchfield.medium.budget import BYTES_PER_BRICK, memory_budget_bytes, zero_forces
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]

__all__ = ["Query", "all_nodes", "brick_forces", "fit_planes", "holds_force", "may_hold_force"]

_TILE = 8  # pixels along each edge of a tile of the culling table
_0, _1, _2, _3, _4, _9, _16 = (np.float32(x) for x in (0, 1, 2, 3, 4, 9, 16))
_HALF, _QUARTER, _BIG, _TINY = np.float32(0.5), np.float32(0.25), np.float32(1e30), np.float32(1e-30)

# -- tangent planes ---------------------------------------------------------------------------------------

_PAD = 6  # pixels beside a block that it needs: 4 for the line fit and 2 for the links
_BLOCK = 320  # columns worked on at once
_STRIDE = _BLOCK + 2 * _PAD + 4
# A row of the scratch array consists of these sections of _STRIDE floats:
_INVERSE = 0 * _STRIDE  # inverse depth, 0 where invalid
_LINK = 1 * _STRIDE  # 1 where a pixel and its right neighbour lie on one surface
_LEVEL = 2 * _STRIDE  # inverse depth smoothed along the row
_TILT = 3 * _STRIDE  # its slope along the row, times ...
_WEIGHT = 4 * _STRIDE  # ... the sum of squared offsets that the slope rests on
_DOWN = 5 * _STRIDE  # 1 where a pixel and its lower neighbour lie on one surface
_ROW = 6 * _STRIDE
# The planes of a row overwrite the row four above it, which is not needed any more:
_NEAR = 0 * _STRIDE  # the largest inverse depth of the plane over the footprint of the pixel
_FAR = 1 * _STRIDE  # and the smallest
_OUT = 2 * _STRIDE  # normal and offset, four sections

_MIN_ACROSS = np.float32(6)  # least sum of squared offsets of the supporting pixels along the rows ...
_MIN_ALONG = np.float32(2)  # ... and along the column: three pixels in line
_MIN_COSINE = np.float32(0.1)  # between the normal and the ray: 84 degrees


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _link(before, here, there, after, step, slope):
    d = there - here
    bend = min(abs(d - (here - before)), abs(after - there - d))
    flat = _1 if abs(d) <= step else _0
    ramp = _1 if bend <= step else _0
    ramp = ramp if abs(d) <= slope * here else _0
    return max(flat, ramp) if min(here, there) > _0 else _0


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _line(a, b, x, y):
    """Weighted line fit over 4 values on each side, given relative to the middle one.

    Returns the fitted middle value, the slope, and the slope's numerator and denominator.
    """
    a1, a2, a3, a4 = a
    b1, b2, b3, b4 = b
    x1, x2, x3, x4 = x[0] * a1, x[1] * a2, x[2] * a3, x[3] * a4
    y1, y2, y3, y4 = y[0] * b1, y[1] * b2, y[2] * b3, y[3] * b4
    s0 = _1 + ((a1 + b1) + (a2 + b2)) + ((a3 + b3) + (a4 + b4))
    s1 = (a1 - b1) + _2 * (a2 - b2) + _3 * (a3 - b3) + _4 * (a4 - b4)
    s2 = (a1 + b1) + _4 * (a2 + b2) + _9 * (a3 + b3) + _16 * (a4 + b4)
    t0 = ((x1 + y1) + (x2 + y2)) + ((x3 + y3) + (x4 + y4))
    t1 = (x1 - y1) + _2 * (x2 - y2) + _3 * (x3 - y3) + _4 * (x4 - y4)
    share = _1 / s0
    mean = s1 * share
    spread = s2 - s1 * mean
    moment = t1 - t0 * mean
    slope = moment / max(spread, _QUARTER)
    return t0 * share - slope * mean, slope, moment, spread


@njit(nogil=True)
def _chain(r, j, step):
    """Products of 1, 2, 3 and 4 links from ``r[j]`` on: which neighbours are reached without a break."""
    m1 = r[j]
    m2 = m1 * r[j + step]
    m3 = m2 * r[j + 2 * step]
    return m1, m2, m3, m3 * r[j + 3 * step]


@njit(nogil=True, fastmath={"contract"})
def _total(r, k, a, b):
    """The sum over the column through ``r[k]`` of what the chains `a` (down) and `b` (up) reach."""
    one = r[k] + (a[0] * r[k + _ROW] + b[0] * r[k - _ROW])
    two = a[1] * r[k + 2 * _ROW] + b[1] * r[k - 2 * _ROW]
    three = a[2] * r[k + 3 * _ROW] + b[2] * r[k - 3 * _ROW]
    return one + two + three + (a[3] * r[k + 4 * _ROW] + b[3] * r[k - 4 * _ROW])


@njit(nogil=True, error_model="numpy")
def _load(r, depth, lead):
    r[_INVERSE : _INVERSE + _STRIDE] = _0
    for u in range(depth.shape[0]):
        inverse = _1 / depth[u]
        r[u + _INVERSE + lead] = inverse if depth[u] > _0 else _0


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _fit_row(r, n, step, slope):
    for u in range(n + 8):
        i = u + _INVERSE
        r[u + _LINK + 1] = _link(r[i], r[i + 1], r[i + 2], r[i + 3], step, slope)
    for u in range(n):
        i = u + _INVERSE + _PAD
        c = r[i]
        a = _chain(r, u + _LINK + _PAD, 1)
        b = _chain(r, u + _LINK + _PAD - 1, -1)
        x = (r[i + 1] - c, r[i + 2] - c, r[i + 3] - c, r[i + 4] - c)
        y = (r[i - 1] - c, r[i - 2] - c, r[i - 3] - c, r[i - 4] - c)
        rise, _, moment, spread = _line(a, b, x, y)
        r[u + _LEVEL + _PAD] = c + rise
        r[u + _TILT + _PAD] = moment
        r[u + _WEIGHT + _PAD] = spread


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _link_down(r, n, step, slope):
    for u in range(n + 2 * _PAD):
        i = u + _LEVEL
        r[u + _DOWN + _ROW] = _link(r[i], r[i + _ROW], r[i + 2 * _ROW], r[i + 3 * _ROW], step, slope)


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _fit_column(r, n, fx, fy, left, dv):
    """The planes of one image row; `r` begins four rows above it, `left` and `dv` count from the axis."""
    per_fx2, dv2 = _1 / (fx * fx), (dv / fy) * (dv / fy)
    for u in range(n):
        i = u + _PAD + 4 * _ROW
        k = i + _LEVEL
        c = r[k]
        a = _chain(r, i + _DOWN, _ROW)
        b = _chain(r, i + _DOWN - _ROW, -_ROW)
        x = (r[k + _ROW] - c, r[k + 2 * _ROW] - c, r[k + 3 * _ROW] - c, r[k + 4 * _ROW] - c)
        y = (r[k - _ROW] - c, r[k - 2 * _ROW] - c, r[k - 3 * _ROW] - c, r[k - 4 * _ROW] - c)
        rise, wv, _, along = _line(a, b, x, y)
        across = _total(r, i + _WEIGHT, a, b)
        w = c + rise
        wu = _total(r, i + _TILT, a, b) / max(across, _QUARTER)
        du = np.float32(np.int32(u)) - left
        nx = fx * wu
        ny = fy * wv
        nz = w - du * wu - dv * wv
        square = nx * nx + ny * ny + nz * nz
        half = _HALF * (abs(wu) + abs(wv))
        ok = _1 if r[i + _INVERSE] > _0 else _0
        ok = ok if across >= _MIN_ACROSS else _0
        ok = ok if along >= _MIN_ALONG else _0
        ok = ok if w > _2 * half else _0
        ok = ok if w * w >= _MIN_COSINE * _MIN_COSINE * square * (_1 + du * du * per_fx2 + dv2) else _0
        s = -ok / np.sqrt(square + _TINY)
        r[u + _PAD + _OUT] = nx * s
        r[u + _PAD + _OUT + _STRIDE] = ny * s
        r[u + _PAD + _OUT + 2 * _STRIDE] = nz * s
        r[u + _PAD + _OUT + 3 * _STRIDE] = s
        r[u + _PAD + _NEAR] = ok * (w + half)
        r[u + _PAD + _FAR] = w - half if ok > _0 else _BIG


@njit(nogil=True)
def _store(r, n, planes):
    for u in range(n):
        i = u + _OUT + _PAD
        planes[4 * u] = r[i]
        planes[4 * u + 1] = r[i + _STRIDE]
        planes[4 * u + 2] = r[i + 2 * _STRIDE]
        planes[4 * u + 3] = r[i + 3 * _STRIDE]


@njit(nogil=True)
def _fit_tiles(r, n, rows, bounds):
    """Bounds of a row of tiles, from the planes of its `rows` image rows: see `fit_planes`."""
    c = _OUT + 3 * _STRIDE
    for u in range(n):
        r[u + c + _PAD] = -r[u + c + _PAD] if r[u + c + _PAD] < _0 else _BIG
    for i in range(1, rows):
        for u in range(n):
            a, b = r[u + _NEAR + _PAD], r[u + _NEAR + _PAD + i * _ROW]
            r[u + _NEAR + _PAD] = b if b > a else a
        for u in range(n):
            a, b = r[u + _FAR + _PAD], r[u + _FAR + _PAD + i * _ROW]
            r[u + _FAR + _PAD] = b if b < a else a
        for u in range(n):
            a, b = r[u + c + _PAD], r[u + c + _PAD + i * _ROW]
            b = -b if b < _0 else _BIG
            r[u + c + _PAD] = b if b < a else a
    for t in range((n + _TILE - 1) // _TILE):
        near, far, flat = _0, _BIG, _BIG
        for u in range(t * _TILE, min(n, t * _TILE + _TILE)):
            x, y, z = r[u + _NEAR + _PAD], r[u + _FAR + _PAD], r[u + c + _PAD]
            near = x if x > near else near
            far = y if y < far else far
            flat = z if z < flat else flat
        bounds[t, 0], bounds[t, 1], bounds[t, 2] = near, far, flat


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _fit_planes(begin, end, depth, camera, gates, planes, bounds):
    """Rows of tiles begin..end; `gates` is the noise step and the slope limit, pixels."""
    height, width = depth.shape
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    top = begin * _TILE - _PAD  # image row of the first row of the scratch array
    rows = min(height, end * _TILE) + _PAD - top
    scratch = np.zeros(rows * _ROW + _STRIDE, np.float32)
    for left in range(0, width, _BLOCK):
        n = min(_BLOCK, width - left)
        full = (n + 7) // 8 * 8  # whole vectors: the columns beyond n are junk that nobody reads
        first, last = max(0, left - _PAD), min(width, left + n + _PAD)
        for i in range(rows):
            r = scratch[i * _ROW :]
            if 0 <= top + i < height:
                _load(r, depth[top + i, first:last], first - left + _PAD)
                _fit_row(r, full, gates[0], gates[1] / fx)
            else:
                r[:_ROW] = _0
        for i in range(rows - 3):
            _link_down(scratch[i * _ROW :], full, gates[0], gates[1] / fy)
        for t in range(begin, end):
            stop = min(height, t * _TILE + _TILE)
            for v in range(t * _TILE, stop):
                r = scratch[(v - top - 4) * _ROW :]
                _fit_column(r, full, fx, fy, cx - np.float32(left), np.float32(v) - cy)
                _store(r, n, planes[4 * (v * width + left) :])
            r = scratch[(t * _TILE - top - 4) * _ROW :]
            _fit_tiles(r, n, stop - t * _TILE, bounds[t, left // _TILE :])


@njit(cache=True, nogil=True)
def _widen(tiles, places, rows):
    """Bounds of tiles twice as wide, level after level, from those of the first."""
    for level in range(1, places.shape[0]):
        fine, fine_columns = places[level - 1, 0], places[level - 1, 1]
        start, columns = places[level, 0], places[level, 1]
        tiles[start : start + rows[level] * columns, 0] = _0
        tiles[start : start + rows[level] * columns, 1:] = _BIG
        for t in range(rows[level - 1]):
            for s in range(fine_columns):
                a, b = tiles[fine + t * fine_columns + s], tiles[start + (t >> 1) * columns + (s >> 1)]
                b[0], b[1], b[2] = max(a[0], b[0]), min(a[1], b[1]), min(a[2], b[2])


def fit_planes(
    depth_m: Float32s, camera_px: Float32s, step_per_m: float, slope_px: float
) -> tuple[Float32s, Float32s, NDArray[np.int64]]:
    """Tangent planes of a depth map, and their bounds in tiles.

    Parameters
    ----------
    depth_m : float32 [height, width], C-contiguous
    camera_px : float32 [4]
        fx, fy, cx, cy.
    step_per_m, slope_px : float
        The gates (see `touchfield.sources.normals`).

    Returns
    -------
    planes : float32 [height * width + 1, 4]
    tiles : float32 [m, 3]
    places : int64 [levels, 2]
        See `touchfield.sources.normals.SurfacePlanes`.
    """
    height, width = depth_m.shape
    planes = np.empty((height * width + 1, 4), np.float32)
    planes[-1] = 0
    sizes = [(-(-height // _TILE), -(-width // _TILE))]
    while sizes[-1] != (1, 1):
        sizes.append((-(-sizes[-1][0] // 2), -(-sizes[-1][1] // 2)))
    rows = np.array([size[0] for size in sizes])
    columns = np.array([size[1] for size in sizes])
    ends = np.cumsum(rows * columns)
    places = np.stack([ends - rows * columns, columns], axis=1)
    tiles = np.empty((ends[-1], 3), np.float32)
    finest = tiles[: ends[0]].reshape(rows[0], columns[0], 3)
    gates = np.array([step_per_m, slope_px], np.float32)
    for_chunks(_fit_planes, rows[0], depth_m, camera_px, gates, planes.reshape(-1), finest, chunk=4)
    _widen(tiles, places, rows)
    return planes, tiles, places


# -- which bricks, and what force -------------------------------------------------------------------------

_B3 = 512
_NX, _NY, _NZ, _C, _PHI, _FORCE, _SCRATCH = (_B3 * q for q in range(7))


@dataclass(frozen=True)
class Query:
    """A depth map's planes and the lattice on which their force is asked for.

    Attributes
    ----------
    planes : float32 [height * width + 1, 4]
        As `fit_planes` gives them.
    tiles : float32 [m, 3]
        Bounds of tiles as `fit_planes` gives them, of 8 pixels, then of 16, 32 ... up to one tile for all.
    places : int64 [levels, 2]
        Where each size begins in `tiles`, and its columns.
    size_px : (int, int)
        Height and width.
    camera_px : float32 [4]
        fx, fy, cx, cy.
    lattice_m : float64 [4, 3]
        In camera axes: the position of sample (0, 0, 0), and the steps along the three axes of the grid.
    shape : (int, int, int)
        Samples of the grid.
    turn : float32 [3, 3]
        From camera axes to those of the force.
    pieces : float32 [n, 4]
        The force profile.
    reach : float32 [3]
        How far in front of and behind a plane a force may be, metres, and how many times as far along the ray.
    """

    planes: Float32s
    tiles: Float32s
    places: NDArray[np.int64]
    size_px: tuple[int, int]
    camera_px: Float32s
    lattice_m: NDArray[np.float64]
    shape: tuple[int, int, int]
    turn: Float32s
    pieces: Float32s
    reach: Float32s


@njit(cache=True, nogil=True)
def _enumerate(shape, out):
    n = 0
    for i in range(shape[0]):
        for j in range(shape[1]):
            for k in range(shape[2]):
                out[n, 0], out[n, 1], out[n, 2] = i, j, k
                n += 1


def all_nodes(shape: tuple[int, int, int]) -> NDArray[np.int32]:
    """All index triples below `shape`, the last fastest, int32 [n, 3]."""
    out = np.empty((shape[0] * shape[1] * shape[2], 3), np.int32)
    _enumerate(shape, out)
    return out


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
    """Whether a box of these pixels and depths may hold a sample within reach of a surface."""
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
def _pixels_of(x0, y0, z0, offsets, count, camera, height, width, index):
    fx, fy, cx, cy = camera[0], camera[1], camera[2] + _HALF, camera[3] + _HALF
    w, h = np.float32(width), np.float32(height)
    for s in range(count):
        z = z0 + offsets[s + 2 * _B3]
        per_z = _1 / z
        u = (x0 + offsets[s]) * per_z * fx + cx
        v = (y0 + offsets[s + _B3]) * per_z * fy + cy
        ok = (z > _0) & (u >= _0) & (u < w) & (v >= _0) & (v < h)
        inside = np.int32(v if ok else _0) * np.int32(width) + np.int32(u if ok else _0)
        index[s] = inside if ok else np.int32(height * width)


@njit(nogil=True)
def _gather(planes, index, count, r):
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
        y = y0 + offsets[s + _B3]
        z = z0 + offsets[s + 2 * _B3]
        facing = r[s + _NX] * x + r[s + _NY] * y + r[s + _NZ] * z
        phi = facing - r[s + _C]
        # z * phi / facing is the distance in z from where the sample's own ray meets the plane
        held = (facing < _0) & (z * abs(phi) <= -facing * (behind if phi <= _0 else front))
        phi = phi if held else _BIG
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
    _pixels_of(x, y, z, offsets, count, camera, height, width, index)
    _gather(planes, index, count, r)
    _amplitudes(x, y, z, offsets, count, pieces, reach, r)
    ni, nj, nk = shape[0] - 8 * brick[0], shape[1] - 8 * brick[1], shape[2] - 8 * brick[2]
    if min(ni, nj, nk) < 8:
        _trim(r, order, count, ni, nj, nk)


@njit(cache=True, nogil=True)
def _holds(begin, end, nodes, order, offsets, lattice, shape, camera, height, width, planes, pieces, reach, hits):
    index, r = np.empty(_B3, np.int32), np.empty(_SCRATCH, np.float32)
    for n in range(begin, end):
        hits[n] = False
        for first in range(0, _B3, 64):
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
    for s in range(_B3):
        q = r[s + _FORCE]
        x, y, z = q * r[s + _NX], q * r[s + _NY], q * r[s + _NZ]
        out[3 * s] = a * x + b * y + c * z
        out[3 * s + 1] = d * x + e * y + f * z
        out[3 * s + 2] = g * x + h * y + i * z


@njit(cache=True, nogil=True)
def _fill(begin, end, nodes, order, offsets, lattice, shape, camera, height, width, planes, pieces, reach, turn, out):
    index, r = np.empty(_B3, np.int32), np.empty(_SCRATCH, np.float32)
    for n in range(begin, end):
        _evaluate(
            nodes[n], _B3, order, offsets, lattice, shape, camera, height, width, planes, pieces, reach, index, r
        )  # fmt: skip
        _write(r, turn, out[1536 * n : 1536 * n + 1536])


_IN_ORDER = np.arange(_B3)
_IJK = np.stack(np.unravel_index(_IN_ORDER, (8, 8, 8))).astype(np.float64)
# Every second sample along each axis first: a brick that holds any force then shows it early.
_SPREAD = _IN_ORDER.reshape(4, 2, 4, 2, 4, 2).transpose(1, 3, 5, 0, 2, 4).ravel().copy()


def _offsets(query: Query, order: NDArray[np.int64]) -> Float32s:
    """Positions in camera axes relative to the first sample of a brick, x of all, then y, then z, metres."""
    return (query.lattice_m[1:].T @ _IJK[:, order]).astype(np.float32).reshape(-1)


def _of(query: Query, order: NDArray[np.int64]) -> tuple[Any, ...]:
    view = (query.lattice_m, query.shape, query.camera_px, *query.size_px)
    return (order, _offsets(query, order), *view, query.planes.reshape(-1), query.pieces, query.reach)


def may_hold_force(nodes: NDArray[np.int32], span: int, query: Query) -> NDArray[np.bool_]:
    """Which cubes of `span` x `span` x `span` bricks cannot be ruled out, bool [n]; `nodes` in units of `span`."""
    hits = np.empty(len(nodes), np.bool_)
    view = (query.lattice_m, query.camera_px, *query.size_px, query.tiles, query.places, query.reach)
    for_chunks(_may_hold, len(nodes), nodes, span, *view, hits, chunk=64)
    return hits


def holds_force(bricks: NDArray[np.int32], query: Query) -> NDArray[np.bool_]:
    """Which bricks hold at least one force, bool [n]."""
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
