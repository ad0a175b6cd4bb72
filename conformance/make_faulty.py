"""Makes faulty files of the golden ones, each with the error that a decoder must raise. Their CRC-32 are
correct unless that is the fault.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from touchfield.errors import TouchfieldError
from touchfield.pipeline.decoding import open_file

__all__ = ["write_faulty"]


class Record(NamedTuple):
    """Tag, flags and payload of a record."""

    tag: bytes
    flags: int
    payload: bytes

    def to_bytes(self) -> bytes:
        """The record with a CRC-32 that holds."""
        framed = struct.pack("<4sIQ", self.tag, self.flags, len(self.payload)) + self.payload
        return framed + struct.pack("<I", zlib.crc32(framed))

    def changed(self, at: int, code: str, *values: float) -> Record:
        """With other numbers at a place of the payload."""
        put = struct.pack("<" + code, *values)
        return self._replace(payload=self.payload[:at] + put + self.payload[at + len(put) :])


def records_of(data: bytes) -> list[Record]:
    """The records of a file, but for INDX and TEND."""
    found, place = [], 14
    while place < len(data):
        tag, flags, size = struct.unpack("<4sIQ", data[place : place + 16])
        found.append(Record(tag, flags, data[place + 16 : place + 16 + size]))
        place += 20 + size
    return found[:-2]


def assembled(records: list[Record], late: Record | None = None, shift: int = 0) -> bytes:
    """A file of records, with an index (of segments `shift` bytes off) and an end; `late` stands before the
    index.
    """
    data, entries, chain = b"\x89TOUCH\r\n\x1a\n\x01\0\0\0", b"", b"\x89TOUCH\r\n\x1a\n\x01\0\0\0"
    for record in records:
        one = record.to_bytes()
        if record.tag == b"SEGM":
            entries += record.payload[:6] + struct.pack("<QQ", len(data) + shift, len(one)) + one[-4:]
        elif record.tag in (b"HEAD", b"OBJT"):
            chain += one[-4:]
        data += one
    data += late.to_bytes() if late else b""
    index = Record(b"INDX", 1, struct.pack("<I", len(entries) // 26) + entries).to_bytes()
    end = struct.pack("<QQI", len(data), len(data) + len(index) + 40, zlib.crc32(chain + index[-4:]))
    return data + index + Record(b"TEND", 1, end).to_bytes()


def with_body(data: bytes, tag: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """A file of which the first body of a tag is another: decoders that are slow meet the fault at once."""
    records = records_of(data)
    at = next(i for i, record in enumerate(records) if record.tag == tag)
    payload = records[at].payload
    records[at] = records[at]._replace(payload=payload[:6] + change(payload[6:]))
    return assembled(records)


def container_faults(golden: Path) -> Iterator[tuple[str, bytes]]:
    """Faults that show before any body is decoded."""
    good = (golden / "paper-one-frame.touch").read_bytes()
    records = records_of(good)
    head, *others = records
    yield "foreign", b"\x89PNG\r\n\x1a\n" + bytes(64)
    yield "nothing", b""
    yield "text-mode", good.replace(b"\r\n", b"\n")
    yield "newer-major", good[:10] + b"\2" + good[11:]
    yield "cut-in-opening", good[:12]
    yield "cut-in-head", good[:40]
    yield "cut-before-index", good[: good.rindex(b"INDX")]
    yield "cut-at-end", good[:-1]
    yield "joined", good + good
    yield (
        "bit-flipped",
        good[: len(good) // 2] + bytes([good[len(good) // 2] ^ 4]) + good[len(good) // 2 + 1 :],
    )
    yield "unknown-required", assembled([*records, Record(b"NEWS", 1, b"")])
    yield "unknown-flags", assembled([*records, Record(b"NEWS", 2, b"")])
    yield "optional-segment", assembled([*records[:-1], records[-1]._replace(flags=0)])
    yield "two-heads", assembled([head, *records])
    yield "story-twice", assembled([head, others[0], *others])
    yield "key-twice", assembled([head, Record(b"PROV", 0, b"\2\0" + b"\1\0k\0\0" * 2), records[-1]])
    yield "index-beside", assembled(records, shift=1)
    yield "frames-missing", assembled([head.changed(68, "I", 2), *others])
    yield "grid-too-large", assembled([head.changed(0, "3I", 1 << 20, 1 << 16, 513), *others])
    yield "grid-too-thin", assembled([head.changed(0, "3I", 1, 1 << 20, 1 << 16), *others])
    yield "spacing-denormal", assembled([head.changed(12, "d", 5e-324), *others])
    yield "rate-not-finite", assembled([head.changed(60, "d", float("inf")), *others])
    coder = head._replace(payload=head.payload.replace(b"\5\0paper", b"\5\0qaper"))
    yield "unknown-coder", assembled([coder, *others])
    late = Record(b"VIBR", 0, struct.pack("<IH", 0, 1))
    yield "vibration-late", assembled(records, late)
    yield "vibration-of-others", assembled([*records[:-1], late.changed(4, "H", 2), records[-1]])
    objects = (golden / "objects-rigid.touch").read_bytes()
    bodies = [r for r in records_of(objects) if r.tag == b"OBJT"]
    one, two = bodies[0].to_bytes(), bodies[1].to_bytes()
    yield "objects-swapped", objects.replace(one + two, two + one)
    yield "objects-missing", assembled([r for r in records_of(objects) if r.tag != b"OBJT"])
    shape = 2 + int.from_bytes(bodies[0].payload[:2], "little")
    large = [
        r.changed(shape, "3I", 1 << 20, 1 << 16, 513) if r == bodies[0] else r for r in records_of(objects)
    ]
    yield "object-too-large", assembled(large)


def refusal(path: Path) -> str:
    """The error that decoding all of a file raises, or nothing."""
    try:
        with open_file(path) as opened:
            for i, frame in enumerate(opened.medium):
                assert frame.grid == opened.grid
                if opened.medium.vibration is not None:
                    opened.medium.vibration(i)
    except TouchfieldError as error:
        return type(error).__name__
    return ""


def is_in_order(path: Path) -> bool:
    """True if the lengths within all bodies hold: decoders tell of one that does not at other times."""
    try:
        with open_file(path) as opened:
            return bool(opened.summary())
    except TouchfieldError:
        return False


def write_body_faults(golden: Path, folder: Path) -> Iterator[str]:
    """Damaged bodies of every coder: cut, longer, and with the first flipped bit that cannot go unseen."""
    for name in ("paper-closed-loop", "touch-mask", "touch-lossless", "objects-rigid", "vibration"):
        data, tag = (golden / f"{name}.touch").read_bytes(), b"VIBR" if name == "vibration" else b"SEGM"
        changes = {"cut": lambda body: body[: len(body) // 2], "long": lambda body: body + 9 * b"\x55"}
        for kind, change in changes.items():
            (folder / f"{name}-{kind}.touch").write_bytes(with_body(data, tag, change))
            yield f"{name}-{kind}"
        path = folder / f"{name}-flipped.touch"
        for place in range(4000):
            path.write_bytes(with_body(data, tag, lambda body, n=place: flipped(body, n)))  # type: ignore[misc]
            if refusal(path) == "CorruptFile" and (tag == b"VIBR" or is_in_order(path)):
                yield path.stem
                break


def flipped(body: bytes, place: int) -> bytes:
    """A body with one other bit, at places in no order."""
    at = place * 37 % len(body)
    return body[:at] + bytes([body[at] ^ 1 << place % 8]) + body[at + 1 :]


def write_faulty(golden: Path, folder: Path) -> None:
    """Write all faulty files but those of older versions, which stay, and the errors of all.

    Raises
    ------
    AssertionError
        If one of them is decoded without an error.
    """
    for path in folder.glob("*.touch"):
        if not path.stem.startswith("older-"):
            path.unlink()
    for name, data in container_faults(golden):
        (folder / f"{name}.touch").write_bytes(data)
    list(write_body_faults(golden, folder))
    errors = {path.stem: refusal(path) for path in sorted(folder.glob("*.touch"))}
    assert all(errors.values()), f"decoded without an error: {[name for name in errors if not errors[name]]}"
    (folder / "errors.json").write_text(json.dumps(errors, indent=1) + "\n")
