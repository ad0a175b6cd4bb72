"""Compiled inner loops of `CloudScene`: the surface near the points, and the forces of samples.

Source: F. Ryden and H. J. Chizeck, A proxy method for real-time 3-DOF haptic rendering of streaming point
cloud data, IEEE Transactions on Haptics 6(3), 2013: the surface is where a weighted mean of the planes of the
points near it vanishes. Here the weights are those of the foot of the sample on the surface, not of the
sample, so that the distance is also one deep behind the surface. The height of a neighbour's plane is taken
along the mean of its normal and the common one, which is exact to second order on a curved surface.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.compute.jit import inner, kernel
from touchfield.sources.clouds.kernels.cells import Cells, Table, key_of, row_of
from touchfield.sources.terrain.kernels import amplitude as amplitude_at

KERNEL_RADIUS = 2.0
"""Radius of the weights, in cells."""
_FULL_GAP, _MAX_GAP = 1.25, 2.0
"""Distance of the foot from the nearest point, in cells: up to it a force is whole; from it, it is 0."""
_ALIKE = 0.2  # least cosine between normals of one surface


class Surfels(NamedTuple):
    """Discs of a surface: the mean of the points of each row of cells."""

    positions_m: Float64s  # float64 [n, 3]
    normals: Float64s  # float64 [n, 3], unit
    weights: Float64s  # float64 [n]; number of points
    cells: Cells
    table: Table
    origin_m: Float64s  # float64 [3]; low corner of cell 0, 0, 0
    edge_m: float


@inner
def _mean_plane(surfels, x, y, z, normal):
    """Return height and unit normal of the surface at a point, and the distance to its nearest disc in edges.

    The height is along the normal, negative behind. The distance is infinite if no disc is near.
    """
    edge, origin, positions, normals = surfels.edge_m, surfels.origin_m, surfels.positions_m, surfels.normals
    i, j, k = (
        math.floor((x - origin[0]) / edge),
        math.floor((y - origin[1]) / edge),
        math.floor((z - origin[2]) / edge),
    )
    total = px = py = pz = sx = sy = sz = own = 0.0
    nearest = np.inf
    radius2 = (KERNEL_RADIUS * edge) ** 2
    u, v, w = (x - origin[0]) / edge - i, (y - origin[1]) / edge - j, (z - origin[2]) / edge - k
    for oi in range(-2, 3):
        bi = max(0.0, oi - u, u - oi - 1.0)
        for oj in range(-2, 3):
            bj = max(0.0, oj - v, v - oj - 1.0)
            for ok in range(-2, 3):
                bk = max(0.0, ok - w, w - ok - 1.0)
                if bi * bi + bj * bj + bk * bk >= KERNEL_RADIUS**2:
                    continue  # the whole cell lies beyond the radius
                row = row_of(surfels.table, key_of(i + oi, j + oj, k + ok))
                while row >= 0:
                    nx, ny, nz = normals[row, 0], normals[row, 1], normals[row, 2]
                    if nx * normal[0] + ny * normal[1] + nz * normal[2] > _ALIKE:
                        dx, dy, dz = x - positions[row, 0], y - positions[row, 1], z - positions[row, 2]
                        square = dx * dx + dy * dy + dz * dz
                        height = dx * nx + dy * ny + dz * nz
                        nearest = min(nearest, square - height * height)
                        weight = 1.0 - square / radius2
                        if weight > 0.0:
                            weight *= weight * surfels.weights[row]
                            total += weight
                            px, py, pz = px + weight * dx, py + weight * dy, pz + weight * dz
                            sx, sy, sz = sx + weight * nx, sy + weight * ny, sz + weight * nz
                            own += weight * height
                    row = surfels.cells.following[row]
    size = math.sqrt(sx * sx + sy * sy + sz * sz)
    if size <= 1e-9 * total or total == 0.0:
        return 0.0, normal, np.inf
    sx, sy, sz = sx / size, sy / size, sz / size
    height = 0.5 * (own + px * sx + py * sy + pz * sz) / total
    return height, (sx, sy, sz), math.sqrt(max(nearest, 0.0)) / edge


@inner
def _distance(surfels, x, y, z, row, low, high):
    """Return signed distance, normal and gap of a sample, given its nearest disc.

    The gap is infinite, too, if the distance is clearly not between `low` and `high`.
    """
    normal = surfels.normals[row, 0], surfels.normals[row, 1], surfels.normals[row, 2]
    dx, dy, dz = (
        x - surfels.positions_m[row, 0],
        y - surfels.positions_m[row, 1],
        z - surfels.positions_m[row, 2],
    )
    phi = dx * normal[0] + dy * normal[1] + dz * normal[2]
    gap, margin = 0.0, surfels.edge_m
    for _ in range(2):
        if phi < low - margin or phi > high + margin:
            return phi, normal, np.inf
        margin = 0.25 * surfels.edge_m
        fx, fy, fz = x - phi * normal[0], y - phi * normal[1], z - phi * normal[2]
        height, normal, gap = _mean_plane(surfels, fx, fy, fz, normal)
        if gap == np.inf:
            break
        phi = (x - fx) * normal[0] + (y - fy) * normal[1] + (z - fz) * normal[2] + height
    return phi, normal, gap


@kernel
def distances(start, stop, points, rows, surfels, phis, normals, gaps):
    """Write signed distances, normals, and gaps in edges of points start..stop; rows -1 are left out."""
    for p in range(start, stop):
        gaps[p] = np.inf
        if rows[p] >= 0:
            phis[p], normal, gaps[p] = _distance(
                surfels, points[p, 0], points[p, 1], points[p, 2], rows[p], -np.inf, np.inf
            )
            normals[p, 0], normals[p, 1], normals[p, 2] = normal


@kernel
def cloud_forces(start, stop, points, rows, surfels, half_wall_m, pieces, forces):
    """Write the forces of points start..stop; `half_wall_m` is 0 for a wall behind the surface.

    A two-sided wall reaches to `half_wall_m` on either side.
    """
    high = pieces[-1, 1] + half_wall_m
    low = -high if half_wall_m > 0.0 else pieces[0, 0]
    for p in range(start, stop):
        if rows[p] < 0:
            continue
        phi, normal, gap = _distance(surfels, points[p, 0], points[p, 1], points[p, 2], rows[p], low, high)
        if not gap < _MAX_GAP:
            continue
        sign = 1.0
        if half_wall_m > 0.0:
            sign = -1.0 if phi < 0.0 else 1.0
            phi = abs(phi) - half_wall_m
        amplitude = amplitude_at(phi, pieces) * sign * min(1.0, (_MAX_GAP - gap) / (_MAX_GAP - _FULL_GAP))
        for c in range(3):
            forces[p, c] = amplitude * normal[c]
