"""Frozen loops that serve as yardsticks: the time of a kernel of ours over theirs is stored and guarded.

Each does the kind of work of one kernel of ours (the memory it reads, its arithmetic, its branches), so
that another processor, another load or another compiler changes both times alike. They import nothing of the
package and are compiled by plain numba. Never change them: the stored ratios would mean nothing. Of another
kind of work a new loop is added, and its ratio stored.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit

frozen: Any = partial(njit, cache=True, nogil=True)


@frozen(fastmath=True, error_model="numpy")
def image_planes(depth, out):
    """Weighted 9 x 9 fits of a depth image [h, w] to slopes and normals [h, w, 4]: for tangent planes."""
    height, width = depth.shape
    for y in range(4, height - 4):
        for x in range(4, width - 4):
            middle = depth[y, x]
            along, across, weight = np.float32(0), np.float32(0), np.float32(1e-6)
            for n in range(1, 5):
                right, left = depth[y, x + n] - middle, middle - depth[y, x - n]
                lower, upper = depth[y + n, x] - middle, middle - depth[y - n, x]
                share = np.float32(1) / (np.float32(1) + abs(right - left) + abs(lower - upper))
                along += share * (right + left) * np.float32(n)
                across += share * (lower + upper) * np.float32(n)
                weight += share * np.float32(n * n)
            a, b = along / weight, across / weight
            scale = np.float32(1) / np.sqrt(a * a + b * b + np.float32(1))
            out[y, x, 0], out[y, x, 1], out[y, x, 2], out[y, x, 3] = (
                a * scale,
                b * scale,
                scale,
                middle * scale,
            )


@frozen(fastmath=True, error_model="numpy")
def projected_forces(planes, out):
    """A dense lattice [n, n, n, 3] that looks up a plane of an image [h, w, 4] at each sample: for depth
    bricks.
    """
    height, width = planes.shape[:2]
    side = out.shape[0]
    for i in range(side):
        x = np.float32(2 * i / side - 1)
        for j in range(side):
            y = np.float32(2 * j / side - 1)
            for k in range(side):
                z = np.float32(0.6 + 2 * k / side)
                u, v = int(x / z * 525 + width / 2), int(y / z * 525 + height / 2)
                force = np.float32(0)
                a = b = c = np.float32(0)
                if 0 <= u < width and 0 <= v < height:
                    a, b, c = planes[v, u, 0], planes[v, u, 1], planes[v, u, 2]
                    phi = a * x + b * y + c * z - planes[v, u, 3]
                    if phi <= 0:
                        force = min(np.float32(3.3), np.float32(-50) * phi)
                out[i, j, k, 0], out[i, j, k, 1], out[i, j, k, 2] = force * a, force * b, force * c


@frozen()
def triangle_distances(points, corners, out):
    """Squared distances of points [n, 3] to the nearest of triangles [m, 3, 3]: for meshes."""
    for p in range(points.shape[0]):
        nearest = 1e30
        for t in range(corners.shape[0]):
            ax, ay, az = corners[t, 0]
            ux, uy, uz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
            vx, vy, vz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
            wx, wy, wz = points[p, 0] - ax, points[p, 1] - ay, points[p, 2] - az
            uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
            wu, wv = wx * ux + wy * uy + wz * uz, wx * vx + wy * vy + wz * vz
            whole = uu * vv - uv * uv
            s, r = vv * wu - uv * wv, uu * wv - uv * wu
            if s < 0:
                s, r = 0.0, min(max(wv / vv, 0.0), 1.0) * whole
            elif r < 0:
                s, r = min(max(wu / uu, 0.0), 1.0) * whole, 0.0
            elif s + r > whole:
                s = min(max((vv + wu - uv - wv) / (uu - 2 * uv + vv), 0.0), 1.0) * whole
                r = whole - s
            s, r = s / whole, r / whole
            dx, dy, dz = wx - s * ux - r * vx, wy - s * uy - r * vy, wz - s * uz - r * vz
            nearest = min(nearest, dx * dx + dy * dy + dz * dz)
        out[p] = nearest


@frozen(fastmath=True)
def smoothed(field, taps, between, out):
    """17 taps along two axes of vectors [n, n, n, 3], without borders: for Gaussian smoothing."""
    side, reach = field.shape[0], taps.shape[0] // 2
    flat = field.reshape(side, side, -1)
    for i in range(side):
        for j in range(reach, side - reach):
            row = between[i, j]
            row[:] = 0
            for n in range(taps.shape[0]):
                source = flat[i, j + n - reach]
                for k in range(row.shape[0]):
                    row[k] += taps[n] * source[k]
    for i in range(reach, side - reach):
        for j in range(side):
            row = out[i, j]
            row[:] = 0
            for n in range(taps.shape[0]):
                source = between[i + n - reach, j]
                for k in range(row.shape[0]):
                    row[k] += taps[n] * source[k]


@frozen(error_model="numpy")
def interpolated(field, points, out):
    """A dense field [n, n, n, 3] between its samples at points [m, 3], in samples: for queries."""
    last = field.shape[0] - 2
    for p in range(points.shape[0]):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        i, j, k = min(int(x), last), min(int(y), last), min(int(z), last)
        u, v, w = x - i, y - j, z - k
        for c in range(3):
            near = (field[i, j, k, c] * (1 - w) + field[i, j, k + 1, c] * w) * (1 - v)
            near += (field[i, j + 1, k, c] * (1 - w) + field[i, j + 1, k + 1, c] * w) * v
            far = (field[i + 1, j, k, c] * (1 - w) + field[i + 1, j, k + 1, c] * w) * (1 - v)
            far += (field[i + 1, j + 1, k, c] * (1 - w) + field[i + 1, j + 1, k + 1, c] * w) * v
            out[p, c] = near * (1 - u) + far * u


@frozen(error_model="numpy")
def coded_bits(symbols, squash, stretch, out):
    """Bytes of an adaptive binary range coder that mixes three models by their logits: for the coder.

    Symbols uint8 [n, n, n] in raster order; contexts are neighbours. `squash` [4096] and `stretch` [4096] are
    tables.
    """
    side = symbols.shape[0]
    models = np.full((3, 1 << 14), 2048, np.int32)
    weights = np.full((256, 3), 22000, np.int32)
    low, high, count = np.uint32(0), np.uint32(0xFFFFFFFF), 0
    for i in range(1, side):
        for j in range(1, side):
            for k in range(1, side):
                a, b, c = symbols[i - 1, j, k], symbols[i, j - 1, k], symbols[i, j, k - 1]
                prefix = 1
                for n in range(7, -1, -1):
                    bit = (symbols[i, j, k] >> n) & 1
                    at0 = (prefix | (int(a) & 31) << 8) & 16383
                    at1 = (prefix | (int(b) & 31) << 8) & 16383
                    at2 = (prefix | (int(c) + int(a)) << 8) & 16383
                    s0, s1, s2 = stretch[models[0, at0]], stretch[models[1, at1]], stretch[models[2, at2]]
                    w = weights[prefix]
                    dot = (w[0] * s0 + w[1] * s1 + w[2] * s2) >> 16
                    p = squash[min(max(dot + 2048, 0), 4095)]
                    middle = low + np.uint32((np.uint64(high - low) * np.uint64(p)) >> np.uint64(12))
                    if bit:
                        high = middle
                    else:
                        low = middle + np.uint32(1)
                    error = ((bit << 12) - p) * 7
                    w[0] += (s0 * error + 8192) >> 14
                    w[1] += (s1 * error + 8192) >> 14
                    w[2] += (s2 * error + 8192) >> 14
                    models[0, at0] += ((bit << 12) - models[0, at0]) >> 5
                    models[1, at1] += ((bit << 12) - models[1, at1]) >> 5
                    models[2, at2] += ((bit << 12) - models[2, at2]) >> 5
                    prefix = (prefix << 1 | bit) & 255
                    while (low ^ high) & np.uint32(0xFF000000) == 0:
                        out[count & 65535] = high >> np.uint32(24)
                        count += 1
                        low, high = low << np.uint32(8), high << np.uint32(8) | np.uint32(255)
    return count
