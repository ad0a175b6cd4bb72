"""A field in whole numbers: what encoder and decoder of the coder `touch` both hold, bit for bit the same.

Forces are multiples of a unit; all that predicts one force from others works on them, and newtons appear only at
the very end (`FixedField.field`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.medium import ForceField, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["TOP", "FixedField"]

TOP: Final = 1 << 16
"""An encoder takes the unit so that the longest original of a segment has this length."""


@dataclass(frozen=True)
class FixedField:
    """Vectors in units, sparse in bricks of 8x8x8 samples.

    Attributes
    ----------
    bricks : int32 [n, 3]
        In ascending order (x slowest, z fastest), as in `ForceField`; a brick may hold no force at all.
    vectors : int32 [n, 8, 8, 8, 3]
        Axes (brick, x, y, z, component), units; each component within 2^17 - 1.
    """

    bricks: NDArray[np.int32]
    vectors: NDArray[np.int32]

    def field(self, grid: Grid, unit_n: float) -> ForceField:
        """The forces in newtons: one float32 product each, the only floating-point step of decoding."""
        from touchfield.codec.touch.kernels.units import newtons

        forces, held = np.empty(self.vectors.shape, np.float32), np.empty(len(self.vectors), np.bool_)
        newtons(self.vectors.reshape(-1), np.float32(unit_n), forces.reshape(-1), held)
        if held.all():
            return ForceField(grid, self.bricks, forces)
        return ForceField(grid, self.bricks[held], forces[held])
