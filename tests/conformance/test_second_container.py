"""docs/format/container.md is enough: the second decoder reads what the package writes, and refuses what it
does.
"""

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


def ours(data: bytes) -> Any:
    """All that the package reads: the fields of HEAD and OBJT, and the segments."""
    with TouchReader(io.BytesIO(data)) as reader:
        objects = [vars(reader.read_object(i)) for i in range(reader.object_count)]
        count = range(len(reader.segments))
        told = [
            (reader.segments[i].frame_count, reader.read_segment(i), reader.read_vibration(i)) for i in count
        ]
        return vars(reader.head), objects, told


def outcome(read: Any, data: bytes, refusal: type[Exception]) -> Any:
    """What a reader says, or None where it refuses the bytes."""
    try:
        return tuple(read(data))
    except refusal:
        return None


def both(data: bytes) -> tuple[Any, Any]:
    return outcome(ours, data, FormatError), outcome(decoder.read_file, data, reading.FaultyFile)


@given(data=st.data())
def test_the_same_content(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    bodies = data.draw(
        st.lists(st.tuples(st.integers(1, 65535), st.binary(), st.none() | st.binary()), min_size=1)
    )
    objects = data.draw(st.lists(allowed(Struct(ObjectRecord)), max_size=3))
    head = data.draw(heads(frame_count=sum(count for count, _, _ in bodies)))
    head = dataclasses.replace(head, coder=OBJECTS_CODER if objects else "touch")
    path, first = tmp_path_factory.mktemp("files") / "a.touch", 0
    with TouchWriter(path) as writer:
        writer.write_head(head, {"source": "größer als nichts"})
        for one in objects:
            writer.write_object(one)
        for count, body, vibration in bodies:
            if vibration is not None:
                writer.write_vibration(first, count, vibration)
            writer.write_segment(first, count, body)
            first += count
    mine, second = both(path.read_bytes())
    assert mine == second is not None


@given(
    changes=st.lists(st.tuples(st.integers(0, len(EXAMPLE) - 1), st.integers(0, 255)), min_size=1, max_size=4)
)
def test_changed_bytes(changes: list[tuple[int, int]]) -> None:
    damaged = bytearray(EXAMPLE)
    for place, value in changes:
        damaged[place] = value
    mine, second = both(bytes(damaged))
    assert mine == second and (mine is None or damaged == EXAMPLE)


HEAD = EXAMPLE[14 : EXAMPLE.index(b"PROV")]
MIDDLE = EXAMPLE[EXAMPLE.index(b"PROV") : EXAMPLE.index(b"INDX")]
INDEX = EXAMPLE[EXAMPLE.index(b"INDX") : EXAMPLE.index(b"TEND")]


@given(data=st.data())
def test_changed_fields_behind_a_crc_that_holds(data: st.DataObject) -> None:
    payload = bytearray(HEAD[16:-4])
    for _ in range(data.draw(st.integers(1, 3))):
        begin = data.draw(st.integers(0, len(payload)))
        put = data.draw(st.binary(max_size=4))
        payload[begin : begin + len(put)] = put
    mine, second = both(assembled(framed("HEAD", bytes(payload)), MIDDLE, INDEX))
    assert mine == second


def test_the_example_again() -> None:
    assert assembled(HEAD, MIDDLE, INDEX) == EXAMPLE and EXAMPLE.startswith(OPENING)
    assert encoded("HEAD", TouchReader(io.BytesIO(EXAMPLE)).head) == HEAD


def test_the_command_line_needs_nothing_of_the_package(tmp_path: Path) -> None:
    (tmp_path / "a.touch").write_bytes(EXAMPLE)
    blocked = "import sys, runpy; sys.modules['touchfield'] = sys.modules['numba'] = None; "
    arguments = [str(tmp_path / "a.touch"), str(tmp_path / "a.npz")]
    place = f"sys.path.insert(0, {str(CONFORMANCE)!r}); sys.argv[1:] = {arguments!r}; "
    code = f"{blocked}{place}runpy.run_path({str(CONFORMANCE / 'decoder.py')!r}, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and "UnsupportedVersion: the coder 'example'" in done.stderr
