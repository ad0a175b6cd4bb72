"""OBJT, the record of an object: written and read in its place only, noticed where it is lost, damaged or
swapped.
"""

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
ONE = ObjectRecord(
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
OTHER = dataclasses.replace(ONE, name="cuboid", is_deforming=1, field=b"")


def write(path: Path, head: Any, objects: list[ObjectRecord]) -> bytes:
    """A file of all frames in one segment."""
    with TouchWriter(path) as writer:
        writer.write_head(head, {"source": "made up"})
        for one in objects:
            writer.write_object(one)
        writer.write_segment(0, head.frame_count, b"body")
    return path.read_bytes()


def content(data: bytes) -> Any:
    """All that a reader says about a file."""
    with TouchReader(io.BytesIO(data)) as reader:
        objects = [reader.read_object(i) for i in range(reader.object_count)]
        bodies = [reader.read_segment(i) for i in range(len(reader.segments))]
        return reader.head, dict(reader.provenance), objects, bodies


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write(tmp_path_factory.mktemp("container") / "a.touch", HEAD, [ONE, OTHER])


# -- what comes back ---------------------------------------------------------------------------------------


@given(
    head=heads(coder=OBJECTS_CODER, frame_count=7),
    objects=st.lists(allowed(Struct(ObjectRecord)), min_size=1),
)
def test_objects_come_back(
    tmp_path_factory: pytest.TempPathFactory, head: Any, objects: list[ObjectRecord]
) -> None:
    data = write(tmp_path_factory.mktemp("files") / "a.touch", head, objects)
    assert content(data) == (head, {"source": "made up"}, objects, [b"body"])


def test_a_file_of_another_coder_has_none() -> None:
    with TouchReader(io.BytesIO(example_file())) as reader:
        assert reader.object_count == 0
        with pytest.raises(InvalidArgument, match=r"object: found 0; expected 0 to -1"):
            reader.read_object(0)


def test_opening_reads_no_object(tmp_path: Path) -> None:
    heavy = dataclasses.replace(ONE, field=bytes(1 << 20))
    file = CountingFile(write(tmp_path / "a.touch", HEAD, [heavy] * 3))
    with TouchReader(file) as reader:
        assert reader.object_count == 3
        assert file.total < 1000
        assert reader.read_object(2) == heavy
        for index in (-1, 3):
            with pytest.raises(InvalidArgument, match=r"object: found .*; expected 0 to 2"):
                reader.read_object(index)


MISUSES = {
    "before the head": lambda w: w.write_object(ONE),
    "another coder": lambda w: (w.write_head(EXAMPLE_HEAD), w.write_object(ONE)),
    "after a segment": lambda w: (
        w.write_head(HEAD), w.write_object(ONE), w.write_segment(0, 2, b""), w.write_object(ONE),
    ),
    "no object": lambda w: (w.write_head(HEAD), w.write_segment(0, 3, b"")),
    "not an object": lambda w: (w.write_head(HEAD), w.write_object(HEAD)),
    "out of bounds": lambda w: (w.write_head(HEAD), w.write_object(dataclasses.replace(ONE, is_deforming=2))),
}  # fmt: skip


@pytest.mark.parametrize("misuse", MISUSES.values(), ids=MISUSES)
def test_misuse_is_refused_and_leaves_nothing(misuse: Any, tmp_path: Path) -> None:
    at_once = r"found (?!.*at its end)"
    with pytest.raises(InvalidArgument, match=at_once), TouchWriter(tmp_path / "a.touch") as writer:
        misuse(writer)
    assert not list(tmp_path.iterdir())


def test_too_many_objects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = write(tmp_path / "a.touch", HEAD, [ONE] * 3)
    monkeypatch.setattr(writer_module, "MAX_OBJECTS", 2)
    with pytest.raises(InvalidArgument, match="more than 2 objects"):
        write(tmp_path / "b.touch", HEAD, [ONE] * 3)
    monkeypatch.setattr(reader_module, "MAX_OBJECTS", 2)
    with pytest.raises(CorruptFile, match="more than 2 objects; expected at most 2"):
        content(data)
    content(write(tmp_path / "c.touch", HEAD, [ONE] * 2))
    assert MAX_OBJECTS == 4096


# -- damage ------------------------------------------------------------------------------------------------


def test_a_file_cut_at_any_byte_is_refused(whole: bytes) -> None:
    for size in range(len(whole)):
        with pytest.raises(FormatError):
            content(whole[:size])


def test_every_flipped_bit_is_noticed(whole: bytes) -> None:
    for place in range(len(whole)):
        for bit in range(8):
            damaged = bytearray(whole)
            damaged[place] ^= 1 << bit
            with pytest.raises(FormatError):
                content(bytes(damaged))


def records(whole: bytes) -> dict[str, bytes]:
    """The records of the file by name; those of the two objects apart."""
    found, place = {}, 14
    while place < len(whole):
        length = 20 + int.from_bytes(whole[place + 8 : place + 16], "little")
        tag = whole[place : place + 4].decode()
        found["OTHER" if tag in found else tag] = whole[place : place + length]
        place += length
    return found


def test_objects_of_other_files_lost_twice_or_swapped_are_noticed(whole: bytes) -> None:
    """Each record has a CRC-32 that holds, and the file its length."""
    r = records(whole)
    foreign = encoded_object(dataclasses.replace(ONE, name="SPHERE"))
    assert len(foreign) == len(r["OBJT"])
    for changed in (
        whole.replace(r["OBJT"], foreign),
        whole.replace(r["OBJT"] + r["OTHER"], r["OTHER"] + r["OBJT"]),
        whole.replace(r["OTHER"], framed("XTRA", bytes(len(r["OTHER"]) - 20), 0)),
    ):
        assert len(changed) == len(whole) and changed != whole
        with pytest.raises(
            CorruptFile, match=r"TEND.chain_crc32: found CRC-32 .* of opening, HEAD, \d OBJT and INDX"
        ):
            content(changed)


# -- crafted files, whose CRC-32 hold ----------------------------------------------------------------------


def encoded_object(one: ObjectRecord, flags: int = 1) -> bytes:
    return framed("OBJT", Struct(ObjectRecord).encode(one, "OBJT"), flags)


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
    crcs, place = b"", 0
    while place < len(data):
        tag, _, size = struct.unpack("<4sIQ", data[place : place + 16])
        place += 20 + size
        crcs += data[place - 4 : place] if tag == b"OBJT" else b""
    return crcs


GOOD = encoded_object(ONE)
STORY = framed("PROV", b"\0\0", 0)
LARGE = GOOD[16:-4].replace(struct.pack("<3I", 4, 5, 6), struct.pack("<3I", 4, 1 << 20, 8193))
NEWS = framed("XTRA", b"news", 0)


def test_objects_stand_anywhere_before_the_first_segment() -> None:
    for before in (GOOD, STORY + GOOD, GOOD + STORY, GOOD + NEWS + GOOD, NEWS + GOOD + STORY + GOOD):
        assert content(crafted(before))[2] == [ONE] * before.count(GOOD)


CRAFTED = {
    "none": (crafted(b""), r"HEAD.coder: found 'objects', and no OBJT; expected an OBJT for each"),
    "late": (crafted(GOOD, late=GOOD), r"OBJT once for each object of coder `objects`, before"),
    "after the index": (crafted(GOOD, after=GOOD), r"OBJT once for each object"),
    "another coder": (crafted(GOOD, head=EXAMPLE_HEAD, chain=False), r"OBJT once for each object"),
    "optional": (crafted(encoded_object(ONE, 0)), r"flags 0; expected flags 1"),
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
        content(data)
    assert type(caught.value) is CorruptFile and "\n" not in str(caught.value)


@given(st.data())
def test_random_payloads_with_a_right_crc_are_refused_or_read(data: st.DataObject) -> None:
    payload = bytearray(GOOD[16:-4])
    for _ in range(data.draw(st.integers(0, 4))):
        begin = data.draw(st.integers(0, len(payload)))
        payload[begin : begin + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
    try:
        objects = content(crafted(framed("OBJT", bytes(payload))))[2]
    except CorruptFile:
        return
    assert Struct(ObjectRecord).encode(objects[0], "OBJT") == bytes(payload)
