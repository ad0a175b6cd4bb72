"""The body of VIBR: exact integers, amplitudes within a ninth, and refusal of faulty bytes."""

from __future__ import annotations

import tracemalloc
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.codec.vibration import (
    AMPLITUDE_STEPS,
    MAX_RELATIVE_ERROR,
    VibrationSymbols,
    decode_symbols,
    decode_vibration,
    dequantise_vibration,
    encode_symbols,
    encode_vibration,
    quantise_vibration,
)
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile
from touchfield.medium import Grid
from touchfield.medium.medium import VibrationFrame

GRID = Grid((11, 9, 10), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))
WIDE = Grid((1 << 20, 1 << 20, 1 << 20), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))


def random_symbols(
    rng: np.random.Generator, grid: Grid, density: float, is_random: bool = True
) -> VibrationSymbols:
    """Samples of a small box of the grid, with random or with constant values."""
    box = np.minimum(grid.shape, 12)
    positions = np.argwhere(rng.random(box) < density).astype(np.int32)
    positions += (np.array(grid.shape) - box).astype(np.int32)
    count = len(positions)
    if not is_random:
        return VibrationSymbols(positions, np.full(count, 70, np.int32), np.full(count, 150, np.int32))
    amplitudes = rng.integers(0, AMPLITUDE_STEPS, count).astype(np.int32)
    return VibrationSymbols(positions, amplitudes, rng.integers(1, 10001, count).astype(np.int32))


def assert_same(found: list[VibrationSymbols], expected: list[VibrationSymbols]) -> None:
    for found_frame, expected_frame in zip(found, expected, strict=True):
        np.testing.assert_array_equal(found_frame.positions, expected_frame.positions)
        np.testing.assert_array_equal(found_frame.amplitudes, expected_frame.amplitudes)
        np.testing.assert_array_equal(found_frame.frequencies, expected_frame.frequencies)


DENSITIES = st.lists(st.sampled_from([0.0, 0.02, 0.5, 1.0]), min_size=1, max_size=4)


@pytest.mark.parametrize("grid", [GRID, WIDE], ids=["small", "wide"])
@given(seed=st.integers(0, 1000), densities=DENSITIES, is_random=st.booleans())
def test_symbols_round_trip(grid: Grid, seed: int, densities: list[float], is_random: bool) -> None:
    rng = np.random.default_rng(seed)
    frames = [random_symbols(rng, grid, density, is_random) for density in densities]
    body = encode_symbols(grid, frames)
    assert_same(decode_symbols(body, grid, len(frames)), frames)
    assert encode_symbols(grid, decode_symbols(body, grid, len(frames))) == body


@given(
    amplitudes=st.lists(st.floats(2.0**-40, 9e5, width=32), min_size=1, max_size=20),
    frequency=st.floats(2.0**-6, 10000, width=32),
)
def test_amplitudes_within_a_ninth_and_frequencies_within_half_a_hertz(
    amplitudes: list[float], frequency: float
) -> None:
    count = len(amplitudes)
    positions = np.stack([np.zeros(count), np.zeros(count), np.arange(count)], axis=1).astype(np.int32)
    grid = Grid((1, 1, 20), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    frame = VibrationFrame(
        grid, positions, np.array(amplitudes, np.float32), np.full(count, frequency, np.float32)
    )
    [found] = decode_vibration(encode_vibration([frame]), grid, 1)
    is_coded = np.isin(positions[:, 2], found.positions[:, 2])
    assert (frame.amplitudes_n[~is_coded] < 2.0**-20).all()
    original_n, decoded_n = (
        frame.amplitudes_n[is_coded].astype(np.float64),
        found.amplitudes_n.astype(np.float64),
    )
    assert (np.abs(decoded_n - original_n) <= MAX_RELATIVE_ERROR * original_n * (1 + 1e-12)).all()
    assert (np.abs(found.frequencies_hz - frequency) <= (0.5 if frequency >= 0.5 else 1)).all()
    requantised = quantise_vibration(found)
    assert_same([requantised], [quantise_vibration(frame)])  # coding what was decoded loses nothing more


def test_the_lowest_and_the_highest_step() -> None:
    steps = np.arange(AMPLITUDE_STEPS, dtype=np.int32)
    positions = np.stack([np.zeros_like(steps), np.zeros_like(steps), steps], axis=1)
    grid = Grid((1, 1, AMPLITUDE_STEPS), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    frame = dequantise_vibration(grid, VibrationSymbols(positions, steps, np.ones_like(steps)))
    assert frame.amplitudes_n[0] == 2.0**-20 and frame.amplitudes_n[-1] == 7 * 2.0**17
    assert (np.diff(frame.amplitudes_n) > 0).all()
    np.testing.assert_array_equal(quantise_vibration(frame).amplitudes, steps)
    strong = VibrationFrame(grid, positions[:1], np.array([1e6], np.float32), np.ones(1, np.float32))
    with pytest.raises(InvalidArgument, match="1e\\+06 N; expected at most 917504 N"):
        quantise_vibration(strong)


def test_unchanged_frames_cost_almost_nothing() -> None:
    rng = np.random.default_rng(1)
    first = random_symbols(rng, GRID, 0.5)
    single_bytes, eight_bytes = len(encode_symbols(GRID, [first])), len(encode_symbols(GRID, [first] * 8))
    assert eight_bytes - single_bytes < single_bytes / 4


# -- bytes of strangers ------------------------------------------------------------------------------------

BODY = encode_symbols(GRID, [random_symbols(np.random.default_rng(s), GRID, 0.3) for s in range(3)])


def test_truncated_body_is_refused() -> None:
    """The code has no end marker: truncating a few bytes may decode to other values."""
    body = encode_symbols(GRID, [random_symbols(np.random.default_rng(s), GRID, 0.1) for s in range(2)])
    assert len(body) > 400
    for size in range(len(body) - 6):
        with pytest.raises(FormatError):
            decode_symbols(body[:size], GRID, 2)


def test_wrong_frame_counts_are_refused() -> None:
    for count in (1, 2, 4, 65535):
        with pytest.raises(FormatError):
            decode_symbols(BODY, GRID, count)
    for more in (bytes(8), bytes(8) + b"\1"):
        with pytest.raises(CorruptFile, match="bytes behind the end of the code"):
            decode_symbols(BODY + more, GRID, 3)


@given(
    changes=st.lists(st.tuples(st.integers(0, len(BODY) - 1), st.integers(0, 255)), min_size=1, max_size=4),
    cut=st.integers(0, 3),
)
def test_changed_bytes_are_refused_or_are_a_frame(changes: list[tuple[int, int]], cut: int) -> None:
    damaged = bytearray(BODY)
    for index, value in changes:
        damaged[index] = value
    with suppress(FormatError):
        frames = decode_vibration(bytes(damaged[: len(damaged) - cut]), GRID, 3)
        assert len(frames) == 3
        for frame in frames:
            assert len(frame) <= GRID.voxel_count  # VibrationFrame has checked the rest


@settings(deadline=None)
@given(data=st.binary(max_size=60), frames=st.sampled_from([1, 2, 65535]))
def test_random_bytes_allocate_little_memory(data: bytes, frames: int) -> None:
    tracemalloc.start()
    try:
        with suppress(FormatError):
            decode_symbols(data, WIDE, frames)
        assert tracemalloc.get_traced_memory()[1] < 30_000_000
    finally:
        tracemalloc.stop()


def test_more_frames_or_bricks_than_bytes_are_refused() -> None:
    nothing = VibrationSymbols(np.zeros((0, 3), np.int32), np.zeros(0, np.int32), np.zeros(0, np.int32))
    body = encode_symbols(WIDE, [nothing] * 100)
    assert len(body) == 96
    assert_same(decode_symbols(body, WIDE, 100), [nothing] * 100)
    with pytest.raises(TruncatedFile, match="found 95 bytes; expected 96 or more to frame 99"):
        decode_symbols(body[:-1], WIDE, 100)


@pytest.mark.parametrize(
    ("amplitude", "frequency"), [(AMPLITUDE_STEPS, 1), (-1, 1), (0, 0), (0, 10001)], ids=str
)
def test_values_out_of_range_are_corrupt(amplitude: int, frequency: int) -> None:
    frame = VibrationSymbols(
        np.array([[1, 2, 3]], np.int32), np.array([amplitude], np.int32), np.array([frequency], np.int32)
    )
    with pytest.raises(CorruptFile, match="expected"):
        decode_symbols(encode_symbols(GRID, [frame]), GRID, 1)


def test_more_samples_than_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "1e-5")
    with pytest.raises(InvalidArgument, match="TOUCHFIELD_MEMORY_GIB"):
        decode_symbols(BODY, GRID, 3)
