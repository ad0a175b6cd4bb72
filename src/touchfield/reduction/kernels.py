"""Compiled: whether a field stops a hand within a cell of a lattice (`touchfield.reduction.reach` has the
proof).
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import inner, kernel

_MAX_CANDIDATES = 1024  # nearest places of one cell; a cell with more is taken as weak


@inner
def _nearest_nodes(edge, cell, step_m, reach_m, found, count):
    """Nodes within a distance of the cell's centre, metres from it, into `found` behind `count`; how many
    then.

    Only those to which no other one is nearer from everywhere in the cell; -1: too many.
    """
    first, low, high = count, np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):
        reach = reach_m / step_m[axis]
        low[axis] = max(0, math.ceil(cell[axis] + 0.5 - reach))
        high[axis] = min(edge.shape[axis] - 1, math.floor(cell[axis] + 0.5 + reach))
    for i in range(low[0], high[0] + 1):
        x = (i - cell[0] - 0.5) * step_m[0]
        for j in range(low[1], high[1] + 1):
            y = (j - cell[1] - 0.5) * step_m[1]
            for k in range(low[2], high[2] + 1):
                z = (k - cell[2] - 0.5) * step_m[2]
                if edge[i, j, k] and x * x + y * y + z * z <= reach_m * reach_m:
                    if count == len(found):
                        return -1
                    found[count, 0], found[count, 1], found[count, 2] = x, y, z
                    count += 1
    nearest_end = first
    for a in range(first, count):  # the nearest of those that are left, so that it can beat the others
        nearest, at = math.inf, a
        for b in range(a, count):
            square = found[b, 0] ** 2 + found[b, 1] ** 2 + found[b, 2] ** 2
            if square < nearest:
                nearest, at = square, b
        for axis in range(3):
            found[a, axis], found[at, axis] = found[at, axis], found[a, axis]
        is_beaten = False
        for b in range(first, nearest_end):
            max_shift, other = 0.0, 0.0
            for axis in range(3):
                max_shift += abs(found[a, axis] - found[b, axis]) * step_m[axis]
                other += found[b, axis] ** 2
            if max_shift <= nearest - other:
                is_beaten = True
                break
        if not is_beaten:
            for axis in range(3):
                found[nearest_end, axis] = found[a, axis]
            nearest_end += 1
    return nearest_end


@inner
def _interpolation_loss(block, step_m, friction):
    """By how much, N m, the force between samples may hold less than theirs tell; float [2, 2, 2, 3]."""
    total = 0.0
    for axis in range(3):
        max_drop, max_square = 0.0, 0.0
        for n in range(4):
            i, j, k = (
                (0, n & 1, n >> 1) if axis == 0 else ((n & 1, 0, n >> 1) if axis == 1 else (n & 1, n >> 1, 0))
            )
            f, g = block[i, j, k], block[i + (axis == 0), j + (axis == 1), k + (axis == 2)]
            max_drop = max(max_drop, f[axis] - g[axis])
            max_square = max(max_square, (f[0] - g[0]) ** 2 + (f[1] - g[1]) ** 2 + (f[2] - g[2]) ** 2)
        total += 0.25 * step_m[axis] * (max_drop + friction * math.sqrt(max_square))
    return total


@inner
def _holds_back(block, nodes, count, step_m, need_n, turn_nm, friction):
    """True if the forces at a cell's corners, [2, 2, 2, 3], hold a hand back from all its nearest nodes."""
    loss = _interpolation_loss(block, step_m, friction)
    for a in range(count):
        for c in range(8):
            i, j, k = c & 1, (c >> 1) & 1, c >> 2
            x, y, z = (i - 0.5) * step_m[0], (j - 0.5) * step_m[1], (k - 0.5) * step_m[2]
            x, y, z = x - nodes[a, 0], y - nodes[a, 1], z - nodes[a, 2]
            fx, fy, fz = block[i, j, k]
            margin = -(x * fx + y * fy + z * fz)
            if friction > 0.0:
                u, v, w = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
                margin -= friction * math.sqrt(u * u + v * v + w * w)
            if margin - need_n * math.sqrt(x * x + y * y + z * z) - turn_nm < loss:
                return False
    return True


@kernel
def weak_cells(
    start,
    stop,
    cells,
    max_distance_m,
    edges,
    later_m,
    beyond,
    frames,
    step_m,
    need_n,
    turn_nm,
    friction,
    weak,
):
    """Into `weak`, bool [m], the cells begin to end - 1 of int [m, 3], where some frame does not hold a hand
    back.

    `max_distance_m` [m]: no place of a cell is farther from A. `edges`, bool [2, nx, ny, nz]: nodes that A
    began with and those that joined it, which count as `later_m` farther, of both those with a neighbour that
    is none; `beyond` of them on each side are outside of the box of `frames`, float32 [f, ...]. `need_n` is P
    + m v^2 / (2 D), `turn_nm` m v^2.
    """
    found = np.empty((_MAX_CANDIDATES, 3))
    half = 0.5 * math.sqrt(step_m[0] ** 2 + step_m[1] ** 2 + step_m[2] ** 2)
    for c in range(start, stop):
        cell = cells[c]
        count = _nearest_nodes(edges[0], cell, step_m, max_distance_m[c] + half, found, 0)
        if count >= 0 and max_distance_m[c] + half > later_m:
            count = _nearest_nodes(edges[1], cell, step_m, max_distance_m[c] + half - later_m, found, count)
        weak[c] = count <= 0
        i, j, k = cell[0] - beyond, cell[1] - beyond, cell[2] - beyond
        for f in range(frames.shape[0]):
            if weak[c]:
                break
            block = frames[f, i : i + 2, j : j + 2, k : k + 2]
            weak[c] = not _holds_back(block, found, count, step_m, need_n, turn_nm, friction)
