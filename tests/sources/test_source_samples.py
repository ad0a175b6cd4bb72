"""The samples on docs/sources.md are those of the corpus, and each is read; each wrong input has a fix."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import room_makers as room
import source_page
from source_corpus import CORPUS, Input
from source_trial import CONVERSIONS, try_input
from touchfield.cli.main import _exit_code
from touchfield.errors import MissingExtra, SourceError
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import kinds, open_source

LAYOUTS = [entry for entry in CORPUS if entry.is_layout and entry.command == "encode"]
READ = [entry for entry in LAYOUTS if not entry.is_foreign]
FOREIGN = [entry for entry in LAYOUTS if entry.is_foreign]


def written(entry: Input, folder: Path) -> Path:
    for name in entry.needs:
        pytest.importorskip(name)
    return entry.write(folder)


def options_of(entry: Input) -> SourceOptions:
    """The options of the command that belong to the source."""
    stated = dict(zip(entry.options[::2], entry.options[1::2]))
    names = {"--depth-scale": float, "--cell-size-m": float, "--height-scale": float, "--intrinsics": str}
    found = {key[2:].replace("-", "_"): kind(stated[key]) for key, kind in names.items() if key in stated}
    return SourceOptions(**found)


def test_the_page_has_the_files_that_the_writers_write(tmp_path: Path) -> None:
    for entry in CORPUS:
        for name in entry.needs if entry.is_layout else ():
            pytest.importorskip(name)
    assert source_page.PAGE.read_text() == source_page.page(tmp_path), "run python tests/source_page.py"


def test_every_kind_of_source_has_a_sample(tmp_path: Path) -> None:
    """Kinds that need another file beside a picture or are named by option are tested elsewhere."""
    found = set()
    for i, entry in enumerate(READ):
        if entry.is_available:
            path = entry.write(tmp_path / str(i))
            found.add(next(kind for kind in kinds() if kind.recognise(path)).name)
    assert {kind.name for kind in kinds()} - found <= {"relative-depth"}


@pytest.mark.parametrize("entry", READ, ids=[entry.name for entry in READ])
def test_each_layout_on_the_page_is_read(tmp_path: Path, entry: Input) -> None:
    scene = open_source(written(entry, tmp_path / "input"), options_of(entry))
    assert scene.frame_count >= 1
    if entry.kind.startswith("depth"):
        if scene.sequence.poses is not None:
            room.assert_room(scene.sequence, known=0.9)
        depth = scene.sequence.depth_m(0)
        assert abs(depth - room.depth_m(room.poses()[0]))[depth > 0].max() < 0.1


@pytest.mark.parametrize("entry", FOREIGN, ids=[entry.name for entry in FOREIGN])
def test_a_format_of_other_programs_is_read_or_comes_with_a_conversion(tmp_path: Path, entry: Input) -> None:
    path = written(entry, tmp_path / "input")
    try:
        is_read, message = open_source(path, options_of(entry)).frame_count >= 1, ""
    except (MissingExtra, SourceError) as error:
        is_read, message = False, str(error)
    assert is_read or "touchfield[" in message or re.search(rf"(?:{CONVERSIONS}): ", message), message


@pytest.mark.parametrize(
    "name", ["textbook", "cut npz", "cut gif", "cut gltf", "cut csv", "gif of uneven times"]
)
def test_the_fix_of_a_message_works(tmp_path: Path, name: str) -> None:
    entry = next(entry for entry in CORPUS if entry.name == name)
    for needed in entry.needs:
        pytest.importorskip(needed)
    outcome = try_input(entry, tmp_path, 4)
    assert outcome.is_right and outcome.text != "read", outcome


@pytest.mark.parametrize("name", ["map coordinates", "turning glb", "sparse morph", "height field"])
def test_what_was_right_stays_right(tmp_path: Path, name: str) -> None:
    """Far from the origin; a cubic spline of rotations; a sparse morph target; a field of heights in MJCF."""
    entry = next(entry for entry in CORPUS if entry.name == name)
    for needed in entry.needs:
        pytest.importorskip(needed)
    outcome = try_input(entry, tmp_path, 5)
    assert outcome.text == "read", outcome


@pytest.mark.thorough
@pytest.mark.parametrize("entry", CORPUS, ids=[entry.name for entry in CORPUS])
def test_each_input_goes_in_right_or_is_refused_with_a_fix(tmp_path: Path, entry: Input) -> None:
    for name in entry.needs:
        pytest.importorskip(name)
    outcome = try_input(entry, tmp_path, 5)
    assert outcome.is_right, f"{outcome.text}\n{outcome.message}"


def test_a_missing_camera_and_unit_are_named_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = next(entry for entry in CORPUS if entry.name == "textbook")
    source, out = entry.write(tmp_path / "input"), str(tmp_path / "o.touch")
    assert _exit_code(["encode", str(source), out]) != 0
    message = capsys.readouterr().err
    assert "--intrinsics fx,fy,cx,cy" in message and "--depth-scale" in message
    assert _exit_code(["encode", str(source), out, "--depth-scale", "1000"]) != 0
    assert "--depth-scale" not in capsys.readouterr().err
