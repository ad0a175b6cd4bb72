"""Compiled loops of the depth reading: tangent planes of a depth map, and forces on bricks near them.

Section 4 of the paper leaves the field of a scene to its [21], which gives no formula; `touchfield.sources.normals`
says how planes are estimated and `touchfield.sources.depth_scene` how they make a force. Rows and bricks are
written as loops without branches over contiguous float32, so that LLVM turns them into vector code.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]

__all__ = ["TILE", "brick_forces", "fit_planes", "node_hits", "occupied_bricks", "tile_levels"]

TILE = 8
"""Pixels along each edge of a tile of the culling table."""

_R = 4  # pixels on each side of a line fit
_PAD = _R + 2
_ONE = np.float32(1)
_ZERO = np.float32(0)
_FAR = np.float32(1e30)
_MIN_ACROSS = np.float32(6)  # sum of squared offsets of the supporting pixels along the rows ...
_MIN_ALONG = np.float32(2)  # ... and along the column: three pixels in line
_TINY_N = np.float32(1e-30)


# -- tangent planes ---------------------------------------------------------------------------------------


@njit(nogil=True, fastmath={"contract"}, error_model="numpy", inline="always")
def _link(before, here, there, after, step, slope):
    """1 if two neighbouring pixels lie on one surface, else 0, of inverse depths (0 is invalid)."""
    d = there - here
    bend = min(abs(d - (here - before)), abs(after - there - d))
    flat = _ONE if abs(d) <= step else _ZERO
    ramp = _ONE if bend <= step else _ZERO
    ramp = ramp if abs(d) <= slope * here else _ZERO
    both = _ONE if min(here, there) > _ZERO else _ZERO
    return both * max(flat, ramp)


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _fit_rows(inverse, step, slope, link, level, tilt, weight):
    """Line fits along one padded row: level (smoothed inverse depth), tilt * weight, and weight."""
    n = level.shape[0]
    for j in range(1, inverse.shape[0] - 2):
        link[j] = _link(inverse[j - 1], inverse[j], inverse[j + 1], inverse[j + 2], step, slope)
    for u in range(n):
        j = u + _PAD
        w0 = inverse[j]
        s0, s1, s2, t0, t1 = _ONE, _ZERO, _ZERO, _ZERO, _ZERO
        a, b = _ONE, _ONE
        for k in range(1, _R + 1):
            kf = np.float32(k)
            a *= link[j + k - 1]
            b *= link[j - k]
            x = a * (inverse[j + k] - w0)
            y = b * (inverse[j - k] - w0)
            s0 += a + b
            s1 += kf * (a - b)
            s2 += kf * kf * (a + b)
            t0 += x + y
            t1 += kf * (x - y)
        mean = s1 / s0
        spread = s2 - s1 * mean
        moment = t1 - t0 * mean
        safe = max(spread, np.float32(0.25))
        level[u] = w0 + t0 / s0 - (moment / safe) * mean
        tilt[u] = moment
        weight[u] = spread


@njit(nogil=True, fastmath={"contract"}, error_model="numpy")
def _fit_columns(v, level, tilt, weight, link, inverse, fx, fy, cx, cy, out, near, far):
    """Line fits down the columns at row `v` of the buffers, and the plane of each pixel.

    out: float32 [4, W], normal and offset; near and far: the bounds of the plane's inverse depth over the
    pixel's footprint, taken into the running maximum and minimum of the tile row.
    """
    for u in range(out.shape[1]):
        w0 = level[v, u]
        s0, s1, s2, t0, t1 = _ONE, _ZERO, _ZERO, _ZERO, _ZERO
        a, b = _ONE, _ONE
        across, moment = weight[v, u], tilt[v, u]
        for k in range(1, _R + 1):
            kf = np.float32(k)
            a *= link[v + k - 1, u]
            b *= link[v - k, u]
            x = a * (level[v + k, u] - w0)
            y = b * (level[v - k, u] - w0)
            s0 += a + b
            s1 += kf * (a - b)
            s2 += kf * kf * (a + b)
            t0 += x + y
            t1 += kf * (x - y)
            across += a * weight[v + k, u] + b * weight[v - k, u]
            moment += a * tilt[v + k, u] + b * tilt[v - k, u]
        mean = s1 / s0
        along = s2 - s1 * mean
        wv = (t1 - t0 * mean) / max(along, np.float32(0.25))
        wu = moment / max(across, np.float32(0.25))
        w = w0 + t0 / s0 - wv * mean
        du = np.float32(u) - cx
        dv = cy  # cy comes in as v - cy
        nx = fx * wu
        ny = fy * wv
        nz = w - du * wu - dv * wv
        square = nx * nx + ny * ny + nz * nz
        ray = _ONE + (du / fx) * (du / fx) + (dv / fy) * (dv / fy)
        half = np.float32(0.5) * (abs(wu) + abs(wv))
        ok = _ONE if inverse[u] > _ZERO else _ZERO
        ok = ok if across >= _MIN_ACROSS else _ZERO
        ok = ok if along >= _MIN_ALONG else _ZERO
        ok = ok if w > np.float32(2) * half else _ZERO
        ok = ok if w * w >= np.float32(0.01) * square * ray else _ZERO
        r = -ok / np.sqrt(square + np.float32(1e-30))
        out[0, u] = nx * r
        out[1, u] = ny * r
        out[2, u] = nz * r
        out[3, u] = r
        near[u] = max(near[u], ok * (w + half))
        far[u] = min(far[u], w - half if ok > _ZERO else _FAR)


@njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")
def _fit_planes(begin, end, depth, camera, step, planes, near_w, far_w):
    height, width = depth.shape
    fx, fy, cx, cy = camera[0], camera[1], camera[2], camera[3]
    top = begin * TILE - _PAD  # image row of the first row of the buffers
    rows = min(height, end * TILE) + _PAD - top
    inverse = np.zeros((rows, width + 2 * _PAD), np.float32)
    level = np.zeros((rows, width), np.float32)
    tilt = np.zeros((rows, width), np.float32)
    weight = np.zeros((rows, width), np.float32)
    link = np.zeros((rows, width), np.float32)
    row_link = np.zeros(width + 2 * _PAD, np.float32)
    for i in range(rows):
        v = top + i
        if 0 <= v < height:
            for u in range(width):
                d = depth[v, u]
                inverse[i, u + _PAD] = _ONE / d if d > _ZERO else _ZERO
            _fit_rows(inverse[i], step, camera[4] / fx, row_link, level[i], tilt[i], weight[i])
    for i in range(1, rows - 2):
        for u in range(width):
            link[i, u] = _link(level[i - 1, u], level[i, u], level[i + 1, u], level[i + 2, u], step, camera[4] / fy)
    out = np.empty((4, width), np.float32)
    near = np.empty(width, np.float32)
    far = np.empty(width, np.float32)
    for t in range(begin, end):
        near[:] = _ZERO
        far[:] = _FAR
        for v in range(t * TILE, min(height, t * TILE + TILE)):
            i = v - top
            _fit_columns(
                i, level, tilt, weight, link, inverse[i, _PAD : _PAD + width], fx, fy, cx, np.float32(v) - cy, out, near, far
            )
            row = planes[v * width : (v + 1) * width]
            for u in range(width):
                row[u, 0] = out[0, u]
                row[u, 1] = out[1, u]
                row[u, 2] = out[2, u]
                row[u, 3] = out[3, u]
        for s in range(near_w.shape[1]):
            stop = min(width, s * TILE + TILE)
            near_w[t, s] = near[s * TILE : stop].max()
            far_w[t, s] = far[s * TILE : stop].min()
