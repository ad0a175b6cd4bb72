"""OBJT, the record of an object: its order in the file, and detection of lost, damaged or swapped records."""

from __future__ import annotations

import dataclasses
import io
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

from container_strategies import (
    EXAMPLE_HEAD,
    CountingFile,
    allowed,
    assembled,
    encoded,
    example_file,
    framed,
    heads,
)
from touchfield.container import (
    ObjectRecord,
    TouchReader,
    TouchWriter,
    reader as reader_module,
    writer as writer_module,
)
from touchfield.container.records import MAX_OBJECTS, OBJECTS_CODER, Index, SegmentEntry, Struct
from touchfield.errors import CorruptFile, FormatError, InvalidArgument

HEAD = dataclasses.replace(EXAMPLE_HEAD, coder=OBJECTS_CODER)
BALL = ObjectRecord(
    name="sphere",
    grid_shape=(4, 5, 6),
    spacing_m=(0.001, 0.001, 0.002),
    origin_m=(-0.0015, -0.002, -0.005),
    is_deforming=0,
    field_coder="example",
    field_parameters=b"\x06",
    pose_steps=b"\xf0\xf2",
    field=b"a field",
)
OTHER = dataclasses.replace(BALL, name="cuboid", is_deforming=1, field=b"")


def write(path: Path, head: Any, objects: list[ObjectRecord]) -> bytes:
    """Write a file with all frames in one segment."""
    with TouchWriter(path) as writer:
        writer.write_head(head, {"source": "made up"})
        for record in objects:
            writer.write_object(record)
        writer.write_segment(0, head.frame_count, b"body")
    return path.read_bytes()


def read_all(data: bytes) -> Any:
    """Everything that a reader returns for a file."""
    with TouchReader(io.BytesIO(data)) as reader:
        objects = [reader.read_object(i) for i in range(reader.object_count)]
        bodies = [reader.read_segment(i) for i in range(len(reader.segments))]
        return reader.head, dict(reader.provenance), objects, bodies


@pytest.fixture(scope="module")
def valid_file(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write(tmp_path_factory.mktemp("container") / "a.touch", HEAD, [BALL, OTHER])


# -- what comes back ---------------------------------------------------------------------------------------


@given(
    head=heads(coder=OBJECTS_CODER, frame_count=7),
    objects=st.lists(allowed(Struct(ObjectRecord)), min_size=1),
)
def test_objects_round_trip(
    tmp_path_factory: pytest.TempPathFactory, head: Any, objects: list[ObjectRecord]
) -> None:
    data = write(tmp_path_factory.mktemp("files") / "a.touch", head, objects)
    assert read_all(data) == (head, {"source": "made up"}, objects, [b"body"])


def test_a_file_of_another_coder_has_none() -> None:
    with TouchReader(io.BytesIO(example_file())) as reader:
        assert reader.object_count == 0
        with pytest.raises(InvalidArgument, match=r"object: found 0; expected 0 to -1"):
            reader.read_object(0)


def test_opening_reads_no_object(tmp_path: Path) -> None:
    heavy = dataclasses.replace(BALL, field=bytes(1 << 20))
    file = CountingFile(write(tmp_path / "a.touch", HEAD, [heavy] * 3))
    with TouchReader(file) as reader:
        assert reader.object_count == 3
        assert file.total < 1000
        assert reader.read_object(2) == heavy
        for index in (-1, 3):
            with pytest.raises(InvalidArgument, match=r"object: found .*; expected 0 to 2"):
                reader.read_object(index)


MISUSES = {
    "before the head": lambda w: w.write_object(BALL),
    "another coder": lambda w: (w.write_head(EXAMPLE_HEAD), w.write_object(BALL)),
    "after a segment": lambda w: (
        w.write_head(HEAD), w.write_object(BALL), w.write_segment(0, 2, b""), w.write_object(BALL),
    ),
    "no object": lambda w: (w.write_head(HEAD), w.write_segment(0, 3, b"")),
    "not an object": lambda w: (w.write_head(HEAD), w.write_object(HEAD)),
    "out of bounds": lambda w: (
        w.write_head(HEAD), w.write_object(dataclasses.replace(BALL, is_deforming=2)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("misuse", MISUSES.values(), ids=MISUSES)
def test_misuse_is_refused_and_leaves_no_file(misuse: Any, tmp_path: Path) -> None:
    at_once = r"found (?!.*at its end)"
    with pytest.raises(InvalidArgument, match=at_once), TouchWriter(tmp_path / "a.touch") as writer:
        misuse(writer)
    assert not list(tmp_path.iterdir())


def test_too_many_objects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = write(tmp_path / "a.touch", HEAD, [BALL] * 3)
    monkeypatch.setattr(writer_module, "MAX_OBJECTS", 2)
    with pytest.raises(InvalidArgument, match="more than 2 objects"):
        write(tmp_path / "b.touch", HEAD, [BALL] * 3)
    monkeypatch.setattr(reader_module, "MAX_OBJECTS", 2)
    with pytest.raises(CorruptFile, match="more than 2 objects; expected at most 2"):
        read_all(data)
    read_all(write(tmp_path / "c.touch", HEAD, [BALL] * 2))
    assert MAX_OBJECTS == 4096


# -- damage ------------------------------------------------------------------------------------------------


def test_a_file_cut_at_any_byte_is_refused(valid_file: bytes) -> None:
    for size in range(len(valid_file)):
        with pytest.raises(FormatError):
            read_all(valid_file[:size])


def test_every_flipped_bit_is_detected(valid_file: bytes) -> None:
    for index in range(len(valid_file)):
        for bit in range(8):
            damaged = bytearray(valid_file)
            damaged[index] ^= 1 << bit
            with pytest.raises(FormatError):
                read_all(bytes(damaged))


def records(valid_file: bytes) -> dict[str, bytes]:
    """The records of the file by tag; the second object as OTHER."""
    found, offset = {}, 14
    while offset < len(valid_file):
        length = 20 + int.from_bytes(valid_file[offset + 8 : offset + 16], "little")
        tag = valid_file[offset : offset + 4].decode()
        found["OTHER" if tag in found else tag] = valid_file[offset : offset + length]
        offset += length
    return found


def test_foreign_lost_or_swapped_objects_are_detected(valid_file: bytes) -> None:
    """Each record has a valid CRC-32, and the file its length."""
    r = records(valid_file)
    foreign = encoded_object(dataclasses.replace(BALL, name="SPHERE"))
    assert len(foreign) == len(r["OBJT"])
    for changed in (
        valid_file.replace(r["OBJT"], foreign),
        valid_file.replace(r["OBJT"] + r["OTHER"], r["OTHER"] + r["OBJT"]),
        valid_file.replace(r["OTHER"], framed("XTRA", bytes(len(r["OTHER"]) - 20), 0)),
    ):
        assert len(changed) == len(valid_file) and changed != valid_file
        with pytest.raises(
            CorruptFile, match=r"TEND.chain_crc32: found CRC-32 .* of opening, HEAD, \d OBJT and INDX"
        ):
            read_all(changed)


# -- crafted files, whose CRC-32 hold ----------------------------------------------------------------------


def encoded_object(record: ObjectRecord, flags: int = 1) -> bytes:
    return framed("OBJT", Struct(ObjectRecord).encode(record, "OBJT"), flags)


SEGMENT = framed("SEGM", struct.pack("<IH", 0, 3) + b"body")


def crafted(
    before: bytes, late: bytes = b"", after: bytes = b"", head: Any = HEAD, chain: bool = True
) -> bytes:
    """A file of one segment, with records before it, after it, and after the index;
    `before` may be chained.
    """
    first = encoded("HEAD", head)
    entry = SegmentEntry(
        first_frame=0,
        frame_count=3,
        offset=14 + len(first + before),
        length=len(SEGMENT),
        crc32=int.from_bytes(SEGMENT[-4:], "little"),
    )
    index = encoded("INDX", Index(segments=(entry,)))
    return assembled(first, before + SEGMENT + late, index, after, chained=closings(before) if chain else b"")


def closings(data: bytes) -> bytes:
    """The last four bytes of each OBJT among records."""
    crcs, offset = b"", 0
    while offset < len(data):
        tag, _, size = struct.unpack("<4sIQ", data[offset : offset + 16])
        offset += 20 + size
        crcs += data[offset - 4 : offset] if tag == b"OBJT" else b""
    return crcs


GOOD = encoded_object(BALL)
STORY = framed("PROV", b"\0\0", 0)
LARGE = GOOD[16:-4].replace(struct.pack("<3I", 4, 5, 6), struct.pack("<3I", 4, 1 << 20, 8193))
NEWS = framed("XTRA", b"news", 0)


def test_objects_may_be_anywhere_before_the_first_segment() -> None:
    for before in (GOOD, STORY + GOOD, GOOD + STORY, GOOD + NEWS + GOOD, NEWS + GOOD + STORY + GOOD):
        assert read_all(crafted(before))[2] == [BALL] * before.count(GOOD)


CRAFTED = {
    "none": (crafted(b""), r"HEAD.coder: found 'objects', and no OBJT; expected an OBJT for each"),
    "late": (crafted(GOOD, late=GOOD), r"OBJT once for each object of coder `objects`, before"),
    "after the index": (crafted(GOOD, after=GOOD), r"OBJT once for each object"),
    "another coder": (crafted(GOOD, head=EXAMPLE_HEAD, chain=False), r"OBJT once for each object"),
    "optional": (crafted(encoded_object(BALL, 0)), r"flags 0; expected flags 1"),
    "short": (crafted(framed("OBJT", b"abc")), r"a payload of 3 bytes"),
    "over a segment": (crafted(framed("OBJT", GOOD[16:-4], length=len(GOOD)), chain=False), "found "),
    "too many bricks": (
        crafted(framed("OBJT", LARGE)),
        r"OBJT.grid_shape at byte .*at most 134217728 bricks",
    ),
}


@pytest.mark.parametrize(("data", "match"), CRAFTED.values(), ids=CRAFTED)
def test_crafted_files_are_refused(data: bytes, match: str) -> None:
    with pytest.raises(CorruptFile, match=match) as caught:
        read_all(data)
    assert type(caught.value) is CorruptFile and "\n" not in str(caught.value)


@given(st.data())
def test_random_payloads_with_a_valid_crc_are_refused_or_read(data: st.DataObject) -> None:
    payload = bytearray(GOOD[16:-4])
    for _ in range(data.draw(st.integers(0, 4))):
        start = data.draw(st.integers(0, len(payload)))
        payload[start : start + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
    try:
        objects = read_all(crafted(framed("OBJT", bytes(payload))))[2]
    except CorruptFile:
        return
    assert Struct(ObjectRecord).encode(objects[0], "OBJT") == bytes(payload)
