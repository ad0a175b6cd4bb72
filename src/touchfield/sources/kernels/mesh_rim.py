"""Compiled loop that lets the force of a one-sided shell fall to zero at an open boundary.

A wall ends where its surface ends: a force is multiplied by min(1, s / w), s the distance to the rim of the nearest
point of the surface. Where that point lies on the rim itself, the surface is beside the sample: no force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks
from touchfield.sources.kernels.mesh_triangle import nearest

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Rim", "RimNear", "fade"]


@dataclass(frozen=True)
class Rim:
    """Where a surface ends.

    Parameters
    ----------
    table : float64 [r, 33]; `triangle_table` of its edges, each a triangle that goes to and fro.
    width_m : float; w.
    """

    table: NDArray[np.float64]
    width_m: float


@dataclass(frozen=True)
class RimNear:
    """The edges of a rim that are near each brick: from `first[b]` to before `last[b]` in `ids`."""

    first: NDArray[np.int64]
    last: NDArray[np.int64]
    ids: NDArray[np.int32]


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
    """Fade `forces`, float32 [n, 8, 8, 8, 3], towards a rim; bricks that have none left are no longer `held`.

    `owners` int32 [n, 8, 8, 8]: the nearest triangle of each sample with a force, -1 for the others; `lattice` the
    grid's origin and spacing in metres, float64 [6].
    """
    spans = (near.first, near.last, near.ids)
    for_chunks(_fade, len(bricks), bricks, owners, table, lattice, rim.table, spans, rim.width_m, forces, held)
