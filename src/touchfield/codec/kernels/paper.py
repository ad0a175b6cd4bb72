"""Compiled loops of the paper's coder: symbols to forces, in scan order."""

from __future__ import annotations

from numba import njit

__all__ = ["add_differences", "hold_and_place"]


@njit(cache=True, nogil=True)
def hold_and_place(slots, sent, levels, directions, levels_n, vertices, forces):
    """Write sent values, and hold the last one where nothing was sent; zero before the first."""
    x = y = z = levels_n.dtype.type(0)
    t = 0
    for i in range(slots.shape[0]):
        if sent[i]:
            a = levels_n[levels[t]]
            d = directions[t]
            x, y, z = a * vertices[d, 0], a * vertices[d, 1], a * vertices[d, 2]
            t += 1
        s = slots[i]
        forces[s, 0], forces[s, 1], forces[s, 2] = x, y, z


@njit(cache=True, nogil=True)
def add_differences(slots, sent, levels, directions, levels_n, vertices, reference, forces):
    """Add the sent differences to the reference; keep the reference where nothing was sent."""
    t = 0
    for i in range(slots.shape[0]):
        s = slots[i]
        x, y, z = reference[s, 0], reference[s, 1], reference[s, 2]
        if sent[i]:
            a = levels_n[levels[t]]
            d = directions[t]
            x, y, z = x + a * vertices[d, 0], y + a * vertices[d, 1], z + a * vertices[d, 2]
            t += 1
        forces[s, 0], forces[s, 1], forces[s, 2] = x, y, z
