"""Variable-length integers, and integers in the adaptive code."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.codec.support import MAX_NUMBER, decode_numbers, encode_numbers
from touchfield.codec.varint import VARINT_LIMIT, read_varint, write_varint
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile


@given(st.integers(0, VARINT_LIMIT - 1) | st.integers(0, 300), st.binary(max_size=3))
def test_varint_round_trip_and_canonical_form(value: int, before: bytes) -> None:
    data = before + write_varint(value)
    assert read_varint(data + b"\xff", len(before)) == (value, len(data))
    assert len(write_varint(value)) == max(1, -(-value.bit_length() // 7))
    with pytest.raises(TruncatedFile):
        read_varint(data[:-1], len(before))
    with pytest.raises(CorruptFile):
        read_varint(data, len(before), "count", value)


def test_varint_bytes() -> None:
    expected = {0: "00", 127: "7f", 128: "8001", 300: "ac02", 1 << 55: "8080808080808040"}
    assert {value: write_varint(value).hex() for value in expected} == expected
    for wrong in (b"\x80\x00", b"\xff" * 9, b"\x80" * 8 + b"\x01"):
        with pytest.raises(CorruptFile):
            read_varint(wrong, 0)
    for value in (-1, VARINT_LIMIT):
        with pytest.raises(InvalidArgument):
            write_varint(value)


@given(st.lists(st.integers(-MAX_NUMBER, MAX_NUMBER) | st.integers(-3, 3), max_size=200))
def test_numbers_round_trip(numbers: list[int]) -> None:
    array = np.array(numbers, np.int32)
    data = encode_numbers(array)
    np.testing.assert_array_equal(decode_numbers(data, len(array)), array)
    with pytest.raises(CorruptFile):
        decode_numbers(data + bytes(8), len(array))


@given(st.binary(max_size=60), st.integers(0, 300))
def test_any_bytes_are_numbers_or_a_fault(data: bytes, count: int) -> None:
    with suppress(FormatError):
        numbers = decode_numbers(data, count)
        assert numbers.shape == (count,) and (np.abs(numbers) <= MAX_NUMBER).all()


def test_too_large_numbers_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="numbers"):
        encode_numbers(np.array([MAX_NUMBER + 1]))
    np.testing.assert_array_equal(
        decode_numbers(encode_numbers(np.array([MAX_NUMBER, -MAX_NUMBER])), 2), [MAX_NUMBER, -MAX_NUMBER]
    )
    with pytest.raises(CorruptFile, match=r"beyond 2\^30 - 1"):
        decode_numbers(bytes(30), 3)  # decodes to ones: negative numbers with the most digits
