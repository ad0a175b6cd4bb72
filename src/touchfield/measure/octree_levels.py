"""What a field is at each level of an octree around its support: how full, and how varied.

The cube around the support, with the longest side of its box (in metres) and the same centre, is cut into 2^j cells
along each axis. Of each level j = 1 .. 5 are told

* the *support fraction*: the share of its 8^j cells that hold a force, which falls from level to level as 2^(d - 3)
  for a support of dimension d;
* the *entropy*, bits a cell: H of the symbol of a cell, 0 where it is empty, else the class of its mean amplitude.

Nothing depends on where the support lies or how large it is, as far as the lattice tells; turns by right angles
change nothing either, but for samples that lie on a border of two cells. A level whose cells are smaller than the
lattice's own (along any axis, where the support has more than one sample) repeats the one above it: there is nothing
in between the samples.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.measure.plug_in import entropy_bits

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid

    Float64s = NDArray[np.float64]

__all__ = ["LEVELS", "octree_levels"]

LEVELS: Final = 5
"""The finest level has 32 cells along each axis."""


def octree_levels(
    grid: Grid, positions: NDArray[np.int32], amplitudes_n: NDArray[np.float32], thresholds_n: Float64s
) -> tuple[Float64s, Float64s]:
    """Support fractions, float64 [LEVELS], and entropies in bits a cell, float64 [LEVELS], of one frame.

    Parameters
    ----------
    grid : Grid
    positions : int32 [L, 3]
        Indices of the samples of the support that count; one or more.
    amplitudes_n : float32 [L]
        Newtons.
    thresholds_n : float64 [K]
        Ascending borders of the classes of amplitude, newtons; what is below the first is a class, too.
    """
    spacing = np.asarray(grid.spacing_m)
    low, high = positions.min(axis=0), positions.max(axis=0)
    side = float(((high - low + 1) * spacing).max())
    centre = (low + high) / 2 * spacing
    places = (positions * spacing - centre) / side + 0.5
    coarsest = float(np.max(np.where(high > low, spacing, 0.0)))
    fractions, entropies = np.zeros(LEVELS), np.zeros(LEVELS)
    for level in range(1, LEVELS + 1):
        cells = 1 << level
        if level > 1 and side / cells < coarsest * (1 - 1e-9):
            fractions[level - 1], entropies[level - 1] = fractions[level - 2], entropies[level - 2]
            continue
        # a hair inwards, so that rounding does not decide which cell a sample on a border lies in
        x, y, z = np.clip(np.floor(places * cells + 1e-9).astype(np.int64), 0, cells - 1).T
        of_sample = (x * cells + y) * cells + z
        held, cell = np.unique(of_sample, return_inverse=True)
        means = np.bincount(cell.reshape(-1), amplitudes_n) / np.bincount(cell.reshape(-1))
        counts = np.bincount(np.searchsorted(thresholds_n, means, side="right"))
        fractions[level - 1] = len(held) / cells**3
        entropies[level - 1] = entropy_bits(np.append(counts, cells**3 - len(held)))
    return fractions, entropies
