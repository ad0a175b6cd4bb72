"""Compiled inner loops that fit a plane to the points around each cell of a cloud.

Source of the fit: H. Hoppe et al., Surface reconstruction from unorganized points, 1992: the normal is the
eigenvector of the smallest eigenvalue of the covariance of the neighbours. Here the covariance is the sum of
the moments of the 5 x 5 x 5 cells around a cell, weighted by distance.
"""

from __future__ import annotations

import math

from touchfield.compute.jit import inner, kernel
from touchfield.sources.clouds.kernels.cells import cell_of, key_of, row_of

REACH = 2
"""Cells on each side of a cell whose points count as its neighbours."""
_RADIUS = 2.5  # of the neighbours, in cells
_TINY = 1e-12


@inner
def _smallest(a, b, c, d, e, f):
    """Return the ascending eigenvalues of [[a b c] [b d e] [c e f]], and the vector of the smallest one."""
    mean = (a + d + f) / 3.0
    a, d, f = a - mean, d - mean, f - mean
    p = math.sqrt((a * a + d * d + f * f + 2.0 * (b * b + c * c + e * e)) / 6.0)
    if p <= _TINY:
        return mean, mean, mean, 0.0, 0.0, 1.0
    det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)
    angle = math.acos(min(1.0, max(-1.0, det / (2.0 * p * p * p)))) / 3.0
    high, low = 2.0 * p * math.cos(angle), 2.0 * p * math.cos(angle + 2.0 * math.pi / 3.0)
    # the rows of A - low I span the plane of the other two vectors
    a, d, f = a - low, d - low, f - low
    x0, y0, z0 = b * e - c * d, b * c - a * e, a * d - b * b  # row 0 x row 1
    x1, y1, z1 = b * f - c * e, c * c - a * f, a * e - b * c  # row 0 x row 2
    x2, y2, z2 = d * f - e * e, c * e - b * f, b * e - c * d  # row 1 x row 2
    s0, s1, s2 = x0 * x0 + y0 * y0 + z0 * z0, x1 * x1 + y1 * y1 + z1 * z1, x2 * x2 + y2 * y2 + z2 * z2
    if s1 > s0:
        x0, y0, z0, s0 = x1, y1, z1, s1
    if s2 > s0:
        x0, y0, z0, s0 = x2, y2, z2, s2
    middle = -low - high
    if s0 <= _TINY * p**4:  # points on a line: any direction across it
        x0, y0, z0, s0 = 0.0, 0.0, 1.0, 1.0
    size = math.sqrt(s0)
    return mean + low, mean + middle, mean + high, x0 / size, y0 / size, z0 / size


@kernel
def fit_planes(start, stop, cells, table, normals, spreads, occupied):
    """Fit planes to rows start..stop: unit normals [n, 3], eigenvalues [n, 3] in edges^2, cells in reach [n].

    A normal points to the side of the row's directions, if it has any.
    """
    moments = cells.moments
    for row in range(start, stop):
        i, j, k = cell_of(cells.keys[row])
        own = moments[row]
        x, y, z = own[1] / own[0], own[2] / own[0], own[3] / own[0]
        dx, dy, dz = own[10], own[11], own[12]
        n = sx = sy = sz = sxx = sxy = sxz = syy = syz = szz = 0.0
        count = 0
        for oi in range(-REACH, REACH + 1):
            for oj in range(-REACH, REACH + 1):
                for ok in range(-REACH, REACH + 1):
                    other = row_of(table, key_of(i + oi, j + oj, k + ok))
                    count += other >= 0
                    while other >= 0:
                        m = moments[other]
                        if dx * m[10] + dy * m[11] + dz * m[12] >= 0.0:
                            c = m[0]
                            u, v, w = m[1] / c + oi - x, m[2] / c + oj - y, m[3] / c + ok - z
                            weight = 1.0 - (u * u + v * v + w * w) / _RADIUS**2
                            if weight > 0.0:
                                weight *= weight
                                c *= weight
                                # relative to the row's mean
                                p, q, r = oi - x, oj - y, ok - z
                                mx, my, mz = weight * m[1], weight * m[2], weight * m[3]
                                n += c
                                sx += mx + c * p
                                sy += my + c * q
                                sz += mz + c * r
                                sxx += weight * m[4] + 2.0 * p * mx + c * p * p
                                sxy += weight * m[5] + p * my + q * mx + c * p * q
                                sxz += weight * m[6] + p * mz + r * mx + c * p * r
                                syy += weight * m[7] + 2.0 * q * my + c * q * q
                                syz += weight * m[8] + q * mz + r * my + c * q * r
                                szz += weight * m[9] + 2.0 * r * mz + c * r * r
                        other = cells.following[other]
        sx, sy, sz = sx / n, sy / n, sz / n
        low, middle, high, nx, ny, nz = _smallest(
            sxx / n - sx * sx,
            sxy / n - sx * sy,
            sxz / n - sx * sz,
            syy / n - sy * sy,
            syz / n - sy * sz,
            szz / n - sz * sz,
        )
        sign = -1.0 if nx * dx + ny * dy + nz * dz < 0.0 else 1.0
        normals[row, 0], normals[row, 1], normals[row, 2] = sign * nx, sign * ny, sign * nz
        spreads[row, 0], spreads[row, 1], spreads[row, 2] = max(low, 0.0), max(middle, 0.0), max(high, 0.0)
        occupied[row] = count
