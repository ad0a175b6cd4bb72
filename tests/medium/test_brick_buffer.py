"""The buffer of bricks: batches in, one field out, within the memory budget."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.errors import InvalidArgument
from touchfield.medium.brick_buffer import BrickBuffer


@pytest.mark.parametrize("sizes", [(), (0,), (5,), (1, 0, 40, 3), (2,) * 30])
def test_the_bricks_with_a_force_are_kept_in_order(sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(len(sizes))
    count = sum(sizes)
    bricks = rng.integers(0, 99, (count, 3)).astype(np.int32)
    forces = rng.standard_normal((count, 8, 8, 8, 3)).astype(np.float32)
    has_force = rng.random(count) < 0.6
    buffer, first = BrickBuffer(), 0
    for size in sizes:
        batch = slice(first, first + size)
        buffer.append(bricks[batch], forces[batch], has_force[batch])
        first += size
    kept_bricks, kept_forces = buffer.take()
    np.testing.assert_array_equal(kept_bricks, bricks[has_force])
    np.testing.assert_array_equal(kept_forces, forces[has_force])


def test_only_the_bricks_with_a_force_count_against_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", str(25 * 6144 / 2**30))
    bricks, forces = np.zeros((100, 3), np.int32), np.ones((100, 8, 8, 8, 3), np.float32)
    buffer = BrickBuffer()
    buffer.append(bricks, forces, np.arange(100) < 20)
    with pytest.raises(InvalidArgument, match=r"of 30 bricks or more.*TOUCHFIELD_MEMORY_GIB"):
        buffer.append(bricks, forces, np.arange(100) < 10)
