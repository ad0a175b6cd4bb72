"""Movies with touch as other programs write them: boxes, packets and elements made here, byte by byte."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from io import BytesIO
from itertools import pairwise

from touchfield.container import TouchReader
from touchfield.network.touch_track import KLV, sync_record

Sample = tuple[float, bytes]
"""When a sample shows in seconds, and its bytes."""

PICTURE = b"\0\0\0\1picture"
TIMESCALE = 90000


def samples_of(stream: bytes, at_s: float, start_s: float | None = None) -> list[Sample]:
    """The file divided after each segment, and the record of its start before the first one."""
    with TouchReader(BytesIO(stream)) as reader:
        entries, rate_hz = reader.segments, reader.head.rate_hz
    sync = b"" if start_s is None else sync_record(start_s)
    head = stream[: entries[0].offset] + sync
    ends = [entry.offset + entry.length for entry in entries]
    parts = [head + stream[entries[0].offset : ends[0]]] + [stream[a:b] for a, b in pairwise(ends)]
    return [(at_s + e.first_frame / rate_hz, part) for e, part in zip(entries, parts, strict=True)]


# -- MP4 and MOV -------------------------------------------------------------------------------------------


def box(kind: bytes, *contents: bytes) -> bytes:
    data = b"".join(contents)
    return struct.pack(">I4s", 8 + len(data), kind) + data


def full(kind: bytes, *contents: bytes, version: int = 0, flags: int = 0) -> bytes:
    return box(kind, bytes([version]), flags.to_bytes(3, "big"), *contents)


def words(*values: int) -> bytes:
    return struct.pack(f">{len(values)}I", *values)


def trak(
    number: int, handler: bytes, label: bytes, tables: bytes, edits: Sequence[tuple[int, int]] = ()
) -> bytes:
    """A track; `edits` are durations in ms, and times in the medium or -1."""
    rows = b"".join(struct.pack(">IiI", *edit, 0x10000) for edit in edits)
    edts = box(b"edts", full(b"elst", words(len(edits)), rows)) if edits else b""
    header = full(b"tkhd", words(0, 0, number), bytes(72))
    mdhd = full(b"mdhd", words(0, 0, TIMESCALE, 0, 0))
    hdlr = full(b"hdlr", bytes(4), handler, bytes(13))
    stsd = full(b"stsd", words(1), box(label, bytes(8)))
    minf = box(b"minf", box(b"stbl", stsd, tables))
    return box(b"trak", header, edts, box(b"mdia", mdhd, hdlr, minf))


def stbl(
    samples: Sequence[Sample], offsets: Sequence[int], kind: bytes = b"stsz", start: float = 0.0
) -> bytes:
    """Tables of samples, each a chunk of its own; the last duration is 0, as ffmpeg writes it."""
    ticks = [round((time_s - start) * TIMESCALE) for time_s, _ in samples]
    durations = [b - a for a, b in pairwise(ticks)] + [0]
    sizes = [len(data) for _, data in samples]
    wide = kind == b"stz2"
    size_table = (
        full(b"stz2", words(16, len(sizes)), struct.pack(f">{len(sizes)}H", *sizes))
        if wide
        else full(b"stsz", words(0, len(sizes), *sizes))
    )
    chunks = (
        full(b"co64", words(len(offsets)), struct.pack(f">{len(offsets)}Q", *offsets))
        if wide
        else full(b"stco", words(len(offsets), *offsets))
    )
    stts = full(b"stts", words(len(durations)), *(words(1, d) for d in durations))
    return stts + full(b"stsc", words(1, 1, 1, 1)) + size_table + chunks


def plain_mp4(
    samples: Sequence[Sample],
    handler: bytes = b"meta",
    label: bytes = b"gpmd",
    kind: bytes = b"stsz",
    picture_ms: int = 21,
) -> bytes:
    """As ffmpeg writes an MP4: `moov` last, and an edit list that ends before the last sample."""
    ftyp = box(b"ftyp", b"isom", words(512), b"isommp42")
    offsets, position = list[int](), len(ftyp) + 8 + len(PICTURE)
    for _, data in samples:
        offsets.append(position)
        position += len(data)
    mdat = box(b"mdat", PICTURE, *(data for _, data in samples))
    start_ms = round(1000 * samples[0][0])
    last_ms = round(1000 * samples[-1][0])
    picture = stbl([(0.0, PICTURE)], [len(ftyp) + 8])
    video = trak(1, b"vide", b"avc1", picture, [(picture_ms, -1), (40, 0)])
    tables = stbl(samples, offsets, kind, samples[0][0])
    touch = trak(2, handler, label, tables, [(start_ms, -1), (last_ms - start_ms, 0)])
    moov = box(b"moov", full(b"mvhd", words(0, 0, 1000, 0), bytes(80)), video, touch)
    return ftyp + mdat + moov


def fragmented_mp4(samples: Sequence[Sample], base: str = "moof", first_s: float | None = None) -> bytes:
    """As ffmpeg writes fragments, without edits; `first_s` replaces the time of the first sample.

    `base` is how positions are stated: "moof", "file", or "before" (relative to what came before).
    """
    ftyp = box(b"ftyp", b"iso5", words(512), b"iso5")
    empty = stbl([], [])
    traks = trak(1, b"vide", b"avc1", empty) + trak(2, b"meta", b"gpmd", empty)
    trex = b"".join(full(b"trex", words(number, 1, 3600, 0, 0)) for number in (1, 2))
    data = ftyp + box(b"moov", full(b"mvhd", words(0, 0, 1000, 0), bytes(80)), traks, box(b"mvex", trex))
    for number, (time_s, sample) in enumerate(samples):
        shown = first_s if first_s is not None and not number else time_s
        data += _fragment(len(data), round(shown * TIMESCALE), sample, base, picture=not number)
    return data


def _fragment(at: int, ticks: int, sample: bytes, base: str, picture: bool) -> bytes:
    def traf(number: int, time: int, size: int, offset: int) -> bytes:
        flags = {"moof": 0x20000, "file": 0x1, "before": 0}[base]
        where = struct.pack(">Q", at) if base == "file" else b""
        has_offset = base != "before" or offset == first
        run = words(1) + (words(offset) if has_offset else b"") + words(size)
        return box(
            b"traf",
            full(b"tfhd", words(number), where, flags=flags),
            full(b"tfdt", struct.pack(">Q", time), version=1),
            full(b"trun", run, flags=0x200 | (0x1 if has_offset else 0)),
        )

    def moof() -> bytes:
        pictures = traf(1, 0, len(PICTURE), first) if picture else b""
        shift = len(PICTURE) if picture else 0
        return box(b"moof", full(b"mfhd", words(1)), pictures, traf(2, ticks, len(sample), first + shift))

    first = 0
    first = len(moof()) + 8
    return moof() + box(b"mdat", PICTURE if picture else b"", sample)


# -- MPEG-TS -----------------------------------------------------------------------------------------------


def triplet(data: bytes) -> bytes:
    return KLV + len(data).to_bytes(4, "big") + data


def pes(data: bytes, stream: int, ticks: int | None, stuffing: int = 0) -> bytes:
    stamp = b""
    if ticks is not None:
        ticks %= 1 << 33
        stamp = bytes([0x21 | ticks >> 29 & 0xE]) + struct.pack(
            ">HH", ticks >> 14 & 0xFFFE | 1, ticks << 1 & 0xFFFE | 1
        )
    header = bytes([0x84, 0x80 if stamp else 0, len(stamp) + stuffing]) + stamp + b"\xff" * stuffing
    length = len(header) + len(data)
    return b"\0\0\1" + bytes([stream]) + struct.pack(">H", length if length < 65536 else 0) + header + data


def packets(data: bytes, pid: int, counter: int = 0) -> list[bytes]:
    """The packets of 188 bytes of one PES packet; the last one is filled by an adaptation field."""
    made = list[bytes]()
    for start in range(0, len(data), 184):
        part = data[start : start + 184]
        fill = 184 - len(part)
        field = b"" if not fill else bytes([fill - 1]) + (b"\0" + b"\xff" * (fill - 2) if fill > 1 else b"")
        head = bytes([0x47, (0x40 if not start else 0) | pid >> 8, pid & 0xFF])
        head += bytes([(0x30 if fill else 0x10) | (counter + len(made)) % 16])
        made.append(head + field + part)
    return made


def transport_stream(
    samples: Sequence[Sample],
    stream: int = 0xBD,
    picture_s: float = 1.48,
    step: int = 188,
    label: bytes = b"",
    pes_bytes: int = 1 << 30,
    stuffing: int = 0,
    repeats: int = 1,
) -> bytes:
    """Pictures on PID 256 and touch on PID 258.

    A sample longer than `pes_bytes` continues in PES packets without a time, `label` is written before each,
    and each packet is written `repeats` times.
    """
    made = packets(pes(PICTURE, 0xE0, round(picture_s * TIMESCALE)), 256)
    for time_s, data in samples:
        ticks: int | None = round((time_s + picture_s) * TIMESCALE)
        for start in range(0, len(data), pes_bytes):
            part = data[start : start + pes_bytes]
            made += packets(pes(label + part if not start else part, stream, ticks, stuffing), 258, len(made))
            ticks = None
    lead, tail = (b"\0" * 4, b"") if step == 192 else (b"", b"\0" * (step - 188))
    return b"".join((lead + packet + tail) * repeats for packet in made)


# -- Matroska ----------------------------------------------------------------------------------------------


def element(kind: int, *contents: bytes, is_open: bool = False) -> bytes:
    data = b"".join(contents)
    size = b"\x01" + b"\xff" * 7 if is_open else (1 << 56 | len(data)).to_bytes(8, "big")
    return kind.to_bytes((kind.bit_length() + 7) // 8, "big") + size + data


def matroska(attachments: Sequence[bytes], picture_ms: int = 21, is_live: bool = False) -> bytes:
    """As mkvmerge writes an MKV with attachments; `is_live` leaves lengths open."""
    files = (
        element(0x61A7, element(0x466E, b"any.bin"), element(0x4660, b"application/x"), element(0x465C, data))
        for data in attachments
    )
    info = element(0x1549A966, element(0x2AD7B1, (1_000_000).to_bytes(3, "big")))
    tracks = element(
        0x1654AE6B,
        element(0xAE, element(0xD7, b"\1"), element(0x83, b"\2")),
        element(0xAE, element(0xD7, b"\2"), element(0x83, b"\1")),
    )
    blocks = (
        element(0xA3, b"\x81\0\0\x80sound"),
        element(0xA0, element(0xA1, b"\x82" + picture_ms.to_bytes(2, "big") + b"\0" + PICTURE)),
    )
    cluster = element(0x1F43B675, element(0xE7, b"\0"), *blocks, is_open=is_live)
    body = info, tracks, cluster, element(0x1941A469, *files)
    return element(0x1A45DFA3, element(0x4282, b"matroska")) + element(0x18538067, *body, is_open=is_live)
