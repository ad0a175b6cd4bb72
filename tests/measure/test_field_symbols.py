"""Quantised fields as sparse symbols: refused arguments, and agreement of dense arrays and bricks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols, FramePairs, Frames
from touchfield.medium.grid import Grid

K = 6


def grid_of(*shape: int) -> Grid:
    x, y, z = shape
    return Grid((x, y, z), (1e-3,) * 3, (0, 0, 0))


def of_bricks(grid: Grid, bricks: Any, symbols: NDArray[np.int32] | None = None) -> FieldSymbols:
    b = np.array(bricks, np.int32).reshape(-1, 3)
    return FieldSymbols(
        grid, b, np.ones((len(b), 8, 8, 8), np.int32) if symbols is None else symbols, K, "a Q"
    )


# -- bricks ------------------------------------------------------------------------------------------------


def test_invalid_bricks_are_refused() -> None:
    grid = grid_of(16, 24, 32)
    good = [[0, 0, 1], [0, 2, 0], [1, 0, 0], [1, 2, 3]]
    assert of_bricks(grid, good).object_count == 4 * 512
    assert of_bricks(grid, []).object_count == 0
    for bad in (good[::-1], [[0, 0, 1], [0, 0, 0]], [[0, 1, 0], [0, 0, 3]], [[1, 0, 0], [1, 0, 0]]):
        with pytest.raises(InvalidArgument, match="out of order or twice"):
            of_bricks(grid, bad)
    for bad in ([[2, 0, 0]], [[0, 3, 0]], [[0, 0, 4]], [[-1, 0, 0]], [[0, 0, 0], [0, 0, -1]]):
        with pytest.raises(InvalidArgument, match="outside the grid"):
            of_bricks(grid, bad)


@pytest.mark.parametrize("axis", range(3))
def test_symbols_outside_the_grid_are_refused(axis: int) -> None:
    shape = [16, 16, 16]
    shape[axis] = 13
    grid = grid_of(*shape)
    last, last_inside, first_outside = [0, 0, 0], [7, 7, 7], [3, 3, 3]
    last[axis], last_inside[axis], first_outside[axis] = 1, 4, 5
    symbols = np.zeros((2, 8, 8, 8), np.int32)
    symbols[0] = 1  # a brick inside the grid has all its samples
    symbols[1][tuple(last_inside)] = 5
    assert of_bricks(grid, [[0, 0, 0], last], symbols).object_count == 513
    symbols[1][tuple(first_outside)] = 1
    with pytest.raises(
        InvalidArgument, match=f"beyond the grid along {'xyz'[axis]}; expected 0 from sample 13"
    ):
        of_bricks(grid, [[0, 0, 0], last], symbols)


def test_invalid_shapes_types_and_ranges_are_refused() -> None:
    grid = grid_of(8, 8, 8)
    brick, symbols = np.zeros((1, 3), np.int32), np.zeros((1, 8, 8, 8), np.int32)
    wrong: list[tuple[Any, Any]] = [
        (brick.astype(np.int64), symbols),
        (brick[0], symbols),
        (brick, symbols.astype(np.int64)),
        (brick, symbols[:0]),
        (brick, symbols - 1),
        (brick, symbols + K),
    ]
    for b, s in wrong:
        with pytest.raises(InvalidArgument, match="FieldSymbols"):
            FieldSymbols(grid, b, s, K, "a Q")


# -- dense arrays ------------------------------------------------------------------------------------------


@example(
    (16, 16, 16), 0, 0.5
)  # whole bricks: outside the grid, a brick's key equals that of one in the next row
@given(st.tuples(*[st.integers(1, 19)] * 3), st.integers(0, 1000), st.sampled_from([0.0, 0.01, 0.5]))
def test_dense_round_trip(shape: tuple[int, int, int], seed: int, density: float) -> None:
    rng = np.random.default_rng(seed)
    dense = rng.integers(1, K, shape) * (rng.random(shape) < density)
    for dtype in (np.int8, np.uint16, np.int64, np.uint64):
        f = FieldSymbols.from_dense(grid_of(*shape), dense.astype(dtype), K, "a Q")
        assert np.array_equal(f.to_dense(), dense)
    assert f.object_count == np.count_nonzero(dense) and f.symbols.any(axis=(1, 2, 3)).all()
    index = np.argwhere(np.ones(shape))
    assert np.array_equal(f.symbols_at(index), dense.ravel())
    for step in np.diag(shape):  # outside one border
        assert not f.symbols_at(index + step).any() and not f.symbols_at(index - step).any()


def test_booleans_are_symbols() -> None:
    dense = np.random.default_rng(0).random((9, 9, 9)) < 0.5
    assert np.array_equal(FieldSymbols.from_dense(grid_of(9, 9, 9), dense, 2, "a Q").to_dense(), dense)


@pytest.mark.parametrize("value", [1.0, 1.5, np.nan, 1j, "1", None, 1 << 70])
def test_symbols_that_are_no_integers_are_refused(value: Any) -> None:
    with pytest.raises(InvalidArgument, match="expected integers"):
        FieldSymbols.from_dense(grid_of(8, 8, 8), np.full((8, 8, 8), value), K, "a Q")


@pytest.mark.parametrize(
    ("value", "alphabet"),
    [
        (K, K),
        (-1, K),
        ((1 << 32) + 1, K),
        (-(1 << 32) + 1, K),
        (1 << 32, K),
        (np.uint64((1 << 63) + 1), K),
        ((1 << 32) + 1, 1 << 40),
        (1 << 31, 1 << 40),
    ],
)
def test_symbols_that_a_cast_would_wrap_are_refused(value: Any, alphabet: int) -> None:
    dense = np.zeros((9, 8, 8), np.asarray(value).dtype)
    dense[8, 1, 1] = value
    with pytest.raises(InvalidArgument, match=r"symbols: found .* to .*; expected 0 to"):
        FieldSymbols.from_dense(grid_of(9, 8, 8), dense, alphabet, "a Q")


def test_dense_array_of_another_shape_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="as the grid says"):
        FieldSymbols.from_dense(grid_of(8, 8, 8), np.zeros((8, 8, 9), int), K, "a Q")


# -- several -----------------------------------------------------------------------------------------------


def test_pairs_at_the_union_of_their_bricks() -> None:
    grid = grid_of(16, 16, 16)
    first = Frames(of_bricks(grid, [[0, 0, 0], [1, 0, 1]]), "first")
    second = Frames(of_bricks(grid, [[0, 1, 0], [1, 0, 1]]), "second")
    ((bricks, joint),) = FramePairs(first, second).parts()
    assert bricks.tolist() == [[0, 0, 0], [0, 1, 0], [1, 0, 1]]
    s, t = np.divmod(joint, K)
    assert [x.any(axis=1).tolist() for x in (s, t)] == [[True, False, True], [False, True, True]]
