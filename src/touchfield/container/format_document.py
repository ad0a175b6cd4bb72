"""Writes docs/format.md, the description of ``.touch`` for whoever writes a second decoder, from the table.

``python -m touchfield.container.format_document`` writes it, ``--print`` prints it, ``--check`` compares. The
chapters of the coders come from the modules in `CHAPTERS`, each of which holds a string ``CHAPTER``.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from touchfield.container.fields import Listed
from touchfield.container.format_example import example_file, explained
from touchfield.container.layout import Struct, rows_of
from touchfield.container.reader import END_SIZE, MIN_SEGMENT
from touchfield.container.records import (
    MAGIC,
    MAX_OBJECTS,
    OBJECTS_CODER,
    RECORD_OF,
    RECORDS,
    VERSION_MAJOR,
    VERSION_MINOR,
    Frame,
    Opening,
    Record,
)
from touchfield.container.wire import CRC_SIZE, FRAME_SIZE, OPENING_SIZE
from touchfield.errors import InvalidArgument, TouchfieldError
from touchfield.medium.atomic import atomic_path

__all__ = ["CHAPTERS", "main", "render"]

CHAPTERS: Final = (
    "touchfield.codec.objects_format",
    "touchfield.codec.touch.chapters",
    "touchfield.codec.vibration",
)
"""Modules whose string ``CHAPTER`` describes what the table takes as bytes: the segment bodies of one coder, or of
VIBR; one that is missing is left out."""

DOCUMENT: Final = Path(__file__).resolve().parents[3] / "docs" / "format.md"

INTRODUCTION: Final = f"""\
# The `.touch` format, version {VERSION_MAJOR}.{VERSION_MINOR}

<!-- Written by `python -m touchfield.container.format_document` from the table in
src/touchfield/container/records.py; change that, not this. -->

A `.touch` file holds a passive haptic medium: a force field over time, W_t: R³ → R³, made for one device.
This document is enough to write a decoder of the container; the bodies of the segments belong to the coder
that HEAD names, and each coder has its own chapter at the end.

Until version 1.0 a new minor version may bring records that an older reader refuses; it says so by name.

## Conventions

- All numbers are little-endian. `u8`, `u16`, `u32`, `u64` are whole numbers without sign; `f32` and `f64` are
  IEEE 754 binary32 and binary64. A number that is not finite is never valid.
- `str` is its length in bytes as `u16`, then that many bytes of UTF-8. `bytes` is a `u32` length, then the bytes.
- `n × type` is n values one after the other; there is never padding.
- `list` is the number of its members, then the members.
- CRC-32 is that of zlib, PNG and gzip (reflected polynomial 0xEDB88320, initial value and final XOR 0xFFFFFFFF):
  the CRC-32 of the nine ASCII characters `123456789` is 0xCBF43926.
- Every bound below is a promise of the writer; a reader refuses a file that breaks one. A reader compares each
  length with the bytes that are left before it allocates anything for it.
- Lengths are metres, forces newtons, times seconds.

## The file

| offset | bytes | what |
|---|---|---|
| 0 | {len(MAGIC)} | magic: `{MAGIC.hex(" ")}` |
| {len(MAGIC)} | {OPENING_SIZE - len(MAGIC)} | the opening, below |
| {OPENING_SIZE} | | records, one after the other, to the end of the file |

As in PNG, the magic has a byte above 127, and line ends and an end-of-file mark that a transfer as text changes.
"""

FRAME_TEXT: Final = f"""\
## Every record

| offset in the record | bytes | what |
|---|---|---|
| 0 | {FRAME_SIZE} | the frame, below |
| {FRAME_SIZE} | `payload_length` | payload |
| {FRAME_SIZE} + `payload_length` | {CRC_SIZE} | `u32`: CRC-32 of the record before it: frame and payload |

A record is {FRAME_SIZE + CRC_SIZE} bytes longer than its payload. Its fields fill the payload exactly.
"""


def minor(tag: str) -> int:
    """The minor version that brought a record."""
    return RECORD_OF[tag].since_minor


RULES: Final = f"""\
## Order, and what a reader does

HEAD, PROV, OBJT, ..., OBJT, VIBR, SEGM, ..., VIBR, SEGM, INDX, TEND. TEND is always the last {END_SIZE} bytes of the
file, and its payload stays the same in all versions {VERSION_MAJOR}.x.

1. Read the first {OPENING_SIZE} bytes: magic and version. Refuse a `version_major` above your own.
2. Read HEAD at byte {OPENING_SIZE}.
3. Read TEND from the last {END_SIZE} bytes. Without it the file was cut. If `file_length` is not the length of the
   file, it was joined to another.
4. Read INDX at `index_offset`, go from HEAD to the first SEGM by the lengths of the records for the OBJT if
   there are any, and compare `chain_crc32`.
5. Read any segment at its `offset`: its length, CRC-32, `first_frame` and `frame_count` are those of its entry.
6. Where there is a VIBR between a SEGM and the SEGM before it (or HEAD), its `first_frame` and `frame_count` are
   those of that SEGM. It is needed for nothing else, and a reader that renders no vibration skips it.

Records with other tags may stand anywhere between HEAD and TEND. A reader goes through those by their lengths,
checks their CRC-32, skips those whose flags have bit 0 clear, and refuses the file at one that has it set: its
`since_minor` is the minor version of the reader that is needed. The same holds for a record of a known tag whose
`since_minor` is above the reader's own version. A HEAD, PROV, OBJT, VIBR, SEGM, INDX or TEND in another place
than those named here makes the file invalid; so does a SEGM that INDX does not name. PROV and the OBJT may stand
in any order before the first SEGM. A file of coder `{OBJECTS_CODER}` has 1 to {MAX_OBJECTS} OBJT; any other file has
none.

`version_minor` of the opening is {minor("VIBR")} in a file with VIBR, otherwise {minor("OBJT")} in one with OBJT, and
otherwise 0.

The smallest SEGM record has {MIN_SEGMENT} bytes. Frame i shows at i / `rate_hz` seconds, for 1 / `rate_hz` seconds.
"""


EXAMPLE_TEXT: Final = """\
## A whole file, byte by byte

Three frames in two segments, of a coder that is called `example`; the bodies are made up. Positions are decimal,
bytes hexadecimal.
"""


def table(layout: type) -> str:
    """The rows of `layout` as a table, with offsets as long as they are fixed, and the tables of its lists."""
    lines = ["| offset | bytes | field | type | unit | bounds | meaning |", "|---|---|---|---|---|---|---|"]
    offset: int | None = 0
    inner = ""
    for row in rows_of(layout):
        kind = row.kind
        fixed = kind.smallest == kind.largest
        size = str(kind.smallest) if fixed else f"{kind.smallest} or more"
        wire, bounds = kind.wire, kind.bounds
        if isinstance(kind, Listed) and isinstance(kind.of, Struct):
            member = kind.of.layout
            wire, bounds = f"list: {kind.code} count, then each: {member.__name__}, below", f"at most {kind.limit}"
            inner += f"\n{member.__name__}: {summary(member)}\n\n{table(member)}"
        place = "" if offset is None else offset
        lines.append(f"| {place} | {size} | `{row.name}` | {wire} | {row.unit} | {bounds} | {row.meaning} |")
        offset = offset + kind.smallest if offset is not None and fixed else None
    return "\n".join(lines) + "\n" + inner


def summary(layout: type) -> str:
    """The first line of a layout's docstring."""
    return (layout.__doc__ or "").splitlines()[0]


def record_chapter(record: Record) -> str:
    """The chapter of one record."""
    flags = "required (flags 1)" if record.required else "optional (flags 0)"
    status = f"Stands {record.place}; {flags}; `since_minor` {record.since_minor}."
    return f"## {record.tag}: {record.layout.__name__}\n\n{summary(record.layout)} {status}\n\n{table(record.layout)}"


def coder_chapters() -> list[str]:
    """What the coders say about the bodies of their segments."""
    present = [name for name in CHAPTERS if find_spec(name) is not None]
    return [import_module(name).CHAPTER.strip() + "\n" for name in present]


def render() -> str:
    """The whole document."""
    chapters = [
        INTRODUCTION + "\n" + table(Opening),
        FRAME_TEXT + "\n" + table(Frame),
        *(record_chapter(record) for record in RECORDS),
        RULES,
        EXAMPLE_TEXT + f"\n```text\n{explained(example_file())}\n```\n",
        *coder_chapters(),
    ]
    return "\n".join(chapters)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write, print or check the document; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m touchfield.container.format_document", description=__doc__)
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--print", action="store_true", help="print it instead of writing it")
    what.add_argument("--check", action="store_true", help="fail unless the file is what would be written")
    parser.add_argument("--path", type=Path, default=DOCUMENT, help="the file (docs/format.md of the checkout)")
    asked = parser.parse_args(arguments)
    text = render()
    if asked.print:
        sys.stdout.write(text)
        return 0
    if not asked.path.parent.is_dir():
        raise InvalidArgument("--path", f"no folder {asked.path.parent}", mend="Name the file with --path.")
    if not asked.check:
        with atomic_path(asked.path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
        return 0
    if asked.path.is_file() and asked.path.read_text(encoding="utf-8") == text:
        return 0
    print(f"{asked.path} is out of date; write it with: python -m touchfield.container.format_document")
    return 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except TouchfieldError as error:
        print(error, file=sys.stderr)
        sys.exit(error.exit_code)
