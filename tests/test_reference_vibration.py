"""docs/format.md is enough for VIBR too: a decoder that follows it alone finds the same numbers."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.codec.vibration import AMPLITUDE_STEPS, VibrationSymbols, decode_symbols, encode_symbols
from touchfield.errors import FormatError
from touchfield.job import open_stream
from touchfield.medium import Grid

CONFORMANCE = Path(__file__).resolve().parents[1] / "conformance"
sys.path.append(str(CONFORMANCE))  # where the decoder looks for its parts
decoder: Any = importlib.import_module("reference_decoder")
reference: Any = importlib.import_module("reference_vibration")
GRID = Grid((9, 7, 10), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))


def symbols(rng: np.random.Generator) -> VibrationSymbols:
    """Some samples, now many, now none."""
    positions = np.argwhere(rng.random(GRID.shape) < rng.choice([0.0, 0.02, 0.3])).astype(np.int32)
    amplitudes = rng.integers(0, AMPLITUDE_STEPS, len(positions)).astype(np.int32)
    hertz = rng.integers(1, rng.choice([2, 300, 10001]), len(positions)).astype(np.int32)
    return VibrationSymbols(positions, amplitudes, hertz)


def mine(body: bytes, frames: int) -> list[list[tuple[Any, ...]]] | None:
    """Samples with amplitude and frequency as the reference finds them; None where it refuses the bytes."""
    try:
        found = reference.decode_vibration(body, frames, GRID.shape)
    except ValueError:
        return None
    return [[(sample, step, hertz[sample]) for sample, step in steps.items()] for steps, hertz in found]


def theirs(body: bytes, frames: int) -> list[list[tuple[Any, ...]]] | None:
    """The same by the package."""
    try:
        found = decode_symbols(body, GRID, frames)
    except FormatError:
        return None
    columns = [(one.positions.tolist(), one.amplitudes.tolist(), one.frequencies.tolist()) for one in found]
    return [[(tuple(p), a, f) for p, a, f in zip(*three, strict=True)] for three in columns]


def test_the_golden_stream() -> None:
    stream = CONFORMANCE / "v0" / "vibration.touch"
    decoded = decoder.decode(stream)
    with np.load(stream.with_suffix(".vibration.npz")) as expected:
        np.testing.assert_array_equal(decoded["amplitudes_n"], expected["amplitudes_n"])
        np.testing.assert_array_equal(decoded["frequencies_hz"], expected["frequencies_hz"])
    with open_stream(stream) as opened:
        assert opened.medium.vibration is not None
    assert "amplitudes_n" not in decoder.decode(stream.with_name("touch_empty.touch"))


@pytest.mark.parametrize("seed", range(6))
def test_the_same_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    body = encode_symbols(GRID, [symbols(rng) for _ in range(4)])
    assert mine(body, 4) == theirs(body, 4) is not None


def test_both_refuse_the_same_bytes() -> None:
    rng = np.random.default_rng(3)
    bodies = [encode_symbols(GRID, [symbols(np.random.default_rng(s)) for _ in range(2)]) for s in (0, 1, 4)]
    refused = 0
    for _ in range(150):
        body = bytearray(bodies[rng.integers(len(bodies))])
        body[rng.integers(len(body))] ^= 1 << rng.integers(8)
        changed = bytes(body[: len(body) - (rng.random() < 0.1)])
        expected = theirs(changed, 2)
        assert mine(changed, 2) == expected, changed.hex()
        refused += expected is None
    assert refused > 100
