"""Compiled loop of bodies in motion: the field of one body added to those of others, with what its motion adds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid

__all__ = ["add_body"]


@njit(cache=True, nogil=True)
def _add(begin, end, bricks, forces, slots, lattice, motion, total):
    ox, oy, oz, vx, vy, vz, wx, wy, wz = motion
    for s in range(begin, end):
        for i in range(8):
            dx = lattice[0] + (8 * bricks[s, 0] + i) * lattice[3] - ox
            for j in range(8):
                dy = lattice[1] + (8 * bricks[s, 1] + j) * lattice[4] - oy
                for k in range(8):
                    f, t = forces[s, i, j, k], total[slots[s], i, j, k]
                    if f[0] != 0 or f[1] != 0 or f[2] != 0:
                        dz = lattice[2] + (8 * bricks[s, 2] + k) * lattice[5] - oz
                        t[0] += f[0] + (vx + wy * dz - wz * dy)
                        t[1] += f[1] + (vy + wz * dx - wx * dz)
                        t[2] += f[2] + (vz + wx * dy - wy * dx)


def add_body(
    field: ForceField,
    slots: NDArray[np.int64],
    grid: Grid,
    motion: tuple[float, ...],
    total_n: NDArray[np.float32],
) -> None:
    """Add a body's forces to the bricks `slots` of a sum, and b (v + omega x r) wherever it has a force.

    `field` ForceField: on the lattice, or a part of it whose bricks are bricks of it; `slots` int64 [n]: where each
    of the field's bricks lies in `total_n`; `grid` Grid: the lattice of `field`; `motion` nine numbers: the body's
    origin, metres; b v and b omega, newtons and newtons a metre; `total_n` float32 [m, 8, 8, 8, 3].
    """
    lattice = (*grid.origin_m, *grid.spacing_m)
    for_chunks(_add, len(slots), field.bricks, field.forces_n, slots, lattice, motion, total_n, chunk=32)
