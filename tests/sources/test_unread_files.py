"""Files that no source reads are refused by their extension, with a command that converts them."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from touchfield.errors import SourceError
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import kinds, open_source
from touchfield.sources.unread_files import _CONVERSIONS, READABLE


def message_of(path: Path, kind: str | None = None) -> str:
    with pytest.raises(SourceError) as caught:
        open_source(path, SourceOptions(kind=kind))
    return str(caught.value)


@pytest.mark.parametrize("ending", sorted(_CONVERSIONS))
def test_a_format_that_is_not_read_comes_with_its_conversion(tmp_path: Path, ending: str) -> None:
    """The command is split as a shell does, names the file and the result, and its Python compiles."""
    path = tmp_path / f"part.v2{ending}"
    path.write_bytes(b"something")
    text = message_of(path)
    _, _, fix = text.partition("Convert it: ")
    command, _, to = fix.partition(", then encode ")
    assert f"part.v2{ending}" in command and (to or "part.v2") in command
    for word in shlex.split(command):
        if word.startswith("import "):
            compile(word, "command", "exec")
    assert "height-map" not in text and "--as" not in text


def test_a_name_with_characters_of_a_shell_is_not_in_the_command(tmp_path: Path) -> None:
    path = tmp_path / "a$(touch x) b.amf"
    path.write_bytes(b"x")
    assert "trimesh.load('FILE.amf').export('FILE.glb')" in message_of(path)


def test_a_template_of_a_robot_comes_with_its_expansion(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf.xacro"
    path.write_text("<robot/>")
    assert "xacro arm.urdf.xacro -o arm.urdf, then encode arm.urdf" in message_of(path)


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("letter.docx", "the extension .docx, which is not read"),
        ("model.xml", "a file .xml whose contents are none of these"),
        ("noname", "a file without an extension"),
    ],
)
def test_any_other_file_is_answered_with_what_can_be_a_source(tmp_path: Path, name: str, found: str) -> None:
    (tmp_path / name).write_bytes(b"<other/>")
    text = message_of(tmp_path / name)
    assert f"found {found}; expected {READABLE}" in text


def test_every_extension_named_as_readable_belongs_to_a_kind() -> None:
    summaries = " ".join(kind.summary.lower() for kind in kinds())
    words = {"tif": "tiff", "stl": "stl", "touch": "", "npz": ".npz"}
    for ending in re.findall(r"\.([a-z0-9]+)", READABLE):
        assert words.get(ending, ending) in summaries, ending
