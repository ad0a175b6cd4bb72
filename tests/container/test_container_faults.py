"""Damaged, foreign, crafted and newer files: a named error each time, and never different content."""

from __future__ import annotations

import dataclasses
import errno
import io
import os
import random
import struct
import sys
import tracemalloc
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, strategies as st

from container_strategies import EXAMPLE_HEAD, OPENING, assembled, encoded, example_file, framed
from touchfield.container import TouchReader, TouchWriter, writer as writer_module
from touchfield.container.records import MAGIC, RECORD_OF, Index, Pair, Provenance, Segment, SegmentEntry
from touchfield.container.wire import CHUNK
from touchfield.errors import (
    CorruptFile,
    ForeignFile,
    FormatError,
    InvalidArgument,
    SourceError,
    TruncatedFile,
    UnsupportedVersion,
)

EXAMPLE = example_file()
HEAD, OTHER_HEAD = (encoded("HEAD", dataclasses.replace(EXAMPLE_HEAD, frame_count=n)) for n in (3, 9))
SEGMENT = framed("SEGM", struct.pack("<IH", 0, 3) + b"body")
UNKNOWN = framed("XTRA", b"news", 0)
FIRST_SEGMENT_AT = 14 + len(HEAD)


def read_all(data: bytes) -> Any:
    """Everything that a reader returns for a file."""
    with TouchReader(io.BytesIO(data)) as reader:
        bodies = [reader.read_segment(i) for i in range(len(reader.segments))]
        return reader.head, dict(reader.provenance), reader.segments, bodies


CONTENT = read_all(EXAMPLE)


def entry_of(record: bytes, offset: int, first_frame: int = 0, frame_count: int = 3) -> SegmentEntry:
    """The correct index entry of a segment."""
    crc32 = int.from_bytes(record[-4:], "little")
    return SegmentEntry(
        first_frame=first_frame, frame_count=frame_count, offset=offset, length=len(record), crc32=crc32
    )


def index_of(*entries: SegmentEntry) -> bytes:
    return encoded("INDX", Index(segments=entries))


def with_segment(before: bytes = b"", late: bytes = b"", after: bytes = b"") -> bytes:
    """A valid file of one segment, with other records before it, after it, and after the index."""
    index = index_of(entry_of(SEGMENT, FIRST_SEGMENT_AT + len(before)))
    return assembled(HEAD, before + SEGMENT + late, index, after)


def assert_refused(data: bytes, kind: type[FormatError], match: str) -> str:
    """Check that a file is refused; return the message."""
    with pytest.raises(kind, match=match) as caught:
        read_all(data)
    assert type(caught.value) is kind
    assert "\n" not in str(caught.value)
    return str(caught.value)


# -- damage ------------------------------------------------------------------------------------------------


def test_a_file_cut_at_any_byte_is_truncated() -> None:
    assert_refused(b"", ForeignFile, "an empty file")
    for size in range(1, len(EXAMPLE)):
        assert "more before" not in assert_refused(EXAMPLE[:size], TruncatedFile, "found "), (
            "nothing changed while it was read"
        )


def test_every_flipped_bit_is_detected() -> None:
    for index in range(len(EXAMPLE)):
        for bit in range(8):
            damaged = bytearray(EXAMPLE)
            damaged[index] ^= 1 << bit
            with pytest.raises(FormatError):
                read_all(bytes(damaged))


@given(changes=st.lists(st.tuples(st.integers(0, len(EXAMPLE) - 1), st.integers(0, 255)), max_size=8))
def test_changed_bytes_are_detected(changes: list[tuple[int, int]]) -> None:
    damaged = bytearray(EXAMPLE)
    for index, value in changes:
        damaged[index] = value
    if damaged == EXAMPLE:
        assert read_all(bytes(damaged)) == CONTENT
    else:
        with pytest.raises(FormatError):
            read_all(bytes(damaged))


offsets = st.integers(0, len(EXAMPLE))


@given(a=offsets, b=offsets, put=st.binary(max_size=40))
@example(a=len(EXAMPLE), b=len(EXAMPLE), put=b"\0")
@example(a=0, b=len(EXAMPLE), put=b"")
def test_removed_or_inserted_bytes_are_detected(a: int, b: int, put: bytes) -> None:
    changed = EXAMPLE[: min(a, b)] + put + EXAMPLE[max(a, b) :]
    if changed != EXAMPLE:
        with pytest.raises(FormatError):
            read_all(changed)


@given(data=st.binary(max_size=300), start=st.sampled_from([0, 10, 14, FIRST_SEGMENT_AT, 284, 340, 416]))
def test_random_bytes_are_refused(data: bytes, start: int) -> None:
    with pytest.raises(FormatError):
        read_all(EXAMPLE[:start] + data)


PLAIN = {
    "HEAD": EXAMPLE_HEAD,
    "PROV": Provenance(pairs=(Pair(key="k", value="v"),)),
    "SEGM": Segment(first_frame=0, frame_count=3, body=b"body"),
    "INDX": Index(segments=(entry_of(SEGMENT, FIRST_SEGMENT_AT),)),
}


@given(data=st.data())
def test_random_payloads_with_a_valid_crc_are_refused_or_read(data: st.DataObject) -> None:
    # past the CRC-32 any bytes may reach the field types
    tag = data.draw(st.sampled_from(["HEAD", "PROV", "SEGM", "INDX"]))
    payload = bytearray(RECORD_OF[tag].kind.encode(PLAIN[tag], tag))
    for _ in range(data.draw(st.integers(0, 4))):
        start = data.draw(st.integers(0, len(payload)))
        payload[start : start + data.draw(st.integers(0, 4))] = data.draw(st.binary(max_size=4))
    records = {
        "HEAD": HEAD,
        "PROV": b"",
        "SEGM": SEGMENT,
        tag: framed(tag, bytes(payload), int(tag != "PROV")),
    }
    offset = 14 + len(records["HEAD"]) + len(records["PROV"])
    records.setdefault("INDX", index_of(entry_of(records["SEGM"], offset)))
    with suppress(CorruptFile):
        read_all(assembled(records["HEAD"], records["PROV"] + records["SEGM"], records["INDX"]))


def test_damaged_end_is_distinguished_from_a_missing_one() -> None:
    damaged = EXAMPLE[:-1] + bytes([EXAMPLE[-1] ^ 1])
    assert_refused(damaged, CorruptFile, r"TEND record at byte 416: found CRC-32")
    assert_refused(EXAMPLE[:-40], TruncatedFile, "no end record in 416 bytes")
    assert_refused(
        EXAMPLE[:300], TruncatedFile, "SEGM record at byte 284: found 300 bytes; expected 313 bytes"
    )


def test_records_larger_than_the_memory_limit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file may be sparse: its size does not bound the memory it should take."""
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", f"{100 / 2**30:.12f}")
    with pytest.raises(
        InvalidArgument, match=r"to be read at once; expected at most .* TOUCHFIELD_MEMORY_GIB"
    ):
        read_all(EXAMPLE)


def test_joined_files_are_refused() -> None:
    assert_refused(
        EXAMPLE + b"\0" * 100, CorruptFile, "TEND record at byte 416: found 100 bytes after it; expected none"
    )
    assert_refused(
        EXAMPLE + EXAMPLE, CorruptFile, r"TEND.file_length: found 456 in a file of 912 bytes.*joined"
    )
    assert_refused(EXAMPLE[:284] + EXAMPLE[313:], CorruptFile, "TEND.file_length")


def test_parts_of_other_files_are_refused() -> None:
    original, other = with_segment(), with_segment().replace(b"body", b"BODY")
    other_segment = framed("SEGM", struct.pack("<IH", 0, 3) + b"BODY")
    assert_refused(
        other.replace(other[FIRST_SEGMENT_AT : FIRST_SEGMENT_AT + 30], other_segment),
        CorruptFile,
        "as the index says",
    )
    assert len(OTHER_HEAD) == len(HEAD)
    assert_refused(original.replace(HEAD, OTHER_HEAD), CorruptFile, "TEND.chain_crc32")


@pytest.mark.parametrize(
    "data",
    [b"\x89PNG\r\n\x1a\n" + bytes(100), b"PK\x03\x04" + bytes(500), b"\0", b"TOUCH", b"x" * 5000, b"\x89TOY"],
    ids=["png", "zip", "nul", "name", "letters", "nearly"],
)
def test_foreign_files(data: bytes) -> None:
    assert_refused(data, ForeignFile, "a .touch file")


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data.replace(b"\r\n", b"\n"),
        lambda data: data.replace(b"\n", b"\r\n"),
        lambda data: data.replace(b"\r", b""),
        lambda data: bytes(byte & 127 for byte in data),
        lambda data: data.decode("latin-1").encode("utf-8"),
        lambda data: data.decode("utf-8", "replace").encode("utf-8"),
    ],
    ids=["unix", "windows", "no-cr", "seven-bit", "utf-8", "replaced"],
)
def test_text_mode_transfer_is_recognised(damage: Any) -> None:
    message = assert_refused(damage(EXAMPLE), CorruptFile, "transferred as text")
    assert message.endswith("Transfer it again in binary mode.")


# -- crafted files, whose CRC-32 hold ----------------------------------------------------------------------

HUGE = (1 << 64) - 1
GOOD = entry_of(SEGMENT, FIRST_SEGMENT_AT)


def entries(*changes: dict[str, int]) -> bytes:
    """A file whose index has one entry for each of `changes` to the correct one."""
    return assembled(HEAD, SEGMENT, index_of(*(dataclasses.replace(GOOD, **change) for change in changes)))


def overlapping() -> bytes:
    """Two segments: the second is a record inside the body of the first and ends elsewhere."""
    inner = framed("SEGM", struct.pack("<IH", 1, 2) + b"body")
    outer = framed("SEGM", struct.pack("<IH", 0, 1) + inner)
    first = entry_of(outer, FIRST_SEGMENT_AT, 0, 1)
    second = entry_of(inner, FIRST_SEGMENT_AT + outer.index(inner), 1, 2)
    return assembled(HEAD, outer, index_of(first, second))


CRAFTED = {
    "segment too late": (entries({"offset": FIRST_SEGMENT_AT + 1}), r"INDX.segments\[0\]"),
    "segment before": (entries({"offset": 0}), r"INDX.segments\[0\]"),
    "segment far away": (entries({"offset": HUGE - 10}), r"INDX.segments\[0\]"),
    "segment huge": (entries({"length": HUGE}), r"INDX.segments\[0\]"),
    "segment short": (entries({"length": len(SEGMENT) - 1}), "record.tag at byte"),
    "segment long": (
        assembled(
            HEAD, SEGMENT + UNKNOWN, index_of(dataclasses.replace(GOOD, length=len(SEGMENT + UNKNOWN)))
        ),
        "as the index says",
    ),
    "segment empty": (entries({"length": 0}), r"INDX.segments\[0\]"),
    "other crc": (entries({"crc32": 1}), "as the index says"),
    "overlap": (entries({"frame_count": 1}, {"first_frame": 1, "frame_count": 2}), r"INDX.segments\[1\]"),
    "segment in a segment": (overlapping(), r"INDX.segments\[1\]: found bytes \d+ to \d+; expected"),
    "one byte of overlap": (
        assembled(
            HEAD,
            2 * SEGMENT,
            index_of(
                dataclasses.replace(GOOD, frame_count=1),
                dataclasses.replace(
                    GOOD, first_frame=1, frame_count=2, offset=FIRST_SEGMENT_AT + len(SEGMENT) - 1
                ),
            ),
        ),
        rf"INDX.segments\[1\]: found bytes {FIRST_SEGMENT_AT + len(SEGMENT) - 1} to",
    ),
    "frames missing": (entries({"frame_count": 2}), "found 2 frames; expected 3"),
    "frames too many": (entries({"frame_count": 4}), "found 4 frames; expected 3"),
    "frames not from 0": (entries({"first_frame": 1}), r"segments\[0\].first_frame: found 1; expected 0"),
    "no segments": (assembled(HEAD, b"", index_of()), "found 0 frames; expected 3"),
    "count beyond the bytes": (
        assembled(HEAD, SEGMENT, framed("INDX", b"\xff\xff\xff\x7f")),
        "INDX.segments at byte .*2147483647 members in 0 bytes",
    ),
    "count beyond its bound": (
        assembled(HEAD, SEGMENT, framed("INDX", b"\xff" * 4)),
        r"INDX\.segments \(members\) at byte .*: found 4294967295",
    ),
    "segment not in the index": (with_segment(late=SEGMENT), "a record that the index does not name"),
    "second head": (with_segment(before=HEAD), "HEAD once, first"),
    "second index": (with_segment(after=index_of(GOOD)), "INDX once"),
    "two stories": (with_segment(before=framed("PROV", b"\0\0", 0) * 2), "PROV at most once"),
    "late story": (with_segment(late=framed("PROV", b"\0\0", 0)), "PROV at most once, before the first SEGM"),
    "key twice": (
        with_segment(before=framed("PROV", b"\2\0" + b"\1\0k\0\0" * 2, 0)),
        "PROV record at byte .*: found a key twice",
    ),
    "required story": (with_segment(before=framed("PROV", b"\0\0", 1)), "flags 1.*expected flags 0"),
    "optional head": (
        assembled(framed("HEAD", HEAD[16:-4], 0), SEGMENT, index_of(GOOD)),
        "flags 0.*expected flags 1",
    ),
    "unknown flag": (with_segment(before=framed("XTRA", b"", 2)), "record.flags at byte"),
    "bytes after a field": (
        with_segment(before=framed("PROV", b"\0\0\0", 0)),
        "1 bytes after the last field",
    ),
    "gap of zeros": (with_segment(before=bytes(40)), "record.tag at byte"),
    "head too large": (
        assembled(framed("HEAD", bytes(200_000)), SEGMENT, index_of(GOOD)),
        "a payload of 200000 bytes; expected",
    ),
    "no head": (assembled(SEGMENT, SEGMENT, index_of(GOOD)), "found a record SEGM; expected a record HEAD"),
    "record over a segment": (
        with_segment(before=framed("XTRA", b"", 0, length=30)),
        "XTRA record at byte .*: found that it ends at byte",
    ),
}


@pytest.mark.parametrize(("data", "match"), CRAFTED.values(), ids=CRAFTED)
def test_crafted_files_are_corrupt_and_cost_no_memory(data: bytes, match: str) -> None:
    tracemalloc.start()
    try:
        assert_refused(data, CorruptFile, match)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("length", [1 << 31, 1 << 40, 1 << 63, HUGE])
def test_a_length_beyond_the_file_is_truncation_without_allocation(length: int) -> None:
    tracemalloc.start()
    try:
        assert_refused(
            OPENING + framed("HEAD", HEAD[16:-4], length=length), TruncatedFile, "HEAD record at byte 14"
        )
        assert_refused(
            EXAMPLE[:284] + framed("SEGM", b"", length=length), TruncatedFile, "SEGM record at byte 284"
        )
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("offset", [0, 13, FIRST_SEGMENT_AT - 1, HUGE, HUGE - 20])
def test_index_at_an_invalid_offset_is_refused(offset: int) -> None:
    data = with_segment()[:-40]
    end = struct.pack("<QQI", offset, len(data) + 40, 0)
    assert_refused(
        data + framed("TEND", end),
        CorruptFile,
        f"TEND.index_offset: found {offset}; expected {FIRST_SEGMENT_AT} to",
    )


# -- versions and unknown records --------------------------------------------------------------------------


def test_a_newer_major_version_is_refused_by_its_number() -> None:
    newer = MAGIC + struct.pack("<HH", 2, 4) + b"all else may be different"
    message = assert_refused(newer, UnsupportedVersion, r"found format 2\.4; expected format 1")
    assert message.endswith("Read it with a touchfield that reads format 2.4.")


@pytest.mark.parametrize("minor", [0, 2, 9])
def test_a_file_from_before_version_1_is_refused_by_name(minor: int) -> None:
    older = MAGIC + struct.pack("<HH", 0, minor) + EXAMPLE[14:]
    expected = rf"found format 0\.{minor}, made by a version before 1\.0; expected format 1\. Encode it again"
    assert_refused(older, UnsupportedVersion, expected)


def test_a_newer_minor_version_is_read() -> None:
    data = assembled(HEAD, SEGMENT, index_of(GOOD), start=MAGIC + struct.pack("<HH", 1, 7))
    assert read_all(data)[3] == [b"body"]


@pytest.mark.parametrize("where", ["before", "late", "after"])
def test_unknown_records_are_skipped_or_refused_at_any_position(where: str) -> None:
    assert read_all(with_segment(**{where: UNKNOWN * 2}))[3] == [b"body"]
    required = framed("XTRA", b"news", 1)
    expected = r"XTRA record at byte \d+: found a required record; expected those of format 1\.0"
    assert_refused(with_segment(**{where: UNKNOWN + required}), UnsupportedVersion, expected)
    # a bit that makes a required record look optional must be detected
    disguised = bytearray(required)
    disguised[4] ^= 1
    assert_refused(with_segment(**{where: bytes(disguised)}), CorruptFile, "XTRA record at byte .* CRC-32")


@pytest.mark.parametrize("size", [CHUNK - 16, CHUNK, 2 * CHUNK + 3])
def test_large_unknown_records_are_checked_in_all_their_chunks(size: int) -> None:
    """Their CRC-32 is that of the whole record, however many chunks it is read in."""
    content = random.Random(size).randbytes(size)
    assert read_all(with_segment(before=framed("XTRA", content, 0)))[3] == [b"body"]
    for position in (0, size // 2, size - 1):
        damaged = bytearray(framed("XTRA", content, 0))
        damaged[16 + position] ^= 1
        assert_refused(with_segment(before=bytes(damaged)), CorruptFile, "XTRA record at byte .* CRC-32")


@pytest.mark.parametrize("tag", [b"HEAD", b"SEGM", b"INDX"])
def test_unknown_required_record_instead_of_another(tag: bytes) -> None:
    records = {b"HEAD": HEAD, b"SEGM": SEGMENT, b"INDX": index_of(GOOD)}
    news = framed("XTRA", records[tag][16:-4])
    if tag == b"SEGM":
        records[b"INDX"] = index_of(entry_of(news, FIRST_SEGMENT_AT))
    records[tag] = news
    assert_refused(
        assembled(*records.values()), UnsupportedVersion, r"XTRA record at byte \d+: found a required record"
    )


# -- what the system says ----------------------------------------------------------------------------------


def test_files_that_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no such file"):
        TouchReader(tmp_path / "none.touch")
    with pytest.raises(SourceError, match="a folder"):
        TouchReader(tmp_path)
    with pytest.raises(SourceError, match="null byte"):
        TouchReader("a\0b")
    with pytest.raises(SourceError, match="File name too long"):
        TouchReader("a" * 5000)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(SourceError, match="a pipe, a socket or a device"):
            TouchReader(tmp_path / "pipe")


def test_objects_that_are_no_binary_file_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.touch").write_bytes(EXAMPLE)
    with (tmp_path / "a.touch").open("r") as file, pytest.raises(InvalidArgument, match="open for text"):
        TouchReader(file)  # type: ignore[arg-type]
    for thing in (7, None, io.BytesIO):
        with pytest.raises(InvalidArgument, match="a path or an open, seekable, binary file"):
            TouchReader(thing)  # type: ignore[arg-type]
    file = io.BytesIO(EXAMPLE)
    file.close()
    with pytest.raises(InvalidArgument, match="closed file"):
        TouchReader(file)


def test_a_file_that_shrinks_or_fails_while_it_is_read() -> None:
    file = io.BytesIO(EXAMPLE)
    reader = TouchReader(file)
    file.truncate(290)
    with pytest.raises(TruncatedFile, match="where there were more before"):
        reader.read_segment(1)

    class Failing(io.BytesIO):
        def read(self, size: int | None = -1, /) -> bytes:
            raise OSError(errno.EIO, "Input/output error")

    with pytest.raises(SourceError, match="Input/output error; expected 14 readable bytes at byte 0"):
        TouchReader(Failing(EXAMPLE))


def test_file_that_reads_in_pieces_is_read_completely() -> None:
    class Slow(io.BytesIO):
        def read(self, size: int | None = -1, /) -> bytes:
            return super().read(min(size or 0, 3))

    with TouchReader(Slow(EXAMPLE)) as reader:
        assert reader.head == EXAMPLE_HEAD


# -- nothing half-written ----------------------------------------------------------------------------------


def write_until(path: Path, error: BaseException | None, body: bytes = b"") -> None:
    with TouchWriter(path) as writer:
        writer.write_head(EXAMPLE_HEAD)
        writer.write_segment(0, 2, body)
        if error is not None:
            raise error
        writer.write_segment(2, 1, body)


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), SystemExit(3), RuntimeError("mine"), FileNotFoundError("x")]
)
def test_error_while_writing_propagates_and_keeps_the_older_file(
    error: BaseException, tmp_path: Path
) -> None:
    path = tmp_path / "a.touch"
    path.write_bytes(b"older")
    with pytest.raises(type(error)) as caught:
        write_until(path, error)
    assert caught.value is error
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"older"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("body", [b"", bytes(1 << 20)], ids=["small", "large"])
def test_a_full_disk(body: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def full(path: Path) -> Iterator[Path]:
        yield Path("/dev/full")

    monkeypatch.setattr(writer_module, "atomic_path", full)
    with pytest.raises(SourceError, match=r"No space left on device.*Free some space"):
        write_until(tmp_path / "a.touch", None, body)
    with pytest.raises(InvalidArgument, match="a write failed before"):
        write_on_after_a_failure(tmp_path / "a.touch")


def write_on_after_a_failure(path: Path) -> None:
    with TouchWriter(path) as writer:
        with pytest.raises(SourceError):
            writer.write_head(EXAMPLE_HEAD)
        writer.write_head(EXAMPLE_HEAD)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of file sizes here")
def test_full_disk_leaves_no_file(tmp_path: Path) -> None:
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, hard))
    try:
        with pytest.raises(SourceError, match="File too large"):
            write_until(tmp_path / "a.touch", None, random.Random(0).randbytes(1 << 17))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.iterdir())


def test_invalid_output_paths_are_refused(tmp_path: Path) -> None:
    for path, match in (
        (tmp_path / "none" / "a.touch", "no folder"),
        (tmp_path, "not a plain file"),
        (Path("a\0b"), "without NUL"),
        (tmp_path / ("a" * 300), "too long"),
    ):
        with pytest.raises((InvalidArgument, SourceError), match=match) as caught:
            write_until(path, None)
        assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


def test_the_crc_is_the_one_of_the_document() -> None:
    assert zlib.crc32(b"123456789") == 0xCBF43926
