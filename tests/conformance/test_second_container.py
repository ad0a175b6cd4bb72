"""The container decoder written from docs/format/container.md alone agrees with the package."""

from __future__ import annotations

import dataclasses
import io
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st
from second import CONFORMANCE, decoder, reading

from container_strategies import OPENING, allowed, assembled, encoded, example_file, framed, heads
from touchfield.container import ObjectRecord, TouchReader, TouchWriter
from touchfield.container.records import OBJECTS_CODER, Struct
from touchfield.errors import FormatError

EXAMPLE = example_file()


def read_with_package(data: bytes) -> Any:
    """Everything that the package reads: the fields of HEAD and OBJT, and the segments."""
    with TouchReader(io.BytesIO(data)) as reader:
        objects = [vars(reader.read_object(i)) for i in range(reader.object_count)]
        count = range(len(reader.segments))
        segments = [
            (reader.segments[i].frame_count, reader.read_segment(i), reader.read_vibration(i)) for i in count
        ]
        return vars(reader.head), objects, segments


def outcome(read: Any, data: bytes, refusal: type[Exception]) -> Any:
    """The result of a reader, or None if it refuses the bytes."""
    try:
        return tuple(read(data))
    except refusal:
        return None


def both(data: bytes) -> tuple[Any, Any]:
    return outcome(read_with_package, data, FormatError), outcome(decoder.read_file, data, reading.FaultyFile)


@given(data=st.data())
def test_both_readers_agree(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    bodies = data.draw(
        st.lists(st.tuples(st.integers(1, 65535), st.binary(), st.none() | st.binary()), min_size=1)
    )
    objects = data.draw(st.lists(allowed(Struct(ObjectRecord)), max_size=3))
    head = data.draw(heads(frame_count=sum(count for count, _, _ in bodies)))
    head = dataclasses.replace(head, coder=OBJECTS_CODER if objects else "touch")
    path, first = tmp_path_factory.mktemp("files") / "a.touch", 0
    with TouchWriter(path) as writer:
        writer.write_head(head, {"source": "größer als nichts"})
        for record in objects:
            writer.write_object(record)
        for count, body, vibration in bodies:
            if vibration is not None:
                writer.write_vibration(first, count, vibration)
            writer.write_segment(first, count, body)
            first += count
    found, expected = both(path.read_bytes())
    assert found == expected is not None


@given(
    changes=st.lists(st.tuples(st.integers(0, len(EXAMPLE) - 1), st.integers(0, 255)), min_size=1, max_size=4)
)
def test_changed_bytes(changes: list[tuple[int, int]]) -> None:
    damaged = bytearray(EXAMPLE)
    for index, value in changes:
        damaged[index] = value
    found, expected = both(bytes(damaged))
    assert found == expected and (found is None or damaged == EXAMPLE)


HEAD = EXAMPLE[14 : EXAMPLE.index(b"PROV")]
MIDDLE = EXAMPLE[EXAMPLE.index(b"PROV") : EXAMPLE.index(b"INDX")]
INDEX = EXAMPLE[EXAMPLE.index(b"INDX") : EXAMPLE.index(b"TEND")]


@given(data=st.data())
def test_changed_fields_with_a_valid_crc(data: st.DataObject) -> None:
    payload = bytearray(HEAD[16:-4])
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(payload)))
        replacement = data.draw(st.binary(max_size=4))
        payload[start : start + len(replacement)] = replacement
    found, expected = both(assembled(framed("HEAD", bytes(payload)), MIDDLE, INDEX))
    assert found == expected


def test_example_of_the_document() -> None:
    assert assembled(HEAD, MIDDLE, INDEX) == EXAMPLE and EXAMPLE.startswith(OPENING)
    assert encoded("HEAD", TouchReader(io.BytesIO(EXAMPLE)).head) == HEAD


def test_command_line_runs_without_the_package(tmp_path: Path) -> None:
    (tmp_path / "a.touch").write_bytes(EXAMPLE)
    blocked = "import sys, runpy; sys.modules['touchfield'] = sys.modules['numba'] = None; "
    arguments = [str(tmp_path / "a.touch"), str(tmp_path / "a.npz")]
    setup = f"sys.path.insert(0, {str(CONFORMANCE)!r}); sys.argv[1:] = {arguments!r}; "
    code = f"{blocked}{setup}runpy.run_path({str(CONFORMANCE / 'decoder.py')!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "UnsupportedVersion: the coder 'example'" in done.stderr
