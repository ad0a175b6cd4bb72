"""Turning of bricks between the coordinates of the grid and those of a scan."""

from __future__ import annotations

from touchfield.lean import entry, lean

__all__ = ["turned", "turned_back"]


@lean
def _place(x, y, z, axes, down):
    """Sample of the grid that sample (x, y, z) of a scan is."""
    place = 0
    for i in range(3):
        c = x if i == 0 else (y if i == 1 else z)
        if down[i]:
            c = 7 - c
        place += c * (64 >> (3 * axes[i]))
    return place


@entry
def turned(vectors, slots, axes, down, scale, out):
    """``out[n, sample, component]`` in a scan of ``vectors[slots[n]]`` in the grid, times `scale`."""
    for n in range(slots.shape[0]):
        for at in range(512):
            place = _place(at >> 6, at >> 3 & 7, at & 7, axes, down)
            for i in range(3):
                v = vectors[slots[n], place, axes[i]] * scale
                out[n, at, i] = -v if down[i] else v


@entry
def turned_back(cells, slots, axes, down, out):
    """Vectors ``out[slots[n]]`` in the grid, of cells of a scan; zeros where a cell holds no force."""
    for n in range(slots.shape[0]):
        for at in range(512):
            place = _place(at >> 6, at >> 3 & 7, at & 7, axes, down)
            for i in range(3):
                v = cells[n, at, i] if cells[n, at, 3] > 0 else 0
                out[slots[n], place, axes[i]] = -v if down[i] else v
