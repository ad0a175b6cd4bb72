"""Compiled inner loops of `DepthScene`: fit a tangent plane at each pixel of a depth image, and find the
bounds of the planes within tiles of it.

`touchfield.sources.depth.depth_scene` describes the estimate. Loops run without branches over contiguous
float32, so that LLVM vectorises them. Two things would prevent that: one array for each quantity (LLVM would
have to check whether they overlap), so all quantities lie in one scratch array at constant distances; and
Python's error for a division by zero, so numpy's error model is selected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks

if TYPE_CHECKING:
    from touchfield.sources.camera import Intrinsics

SLOPE_LIMIT_PX: Final = 5.0
"""Maximum slope along an image row or column, in pixel footprints of depth per pixel (79 degrees)."""

_TILE = 8  # pixels along each edge of a tile of the culling table
_0, _1, _2, _3, _4, _9, _16 = (np.float32(x) for x in (0, 1, 2, 3, 4, 9, 16))
_HALF, _QUARTER, _BIG, _TINY = np.float32(0.5), np.float32(0.25), np.float32(1e30), np.float32(1e-30)

_PAD = 6  # margin of a block, pixels: 4 for the line fit and 2 for the links
_BLOCK = 320  # columns processed at once
_STRIDE = _BLOCK + 2 * _PAD + 4
# A row of the scratch array consists of these sections of _STRIDE floats:
_INVERSE = 0 * _STRIDE  # inverse depth, 0 where invalid
_LINK = 1 * _STRIDE  # 1 where a pixel and its right neighbour lie on one surface
_LEVEL = 2 * _STRIDE  # inverse depth smoothed along the row
_TILT = 3 * _STRIDE  # slope along the row times `_WEIGHT`
_WEIGHT = 4 * _STRIDE  # sum of squared offsets of the pixels that support the slope
_DOWN = 5 * _STRIDE  # 1 where a pixel and its lower neighbour lie on one surface
_ROW = 6 * _STRIDE
# The planes of a row overwrite the row four above it, which is no longer needed:
_LARGEST = 0 * _STRIDE  # the largest inverse depth of the plane over the footprint of the pixel
_SMALLEST = 1 * _STRIDE  # the smallest inverse depth there
_OUT = 2 * _STRIDE  # normal and offset, four sections


class SurfacePlanes(NamedTuple):
    """The planes of a depth map, in camera axes.

    `planes` are unit normal n towards the camera and offset c, metres, with n . p = c on the plane; all zero
    where there is no plane, and after the last pixel. `tiles` bound tiles of 8 x 8 pixels: the largest and
    smallest inverse depth of the planes over their pixels, 1/m; (0, 1e30) where there is no plane.
    """

    size_px: tuple[int, int]  # height and width
    camera_px: Float32s  # [4]: fx, fy, cx, cy
    planes: Float32s  # [4 (height width + 1)]
    tiles: Float32s  # [rows of tiles, columns, 2]


_MIN_ACROSS = np.float32(6)  # minimum sum of squared offsets of the supporting pixels along the rows
_MIN_ALONG = np.float32(2)  # the same along the column: three pixels in line
_MIN_COSINE = np.float32(0.1)  # minimum cosine between the normal and the ray: 84 degrees


@inner(fastmath={"contract"}, error_model="numpy")
def _link(w0, w1, w2, w3, step, slope):
    d = w2 - w1
    bend = min(abs(d - (w1 - w0)), abs(w3 - w2 - d))
    flat = _1 if abs(d) <= step else _0
    ramp = _1 if bend <= step else _0
    ramp = ramp if abs(d) <= slope * w1 else _0
    return max(flat, ramp) if min(w1, w2) > _0 else _0


@inner(fastmath={"contract"}, error_model="numpy")
def _line(r, i, step, a, b):
    """Fit a line to the 4 values on each side of ``r[i]``, by their weights, relative to it.

    Returns the fitted middle value, the slope, and the slope's numerator and denominator.
    """
    c = r[i]
    a1, a2, a3, a4 = a
    b1, b2, b3, b4 = b
    x1, x2 = (r[i + step] - c) * a1, (r[i + 2 * step] - c) * a2
    x3, x4 = (r[i + 3 * step] - c) * a3, (r[i + 4 * step] - c) * a4
    y1, y2 = (r[i - step] - c) * b1, (r[i - 2 * step] - c) * b2
    y3, y4 = (r[i - 3 * step] - c) * b3, (r[i - 4 * step] - c) * b4
    s0 = _1 + ((a1 + b1) + (a2 + b2)) + ((a3 + b3) + (a4 + b4))
    s1 = (a1 - b1) + _2 * (a2 - b2) + _3 * (a3 - b3) + _4 * (a4 - b4)
    s2 = (a1 + b1) + _4 * (a2 + b2) + _9 * (a3 + b3) + _16 * (a4 + b4)
    t0 = ((x1 + y1) + (x2 + y2)) + ((x3 + y3) + (x4 + y4))
    t1 = (x1 - y1) + _2 * (x2 - y2) + _3 * (x3 - y3) + _4 * (x4 - y4)
    inverse_count = _1 / s0
    mean = s1 * inverse_count
    spread = s2 - s1 * mean
    moment = t1 - t0 * mean
    slope = moment / max(spread, _QUARTER)
    return c + (t0 * inverse_count - slope * mean), slope, moment, spread


@inner
def _chain(r, j, step):
    """Return the products of 1, 2, 3 and 4 links from ``r[j]`` on: 1 if no link is broken."""
    m1 = r[j]
    m2 = m1 * r[j + step]
    m3 = m2 * r[j + 2 * step]
    return m1, m2, m3, m3 * r[j + 3 * step]


@inner(fastmath={"contract"})
def _total(r, k, a, b):
    """Sum the values of the column of ``r[k]`` that the chains `a` (down) and `b` (up) reach."""
    first = r[k] + (a[0] * r[k + _ROW] + b[0] * r[k - _ROW])
    second = a[1] * r[k + 2 * _ROW] + b[1] * r[k - 2 * _ROW]
    third = a[2] * r[k + 3 * _ROW] + b[2] * r[k - 3 * _ROW]
    return first + second + third + (a[3] * r[k + 4 * _ROW] + b[3] * r[k - 4 * _ROW])


@inner(error_model="numpy")
def _load(r, depth, lead):
    r[_INVERSE : _INVERSE + _STRIDE] = _0
    for u in range(depth.shape[0]):
        inverse = _1 / depth[u]
        r[u + _INVERSE + lead] = inverse if depth[u] > _0 else _0


@inner(fastmath={"contract"}, error_model="numpy")
def _fit_row(r, n, step, slope):
    for u in range(n + 8):
        i = u + _INVERSE
        r[u + _LINK + 1] = _link(r[i], r[i + 1], r[i + 2], r[i + 3], step, slope)
    for u in range(n):
        i = u + _INVERSE + _PAD
        a = _chain(r, u + _LINK + _PAD, 1)
        b = _chain(r, u + _LINK + _PAD - 1, -1)
        r[u + _LEVEL + _PAD], _, moment, spread = _line(r, i, 1, a, b)
        r[u + _TILT + _PAD] = moment
        r[u + _WEIGHT + _PAD] = spread


@inner(fastmath={"contract"}, error_model="numpy")
def _link_down(r, n, step, slope):
    for u in range(n + 2 * _PAD):
        i = u + _LEVEL
        r[u + _DOWN + _ROW] = _link(r[i], r[i + _ROW], r[i + 2 * _ROW], r[i + 3 * _ROW], step, slope)


@inner(fastmath={"contract"}, error_model="numpy")
def _fit_column(r, n, fx, fy, centre_u, dv):
    """Compute the planes of one image row; `r` starts four rows above it.

    `centre_u` is the column of the optical axis, `dv` the row relative to it.
    """
    per_fx2, dv2 = _1 / (fx * fx), (dv / fy) * (dv / fy)
    for u in range(n):
        i = u + _PAD + 4 * _ROW
        k = i + _LEVEL
        a = _chain(r, i + _DOWN, _ROW)
        b = _chain(r, i + _DOWN - _ROW, -_ROW)
        w, wv, _, along = _line(r, k, _ROW, a, b)
        across = _total(r, i + _WEIGHT, a, b)
        wu = _total(r, i + _TILT, a, b) / max(across, _QUARTER)
        du = np.float32(np.int32(u)) - centre_u
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
        r[u + _PAD + _LARGEST] = ok * (w + half)
        r[u + _PAD + _SMALLEST] = w - half if ok > _0 else _BIG


@inner
def _store(r, n, planes):
    for u in range(n):
        i = u + _OUT + _PAD
        planes[4 * u] = r[i]
        planes[4 * u + 1] = r[i + _STRIDE]
        planes[4 * u + 2] = r[i + 2 * _STRIDE]
        planes[4 * u + 3] = r[i + 3 * _STRIDE]


@inner
def _fit_tiles(r, n, rows, bounds):
    """Compute the bounds of a row of tiles from the planes of its `rows` image rows.

    See `surface_planes`.
    """
    for i in range(1, rows):
        for u in range(n):
            a, b = r[u + _LARGEST + _PAD], r[u + _LARGEST + _PAD + i * _ROW]
            r[u + _LARGEST + _PAD] = b if b > a else a
        for u in range(n):
            a, b = r[u + _SMALLEST + _PAD], r[u + _SMALLEST + _PAD + i * _ROW]
            r[u + _SMALLEST + _PAD] = b if b < a else a
    for t in range((n + _TILE - 1) // _TILE):
        largest, smallest = _0, _BIG
        for u in range(t * _TILE, min(n, t * _TILE + _TILE)):
            x, y = r[u + _LARGEST + _PAD], r[u + _SMALLEST + _PAD]
            largest = x if x > largest else largest
            smallest = y if y < smallest else smallest
        bounds[t, 0], bounds[t, 1] = largest, smallest


@kernel(fastmath={"contract"}, error_model="numpy")
def _fit_planes(start, stop, depth, camera, gates, planes, bounds):
    """Fit rows of tiles start..stop.

    `gates` is the noise step and the slope limit, pixels.
    """
    height, width = depth.shape
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    top = start * _TILE - _PAD  # image row of the first row of the scratch array
    rows = min(height, stop * _TILE) + _PAD - top
    scratch = np.zeros(rows * _ROW + _STRIDE, np.float32)
    for column in range(0, width, _BLOCK):
        n = min(_BLOCK, width - column)
        full = (n + 7) // 8 * 8  # whole vectors: columns beyond n are never read
        first, last = max(0, column - _PAD), min(width, column + n + _PAD)
        for i in range(rows):
            r = scratch[i * _ROW :]
            if 0 <= top + i < height:
                _load(r, depth[top + i, first:last], first - column + _PAD)
                _fit_row(r, full, gates[0], gates[1] / fx)
            else:
                r[:_ROW] = _0
        for i in range(rows - 3):
            _link_down(scratch[i * _ROW :], full, gates[0], gates[1] / fy)
        for t in range(start, stop):
            last_row = min(height, t * _TILE + _TILE)
            for v in range(t * _TILE, last_row):
                r = scratch[(v - top - 4) * _ROW :]
                _fit_column(r, full, fx, fy, cx - np.float32(column), np.float32(v) - cy)
                _store(r, n, planes[4 * (v * width + column) :])
            r = scratch[(t * _TILE - top - 4) * _ROW :]
            _fit_tiles(r, n, last_row - t * _TILE, bounds[t, column // _TILE :])


def surface_planes(depth_m: Float32s, camera: Intrinsics, step_per_m: float) -> SurfacePlanes:
    """Estimate the tangent planes of a depth map, metres, and their bounds in tiles.

    `depth_m` float32 [height, width], C-contiguous; unknown pixels are not positive or not finite;
    `step_per_m` is the noise step (see `touchfield.sources.depth.depth_scene`).
    """
    height, width = depth_m.shape
    planes = np.empty(4 * (height * width + 1), np.float32)
    planes[-4:] = 0
    tiles = np.empty((-(-height // _TILE), -(-width // _TILE), 2), np.float32)
    gates = np.array([step_per_m, SLOPE_LIMIT_PX], np.float32)
    camera_px = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    for_chunks(_fit_planes, len(tiles), depth_m, camera_px, gates, planes, tiles, chunk=4)
    return SurfacePlanes((height, width), camera_px, planes, tiles)
