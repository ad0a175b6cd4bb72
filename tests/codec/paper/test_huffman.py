"""Huffman codes and runs of held samples: theoretical identities, and errors for faulty streams."""

from __future__ import annotations

import heapq
import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.codec.paper.body import MAX_CODE_BITS, RUN_SYMBOLS, BitStream, HuffmanCode, decode_symbols
from touchfield.codec.paper.encoder import encode_symbols, fitted_code, pack_runs
from touchfield.codec.support import encode_numbers
from touchfield.errors import CorruptFile, FormatError, InvalidArgument

COUNTS = st.lists(st.integers(0, 1000) | st.integers(0, 3), min_size=1, max_size=60).filter(any)
FLAGS = st.lists(st.tuples(st.booleans(), st.integers(1, 300)), max_size=20).map(
    lambda runs: np.repeat([s for s, _ in runs], [n for _, n in runs]).astype(np.bool_)
)


def entropy_bits(counts: list[int]) -> float:
    total = sum(counts)
    return -sum(c / total * math.log2(c / total) for c in counts if c)


def heap_bits(counts: list[int]) -> int:
    """Total bits of an optimal code without a length limit."""
    heap = [c for c in counts if c]
    heapq.heapify(heap)
    total = 0
    while len(heap) > 1:
        joined = heapq.heappop(heap) + heapq.heappop(heap)
        total += joined
        heapq.heappush(heap, joined)
    return total


def encode_runs(
    sent: np.ndarray, levels: np.ndarray, count: int, single: bool = False
) -> tuple[HuffmanCode, BitStream]:
    symbols, values, bits = pack_runs(sent, levels, count, single=single)
    code = fitted_code(np.bincount(symbols, minlength=count + RUN_SYMBOLS))
    return code, encode_symbols(code, symbols, values, bits)


@pytest.mark.parametrize(
    ("counts", "entropy", "length"),
    [([4, 2, 2, 1, 1], 2.121928, 2.2), ([9, 1], 0.468996, 1.0), ([4, 2, 1, 1], 1.75, 1.75), ([7], 0.0, 1.0)],
)
def test_known_mean_lengths(counts: list[int], entropy: float, length: float) -> None:
    assert entropy_bits(counts) == pytest.approx(entropy, abs=1e-6)
    assert np.dot(counts, fitted_code(np.array(counts)).lengths) / sum(counts) == pytest.approx(length)


@given(COUNTS)
def test_lengths_are_optimal_and_within_a_bit_of_the_entropy(counts: list[int]) -> None:
    code = fitted_code(np.array(counts))
    bits = int(np.dot(counts, code.lengths.astype(int)))
    assert ((code.lengths > 0) == (np.array(counts) > 0)).all()
    if sum(c > 0 for c in counts) > 1:
        assert bits == heap_bits(counts)
        assert entropy_bits(counts) - 1e-9 <= bits / sum(counts) < entropy_bits(counts) + 1


def test_lengths_are_limited() -> None:
    fibonacci = [1, 1]
    while len(fibonacci) < 40:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    code = fitted_code(np.array(fibonacci))
    assert code.lengths.max() <= MAX_CODE_BITS and sum(2.0 ** -int(n) for n in code.lengths) == 1.0
    assert np.dot(fibonacci, code.lengths.astype(int)) < heap_bits(fibonacci) * 1.001
    symbols = np.arange(40).repeat(3)
    _, levels = decode_symbols(code, encode_symbols(code, symbols), len(symbols), 40)
    assert levels.tolist() == symbols.tolist()


@pytest.mark.parametrize("lengths", [[1, 1, 1], [2], [1, 2], [25] * 4, [1, 2, 3, 0]])
def test_incomplete_codes_are_refused(lengths: list[int]) -> None:
    with pytest.raises(InvalidArgument):
        HuffmanCode(np.array(lengths, np.uint8))
    with pytest.raises(CorruptFile):
        HuffmanCode.from_bytes(encode_numbers(np.array(lengths, np.int32)), len(lengths))


@given(COUNTS, st.integers(0, 500), st.data())
def test_table_round_trip_and_changed_tables(counts: list[int], absent: int, data: st.DataObject) -> None:
    code = fitted_code(np.array(counts + [0] * absent))
    table = encode_numbers(code.lengths)
    assert HuffmanCode.from_bytes(table, len(code.lengths)).lengths.tolist() == code.lengths.tolist()
    assert len(table) <= len(counts) + 12
    changed = bytearray(table)
    changed[data.draw(st.integers(0, len(table) - 1))] ^= data.draw(st.integers(1, 255))
    for wrong, n in (
        (bytes(changed), len(code.lengths)),
        (table, len(code.lengths) + 1),
        (table[:-1], len(counts)),
    ):
        try:
            restored = HuffmanCode.from_bytes(wrong, n)
        except FormatError:
            continue
        assert len(restored.lengths) == n


def test_bytes_are_fixed() -> None:
    code = fitted_code(np.array([4, 2, 2, 1, 1]))
    assert code.lengths.tolist() == [2, 2, 2, 3, 3]  # 00 01 10 110 111
    stream = encode_symbols(code, np.array([0, 1, 2, 3, 4, 0]))
    assert (stream.data.hex(), stream.bit_length) == ("1b70", 14)
    sent = np.array([1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1], np.bool_)
    streams = pack_runs(sent, np.array([0, 1, 1, 0], np.uint16), 2, single=False)
    assert [s.tolist() for s in streams] == [[0, 3, 1, 1, 4, 0], [0, 1, 0, 0, 2, 0], [0, 1, 0, 0, 2, 0]]
    lengths = np.zeros(2 + RUN_SYMBOLS, np.uint8)
    lengths[[0, 1, 3, 4]] = 1, 2, 3, 3
    stream = encode_symbols(HuffmanCode(lengths), *streams)
    assert (stream.data.hex(), stream.bit_length) == ("6d78", 15)  # 0 110 1 10 10 111 10 0


@given(FLAGS, st.integers(1, 70), st.booleans())
def test_runs_round_trip(sent: np.ndarray, level_count: int, single: bool) -> None:
    levels = (np.arange(np.count_nonzero(sent)) ** 2 % level_count).astype(np.uint16)
    code, stream = encode_runs(sent, levels, level_count, single)
    read = decode_symbols(code, stream, len(sent), level_count)
    assert np.array_equal(read[0], sent) and np.array_equal(read[1], levels)
    for wrong in (len(sent) + 1, max(0, len(sent) - 1), 5 * len(sent) + 7):
        if wrong != len(sent):
            with pytest.raises(CorruptFile):
                decode_symbols(code, stream, wrong, level_count)


def test_runs_of_every_length() -> None:
    for length in (1, 2, 3, 4, 7, 8, 1000, 2**21 - 1, 2**21, 2**22 + 5):
        symbols, values, bits = pack_runs(np.zeros(length, np.bool_), np.zeros(0, np.uint16), 4, single=False)
        assert sum((1 << int(s) - 4) + int(v) for s, v in zip(symbols, values, strict=True)) == length
        assert (
            len(symbols) == -(-length // (2**21 - 1))
            and (bits == symbols - 4).all()
            and (values >> bits == 0).all()
        )


@given(FLAGS.filter(len), st.binary(min_size=1, max_size=40), st.data())
def test_random_bits_are_an_error_or_runs(sent: np.ndarray, noise: bytes, data: st.DataObject) -> None:
    levels = (np.arange(np.count_nonzero(sent)) ** 2 % 9).astype(np.uint16)
    code, (encoded, bits) = encode_runs(sent, levels, 9)
    flipped = bytearray(encoded)
    flipped[data.draw(st.integers(0, len(encoded) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    for wrong, length in (
        (bytes(flipped), bits),
        (noise, 8 * len(noise)),
        (encoded[:-1], bits),
        (encoded, bits + 8),
    ):
        try:
            read, read_levels = decode_symbols(code, BitStream(wrong, length), len(sent), 9)
        except FormatError:
            continue
        assert (
            len(read) == len(sent) and len(read_levels) == np.count_nonzero(read) and (read_levels < 9).all()
        )


def test_an_empty_alphabet_has_no_stream() -> None:
    for n in (0, 5):
        code = fitted_code(np.zeros(n, np.int64))
        assert encode_symbols(code, np.zeros(0, np.int64)) == (b"", 0)
        assert len(decode_symbols(code, BitStream(b"", 0), 0, n)[1]) == 0
        with pytest.raises(CorruptFile):
            decode_symbols(code, BitStream(b"\0", 8), 1, n)
