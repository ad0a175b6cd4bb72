"""One frame of the paper's coder as symbols, and the forces that they stand for (figure 4, "synthesis").

A frame is coded in one of three ways:

* ``INTRA``: alone. Samples in raster order; a sample within the deadband of the last sent one is held (eq. 8).
* ``INTER``: closed loop. The reference is the decoded previous frame at the same voxel; a voxel within the
  deadband of it is held, otherwise the quantised difference is sent.
* ``DIFFERENCE``: the paper's open loop. The field of differences between two originals is coded like a frame of
  its own and added to the decoded previous frame; errors add up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.segment import FrameKind
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys
from touchfield.medium.kernels import raster_slots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.paper.directions import Codebook

    Int32s = NDArray[np.int32]
    Float32s = NDArray[np.float32]
    Mask = NDArray[np.bool_]

__all__ = ["FrameSymbols", "field_of", "rebuilt"]


@dataclass(frozen=True)
class FrameSymbols:
    """Symbols of a frame that go into the stream.

    Attributes
    ----------
    kind : FrameKind
    bricks : int32 [n, 3]
    mask : bool [n, 8, 8, 8]
        The support (of the differences, in a DIFFERENCE frame).
    sent : bool [L]
        Per supported sample in raster order: sent, or held.
    levels, directions : uint16 [sent.sum()]
        Amplitude level and direction index of the sent samples.
    """

    kind: FrameKind
    bricks: Int32s
    mask: Mask
    sent: NDArray[np.bool_]
    levels: NDArray[np.uint16]
    directions: NDArray[np.uint16]


def field_of(grid: Grid, bricks: Int32s, forces_n: Float32s) -> ForceField:
    """Forces [n, 8, 8, 8, 3] as a field; bricks whose forces are all zero are left out."""
    held = forces_n.any(axis=(1, 2, 3, 4))
    return ForceField(grid, bricks[held], forces_n[held])


def rebuilt(
    grid: Grid, symbols: FrameSymbols, levels_n: Float32s, codebook: Codebook, previous: ForceField | None
) -> ForceField:
    """One frame from its symbols, its amplitude levels and the decoded frame before; all arithmetic is of float32."""
    slots = raster_slots(symbols.bricks, symbols.mask)
    values = levels_n[symbols.levels][:, None] * codebook.vertices_float32[symbols.directions]
    forces = zero_forces(len(symbols.bricks))
    flat = forces.reshape(-1, 3)
    if symbols.kind == FrameKind.INTER:
        assert previous is not None
        before = previous.forces_at(brick_keys(grid, symbols.bricks)).reshape(-1, 3)
        flat[slots] = before[slots]
        flat[slots[symbols.sent]] += values
        return field_of(grid, symbols.bricks, forces)
    latest = np.cumsum(symbols.sent)  # the last sent value is held; zero before the first
    flat[slots] = np.concatenate([np.zeros((1, 3), np.float32), values])[latest]
    alone = field_of(grid, symbols.bricks, forces)
    if symbols.kind == FrameKind.INTRA:
        return alone
    assert previous is not None
    return previous + alone
