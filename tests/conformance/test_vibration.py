"""The decoder written from docs/format/vibration.md alone finds the same numbers in VIBR."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
import pytest
from second import reading

from touchfield.codec.vibration import AMPLITUDE_STEPS, decode_vibration, encode_vibration
from touchfield.errors import FormatError
from touchfield.medium import Grid
from touchfield.medium.medium import VibrationFrame

part: Any = importlib.import_module("decode_vibration")
GRID = Grid((9, 7, 18), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))


def random_frame(rng: np.random.Generator) -> VibrationFrame:
    """Random samples, of amplitudes that are coded exactly: many, few or none."""
    positions = np.argwhere(rng.random(GRID.shape) < rng.choice([0.0, 0.02, 0.3])).astype(np.int32)
    steps = rng.integers(0, AMPLITUDE_STEPS, len(positions))
    hertz = rng.integers(1, rng.choice([2, 300, 10001]), len(positions)).astype(np.float32)
    return VibrationFrame(
        GRID, positions, ((4 + steps % 4) * 2.0 ** (steps // 4 - 22)).astype(np.float32), hertz
    )


def decode_with_reference(body: bytes, frames: int) -> list[bytes] | str:
    """Amplitudes and frequencies as dense arrays from the reference decoder,
    or the name of the error if it refuses the bytes.
    """
    try:
        return [frame.tobytes() for frame in part.decode_segment(body, GRID.shape, frames)]
    except reading.FaultyFile as error:
        return type(error).__name__


def decode_with_package(body: bytes, frames: int) -> list[bytes] | str:
    """The same from the package."""
    try:
        return [dense_bytes(frame) for frame in decode_vibration(body, GRID, frames)]
    except FormatError as error:
        return type(error).__name__


def dense_bytes(frame: VibrationFrame) -> bytes:
    """Amplitudes and frequencies as dense arrays, as of the reference decoder."""
    return np.ascontiguousarray(np.moveaxis(frame.as_field().to_dense()[..., :2], -1, 0)).tobytes()


@pytest.mark.parametrize("seed", range(6))
def test_the_same_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    frames = [random_frame(rng) for _ in range(4)]
    body = encode_vibration(frames)
    found = decode_with_reference(body, 4)
    assert found == decode_with_package(body, 4) == [dense_bytes(frame) for frame in frames]


def test_both_refuse_the_same_bytes() -> None:
    rng = np.random.default_rng(3)
    bodies = [encode_vibration([random_frame(np.random.default_rng(s)) for _ in range(2)]) for s in (0, 1, 4)]
    refused = 0
    for _ in range(150):
        body = bytearray(bodies[rng.integers(len(bodies))])
        body[rng.integers(len(body))] ^= 1 << rng.integers(8)
        changed = bytes(body[: len(body) - (rng.random() < 0.1)])
        expected = decode_with_package(changed, 2)
        assert decode_with_reference(changed, 2) == expected, changed.hex()
        refused += isinstance(expected, str)
    assert 50 < refused < 150
