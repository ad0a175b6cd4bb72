"""The warped amplitudes of a lattice, made once: every frame of a stream asks for the same."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.lattice import Lattice

__all__ = ["tables_of", "warp_of"]


@lru_cache(maxsize=8)
def warp_of(floor: int, rate: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`touch_lattice.warp_table`, kept; nobody writes into it."""
    from touchfield.codec.kernels.touch_lattice import warp_table

    return warp_table(floor, rate)


def tables_of(lattice: Lattice) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """What the kernels take of a lattice: its four numbers, and the tables of `warp_of`."""
    steps = np.array([lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate], np.int64)
    return (steps, *warp_of(lattice.floor, lattice.rate))
