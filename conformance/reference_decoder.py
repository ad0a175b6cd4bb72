"""A second decoder of ``.touch`` files, which follows docs/format.md step by step: plain Python and numpy, slow.

`reference_objects`, `reference_touch` and `reference_vibration`, beside it, are the parts for files of coders
`objects` and `touch`, and for VIBR.

It shares no line with the package and uses nothing that the document does not say, so that it can tell whether the
document is enough and whether the package keeps to it. It is meant to be read beside the document.

``python conformance/reference_decoder.py FILE.touch OUT.npz``
"""

from __future__ import annotations

import argparse
import math
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from decode_paper import Forces, codebook, decode_segment
from numpy.typing import NDArray
from support import (
    CERTAIN,
    RATES,
    SQUASH,
    STRETCH,
    Coder,
    Models,
    Position,
    Support,
    brick_counts,
    decode_support,
    inside,
    samples_of,
)

__all__ = [
    "CERTAIN", "RATES", "SQUASH", "STRETCH", "Coder", "Forces", "Models", "Position", "Support", "brick_counts",
    "codebook", "decode", "decode_bodies", "decode_segment", "decode_support", "inside", "samples_of",
]  # fmt: skip

Array = NDArray[Any]

MOST_DENSE = 1 << 28
"""Samples of all frames that `decode` lays out; `decode_bodies` has no such limit."""


def need(condition: object, message: str) -> None:
    """Refuse the file unless `condition` holds."""
    if not condition:
        raise ValueError(message)


class Cursor:
    """Bytes, read from the first to the last and not beyond."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, size: int) -> bytes:
        need(size <= len(self.data) - self.at, f"{size} bytes wanted, {len(self.data) - self.at} left")
        self.at += size
        return self.data[self.at - size : self.at]

    def numbers(self, codes: str) -> tuple[Any, ...]:
        values = struct.unpack("<" + codes, self.take(struct.calcsize("<" + codes)))
        need(all(math.isfinite(v) for v in values if isinstance(v, float)), "a number that is not finite")
        return values

    def number(self, code: str) -> Any:
        return self.numbers(code)[0]

    def text(self, most: int, least: int = 0, control: str = r"[\x00-\x1f\x7f-\x9f]") -> str:
        size = self.number("H")
        need(least <= size <= most, f"a text of {size} bytes")
        text = self.take(size).decode("utf-8")  # a UnicodeDecodeError is a ValueError
        need(not re.search(control, text), "a control character in a text")
        return text

    def octets(self, most: int) -> bytes:
        size = self.number("I")
        need(size <= most, f"{size} bytes in a field")
        return self.take(size)

    def varint(self) -> int:
        value = 0
        for place in range(8):
            byte: int = self.number("B")
            value |= (byte & 127) << (7 * place)
            if byte < 128:
                need(byte or not place, "a varint that is not in its shortest form")
                return value
        raise ValueError("a varint of more than 8 bytes")

    def chunk(self) -> bytes:
        return self.take(self.varint())

    def bit_chunk(self) -> list[int]:
        size = self.varint()
        data = self.take(-(-size // 8))
        bits: list[int] = np.unpackbits(np.frombuffer(data, np.uint8)).tolist()
        need(not any(bits[size:]), "bits behind the end of a bit chunk")
        return bits[:size]

    def end(self) -> None:
        need(self.at == len(self.data), f"{len(self.data) - self.at} bytes too many")


# -- the container ----------------------------------------------------------------------------------------


@dataclass
class Record:
    """A record whose CRC-32 holds."""

    tag: str
    offset: int
    payload: bytes
    crc: int

    @property
    def length(self) -> int:
        return len(self.payload) + 20


SINCE_MINOR = {b"HEAD": 0, b"PROV": 0, b"OBJT": 1, b"VIBR": 2, b"SEGM": 0, b"INDX": 0, b"TEND": 0}


def read_records(data: bytes) -> tuple[bytes, list[Record]]:
    """The opening, and all records that a reader of version 0.2 knows."""
    file = Cursor(data)
    need(file.take(10) == bytes.fromhex("89544f5543480d0a1a0a"), "no .touch file")
    major, _ = file.numbers("HH")
    need(major == 0, f"format version {major}")
    records = []
    while file.at < len(data):
        offset = file.at
        tag, flags, since_minor, length = file.numbers("4sHHQ")
        need(re.fullmatch(rb"[A-Z0-9]{4}", tag), "a tag of other characters")
        payload = file.take(length)
        crc = file.number("I")
        need(crc == zlib.crc32(data[offset : file.at - 4]), f"the CRC-32 of the record at byte {offset}")
        need(flags <= 1, "unknown flags")
        if since_minor <= 2 and tag in SINCE_MINOR:
            need(
                flags == (tag not in (b"PROV", b"VIBR")) and since_minor == SINCE_MINOR[tag],
                "the frame of a known record",
            )
            records.append(Record(tag.decode("ascii"), offset, payload, crc))
        else:
            need(not flags, f"a required record {tag!r} of minor version {since_minor}")
    return data[:14], records


def read_head(payload: bytes) -> dict[str, Any]:
    """The fields of HEAD that decoding needs; the others are checked all the same."""
    c = Cursor(payload)
    shape, spacing_m, origin_m = c.numbers("3I"), c.numbers("3d"), c.numbers("3d")
    rate_hz, frame_count = c.numbers("dI")
    need(all(1 <= n <= 1 << 20 for n in shape) and all(h > 0 for h in spacing_m), "the grid of HEAD")
    need(0 < rate_hz <= 1e6 and 1 <= frame_count < 1 << 31, "rate_hz or frame_count of HEAD")
    c.text(256)  # axes
    c.text(256)  # device_name
    device_type, force_max_n, mapping_scale = c.numbers("Bdd")
    c.numbers("3d")  # mapping_offset_m
    weber_fraction, *others = c.numbers("4d")
    need(device_type in (1, 2) and force_max_n > 0 and mapping_scale > 0, "the device of HEAD")
    need(0 <= weber_fraction <= 1 and min(others) >= 0, "the promises of HEAD")
    tag_count = c.number("H")
    need(tag_count <= 16, f"{tag_count} tags")
    for _ in range(tag_count):
        c.text(64)
    coder = c.text(32, 1)
    need(coder in ("paper", "objects", "touch"), f"coder {coder!r}")
    parameters = c.octets(1 << 16)
    c.end()
    return {
        "shape": shape, "spacing_m": spacing_m, "origin_m": origin_m, "rate_hz": rate_hz,
        "frame_count": frame_count, "force_max_n": force_max_n, "coder": coder, "parameters": parameters,
    }  # fmt: skip


def read_file(data: bytes) -> tuple[dict[str, Any], list[tuple[int, bytes]]]:
    """The head, with the payloads of its objects and what vibrates, and frame count and body of every segment."""
    opening, records = read_records(data)
    order = " ".join(r.tag for r in records)
    pattern = r"HEAD (OBJT |PROV |VIBR )*SEGM ((VIBR )?SEGM )*INDX TEND"
    need(re.fullmatch(pattern, order), "records out of order, or some that are missing")
    need(order.count("PROV") <= 1 and order.partition("SEGM")[0].count("VIBR") <= 1, "a record twice")
    need(records[0].offset == 14 and len(records[-1].payload) == 20, "the places of HEAD and TEND")
    need(records[-1].offset + 40 == len(data), "bytes behind TEND")
    head, index, segments = read_head(records[0].payload), records[-2], [r for r in records if r.tag == "SEGM"]
    objects = [r for r in records if r.tag == "OBJT"]
    need((len(objects) > 0) == (head["coder"] == "objects") and len(objects) <= 4096, f"{len(objects)} objects")
    head["objects"] = [r.payload for r in objects]
    end = struct.unpack("<QQI", records[-1].payload)
    chain = zlib.crc32(opening + b"".join(struct.pack("<I", r.crc) for r in (records[0], *objects, index)))
    need(end == (index.offset, len(data), chain), "TEND does not fit to the file")
    for record in records:
        if record.tag == "PROV":
            check_provenance(Cursor(record.payload))
    entries = Cursor(index.payload)
    need(entries.number("I") == len(segments), "the number of segments in INDX")
    bodies, first = [], 0
    head["vibrations"] = vibrations(records)
    for record in segments:
        segment = Cursor(record.payload)
        own = (*segment.numbers("IH"), record.offset, record.length, record.crc)
        need(entries.numbers("IHQQI") == own and own[0] == first and own[1] >= 1, "an entry of INDX")
        first += own[1]
        bodies.append((own[1], record.payload[6:]))
    entries.end()
    need(first == head["frame_count"], "the number of frames in INDX")
    return head, bodies


def vibrations(records: list[Record]) -> list[bytes | None]:
    """The body of the VIBR before each segment; None where there is none."""
    found: list[bytes | None] = []
    latest = None
    for record in records:
        if record.tag == "VIBR":
            latest = record.payload
            need(len(latest) >= 6, "a VIBR that is too short")
        elif record.tag == "SEGM":
            need(latest is None or latest[:6] == record.payload[:6], "a VIBR of other frames than its segment")
            found.append(None if latest is None else latest[6:])
            latest = None
    return found


def check_provenance(c: Cursor) -> None:
    """The pairs of PROV; the forces do not depend on them."""
    count = c.number("H")
    need(count <= 64, f"{count} pairs in PROV")
    keys = set()
    for _ in range(count):
        keys.add(c.text(64, 1))
        c.text(4096, 0, r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
    need(len(keys) == count, "a key twice in PROV")
    c.end()


# -- whole files ------------------------------------------------------------------------------------------


def decode_bodies(data: bytes) -> tuple[dict[str, Any], Iterator[Forces]]:
    """The head of a file of coder `paper` or `touch`, and its frames as sparse bricks."""
    head, bodies = read_file(data)
    need(head["coder"] != "objects", "objects, not frames")
    if head["coder"] == "touch":
        import reference_touch

        known = head["shape"], head["spacing_m"], head["parameters"]
        return head, (f for count, body in bodies for f in reference_touch.decode_touch_body(body, count, *known))
    known = head["parameters"], head["shape"]
    return head, (f for count, body in bodies for f in decode_segment(body, *known, count))


def laid_out(bricks: Forces, shape: Position) -> Array:
    """Bricks as a dense array, newtons, float32 [nx, ny, nz, 3]."""
    dense = np.zeros((*(8 * n for n in brick_counts(shape)), 3), np.float32)
    for (x, y, z), forces in bricks.items():
        dense[8 * x : 8 * x + 8, 8 * y : 8 * y + 8, 8 * z : 8 * z + 8] = forces
    return dense[: shape[0], : shape[1], : shape[2]]


def decode(path: str | Path) -> dict[str, Any]:
    """All forces of a file; of objects, those at the points of its grid.

    Returns
    -------
    dict
        ``forces_n`` float32 [frame, nx, ny, nz, 3], newtons; ``origin_m`` and ``spacing_m`` float64 [3];
        ``rate_hz``. Where there is VIBR, also ``amplitudes_n`` and ``frequencies_hz``, float32 [frame, nx, ny, nz],
        0 where nothing vibrates.

    Raises
    ------
    ValueError
        If the file is not what docs/format.md describes, or too large to lay out.
    """
    data = Path(path).read_bytes()
    head, segments = read_file(data)
    shape, count = head["shape"], head["frame_count"]
    need(count * math.prod(shape) <= MOST_DENSE, f"{count} frames of {shape} samples are too many to lay out")
    if head["coder"] == "objects":
        import reference_objects

        forces_n = reference_objects.decode_scene(data).voxels()
    else:
        forces_n = np.zeros((count, *shape, 3), np.float32)
        for i, bricks in enumerate(decode_bodies(data)[1]):
            forces_n[i] = laid_out(bricks, shape)
    decoded = {
        "forces_n": forces_n,
        "origin_m": np.array(head["origin_m"]),
        "spacing_m": np.array(head["spacing_m"]),
        "rate_hz": head["rate_hz"],
    }
    if any(body is not None for body in head["vibrations"]):
        import reference_vibration

        decoded |= reference_vibration.laid_out(head, [count for count, _ in segments])
    return decoded


def main() -> None:
    """Decode one file to one ``.npz``."""
    parser = argparse.ArgumentParser(description="Decode a .touch file by docs/format.md alone, slowly.")
    parser.add_argument("stream", metavar="FILE.touch")
    parser.add_argument("field", metavar="OUT.npz")
    asked = parser.parse_args()
    try:
        decoded = decode(asked.stream)
    except (ValueError, OSError) as error:
        parser.exit(1, f"{asked.stream}: {error}\n")
    np.savez_compressed(asked.field, **decoded)


if __name__ == "__main__":
    main()
