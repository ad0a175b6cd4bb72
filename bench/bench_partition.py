"""Compares the division of a workspace by `touchfield partition` with uniform divisions and with an octree.

    python bench/bench_partition.py [--quick] [--nw N]

A device has 16 samples along each axis (8 in quick runs), a quarter of the lattice's. There are three ways to
divide the workspace of a medium for a penalty lambda, in bits per box:

* optimal: `touchfield partition`, the least objective J = bits lost + lambda * boxes among dyadic divisions.
* uniform: all boxes of one depth; the depth with the least J.
* octree: from one box on, the box with the most supported voxels is divided, as long as there are no more
  boxes than the optimal division has.

"bits" are J. "beyond" are the voxels at which a box's cell differs from the medium by more than max(F_0, k
|F|), over the supported voxels; k = 0.1, F_0 = 0.05 N. J counts information and not what a hand feels.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from machine import Bar, Figures, at_most, bench, column
from touchfield import EncodeSpec, prepare
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.filters import resample
from touchfield.filters.limit import limit_forces
from touchfield.measure.partition import BoxLosses, DyadicLattice, optimal_partition
from touchfield.medium import ForceField, HapticMedium

K, F0_N, DEPTH = 0.1, 0.05, 2
PENALTIES = (100.0, 1000.0, 10_000.0)
SOURCES = ("sample:terrain", "sample:motorcycle", "sample:shapes")
QUANTISER = "weber:0.25/ico1"

Float64s = NDArray[np.float64]
Box = tuple[int, tuple[int, int, int]]
"""Depth and index of a box."""


def levels_of(field: ForceField, lattice: DyadicLattice) -> list[ForceField]:
    """Return a field on the device's lattice at each depth; the last one is the field itself."""
    coarse = [resample(field, lattice.lattice(d), "box") for d in range(lattice.depth)]
    return [*coarse, field]


def losses_of(medium: HapticMedium, lattice: DyadicLattice) -> tuple[Float64s, ...]:
    """Return the bits lost by each box of each depth."""
    quantise, losses = FieldQuantiserSpec.parse(QUANTISER).fit(medium), BoxLosses(lattice)
    losses.add([quantise(limit_forces(level, quantise.top_n)) for level in levels_of(medium[0], lattice)])
    return losses.bits()


def octree(field: ForceField, lattice: DyadicLattice, count: int) -> list[Box]:
    """Divide the box with the most supported voxels, until there would be more than `count` boxes."""
    supported = np.zeros(field.grid.shape, np.int64)
    supported[tuple(field.positions().T)] = 1
    counts = []
    for depth in range(lattice.depth + 1):
        boxes = lattice.boxes(depth)
        split = [part for n, m in zip(field.grid.shape, boxes, strict=True) for part in (m, n // m)]
        counts.append(supported.reshape(split).sum(axis=(1, 3, 5)))
    leaves: list[Box] = [(0, (0, 0, 0))]
    while divisible := [box for box in leaves if box[0] < lattice.depth]:
        depth, index = max(divisible, key=lambda box: int(counts[box[0]][box[1]]))
        factors = [b // a for a, b in zip(lattice.boxes(depth), lattice.boxes(depth + 1), strict=True)]
        children = [tuple(np.multiply(index, factors) + corner) for corner in np.ndindex(*factors)]
        if len(leaves) - 1 + len(children) > count:
            break
        leaves.remove((depth, index))
        leaves += [(depth + 1, (int(x), int(y), int(z))) for x, y, z in children]
    return leaves


def beyond(levels: list[ForceField], lattice: DyadicLattice, boxes: Iterable[Box]) -> float:
    """Return the fraction of supported voxels that the boxes render beyond the mask."""
    field = levels[-1].to_dense().astype(np.float64)
    rendered = np.empty_like(field)
    for depth, index in boxes:
        sides = [n // m for n, m in zip(field.shape[:3], lattice.boxes(depth), strict=True)]
        part = tuple(slice(i * side, (i + 1) * side) for i, side in zip(index, sides, strict=True))
        shape = levels[depth].grid.shape
        cells = [
            np.arange(s.start, s.stop) * n // m for s, n, m in zip(part, shape, field.shape, strict=False)
        ]
        rendered[part] = levels[depth].to_dense()[np.ix_(*cells)]
    size = np.linalg.norm(field, axis=-1)
    is_beyond = np.linalg.norm(rendered - field, axis=-1) > np.maximum(F0_N, K * size)
    return float(is_beyond.sum() / (size > 0).sum())


def rows_of(source: str, nw: int) -> dict[str, Figures]:
    """Return a row for each penalty."""
    medium = prepare(source, EncodeSpec(nw=nw, representation="voxel")).medium[0:1]
    x, y, z = (n >> DEPTH for n in medium.grid.shape)
    lattice = DyadicLattice(medium.grid, (x, y, z))
    losses, levels, rows = losses_of(medium, lattice), levels_of(medium[0], lattice), {}
    for penalty in PENALTIES:
        best = optimal_partition(lattice, losses, penalty)
        uniform = [float(loss.sum()) + penalty * loss.size for loss in losses]
        depth = int(np.argmin(uniform))
        by_support = octree(medium[0], lattice, len(best.boxes))
        support_bits = sum(float(losses[d][index]) for d, index in by_support) + penalty * len(by_support)
        everywhere: list[Box] = [(depth, (i, j, k)) for i, j, k in np.ndindex(*lattice.boxes(depth))]
        rows[f"{source}, {penalty:g} bits a box"] = {
            "boxes": len(best.boxes),
            "bits": best.cost_bits,
            "uniform bits": uniform[depth],
            "octree bits": support_bits,
            "beyond": beyond(levels, lattice, [(box.depth, box.index) for box in best.boxes]),
            "uniform beyond": beyond(levels, lattice, everywhere),
            "octree beyond": beyond(levels, lattice, by_support),
        }
    return rows


def measure(nw: int) -> Figures:
    """Measure every source and penalty."""
    return {"divisions": {name: row for source in SOURCES for name, row in rows_of(source, nw).items()}}


def bars(figures: Figures) -> list[Bar]:
    """Require no greater objective than the others', and no more voxels beyond than the octree leaves."""
    rows = list(figures["divisions"].values())
    return [
        at_most("objective over that of the best uniform division, worst", max(
            row["bits"] / row["uniform bits"] for row in rows), 1.0),
        at_most("objective over that of the octree, worst", max(
            row["bits"] / row["octree bits"] for row in rows), 1.0),
        at_most("voxels beyond the mask less those of an octree of as many boxes, mean", float(
            np.mean(column(rows, "beyond")) - np.mean(column(rows, "octree beyond"))), 0.0),
    ]  # fmt: skip


if __name__ == "__main__":
    bench("partition", __doc__, measure, bars, nw=(6, 5))
