"""docs/format: its tables agree with the code, its example is a valid file, and its links exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from container_strategies import example_file
from touchfield.container.fields import FieldType, Listed
from touchfield.container.map_record import LAYOUTS
from touchfield.container.records import (
    MAX_BRICKS,
    MAX_OBJECTS,
    RECORDS,
    Pair,
    Record,
    SegmentEntry,
    Struct,
    rows_of,
)

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "format"
CONTAINER = (FOLDER / "container.md").read_text(encoding="utf-8")
CHAPTERS = ("container.md", "bits.md", "paper.md", "touch.md", "objects.md", "vibration.md", "maps.md")


def type_and_bounds(kind: FieldType) -> tuple[str, str]:
    """Type and bounds of a field as the document prints them."""
    if isinstance(kind, Listed) and isinstance(kind.of, Struct):
        return f"list ({kind.code}), below", f"at most {kind.limit}"
    return kind.wire, kind.bounds


def table(layout: type) -> str:
    """The rows of a layout as the document prints them."""
    lines = ["| field | type | bounds | unit | meaning |", "|---|---|---|---|---|"]
    for row in rows_of(layout):
        wire, bounds = type_and_bounds(row.kind)
        lines.append(f"| `{row.name}` | {wire} | {bounds} | {row.unit} | {row.meaning} |")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("layout", [*(record.layout for record in RECORDS), Pair, SegmentEntry])
def test_tables(layout: type) -> None:
    assert table(layout) in CONTAINER


@pytest.mark.parametrize("layout", LAYOUTS)
def test_tables_of_maps(layout: type) -> None:
    assert table(layout) in (FOLDER / "maps.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.tag)
def test_headings(record: Record) -> None:
    needed = "required" if record.required else "optional"
    assert f"### {record.tag}\n{record.layout.__doc__} Stands {record.position}; {needed}.\n" in CONTAINER


def test_numbers() -> None:
    assert f"{MAX_OBJECTS} OBJT" in CONTAINER and f"2^{MAX_BRICKS.bit_length() - 1} bricks" in CONTAINER


def test_worked_example_is_a_valid_file() -> None:
    lines = CONTAINER.split("```text\n")[1].split("```")[0].splitlines()
    printed = [(int(line[:5]), bytes.fromhex(line[7:54])) for line in lines if re.match(r" *\d+  ", line)]
    assert b"".join(data for _, data in printed) == example_file()
    offset = 0
    for printed_offset, data in printed:
        assert printed_offset == offset
        offset += len(data)


def test_chapters_exist_and_are_linked() -> None:
    readme = (FOLDER / "README.md").read_text(encoding="utf-8")
    for name in CHAPTERS:
        assert f"]({name})" in readme
    assert CHAPTERS and set(CHAPTERS) <= {path.name for path in FOLDER.glob("*.md")}
    for path in FOLDER.glob("*.md"):
        for link in re.findall(r"\]\((?!http)([^)#]+)", path.read_text(encoding="utf-8")):
            assert (path.parent / link).exists() or link in CHAPTERS, f"{path.name}: {link}"
