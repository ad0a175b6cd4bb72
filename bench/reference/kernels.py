"""Loops that never change, whose time is the reference of the regression guard `bench_guard`.

`bench_guard` stores the time of each kernel of the package relative to a frozen loop. Each loop does the same
kind of work as one kernel (memory access, arithmetic, branches), so that another processor, another load or
another compiler changes both times alike. The loops import nothing of the package and are compiled by plain
numba. Never change them, because the stored ratios would lose their meaning. For another kind of work, add a
new loop and store its ratio.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numba import njit

frozen: Any = partial(njit, cache=True, nogil=True)


@frozen(fastmath=True, error_model="numpy")
def image_planes(depth, out):
    """Fit slopes and normals [h, w, 4] to a depth image [h, w]: for tangent planes.

    The fits are weighted, over a cross of 9 x 9 pixels.
    """
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
    """Look up a plane of an image [h, w, 4] at each sample of a dense lattice.

    For depth bricks; the lattice is [n, n, n, 3].
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
    """Compute squared distances of points [n, 3] to triangles [m, 3, 3]: for meshes.

    The distance is that to the nearest triangle.
    """
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
    """Filter vectors [n, n, n, 3] by 17 taps along two axes: for Gaussian smoothing.

    Borders are left out.
    """
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
    """Interpolate a dense field [n, n, n, 3] at points [m, 3]: for queries.

    Points are in samples.
    """
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
    """Code bits by an adaptive binary range coder that mixes three models: for coders.

    Symbols are uint8 [n, n, n] in raster order; contexts are neighbours. The models are mixed by their
    logits. `squash` [4096] and `stretch` [4096] are tables. Returns the number of bytes.
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
