"""The course of a scan: there and back again is the same, and neighbours are where they are."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from field_makers import GRID, field_of
from hypothesis import given, strategies as st

from touchfield.codec.touch.frame import ScanOrder
from touchfield.codec.touch.lattice import FixedField
from touchfield.medium import ForceField, Grid

COURSES = [code for code in range(32) if code & 3 < 3]


def down_of(code: int) -> tuple[bool, bool, bool]:
    """Axes of the scan that run down: told by bits 2, 3 and 4."""
    return bool(code & 4), bool(code & 8), bool(code & 16)


def bricks_of(shape: tuple[int, int, int], share: float, seed: int) -> np.ndarray:
    return np.argwhere(np.random.default_rng(seed).random(shape) < share).astype(np.int32)


@pytest.mark.parametrize("code", COURSES)
def test_there_and_back(code: int) -> None:
    course = ScanOrder(GRID, code)
    assert course.axes[0] == code & 3 and tuple(course.down) == down_of(code)
    rng = np.random.default_rng(code)
    bricks = bricks_of(GRID.brick_shape, 0.6, code)
    vectors = rng.integers(-(1 << 17) + 1, 1 << 17, (len(bricks), 8, 8, 8, 3)).astype(np.int32)
    vectors[rng.random(vectors.shape[:4]) < 0.5] = 0
    places, order = course.order(bricks)
    assert sorted(order.tolist()) == list(range(len(bricks)))
    assert (np.lexsort(places.T[::-1]) == np.arange(len(places))).all()
    turned = course.permute(vectors, order)
    cells = np.zeros((len(bricks), 512, 8), np.int32)
    cells[..., :3], cells[..., 3] = turned, turned.any(-1)
    assert np.array_equal(course.unpermute(cells, order), vectors)


@given(st.sampled_from(COURSES), st.integers(0, 99))
def test_a_sample_of_the_scan_is_one_of_the_grid(code: int, seed: int) -> None:
    down, course, field = down_of(code), ScanOrder(GRID, code), field_of("dense", seed)
    places, order = course.order(field.bricks)
    turned = course.permute(field.forces_n, order, 2.0)
    scan = course.scan(places, None)
    axes, rng = course.axes, np.random.default_rng(seed)
    n, at = int(rng.integers(len(places))), int(rng.integers(512))
    local = np.array([at >> 6, at >> 3 & 7, at & 7])
    inside = bool(((scan.low[n] <= local) & (local < scan.high[n])).all())
    # the sample counted from the far end of a whole number of bricks, where the axis runs down
    padded = 8 * np.array(GRID.brick_shape)[axes]
    along = 8 * places[n] + local
    along = np.where(down, padded - 1 - along, along)
    index = np.zeros(3, int)
    index[axes] = along
    assert inside == bool((index < GRID.shape).all())
    if inside:
        force = field.to_dense()[tuple(index)][axes] * 2.0
        assert np.array_equal(turned[n, at], np.where(down, -force, force))


@pytest.mark.parametrize("code", COURSES[::3])
def test_neighbours_are_where_they_are(code: int) -> None:
    grid = Grid((60, 45, 70), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    course = ScanOrder(grid, code)
    bricks, theirs = bricks_of(grid.brick_shape, 0.3, 1), bricks_of(grid.brick_shape, 0.3, 2)
    places, _ = course.order(bricks)
    known, _ = course.order(theirs)
    scan = course.scan(places, FixedField(theirs, np.ones((len(theirs), 8, 8, 8, 3), np.int32)))
    assert scan.near.shape == (len(bricks), 13) and scan.around.shape == (len(bricks), 27)
    ours, others = ({tuple(p): i for i, p in enumerate(some.tolist())} for some in (places, known))
    for n, place in enumerate(places.tolist()):
        for s, step in enumerate(itertools.product((-1, 0, 1), repeat=3)):
            there = tuple(p + d for p, d in zip(place, step, strict=True))
            assert scan.around[n, s] == others.get(there, -1)
            if s < 13:
                assert scan.near[n, s] == ours.get(there, -1) < n


def test_a_scan_without_bricks() -> None:
    empty = ForceField.empty(GRID)
    course = ScanOrder(GRID, 1 | 4 | 16)
    places, order = course.order(empty.bricks)
    scan = course.scan(places, FixedField(empty.bricks, np.zeros((0, 8, 8, 8, 3), np.int32)))
    assert len(places) == len(order) == len(scan.near) == 0 and scan.around.shape == (0, 27)
