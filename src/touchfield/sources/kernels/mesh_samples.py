"""Compiled loops over the samples that a surface pushes: what its motion adds, and where a shell ends.

The damping of a moving surface is b times the velocity of the nearest point (paper 3.2); the velocity within a
triangle is linear between its corners, as their positions are. A wall ends where its surface ends: a force is
multiplied by min(1, s / w), s the distance to the rim of the nearest point of the surface. Where that point lies on
the rim itself, the surface is beside the sample: no force.

Both take `owners` int32 [n, 8, 8, 8], the nearest triangle of each sample with a force, -1 for the others, and the
grid's origin and spacing in metres, `lattice` float64 [6]; they change `forces`, float32 [n, 8, 8, 8, 3].
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from touchfield.parallel import for_chunks
from touchfield.sources.kernels.mesh_triangle import nearest


class Motion(NamedTuple):
    """Motion of a surface."""

    triangles: NDArray[np.int32]  # int32 [m, 3]; in the order of the table, each beginning with its longest edge
    velocities_m_s: NDArray[np.float64]  # float64 [n, 3]; of the vertices
    damping_n_s_per_m: float  # b


class Rim(NamedTuple):
    """Rim of a surface."""

    table: NDArray[np.float64]  # float64 [r, 33]; `triangle_table` of its edges, each a triangle that goes to and fro
    width_m: float  # w


class RimNear(NamedTuple):
    """The edges of a rim that are near each brick: from `first[b]` to before `last[b]` in `ids`."""

    first: NDArray[np.int64]
    last: NDArray[np.int64]
    ids: NDArray[np.int32]


@njit(nogil=True, forceinline=True)
def _shares(table, t, x, y, z):
    """Shares of the last two corners of a triangle in its point nearest to (x, y, z)."""
    dx, dy, dz, edge, along = nearest(table, t, x, y, z)
    if edge >= 0:
        length = table[t, 30 + edge]
        share = along / length if length > 0.0 else 0.0
        if edge == 0:
            return share, 0.0
        if edge == 1:
            return 1.0 - share, share
        return 0.0, 1.0 - share
    px, py, pz = x - dx, y - dy, z - dz
    # the height over an edge, of that of the corner opposite: negative within, as that of the corner
    top = table[t, 3] * (px - table[t, 21]) + table[t, 4] * (py - table[t, 22]) + table[t, 5] * (pz - table[t, 23])
    whole = (
        table[t, 3] * (table[t, 27] - table[t, 21])
        + table[t, 4] * (table[t, 28] - table[t, 22])
        + table[t, 5] * (table[t, 29] - table[t, 23])
    )
    third = min(max(top / whole, 0.0), 1.0) if whole != 0.0 else 0.0
    top = table[t, 9] * (px - table[t, 27]) + table[t, 10] * (py - table[t, 28]) + table[t, 11] * (pz - table[t, 29])
    whole = (
        table[t, 9] * (table[t, 24] - table[t, 27])
        + table[t, 10] * (table[t, 25] - table[t, 28])
        + table[t, 11] * (table[t, 26] - table[t, 29])
    )
    second = min(max(top / whole, 0.0), 1.0 - third) if whole != 0.0 else 0.0
    return second, third


@njit(cache=True, nogil=True)
def _add(begin, end, bricks, owners, table, lattice, triangles, velocities, damping, forces):
    for b in range(begin, end):
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    t = owners[b, i, j, k]
                    if t < 0:
                        continue
                    x = lattice[0] + (bricks[b, 0] * 8 + i) * lattice[3]
                    y = lattice[1] + (bricks[b, 1] * 8 + j) * lattice[4]
                    z = lattice[2] + (bricks[b, 2] * 8 + k) * lattice[5]
                    second, third = _shares(table, t, x, y, z)
                    for c in range(3):
                        v = velocities[triangles[t, 0], c]
                        at = v + second * (velocities[triangles[t, 1], c] - v)
                        at += third * (velocities[triangles[t, 2], c] - v)
                        forces[b, i, j, k, c] += damping * at


def add_motion(
    bricks: NDArray[np.int32],
    owners: NDArray[np.int32],
    table: NDArray[np.float64],
    lattice: NDArray[np.float64],
    motion: Motion,
    forces: NDArray[np.float32],
) -> None:
    """Add the damping of a surface that moves, where there are forces."""
    velocities = np.ascontiguousarray(motion.velocities_m_s, np.float64)
    arguments = (bricks, owners, table, lattice, motion.triangles, velocities, motion.damping_n_s_per_m, forces)
    for_chunks(_add, len(bricks), *arguments)


@njit(cache=True, nogil=True)
def _fade(begin, end, bricks, owners, table, lattice, rim, near, width, forces, held):
    first, last, ids = near
    for b in range(begin, end):
        if first[b] == last[b] or not held[b]:
            continue
        held[b] = False
        for i in range(8):
            for j in range(8):
                for k in range(8):
                    t = owners[b, i, j, k]
                    if t < 0:
                        continue
                    x = lattice[0] + (bricks[b, 0] * 8 + i) * lattice[3]
                    y = lattice[1] + (bricks[b, 1] * 8 + j) * lattice[4]
                    z = lattice[2] + (bricks[b, 2] * 8 + k) * lattice[5]
                    dx, dy, dz, _, _ = nearest(table, t, x, y, z)
                    x, y, z = x - dx, y - dy, z - dz
                    least = width * width
                    for e in range(first[b], last[b]):
                        dx, dy, dz, _, _ = nearest(rim, ids[e], x, y, z)
                        least = min(least, dx * dx + dy * dy + dz * dz)
                    # what lies on the rim to rounding has no force at all
                    share = max(0.0, math.sqrt(least) / width - 1e-6)
                    if share < 1.0 - 2e-6:
                        for c in range(3):
                            forces[b, i, j, k, c] *= share
                    if share > 0.0:
                        held[b] = True


def fade(
    bricks: NDArray[np.int32],
    owners: NDArray[np.int32],
    table: NDArray[np.float64],
    lattice: NDArray[np.float64],
    rim: Rim,
    near: RimNear,
    forces: NDArray[np.float32],
    held: NDArray[np.bool_],
) -> None:
    """Fade forces towards a rim; bricks that have none left are no longer `held`."""
    for_chunks(_fade, len(bricks), bricks, owners, table, lattice, rim.table, tuple(near), rim.width_m, forces, held)
