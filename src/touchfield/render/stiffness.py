"""The stiffest slope of a field: what a wall of it asks of the loop (`render.stability`)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from touchfield.medium.cells import CellPool

__all__ = ["stiffest_n_per_m"]

_SHARE: Final = 1e-3
"""Of the cells that push back may be stiffer: edges, corners, noise."""


def stiffest_n_per_m(pools: Iterable[CellPool]) -> float:
    """How much a force grows with a way against it, N/m: what one cell in a thousand of a field passes, at the most.

    Parameters
    ----------
    pools : iterable of CellPool
        Of one field each, in their own frames.
    """
    from touchfield.render.kernels.stiffness import BINS, count_slopes, slope_of_bin

    stiffest = 0.0
    for pool in pools:
        counts = np.zeros(BINS, np.int64)
        count_slopes(pool.cells, pool.held, 1.0 / pool.lattices[0, :3], counts)
        beyond = np.cumsum(counts[::-1])[::-1]
        if counts.any():
            stiffest = max(stiffest, slope_of_bin(int(np.flatnonzero(beyond > _SHARE * beyond[0])[-1])))
    return stiffest
