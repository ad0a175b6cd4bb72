"""The support coder: lossless for any mask, fixed bytes, and named errors for faulty bytes."""

from __future__ import annotations

import contextlib
import zlib

import numpy as np
import pytest
from hypothesis import given, strategies as st

from bit_writer import empty_bricks
from part_memory import decode_support_in
from touchfield.codec.support import (
    BRICKS_FREE,
    BRICKS_PER_BYTE,
    decode_support,
    encode_support,
)
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile
from touchfield.medium import ForceField, Grid

Support = tuple[np.ndarray, np.ndarray]


def grid_of(shape: tuple[int, int, int]) -> Grid:
    return Grid(shape, (1e-3, 1e-3, 1e-3), (0, 0, 0))


def support_of(dense: np.ndarray) -> Support:
    """Bricks and mask of a dense bool array."""
    field = ForceField.from_dense(grid_of(dense.shape), dense[..., None] * np.ones(3, np.float32))
    return field.bricks, field.mask


def same_support(a: Support, b: Support) -> bool:
    return a[1].dtype == b[1].dtype == np.bool_ and all(
        np.array_equal(x, y) for x, y in zip(a, b, strict=True)
    )


@st.composite
def dense_masks(draw: st.DrawFn, shape: tuple[int, int, int] | None = None) -> np.ndarray:
    """Noise of any density, balls, layers and boxes, on grids that end within a brick."""
    shape = shape or tuple(draw(st.lists(st.integers(1, 27), min_size=3, max_size=3)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    ijk = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    distance = np.linalg.norm(ijk - rng.uniform(0, 20, 3), axis=-1) - rng.uniform(0, 15)
    kind = draw(st.sampled_from(["noise", "ball", "shell", "all", "nothing", "bricks"]))
    return {
        "noise": rng.random(shape) < draw(st.sampled_from([0.001, 0.03, 0.5, 0.97, 0.999])),
        "ball": distance < rng.normal(0, 0.5, shape),
        "shell": (distance < 0) & (distance > -4),
        "all": np.ones(shape, np.bool_),
        "nothing": np.zeros(shape, np.bool_),
        "bricks": rng.random((4, 4, 4))[tuple(np.moveaxis(ijk // 8, -1, 0))] < 0.5,
    }[kind]


def assert_fault_or_support(data: bytes, grid: Grid) -> None:
    """Bytes raise a format error, or decode to a support within the brick limit that can be coded again."""
    try:
        support = decode_support(data, grid)
    except FormatError:
        return
    assert len(support[0]) <= BRICKS_FREE + BRICKS_PER_BYTE * len(data)
    assert same_support(decode_support(encode_support(grid, *support), grid), support)


@given(dense_masks())
def test_round_trip_and_trailing_bytes(dense: np.ndarray) -> None:
    grid, support = grid_of(dense.shape), support_of(dense)
    data = encode_support(grid, *support)
    assert same_support(decode_support(data, grid), support)
    assert len(support[0]) <= BRICKS_FREE + BRICKS_PER_BYTE * len(data)
    for trailing in (bytes(8), bytes(8) + b"\1"):
        with pytest.raises(CorruptFile):
            decode_support(data + trailing, grid)


@given(st.data())
def test_round_trip_given_the_previous_frame(data: st.DataObject) -> None:
    before = data.draw(dense_masks())
    after = data.draw(st.just(np.roll(before, 1, axis=2)) | dense_masks(before.shape))
    grid, previous, support = grid_of(before.shape), support_of(before), support_of(after)
    assert same_support(decode_support(encode_support(grid, *support, previous), grid, previous), support)


@given(
    st.lists(
        st.tuples(st.integers(0, 9_999), st.integers(0, 9_998), st.integers(0, 9_999)),
        min_size=1,
        max_size=30,
    ),
    st.booleans(),
)
def test_round_trip_in_a_large_grid(points: list[tuple[int, int, int]], full: bool) -> None:
    grid = grid_of((10_000, 9_999, 10_000))
    field = ForceField.from_support(grid, points, np.ones((len(points), 3)))
    mask = np.ones_like(field.mask) if full and (field.bricks[:, 1] < 1249).all() else field.mask
    support = field.bricks, mask
    data = encode_support(grid, *support)
    assert same_support(decode_support(data, grid), support)
    assert same_support(decode_support(encode_support(grid, *support, support), grid, support), support)
    for cut in range(len(data)):
        assert_fault_or_support(data[:cut], grid)


def shell(n: int) -> np.ndarray:
    ijk = np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1)
    distance = np.linalg.norm(ijk - np.array([n / 2, n / 2 + 1, n / 2 - 1.5]), axis=-1) - n / 3
    return (distance < 0) & (distance > -4)


def test_the_bytes_are_fixed() -> None:
    """A change of these bytes is a change of the format."""
    tiny = np.zeros((9, 8, 17), np.bool_)
    tiny[2:5, 3, 4:12] = tiny[8, :, :8] = True
    tiny[0, 0, 16] = tiny[3, 3, 7] = True
    assert encode_support(grid_of(tiny.shape), *support_of(tiny)).hex() == "08f4aae1937fc32dbb2dc818f61b"
    moved = np.roll(tiny, 1, axis=1)
    inter = encode_support(grid_of(tiny.shape), *support_of(moved), support_of(tiny))
    assert inter.hex() == "1892532c4cb4aecf528b"
    distant = ForceField.from_support(
        grid_of((9000, 9000, 9000)), [[7, 8, 9], [8999, 8999, 8999]], np.ones((2, 3))
    )
    assert encode_support(distant.grid, distant.bricks, distant.mask).hex() == "3d97af2eefcd6d33288b"
    ball = encode_support(grid_of((64, 64, 64)), *support_of(shell(64)))
    assert (len(ball), f"{zlib.crc32(ball):08x}") == (966, "50ead99c")


def test_an_empty_support_is_one_byte() -> None:
    grid = grid_of((16, 16, 16))
    empty = np.zeros((0, 3), np.int32), np.zeros((0, 8, 8, 8), np.bool_)
    assert encode_support(grid, *empty) == b"\x80"
    assert same_support(decode_support(b"\x80", grid), empty)


def test_smaller_than_zlib_and_unchanged_frames_cost_little() -> None:
    dense = shell(96)
    grid, support = grid_of(dense.shape), support_of(dense)
    intra_bytes = len(encode_support(grid, *support))
    assert intra_bytes < 0.9 * len(zlib.compress(np.packbits(dense).tobytes(), 9))
    assert len(encode_support(grid, *support, support)) * 3 < intra_bytes


@pytest.mark.parametrize("samples", [24, 9000])
def test_changed_bytes_are_an_error_or_another_support(samples: int) -> None:
    grid, support = grid_of((samples,) * 3), support_of(shell(24))
    data = encode_support(grid, *support)
    for index in range(len(data)):
        for change in (1, 0x40, 0xFF):
            wrong = bytearray(data)
            wrong[index] ^= change
            for cut in (len(data), index + 1):
                assert_fault_or_support(bytes(wrong[:cut]), grid)


@given(
    st.binary(max_size=200), st.sampled_from([(30, 20, 17), (1, 1, 1), (9000, 9000, 9000), (1 << 20,) * 3])
)
def test_random_bytes_are_an_error_or_a_support(data: bytes, shape: tuple[int, int, int]) -> None:
    assert_fault_or_support(data, grid_of(shape))


@pytest.mark.parametrize("shape", [(512, 512, 512), (1 << 20, 1 << 20, 1 << 20)])
def test_few_bytes_allocate_little_memory(shape: tuple[int, int, int]) -> None:
    solid = np.ones((96, 96, 96), np.bool_)  # whose code is one byte followed by zeros
    bombs = [bytes(60), bytes(5000), b"\1" * 4096, encode_support(grid_of(shape), *support_of(solid))]
    assert len(bombs[-1]) == (12**3 - 64) // 16
    for bomb in bombs:
        with contextlib.suppress(FormatError):  # and no MemoryError
            decode_support_in((1 << 19) + (28 << 10) * len(bomb), bomb, grid_of(shape))
    with pytest.raises(MemoryError):
        decode_support_in(1 << 19, bombs[-1], grid_of(shape))


def test_invalid_supports_are_refused() -> None:
    grid = grid_of((20, 16, 16))
    corner_mask = np.zeros((1, 8, 8, 8), np.bool_)
    corner_mask[0, 0, 0, 0] = True
    outside_mask = corner_mask.copy()
    outside_mask[0, 7] = True
    for bricks, mask in [
        ([[0, 0, 0]], np.zeros_like(corner_mask)),
        ([[0, 0, 1], [0, 0, 0]], np.repeat(corner_mask, 2, axis=0)),
        ([[2, 0, 0]], outside_mask),
        ([[3, 0, 0]], corner_mask),
        ([[0, -1, 0]], corner_mask),
        ([[0, 0, 0]], np.repeat(corner_mask, 2, axis=0)),
    ]:
        with pytest.raises(InvalidArgument):
            encode_support(grid, np.array(bricks, np.int32), mask)


def test_faults_raise_named_errors() -> None:
    grid, support = grid_of((64, 64, 64)), support_of(shell(64))
    data = encode_support(grid, *support)
    with pytest.raises(TruncatedFile, match="a code that ends too early"):
        decode_support(data[:-20], grid)
    with pytest.raises(CorruptFile, match="more bricks than the bytes may list"):
        decode_support(b"", grid_of((40, 32, 32)))  # a code of ones: all bricks, all samples
    small, one = grid_of((20, 16, 16)), support_of(np.ones((20, 16, 16), np.bool_))
    with pytest.raises(CorruptFile, match="a brick without samples"):
        decode_support(empty_bricks(small, one), small)
