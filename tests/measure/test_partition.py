"""Workspace partitions: losses of boxes compared with counts of samples, and the optimum with enumeration."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.partition import BoxLosses, DyadicLattice, Partition, optimal_partition
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.partition import partition_workspace

Box = tuple[int, tuple[int, int, int]]


def lattice(
    split: tuple[bool, bool, bool], depth: int, device: tuple[int, int, int] = (2, 3, 1)
) -> DyadicLattice:
    x, y, z = (m << depth if s else m for m, s in zip(device, split, strict=True))
    return DyadicLattice(Grid.over_box((0, 0, 0), (0.16, 0.12, 0.08), (x, y, z)), device)


def divisions(
    lat: DyadicLattice, depth: int = 0, index: tuple[int, int, int] = (0, 0, 0)
) -> Iterator[list[Box]]:
    """Every dyadic division of a box."""
    yield [(depth, index)]
    if depth < lat.depth:
        boxes_here, boxes_below = lat.boxes(depth), lat.boxes(depth + 1)
        steps = [range(b // a) for a, b in zip(boxes_here, boxes_below, strict=True)]
        factor = [b // a for a, b in zip(boxes_here, boxes_below, strict=True)]
        corners = itertools.product(*steps)
        children = [
            list(
                divisions(lat, depth + 1, tuple(i * f + c for i, f, c in zip(index, factor, at, strict=True)))
            )  # type: ignore[arg-type]
            for at in corners
        ]
        for selected in itertools.product(*children):
            yield [box for part in selected for box in part]


def random_losses(lat: DyadicLattice, seed: int, is_rounded: bool = False) -> list[NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    found = [rng.random(lat.boxes(d)) * 8.0 ** -(0.7 * d) * 10 for d in range(lat.depth + 1)]
    return [np.rint(4 * loss) for loss in found] if is_rounded else found


TREES = [
    ((True, True, True), 1),
    ((True, True, True), 2),
    ((True, True, False), 2),
    ((False, True, False), 4),
]


@pytest.mark.parametrize(("split", "depth"), TREES)
def test_optimum_agrees_with_enumeration(split: tuple[bool, bool, bool], depth: int) -> None:
    lat = lattice(split, depth)
    all_divisions = list(divisions(lat))
    for seed, penalty in itertools.product(range(6), (0.0, 0.3, 1.0, 4.0, 100.0)):
        losses = random_losses(lat, seed)
        costs = [sum(losses[d][i] for d, i in boxes) + penalty * len(boxes) for boxes in all_divisions]
        partition = optimal_partition(lat, losses, penalty)
        assert partition.cost_bits == pytest.approx(min(costs), rel=1e-12)
        best = all_divisions[int(np.argmin(costs))]
        assert {(b.depth, b.index) for b in partition.boxes} == set(best)


@given(st.sampled_from(TREES), st.integers(0, 2**32 - 1), st.floats(0, 20), st.floats(0, 20), st.booleans())
def test_boxes_partition_the_grid_and_lambda_is_monotone(
    tree: Any, seed: int, first: float, second: float, is_rounded: bool
) -> None:
    lat = lattice(*tree)
    losses = random_losses(lat, seed, is_rounded)
    coarse, fine = (optimal_partition(lat, losses, p) for p in sorted((first, second), reverse=True))
    for partition in (coarse, fine):
        covered = np.zeros(lat.grid.shape, int)
        for box in partition.boxes:
            covered[slices(partition, box)] += 1
            assert box.loss_bits == losses[box.depth][box.index]
        assert (covered == 1).all()
    assert len(coarse.boxes) <= len(fine.boxes)
    assert coarse.loss_bits >= fine.loss_bits - 1e-9


def slices(partition: Partition, box: Any) -> tuple[slice, ...]:
    """The fine samples of a box, from the metres of its lattice."""
    low, high = (partition.lattice.grid.to_index(edge) + 0.5 for edge in partition.grid(box).box_m)
    assert np.abs(low - np.rint(low)).max() < 1e-6 and np.abs(high - np.rint(high)).max() < 1e-6
    return tuple(
        slice(a, b) for a, b in zip(np.rint(low).astype(int), np.rint(high).astype(int), strict=True)
    )


def test_each_box_has_the_shape_of_the_device() -> None:
    lat = lattice((True, True, False), 3, (4, 2, 5))
    partition = optimal_partition(lat, random_losses(lat, 1), 0.05)
    assert len({b.depth for b in partition.boxes}) > 1
    for box in partition.boxes:
        grid = partition.grid(box)
        assert grid.shape == (4, 2, 5)
        extent = np.subtract(*reversed(lat.grid.box_m)) / [2**box.depth, 2**box.depth, 1]
        np.testing.assert_allclose(np.subtract(*reversed(grid.box_m)), extent)
    summary = partition.summary()
    assert sum(summary["boxes_by_depth"].values()) == summary["boxes"] == len(partition.boxes)
    assert summary["lost_bits_per_frame"] == partition.loss_bits < summary["cost_bits"] == partition.cost_bits
    assert summary["device_shape"] == [4, 2, 5]


def test_fewer_boxes_win_ties() -> None:
    lat = lattice((True, True, True), 2)
    none = [np.zeros(lat.boxes(d)) for d in range(3)]
    assert len(optimal_partition(lat, none, 0.0).boxes) == 1


# -- losses ------------------------------------------------------------------------------------------------


def conditional_bits(pairs: list[tuple[int, int]]) -> float:
    """n H(S|K) of pairs (k, s), by definition."""
    joint, counts_k = Counter(pairs), Counter(k for k, _ in pairs)
    return -sum(c * np.log2(c / counts_k[k]) for (k, _), c in joint.items())


def test_losses_are_conditional_entropies_of_samples() -> None:
    lat = lattice((True, True, False), 3, (3, 2, 5))
    losses, rng = BoxLosses(lat), np.random.default_rng(0)
    frames = []
    for _ in range(3):
        frames.append([])
        for d in range(4):
            grid = lat.lattice(d)
            dense = rng.integers(0, 4, grid.shape) * (rng.random(grid.shape) < 0.3)
            frames[-1].append(dense)
        losses.add([FieldSymbols.from_dense(lat.lattice(d), s, 4, "q") for d, s in enumerate(frames[-1])])
    bits = losses.bits()
    for d in range(4):
        for index in np.ndindex(lat.boxes(d)):
            pairs: list[tuple[int, int]] = []
            for levels in frames:
                fine = levels[3] if d < 3 else levels[d]
                ratio = np.array(fine.shape) // np.array(levels[d].shape)
                for cell in np.ndindex(3, 2, 5):
                    at = np.multiply(index, (3, 2, 5)) + cell
                    part = fine[tuple(slice(a * r, (a + 1) * r) for a, r in zip(at, ratio, strict=True))]
                    pairs += [(int(levels[d][tuple(at)]), int(s)) for s in part.ravel()]
            assert bits[d][index] == pytest.approx(conditional_bits(pairs) / 3, abs=1e-9)
    assert bits[0][0, 0, 0] > 0 and not bits[3].any()


def test_empty_workspace_has_no_loss() -> None:
    lat = lattice((True, True, True), 2)
    losses = BoxLosses(lat)
    losses.add(
        [
            FieldSymbols.from_dense(lat.lattice(d), np.zeros(lat.lattice(d).shape, int), 9, "q")
            for d in range(3)
        ]
    )
    assert not any(loss.any() for loss in losses.bits())


# -- media -------------------------------------------------------------------------------------------------


def corner_medium(frames: int = 2) -> HapticMedium:
    """Rough forces in one corner, a constant force in the opposite one, and empty space between."""
    grid = Grid.over_box((-0.08,) * 3, (0.08,) * 3, (32, 32, 32))
    fields = []
    for t in range(frames):
        forces = np.zeros((32, 32, 32, 3), np.float32)
        forces[:8, :8, :8] = np.random.default_rng(t).normal(size=(8, 8, 8, 3))
        forces[16:, 16:, 16:] = (0.0, 0.0, 1.0)
        fields.append(ForceField.from_dense(grid, forces))
    return HapticMedium.from_frames(fields, 25.0)


def test_small_boxes_are_at_fine_detail() -> None:
    medium = corner_medium()
    partition = partition_workspace(medium, (4, 4, 4), penalty_bits=50.0)
    rough = [b for b in partition.boxes if all(i < (8 << b.depth) / 32 for i in b.index)]
    assert max(b.depth for b in partition.boxes) == 3
    assert {b.depth for b in partition.boxes if b not in rough} == {1, 2}
    assert len(rough) == 8 and partition.loss_bits == 0.0
    assert len(partition.boxes) == 7 + 7 + 8
    # full depth everywhere has no loss either, but 512 boxes
    expensive = partition_workspace(medium, (4, 4, 4), penalty_bits=1e6)
    assert len(expensive.boxes) == 1 and expensive.loss_bits > 1000


def test_the_same_partition_for_any_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    partitions = []
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        partitions.append(partition_workspace(corner_medium(), (8, 8, 8), 20.0))
    assert partitions[0] == partitions[1]


def test_medium_on_the_lattice_of_the_device_is_one_box() -> None:
    partition = partition_workspace(corner_medium(1), (32, 32, 32), 0.0)
    assert len(partition.boxes) == 1 and partition.loss_bits == 0.0
    assert partition.grid(partition.boxes[0]) == partition.lattice.grid


def test_invalid_arguments_are_refused() -> None:
    grid = Grid((32, 32, 32), (1, 1, 1), (0, 0, 0))
    for device in ((32, 16, 8), (5, 32, 32), (64, 32, 32), (0, 1, 1), (12, 12, 12)):
        with pytest.raises(InvalidArgument, match=r"grid to partition|device_shape"):
            DyadicLattice(grid, device)
    with pytest.raises(InvalidArgument, match="D up to 7"):
        DyadicLattice(Grid((256, 1, 1), (1, 1, 1), (0, 0, 0)), (1, 1, 1))
    lat = lattice((True, True, True), 1)
    for penalty in (-1.0, float("nan"), float("inf")):
        with pytest.raises(InvalidArgument, match="penalty_bits"):
            optimal_partition(lat, random_losses(lat, 0), penalty)
    with pytest.raises(InvalidArgument, match="shapes"):
        optimal_partition(lat, random_losses(lat, 0)[:1], 1.0)
    with pytest.raises(InvalidArgument, match="not finite"):
        optimal_partition(lat, [np.full(lat.boxes(d), np.nan) for d in range(2)], 1.0)
    with pytest.raises(InvalidArgument, match="no frame"):
        BoxLosses(lat).bits()
    symbols = [
        FieldSymbols.from_dense(lat.lattice(d), np.zeros(lat.lattice(d).shape, int), 2, "q") for d in range(2)
    ]
    with pytest.raises(InvalidArgument, match="dyadic lattice"):
        BoxLosses(lat).add(symbols[::-1])
    symbols = [
        [FieldSymbols.from_dense(s.grid, s.to_dense(), *q) for s in symbols]
        for q in ((2, "p"), (1 << 30, "q"))
    ]
    losses = BoxLosses(lat)
    losses.add(symbols[0])
    with pytest.raises(InvalidArgument, match="several quantisers"):
        losses.add([FieldSymbols.from_dense(s.grid, s.to_dense(), 2, "q") for s in symbols[0]])
    with pytest.raises(InvalidArgument, match="coarser quantiser"):
        BoxLosses(lat).add(symbols[1])
    with pytest.raises(InvalidArgument, match="distinct"):
        partition_workspace(corner_medium(1), (8, 8, 8), 1.0, "distinct")
