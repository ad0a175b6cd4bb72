"""Voxel and object entropy from one count: the same as from separate counts, with fewer passes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from touchfield.errors import InvalidArgument
from touchfield.measure.field_count import field_counts, field_entropy
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.information import entropy
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.grid import Grid
from touchfield.tasks.measure import MeasureSpec, measure_medium

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")
GRID = Grid((33, 20, 41), (1e-3,) * 3, (0, 0, 0))


def frame(seed: int, alphabet: int, full: bool = False) -> FieldSymbols:
    rng = np.random.default_rng(seed)
    dense = rng.integers(0, 9, GRID.shape) * (rng.random(GRID.shape) < 0.2) + full
    return FieldSymbols.from_dense(GRID, dense, alphabet, "a Q")


class CountingFrames(Sequence[FieldSymbols]):
    def __init__(self, frames: list[FieldSymbols]) -> None:
        self.frames, self.times = frames, [0] * len(frames)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: Any) -> Any:
        self.times[index] += 1
        return self.frames[index]


@pytest.mark.parametrize("alphabet", [12, 1 << 20])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("interval", [False, True])
def test_one_count_gives_every_entropy(alphabet: int, full: bool, interval: bool) -> None:
    frames = [frame(n, alphabet, full) for n in range(3)]
    lazy = CountingFrames(frames)
    counts = field_counts(lazy, interval=interval)
    assert lazy.times == [1 + interval] * 3
    for over in ("voxel", "object"):
        for estimator in ("plug-in", "miller-madow"):
            separate = field_entropy(frames, over, estimator=estimator, interval=interval)
            assert entropy(counts[over], estimator=estimator) == separate
            assert (separate.dependence is not None) == interval
        plain = field_entropy(frames, over, interval=False)
        assert entropy(counts[over], interval=False) == plain


def test_empty_fields_have_voxels_and_no_object() -> None:
    empty = FieldSymbols.from_dense(GRID, np.zeros(GRID.shape, int), 9, "a Q")
    counts = field_counts([empty, empty])
    assert entropy(counts["voxel"]).value == 0
    with pytest.raises(InvalidArgument, match="no sample"):
        entropy(counts["object"])
    with pytest.raises(InvalidArgument, match="no voxel with a force"):
        field_entropy([empty, empty], "object")


def test_measurement_computes_each_frame_few_times(wavy_field: ForceField) -> None:
    """Passes to fit Q, to count, to count the blocks, and two for time; one more frame for the energy."""
    calls = [0] * 6

    def make(i: int) -> ForceField:
        calls[i] += 1
        return wavy_field.scaled(1.0 if i == 4 else 0.01 + 0.1 * i)

    medium = HapticMedium(wavy_field.grid, 30.0, 6, make)
    found = measure_medium(medium, MeasureSpec(limits=False))
    assert max(calls) <= 6 and sum(calls) <= 5 * 6 + 1
    assert found.corrected.value > found.voxel.value and found.corrected.interval is None
    symbols = found.object.samples
    assert found.supported_voxels == symbols and found.voxel.samples == 6 * wavy_field.grid.voxel_count
