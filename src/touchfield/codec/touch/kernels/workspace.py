"""Workspaces of a pass: what a frame is walked by, the law it follows, and the room that its kernels work in."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = [
    "ALTERNATIVES", "APART", "AXES", "BASE", "BLEND", "CENTRE", "CLASSES", "EXPECTED", "FEATURE", "FEATURES", "LAST",
    "OTHER", "SIDES", "STEPS", "VECTOR", "Law", "Scan", "Work", "fresh_work",
]  # fmt: skip

FEATURES = 13
"""Differences of neighbours that the blend is made of."""

CLASSES = 16
"""Sets of weights of the blend: which neighbours across a face hold a force, and whether the reference does."""

ALTERNATIVES = 4
"""Other predictions, of which the contexts of a residual know how far they lie from its centre."""

_CELLS = 12**3

EXPECTED, BLEND, BASE, LAST, OTHER, APART, CENTRE, AXES, STEPS, VECTOR, SIDES, FEATURE = (
    0, 1, 2, 3, 4, 5, 6, 7, 10, 11, 12, 12 + ALTERNATIVES,
)  # fmt: skip
ROWS = FEATURE + FEATURES
"""Rows of a workspace, three whole numbers each, units: the two opinions; what the weights correct; the vector
decoded last; room for another one; from what is taken to the other opinion; what the residual is about; its three
axes, 1/16384; the residual, and the vector that it makes; classes of the distances of other predictions from the
centre along the axes; and the features of the blend, 1/256 steps."""


class Scan(NamedTuple):
    """Bricks of a frame in the order and the coordinates of its scan.

    Attributes
    ----------
    near : int64 [n, 13]
        Slots of the bricks around that come before, -1 for none.
    around : int64 [n, 27]
        Slots of the reference's bricks here and around, -1 for none; [0, 27] without a reference.
    low, high : int64 [n, 3]
        Samples within the grid, from low to below high.
    reference : int32 [m, 512, 3]
        Vectors of the reference, units.
    cells : int32 [n, 512, 8]
        Takes what is decoded; see `window`.
    """

    near: Int64s
    around: Int64s
    low: Int64s
    high: Int64s
    reference: NDArray[np.int32]
    cells: NDArray[np.int32]


class Law(NamedTuple):
    """The force law of a frame, and its lattice.

    Attributes
    ----------
    slope : int64 [3]
        Units that the length loses in a step along each axis of the scan where the force points along it.
    floor, rate, cross_floor, cross_rate : int
        See `touchfield.codec.touch.lattice.Lattice`.
    border, first : int64
        The table of warped lengths, and where to look in it; see `touchfield.codec.touch.lattice.warp_of`.
    """

    slope: Int64s
    floor: int
    rate: int
    cross_floor: int
    cross_rate: int
    border: Int64s
    first: Int64s


class Work(NamedTuple):
    """Room to work in, and the weights of the blend.

    Attributes
    ----------
    window : int32 [12 * 12 * 12 * 8]
    old : int32 [12 * 12 * 12 * 4]
        The window's cells of the reference.
    weights : int64 [CLASSES, FEATURES]
        Of the blend, 1/65536; kept from frame to frame of a segment.
    rows : int64 [ROWS, 3]
        Vectors, by the names above.
    of : int64 [16]
        Numbers, by the names in `residual` and `predict`.
    """

    window: NDArray[np.int32]
    old: NDArray[np.int32]
    weights: Int64s
    rows: Int64s
    of: Int64s


def fresh_work(weights: Int64s) -> Work:
    """Room for a pass that goes on from these weights, and changes them."""
    cells = np.zeros(_CELLS * 8, np.int32), np.zeros(_CELLS * 4, np.int32)
    return Work(*cells, weights, np.zeros((ROWS, 3), np.int64), np.zeros(16, np.int64))
