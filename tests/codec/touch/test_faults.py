"""Damaged bodies raise only the named errors, in bounded memory; `bench/fuzz_touch.py` searches longer."""

from __future__ import annotations

import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile, UnsupportedVersion

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "bench"))

import fuzz_touch as fuzz

NAMED = (CorruptFile, TruncatedFile, UnsupportedVersion)


@pytest.fixture(scope="module")
def valid_segments() -> dict[str, fuzz.Good]:
    """A valid segment of each mode and base layer."""
    return {name: make() for name, make in fuzz.makers().items()}


@pytest.mark.parametrize("name", fuzz.makers())
def test_truncated_segment_is_refused(valid_segments: dict[str, fuzz.Good], name: str) -> None:
    good = valid_segments[name]
    decoder, body = good.decoder, good.body
    assert len(list(decoder.frames(body, good.frames))) == good.frames
    rng = np.random.default_rng(0)
    for n in sorted({*range(12), len(body) - 1, *rng.integers(0, len(body), 12).tolist()}):
        with pytest.raises(NAMED):
            list(decoder.frames(body[:n], good.frames))
    with pytest.raises(NAMED):
        list(decoder.frames(body + b"\0", good.frames))
    for count in (good.frames - 1, good.frames + 1):
        with pytest.raises(NAMED):
            list(decoder.frames(body, count))


@pytest.mark.parametrize("seed", range(4))
def test_a_changed_segment_is_refused_or_is_another(valid_segments: dict[str, fuzz.Good], seed: int) -> None:
    """Changed bodies, payloads, base layers and outliers, with the lengths around them corrected."""
    pool = list(valid_segments.values())
    outcomes = set()
    tracemalloc.start()
    for number in range(60):
        case = fuzz.case_of(pool, seed, number)
        before = tracemalloc.get_traced_memory()[0]
        tracemalloc.reset_peak()
        found = fuzz.run(case)
        assert not found.startswith("FAULT"), f"--replay {seed} {number}: {found}"
        assert tracemalloc.get_traced_memory()[1] - before < fuzz.bytes_allowed(case), (
            f"--replay {seed} {number}"
        )
        outcomes.add(found)
    tracemalloc.stop()
    assert {"CorruptFile"} <= outcomes <= {"decoded", *(error.__name__ for error in NAMED)}


def test_random_bytes_are_no_segment(valid_segments: dict[str, fuzz.Good]) -> None:
    rng = np.random.default_rng(2)
    for good in valid_segments.values():
        for size in (0, 1, 30, 300):
            with pytest.raises(NAMED):
                list(good.decoder.frames(rng.bytes(size), 2))


def test_named_errors_are_of_the_format() -> None:
    assert all(issubclass(error, FormatError) for error in NAMED) and not issubclass(
        InvalidArgument, FormatError
    )
