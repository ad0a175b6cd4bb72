"""The body of VIBR: exact integers, amplitudes within a ninth, and refusal of faulty bytes."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bit_writer import vibration_body
from part_memory import decode_vibration_in
from touchfield.codec.vibration import (
    AMPLITUDE_STEPS,
    MAX_RELATIVE_ERROR,
    decode_vibration,
    encode_vibration,
)
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile
from touchfield.medium import Grid
from touchfield.medium.medium import VibrationFrame

GRID = Grid((11, 9, 10), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))
WIDE = Grid((1 << 20, 1 << 20, 1 << 20), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))


def frame_of(grid: Grid, positions: np.ndarray, steps: np.ndarray, hertz: np.ndarray) -> VibrationFrame:
    """A frame that is coded exactly."""
    amplitudes_n = (4 + steps % 4) * 2.0 ** (steps // 4 - 22)
    return VibrationFrame(grid, positions, amplitudes_n.astype(np.float32), hertz.astype(np.float32))


def random_frame(
    rng: np.random.Generator, grid: Grid, density: float, is_random: bool = True
) -> VibrationFrame:
    """Samples of a small box of the grid, with random or with constant values."""
    box = np.minimum(grid.shape, 12)
    positions = np.argwhere(rng.random(box) < density).astype(np.int32)
    positions += (np.array(grid.shape) - box).astype(np.int32)
    count = len(positions)
    if not is_random:
        return frame_of(grid, positions, np.full(count, 70), np.full(count, 150))
    return frame_of(grid, positions, rng.integers(0, AMPLITUDE_STEPS, count), rng.integers(1, 10001, count))


def assert_same(found: list[VibrationFrame], expected: list[VibrationFrame]) -> None:
    for found_frame, expected_frame in zip(found, expected, strict=True):
        np.testing.assert_array_equal(found_frame.positions, expected_frame.positions)
        np.testing.assert_array_equal(found_frame.amplitudes_n, expected_frame.amplitudes_n)
        np.testing.assert_array_equal(found_frame.frequencies_hz, expected_frame.frequencies_hz)


DENSITIES = st.lists(st.sampled_from([0.0, 0.02, 0.5, 1.0]), min_size=1, max_size=4)


@pytest.mark.parametrize("grid", [GRID, WIDE], ids=["small", "wide"])
@given(seed=st.integers(0, 1000), densities=DENSITIES, is_random=st.booleans())
def test_exact_frames_round_trip(grid: Grid, seed: int, densities: list[float], is_random: bool) -> None:
    rng = np.random.default_rng(seed)
    frames = [random_frame(rng, grid, density, is_random) for density in densities]
    body = encode_vibration(frames)
    assert_same(decode_vibration(body, grid, len(frames)), frames)


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
    assert_same(decode_vibration(encode_vibration([found]), grid, 1), [found])  # nothing more is lost


def test_the_lowest_and_the_highest_step() -> None:
    steps = np.arange(AMPLITUDE_STEPS)
    positions = np.stack([np.zeros_like(steps), np.zeros_like(steps), steps], axis=1).astype(np.int32)
    grid = Grid((1, 1, AMPLITUDE_STEPS), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    frame = frame_of(grid, positions, steps, np.ones_like(steps))
    assert frame.amplitudes_n[0] == 2.0**-20 and frame.amplitudes_n[-1] == 7 * 2.0**17
    assert (np.diff(frame.amplitudes_n) > 0).all()
    assert_same(decode_vibration(encode_vibration([frame]), grid, 1), [frame])
    strong = VibrationFrame(grid, positions[:1], np.array([1e6], np.float32), np.ones(1, np.float32))
    with pytest.raises(InvalidArgument, match=r"an amplitude above 0\.9 meganewton"):
        encode_vibration([strong])


def test_unchanged_frames_cost_almost_nothing() -> None:
    rng = np.random.default_rng(1)
    first = random_frame(rng, GRID, 0.5)
    single_bytes, eight_bytes = len(encode_vibration([first])), len(encode_vibration([first] * 8))
    assert eight_bytes - single_bytes < single_bytes / 4


# -- bytes of strangers ------------------------------------------------------------------------------------

BODY = encode_vibration([random_frame(np.random.default_rng(s), GRID, 0.3) for s in range(3)])


def test_truncated_body_is_refused() -> None:
    """The code has no end marker: truncating a few bytes may decode to other values."""
    body = encode_vibration([random_frame(np.random.default_rng(s), GRID, 0.1) for s in range(2)])
    assert len(body) > 400
    for size in range(len(body) - 6):
        with pytest.raises(FormatError):
            decode_vibration(body[:size], GRID, 2)


def test_wrong_frame_counts_are_refused() -> None:
    for count in (1, 2, 4, 65535):
        with pytest.raises(FormatError):
            decode_vibration(BODY, GRID, count)
    for more in (bytes(8), bytes(8) + b"\1"):
        with pytest.raises(CorruptFile, match="bytes behind a code"):
            decode_vibration(BODY + more, GRID, 3)


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
def test_random_bytes_take_little_memory(data: bytes, frames: int) -> None:
    """It would be a MemoryError."""
    with suppress(FormatError):
        decode_vibration_in(30_000_000, data, WIDE, frames)


def test_memory_follows_the_samples() -> None:
    body = encode_vibration([frame_of(GRID, *(np.zeros(s, np.int32) for s in ((0, 3), 0, 0)))] * 50)
    assert decode_vibration_in(1 << 19, body, GRID, 50) == 0
    positions = np.argwhere(np.ones((24, 24, 24))).astype(np.int32)
    values = np.full(len(positions), 9)
    body = vibration_body(WIDE, [(positions[:1], values[:1], values[:1])] * 3)
    assert decode_vibration_in(1 << 19, body, WIDE, 3) == 3
    body = encode_vibration([frame_of(WIDE, positions, values, values)])
    assert decode_vibration_in(2 << 20, body, WIDE, 1) == 24**3
    with pytest.raises(MemoryError):
        decode_vibration_in(1 << 19, body, WIDE, 1)


def test_more_frames_or_bricks_than_bytes_are_refused() -> None:
    nothing = VibrationFrame.empty(WIDE)
    body = encode_vibration([nothing] * 100)
    assert len(body) == 96
    assert_same(decode_vibration(body, WIDE, 100), [nothing] * 100)
    with pytest.raises(TruncatedFile, match="more frames or bricks than the bytes may list"):
        decode_vibration(body[:-1], WIDE, 100)


@pytest.mark.parametrize(
    ("step", "hertz", "is_right"),
    [
        *((0, 1, True), (AMPLITUDE_STEPS - 1, 10000, True)),
        *((AMPLITUDE_STEPS, 1, False), (-1, 1, False), (0, 0, False), (0, 10001, False)),
    ],
    ids=str,
)
def test_values_out_of_range_are_corrupt(step: int, hertz: int, is_right: bool) -> None:
    positions = np.array([[1, 2, 3]], np.int32)
    body = vibration_body(GRID, [(positions, np.array([step]), np.array([hertz]))])
    if is_right:
        frame = frame_of(GRID, positions, np.array([step]), np.array([hertz]))
        assert body == encode_vibration([frame])
        assert_same(decode_vibration(body, GRID, 1), [frame])
        return
    with pytest.raises(CorruptFile, match="a vibration beyond its limit"):
        decode_vibration(body, GRID, 1)


def test_more_samples_than_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "1e-5")
    with pytest.raises(InvalidArgument, match="TOUCHFIELD_MEMORY_GIB"):
        decode_vibration(BODY, GRID, 3)
