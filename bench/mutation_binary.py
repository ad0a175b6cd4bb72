"""Damages binary formats by their structure: chunks, boxes, elements, packets, records, tables, archives."""

from __future__ import annotations

import io
import random
import re
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from mutation import (
    ODD_INTEGERS,
    ODD_TEXTS,
    WIDE_INTEGERS,
    Malformed,
    Mutator,
    columns,
    integer,
    json_tree,
    one_of,
    raw,
    xml_tree,
)


class Part(NamedTuple):
    """A labelled part of a file, such as a chunk or a box."""

    tag: bytes
    data: bytes


Split = Callable[[bytes], tuple[bytes, list[Part], bytes]]
"""Divides a file into what comes before the parts, the parts, and the rest."""
Join = Callable[[Part, int], bytes]
"""Writes a part whose stated length is off by a number of bytes (0 in most cases)."""


def parts_of(split: Split, join: Join, inner: Callable[[bytes], Mutator | None]) -> Mutator:
    """Return a mutator of a sequence of parts.

    `inner` gives the mutator of the content of a part by its tag; None for any bytes.
    """

    def mutate(data: bytes, rng: random.Random) -> bytes:
        before, parts, rest = split(data)
        if not parts:
            raise Malformed
        at, off = rng.randrange(len(parts)), {}
        part = parts[at]
        match rng.randrange(10):
            case 0:
                del parts[at]
            case 1:
                parts[at:at] = [part] * rng.choice((1, 2, 100))
            case 2:
                other = rng.randrange(len(parts))
                parts[at], parts[other] = parts[other], parts[at]
            case 3:
                parts[at] = part._replace(
                    tag=rng.choice((rng.choice(parts).tag, rng.randbytes(len(part.tag))))
                )
            case 4:
                off[at] = rng.choice((*WIDE_INTEGERS, -1, -4, 5))
            case _:
                parts[at] = part._replace(data=(inner(part.tag) or raw)(part.data, rng))
        try:
            written = [join(part, off.get(i, 0)) for i, part in enumerate(parts)]
        except (struct.error, OverflowError):
            raise Malformed from None
        return b"".join([before, *written, rest])

    return mutate


def split_by(head: Callable[[bytes, int], tuple[int, bytes, int, int]], start: int) -> Split:
    """Return the splitter of a format whose ``head(data, at)`` gives the lengths of a part.

    The four values are length of the header, tag, length of the data, and length of the trailer.
    """

    def split(data: bytes) -> tuple[bytes, list[Part], bytes]:
        parts, at = list[Part](), start
        while at < len(data):
            try:
                header, tag, size, trailer = head(data, at)
            except (struct.error, IndexError):
                break
            if at + header + size > len(data):
                break
            parts.append(Part(tag, data[at + header : at + header + size]))
            at += header + size + trailer
        return data[:start], parts, data[at:]

    return split


# -- PNG, GLB, RIFF ----------------------------------------------------------------------------------------


def _png_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    size, tag = struct.unpack_from(">I4s", data, at)
    return 8, tag, size, 4


def _png_part(part: Part, off: int) -> bytes:
    check = zlib.crc32(part.tag + part.data)
    return (
        struct.pack(">I4s", (len(part.data) + off) & 0xFFFFFFFF, part.tag)
        + part.data
        + struct.pack(">I", check)
    )


def _deflated(data: bytes, rng: random.Random) -> bytes:
    """Change what a zlib stream holds."""
    try:
        return zlib.compress(raw(zlib.decompress(data), rng))
    except zlib.error:
        return raw(data, rng)


def _words(data: bytes, rng: random.Random, order: str = ">") -> bytes:
    """Set one of the 32-bit words of a table."""
    at = 4 * rng.randrange(max(len(data) // 4, 1))
    return data[:at] + struct.pack(order + "I", rng.choice(ODD_INTEGERS)) + data[at + 4 :]


png = parts_of(split_by(_png_head, 8), _png_part, {b"IDAT": _deflated, b"IHDR": one_of(raw, _words)}.get)


def _glb_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    size, tag = struct.unpack_from("<I4s", data, at)
    return 8, tag, size, 0


def _glb_part(part: Part, off: int) -> bytes:
    fill = b" " if part.tag == b"JSON" else b"\0"
    data = part.data + fill * (-len(part.data) % 4)
    return struct.pack("<I4s", (len(data) + off) & 0xFFFFFFFF, part.tag) + data


_glb_parts = parts_of(split_by(_glb_head, 12), _glb_part, {b"JSON": json_tree}.get)


def glb(data: bytes, rng: random.Random) -> bytes:
    """Change a chunk of a GLB; the length of the file holds, nine times of ten."""
    out = _glb_parts(data, rng)
    return out if rng.random() < 0.1 else out[:8] + struct.pack("<I", len(out)) + out[12:]


# -- MP4 and Matroska --------------------------------------------------------------------------------------


def _box_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    size, tag = struct.unpack_from(">I4s", data, at)
    if size < 8:
        raise IndexError
    return 8, tag, size - 8, 0


def _box(part: Part, off: int) -> bytes:
    return struct.pack(">I4s", (8 + len(part.data) + off) & 0xFFFFFFFF, part.tag) + part.data


def boxes(data: bytes, rng: random.Random) -> bytes:
    """Change a box of an MP4, or one that it contains."""
    return _boxes(data, rng)


_NESTED: Final = frozenset((b"moov", b"trak", b"mdia", b"minf", b"stbl", b"edts", b"mvex", b"moof", b"traf"))
_box_content: Final = one_of(raw, _words, _words)
_boxes = parts_of(split_by(_box_head, 0), _box, lambda tag: boxes if tag in _NESTED else _box_content)


def _element_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    """Lengths of an EBML element."""
    tag_bytes = 9 - data[at].bit_length()
    first = data[at + tag_bytes]
    size_bytes = 9 - first.bit_length()
    value = int.from_bytes(data[at + tag_bytes : at + tag_bytes + size_bytes], "big")
    size = value & ((1 << 7 * size_bytes) - 1)
    return tag_bytes + size_bytes, data[at : at + tag_bytes], size, 0


def _element(part: Part, off: int) -> bytes:
    size = (len(part.data) + off) & ((1 << 56) - 1)
    return part.tag + (1 << 56 | size).to_bytes(8, "big") + part.data


def elements(data: bytes, rng: random.Random) -> bytes:
    """Change an element of a Matroska file, or one that it contains."""
    return _elements(data, rng)


_MASTERS: Final = frozenset(
    bytes.fromhex(text)
    for text in ("18538067", "1549A966", "1654AE6B", "AE", "1F43B675", "A0", "1941A469", "61A7", "1A45DFA3")
)
_elements = parts_of(split_by(_element_head, 0), _element, lambda tag: elements if tag in _MASTERS else None)


# -- packets and records -----------------------------------------------------------------------------------


def packets(data: bytes, rng: random.Random, size: int = 188) -> bytes:
    """Change, drop, repeat or exchange packets of MPEG-TS."""
    each = [data[at : at + size] for at in range(0, len(data), size)]
    if not each:
        return data
    at = rng.randrange(len(each))
    match rng.randrange(6):
        case 0:
            del each[at]
        case 1:
            each[at:at] = [each[at]] * rng.choice((1, 20))
        case 2:
            other = rng.randrange(len(each))
            each[at], each[other] = each[other], each[at]
        case 3:
            each[at] = each[at][: rng.randrange(1, size)]
        case 4:  # header, adaptation field and PES header
            head = bytearray(each[at])
            head[rng.randrange(1, 30) % len(head)] = rng.choice(
                (0, 1, 0x47, 0x80, 0xB7, 0xFF, rng.randrange(256))
            )
            each[at] = bytes(head)
        case _:
            each[at] = raw(each[at], rng)
    return b"".join(each)


def _record_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    tag, size = struct.unpack_from("<cQ", data, at)
    return 9, tag, size, 0


def _record(part: Part, off: int) -> bytes:
    return part.tag + struct.pack("<Q", (len(part.data) + off) & ((1 << 64) - 1)) + part.data


def _chunk(data: bytes, rng: random.Random) -> bytes:
    """Change the records in a chunk of MCAP without compression; its check is left out."""
    try:
        name_bytes = struct.unpack_from("<I", data, 28)[0]
        start = 32 + name_bytes + 8
        if data[32 : 32 + name_bytes]:
            return raw(data, rng)
        inner = _mcap_records(data[start:], rng)
    except struct.error:
        raise Malformed from None
    head = data[:16] + struct.pack("<QI", len(inner), 0) + data[28 : start - 8]
    return head + struct.pack("<Q", len(inner)) + inner


_text_or_words = one_of(raw, _words, lambda data, rng: columns(data, rng))
_RECORD_KINDS: Final[dict[bytes, Mutator]] = {
    b"\x06": _chunk,
    b"\x03": _text_or_words,
    b"\x04": _text_or_words,
}
_mcap_records = parts_of(split_by(_record_head, 0), _record, _RECORD_KINDS.get)
mcap = parts_of(split_by(_record_head, 8), _record, _RECORD_KINDS.get)


def _bag_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    (header,) = struct.unpack_from("<I", data, at)
    (size,) = struct.unpack_from("<I", data, at + 4 + header)
    return 4, b"", 4 + header + size, 0


def _bag_record(data: bytes, rng: random.Random) -> bytes:
    """Change a field of the header, the data, or the records in the data of a record of ROS 1."""
    header, _ = _bag_sizes(data)
    head, content = data[:header], data[header + 4 :]
    if rng.random() < 0.5:
        head = one_of(raw, lambda part, r: _words(part, r, "<"))(head, rng)
    else:
        content = one_of(raw, lambda part, r: bag_records(part, r))(content, rng)
    return head + struct.pack("<I", len(content) & 0xFFFFFFFF) + content


def _bag_sizes(data: bytes) -> tuple[int, int]:
    """Find where the header of a record ends: its fields have their lengths before them."""
    at = 0
    while at + 4 <= len(data):
        (size,) = struct.unpack_from("<I", data, at)
        if b"=" not in data[at + 4 : at + 4 + size]:
            return at, size
        at += 4 + size
    raise Malformed


def _bag_join(part: Part, off: int) -> bytes:
    header, _ = _bag_sizes(part.data)
    return struct.pack("<I", (header + off) & 0xFFFFFFFF) + part.data


bag_records = parts_of(split_by(_bag_head, 0), _bag_join, lambda tag: _bag_record)
bag = parts_of(split_by(_bag_head, 13), _bag_join, lambda tag: _bag_record)


def _unit_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    """Lengths of a unit of HMPG: 72 bits, of which bits 36 to 67 are the length."""
    bits = int.from_bytes(data[at : at + 9], "big")
    return 9, data[at : at + 9], (bits >> 4) & 0xFFFFFFFF, 0


def _unit(part: Part, off: int) -> bytes:
    bits = int.from_bytes(part.tag, "big") & ~(0xFFFFFFFF << 4)
    return (bits | ((len(part.data) + off) & 0xFFFFFFFF) << 4).to_bytes(9, "big") + part.data


def _packet_head(data: bytes, at: int) -> tuple[int, bytes, int, int]:
    bits = int.from_bytes(data[at : at + 3], "big")
    return 3, data[at : at + 3], (bits >> 1) & 0x1FFFF, 0


def _packet(part: Part, off: int) -> bytes:
    bits = int.from_bytes(part.tag, "big") & ~(0x1FFFF << 1)
    return (bits | ((len(part.data) + off) & 0x1FFFF) << 1).to_bytes(3, "big") + part.data


def hmpg(content: Mutator) -> Mutator:
    """Return the mutator of units and their packets; `content` changes what a packet holds."""
    inner = parts_of(split_by(_packet_head, 0), _packet, lambda tag: content)
    return parts_of(split_by(_unit_head, 0), _unit, lambda tag: inner)


# -- tables, arrays, archives ------------------------------------------------------------------------------


def tiff(data: bytes, rng: random.Random) -> bytes:
    """Change an entry of a directory of a classic TIFF: tag, type, count, or value."""
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None or len(data) < 16:
        raise Malformed
    starts, at = list[int](), struct.unpack_from(order + "I", data, 4)[0]
    while at and at + 2 <= len(data) and len(starts) < 99:
        starts.append(at)
        (count,) = struct.unpack_from(order + "H", data, at)
        if at + 6 + 12 * count > len(data):
            break
        at = struct.unpack_from(order + "I", data, at + 2 + 12 * count)[0]
    if not starts:
        raise Malformed
    out, start = bytearray(data), rng.choice(starts)
    count = struct.unpack_from(order + "H", data, start)[0]
    entry = start + 2 + 12 * rng.randrange(count or 1)
    where, form = rng.choice(
        ((entry, "H"), (entry + 2, "H"), (entry + 4, "I"), (entry + 8, "I"), (start, "H"))
    )
    width = struct.calcsize(form)
    if where + width > len(out):
        raise Malformed
    value = rng.choice((*ODD_INTEGERS, *range(1, 18), len(data), start)) & ((1 << 8 * width) - 1)
    struct.pack_into(order + form, out, where, value)
    return bytes(out)


_SHAPES: Final = (
    "()",
    "(0,)",
    "(1,)",
    "(-1,)",
    "(1000000000000,)",
    "(3, 3)",
    "(2, 3, 4, 5, 6)",
    "(99999999,)",
)
_TYPES: Final = ("<f8", ">f4", "<i2", "|u1", "|O", "<U9", "|S3", "<c16", "<M8[ns]", "|V0", "|b1", "<f2", "x")


def npy(data: bytes, rng: random.Random) -> bytes:
    """Change the header of an array, or its values."""
    if data[:6] != b"\x93NUMPY" or len(data) < 12:
        raise Malformed
    size = struct.unpack_from("<H", data, 8)[0]
    header, values = data[10 : 10 + size].decode("latin-1"), data[10 + size :]
    match rng.randrange(5):
        case 0:
            header = re.sub(r"\([^)]*\)", lambda _: rng.choice(_SHAPES), header)
        case 1:
            header = re.sub(r"'descr': '[^']*'", lambda _: f"'descr': '{rng.choice(_TYPES)}'", header)
        case 2:
            header = columns(header.encode("latin-1"), rng).decode("latin-1")
        case 3:
            kind = rng.choice(("<f8", "<f4", "<i4", "<u2"))
            array = np.frombuffer(values[: len(values) // 8 * 8], kind).copy()
            if len(array):
                limits = np.iinfo(kind) if kind[1] != "f" else np.finfo(kind)
                odd = [0, 1, limits.max, limits.min, *([np.nan, np.inf] if kind[1] == "f" else [])]
                array[rng.randrange(len(array)) :: rng.choice((1, 7, 10**6))] = rng.choice(odd)
            values = array.tobytes() + values[len(values) // 8 * 8 :]
        case _:
            values = rng.choice((values[: rng.randrange(len(values) + 1)], values * 2, raw(values, rng)))
    text = header.encode("latin-1")[:65000]
    return data[:8] + struct.pack("<H", len(text)) + text + values


def archive(inner: Callable[[str], Mutator]) -> Mutator:
    """Return the mutator of a zip; `inner` gives the mutator of a member by its name."""

    def mutate(data: bytes, rng: random.Random) -> bytes:
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as source:
                members = [(item.filename, source.read(item)) for item in source.infolist()]
        except Exception:  # as of a damaged archive
            raise Malformed from None
        if not members:
            raise Malformed
        at = rng.randrange(len(members))
        name, content = members[at]
        match rng.randrange(9):
            case 0:
                del members[at]
            case 1:
                members.append((name, rng.choice(members)[1]))
            case 2:
                members[at] = (rng.choice((*ODD_TEXTS, *(name for name, _ in members)))[:60000], content)
            case 3 if rng.random() < 0.1:
                members[at] = (name, content[:200] + bytes(1 << 24))  # a small archive of many bytes
            case _:
                members[at] = (name, inner(name)(content, rng))
        return _zipped(members, rng)

    return mutate


def _zipped(members: list[tuple[str, bytes]], rng: random.Random) -> bytes:
    file = io.BytesIO()
    method = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA))
    try:
        with warnings.catch_warnings(), zipfile.ZipFile(file, "w", method) as target:
            warnings.simplefilter("ignore")  # two members of one name
            for name, content in members:
                target.writestr(zipfile.ZipInfo(name.replace("\ud800", "?") or "x"), content, method)
    except (ValueError, UnicodeError, struct.error):
        raise Malformed from None
    data = file.getvalue()
    return _directory(data, rng) if rng.random() < 0.1 else data


def _directory(data: bytes, rng: random.Random) -> bytes:
    """Change a field of the central directory of a zip, where sizes, flags and offsets are."""
    at = data.rfind(b"PK\x01\x02")
    if at < 0:
        raise Malformed
    where, width = rng.choice(((8, 2), (10, 2), (16, 4), (20, 4), (24, 4), (28, 2), (42, 4)))
    return data[: at + where] + integer(rng, width, "little") + data[at + where + width :]


# -- E57 ---------------------------------------------------------------------------------------------------

_CRC32C: Final = [0] * 256
for _n in range(256):
    _c = _n
    for _ in range(8):
        _c = _c >> 1 ^ (0x82F63B78 if _c & 1 else 0)
    _CRC32C[_n] = _c


def _crc32c(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC32C[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


def e57(data: bytes, rng: random.Random, page: int = 1024) -> bytes:
    """Change the content of the pages of an E57, or words of its XML of the same length; the checks hold."""
    pages = [data[at : at + page - 4] for at in range(0, len(data), page)]
    if len(pages[-1]) != page - 4:
        raise Malformed
    whole, before = b"".join(pages), pages
    start = whole.find(b"<?xml")
    if rng.random() < 0.7 and start >= 0:
        changed = whole[:start] + columns(whole[start:], rng)
    else:
        at = rng.choice((0, rng.randrange(len(whole))))
        changed = whole[:at] + raw(whole[at : at + 64], rng)[:64].ljust(64, b"\0") + whole[at + 64 :]
    changed = changed[: len(whole)].ljust(len(whole), b" ")
    out = list[bytes]()
    for i, old in enumerate(before):
        new = changed[i * (page - 4) : (i + 1) * (page - 4)]
        check = data[(i + 1) * page - 4 : (i + 1) * page] if new == old else struct.pack(">I", _crc32c(new))
        out.append(new + check)
    return b"".join(out)


__all__ = [
    "archive",
    "bag",
    "boxes",
    "e57",
    "elements",
    "glb",
    "hmpg",
    "mcap",
    "npy",
    "packets",
    "parts_of",
    "png",
    "tiff",
    "xml_tree",
]
