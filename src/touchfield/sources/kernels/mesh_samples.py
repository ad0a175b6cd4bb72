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

from touchfield.arrays import Float64s, Int32s
from touchfield.sources.kernels.mesh_triangle import nearest


class Motion(NamedTuple):
    """Motion of a surface."""

    triangles: Int32s  # int32 [m, 3]; in the order of the table, each beginning with its longest edge
    velocities_m_s: Float64s  # float64 [n, 3]; of the vertices
    damping_n_s_per_m: float  # b


class Rim(NamedTuple):
    """Rim of a surface."""

    table: Float64s  # float64 [r, 33]; `triangle_table` of its edges, each a triangle that goes to and fro
    width_m: float  # w


@njit(nogil=True, forceinline=True)
def _place(bricks, b, i, j, k, lattice):
    x = lattice[0] + (bricks[b, 0] * 8 + i) * lattice[3]
    y = lattice[1] + (bricks[b, 1] * 8 + j) * lattice[4]
    z = lattice[2] + (bricks[b, 2] * 8 + k) * lattice[5]
    return x, y, z


@njit(nogil=True, forceinline=True)
def _height(table, t, edge, x, y, z):
    """The height over an edge, in the plane of its triangle."""
    m, a = 3 + 3 * edge, 21 + 3 * edge
    dx, dy, dz = x - table[t, a], y - table[t, a + 1], z - table[t, a + 2]
    return table[t, m] * dx + table[t, m + 1] * dy + table[t, m + 2] * dz


@njit(nogil=True, forceinline=True)
def _share(table, t, edge, x, y, z):
    """The height over an edge, of that of the corner opposite: the share of that corner."""
    a = 21 + 3 * ((edge + 2) % 3)
    whole = _height(table, t, edge, table[t, a], table[t, a + 1], table[t, a + 2])
    return min(max(_height(table, t, edge, x, y, z) / whole, 0.0), 1.0) if whole != 0.0 else 0.0


@njit(nogil=True, forceinline=True)
def _shares(table, t, x, y, z):
    """Shares of the last two corners of a triangle in its point nearest to (x, y, z)."""
    dx, dy, dz, edge, along = nearest(table, t, x, y, z)
    if edge < 0:
        px, py, pz = x - dx, y - dy, z - dz
        third = _share(table, t, 0, px, py, pz)
        return min(_share(table, t, 2, px, py, pz), 1.0 - third), third
    length = table[t, 30 + edge]
    share = along / length if length > 0.0 else 0.0
    if edge == 0:
        return share, 0.0
    return (1.0 - share, share) if edge == 1 else (0.0, 1.0 - share)


@njit(cache=True, nogil=True)
def add_motion(begin, end, bricks, owners, table, lattice, triangles, velocities, damping, forces):
    """Add the damping of a surface that moves, where there are forces."""
    for b in range(begin, end):
        for i, j, k in np.ndindex(8, 8, 8):
            t = owners[b, i, j, k]
            if t < 0:
                continue
            x, y, z = _place(bricks, b, i, j, k, lattice)
            second, third = _shares(table, t, x, y, z)
            for c in range(3):
                v = velocities[triangles[t, 0], c]
                at = v + second * (velocities[triangles[t, 1], c] - v)
                at += third * (velocities[triangles[t, 2], c] - v)
                forces[b, i, j, k, c] += damping * at


@njit(cache=True, nogil=True)
def fade(begin, end, bricks, owners, table, lattice, rim, near, width, forces, held):
    """Fade forces towards a rim; bricks that have none left are no longer `held`.

    `near` (first, last, ids): the edges of the rim near brick b are ids[first[b]] to before ids[last[b]].
    """
    first, last, ids = near
    for b in range(begin, end):
        if first[b] == last[b] or not held[b]:
            continue
        held[b] = False
        for i, j, k in np.ndindex(8, 8, 8):
            t = owners[b, i, j, k]
            if t < 0:
                continue
            x, y, z = _place(bricks, b, i, j, k, lattice)
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
