"""Compiled loops of the depth reading: tangent planes of a depth map, and their bounds in tiles.

The estimate is told in `touchfield.sources.depth.depth_scene`. Loops run without branches over contiguous
float32, so that LLVM turns them into vector code. Two things would prevent it: an array for each quantity
(LLVM would have to ask whether any two overlap), so that they lie in one scratch array at constant distances;
and Python's error for a division by zero, so that numpy's rule is asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks

if TYPE_CHECKING:
    from touchfield.sources.camera import Intrinsics

SLOPE_LIMIT_PX: Final = (
    5.0  # along an image row or column, footprints of a pixel in depth per pixel: 79 degrees
)

_TILE = 8  # pixels along each edge of a tile of the culling table
_0, _1, _2, _3, _4, _9, _16 = (np.float32(x) for x in (0, 1, 2, 3, 4, 9, 16))
_HALF, _QUARTER, _BIG, _TINY = np.float32(0.5), np.float32(0.25), np.float32(1e30), np.float32(1e-30)

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


class SurfacePlanes(NamedTuple):
    """The planes of a depth map, in camera axes.

    `planes` are unit normal n towards the camera and offset c, metres, with n . p = c on the plane; all zero
    where there is no plane, and behind the last pixel. `tiles` bound tiles of 8 x 8 pixels: the largest and
    smallest inverse depth of the planes over their pixels, 1/m; (0, 1e30) where there is no plane.
    """

    size_px: tuple[int, int]  # height and width
    camera_px: Float32s  # [4]: fx, fy, cx, cy
    planes: Float32s  # [4 (height width + 1)]
    tiles: Float32s  # [rows of tiles, columns, 2]


_MIN_ACROSS = np.float32(6)  # least sum of squared offsets of the supporting pixels along the rows ...
_MIN_ALONG = np.float32(2)  # ... and along the column: three pixels in line
_MIN_COSINE = np.float32(0.1)  # between the normal and the ray: 84 degrees


@inner(fastmath={"contract"}, error_model="numpy")
def _link(before, here, there, after, step, slope):
    d = there - here
    bend = min(abs(d - (here - before)), abs(after - there - d))
    flat = _1 if abs(d) <= step else _0
    ramp = _1 if bend <= step else _0
    ramp = ramp if abs(d) <= slope * here else _0
    return max(flat, ramp) if min(here, there) > _0 else _0


@inner(fastmath={"contract"}, error_model="numpy")
def _line(r, i, step, a, b):
    """Line fit over the 4 values behind and before ``r[i]``, by their weights, relative to it.

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
    share = _1 / s0
    mean = s1 * share
    spread = s2 - s1 * mean
    moment = t1 - t0 * mean
    slope = moment / max(spread, _QUARTER)
    return c + (t0 * share - slope * mean), slope, moment, spread


@inner
def _chain(r, j, step):
    """Products of 1, 2, 3 and 4 links from ``r[j]`` on: which neighbours are reached without a break."""
    m1 = r[j]
    m2 = m1 * r[j + step]
    m3 = m2 * r[j + 2 * step]
    return m1, m2, m3, m3 * r[j + 3 * step]


@inner(fastmath={"contract"})
def _total(r, k, a, b):
    """The sum over the column through ``r[k]`` of what the chains `a` (down) and `b` (up) reach."""
    one = r[k] + (a[0] * r[k + _ROW] + b[0] * r[k - _ROW])
    two = a[1] * r[k + 2 * _ROW] + b[1] * r[k - 2 * _ROW]
    three = a[2] * r[k + 3 * _ROW] + b[2] * r[k - 3 * _ROW]
    return one + two + three + (a[3] * r[k + 4 * _ROW] + b[3] * r[k - 4 * _ROW])


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
def _fit_column(r, n, fx, fy, left, dv):
    """The planes of one image row; `r` begins four rows above it, `left` and `dv` count from the axis."""
    per_fx2, dv2 = _1 / (fx * fx), (dv / fy) * (dv / fy)
    for u in range(n):
        i = u + _PAD + 4 * _ROW
        k = i + _LEVEL
        a = _chain(r, i + _DOWN, _ROW)
        b = _chain(r, i + _DOWN - _ROW, -_ROW)
        w, wv, _, along = _line(r, k, _ROW, a, b)
        across = _total(r, i + _WEIGHT, a, b)
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
    """Bounds of a row of tiles, from the planes of its `rows` image rows: see `surface_planes`."""
    for i in range(1, rows):
        for u in range(n):
            a, b = r[u + _NEAR + _PAD], r[u + _NEAR + _PAD + i * _ROW]
            r[u + _NEAR + _PAD] = b if b > a else a
        for u in range(n):
            a, b = r[u + _FAR + _PAD], r[u + _FAR + _PAD + i * _ROW]
            r[u + _FAR + _PAD] = b if b < a else a
    for t in range((n + _TILE - 1) // _TILE):
        near, far = _0, _BIG
        for u in range(t * _TILE, min(n, t * _TILE + _TILE)):
            x, y = r[u + _NEAR + _PAD], r[u + _FAR + _PAD]
            near = x if x > near else near
            far = y if y < far else far
        bounds[t, 0], bounds[t, 1] = near, far


@kernel(fastmath={"contract"}, error_model="numpy")
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


def surface_planes(depth_m: Float32s, camera: Intrinsics, step_per_m: float) -> SurfacePlanes:
    """Tangent planes of a depth map, metres, and their bounds in tiles.

    `depth_m` float32 [height, width], C-contiguous, not positive or not finite where unknown; `step_per_m` is
    the noise step (see `touchfield.sources.depth.depth_scene`).
    """
    height, width = depth_m.shape
    planes = np.empty(4 * (height * width + 1), np.float32)
    planes[-4:] = 0
    tiles = np.empty((-(-height // _TILE), -(-width // _TILE), 2), np.float32)
    gates = np.array([step_per_m, SLOPE_LIMIT_PX], np.float32)
    camera_px = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    for_chunks(_fit_planes, len(tiles), depth_m, camera_px, gates, planes, tiles, chunk=4)
    return SurfacePlanes((height, width), camera_px, planes, tiles)
