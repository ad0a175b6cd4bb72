"""One frame of the paper's coder as symbols, and the forces that they stand for (figure 4, "synthesis").

A frame is coded in one of three ways:

* ``INTRA``: alone. Samples in scan order; a sample within the deadband of the last sent one is held (eq. 8).
* ``INTER``: closed loop. The reference is the decoded previous frame at the same voxel; a voxel within the
  deadband of it is held, otherwise the quantised difference is sent.
* ``DIFFERENCE``: the paper's open loop. The field of differences between two originals is coded like a frame of
  its own and added to the decoded previous frame; errors add up.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.segment import FrameKind
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int32s = NDArray[np.int32]
    Float32s = NDArray[np.float32]
    Mask = NDArray[np.bool_]

__all__ = ["FrameSymbols", "Scan", "Synthesis", "field_of", "scan_slots", "scanned_n"]


class Scan(IntEnum):
    """Raster order of the samples: which axis runs fastest; the number is what the file holds."""

    X_FASTEST = 0
    Z_FASTEST = 1


@dataclass(frozen=True)
class FrameSymbols:
    """What of a frame goes into the stream.

    Attributes
    ----------
    kind : FrameKind
    bricks : int32 [n, 3]
    mask : bool [n, 8, 8, 8]
        The support (of the differences, in a DIFFERENCE frame).
    sent : bool [L]
        Per supported sample in scan order: sent, or held.
    levels, directions : uint16 [sent.sum()]
        Amplitude level and direction index of the sent samples.
    """

    kind: FrameKind
    bricks: Int32s
    mask: Mask
    sent: NDArray[np.bool_]
    levels: NDArray[np.uint16]
    directions: NDArray[np.uint16]


def scan_slots(bricks: Int32s, mask: Mask, scan: Scan) -> NDArray[np.int64]:
    """Places of the supported samples in forces [n * 512, 3], in scan order, int64 [L]."""
    if scan == Scan.Z_FASTEST:
        from touchfield.medium.kernels import raster_slots

        return raster_slots(bricks, mask)
    slots = np.flatnonzero(mask)
    brick, local = np.divmod(slots, BRICK**3)
    x, y, z = bricks.astype(np.int64)[brick].T * BRICK + np.unravel_index(local, (BRICK,) * 3)
    return slots[np.argsort((z << 42) + (y << 21) + x, kind="stable")]


def scanned_n(field: ForceField, scan: Scan) -> Float32s:
    """The forces of the support in scan order, newtons, float32 [L, 3]."""
    return field.forces_n.reshape(-1, 3)[scan_slots(field.bricks, field.mask, scan)]


def field_of(grid: Grid, bricks: Int32s, forces_n: Float32s) -> ForceField:
    """Forces [n, 8, 8, 8, 3] as a field; bricks whose forces are all zero are left out."""
    held = forces_n.any(axis=(1, 2, 3, 4))
    return ForceField(grid, bricks[held], forces_n[held])


@dataclass(frozen=True)
class Synthesis:
    """The decoder's synthesis: symbols to forces. Products and sums are of float32.

    Attributes
    ----------
    grid : Grid
    vertices : float32 [any, 3]
        Directions.
    scan : Scan
    """

    grid: Grid
    vertices: Float32s
    scan: Scan

    def rebuild(self, symbols: FrameSymbols, levels_n: Float32s, previous: ForceField | None) -> ForceField:
        """One frame from its symbols, its amplitude levels and the decoded frame before."""
        slots = scan_slots(symbols.bricks, symbols.mask, self.scan)
        values = levels_n[symbols.levels][:, None] * self.vertices[symbols.directions]
        forces = zero_forces(len(symbols.bricks))
        flat = forces.reshape(-1, 3)
        if symbols.kind == FrameKind.INTER:
            assert previous is not None
            before = previous.forces_at(brick_keys(self.grid, symbols.bricks)).reshape(-1, 3)
            flat[slots] = before[slots]
            flat[slots[symbols.sent]] += values
            return field_of(self.grid, symbols.bricks, forces)
        latest = np.cumsum(symbols.sent)  # the last sent value is held; zero before the first
        flat[slots] = np.concatenate([np.zeros((1, 3), np.float32), values])[latest]
        alone = field_of(self.grid, symbols.bricks, forces)
        if symbols.kind == FrameKind.INTRA:
            return alone
        assert previous is not None
        return previous + alone
