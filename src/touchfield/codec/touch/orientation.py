"""The way a pass runs through a grid: along which axes and from which ends."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Orientation", "sampled"]

_AXES: Final = tuple(permutations(range(3)))

_QUICK: Final = 150_000
"""Up to so many samples all orientations are tried on the whole frame: an eighth of a smaller one chose another one
than the whole, for 3 to 6 % more bytes."""

_SHARE: Final = 8
"""Of a larger frame one part in so many is tried."""

_TILE: Final = 4
"""Bricks along a side of a tile across the main axis, which is taken as a whole."""


@dataclass(frozen=True)
class Orientation:
    """How a pass runs through a grid: its (z, y, x) are which of the grid's axes, and from which end.

    Attributes
    ----------
    number : int
        0 to 47: six orders of the axes times eight senses.
    """

    number: int

    @classmethod
    def of(cls, axes: tuple[int, ...], flips: tuple[bool, ...]) -> Orientation:
        """The inverse of `axes` and `flips`."""
        return cls(_AXES.index(axes) << 3 | sum(int(f) << i for i, f in enumerate(flips)))

    @property
    def axes(self) -> tuple[int, int, int]:
        """The grid's axes that are slowest, middle and fastest."""
        return _AXES[self.number >> 3]  # type: ignore[return-value]

    @property
    def flips(self) -> tuple[bool, bool, bool]:
        """Whether each of them is run through from its end."""
        return tuple(bool(self.number >> i & 1) for i in range(3))  # type: ignore[return-value]

    def shape(self, grid: Grid) -> tuple[int, ...]:
        """Bricks along (z, y, x)."""
        return tuple(grid.brick_shape[a] for a in self.axes)

    def bounds(self, grid: Grid) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First and last + 1 sample within the grid, along (z, y, x)."""
        size = np.array([grid.shape[a] for a in self.axes], np.int64)
        whole = np.array(self.shape(grid), np.int64) * BRICK
        flipped = np.array(self.flips)
        return np.where(flipped, whole - size, 0), np.where(flipped, whole, size)

    def turned(
        self, grid: Grid, bricks: NDArray[np.int32], values: NDArray[Any]
    ) -> tuple[NDArray[np.int32], NDArray[Any], NDArray[np.int64]]:
        """Bricks int32 [n, 3] as (z, y, x), ascending, their vectors as (x, y, z), and the order they came in."""
        axes, flips = self.axes, self.flips
        shape = self.shape(grid)
        b = np.stack([shape[i] - 1 - bricks[:, a] if flips[i] else bricks[:, a] for i, a in enumerate(axes)], axis=-1)
        order = np.lexsort((b[:, 2], b[:, 1], b[:, 0]))
        v = values[order].transpose(0, *(a + 1 for a in axes), 4)[..., list(axes[::-1])].copy()
        for i, flipped in enumerate(flips):
            if flipped:
                v = np.flip(v, i + 1)
                v[..., 2 - i] *= -1
        return np.ascontiguousarray(b[order].astype(np.int32)), np.ascontiguousarray(v), order

    def back(self, values: NDArray[np.int32], order: NDArray[np.int64]) -> NDArray[np.int32]:
        """The vectors of `turned` in the grid's own order."""
        v = values.copy()
        for i, flipped in enumerate(self.flips):
            if flipped:
                v = np.flip(v, i + 1)
                v[..., 2 - i] *= -1
        inverse = np.argsort(self.axes)
        v = v[..., [2 - int(np.flatnonzero(np.array(self.axes) == c)[0]) for c in range(3)]]
        v = v.transpose(0, *(inverse + 1), 4)
        out = np.empty_like(v)
        out[order] = v
        return np.ascontiguousarray(out)


def sampled(bricks: NDArray[np.int32], forces: NDArray[np.float32]) -> NDArray[np.bool_] | None:
    """Bricks by which orientations may be compared, bool [n]: whole columns of bricks along the main axis, scattered.

    Parameters
    ----------
    bricks : int32 [n, 3]
    forces : float32 [n, 8, 8, 8, 3]
        Newtons.

    Returns
    -------
    bool [n] or None
        None where the frame is small enough to be tried as a whole.
    """
    held = (forces != 0).any(axis=-1).sum(axis=(1, 2, 3))
    if held.sum() <= _QUICK:
        return None
    main = int(np.abs(forces.reshape(-1, 3).sum(axis=0, dtype=np.float64)).argmax())
    across = bricks[:, [a for a in range(3) if a != main]].astype(np.int64) // _TILE
    tiles, tile_of = np.unique(across[:, 0] << 32 | across[:, 1], return_inverse=True)
    counts = np.bincount(tile_of, held)
    scattered = np.argsort((tiles ^ tiles >> 15) * 0x9E3779B1 & 0xFFFFFFFF, kind="stable")
    enough = int(np.searchsorted(np.cumsum(counts[scattered]), counts.sum() / _SHARE)) + 1
    return np.isin(tile_of, scattered[:enough])
