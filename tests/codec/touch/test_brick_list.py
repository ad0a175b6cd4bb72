"""The coded list of bricks: round trip with any grid and previous list, its size, and faulty bytes."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from native_model import read_list, write_list

from touchfield.codec.support import BRICKS_FREE, BRICKS_PER_BYTE
from touchfield.errors import CorruptFile, TruncatedFile


def ascending(bricks: np.ndarray) -> np.ndarray:
    return np.unique(np.asarray(bricks).reshape(-1, 3), axis=0).astype(np.int32)


def brick_lists(shape: tuple[int, int, int]) -> st.SearchStrategy[np.ndarray]:
    """Lists of single bricks and of boxes."""
    corner = st.tuples(*(st.integers(0, n - 1) for n in shape))
    box = st.tuples(corner, st.integers(1, 4)).map(
        lambda c: np.minimum(
            np.array(c[0]) + np.stack(np.indices((c[1],) * 3), -1).reshape(-1, 3), np.array(shape) - 1
        )
    )
    return st.lists(box, max_size=5).map(
        lambda boxes: ascending(np.concatenate([np.zeros((0, 3), int), *boxes]))
    )


@given(st.data())
@settings(max_examples=60)
def test_list_round_trip_is_within_its_byte_limit(data):
    side = st.one_of(st.integers(1, 9), st.sampled_from([100, 1 << 17, 1 << 20]))
    shape = data.draw(st.tuples(side, side, side))
    bricks, before = data.draw(brick_lists(shape)), data.draw(st.none() | brick_lists(shape))
    payload = write_list(shape, bricks, before)
    found, bit = read_list(payload, shape, before)
    assert np.array_equal(found, bricks) and found.dtype == np.int32 and bit == 1
    assert len(payload) <= 64 + 64 * len(bricks)


def test_few_bricks_of_a_huge_grid_cost_little():
    block = ascending((1 << 19) + np.stack(np.indices((4, 4, 4)), -1))
    assert len(write_list((1 << 20,) * 3, block)) < 60


def test_unchanged_list_costs_almost_nothing():
    rng = np.random.default_rng(5)
    x, y = np.indices((24, 24))
    sheet = ascending(np.stack([x, y, (8 + 3 * np.sin(x / 5) + 3 * np.cos(y / 7)).astype(int)], -1))
    fewer = sheet[rng.random(len(sheet)) < 0.97]
    pairs = ((sheet, sheet), (fewer, sheet), (sheet, None))
    unchanged, moved, alone = (
        len(write_list((24,) * 3, bricks, before).rstrip(b"\0")) for bricks, before in pairs
    )
    assert 4 * unchanged < moved < alone < len(sheet) // 4


def test_wall_of_bricks_has_the_minimum_size_of_the_rule():
    wall = ascending(np.stack(np.indices((16, 16, 16)), -1))
    payload = write_list((16,) * 3, wall)
    assert len(payload) == (16**3 - BRICKS_FREE) // BRICKS_PER_BYTE
    with pytest.raises(CorruptFile, match="list of bricks"):
        read_list(payload[:-1], (16,) * 3)


@given(st.binary(max_size=40), st.none() | st.just(np.zeros((1, 3), np.int32)))
@settings(max_examples=60)
def test_random_bytes_are_a_list_or_a_named_error(data, before):
    """In little memory: else it would be a MemoryError."""
    shape = (1 << 20, 1 << 20, 3)
    with contextlib.suppress(CorruptFile, TruncatedFile):
        found, _ = read_list(data, shape, before, 1 << 20)
        assert len(found) <= BRICKS_FREE + BRICKS_PER_BYTE * len(data)
        assert np.array_equal(ascending(found), found) and (found >= 0).all() and (found < shape).all()
