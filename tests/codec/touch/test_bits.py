"""The range coder in C: round trip, the reference decoder, code length, and reading of random bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from native_model import (
    CODE,
    CONTEXTS,
    EVEN,
    GAMMA,
    MAX_INPUTS,
    MIX,
    logistic_tables,
    read_bits,
    write_bits,
)

from bit_writer import touch_bits


@st.composite
def scripts(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Random calls, int64 [n, 3], and the values they code."""
    bit = st.integers(0, 1)
    call = st.one_of(
        st.tuples(st.just(CODE), st.integers(0, CONTEXTS - 1), st.just(0), bit),
        st.tuples(st.just(MIX), st.integers(0, CONTEXTS - 1), st.integers(1, MAX_INPUTS), bit),
        st.integers(1, 40).flatmap(
            lambda n: st.tuples(st.just(EVEN), st.just(0), st.just(n), st.integers(0, 2**n - 1))
        ),
        st.integers(1, 30).flatmap(
            lambda n: st.tuples(st.just(GAMMA), st.just(0), st.just(n), st.integers(1, 2 ** (n + 1) - 1))
        ),
    )
    rows = draw(st.lists(call, min_size=1, max_size=30)) * draw(st.sampled_from([1, 1, 40]))
    table = np.array(rows, np.int64)
    return table[:, :3].copy(), table[:, 3].copy()


def reference_values(calls: np.ndarray, data: bytes) -> tuple[np.ndarray, int]:
    """The values that the reference decoder reads, and its position."""
    bits, values = touch_bits.Bits(data), []
    for n, (function, a, b) in enumerate(calls.tolist()):
        if function == CODE:
            values.append(bits.code(a))
        elif function == MIX:
            values.append(bits.mix([(a * (i + 3) + n * i) % CONTEXTS for i in range(b)], (a % 3, b)))
        else:
            values.append(bits.even(b) if function == EVEN else bits.gamma(b))
    return np.array(values, np.int64), bits.place


@given(scripts())
def test_written_values_are_read_back(script: tuple[np.ndarray, np.ndarray]) -> None:
    calls, values = script
    written, data = write_bits(calls, values)
    found = read_bits(calls, data)
    assert np.array_equal(found.values, values)
    # both sides have the same adapted models and position
    assert found.models == written.models and found.position == written.position + 6
    assert written.position <= len(data) <= found.position
    reference, position = reference_values(calls, data)
    assert np.array_equal(reference, values) and position == found.position
    if len(data) > written.position:
        # no code of one word less, below or above, and none without the last byte has these values
        stop = written.position + (len(data) - written.position - 1) // 2 * 2
        above = (int.from_bytes(data[:stop], "big") + 1) % 256**stop
        for shorter in (data[:-1], data[:stop], above.to_bytes(stop, "big")):
            assert not np.array_equal(read_bits(calls, shorter).values, values)


@given(st.binary(max_size=80), scripts())
def test_reader_of_random_bytes_stays_within_its_buffer(
    data: bytes, script: tuple[np.ndarray, np.ndarray]
) -> None:
    """Zeros follow the end of the buffer; values stay in their ranges."""
    calls, _ = script
    found = read_bits(calls, data).values
    assert np.array_equal(found, read_bits(calls, data + bytes(4000)).values)
    assert np.array_equal(found, reference_values(calls, data)[0])
    functions, width = calls[:, 0], calls[:, 2]
    assert (found[(functions == CODE) | (functions == MIX)] <= 1).all() and (found >= 0).all()
    assert (found[functions == EVEN] < np.int64(1) << width[functions == EVEN]).all()
    assert (found[functions == GAMMA] < np.int64(2) << width[functions == GAMMA]).all()
    assert (found[functions == GAMMA] > 0).all()


def test_carry_propagates_through_full_bytes() -> None:
    """Ones of a low probability keep the interval below a byte boundary until a carry crosses it."""
    carries = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        calls = np.array([(EVEN, 0, int(n)) for n in rng.integers(1, 17, 60)], np.int64)
        values = np.array([(1 << n) - 1 if rng.random() < 0.9 else 0 for _, _, n in calls], np.int64)
        _, data = write_bits(calls, values)
        assert np.array_equal(read_bits(calls, data).values, values)
        carries += b"\0\0" in data
    assert carries  # at least one carry crossed two full bytes


@pytest.mark.parametrize("length", [0, 1, 2, 50])
def test_expected_bits_cost_almost_nothing(length: int) -> None:
    calls = np.array([(CODE, 3, 0)] * 1000 + [(EVEN, 0, 8)] * length, np.int64)
    values = np.append(np.ones(1000, np.int64), np.zeros(length, np.int64))
    assert length <= len(write_bits(calls, values)[1]) <= length + 6


def test_tables_are_the_logistic_function() -> None:
    squash, stretch = logistic_tables()
    reach = len(squash) // 2
    x = np.arange(-reach, reach + 1) / 256
    exact = 65536 / (1 + np.exp(-x))
    assert np.abs(squash - np.clip(exact, 4, 65532)).max() < 1 and (np.diff(squash) >= 0).all()
    chance = (16 * np.arange(4096) + 8) / 65536
    assert np.abs(stretch / 256 - np.log(chance / (1 - chance)))[1:-1].max() < 0.15
