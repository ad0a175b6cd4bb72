"""Compiled inner loops of `HeightScene`: slopes of a height map, the bricks (blocks of 8x8x8 samples) that
have a force, and the forces in them.

A column of samples shares one point of the map: the map is evaluated once for each column, and the voxels
with a force form an interval of it. No voxel is visited twice, and bricks above the surface are not visited
at all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int32s
from touchfield.compute.jit import inner, kernel
from touchfield.compute.threads import for_chunks
from touchfield.medium.budget import zero_forces
from touchfield.medium.grid import Grid

if TYPE_CHECKING:
    from touchfield.sources.laws import ForceProfile
    from touchfield.sources.terrain.height_scene import HeightLattice


_WEIGHTS = np.array([1.0, 4.0, 6.0, 4.0, 1.0])
_RADIUS = 2


@inner(error_model="numpy", forceinline=True)
def _fit(heights, r, c, step):
    """Fit a plane to the known neighbours by weighted least squares: slopes along columns and rows."""
    rows, cols = heights.shape
    centre = heights[r, c]
    s = sx = sy = sh = sxx = sxy = syy = sxh = syh = 0.0
    for dr in range(-_RADIUS, _RADIUS + 1):
        for dc in range(-_RADIUS, _RADIUS + 1):
            if 0 <= r + dr < rows and 0 <= c + dc < cols:
                h = heights[r + dr, c + dc] - centre
                if abs(h) <= step:  # false for NaN, too
                    w = _WEIGHTS[dr + _RADIUS] * _WEIGHTS[dc + _RADIUS]
                    s += w
                    sx += w * dc
                    sy += w * dr
                    sh += w * h
                    sxx += w * dc * dc
                    sxy += w * dc * dr
                    syy += w * dr * dr
                    sxh += w * dc * h
                    syh += w * dr * h
    cxx, cxy, cyy = sxx - sx * sx / s, sxy - sx * sy / s, syy - sy * sy / s
    cxh, cyh = sxh - sx * sh / s, syh - sy * sh / s
    det = cxx * cyy - cxy * cxy
    trace = cxx + cyy
    if det > 1e-9 * trace * trace:
        return (cyy * cxh - cxy * cyh) / det, (cxx * cyh - cxy * cxh) / det
    if trace > 1e-9:  # neighbours on one line: the slope along it
        return (cxx * cxh + cxy * cyh) / trace**2, (cxy * cxh + cyy * cyh) / trace**2
    return 0.0, 0.0


@kernel(error_model="numpy")
def _gradients(start, stop, heights, step, per_col, per_row, out):
    for r in range(start, stop):
        for c in range(heights.shape[1]):
            if not np.isfinite(heights[r, c]):
                out[r, c, 0] = 0.0
                out[r, c, 1] = 0.0
                continue
            gx, gy = _fit(heights, r, c, step)
            out[r, c, 0] = gx * per_col
            out[r, c, 1] = gy * per_row


def gradients(heights_m: Float64s, step_m: float, dx_m: float, dy_m: float) -> Float32s:
    """Fit planes to the 5 x 5 neighbours of each sample: slopes dh/dx and dh/dy, float32 [rows, cols, 2].

    Neighbours have binomial weights; unknown ones (NaN), and those that differ from the sample by more than
    `step_m` in height, are excluded. `dx_m` and `dy_m` are signed: from one column, or row, to the next.
    """
    out = np.empty((*heights_m.shape, 2), np.float32)
    for_chunks(_gradients, len(heights_m), heights_m, step_m, 1 / dx_m, 1 / dy_m, out, chunk=16)
    return out


@inner(error_model="numpy", forceinline=True)
def amplitude(phi, table):
    """Evaluate f(phi), newtons, of a force profile whose pieces are the rows of `table`."""
    for p in range(table.shape[0]):
        if table[p, 0] < phi <= table[p, 1]:
            return table[p, 2] + table[p, 3] * phi
    return 0.0


@inner(error_model="numpy", forceinline=True)
def _surface(x, y, lattice, step, heights, slopes):
    """Return whether the surface is known at (x, y), and its height and slopes there."""
    rows, cols = heights.shape
    u, v = (x - lattice[0]) / lattice[1], (y - lattice[2]) / lattice[3]
    slack = 1e-6  # of a cell, for rounding at the rim
    if not (-slack <= u <= cols - 1 + slack and -slack <= v <= rows - 1 + slack):
        return False, 0.0, 0.0, 0.0
    c, r = min(max(int(u), 0), cols - 2), min(max(int(v), 0), rows - 2)
    fu, fv = min(max(u - c, 0.0), 1.0), min(max(v - r, 0.0), 1.0)
    h = gx = gy = 0.0
    low, high = np.inf, -np.inf
    for a in range(2):
        for b in range(2):
            w = (fv if a else 1.0 - fv) * (fu if b else 1.0 - fu)
            if w > 0.0:
                corner = heights[r + a, c + b]
                if not np.isfinite(corner):
                    return False, 0.0, 0.0, 0.0
                low, high = min(low, corner), max(high, corner)
                h += w * corner
                gx += w * slopes[r + a, c + b, 0]
                gy += w * slopes[r + a, c + b, 1]
    if high - low > step:  # across a step, use the plane of the nearest sample
        a, b = 1 if fv > 0.5 else 0, 1 if fu > 0.5 else 0
        gx, gy = slopes[r + a, c + b, 0] * 1.0, slopes[r + a, c + b, 1] * 1.0
        h = heights[r + a, c + b] + gx * (fu - b) * lattice[1] + gy * (fv - a) * lattice[3]
    return True, h, gx, gy


@kernel(error_model="numpy")
def _flag(start, stop, shape, origin, spacing, lattice, facing, step, heights, slopes, table, flags):
    """Flag the bricks with a force in the columns of bricks start..stop."""
    low, high = table[0, 0], table[-1, 1]
    for column in range(start, stop):
        bi, bj = column // flags.shape[1], column % flags.shape[1]
        for i in range(bi * 8, min(bi * 8 + 8, shape[0])):
            for j in range(bj * 8, min(bj * 8 + 8, shape[1])):
                x, y = origin[0] + i * spacing[0], origin[1] + j * spacing[1]
                is_known, h, gx, gy = _surface(x, y, lattice, step, heights, slopes)
                if not is_known:
                    continue
                nz = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
                a = (h + facing * low / nz - origin[2]) / spacing[2]
                b = (h + facing * high / nz - origin[2]) / spacing[2]
                k = int(min(max(np.floor(min(a, b)), 0.0), shape[2]))
                last = int(min(max(np.ceil(max(a, b)), -1.0), shape[2] - 1.0))
                while k <= last:
                    if flags[bi, bj, k >> 3] == 0:
                        phi = facing * (origin[2] + k * spacing[2] - h) * nz
                        if np.float32(amplitude(phi, table) * nz) == np.float32(0.0):
                            k += 1
                            continue
                        flags[bi, bj, k >> 3] = 1
                    k = ((k >> 3) + 1) * 8


@kernel(error_model="numpy")
def _fill(
    start, stop, starts, bricks, shape, origin, spacing, lattice, facing, step, heights, slopes, table, out
):
    """Fill the bricks of columns start..stop; `out` is initially zero.

    Column c has bricks starts[c] to starts[c + 1] - 1.
    """
    for column in range(start, stop):
        first, last = starts[column], starts[column + 1]
        if first == last:
            continue
        for i in range(8):
            for j in range(8):
                gi, gj = bricks[first, 0] * 8 + i, bricks[first, 1] * 8 + j
                is_known, h, gx, gy = False, 0.0, 0.0, 0.0
                if gi < shape[0] and gj < shape[1]:
                    x, y = origin[0] + gi * spacing[0], origin[1] + gj * spacing[1]
                    is_known, h, gx, gy = _surface(x, y, lattice, step, heights, slopes)
                if not is_known:
                    continue
                nz = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
                nx, ny = -gx * nz, -gy * nz
                for s in range(first, last):
                    for k in range(8):
                        gk = bricks[s, 2] * 8 + k
                        f = 0.0
                        if gk < shape[2]:
                            f = facing * amplitude(facing * (origin[2] + gk * spacing[2] - h) * nz, table)
                        out[s, i, j, k, 0] = f * nx
                        out[s, i, j, k, 1] = f * ny
                        out[s, i, j, k, 2] = f * nz


def bricks_and_forces(
    heights_m: Float64s, slopes: Float32s, at: HeightLattice, grid: Grid, profile: ForceProfile
) -> tuple[Int32s, Float32s]:
    """Return the bricks with a force, int32 [n, 3] ascending, and the forces, float32 [n, 8, 8, 8, 3].

    `heights_m` float64 [rows, cols], NaN where unknown; `slopes` float32 [rows, cols, 2], dh/dx and dh/dy.
    """
    # tuples, because references to arrays are counted at each call of an inner function
    common = (
        tuple(map(int, grid.shape)),
        tuple(map(float, grid.origin_m)),
        tuple(map(float, grid.spacing_m)),
        (float(at.x0_m), float(at.dx_m), float(at.y0_m), float(at.dy_m)),
        float(at.facing),
        at.step_m,
        heights_m,
        slopes,
        profile.table(),
    )
    flags = np.zeros(grid.brick_shape, np.uint8)
    columns = flags.shape[0] * flags.shape[1]
    for_chunks(_flag, columns, *common, flags, chunk=16)
    bricks = np.argwhere(flags).astype(np.int32, order="C")
    starts = np.zeros(columns + 1, np.int64)
    np.cumsum(flags.reshape(columns, -1).sum(axis=1), out=starts[1:])
    out = zero_forces(len(bricks))
    for_chunks(_fill, columns, starts, bricks, *common, out, chunk=16)
    return bricks, out
