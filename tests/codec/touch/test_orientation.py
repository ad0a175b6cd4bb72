"""Which orientations of a pass are compared, and on what."""

from __future__ import annotations

import numpy as np
import pytest
from touchfield.codec.kernels.touch_max_predict import learn
from touchfield.codec.kernels.touch_max_window import ALL, ALL_B, CANDIDATES, M, fresh_work
from touchfield.codec.touch.orientation import sampled

from touchfield.codec.touch import orientation


def sheet(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Two layers of `side` by `side` bricks, pushed along z, of which each holds 64 forces."""
    bricks = np.stack(np.meshgrid(np.arange(side), np.arange(side), np.arange(2), indexing="ij"), axis=-1)
    forces = np.zeros((2 * side**2, 8, 8, 8, 3), np.float32)
    forces[:, :, :, 3, 2] = 1
    return bricks.reshape(-1, 3).astype(np.int32), forces


def test_a_small_frame_is_tried_as_a_whole() -> None:
    assert sampled(*sheet(8)) is None


def test_a_large_frame_is_tried_by_columns_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orientation, "_QUICK", 1000)
    bricks, forces = sheet(32)
    part = sampled(bricks, forces)
    assert part is not None
    assert 1 / 8 <= part.mean() <= 1 / 8 + 2 / 64
    columns = part.reshape(32, 32, 2)
    assert (columns[..., 0] == columns[..., 1]).all()


def test_sums_of_least_squares_stay_below_their_bound() -> None:
    """The largest differences that count, again and again: products with weights stay below 2^53."""
    work = fresh_work(1, 1, 8, inter=True)
    candidates = np.zeros((CANDIDATES, 3), np.int64)
    candidates[1:] = 1 << 17
    came = np.full(3, 1 << 17)
    for _ in range(1000):
        learn(work, candidates, CANDIDATES - 1, 0, came)
    assert work.sums[ALL].max() > 1 << 31
    assert (M + 1) * max(np.abs(work.sums[ALL : ALL + M]).max() << 16, np.abs(work.sums[ALL_B]).max() << 14) < 1 << 53
