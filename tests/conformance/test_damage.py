"""Damaged golden files, truncated at every byte or with changed bytes, raise only the named errors."""

from __future__ import annotations

import importlib
import io
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, strategies as st
from second import GOLDEN

from touchfield.container import TouchReader
from touchfield.errors import FormatError, InvalidArgument
from touchfield.pipeline.decoding import stream_of

pytestmark = pytest.mark.skipif(not GOLDEN, reason="there are no golden files: make golden")
STREAMS = {path.stem: path.read_bytes() for path in GOLDEN if path.stat().st_size < 4000}
NAMES = st.sampled_from(sorted(STREAMS) or [""])


def decode(data: bytes) -> int:
    with TouchReader(io.BytesIO(data)) as reader:
        medium = stream_of(reader).medium
        # read separately from the frames
        band = map(medium.vibration, range(len(medium))) if medium.vibration else ()
        return sum(frame.support_count for frame in medium) + sum(map(len, band))


def test_streams_are_valid() -> None:
    assert len(STREAMS) >= 4
    assert all(decode(data) >= 0 for data in STREAMS.values())


@pytest.mark.parametrize("name", STREAMS)
def test_truncated_at_every_byte(name: str) -> None:
    data = STREAMS[name]
    for length in range(len(data)):
        with pytest.raises(FormatError):
            decode(data[:length])


@given(NAMES, st.data())
def test_bits_flipped_at_random(name: str, draw: st.DataObject) -> None:
    data = bytearray(STREAMS[name])
    for bit in draw.draw(st.sets(st.integers(0, 8 * len(data) - 1), min_size=1, max_size=5)):
        data[bit // 8] ^= 1 << (bit % 8)
    with pytest.raises(FormatError):
        decode(bytes(data))


@given(NAMES, st.data())
def test_byte_ranges_of_one_stream_in_another(name: str, draw: st.DataObject) -> None:
    data, other = bytearray(STREAMS[name]), STREAMS[draw.draw(NAMES)]
    length = draw.draw(st.integers(1, 60))
    a, b = (draw.draw(st.integers(0, len(d) - length)) for d in (data, other))
    data[a : a + length] = other[b : b + length]
    if bytes(data) != STREAMS[name]:
        with pytest.raises(FormatError):
            decode(bytes(data))


FAULTS: Any = importlib.import_module("make_faulty")


@given(NAMES, st.data())
def test_changed_payloads_with_a_valid_crc(name: str, draw: st.DataObject) -> None:
    """Either another field is decoded, or a named error is raised, possibly for its size."""
    records = FAULTS.records_of(STREAMS[name])
    index = draw.draw(st.sampled_from([i for i, record in enumerate(records) if record.payload]))
    payload = bytearray(records[index].payload)
    for _ in range(draw.draw(st.integers(1, 3))):
        at = draw.draw(st.integers(0, len(payload) - 1))
        replacement = draw.draw(
            st.sampled_from([b"\0\0\x10\0", b"\xff" * 4, bytes(7) + b"\x7f"])
            | st.binary(min_size=1, max_size=3)
        )
        payload[at : at + len(replacement)] = replacement[: len(payload) - at]
    records[index] = records[index]._replace(payload=bytes(payload))
    with suppress(FormatError, InvalidArgument):
        decode(FAULTS.assembled(records))
