"""Errors of the system in every command: a nonzero exit code, one clear line, and no partial file."""

from __future__ import annotations

import errno
import os
import socket
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from test_every_option import TASKS

from map_makers import town, write_geojson
from option_tables import ARGUMENTS
from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import SourceError
from touchfield.files import readable
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene

SPHERE = '[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.05\n'

WRITING = {
    "encode": ("sphere.toml {out}.touch --nw 3",),
    "filter": ("sphere.touch {out}.touch --gaussian 2mm", "sphere.touch {out}.npz --gaussian 2mm"),
    "field": (
        "sphere.toml {out}.npz --nw 3",
        "sphere.toml {out}.vti --nw 3",
        "sphere.toml --preview {out}.png --nw 3",
    ),
    "plan": ("sphere.toml --budget 60kB --nw 3 --plot {out}.png",),
    "decode": ("sphere.touch {out}.npz", "sphere.touch {out}.vti"),
    "export": (
        "sphere.touch {out}.wav --trajectory hand.csv",
        "sphere.touch {out}.hjif --trajectory hand.csv",
        "sphere.touch {out}.html",
    ),
    "map": (
        "town.geojson {out}.touch --no-labels",
        "town.geojson new.touch --no-labels --svg {out}.svg",
        "town.geojson new.touch --no-labels --stl {out}.stl",
    ),
    "edit": ("sphere.touch {out}.touch --operator gain:2", "sphere.touch {out}.npz --operator gain:2"),
    "splice": ("sphere.touch sphere.touch {out}.touch",),
    "resample": ("sphere.touch {out}.touch --nw 3", "sphere.touch {out}.vti --nw 3"),
    "texture": ("drag.csv --out {out}.json --speed-m-s 0.1 --force-n 1",),
    "deform": ("sphere.touch --out {out}.npz --yield-m-per-n 0.002",),
    "view": ("sphere.touch --out {out}.html --no-open",),  # --rerun: tests/tasks/test_rerun_scene.py
    "compare": ("sphere.toml sphere.touch --picture {out}.png",),
    "play": (
        "sphere.touch --offline --seconds 0.1 --log {out}.csv",
        "sphere.touch --offline --seconds 0.1 --log {out}.mcap",
        "sphere.touch --offline --seconds 0.1 --plot {out}.png",
    ),
    "measure": ("sphere.touch --no-limits --plot {out}.png",),
    "reduce": ("moving.touch {out}.touch", "moving.touch --cull {out}.touch"),
    "index": (". --index {out}.npz",),
    "points": ("5 sphere.touch {out}.touch", "5 sphere.touch {out}.npz"),
}
"""Arguments of each command that writes a file."""

READING = {
    "info": "{in}.touch",
    "partition": "{in}.touch",
    "lod": "{in}.touch",
    "similar": "{in}.touch sphere.touch",
    "search": "{in} sphere.touch",
    "study": "run {in}.toml new-results --observer threshold=2",
    "correlate": "{in}.png sphere.touch",
    "import": "{in}.hjif new.touch",
    "map": "{in}.geojson new.touch",
    "watch": "{in}.mp4 --out new.mp4",
    "demux": "{in}.mp4 new.touch",
    "mux": "{in}.mp4 sphere.touch new.mp4",
    "serve": "{in} --port 0",
    "live": "{in}.toml",
    "encode": "{in}.toml new.touch",
    "filter": "{in}.touch new.touch --gaussian 2mm",
    "field": "{in}.toml new.npz",
    "plan": "{in}.toml --budget 60kB",
    "decode": "{in}.touch new.npz",
    "export": "{in}.touch new.html",
    "edit": "{in}.touch new.touch --operator gain:2",
    "splice": "{in}.touch sphere.touch new.touch",
    "resample": "{in}.touch new.touch --nw 3",
    "texture": "{in}.wav --out new.json --speed-m-s 0.1 --force-n 1",
    "deform": "{in}.touch --out new.npz --yield-m-per-n 0.002",
    "view": "{in}.touch --out new.html --no-open",
    "compare": "{in}.toml sphere.touch --no-picture",
    "guide": "{in}.png --offline",
    "play": "{in}.touch --offline",
    "measure": "{in}.touch",
    "reduce": "{in}.touch",
    "index": "{in}",
    "points": "5 {in}.touch",
}
"""Arguments of each command that reads a file; {in} is a missing file, or a folder."""

NOTHING_READ = {"data", "demo", "devices", "sources", "doctor", "warmup"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("refused")
    (path / "sphere.toml").write_text(SPHERE)
    write_geojson(path / "town.geojson", *town())
    encode(path / "sphere.toml", path / "sphere.touch", EncodeSpec(nw=4, thickness_m=0.01))
    grid = Grid((8, 8, 8), (0.008,) * 3, (-0.028,) * 3)
    forces = np.random.default_rng(1).normal(size=(4, *grid.shape, 3)).astype(np.float32)
    medium = HapticMedium.from_frames(
        [ForceField.from_dense(grid, array) for array in forces], 30.0, "x right, y up, z towards"
    )
    encode(StoredScene(medium), path / "moving.touch", EncodeSpec(nw=3, touch=TouchSpec(effort="fast")))
    (path / "hand.csv").write_text("t_s,x_m,y_m,z_m\n0,0,0,0.02\n0.1,0.004,0.002,0.006\n0.2,0,0,0.002\n")
    times = np.arange(4000) / 4000
    rows = "\n".join(f"{t:.6f},{np.sin(900 * t):.6f}" for t in times)
    (path / "drag.csv").write_text(f"t_s,a_m_s2\n{rows}\n")
    Image.fromarray(np.zeros((9, 9), np.uint8)).save(path / "look.png")
    return path


def error_line(arguments: list[str], capsys: pytest.CaptureFixture[str], watched: Path, code: int) -> str:
    """The single error line of a command that must fail without leaving a file in `watched`."""
    before = sorted(watched.rglob("*"))
    capsys.readouterr()
    found = _exit_code(arguments)
    stderr = capsys.readouterr().err
    assert found == code, f"{arguments}: {found}, {stderr}"
    lines = [line for line in stderr.splitlines() if not line.startswith("note: ")]
    assert len(lines) == 1 and lines[0].startswith("touchfield: "), f"{arguments}: {stderr}"
    assert "fault of touchfield itself" not in stderr and "Traceback" not in stderr, f"{arguments}: {stderr}"
    assert sorted(watched.rglob("*")) == before, f"{arguments} left something behind"
    return lines[0]


def test_tables_name_every_command() -> None:
    assert READING.keys() | NOTHING_READ == ARGUMENTS.keys()


@pytest.mark.parametrize("command", sorted(TASKS))
def test_system_error_is_reported_with_a_nonzero_exit_code(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def raise_permission_error(*_: Any, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", "there")

    for task in TASKS[command]:
        module, _, name = task.partition(":")
        holder = import_module(f"touchfield.{module}")
        if not name.startswith(("executor_of", "computing", "read_", "tool_of")):
            monkeypatch.setattr(holder, name, raise_permission_error)
    monkeypatch.chdir(tmp_path)
    for name in ("one.wav", "two.wav", "in.touch"):
        (tmp_path / name).write_bytes(b"")
    arguments = [command, *ARGUMENTS[command].format(tmp=tmp_path).split()]
    line = error_line(arguments, capsys, tmp_path, 1)
    if command not in ("partition", "texture"):  # these read their files first
        assert (
            line == "touchfield: there: Permission denied. Check the path, the permissions and the free space"
        )


FOLDER_READING = {"search", "serve", "index"}


@pytest.mark.parametrize(
    ("kind", "command"),
    [("missing", command) for command in sorted(READING)]
    + [("folder", command) for command in sorted(READING.keys() - FOLDER_READING)],
)
def test_missing_file_or_folder_as_input_is_one_line(
    command: str, kind: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    arguments = READING[command].replace("{in}", "not-there").split()
    at = next(word for word in arguments if "not-there" in word)
    if kind == "folder":
        (folder / at).mkdir(exist_ok=True)
    try:
        line = error_line([command, *arguments], capsys, folder, 2 if command in FOLDER_READING else 1)
    finally:
        if kind == "folder":
            (folder / at).rmdir()
    assert f"touchfield: {at}: found " in line and "; expected " in line, line
    assert kind == "folder" or line.endswith("Check the path."), line


READ_BY_OPTIONS = (
    "encode sphere.toml new.touch --device not-there.toml",
    "view sphere.touch --rerun --out new.rrd --log not-there.csv",
    "play sphere.touch --offline --materials not-there.json",
    "play sphere.touch --offline --deformation not-there.npz",
    "play sphere.touch --offline --trajectory not-there.csv",
    "play sphere.touch --offline --trace not-there.csv",
    "play sphere.touch --offline --profile not-there.toml",
    "export sphere.touch new.wav --trajectory not-there.csv",
    "points 5 sphere.touch --next --measured not-there.csv",
    "texture not-there.json --into sphere.touch --out new.touch",
    "texture not-there.csv --out new.json --speed-m-s 0.1 --force-n 1",
    "texture not-there.xml --out new.json",
    "compare sphere.toml not-there.touch --no-picture",
    "mux look.png not-there.touch new.mp4",
    "watch not-there.mkv --out new.mkv",
    "watch look.png --out new.mkv --depth not-there.mkv",
    "demux not-there.m3u8 new.touch",
    "study analyse not-there",
    *(f"import not-there.{ending} new.touch" for ending in ("ahap", "haptic", "tact", "hmpg")),
    *(f"encode not-there.{ending} new.touch" for ending in ("stl", "npz", "csv", "mcap", "mp4", "png")),
)
"""Arguments whose option, or a file that is not the first, is missing."""


@pytest.mark.parametrize("words", READ_BY_OPTIONS)
def test_a_missing_file_of_an_option_is_named(
    words: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    line = error_line(words.split(), capsys, folder, 1)
    assert line.startswith("touchfield: not-there") and "; expected " in line, line
    assert any(text in line for text in (": found no such file; ", ": found nothing there; ")), line
    assert line.endswith("Check the path."), line


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (PermissionError(errno.EACCES, "Permission denied"), "no permission; expected text. Check its perm"),
        (IsADirectoryError(errno.EISDIR, "Is a directory"), "a folder; expected text. Name a file"),
        (NotADirectoryError(errno.ENOTDIR, "Not a directory"), "no such file; .* part of it is no folder"),
        (OSError(errno.ENAMETOOLONG, "File name too long"), "File name too long; .* the path and the perm"),
    ],
)
def test_what_the_system_reports_is_a_clear_error(error: OSError, found: str) -> None:
    with pytest.raises(SourceError, match=f"a.txt: found {found}"), readable(Path("a.txt"), "text"):
        raise error


@pytest.mark.thorough
@pytest.mark.parametrize("command", sorted(WRITING))
def test_unwritable_result_is_one_line_and_leaves_no_file(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A missing folder; a folder of the result's name; a full disk."""
    monkeypatch.chdir(folder)
    for form in WRITING[command]:
        line = error_line([command, *form.replace("{out}", "nowhere/new").split()], capsys, folder, 2)
        assert line.startswith("touchfield: nowhere/new") and "found no folder" in line
        arguments = form.replace("{out}", "new").split()
        out = next(word for word in arguments if word.startswith("new"))
        (folder / out).mkdir()
        # two commands find it when they write, the others before they compute anything
        code = 1 if command in ("compare", "index") else 2
        assert error_line([command, *arguments], capsys, folder, code).startswith(f"touchfield: {out}: ")
        (folder / out).rmdir()

        def full(handle: int) -> None:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            line = error_line([command, *arguments], capsys, folder, 1)
        assert "No space left on device" in line and out in line


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize(
    "command", ["--version", "sources --json", "devices", "doctor --json --device sim", "info sphere.touch"]
)
def test_output_that_cannot_be_printed_is_an_error(command: str, folder: Path) -> None:
    program = [sys.executable, "-m", "touchfield", *command.split()]
    with open("/dev/full", "w") as full:
        done = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, cwd=folder, text=True)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "No space left on device" in done.stderr
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(program, stdout=writing, stderr=subprocess.PIPE, cwd=folder, text=True)
    os.close(writing)
    assert done.returncode == 1 and not done.stderr, "who closes a pipe wants to hear no more"


def test_broken_pipe_within_a_task_is_an_error(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def breaks(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr("touchfield.network.opening.open_stream", breaks)
    capsys.readouterr()
    assert _exit_code(["info", "sphere.touch"]) == 1
    assert capsys.readouterr() == ("", ""), "nobody is there to hear it"


@pytest.mark.parametrize("name", ["fits.txt", "x.jpg", "picture"])
@pytest.mark.parametrize(
    "arguments",
    [
        "study analyse in --plot", "encode sample:shapes out.touch --plot", "field sample:shapes --preview",
        "measure in.touch --plot", "play in.touch --offline --plot", "points 5 in.touch --plot",
        "compare sample:shapes in.touch --picture", "plan sample:shapes --budget 60kB --plot",
        "reduce in.touch --plot", "filter in.touch out.touch --gaussian 2mm --plot",
        "texture in.wav -o o.json --plot",
    ],
)  # fmt: skip
def test_a_picture_that_is_no_png_is_refused_before_the_work(
    arguments: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert _exit_code([*arguments.split(), name]) == 2
    assert f"{name}: found the ending" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "known"),
    [("play in.touch --offline --log", "LOG.csv or LOG.mcap"), ("guide walk --offline --log", "LOG.csv")],
)
@pytest.mark.parametrize("name", ["log.txt", "log.json", "log"])
def test_a_log_of_another_format_is_refused_before_the_work(
    arguments: str, known: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert _exit_code([*arguments.split(), name]) == 2
    assert f"{name}: found the ending" in (error := capsys.readouterr().err) and known in error
    assert not list(tmp_path.iterdir())


def test_a_port_in_use_is_refused_before_the_source_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        for command in ("live", "serve"):
            source = tmp_path if command == "serve" else tmp_path / "missing.stl"
            assert _exit_code([command, str(source), "--port", str(port)]) == 2
            message = capsys.readouterr().err
            assert f"--port: found 127.0.0.1:{port}: in use by another program" in message
            assert message.count("\n") == 1
