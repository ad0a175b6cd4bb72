"""Huffman codes, runs of held samples and varints: the identities of theory.md, and every fault an error."""

from __future__ import annotations

import contextlib
import heapq
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from touchfield.codec.huffman import MAX_CODE_BITS, HuffmanCode, decode_plain, encode_plain
from touchfield.codec.runs import RUN_SYMBOLS, decode_runs, encode_runs, pack_runs, unpack_runs
from touchfield.codec.varint import VARINT_LIMIT, read_varint, write_varint
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile

COUNTS = st.lists(st.integers(0, 1000) | st.integers(0, 3), min_size=1, max_size=60).filter(any)


def entropy_bits(counts: list[int]) -> float:
    total = sum(counts)
    return -sum(c / total * math.log2(c / total) for c in counts if c)


def heap_bits(counts: list[int]) -> int:
    """Total bits of an optimal code without a limit, by Huffman's own merging."""
    heap = [c for c in counts if c]
    heapq.heapify(heap)
    total = 0
    while len(heap) > 1:
        joined = heapq.heappop(heap) + heapq.heappop(heap)
        total += joined
        heapq.heappush(heap, joined)
    return total


def code_words(code: HuffmanCode) -> list[str]:
    return [f"{entry >> 5:0{entry & 31}b}" for entry in code.codes.tolist() if entry & 31]


# -- lengths ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counts", "entropy", "length"),
    [([4, 2, 2, 1, 1], 2.121928, 2.2), ([9, 1], 0.468996, 1.0), ([4, 2, 1, 1], 1.75, 1.75), ([7], 0.0, 1.0)],
)
def test_known_mean_lengths(counts: list[int], entropy: float, length: float) -> None:
    assert entropy_bits(counts) == pytest.approx(entropy, abs=1e-6)
    assert HuffmanCode.fit(counts).mean_length(counts) == pytest.approx(length, abs=1e-12)


@given(COUNTS)
def test_lengths_are_optimal_and_within_a_bit_of_the_entropy(counts: list[int]) -> None:
    code = HuffmanCode.fit(counts)
    bits = int(np.dot(counts, code.lengths.astype(int)))
    assert ((code.lengths > 0) == (np.array(counts) > 0)).all()
    if sum(c > 0 for c in counts) > 1:
        assert bits == heap_bits(counts)
        assert entropy_bits(counts) - 1e-9 <= code.mean_length(counts) < entropy_bits(counts) + 1


@given(COUNTS)
def test_codes_are_prefix_free_and_in_canonical_order(counts: list[int]) -> None:
    words = code_words(HuffmanCode.fit(counts))
    assert not any(a is not b and b.startswith(a) for a in words for b in words)
    lengths = [len(w) for w in words]
    in_order = sorted(range(len(words)), key=lambda s: (lengths[s], s))
    values = [int(words[s].ljust(MAX_CODE_BITS, "0"), 2) for s in in_order]
    assert values == sorted(values) and values[0] == 0


def test_lengths_are_limited_to_24_bits() -> None:
    fibonacci = [1, 1]
    while len(fibonacci) < 40:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    code = HuffmanCode.fit(fibonacci)
    assert code.lengths.max() == MAX_CODE_BITS
    assert sum(2.0 ** -int(n) for n in code.lengths) == 1.0
    assert heap_bits(fibonacci) < np.dot(fibonacci, code.lengths.astype(int)) < heap_bits(fibonacci) * 1.0001
    symbols = np.arange(40).repeat(3).astype(np.uint16)
    data, bit_length = encode_plain(code, symbols)
    assert np.array_equal(decode_plain(code, data, bit_length, len(symbols)), symbols)


def test_empty_alphabets() -> None:
    for n in (0, 5):
        code = HuffmanCode.fit(np.zeros(n, np.int64))
        assert encode_plain(code, np.zeros(0, np.uint16)) == (b"", 0)
        assert len(decode_plain(code, b"", 0, 0)) == 0
        assert HuffmanCode.from_bytes(code.to_bytes(), 0, n)[0].lengths.tolist() == [0] * n
        with pytest.raises(CorruptFile):
            decode_plain(code, b"\0", 8, 1)


@pytest.mark.parametrize("counts", [[1, -1], [[1, 2]], [1.5], np.ones(70000, int), [1 << 60, 1]])
def test_counts_that_cannot_be_fitted(counts: object) -> None:
    with pytest.raises(InvalidArgument):
        HuffmanCode.fit(counts)  # type: ignore[arg-type]


@pytest.mark.parametrize("lengths", [[1], [1, 1, 1], [2], [1, 2], [25] * 4, [1, 2, 3, 0]])
def test_lengths_that_are_no_complete_code(lengths: list[int]) -> None:
    if lengths == [1]:
        assert HuffmanCode(np.array(lengths, np.uint8)).symbol_count == 1
        return
    with pytest.raises(InvalidArgument):
        HuffmanCode(np.array(lengths, np.uint8))


# -- the table --------------------------------------------------------------------------------------------


@given(COUNTS, st.integers(0, 500), st.binary(max_size=3))
def test_a_table_reads_back(counts: list[int], absent: int, before: bytes) -> None:
    code = HuffmanCode.fit(counts + [0] * absent)
    data = before + code.to_bytes()
    read, end = HuffmanCode.from_bytes(data + b"after", len(before), code.symbol_count)
    assert np.array_equal(read.lengths, code.lengths) and end == len(data)
    assert len(code.to_bytes()) <= 1.5 * len(counts) + 4


def test_tables_are_small_and_their_bytes_are_fixed() -> None:
    assert HuffmanCode.fit([4, 2, 2, 1, 1] + [0] * 100).to_bytes().hex() == "9024454bac10"
    sparse = np.zeros(4000, np.int64)
    sparse[[0, 1999, 3999]] = 1
    assert len(HuffmanCode.fit(sparse).to_bytes()) <= 10


@given(COUNTS, st.data())
def test_a_cut_or_changed_table_is_an_error_or_a_code(counts: list[int], data: st.DataObject) -> None:
    table = HuffmanCode.fit(counts).to_bytes()
    with pytest.raises(TruncatedFile):
        HuffmanCode.from_bytes(table[: data.draw(st.integers(0, len(table) - 1))], 0, len(counts))
    changed = bytearray(table)
    changed[data.draw(st.integers(0, len(table) - 1))] ^= data.draw(st.integers(1, 255))
    for wrong, n in ((bytes(changed), len(counts)), (table, len(counts) + 1), (table, 1 << 17)):
        try:
            code, _ = HuffmanCode.from_bytes(wrong, 0, n)
        except FormatError:
            continue
        assert code.symbol_count == n


# -- plain streams ----------------------------------------------------------------------------------------


@given(st.lists(st.integers(0, 300), max_size=400), st.integers(0, 2000))
def test_plain_symbols_read_back(symbols: list[int], skew: int) -> None:
    counts = np.bincount(symbols, minlength=301) + (np.arange(301) < skew % 300) * skew
    code = HuffmanCode.fit(counts)
    for dtype in (np.uint16, np.int32):
        data, bit_length = encode_plain(code, np.array(symbols, dtype))
        assert len(data) == -(-bit_length // 8) and bit_length == code.lengths[symbols].sum(dtype=int)
        assert decode_plain(code, data, bit_length, len(symbols)).tolist() == symbols


def test_plain_bytes_are_fixed() -> None:
    code = HuffmanCode.fit([4, 2, 2, 1, 1])
    assert code_words(code) == ["00", "01", "10", "110", "111"]
    data, bit_length = encode_plain(code, np.array([0, 1, 2, 3, 4, 0], np.uint16))
    assert (data.hex(), bit_length) == ("1b70", 14)


@given(st.lists(st.integers(0, 9), min_size=1, max_size=60), st.data())
def test_faults_of_a_plain_stream(symbols: list[int], data: st.DataObject) -> None:
    code = HuffmanCode.fit(np.bincount(symbols, minlength=10))
    coded, bits = encode_plain(code, np.array(symbols))
    with pytest.raises(TruncatedFile):
        decode_plain(code, coded[:-1], bits, len(symbols))
    with pytest.raises(CorruptFile):
        decode_plain(code, coded + b"\0", bits, len(symbols))
    with pytest.raises(CorruptFile):
        decode_plain(code, coded, bits, len(symbols) - 1)
    with pytest.raises(CorruptFile):
        decode_plain(code, coded, bits, bits + 1)
    flipped = bytearray(coded)
    flipped[data.draw(st.integers(0, len(coded) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    with contextlib.suppress(FormatError):
        assert decode_plain(code, bytes(flipped), bits, len(symbols)).tolist() != symbols


def test_symbols_without_a_code() -> None:
    code = HuffmanCode.fit([3, 0, 1])
    for symbols in ([1], [3], [-1], [70000]):
        with pytest.raises(InvalidArgument):
            encode_plain(code, np.array(symbols))
    with pytest.raises(InvalidArgument):
        encode_plain(code, np.array([3], np.uint16))
    with pytest.raises(CorruptFile):
        decode_plain(HuffmanCode.fit([5]), b"\x40", 2, 2)


# -- runs -------------------------------------------------------------------------------------------------

FLAGS = st.lists(st.tuples(st.booleans(), st.integers(1, 300)), max_size=20).map(
    lambda runs: np.repeat([s for s, _ in runs], [n for _, n in runs]).astype(np.bool_)
)


def levels_for(sent: np.ndarray, level_count: int) -> np.ndarray:
    return (np.arange(np.count_nonzero(sent)) ** 2 % level_count).astype(np.uint16)


@given(FLAGS, st.integers(1, 70), st.booleans())
def test_runs_read_back(sent: np.ndarray, level_count: int, single: bool) -> None:
    levels = levels_for(sent, level_count)
    streams = pack_runs(sent, levels, level_count, single=single)
    assert all(
        np.array_equal(a, b) for a, b in zip(unpack_runs(*streams[:2], level_count, len(sent)), (sent, levels))
    )
    if single:
        assert len(streams[0]) == len(sent) and (streams[0][~sent] == level_count).all()
    code = HuffmanCode.fit(np.bincount(streams[0], minlength=level_count + RUN_SYMBOLS))
    data, bit_length = encode_runs(code, *streams)
    read = decode_runs(code, data, bit_length, len(sent), level_count)
    assert np.array_equal(read[0], sent) and np.array_equal(read[1], levels)
    for wrong in (len(sent) + 1, max(0, len(sent) - 1), 5 * len(sent) + 7):
        if wrong != len(sent):
            with pytest.raises(FormatError):
                decode_runs(code, data, bit_length, wrong, level_count)


def test_runs_of_every_length() -> None:
    for length in (1, 2, 3, 4, 7, 8, 1000, 2**21 - 1, 2**21, 2**22 + 5):
        symbols, values, bits = pack_runs(np.zeros(length, np.bool_), np.zeros(0, np.uint16), 4)
        assert sum((1 << (int(s) - 4)) + int(v) for s, v in zip(symbols, values)) == length
        assert len(symbols) == -(-length // (2**21 - 1)) and (bits == symbols - 4).all()
        assert len(unpack_runs(symbols, values, 4, length)[0]) == length


def test_run_bytes_are_fixed() -> None:
    sent = np.array([1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1], np.bool_)
    streams = pack_runs(sent, np.array([0, 1, 1, 0], np.uint16), 2)
    assert [s.tolist() for s in streams] == [[0, 3, 1, 1, 4, 0], [0, 1, 0, 0, 2, 0], [0, 1, 0, 0, 2, 0]]
    lengths = np.zeros(2 + RUN_SYMBOLS, np.uint8)
    lengths[[0, 1, 3, 4]] = 1, 2, 3, 3
    data, bit_length = encode_runs(HuffmanCode(lengths), *streams)
    assert (data.hex(), bit_length) == ("6d78", 15)  # 0 110 1 10 10 111 10 0


@given(FLAGS.filter(len), st.binary(min_size=1, max_size=40), st.data())
def test_random_bits_are_an_error_or_runs(sent: np.ndarray, noise: bytes, data: st.DataObject) -> None:
    streams = pack_runs(sent, levels_for(sent, 9), 9)
    code = HuffmanCode.fit(np.bincount(streams[0], minlength=9 + RUN_SYMBOLS))
    coded, bits = encode_runs(code, *streams)
    flipped = bytearray(coded)
    flipped[data.draw(st.integers(0, len(coded) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    for wrong, length in ((bytes(flipped), bits), (noise, 8 * len(noise)), (coded[:-1], bits), (coded, bits + 8)):
        try:
            read, levels = decode_runs(code, wrong, length, len(sent), 9)
        except FormatError:
            continue
        assert len(read) == len(sent) and len(levels) == np.count_nonzero(read) and (levels < 9).all()


def test_what_cannot_be_packed() -> None:
    sent, levels = np.array([True, False]), np.array([3], np.uint16)
    for wrong in ((sent, levels, 3), (sent, levels[:0], 4), (sent.astype(int), levels, 4), (sent, levels, 1 << 16)):
        with pytest.raises(InvalidArgument):
            pack_runs(*wrong)
    code = HuffmanCode.fit([1] * (4 + RUN_SYMBOLS))
    for bits in (2, 30):
        with pytest.raises(InvalidArgument):
            encode_runs(code, np.array([5], np.uint16), np.array([9], np.uint32), np.array([bits], np.uint8))
    with pytest.raises(InvalidArgument):
        decode_runs(code, b"", 0, 0, 5)
    with pytest.raises(CorruptFile):
        unpack_runs(np.array([4 + 3], np.uint16), np.array([8], np.uint32), 4, 16)


# -- varints ----------------------------------------------------------------------------------------------


@given(st.integers(0, VARINT_LIMIT - 1) | st.integers(0, 300), st.binary(max_size=3))
def test_varints_read_back_and_have_one_form(value: int, before: bytes) -> None:
    data = before + write_varint(value)
    assert read_varint(data + b"\xff", len(before)) == (value, len(data))
    assert len(write_varint(value)) == max(1, -(-value.bit_length() // 7))
    with pytest.raises(TruncatedFile):
        read_varint(data[:-1], len(before))
    with pytest.raises(CorruptFile):
        read_varint(data, len(before), "count", value)


def test_varint_bytes() -> None:
    assert [write_varint(v).hex() for v in (0, 127, 128, 300, 1 << 55)] == [
        "00",
        "7f",
        "8001",
        "ac02",
        "8080808080808040",
    ]
    for wrong in (b"\x80\x00", b"\xff" * 9, b"\x80" * 8 + b"\x01"):
        with pytest.raises(CorruptFile):
            read_varint(wrong, 0)
    for value in (-1, VARINT_LIMIT):
        with pytest.raises(InvalidArgument):
            write_varint(value)
