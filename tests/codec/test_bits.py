"""The range coder of `touch`: round trip, code length, and reading of random bytes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numba import njit

from touchfield.codec import kernels
from touchfield.codec.kernels import (
    INPUTS,
    POSITION,
    SQUASH,
    STRETCH,
    Bits,
    finish,
    new_models,
    reader,
    writer,
)  # fmt: skip

CONTEXTS, SETS = 64, 3
CODE, MIX, EVEN = range(3)


@njit
def run(bits: Any, calls: Any, values: Any) -> None:
    """Code values by calls (function, argument, parameter); a reader fills `values`."""
    for n in range(len(calls)):
        function, a, b = calls[n]
        if function == CODE:
            values[n] = kernels.code(bits, a, values[n])
        elif function == MIX:
            for i in range(b):
                bits.inputs[i] = (a * (i + 3) + n * i) % CONTEXTS
            values[n] = kernels.mix(bits, b, a % SETS, values[n])
        else:
            values[n] = kernels.even(bits, values[n], b)


def models() -> kernels.Models:
    return new_models(CONTEXTS, SETS)


def write_bits(calls: np.ndarray, values: np.ndarray) -> tuple[Bits, bytes]:
    bits = writer(16 * len(calls) + 64, models())
    run(bits, calls, values.copy())
    return bits, finish(bits)


@st.composite
def scripts(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Random calls, int64 [n, 3], and the values they code."""
    bit = st.integers(0, 1)
    call = st.one_of(
        st.tuples(st.just(CODE), st.integers(0, CONTEXTS - 1), st.just(0), bit),
        st.tuples(st.just(MIX), st.integers(0, CONTEXTS - 1), st.integers(1, INPUTS), bit),
        st.integers(1, 40).flatmap(
            lambda n: st.tuples(st.just(EVEN), st.just(0), st.just(n), st.integers(0, 2**n - 1))
        ),
    )
    rows = draw(st.lists(call, min_size=1, max_size=30)) * draw(st.sampled_from([1, 1, 40]))
    table = np.array(rows, np.int64)
    return table[:, :3].copy(), table[:, 3].copy()


@given(scripts())
def test_written_values_are_read_back(script: tuple[np.ndarray, np.ndarray]) -> None:
    calls, values = script
    writer_state, data = write_bits(calls, values)
    bits = reader(data, models())
    found = np.zeros_like(values)
    run(bits, calls, found)
    assert np.array_equal(found, values)
    # both sides have the same adapted state and position
    assert np.array_equal(bits.probabilities, writer_state.probabilities) and np.array_equal(
        bits.weights, writer_state.weights
    )
    assert bits.state[POSITION] == writer_state.state[POSITION] + 6
    written = int(writer_state.state[POSITION])
    assert written <= len(data) <= bits.state[POSITION]
    if len(data) > written:
        # no code of one word less, below or above, and none without the last byte has these values
        stop = written + (len(data) - written - 1) // 2 * 2
        above = (int.from_bytes(data[:stop], "big") + 1) % 256**stop
        for shorter in (data[:-1], data[:stop], above.to_bytes(stop, "big")):
            run(reader(shorter, models()), calls, found)
            assert not np.array_equal(found, values)


@given(st.binary(max_size=80), scripts())
def test_reader_of_random_bytes_stays_within_its_buffer(
    data: bytes, script: tuple[np.ndarray, np.ndarray]
) -> None:
    """Zeros follow the end of the buffer; values stay in their ranges."""
    calls, _ = script
    bits = reader(data, models())
    found = np.zeros(len(calls), np.int64)
    run(bits, calls, found)
    longer = reader(data + bytes(4000), models())
    found_in_longer = np.zeros(len(calls), np.int64)
    run(longer, calls, found_in_longer)
    assert np.array_equal(found, found_in_longer)
    functions, width = calls[:, 0], calls[:, 2]
    assert (found[(functions == CODE) | (functions == MIX)] <= 1).all() and (found >= 0).all()
    assert (found[functions == EVEN] < np.int64(1) << width[functions == EVEN]).all()
    assert (found < 1 << 40).all()


def test_carry_propagates_through_full_bytes() -> None:
    """Ones of a low probability keep the interval below a byte boundary until a carry crosses it."""
    carries = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        calls = np.array([(EVEN, 0, int(n)) for n in rng.integers(1, 17, 60)], np.int64)
        values = np.array([(1 << n) - 1 if rng.random() < 0.9 else 0 for _, _, n in calls], np.int64)
        _, data = write_bits(calls, values)
        found = np.zeros_like(values)
        run(reader(data, models()), calls, found)
        assert np.array_equal(found, values)
        carries += b"\0\0" in data
    assert carries  # at least one carry crossed two full bytes


@pytest.mark.parametrize("length", [0, 1, 2, 50])
def test_expected_bits_cost_almost_nothing(length: int) -> None:
    calls = np.array([(CODE, 3, 0)] * 1000 + [(EVEN, 0, 8)] * length, np.int64)
    values = np.append(np.ones(1000, np.int64), np.zeros(length, np.int64))
    assert length <= len(write_bits(calls, values)[1]) <= length + 6


def test_tables_are_the_logistic_function() -> None:
    reach = len(SQUASH) // 2
    x = np.arange(-reach, reach + 1) / 256
    exact = 65536 / (1 + np.exp(-x))
    assert np.abs(SQUASH - np.clip(exact, 4, 65532)).max() < 1 and (np.diff(SQUASH) >= 0).all()
    chance = (16 * np.arange(4096) + 8) / 65536
    assert np.abs(STRETCH / 256 - np.log(chance / (1 - chance)))[1:-1].max() < 0.15
