"""The warped amplitudes of a lattice, made once: every frame of a stream asks for the same."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["warp_of"]


@lru_cache(maxsize=8)
def warp_of(floor: int, rate: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """`touch_lattice.warp_table`, kept; nobody writes into it."""
    from touchfield.codec.kernels.touch_lattice import warp_table

    return warp_table(floor, rate)
