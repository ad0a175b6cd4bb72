"""Neighbouring bricks, checked against sets of tuples."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, strategies as st

from touchfield.medium import Grid
from touchfield.medium.field import brick_keys, dilated, neighbour_slots

GRID = Grid((40, 21, 33), (1, 1, 1), (0, 0, 0))
brick_sets = st.sets(st.tuples(st.integers(0, 4), st.integers(0, 2), st.integers(0, 4)), max_size=12)


def ascending(found: set[tuple[int, int, int]]) -> np.ndarray:
    return np.array(sorted(found), np.int32).reshape(-1, 3)


@given(brick_sets, st.tuples(*[st.integers(0, 20)] * 3))
def test_dilated(found: set[tuple[int, int, int]], reach: tuple[int, int, int]) -> None:
    got = dilated(GRID, ascending(found), reach)
    spans = [range(-r // 8, -(-r // 8) + 1) for r in reach]
    expected = {
        p
        for b in found
        for p in (tuple(np.add(b, o)) for o in itertools.product(*spans))
        if all(0 <= p[a] < GRID.brick_shape[a] for a in range(3))
    }
    assert {tuple(b) for b in got.tolist()} == expected
    assert (np.diff(brick_keys(GRID, got)) > 0).all()


@given(brick_sets)
def test_neighbour_slots(found: set[tuple[int, int, int]]) -> None:
    bricks = ascending(found)
    slots = neighbour_slots(bricks, bricks, GRID.brick_shape)
    for b, row in zip(bricks.tolist(), slots.tolist()):
        for offset, slot in zip(itertools.product((-1, 0, 1), repeat=3), row):
            neighbour = tuple(np.add(b, offset).tolist())
            assert (neighbour in found) == (slot >= 0)
            assert slot < 0 or tuple(bricks[slot].tolist()) == neighbour
