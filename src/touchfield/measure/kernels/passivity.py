"""Compiled loop over bricks: curl at the lattice points, and the work around the squares of the lattice.

A brick is looked at with one sample around it. Imported only when first needed, because it imports numba.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.arrays import Float32s, Float64s, Int32s
from touchfield.medium.grid import Grid
from touchfield.parallel import for_chunks

COLUMNS = ("points", "held", "curl2", "gradient2", "squares", "work2", "curl2_max", "work_max")
"""Sums of each brick: samples with a curl, those among them with a force, |curl|^2, |gradient|^2; squares,
W^2; the largest |curl|^2 and |W|. The first six are sums."""


@njit(cache=True, nogil=True)
def _fill(slots, low, shape, forces, halo, held, within):
    """The 10^3 samples of a brick and around it: forces, whether there is one, whether the grid reaches there."""
    for a in range(10):
        da, la = (a + 7) >> 3, (a + 7) & 7
        for b in range(10):
            db, lb = (b + 7) >> 3, (b + 7) & 7
            for c in range(10):
                p = a * 100 + b * 10 + c
                x, y, z = low[0] + a - 1, low[1] + b - 1, low[2] + c - 1
                within[p] = 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= z < shape[2]
                slot = slots[da * 9 + db * 3 + ((c + 7) >> 3)]
                held[p] = False
                for d in range(3):
                    f = np.float64(0.0)
                    if slot >= 0:
                        f = np.float64(forces[slot, la, lb, (c + 7) & 7, d])
                    halo[p, d] = f
                    if f != 0.0:
                        held[p] = True


@njit(cache=True, nogil=True)
def _curl_and_loops(begin, end, slots, lows, shape, spacing, forces, edges, sums, curls):
    halo, held, within = np.empty((1000, 3)), np.empty(1000, np.bool_), np.empty(1000, np.bool_)
    jacobian, curl = np.empty((3, 3)), np.empty(3)
    step = (100, 10, 1)
    half = (0.5 / spacing[0], 0.5 / spacing[1], 0.5 / spacing[2])
    for n in range(begin, end):
        _fill(slots[n], lows[n], shape, forces, halo, held, within)
        for s in range(512):
            p = (s // 64 + 1) * 100 + (s // 8 % 8 + 1) * 10 + s % 8 + 1
            some, every, inside = held[p], held[p], within[p]
            for d in range(3):
                for q in (p + step[d], p - step[d]):
                    some, every, inside = some or held[q], every and held[q], inside and within[q]
            if every or (edges and some and inside):
                square = 0.0
                for d in range(3):
                    for e in range(3):
                        jacobian[e, d] = (halo[p + step[d], e] - halo[p - step[d], e]) * half[d]
                        square += jacobian[e, d] ** 2
                curl2 = 0.0
                for d in range(3):
                    e, f = (d + 1) % 3, (d + 2) % 3
                    curl[d] = jacobian[f, e] - jacobian[e, f]
                    curl2 += curl[d] ** 2
                sums[n, 0] += 1
                sums[n, 1] += held[p]
                sums[n, 2] += curl2
                sums[n, 3] += square
                sums[n, 6] = max(sums[n, 6], curl2)
                if n < curls.shape[0]:
                    for d in range(3):
                        curls[n, s, d] = curl[d]
            for d in range(3):  # the square from p along axes d and e
                e = (d + 1) % 3
                u, v, w = p + step[d], p + step[d] + step[e], p + step[e]
                every = held[p] and held[u] and held[v] and held[w]
                some = held[p] or held[u] or held[v] or held[w]
                if every or (edges and some and within[p] and within[v]):
                    work = 0.5 * spacing[d] * (halo[p, d] + halo[u, d] - halo[w, d] - halo[v, d])
                    work += 0.5 * spacing[e] * (halo[u, e] + halo[v, e] - halo[p, e] - halo[w, e])
                    sums[n, 4] += 1
                    sums[n, 5] += work * work
                    sums[n, 7] = max(sums[n, 7], abs(work))


def curl_and_loops(
    grid: Grid,
    bricks: Int32s,
    slots: Int32s,
    forces_n: Float32s,
    edges: bool,
    curls_n_per_m: Float32s,
) -> Float64s:
    """The `COLUMNS` for each brick, float64 [m, 8]; SI units.

    `bricks` int32 [m, 3]; `slots` int32 [m, 27], where in `forces_n` each neighbour lies, -1 for none. The curls are
    written to `curls_n_per_m`, float32 [m, 512, 3], unless it is empty; samples without one are left as they are.
    """
    sums = np.zeros((len(bricks), len(COLUMNS)))
    lows, shape = bricks.astype(np.int64) * 8, np.array(grid.shape, np.int64)
    spacing = np.array(grid.spacing_m)
    for_chunks(
        _curl_and_loops, len(bricks), slots, lows, shape, spacing, forces_n, edges, sums, curls_n_per_m, chunk=32
    )
    return sums
