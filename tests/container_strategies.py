"""Valid and invalid values of a ``.touch`` file, both derived from the table of the format; a small file."""

from __future__ import annotations

import io
import math
import struct
import tempfile
import zlib
from collections.abc import Iterator
from functools import singledispatch
from pathlib import Path
from typing import Any, Final

from hypothesis import strategies as st

from touchfield.container import Head, TouchWriter
from touchfield.container.fields import (
    LINES,
    NAME,
    TEXT,
    Array,
    FieldType,
    Listed,
    Octets,
    Real,
    Rest,
    Text,
    Whole,
)
from touchfield.container.records import MAGIC, RECORD_OF, Record, Struct, rows_of

Values = st.SearchStrategy[Any]

CHARACTERS = {
    TEXT: st.characters(exclude_categories=("Cc", "Cs")),
    LINES: st.characters(exclude_categories=("Cc", "Cs"), include_characters="\t\n"),
    NAME: st.sampled_from("abcxyz019._-"),
}


# -- valid values ------------------------------------------------------------------------------------------


@singledispatch
def allowed(kind: FieldType) -> Values:
    """Values within the bounds of a field type."""
    raise NotImplementedError(type(kind).__name__)


@allowed.register
def _(kind: Whole) -> Values:
    return st.integers(kind.low, kind.high) | st.sampled_from([kind.low, kind.high])


@allowed.register
def _(kind: Real) -> Values:
    return st.floats(kind.low, kind.high)


@allowed.register
def _(kind: Array) -> Values:
    if kind.max_bricks is None:
        return st.tuples(*[allowed(kind.of)] * kind.count)
    largest = st.sampled_from([(4096, 4096, 4096), (1 << 20, 1 << 13, 8), (1, 1 << 20, 8192)])
    return st.tuples(*[st.integers(1, 4096)] * 3) | largest


@allowed.register
def _(kind: Text) -> Values:
    texts = st.text(CHARACTERS[kind.pattern], min_size=kind.min_bytes, max_size=kind.limit)
    if kind.pattern is NAME:
        texts = texts.map(lambda text: "a" + text[1:])
    return texts.filter(lambda text: kind.min_bytes <= len(text.encode()) <= kind.limit)


@allowed.register
def _(kind: Octets) -> Values:
    return st.binary(max_size=min(kind.limit, 100))


@allowed.register
def _(kind: Rest) -> Values:
    return st.binary(max_size=200)


@allowed.register
def _(kind: Listed) -> Values:
    return st.lists(allowed(kind.of), max_size=min(kind.limit, 5)).map(tuple)


@allowed.register
def _(kind: Struct) -> Values:
    return st.builds(kind.layout, **{row.name: allowed(row.kind) for row in rows_of(kind.layout)})


def heads(**fixed: Any) -> st.SearchStrategy[Head]:
    """Heads, with some fields given."""
    free = {row.name: allowed(row.kind) for row in rows_of(Head)}
    return st.builds(Head, **{**free, **{name: st.just(value) for name, value in fixed.items()}})


# -- invalid values ----------------------------------------------------------------------------------------


@singledispatch
def refused(kind: FieldType) -> Iterator[tuple[Any, bytes | None]]:
    """Values out of bounds, each with its bytes (None if it has none)."""
    raise NotImplementedError(type(kind).__name__)


@refused.register
def _(kind: Whole) -> Iterator[tuple[Any, bytes | None]]:
    size = kind.smallest
    for value in (kind.low - 1, kind.high + 1):
        fits = 0 <= value < 1 << 8 * size
        yield value, value.to_bytes(size, "little") if fits else None
    yield from ((1.5, None), ("1", None), (None, None), (True, None))


@refused.register
def _(kind: Real) -> Iterator[tuple[Any, bytes | None]]:
    beyond = [math.nextafter(kind.low, -math.inf), math.nextafter(kind.high, math.inf)]
    bad = [math.nan, math.inf, -math.inf, *beyond, *([5e-324, 0.0, -0.0] if kind.low > 0 else [])]
    yield from ((value, struct.pack("<d", value)) for value in bad)
    yield from (("1.0", None), (None, None), (1j, None))


@refused.register
def _(kind: Array) -> Iterator[tuple[Any, bytes | None]]:
    good = good_bytes(kind.of)
    for value, data in refused(kind.of):
        yield (value,) * kind.count, None if data is None else good * (kind.count - 1) + data
    yield from (((), None), (7, None), ("abc", None), ({1, 2}, None))
    for shape in (
        () if kind.max_bricks is None else ((4097, 4096, 4096), (1, 1 << 20, 1 << 16), (1 << 20,) * 3)
    ):
        yield shape, struct.pack("<3I", *shape)


@refused.register
def _(kind: Text) -> Iterator[tuple[Any, bytes | None]]:
    def raw(data: bytes) -> bytes:
        return struct.pack("<H", len(data)) + data

    long = "a" * (kind.limit + 1)
    yield long, raw(long.encode())
    for text in ("a\x1b[2Jb", "a\x00", "a\x9b"):
        yield text, raw(text.encode())
    yield "a\ud800", raw(b"a\xed\xa0\x80")
    yield b"a", raw(b"a\xff")
    if kind.min_bytes:
        yield "", raw(b"")
    if kind.pattern is NAME:
        yield "A b", raw(b"A b")
    yield None, None


@refused.register
def _(kind: Octets) -> Iterator[tuple[Any, bytes | None]]:
    long = bytes(kind.limit + 1)
    yield long, struct.pack("<I", len(long)) + long
    yield "text", struct.pack("<I", 0xFFFFFFFF)


@refused.register
def _(kind: Rest) -> Iterator[tuple[Any, bytes | None]]:
    yield from (("text", None), (None, None), (3, None))


@refused.register
def _(kind: Listed) -> Iterator[tuple[Any, bytes | None]]:
    size, good = kind.smallest, good_bytes(kind.of)
    for value, data in refused(kind.of):
        yield (value,), None if data is None else (1).to_bytes(size, "little") + data
    if kind.limit < 1000:
        count = kind.limit + 1
        member = kind.of.decode(cursor_on(good), "")
        yield (member,) * count, count.to_bytes(size, "little") + good * count
    yield "text", b"\xff" * size
    yield None, None


@refused.register
def _(kind: Struct) -> Iterator[tuple[Any, bytes | None]]:
    rows = rows_of(kind.layout)
    good = [good_bytes(row.kind) for row in rows]
    member = kind.decode(cursor_on(b"".join(good)), "")
    for i, row in enumerate(rows):
        for value, data in refused(row.kind):
            values = {**vars(member), row.name: value}
            raw = None if data is None else b"".join([*good[:i], data, *good[i + 1 :]])
            yield kind.layout(**values), raw
    yield (1, 2), None


def cursor_on(data: bytes) -> Any:
    """A cursor on `data` alone."""
    from touchfield.container.fields import Cursor

    return Cursor(data, "test")


@singledispatch
def good_bytes(kind: FieldType) -> bytes:
    """The bytes of a valid value."""
    return bytes(kind.smallest)


@good_bytes.register
def _(kind: Whole) -> bytes:
    return kind.low.to_bytes(kind.smallest, "little")


@good_bytes.register
def _(kind: Real) -> bytes:
    return struct.pack("<d", 1.0)


@good_bytes.register
def _(kind: Array) -> bytes:
    return good_bytes(kind.of) * kind.count


@good_bytes.register
def _(kind: Text) -> bytes:
    return struct.pack("<H", kind.min_bytes) + b"a" * kind.min_bytes


@good_bytes.register
def _(kind: Struct) -> bytes:
    return b"".join(good_bytes(row.kind) for row in rows_of(kind.layout))


class CountingFile(io.BytesIO):
    """A file that counts the bytes read."""

    total = 0

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self.total += len(data)
        return data


# -- files by hand -----------------------------------------------------------------------------------------


OPENING: Final = MAGIC + struct.pack("<HH", 1, 0)

EXAMPLE_HEAD: Final = Head(
    grid_shape=(16, 16, 8),
    spacing_m=(0.01, 0.01, 0.02),
    origin_m=(-0.075, -0.075, 0.5),
    rate_hz=30.0,
    frame_count=3,
    axes="x right, y down, z forward",
    device_name="phantom-omni",
    device_type=1,
    force_max_n=3.3,
    mapping_scale=0.5,
    mapping_offset_m=(0.0, 0.0, 0.57),
    weber_fraction=0.1,
    force_threshold_n=0.0,
    friction=0.2,
    damping_n_s_per_m=0.0,
    tags=("direct",),
    coder="example",
    coder_parameters=b"\x06",
)


def example_file() -> bytes:
    """The bytes of the example in docs/format/container.md: three frames in two segments."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "example.touch"
        with TouchWriter(path) as writer:
            writer.write_head(EXAMPLE_HEAD, {"source": "made up"})
            writer.write_segment(0, 2, b"\xaa\xbb\xcc")
            writer.write_segment(2, 1, b"\xdd")
        return path.read_bytes()


def framed(tag: str, payload: bytes, flags: int = 1, length: int | None = None) -> bytes:
    """A record with a correct CRC-32 for any payload."""
    announced = len(payload) if length is None else length
    head = tag.encode() + struct.pack("<IQ", flags, announced)
    return head + payload + struct.pack("<I", zlib.crc32(head + payload))


def encoded(tag: str, value: Any) -> bytes:
    """A record of the table."""
    record: Record = RECORD_OF[tag]
    return framed(tag, record.kind.encode(value, tag), int(record.required))


def assembled(
    head: bytes, middle: bytes, index: bytes, after: bytes = b"", start: bytes = OPENING, chained: bytes = b""
) -> bytes:
    """A file of the given records, closed by a correct end record; `chained` closes the objects."""
    index_offset = len(start) + len(head) + len(middle)
    length = index_offset + len(index) + len(after) + 40
    chain = zlib.crc32(start + head[-4:] + chained + index[-4:])
    return (
        start
        + head
        + middle
        + index
        + after
        + framed("TEND", struct.pack("<QQI", index_offset, length, chain))
    )
