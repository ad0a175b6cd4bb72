"""Boxes of space that two lattices share, so that a medium and what a device renders of it are resampled together.

Source: S. N. Lahiri, Resampling Methods for Dependent Data, 2003, chapter 12 (blocks of a random field).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.field_frames import Fields, Frames, frames_changed
from touchfield.measure.histogram import LEAST_BLOCKS, MOST_BLOCK_CELLS, Histogram
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["SharedBoxes", "shared_counts"]

LEAST_SAMPLES = (BRICK, 2)
"""Along each side of a box, of the medium and of what is rendered of it: their neighbours depend on each other."""


@dataclass(frozen=True)
class SharedBoxes:
    """The box of a lattice, cut into equal boxes; what lies beyond belongs to the nearest.

    Attributes
    ----------
    low_m, high_m : float64 [3]
        The box that is cut.
    cuts : (int, int, int)
        Boxes along each axis.
    """

    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]
    cuts: tuple[int, int, int]

    @classmethod
    def of(cls, grid: Grid, other: Grid, most: int) -> SharedBoxes | None:
        """At most so many boxes of `grid`, all of which hold samples of both lattices, or None for fewer than 8.

        They are cut again and again across the longest side, while 8 samples of `grid` and 2 of `other` are left
        along it: an axis along which the other has a single sample, as an array of actuators has, is not cut.

        Parameters
        ----------
        grid, other : Grid
            Of one space.
        most : int
        """
        low, high = grid.box_m
        inside = [
            int(((x >= lo) & (x < hi)).sum()) for x, lo, hi in zip(_along_m(other), low, high, strict=True)
        ]  # samples of the other along each axis
        room = [
            max(1, min(n // LEAST_SAMPLES[0], m // LEAST_SAMPLES[1])) for n, m in zip(grid.shape, inside, strict=True)
        ]
        cuts = [1, 1, 1]
        while True:
            sides = (high - low) / cuts
            open_ = [
                a
                for a in np.argsort(sides)[::-1]
                if cuts[a] < room[a] and math.prod(cuts) // cuts[a] * (cuts[a] + 1) <= most
            ]
            if not open_:
                break
            cuts[open_[0]] += 1
        found = cls(low, high, (cuts[0], cuts[1], cuts[2]))
        both = (found.voxels(grid) > 0) & (found.voxels(other) > 0)
        return found if found.count >= LEAST_BLOCKS and both.all() else None

    @property
    def count(self) -> int:
        """B."""
        return math.prod(self.cuts)

    def owner(self, grid: Grid, bricks: NDArray[np.int32]) -> Int64s:
        """The box of each sample of bricks of a lattice, int64 [m, 512], of int32 [m, 3]."""
        x, y, z = (
            np.pad(o, (0, -len(o) % BRICK)).reshape(-1, BRICK)[b]
            for o, b in zip(self._along(grid), bricks.T, strict=True)
        )
        owner = (x[:, :, None, None] * self.cuts[1] + y[:, None, :, None]) * self.cuts[2] + z[:, None, None, :]
        flat: Int64s = owner.reshape(len(bricks), -1)
        return flat

    def voxels(self, grid: Grid) -> Int64s:
        """Samples of a lattice in each box, int64 [B]."""
        x, y, z = (np.bincount(o, minlength=n) for o, n in zip(self._along(grid), self.cuts, strict=True))
        samples: Int64s = (x[:, None, None] * y[:, None] * z).reshape(-1)
        return samples

    def _along(self, grid: Grid) -> list[Int64s]:
        """For each axis the cut that each sample lies in."""
        axes = zip(_along_m(grid), self.low_m, self.high_m, self.cuts, strict=True)
        return [np.clip((x - lo) / (hi - lo) * n, 0, n - 1).astype(np.int64) for x, lo, hi, n in axes]


def shared_counts(
    fields: tuple[Fields, Fields], grids: tuple[Grid, Grid], histograms: tuple[Histogram, Histogram], most: int = 64
) -> tuple[Int64s, Int64s] | None:
    """The counts over "voxel" of two media in the same boxes of space, for a bootstrap of both together.

    Parameters
    ----------
    fields : two of FieldSymbols or a sequence of them
        A medium, and what is rendered of it, frame by frame. Each frame is asked for once, those of the medium first.
    grids : (Grid, Grid)
        Their lattices in one space, such as hand metres.
    histograms : (Histogram, Histogram)
        Of all voxels of all frames of each.
    most : int
        Boxes that are wanted. Fewer are made where 2^24 counts would not hold them.

    Returns
    -------
    (int64 [B, K], int64 [B, K']), or None
        None where there would be fewer than 8 boxes, or one of them held samples of one lattice alone.

    Raises
    ------
    InvalidArgument
        If there are not as many frames of each, or a histogram is not that of the frames.
    """
    frames = Frames(fields[0], "medium"), Frames(fields[1], "rendered")
    if frames[0].count != frames[1].count:
        raise InvalidArgument("rendered", f"{frames[1].count} frames", f"{frames[0].count}, as many as the medium")
    cells = sum(len(h.counts) for h in histograms)
    boxes = SharedBoxes.of(*grids, min(most, MOST_BLOCK_CELLS // cells))
    if boxes is None:
        return None
    first, second = (_counts(f, g, h, boxes) for f, g, h in zip(frames, grids, histograms, strict=True))
    return first, second


def _counts(frames: Frames, grid: Grid, histogram: Histogram, boxes: SharedBoxes) -> Int64s:
    from touchfield.measure.kernels.count import add_counts

    k = len(histogram.counts)
    out = np.zeros((boxes.count, k), np.int64)
    for bricks, symbols in frames.parts():
        held = symbols != 0
        cells = np.searchsorted(histogram.symbols, symbols[held])
        if (cells == k).any():  # beyond the table
            raise frames_changed()
        add_counts(boxes.owner(grid, bricks)[held] * k + cells, out.reshape(-1))
    if histogram.symbols[0] == 0:
        out[:, 0] = boxes.voxels(grid) * frames.count - out[:, 1:].sum(axis=1)
    if not np.array_equal(out.sum(axis=0), histogram.counts):
        raise frames_changed()
    return out


def _along_m(grid: Grid) -> Sequence[NDArray[np.float64]]:
    """Where the samples lie along each axis, metres."""
    return [
        o + h * np.arange(n, dtype=np.float64)
        for o, h, n in zip(grid.origin_m, grid.spacing_m, grid.shape, strict=True)
    ]
