"""The container: round trips, and limits that both the writer and the reader enforce."""

from __future__ import annotations

import dataclasses
import io
import struct
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from container_strategies import (
    EXAMPLE_HEAD,
    CountingFile,
    allowed,
    cursor_on,
    example_file,
    good_bytes,
    heads,
    refused,
)
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.container.fields import Array, FieldType, Listed, Real, Text, Whole
from touchfield.container.records import RECORDS, Pair, Row, SegmentEntry, rows_of
from touchfield.errors import CorruptFile, InvalidArgument, SourceError

LAYOUTS = [*(record.layout for record in RECORDS), Pair, SegmentEntry]
ROWS = [
    pytest.param(row, id=f"{layout.__name__}.{row.name}") for layout in LAYOUTS for row in rows_of(layout)
]
UNITS = {"_n_s_per_m": "N s/m", "_m": "m", "_hz": "Hz", "_n": "N"}
TYPES = [Whole("u8"), Array(Real(-2, 2), 2), Listed(Text(4), 3)]


def write(
    path: Path, head: Head, bodies: list[tuple[int, bytes]], provenance: dict[str, str] | None = None
) -> None:
    """Write a file of segments of (frame_count, body)."""
    first = 0
    with TouchWriter(path) as writer:
        writer.write_head(head, provenance)
        for frame_count, body in bodies:
            writer.write_segment(first, frame_count, body)
            first += frame_count


# -- the table ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [*(p.values[0].kind for p in ROWS), *TYPES], ids=repr)  # type: ignore[attr-defined]
@given(data=st.data())
def test_allowed_values_round_trip_and_have_one_form(kind: FieldType, data: st.DataObject) -> None:
    value = data.draw(allowed(kind))
    encoded_value = kind.encode(value, "field")
    cursor = cursor_on(encoded_value)
    assert kind.decode(cursor, "field") == value
    assert cursor.remaining == 0
    assert kind.smallest <= len(encoded_value) <= kind.largest
    for size in range(min(len(encoded_value), 300) if not kind_is_rest(kind) else 0):
        with pytest.raises(CorruptFile, match=r"field.* at byte \d+"):
            kind.decode(cursor_on(encoded_value[:size]), "field")


def kind_is_rest(kind: FieldType) -> bool:
    """Whether any prefix of the bytes is a value too."""
    return kind.largest > 1 << 62


@pytest.mark.parametrize("row", ROWS)
def test_values_out_of_bounds_are_refused_on_both_sides(row: Row) -> None:
    refusals = list(refused(row.kind))
    assert refusals
    for value, data in refusals:
        with pytest.raises(InvalidArgument, match=rf"RECORD\.{row.name}.*found .*; expected "):
            row.kind.encode(value, f"RECORD.{row.name}")
        if data is not None:
            with pytest.raises(
                CorruptFile, match=rf"^test: RECORD\.{row.name}.* at byte \d+: found .*; expected "
            ):
                row.kind.decode(cursor_on(data), f"RECORD.{row.name}")


def test_a_message_names_file_field_offset_found_and_expected() -> None:
    data = good_bytes(Whole("u16")) + struct.pack("<d", float("nan"))
    cursor = cursor_on(data)
    cursor.take(2, "")
    with pytest.raises(CorruptFile) as caught:
        Real(0, 1e6).decode(cursor, "HEAD.rate_hz")
    assert str(caught.value) == "test: HEAD.rate_hz at byte 2: found nan; expected 0 to 1000000"


def test_numpy_values_are_accepted() -> None:
    head = dataclasses.replace(
        EXAMPLE_HEAD,
        grid_shape=np.array([16, 16, 8]),
        spacing_m=np.array([0.01, 0.01, 0.02]),
        rate_hz=np.float64(30),
        frame_count=np.int64(3),
    )
    kind = RECORDS[0].kind
    assert kind.encode(head, "HEAD") == kind.encode(EXAMPLE_HEAD, "HEAD")


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_field_of_a_record_has_its_row_in_the_table(layout: type) -> None:
    fields = dataclasses.fields(layout)
    rows = rows_of(layout)
    assert [row.name for row in rows] == [field.name for field in fields]
    for row, field in zip(rows, fields, strict=True):
        expected = {Array: "tuple", Listed: "tuple", Text: "str", Whole: "int", Real: "float"}
        assert str(field.type).startswith(expected.get(type(row.kind), "bytes"))
        assert row.meaning.endswith(".")
        unit = next((unit for end, unit in UNITS.items() if row.name.endswith(end)), row.unit)
        assert row.unit == unit


# -- whole files -------------------------------------------------------------------------------------------


@st.composite
def files(draw: st.DrawFn) -> tuple[Head, list[tuple[int, bytes]], dict[str, str]]:
    bodies = draw(st.lists(st.tuples(st.integers(1, 65535), st.binary(max_size=50)), min_size=1, max_size=6))
    pairs = draw(st.lists(allowed(next(iter(rows_of(RECORDS[1].layout))).kind.of), max_size=3))
    head = draw(heads(frame_count=sum(count for count, _ in bodies)))
    return head, bodies, {pair.key: pair.value for pair in pairs}


@given(file=files(), data=st.data())
def test_file_round_trip(tmp_path_factory: pytest.TempPathFactory, file: Any, data: st.DataObject) -> None:
    head, bodies, provenance = file
    path = tmp_path_factory.mktemp("files") / "a.touch"
    write(path, head, bodies, provenance)
    for source in (path, str(path), io.BytesIO(path.read_bytes())):
        with TouchReader(source) as reader:
            assert reader.head == head
            assert reader.provenance == provenance
            assert [entry.frame_count for entry in reader.segments] == [count for count, _ in bodies]
            order = data.draw(st.permutations(range(len(bodies))))
            assert [reader.read_segment(i) for i in order] == [bodies[i][1] for i in order]
            frame = data.draw(st.integers(0, head.frame_count - 1))
            entry = reader.segments[reader.segment_of(frame)]
            assert entry.first_frame <= frame < entry.first_frame + entry.frame_count


def test_the_same_content_has_the_same_bytes(tmp_path: Path) -> None:
    assert example_file() == example_file()
    with TouchReader(io.BytesIO(example_file())) as reader:
        bodies = [(entry.frame_count, reader.read_segment(i)) for i, entry in enumerate(reader.segments)]
        write(tmp_path / "again.touch", reader.head, bodies, dict(reader.provenance))
    assert (tmp_path / "again.touch").read_bytes() == example_file()


class Slow(io.BytesIO):
    """A file that writes a few bytes at a time, as the system does with large data."""

    def write(self, data: Any) -> int:
        return super().write(bytes(data)[:7])


def test_file_that_writes_a_few_bytes_at_a_time(tmp_path: Path) -> None:
    write(tmp_path / "a.touch", EXAMPLE_HEAD, [(EXAMPLE_HEAD.frame_count, b"body of a segment")])
    slow = Slow()
    with TouchWriter(slow) as writer:
        writer.write_head(EXAMPLE_HEAD)
        writer.write_segment(0, EXAMPLE_HEAD.frame_count, b"body of a segment")
    assert slow.getvalue() == (tmp_path / "a.touch").read_bytes()


def test_opening_reads_no_segment(tmp_path: Path) -> None:
    write(tmp_path / "a.touch", dataclasses.replace(EXAMPLE_HEAD, frame_count=8), [(2, bytes(1 << 20))] * 4)
    file = CountingFile((tmp_path / "a.touch").read_bytes())
    with TouchReader(file) as reader:
        assert file.total < 1000
        assert len(reader.read_segment(3)) == 1 << 20
        assert file.total < 1000 + (1 << 20) + 100


def test_segments_may_be_read_from_many_threads(tmp_path: Path) -> None:
    bodies = [(1, bytes([i]) * (1000 + i)) for i in range(64)]
    write(tmp_path / "a.touch", dataclasses.replace(EXAMPLE_HEAD, frame_count=64), bodies)
    with TouchReader(tmp_path / "a.touch") as reader, ThreadPoolExecutor(8) as pool:
        assert list(pool.map(reader.read_segment, list(range(64)) * 4)) == [body for _, body in bodies] * 4


def test_missing_frames_and_segments_are_refused() -> None:
    with TouchReader(io.BytesIO(example_file())) as reader:
        for index in (-1, 2):
            with pytest.raises(InvalidArgument, match=r"segment: found .*; expected 0 to 1"):
                reader.read_segment(index)
        for frame in (-1, 3):
            with pytest.raises(InvalidArgument, match=r"frame: found .*; expected 0 to 2"):
                reader.segment_of(frame)
        assert [reader.segment_of(frame) for frame in range(3)] == [0, 0, 1]


def test_open_file_stays_open_and_path_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "a.touch"
    path.write_bytes(example_file())
    with path.open("rb") as file:
        file.seek(7)
        TouchReader(file).close()
        assert not file.closed
    reader = TouchReader(path)
    reader.close()
    with pytest.raises(SourceError, match="closed file"):
        reader.read_segment(0)


# -- the writer's order ------------------------------------------------------------------------------------


def segment(writer: TouchWriter, first: int, count: int) -> None:
    writer.write_segment(first, count, b"")


MISUSES = {
    "segment before head": lambda w: segment(w, 0, 3),
    "no head": lambda w: None,
    "no segment": lambda w: w.write_head(EXAMPLE_HEAD),
    "two heads": lambda w: (w.write_head(EXAMPLE_HEAD), w.write_head(EXAMPLE_HEAD)),
    "too few frames": lambda w: (w.write_head(EXAMPLE_HEAD), segment(w, 0, 2)),
    "too many frames": lambda w: (w.write_head(EXAMPLE_HEAD), segment(w, 0, 4)),
    "a gap": lambda w: (w.write_head(EXAMPLE_HEAD), segment(w, 0, 1), segment(w, 2, 1)),
    "an overlap": lambda w: (w.write_head(EXAMPLE_HEAD), segment(w, 0, 2), segment(w, 1, 2)),
    "not from frame 0": lambda w: (w.write_head(EXAMPLE_HEAD), segment(w, 1, 2)),
    "no frames": lambda w: (w.write_head(EXAMPLE_HEAD), segment(w, 0, 0)),
    "not a head": lambda w: w.write_head({"rate_hz": 30}),
    "long key": lambda w: w.write_head(EXAMPLE_HEAD, {"k" * 65: ""}),
    "many pairs": lambda w: w.write_head(EXAMPLE_HEAD, {str(i): "" for i in range(65)}),
    "not bytes": lambda w: (w.write_head(EXAMPLE_HEAD), w.write_segment(0, 3, "text")),
    "entered twice": lambda w: w.__enter__(),
}


@pytest.mark.parametrize("misuse", MISUSES)
def test_misuse_is_refused_and_leaves_no_file(misuse: str, tmp_path: Path) -> None:
    with (
        pytest.raises(InvalidArgument, match="found ") as caught,
        TouchWriter(tmp_path / "a.touch") as writer,
    ):
        MISUSES[misuse](writer)
    assert ("at its end" in str(caught.value)) == (misuse in ("no head", "no segment", "too few frames"))
    assert not list(tmp_path.iterdir())


def test_refused_segment_may_be_followed_by_a_valid_one(tmp_path: Path) -> None:
    with TouchWriter(tmp_path / "a.touch") as writer:
        writer.write_head(EXAMPLE_HEAD)
        with pytest.raises(InvalidArgument):
            writer.write_segment(5, 1, b"")
        with pytest.raises(InvalidArgument):
            writer.write_segment(0, 9, b"")
        writer.write_segment(0, 3, b"body")
    with pytest.raises(InvalidArgument, match="not open"):
        TouchWriter(tmp_path / "b.touch").write_head(EXAMPLE_HEAD)
    with pytest.raises(InvalidArgument, match="a second call"):
        writer.write_head(EXAMPLE_HEAD)
    assert TouchReader(tmp_path / "a.touch").read_segment(0) == b"body"
