"""The conformance decoder: a second decoder of ``.touch`` files that follows docs/format step by step, in
plain Python and numpy, slowly. Tests compare the package with it.

It shares no line with the package and uses nothing that the documents do not say. This file is the container.

``python conformance/decoder.py FILE.touch OUT.npz``
"""

import math
import re
import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import decode_objects
import decode_vibration
import numpy as np
from reading import (
    CorruptFile,
    Cursor,
    FaultyFile,
    ForeignFile,
    TruncatedFile,
    UnsupportedVersion,
    laid_out,
    need,
)

MAGIC = b"\x89TOUCH\r\n\x1a\n"
FLAGS = {"HEAD": 1, "PROV": 0, "OBJT": 1, "VIBR": 0, "SEGM": 1, "INDX": 1, "TEND": 1}
ORDER = r"HEAD (OBJT |PROV |VIBR )*SEGM ((VIBR )?SEGM )*INDX TEND"
MOST_DENSE = 1 << 28  # samples of all frames that `decode` lays out; `frames_of` has no such limit

LATTICE = (("grid_shape", "3I", 1, 1 << 20), ("spacing_m", "3d", 1e-9, 1e6), ("origin_m", "3d", -1e9, 1e9))
HEAD = (
    *LATTICE,
    ("rate_hz", "d", 1e-6, 1e6),
    ("frame_count", "I", 1, (1 << 31) - 1),
    ("axes", "text", 0, 256),
    ("device_name", "text", 0, 256),
    ("device_type", "B", 1, 2),
    ("force_max_n", "d", 1e-30, 1e30),
    ("mapping_scale", "d", 1e-30, 1e30),
    ("mapping_offset_m", "3d", -1e9, 1e9),
    ("weber_fraction", "d", 0, 1),
    ("force_threshold_n", "d", 0, 1e30),
    ("friction", "d", 0, 1e30),
    ("damping_n_s_per_m", "d", 0, 1e30),
    ("tags", "texts", 16, 64),
    ("coder", "name", 1, 32),
    ("coder_parameters", "bytes", 0, 1 << 16),
)
OBJECT = (
    ("name", "text", 0, 256), *LATTICE, ("is_deforming", "B", 0, 1), ("field_coder", "name", 1, 32),
    ("field_parameters", "bytes", 0, 1 << 16), ("pose_steps", "bytes", 0, 64),
)  # fmt: skip


class Record(NamedTuple):
    """A record whose CRC-32 holds."""

    tag: str
    offset: int
    payload: bytes
    crc: bytes


class Segment(NamedTuple):
    """Frames that are decoded together; `vibration` is None where nothing vibrates."""

    frame_count: int
    body: bytes
    vibration: bytes | None


class TouchFile(NamedTuple):
    """What the container holds: the fields of HEAD and of each OBJT by their names, and the segments."""

    head: dict[str, Any]
    objects: list[dict[str, Any]]
    segments: list[Segment]


def read_fields(c: Cursor, table: tuple[tuple[str, str, float, float], ...]) -> dict[str, Any]:
    """The fields of a payload, each within its bounds."""
    found: dict[str, Any] = {}
    for name, kind, low, high in table:
        if kind in ("text", "name"):
            found[name] = c.text(int(high), int(low))
            need(kind == "text" or re.fullmatch("[a-z][a-z0-9._-]*", found[name]), f"the {name}")
        elif kind == "texts":
            count = c.number("H")
            need(count <= low, f"{count} {name}")
            found[name] = tuple(c.text(int(high)) for _ in range(count))
        elif kind == "bytes":
            size = c.number("I")
            need(size <= high, f"{size} bytes in a field")
            found[name] = c.take(size)
        else:
            values = c.numbers(kind)
            need(all(low <= value <= high for value in values), f"{name} of {values}")
            found[name] = values if len(values) > 1 else values[0]
    need(math.prod(-(-n // 8) for n in found["grid_shape"]) <= 1 << 27, f"{found['grid_shape']} samples")
    return found


def check_provenance(c: Cursor) -> None:
    """The pairs of PROV; nothing else depends on them."""
    count, keys = c.number("H"), set()
    need(count <= 64, f"{count} pairs")
    for _ in range(count):
        keys.add(c.text(64, 1))
        c.text(4096, 0, r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")
    need(len(keys) == count, "a key twice")
    c.end()


def check_opening(data: bytes) -> None:
    """Refuse what is no file of version 1."""
    magic, wanted = data[:10], MAGIC[: len(data)]
    is_text = any(magic[i : i + 5] == b"TOUCH" for i in (1, 2, 3)) and magic != wanted
    need(not is_text, "a file that was transferred as text")
    need(data and magic == wanted, "no .touch file", ForeignFile)
    need(len(data) >= 14, f"{len(data)} bytes", TruncatedFile)
    major, minor = struct.unpack("<HH", data[10:14])
    need(
        major >= 1,
        f"format {major}.{minor}, made by a version before 1.0: encode it again",
        UnsupportedVersion,
    )
    need(major == 1, f"format {major}.{minor}", UnsupportedVersion)


def read_records(data: bytes) -> list[Record]:
    """All records of the seven kinds, from HEAD to TEND; others are skipped if they may be."""
    file, records = Cursor(data), [Record("", 0, b"", b"")]
    file.at = 14
    while records[-1].tag != "TEND":
        offset = file.at
        name, flags, length = file.numbers("4sIQ")
        need(re.fullmatch(rb"[A-Z0-9]{4}", name) and flags <= 1, f"the frame at byte {offset}")
        payload, crc = file.take(length), file.take(4)
        need(
            crc == struct.pack("<I", zlib.crc32(data[offset : file.at - 4])),
            f"the CRC-32 at byte {file.at - 4}",
        )
        name = name.decode("ascii")
        need(name in FLAGS or not flags, f"a required record {name}", UnsupportedVersion)
        if name in FLAGS:
            need(flags == FLAGS[name], f"the flags of {name}")
            records.append(Record(name, offset, payload, crc))
    file.end()
    return records[1:]


def read_segments(records: list[Record], frame_count: int) -> list[Segment]:
    """The segments, each with the VIBR before it, compared with INDX."""
    entries, segments = Cursor(records[-2].payload, CorruptFile), []
    need(entries.number("I") == sum(r.tag == "SEGM" for r in records), "the number of segments in INDX")
    first, vibration = 0, None
    for tag, offset, payload, crc in records:
        if tag not in ("VIBR", "SEGM"):
            continue
        own = Cursor(payload, CorruptFile).numbers("IH")
        need(own[0] == first and 1 <= own[1] <= frame_count - first, f"the frames of {tag}")
        if tag == "VIBR":
            vibration = payload
            continue
        expected = (*own, offset, len(payload) + 20, int.from_bytes(crc, "little"))
        need(entries.numbers("IHQQI") == expected, "an entry of INDX")
        need(vibration is None or vibration[:6] == payload[:6], "a VIBR of other frames than its segment")
        segments.append(Segment(own[1], payload[6:], vibration and vibration[6:]))
        first, vibration = first + own[1], None
    entries.end()
    need(first == frame_count, "the number of frames in INDX")
    return segments


def read_file(data: bytes) -> TouchFile:
    """All that the container holds; FaultyFile if it is not what docs/format/container.md describes."""
    check_opening(data)
    records = read_records(data)
    order = " ".join(r.tag for r in records)
    need(re.fullmatch(ORDER, order), "records that are missing, or in another order")
    need(order.count("PROV") <= 1 and order.partition("SEGM")[0].count("VIBR") <= 1, "a record twice")
    c = Cursor(records[0].payload, CorruptFile)
    head = read_fields(c, HEAD)
    c.end()
    object_records = [r for r in records if r.tag == "OBJT"]
    count = len(object_records)
    need((count > 0) == (head["coder"] == "objects") and count <= 4096, f"{count} objects")
    chain = zlib.crc32(data[:14] + b"".join(r.crc for r in (records[0], *object_records, records[-2])))
    end = struct.pack("<QQI", records[-2].offset, len(data), chain)
    need(records[0].offset == 14 and records[-1].payload == end, "HEAD or TEND does not fit to the file")
    for record in (r for r in records if r.tag == "PROV"):
        check_provenance(Cursor(record.payload, CorruptFile))
    bodies = [Cursor(r.payload, CorruptFile) for r in object_records]
    objects = [{**read_fields(c, OBJECT), "field": c.rest()} for c in bodies]
    return TouchFile(head, objects, read_segments(records, head["frame_count"]))


class TooLarge(FaultyFile):
    """Its frames are too large to lay out, but it may be without a fault."""


def frames_of(file: TouchFile) -> Iterator[Any]:
    """The frames of a file, one after another: bricks, or dense arrays of objects."""
    coder = file.head["coder"]
    need(coder == "objects" or coder in decode_objects.CODERS, f"the coder {coder!r}", UnsupportedVersion)
    if coder == "objects":
        yield from decode_objects.decode_forces(file)
        return
    known = file.head["coder_parameters"], file.head["grid_shape"]
    for segment in file.segments:
        yield from decode_objects.CODERS[coder](segment.body, *known, segment.frame_count)


def vibration_of(file: TouchFile) -> dict[str, Any]:
    """Amplitudes and frequencies of all frames; nothing where there is no VIBR."""
    if all(segment.vibration is None for segment in file.segments):
        return {}
    shape, made = file.head["grid_shape"], list[Any]()
    for count, _, body in file.segments:
        nothing = [np.zeros((2, *shape), np.float32)] * count
        made += nothing if body is None else decode_vibration.decode_segment(body, shape, count)
    amplitudes_n, frequencies_hz = np.stack(made, axis=1)
    return {"amplitudes_n": amplitudes_n, "frequencies_hz": frequencies_hz}


def decode(path: str | Path) -> dict[str, Any]:
    """All of a file as dense arrays; FaultyFile if it is not what docs/format describes, or too large to lay
    out.
    """
    file = read_file(Path(path).read_bytes())
    shape, count = file.head["grid_shape"], file.head["frame_count"]
    sizes = f"{count} frames of {shape} samples are too many to lay out; frames_of decodes them as bricks"
    need(count * math.prod(shape) <= MOST_DENSE, sizes, TooLarge)
    forces_n = np.zeros((count, *shape, 3), np.float32)
    for i, frame in enumerate(frames_of(file)):
        forces_n[i] = laid_out(frame, shape) if isinstance(frame, dict) else frame
    places = {name: np.array(file.head[name]) for name in ("origin_m", "spacing_m", "rate_hz")}
    return {"forces_n": forces_n, **places, **vibration_of(file)}


def main() -> None:
    """Decode one file to one ``.npz``."""
    if len(sys.argv) != 3:
        sys.exit("usage: decoder.py FILE.touch OUT.npz")
    try:
        np.savez_compressed(sys.argv[2], **decode(sys.argv[1]))
    except (FaultyFile, OSError) as error:
        sys.exit(f"{sys.argv[1]}: {type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
