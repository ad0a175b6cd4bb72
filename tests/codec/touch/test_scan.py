"""Scan orders: the permutation is invertible, and neighbour indices are correct."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from field_makers import GRID, field_of
from hypothesis import given, strategies as st

from touchfield.codec.touch.frame import ScanOrder
from touchfield.codec.touch.lattice import FixedField
from touchfield.medium import ForceField, Grid

SCAN_CODES = [code for code in range(32) if code & 3 < 3]


def down_of(code: int) -> tuple[bool, bool, bool]:
    """Which axes of the scan are descending: bits 2, 3 and 4 of the code."""
    return bool(code & 4), bool(code & 8), bool(code & 16)


def bricks_of(shape: tuple[int, int, int], density: float, seed: int) -> np.ndarray:
    return np.argwhere(np.random.default_rng(seed).random(shape) < density).astype(np.int32)


@pytest.mark.parametrize("code", SCAN_CODES)
def test_permutation_round_trip(code: int) -> None:
    scan_order = ScanOrder(GRID, code)
    assert scan_order.axes[0] == code & 3 and tuple(scan_order.down) == down_of(code)
    rng = np.random.default_rng(code)
    bricks = bricks_of(GRID.brick_shape, 0.6, code)
    vectors = rng.integers(-(1 << 17) + 1, 1 << 17, (len(bricks), 8, 8, 8, 3)).astype(np.int32)
    vectors[rng.random(vectors.shape[:4]) < 0.5] = 0
    positions, order = scan_order.order(bricks)
    assert sorted(order.tolist()) == list(range(len(bricks)))
    assert (np.lexsort(positions.T[::-1]) == np.arange(len(positions))).all()
    permuted = scan_order.permute(vectors, order)
    cells = np.zeros((len(bricks), 512, 8), np.int32)
    cells[..., :3], cells[..., 3] = permuted, permuted.any(-1)
    assert np.array_equal(scan_order.unpermute(cells, order), vectors)


@given(st.sampled_from(SCAN_CODES), st.integers(0, 99))
def test_scan_samples_agree_with_the_grid(code: int, seed: int) -> None:
    down, scan_order, field = down_of(code), ScanOrder(GRID, code), field_of("dense", seed)
    positions, order = scan_order.order(field.bricks)
    permuted = scan_order.permute(field.forces_n, order, 2.0)
    scan = scan_order.scan(positions, None)
    axes, rng = scan_order.axes, np.random.default_rng(seed)
    n, at = int(rng.integers(len(positions))), int(rng.integers(512))
    local = np.array([at >> 6, at >> 3 & 7, at & 7])
    inside = bool(((scan.low[n] <= local) & (local < scan.high[n])).all())
    # on a descending axis samples are counted from the end of the padded grid
    padded = 8 * np.array(GRID.brick_shape)[axes]
    along = 8 * positions[n] + local
    along = np.where(down, padded - 1 - along, along)
    index = np.zeros(3, int)
    index[axes] = along
    assert inside == bool((index < GRID.shape).all())
    if inside:
        force = field.to_dense()[tuple(index)][axes] * 2.0
        assert np.array_equal(permuted[n, at], np.where(down, -force, force))


@pytest.mark.parametrize("code", SCAN_CODES[::3])
def test_neighbour_indices_are_correct(code: int) -> None:
    grid = Grid((60, 45, 70), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    scan_order = ScanOrder(grid, code)
    bricks, reference_bricks = bricks_of(grid.brick_shape, 0.3, 1), bricks_of(grid.brick_shape, 0.3, 2)
    positions, _ = scan_order.order(bricks)
    reference_positions, _ = scan_order.order(reference_bricks)
    scan = scan_order.scan(
        positions, FixedField(reference_bricks, np.ones((len(reference_bricks), 8, 8, 8, 3), np.int32))
    )
    assert scan.near.shape == (len(bricks), 13) and scan.around.shape == (len(bricks), 27)
    index_of, reference_index_of = (
        {tuple(p): i for i, p in enumerate(listed.tolist())} for listed in (positions, reference_positions)
    )
    for n, position in enumerate(positions.tolist()):
        for s, step in enumerate(itertools.product((-1, 0, 1), repeat=3)):
            neighbour = tuple(p + d for p, d in zip(position, step, strict=True))
            assert scan.around[n, s] == reference_index_of.get(neighbour, -1)
            if s < 13:
                assert scan.near[n, s] == index_of.get(neighbour, -1) < n


def test_a_scan_without_bricks() -> None:
    empty = ForceField.empty(GRID)
    scan_order = ScanOrder(GRID, 1 | 4 | 16)
    positions, order = scan_order.order(empty.bricks)
    scan = scan_order.scan(positions, FixedField(empty.bricks, np.zeros((0, 8, 8, 8, 3), np.int32)))
    assert len(positions) == len(order) == len(scan.near) == 0 and scan.around.shape == (0, 27)
