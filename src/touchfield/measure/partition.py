"""Adaptive workspace partitioning: the best division into dyadic boxes (paper section 4).

"Optimal adaptive workspace partitioning in disjoint subspaces so as to minimize information loss taking into account
the rendering device". Each box fills the device's own lattice, so that a small box is rendered finely and a large one
coarsely. More boxes lose less and cost more: each one is another view that the hand must be taken to. What is
minimised is

    J = sum of the losses of the boxes + lambda * number of boxes,

lambda in bits a box. J is a sum over boxes, so that the best division of a box is the box itself or the best
divisions of its children, whichever is less: pruning from the smallest boxes up finds the optimum among all dyadic
divisions. Of equal ones it takes the fewer boxes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.box_losses import DyadicLattice
from touchfield.medium.grid import Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["DyadicBox", "Partition", "optimal_partition"]


@dataclass(frozen=True)
class DyadicBox:
    """One box of a partition.

    Attributes
    ----------
    depth : int
        How often the workspace was halved along each axis.
    index : (int, int, int)
        Which of the 2^depth boxes along each axis.
    lost_bits : float
        What the device leaves out of it, bits a frame.
    """

    depth: int
    index: tuple[int, int, int]
    lost_bits: float


@dataclass(frozen=True)
class Partition:
    """Disjoint boxes that cover the workspace, in ascending order of depth and index.

    Attributes
    ----------
    lattice : DyadicLattice
    penalty_bits : float
        lambda, bits a box.
    boxes : tuple of DyadicBox
    """

    lattice: DyadicLattice
    penalty_bits: float
    boxes: tuple[DyadicBox, ...]

    @property
    def lost_bits(self) -> float:
        """Of all boxes, bits a frame."""
        return math.fsum(b.lost_bits for b in self.boxes)

    @property
    def cost_bits(self) -> float:
        """J."""
        return self.lost_bits + self.penalty_bits * len(self.boxes)

    def grid(self, box: DyadicBox) -> Grid:
        """The device's lattice in a box, metres of the hand."""
        return self.lattice.box_grid(box.depth, box.index)

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        depths = [b.depth for b in self.boxes]
        return {
            "boxes": len(self.boxes),
            "boxes_by_depth": {d: depths.count(d) for d in sorted(set(depths))},
            "lost_bits_per_frame": self.lost_bits,
            "penalty_bits_per_box": self.penalty_bits,
            "cost_bits": self.cost_bits,
            "device_shape": list(self.lattice.device_shape),
        }


def optimal_partition(lattice: DyadicLattice, losses: Sequence[Float64s], penalty_bits: float) -> Partition:
    """The partition with the least J.

    Parameters
    ----------
    lattice : DyadicLattice
    losses : sequence of float64 arrays
        For each depth 0 .. D the loss of its boxes, of shape ``lattice.boxes(d)``, bits a frame (`BoxLosses.bits`).
    penalty_bits : float
        lambda, 0 or more. A greater one never gives more boxes, nor a smaller sum of losses.

    Raises
    ------
    InvalidArgument
        If lambda is negative, or the losses have other shapes or are not finite.
    """
    if not 0 <= penalty_bits < math.inf:
        raise InvalidArgument("penalty_bits", repr(penalty_bits), "bits a box, 0 or more")
    shapes = [lattice.boxes(d) for d in range(lattice.depth + 1)]
    if [np.shape(loss) for loss in losses] != shapes:
        raise InvalidArgument("losses", f"shapes {[np.shape(loss) for loss in losses]}", str(shapes))
    if not all(np.isfinite(loss).all() for loss in losses):
        raise InvalidArgument("losses", "one that is not finite", "finite bits")
    kept: list[NDArray[np.bool_]] = [np.ones(shapes[-1], np.bool_)]
    cost, count = np.asarray(losses[-1], np.float64) + penalty_bits, np.ones(shapes[-1], np.int64)
    for d in reversed(range(lattice.depth)):
        alone = losses[d] + penalty_bits
        parted, parts = _of_children(cost, shapes[d]), _of_children(count, shapes[d])
        whole = alone <= parted
        kept.insert(0, whole)
        cost, count = np.where(whole, alone, parted), np.where(whole, 1, parts)
    boxes = []
    reached = np.ones(shapes[0], np.bool_)
    for d, whole in enumerate(kept):
        for index in np.argwhere(reached & whole).tolist():
            boxes.append(DyadicBox(d, (index[0], index[1], index[2]), float(losses[d][tuple(index)])))
        if d < lattice.depth:
            reached = _to_children(reached & ~whole, shapes[d + 1])
    assert len(boxes) == int(count.sum())
    return Partition(lattice, float(penalty_bits), tuple(boxes))


def _of_children(values: NDArray[Any], shape: tuple[int, int, int]) -> NDArray[Any]:
    """The sum over the children of each box."""
    bx, by, bz = shape
    nx, ny, nz = values.shape
    total: NDArray[Any] = values.reshape(bx, nx // bx, by, ny // by, bz, nz // bz).sum(axis=(1, 3, 5))
    return total


def _to_children(values: NDArray[np.bool_], shape: tuple[int, int, int]) -> NDArray[np.bool_]:
    for axis in range(3):
        values = np.repeat(values, shape[axis] // values.shape[axis], axis=axis)
    return values
