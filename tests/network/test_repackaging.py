"""Touch comes back in sync and to the byte from movies that other programs have copied."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from repackagers import MARKS, PAGE, REPACKAGERS, Repackager, repackage, write_movies

pytest.importorskip("av", reason="movies need the extra video")

DROPPED = {
    "ffmpeg -c copy", "gst-launch-1.0 qtdemux, mp4mux", "MP4Box -frag", ("mkvmerge", ".mp4"),
}  # fmt: skip
"""Programs that leave out tracks which they do not know: the sidecar is used."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("repackaging")
    write_movies(folder)
    return folder


@pytest.mark.parametrize("program", REPACKAGERS, ids=lambda p: f"{p.name}: {p.source} to {p.result}")
def test_a_copied_movie_has_its_touch_in_sync(program: Repackager, folder: Path) -> None:
    if shutil.which(program.program) is None:
        pytest.skip(f"there is no {program.program} here")
    kept = repackage(program, folder)
    is_dropped = program.name in DROPPED or (program.name, program.source) in DROPPED
    assert kept.where == ("in the sidecar" if is_dropped else "yes")
    assert kept.is_equal and abs(kept.error_ms) < 45  # one picture at 25 a second


def test_the_page_lists_every_program() -> None:
    text = PAGE.read_text("utf-8")
    lines = text[text.index(MARKS[0]) : text.index(MARKS[1])].splitlines()[3:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [(row[0], f".{row[1]}", f".{row[2]}") for row in cells] == [p[:3] for p in REPACKAGERS]
    assert all(row[5] == "yes" for row in cells)
