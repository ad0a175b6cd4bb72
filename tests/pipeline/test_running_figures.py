"""Figures that accumulate by segment: sums, largest ratios and unknown ones, in any order."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from touchfield.codec.segment import MaxError, max_error_keys
from touchfield.codec.touch.spec import TouchSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid
from touchfield.network.live import LiveSegment
from touchfield.pipeline import tiles
from touchfield.tasks.live import Sent

RATIOS = (0.25, 0.875, 0.5)
ORDERS = list(permutations(RATIOS))
GRID = Grid((8, 8, 8), (0.01,) * 3, (0.0,) * 3)


@pytest.mark.parametrize("ratios", [*ORDERS, *permutations((0.875, None, 0.0))], ids=str)
def test_a_broadcast_counts_every_segment_and_has_their_largest_ratio(
    ratios: tuple[float | None, ...],
) -> None:
    sent = Sent()
    for i, ratio in enumerate(ratios):
        segment = LiveSegment(7 * sent.frames, 2 + i, bytes(10 + i), bytes(100) if i == 1 else None)
        sent.add(segment, None if ratio is None else MaxError(ratio, 0, (0, 0, 0)))
    assert (sent.segments, sent.frames, sent.sent_bytes) == (3, 2 + 3 + 4, 10 + 11 + 12 + 100)
    assert sent.worst_mask_ratio == 0.875


@pytest.mark.parametrize("ratios", ORDERS, ids=str)
def test_a_file_has_the_largest_ratio_of_its_segments_and_its_index(ratios: tuple[float, ...]) -> None:
    found = max_error_keys((5 * i, MaxError(ratio, 2, (i, 1, 0))) for i, ratio in enumerate(ratios))
    at = ratios.index(0.875)
    assert (found["worst_mask_ratio"], found["promise_kept"]) == (0.875, True)
    assert (found["worst_frame"], found["worst_voxel"]) == (5 * at + 2, [at, 1, 0])


@pytest.mark.parametrize("at", range(3))
def test_the_ratio_of_a_file_with_an_unknown_segment_is_unknown(at: int) -> None:
    segments = [None if i == at else MaxError(ratio, 0, (0, 0, 0)) for i, ratio in enumerate(RATIOS)]
    assert set(max_error_keys((i, worst) for i, worst in enumerate(segments)).values()) == {None}
    ratios = [None if i == at else ratio for i, ratio in enumerate(RATIOS)]
    assert tiles._error_bound(TouchSpec(), ratios)["worst_mask_ratio"] is None


@pytest.mark.parametrize("ratios", ORDERS, ids=str)
def test_a_store_has_the_largest_ratio_of_its_tiles(ratios: tuple[float, ...]) -> None:
    assert tiles._error_bound(TouchSpec(), ratios)["worst_mask_ratio"] == 0.875


@pytest.mark.parametrize("order", list(permutations(range(3))), ids=str)
def test_a_comparison_has_the_largest_ratio_of_its_frames_and_the_sums_of_all(order: tuple[int, ...]) -> None:
    errors_n = (0.1, 0.5, 0.3)
    meter = FidelityMeter(k=0.1, f0_n=0.05)
    for i in order:
        fields = [np.zeros((8, 8, 8, 3), np.float32) for _ in range(2)]
        for dense, force_n in zip(fields, (2.0, 2.0 + errors_n[i]), strict=True):
            dense[: i + 1, 0, 0, 0] = force_n
        meter.add(*(ForceField.from_dense(GRID, dense) for dense in fields))
    assert (meter.compared_voxels, meter.supported_voxels, meter.mask_violations) == (6, 6, 5)
    assert meter.worst_mask_ratio == pytest.approx(0.5 / 0.2, rel=1e-5)
    squares = 0.1**2 + 2 * 0.5**2 + 3 * 0.3**2
    assert meter.nmse_db == pytest.approx(10 * np.log10(squares / (6 * 2.0**2)), abs=1e-4)
