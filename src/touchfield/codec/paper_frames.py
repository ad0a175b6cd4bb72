"""One frame through the paper's coder: gate, quantise, and what the decoder will see.

A frame is coded in one of three ways:

* ``INTRA``: alone. Samples in scan order; a sample within the deadband of the last sent one is held (eq. 8).
* ``INTER``: closed loop. The reference is the decoded previous frame at the same voxel; a voxel within the
  deadband of it is held, otherwise the quantised difference is sent.
* ``DIFFERENCE``: the paper's open loop. The field of differences between two originals is coded like a frame of
  its own and added to the decoded previous frame; errors add up.

Encoder and decoder rebuild forces with the same compiled loops, so that the closed loop is closed exactly.
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

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.directions import Codebook
    from touchfield.codec.stage import Table

__all__ = [
    "DecodedFrame",
    "FrameSymbols",
    "Scan",
    "Synthesis",
    "amplitudes_n",
    "scan_slots",
    "scanned_n",
]


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
    bricks: NDArray[np.int32]
    mask: NDArray[np.bool_]
    sent: NDArray[np.bool_]
    levels: NDArray[np.uint16]
    directions: NDArray[np.uint16]


@dataclass(frozen=True)
class DecodedFrame:
    """A frame as the decoder holds it: its support, and forces that may have decoded to zero.

    Attributes
    ----------
    bricks : int32 [n, 3]
    mask : bool [n, 8, 8, 8]
    forces_n : float32 [n, 8, 8, 8, 3]
    """

    bricks: NDArray[np.int32]
    mask: NDArray[np.bool_]
    forces_n: NDArray[np.float32]

    def field(self, grid: Grid) -> ForceField:
        """The frame as a field; bricks whose forces all decoded to zero are left out."""
        held = self.forces_n.any(axis=(1, 2, 3, 4))
        if held.all():
            return ForceField(grid, self.bricks, self.forces_n)
        return ForceField(grid, self.bricks[held], self.forces_n[held])

    def forces_at(self, grid: Grid, bricks: NDArray[np.int32]) -> NDArray[np.float32]:
        """The forces of the given bricks, float32 [n, 8, 8, 8, 3]; zero where there is none."""
        return ForceField(grid, self.bricks, self.forces_n).forces_at(brick_keys(grid, bricks))


def amplitudes_n(vectors_n: NDArray[np.float32]) -> NDArray[np.float32]:
    """|F| of float32 [L, 3], float32 [L]."""
    x = vectors_n.astype(np.float64)
    amplitudes: NDArray[np.float32] = np.sqrt((x * x).sum(axis=1)).astype(np.float32)
    return amplitudes


def scan_slots(bricks: NDArray[np.int32], mask: NDArray[np.bool_], scan: Scan) -> NDArray[np.int64]:
    """Where the supported samples lie in forces [n * 512, 3], in scan order, int64 [L]."""
    if scan == Scan.Z_FASTEST:
        from touchfield.medium.kernels import raster_slots

        return raster_slots(bricks, mask)
    from touchfield.codec.kernels.scan import slots_along_x

    return slots_along_x(bricks, mask)


def scanned_n(field: ForceField, scan: Scan) -> NDArray[np.float32]:
    """The forces of the support in scan order, newtons, float32 [L, 3]."""
    return field.forces_n.reshape(-1, 3)[scan_slots(field.bricks, field.mask, scan)]


@dataclass(frozen=True)
class Synthesis:
    """The decoder's synthesis (figure 4): symbols to forces.

    Attributes
    ----------
    grid : Grid
    codebook : Codebook
    scan : Scan
    """

    grid: Grid
    codebook: Codebook
    scan: Scan

    def rebuild(self, symbols: FrameSymbols, amplitude: Table, previous: DecodedFrame | None) -> DecodedFrame:
        """One frame from its symbols, its amplitude table and the decoded frame before."""
        from touchfield.codec.kernels import paper as kernels

        slots = scan_slots(symbols.bricks, symbols.mask, self.scan)
        sent = (symbols.sent, symbols.levels, symbols.directions, amplitude.levels_n, self.codebook.vertices_float32)
        if symbols.kind == FrameKind.INTER:
            assert previous is not None
            reference = previous.forces_at(self.grid, symbols.bricks)
            forces = np.zeros_like(reference)
            kernels.add_differences(slots, *sent, reference.reshape(-1, 3), forces.reshape(-1, 3))
            return DecodedFrame(symbols.bricks, symbols.mask, forces)
        forces = zero_forces(len(symbols.bricks))
        kernels.hold_and_place(slots, *sent, forces.reshape(-1, 3))
        alone = DecodedFrame(symbols.bricks, symbols.mask, forces)
        if symbols.kind == FrameKind.INTRA:
            return alone
        assert previous is not None
        return _sum(self.grid, previous, alone)


def _sum(grid: Grid, a: DecodedFrame, b: DecodedFrame) -> DecodedFrame:
    both = np.concatenate([a.bricks, b.bricks])
    _, first = np.unique(brick_keys(grid, both), return_index=True)
    bricks = both[first]
    forces = a.forces_at(grid, bricks) + b.forces_at(grid, bricks)
    return DecodedFrame(bricks, (forces != 0).any(axis=-1), forces)
