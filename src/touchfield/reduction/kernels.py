"""Compiled inner loop of `reach`: tests for each cell of a lattice whether the forces there stop a hand.

See `touchfield.reduction.reach` for the proof.
"""

from __future__ import annotations

import math

import numpy as np

from touchfield.compute.jit import inner, kernel

_MAX_CANDIDATES = 1024  # maximum number of nearest nodes of a cell; a cell with more counts as weak


@inner
def _nearest_nodes(edge, cell, step_m, reach_m, found, count):
    """Write the nodes that may be nearest to a cell to `found`, from row `count` on.

    Positions are relative to the cell's centre, in metres, of nodes within `reach_m` of it. A node is omitted
    if another one is nearer from everywhere in the cell. Returns the new count, or -1 if there are too many
    nodes.
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
    for a in range(first, count):  # in order of distance, so that nearer nodes can eliminate farther ones
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
    """Upper bound of the loss of -(x - a) . F between samples, N m (see `reach`).

    `block`: forces at the corners of a cell, float [2, 2, 2, 3].
    """
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
    """True if the forces of a cell hold a hand back from all its nearest nodes.

    `block`: forces at the corners of the cell, [2, 2, 2, 3].
    """
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
    """Set `weak`, bool [m], for cells where some frame does not hold a hand back.

    Tests cells `start` to `stop` - 1 of `cells`, int [m, 3]. `max_distance_m` [m]: upper bound of the
    distance d from A within each cell. `edges`, bool [2, nx, ny, nz]: boundary nodes (those with a neighbour
    outside the set) of the initial A and of what joined it later; the latter count as `later_m` farther away.
    `beyond`: number of nodes on each side outside the box of `frames`, float32 [f, ...]. `need_n` is P + m
    v^2 / (2 D), `turn_nm` is m v^2.
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
