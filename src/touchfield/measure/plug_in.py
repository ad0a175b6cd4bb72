"""Plug-in entropies of a quantised field, voxel and object (paper section 3.1, table 1).

The paper never names the random variable; here it is S = Q(F(X)), Q the quantiser of the stream and X uniform
over all V voxels ("voxel", empty space being one symbol) or over the support alone ("object"). The two obey
H_voxel = h2(p) + p H_object exactly, p = L/V being the density of the support: that identity is what the paper
calls "artificially escalated".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = ["SymbolCounter", "binary_entropy_bits", "entropy_bits"]


def entropy_bits(counts: ArrayLike) -> float:
    """Plug-in entropy -sum p log2 p of a histogram, bits a sample; 0 for an empty one.

    Exact to rounding also where one symbol dominates, such as the empty space around one brick.
    """
    n = np.asarray(counts, np.float64).ravel()
    n = n[n > 0]
    if not len(n):
        return 0.0
    total = n.sum()
    common = int(n.argmax())
    others = np.delete(n, common)
    rest = others.sum()
    if rest < n[common]:  # its share is nearly 1, and what is left of a difference of logarithms would be rounding
        p = others / total
        return float(-(1 - rest / total) * np.log1p(-rest / total) / np.log(2) - (p * np.log2(p)).sum()) + 0.0
    return float(max(0.0, np.log2(total) - (n * np.log2(n)).sum() / total))


def binary_entropy_bits(p: float) -> float:
    """h2(p), bits."""
    return entropy_bits([p, 1.0 - p])


class SymbolCounter:
    """Counts the symbols of the support and the empty voxels, frame after frame."""

    def __init__(self) -> None:
        self._symbols = np.zeros(0, np.int64)
        self._counts = np.zeros(0, np.int64)
        self._voxels = 0

    def add(self, symbols: ArrayLike, voxel_count: int) -> None:
        """Count one frame: the symbols of its support, whole numbers, and the number of all its voxels."""
        found, counts = np.unique(np.asarray(symbols, np.int64), return_counts=True)
        both = np.concatenate([self._symbols, found])
        self._symbols, place = np.unique(both, return_inverse=True)
        total = np.zeros(len(self._symbols), np.int64)
        np.add.at(total, place, np.concatenate([self._counts, counts]))
        self._counts = total
        self._voxels += voxel_count

    @property
    def object_bits(self) -> float:
        """H_object, bits per supported voxel."""
        return entropy_bits(self._counts)

    @property
    def voxel_bits(self) -> float:
        """H_voxel, bits per voxel, the empty voxel being one more symbol."""
        return entropy_bits(np.append(self._counts, self._voxels - self._counts.sum()))
