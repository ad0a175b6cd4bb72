"""Boxes that two lattices share: each sample in one box, counts of both, and too little overlap."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.measure.counts import Counts
from touchfield.measure.field_count import Boxes, shared_boxes, shared_counts
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.medium.grid import Grid

GRID = Grid.over_box((-0.04, -0.03, 0.0), (0.04, 0.03, 0.03), (40, 30, 17))
COARSE = Grid.over_box((-0.04, -0.03, 0.0), (0.04, 0.03, 0.03), (16, 9, 6))
ARRAY = Grid.over_box((-0.05, -0.05, -0.01), (0.05, 0.05, 0.05), (20, 20, 1))


def symbols(grid: Grid, seed: int, alphabet: int = 5) -> NDArray[np.int64]:
    rng = np.random.default_rng(seed)
    return rng.integers(0, alphabet, grid.shape) * (rng.random(grid.shape) < 0.3)


def field(grid: Grid, dense: NDArray[np.int64], alphabet: int = 5) -> FieldSymbols:
    return FieldSymbols.from_dense(grid, dense, alphabet, "a Q")


def box_of_each_sample(boxes: Boxes, grid: Grid) -> NDArray[np.int64]:
    """The box of each sample by its position, int64 [nx, ny, nz]."""
    index = np.moveaxis(np.indices(grid.shape), 0, -1)
    at = np.asarray(grid.origin_m) + index * np.asarray(grid.spacing_m)
    edges = [np.linspace(lo, hi, n + 1)[1:-1] for lo, hi, n in zip(*GRID.box_m, boxes.cuts)]
    x, y, z = (np.searchsorted(e, at[..., a], side="right") for a, e in enumerate(edges))
    return np.asarray((x * boxes.cuts[1] + y) * boxes.cuts[2] + z)


@pytest.mark.parametrize("other", [COARSE, ARRAY, GRID])
def test_counts_agree_with_the_samples_of_each_box(other: Grid) -> None:
    dense = [[symbols(g, s + n) for n in range(3)] for s, g in ((0, GRID), (50, other))]
    histograms = Counts.of(np.stack(dense[0])), Counts.of(np.stack(dense[1]))
    frames = [field(GRID, d) for d in dense[0]], [field(other, d) for d in dense[1]]
    found = shared_counts(frames, (GRID, other), histograms)
    both = shared_boxes(GRID, other, 64)
    assert found is not None and both is not None
    for counts, histogram, boxes, grid, arrays in zip(found, histograms, both, (GRID, other), dense):
        owner = box_of_each_sample(boxes, grid)
        assert 8 <= boxes.count <= 64
        assert np.array_equal(boxes.voxels, np.bincount(owner.ravel(), minlength=boxes.count))
        want = [[sum(int(((d == s) & (owner == b)).sum()) for d in arrays) for s in histogram.cells[:, 0]]
                for b in range(boxes.count)]  # fmt: skip
        assert np.array_equal(counts.blocks, want)


def test_a_frame_that_is_full_has_no_symbol_of_empty_space() -> None:
    full = symbols(GRID, 1) + 1
    histogram = Counts.of(full)
    found = shared_counts((field(GRID, full, 6), field(GRID, full, 6)), (GRID, GRID), (histogram, histogram))
    assert found is not None and found[0].blocks is not None
    assert np.array_equal(found[0].blocks.sum(axis=0), histogram.weights)
    assert np.array_equal(found[0].blocks, found[1].blocks)


@given(st.lists(st.integers(1, 60), min_size=6, max_size=6), st.integers(8, 80))
def test_boxes_have_enough_samples_of_both(sizes: list[int], max_boxes: int) -> None:
    low, high = (-0.02, 0.01, 0.0), (0.03, 0.05, 0.04)
    first, second = (Grid.over_box(low, high, (a, b, c)) for a, b, c in (sizes[:3], sizes[3:]))
    both = shared_boxes(first, second, max_boxes)
    if both is None:
        return
    assert both[0].cuts == both[1].cuts
    for n, m, cuts in zip(first.shape, second.shape, both[0].cuts):
        assert cuts == 1 or (n >= 8 * cuts and m >= 2 * cuts)
    for grid, boxes in zip((first, second), both):
        assert 8 <= boxes.count <= max_boxes
        assert boxes.voxels.sum() == grid.voxel_count and boxes.voxels.min() > 0


def test_arrays_are_not_divided_along_their_pooled_depth() -> None:
    both = shared_boxes(GRID, ARRAY, 64)
    assert both is not None and both[0].cuts[2] == 1 and min(both[0].cuts[:2]) > 1


@pytest.mark.parametrize(
    "other",
    [
        Grid.over_box((-0.01, -0.01, 0.01), (0.01, 0.01, 0.02), (40, 30, 17)),  # a window in the centre
        Grid.over_box((1.0, 1.0, 1.0), (1.1, 1.1, 1.1), (40, 30, 17)),  # disjoint
        Grid.over_box((-0.04, -0.03, 0.0), (0.04, 0.03, 0.03), (2, 2, 1)),  # four actuators
    ],
)
def test_lattices_with_too_little_overlap(other: Grid) -> None:
    assert shared_boxes(GRID, other, 64) is None
    dense = symbols(GRID, 1), symbols(other, 2)
    histograms = Counts.of(dense[0]), Counts.of(dense[1])
    assert shared_counts((field(GRID, dense[0]), field(other, dense[1])), (GRID, other), histograms) is None


def test_many_symbols_give_fewer_boxes(monkeypatch: pytest.MonkeyPatch) -> None:
    dense = symbols(GRID, 1)
    histogram, f = Counts.of(dense), field(GRID, dense)
    monkeypatch.setattr("touchfield.measure.field_count.MAX_BLOCK_CELLS", 12 * 10)
    found = shared_counts((f, f), (GRID, GRID), (histogram, histogram))
    assert found is not None and found[0].blocks is not None
    assert 8 <= len(found[0].blocks) <= 12
    monkeypatch.setattr("touchfield.measure.field_count.MAX_BLOCK_CELLS", 7 * 10)
    assert shared_counts((f, f), (GRID, GRID), (histogram, histogram)) is None


def test_mismatched_frames_are_refused() -> None:
    dense = symbols(GRID, 1)
    f, histogram = field(GRID, dense), Counts.of(dense)

    def ask(first: Any, second: Any, counted: Counts) -> object:
        return shared_counts((first, second), (GRID, GRID), (histogram, counted))

    with pytest.raises(InvalidArgument, match="rendered: found 1 frames; expected 2"):
        ask([f, f], f, histogram)
    for other in (Counts.of(dense[dense < 4]), Counts.of(np.append(dense, 4))):
        with pytest.raises(InvalidArgument, match="frames stay the same"):
            ask(f, f, other)
