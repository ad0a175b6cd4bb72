"""A tiny ``.touch`` file and its bytes, each with its meaning: the worked example of docs/format.md."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Final

from touchfield.container.cursor import Cursor
from touchfield.container.fields import FieldType, Listed, Whole
from touchfield.container.layout import Struct, rows_of
from touchfield.container.records import MAGIC, RECORD_OF, Frame, Head, Opening
from touchfield.container.source import ByteSource
from touchfield.container.wire import OPENING_SIZE, find_record
from touchfield.container.writer import TouchWriter

__all__ = ["EXAMPLE_HEAD", "example_file", "explained"]

BYTES_IN_LINE: Final = 16

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
    """The bytes of the example: three frames in two segments."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "example.touch"
        with TouchWriter(path) as writer:
            writer.write_head(EXAMPLE_HEAD, {"source": "made up"})
            writer.write_segment(0, 2, b"\xaa\xbb\xcc")
            writer.write_segment(2, 1, b"\xdd")
        return path.read_bytes()


def explained(data: bytes) -> str:
    """Every byte of a ``.touch`` file, with its position and its meaning."""
    source = ByteSource(BytesIO(data))
    lines = [*_lines(0, MAGIC, "magic")]
    lines += _fields(Struct(Opening), Cursor(data[len(MAGIC) : OPENING_SIZE], "example", len(MAGIC)), data)
    place = OPENING_SIZE
    while place < len(data):
        found = find_record(source, place, len(data))
        tag = found.frame.tag
        lines += ["", f"{tag}, {found.end - place} bytes"]
        lines += _fields(Struct(Frame), Cursor(data[place : found.payload_offset], "example", place), data)
        payload = Cursor(data[found.payload_offset : found.crc_offset], "example", found.payload_offset)
        lines += _fields(RECORD_OF[tag].kind, payload, data)
        lines += _lines(found.crc_offset, data[found.crc_offset : found.end], "CRC-32")
        place = found.end
    return "\n".join(lines)


def _fields(kind: FieldType, cursor: Cursor, data: bytes, name: str = "") -> Iterator[str]:
    """The lines of a field, or of all the fields within it."""
    if isinstance(kind, Struct):
        for row in rows_of(kind.layout):
            yield from _fields(row.kind, cursor, data, f"{name}.{row.name}" if name else row.name)
        return
    begin = cursor.place
    if isinstance(kind, Listed):
        count = Whole(kind.code).decode(cursor, name)
        yield from _lines(begin, data[begin : cursor.place], f"{name}: {count} members")
        for i in range(count):
            yield from _fields(kind.of, cursor, data, f"{name}[{i}]")
        return
    value = kind.decode(cursor, name)
    text = value.hex(" ") if isinstance(value, bytes) else ascii(value)
    yield from _lines(begin, data[begin : cursor.place], f"{name} = {text}")


def _lines(offset: int, data: bytes, meaning: str) -> Iterator[str]:
    """Bytes from `offset` on, 16 in a line, with their meaning beside the first."""
    for i in range(0, len(data), BYTES_IN_LINE):
        part = data[i : i + BYTES_IN_LINE].hex(" ")
        yield f"{offset + i:5}  {part:47}  {meaning if i == 0 else ''}".rstrip()
