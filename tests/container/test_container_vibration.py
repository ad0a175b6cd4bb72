"""VIBR records: at most one before each segment, optional for readers, refused at any other position."""

from __future__ import annotations

import dataclasses
import io
import struct
from pathlib import Path
from typing import Any

import pytest

from container_strategies import EXAMPLE_HEAD, assembled, encoded, framed
from touchfield.container import TouchReader, TouchWriter
from touchfield.container.records import Index, SegmentEntry, Vibration
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile

HEAD = encoded("HEAD", EXAMPLE_HEAD)
FIRST_SEGMENT_AT = 14 + len(HEAD)
FIRST, SECOND = (
    framed("SEGM", struct.pack("<IH", 0, 2) + b"body"),
    framed("SEGM", struct.pack("<IH", 2, 1) + b"more"),
)


def vibr(first: int, count: int, body: bytes = b"hum", flags: int = 0) -> bytes:
    return framed("VIBR", struct.pack("<IH", first, count) + body, flags)


def crafted(before: bytes = b"", between: bytes = b"", trailing: bytes = b"", after: bytes = b"") -> bytes:
    """A file of two segments with other records around them."""
    entries, offset = [], FIRST_SEGMENT_AT + len(before)
    for first, count, record in ((0, 2, FIRST), (2, 1, SECOND)):
        crc32 = int.from_bytes(record[-4:], "little")
        entries.append(
            SegmentEntry(first_frame=first, frame_count=count, offset=offset, length=len(record), crc32=crc32)
        )
        offset += len(record) + len(between)
    index = encoded("INDX", Index(segments=tuple(entries)))
    return assembled(HEAD, before + FIRST + between + SECOND + trailing, index, after)


def vibrations(data: bytes) -> list[bytes | None]:
    with TouchReader(io.BytesIO(data)) as reader:
        assert [reader.read_segment(i) for i in range(2)] == [b"body", b"more"]
        found = [reader.read_vibration(i) for i in range(2)]
        assert reader.has_vibration == any(body is not None for body in found)
        return found


def write(path: Path, bodies: list[bytes | None]) -> bytes:
    """A file of two segments, each with or without vibration."""
    with TouchWriter(path) as writer:
        writer.write_head(EXAMPLE_HEAD, {"source": "made up"})
        for (first, count, body), vibration in zip(((0, 2, b"body"), (2, 1, b"more")), bodies, strict=True):
            if vibration is not None:
                writer.write_vibration(first, count, vibration)
            writer.write_segment(first, count, body)
    return path.read_bytes()


@pytest.mark.parametrize("bodies", [[b"hum", b""], [b"hum", None], [None, b"hum"], [None, None]], ids=str)
def test_bodies_round_trip(bodies: list[bytes | None], tmp_path: Path) -> None:
    data = write(tmp_path / "a.touch", bodies)
    assert vibrations(data) == bodies
    with TouchReader(io.BytesIO(data)) as reader, pytest.raises(InvalidArgument, match="expected 0 to 1"):
        reader.read_vibration(2)


def test_rest_of_the_file_is_unchanged(tmp_path: Path) -> None:
    """Only offsets change: readers that do not know the record skip it by its length."""
    with_band, without = (write(tmp_path / "a.touch", [body, None]) for body in (b"hum", None))
    record = vibr(0, 2)
    assert record in with_band
    assert with_band.replace(record, b"")[: without.index(b"INDX")] == without[: without.index(b"INDX")]


def test_crafted_files_are_read() -> None:
    assert vibrations(crafted()) == [None, None]
    assert vibrations(crafted(vibr(0, 2), vibr(2, 1, b""))) == [b"hum", b""]
    news = framed("XTRA", b"news", 0)
    assert vibrations(crafted(news + vibr(0, 2) + news, news)) == [b"hum", None]


REFUSED: dict[str, tuple[bytes, str]] = {
    "two for one": (crafted(vibr(0, 2) * 2), "a record that the index does not name"),
    "late": (crafted(trailing=vibr(2, 1)), "VIBR at most once for each SEGM"),
    "after the index": (crafted(after=vibr(2, 1)), "VIBR at most once for each SEGM"),
    "other frames": (crafted(vibr(2, 1)), "found 1 frames from frame 2; expected 2 from 0"),
    "fewer frames": (crafted(vibr(0, 1)), "found 1 frames from frame 0; expected 2 from 0"),
    "no frames": (crafted(vibr(0, 0)), "VIBR.frame_count"),
    "required": (crafted(vibr(0, 2, flags=1)), "flags 1; expected flags 0"),
    "short": (crafted(framed("VIBR", b"abc", 0)), "a payload of 3 bytes"),
    "changed": (crafted(vibr(0, 2).replace(b"hum", b"hun")), "CRC-32"),
}


@pytest.mark.parametrize(("data", "match"), REFUSED.values(), ids=REFUSED)
def test_crafted_files_are_refused(data: bytes, match: str) -> None:
    with pytest.raises(CorruptFile, match=match) as caught:
        vibrations(data)
    assert "\n" not in str(caught.value)


def test_a_file_cut_anywhere_or_with_a_flipped_bit_is_refused(tmp_path: Path) -> None:
    data = write(tmp_path / "a.touch", [b"hum", b""])
    for size in range(1, len(data)):
        with pytest.raises(TruncatedFile):
            vibrations(data[:size])
    for index in range(len(data)):
        damaged = bytearray(data)
        damaged[index] ^= 1 << index % 8
        with pytest.raises(FormatError):
            vibrations(bytes(damaged))


def test_opening_reads_no_vibration(tmp_path: Path) -> None:
    data = write(tmp_path / "a.touch", [bytes(1 << 20), None])

    class Counting(io.BytesIO):
        total = 0

        def read(self, size: int | None = -1, /) -> bytes:
            got = super().read(size)
            self.total += len(got)
            return got

    file = Counting(data)
    with TouchReader(file) as reader:
        assert reader.has_vibration and file.total < 1000


MISUSES: dict[str, Any] = {
    "before the head": lambda w: w.write_vibration(0, 2, b""),
    "twice": lambda w: (begun(w), w.write_vibration(0, 2, b""), w.write_vibration(0, 2, b"")),
    "a gap": lambda w: (begun(w), w.write_vibration(1, 2, b"")),
    "too many frames": lambda w: (begun(w), w.write_vibration(0, 4, b"")),
    "other frames than the segment": lambda w: (
        begun(w),
        w.write_vibration(0, 2, b""),
        w.write_segment(0, 3, b""),
    ),
    "after all segments": lambda w: (begun(w), w.write_segment(0, 3, b""), w.write_vibration(3, 1, b"")),
    "not bytes": lambda w: (begun(w), w.write_vibration(0, 3, "text")),
}


def begun(writer: TouchWriter) -> None:
    writer.write_head(EXAMPLE_HEAD)


@pytest.mark.parametrize("misuse", MISUSES.values(), ids=MISUSES)
def test_misuse_is_refused_and_leaves_no_file(misuse: Any, tmp_path: Path) -> None:
    at_once = r"found (?!.*at its end)"
    with pytest.raises(InvalidArgument, match=at_once), TouchWriter(tmp_path / "a.touch") as writer:
        misuse(writer)
    assert not list(tmp_path.iterdir())


def test_record_agrees_with_the_table() -> None:
    vibration = Vibration(first_frame=0, frame_count=2, body=b"hum")
    assert encoded("VIBR", vibration)[:4] == vibr(0, 2)[:4]
    with pytest.raises(InvalidArgument, match="frame_count"):
        encoded("VIBR", dataclasses.replace(vibration, frame_count=0))
