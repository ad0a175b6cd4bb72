"""Scan of a frame: the order and the coordinates in which its bricks are walked, from deep to shallow.

Axis 0 of a scan is the slowest; along each axis it goes the way that the force points. In its coordinates components
are turned and signed alike, so that nothing else of the coder knows of axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.medium.field import slots_around
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.workspace import Scan

    Int64s = NDArray[np.int64]

__all__ = ["Course"]

_SAMPLES = BRICK**3


@dataclass(frozen=True)
class Course:
    """The course of a scan over the bricks of a grid.

    Attributes
    ----------
    grid : Grid
    axis : int
        Of the grid, the slowest of the scan; the others follow in ascending order.
    down : (bool, bool, bool)
        Whether the axes of the scan run against those of the grid.
    """

    grid: Grid
    axis: int
    down: tuple[bool, bool, bool]

    @property
    def axes(self) -> Int64s:
        """Axes of the grid, slowest first."""
        return np.array([self.axis, *(c for c in range(3) if c != self.axis)], np.int64)

    @property
    def code(self) -> int:
        """The number that a file has for it: the axis, and 4, 8, 16 where axes 0, 1, 2 of the scan run down."""
        return self.axis | sum(4 << n for n in range(3) if self.down[n])

    @classmethod
    def of_code(cls, grid: Grid, code: int) -> Course:
        """The course of such a number, below 32 and not 3 modulo 4."""
        return cls(grid, code & 3, (bool(code & 4), bool(code & 8), bool(code & 16)))

    def order(self, bricks: NDArray[np.int32]) -> tuple[Int64s, Int64s]:
        """Bricks of the grid in the scan's coordinates, int64 [n, 3] in scan order, and which each of them is."""
        axes = self.axes
        turned = bricks[:, axes].astype(np.int64)
        last = np.array(self.grid.brick_shape, np.int64)[axes] - 1
        turned = np.where(self.down, last - turned, turned)
        order = np.lexsort(turned.T[::-1])
        return turned[order], order.astype(np.int64)

    def turned(self, vectors: NDArray[Any], slots: Int64s, scale: float = 1.0) -> NDArray[Any]:
        """Vectors [n, 8, 8, 8, 3] of the grid as [n, 512, 3] of the scan: int32 stay whole, floats become float64."""
        from touchfield.codec.touch.kernels.turn import turned

        whole = vectors.dtype == np.int32
        out = np.empty((len(slots), _SAMPLES, 3), np.int32 if whole else np.float64)
        factor = np.int32(1) if whole else np.float64(scale)
        turned(vectors.reshape(-1, _SAMPLES, 3), slots, self.axes, np.array(self.down), factor, out)
        return out

    def turned_back(self, cells: NDArray[np.int32], slots: Int64s) -> NDArray[np.int32]:
        """Vectors int32 [n, 8, 8, 8, 3] of the grid, of the cells [n, 512, 8] of a scan."""
        from touchfield.codec.touch.kernels.turn import turned_back

        out = np.empty((len(slots), BRICK, BRICK, BRICK, 3), np.int32)
        turned_back(cells, slots, self.axes, np.array(self.down), out.reshape(-1, _SAMPLES, 3))
        return out

    def scan(self, bricks: Int64s, reference: FixedField | None) -> Scan:
        """Walk of a pass: bricks in scan order, as `order` gives them, beside a reference."""
        from touchfield.codec.touch.kernels.workspace import Scan

        axes, down = self.axes, np.array(self.down)
        size = np.array(self.grid.shape, np.int64)[axes]
        count = np.array(self.grid.brick_shape, np.int64)[axes]
        # samples beyond the grid lie in its last bricks, which are the first ones of an axis that runs down
        rest = count * BRICK - size
        low = np.where(down & (bricks == 0), rest, 0)
        high = np.where(~down & (bricks == count - 1), BRICK - rest, BRICK)
        if reference is None:
            vectors, around = np.zeros((1, _SAMPLES, 3), np.int32), np.zeros((0, 27), np.int64)
        else:
            theirs, slots = self.order(reference.bricks)
            vectors, around = self.turned(reference.vectors, slots), slots_around(bricks, theirs, count, 27)
        cells = np.zeros((len(bricks), _SAMPLES, 8), np.int32)
        return Scan(slots_around(bricks, bricks, count, 13), around, low, high, vectors, cells)
