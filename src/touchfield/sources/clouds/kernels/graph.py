"""Compiled inner loops over the graph of neighbouring cells: groups of cells, and normals that face alike.

Source of the order: H. Hoppe et al., Surface reconstruction from unorganized points, 1992. The sign of a
normal spreads along the minimum spanning tree of 1 - |n_i . n_j|. Here the tree is found by sorted edges
(Kruskal), with sets of cells that know their sign relative to that of their first cell.
"""

from __future__ import annotations

import numpy as np

from touchfield.compute.jit import inner, kernel
from touchfield.sources.clouds.kernels.cells import cell_of, key_of, row_of

_LEVELS = 256


@inner(forceinline=True)
def _root(parents, signs, row):
    """Return the first row of the set of a row, and the sign relative to it; paths are halved."""
    sign = np.int8(1)
    while parents[row] != row:
        above = parents[row]
        signs[row] *= signs[above]
        parents[row] = parents[above]
        sign *= signs[row]
        row = parents[row]
    return row, sign


@kernel
def find_edges(cells, table, normals, reach, only_from, roots, edges, levels):
    """Find pairs of rows within `reach` cells of each other, and the level of 1 - |n_i . n_j| of each.

    Returns their number, even where `edges` int32 [m, 2] and `levels` uint8 [m] are too short. Rows that are
    not in `only_from`, bool [n], start no pair; if `roots` int32 [n] is not empty, pairs within a set are
    left out.
    """
    count = 0
    for row in range(len(cells.keys)):
        if not only_from[row]:
            continue
        i, j, k = cell_of(cells.keys[row])
        for oi in range(-reach, reach + 1):
            for oj in range(-reach, reach + 1):
                for ok in range(-reach, reach + 1):
                    other = row_of(table, key_of(i + oi, j + oj, k + ok))
                    while other >= 0:
                        is_new = other > row or not only_from[other]
                        if is_new and other != row and (len(roots) == 0 or roots[other] != roots[row]):
                            if count < len(levels):
                                dot = abs(
                                    normals[row, 0] * normals[other, 0]
                                    + normals[row, 1] * normals[other, 1]
                                    + normals[row, 2] * normals[other, 2]
                                )
                                edges[count, 0], edges[count, 1] = row, other
                                levels[count] = np.uint8(min(max((1.0 - dot) * _LEVELS, 0.0), _LEVELS - 1.0))
                            count += 1
                        other = cells.following[other]
    return count


@kernel
def join(edges, order, normals, parents, signs):
    """Join the sets of both ends of each edge, in the given order, with the signs that make normals agree."""
    for e in order:
        a, b = edges[e, 0], edges[e, 1]
        first, sign_a = _root(parents, signs, a)
        second, sign_b = _root(parents, signs, b)
        if first == second:
            continue
        dot = normals[a, 0] * normals[b, 0] + normals[a, 1] * normals[b, 1] + normals[a, 2] * normals[b, 2]
        agreed = np.int8(1) if dot >= 0.0 else np.int8(-1)
        parents[second] = first
        signs[second] = sign_a * sign_b * agreed


@kernel
def roots_of(parents, signs, roots, relative):
    """Write the first row of the set of each row, and the sign relative to it."""
    for row in range(len(parents)):
        roots[row], relative[row] = _root(parents, signs, row)
