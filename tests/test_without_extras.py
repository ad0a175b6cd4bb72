"""Without any extra a receiver does all its work, and what needs numba names its extra, ``sources``."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Timer
from typing import Any
from urllib.request import Request, urlopen

import numpy as np
import pytest

import touchfield as tf
from child_environment import environment_with
from touchfield.medium.stores.npz import read_npz

GOLDEN = Path(__file__).parents[1] / "conformance" / "v1"
FILES = ("touch-block", "objects-touch", "objects-rigid", "paper-closed-loop", "paper-adpcm")
"""A golden file of each coder, and one of the stage whose decoder was a kernel."""
ON_PAGES = ("touch-block", "objects-touch")
NUMBA = "numba", "llvmlite"
EXTRAS = (
    *(*NUMBA, "matplotlib", "skimage", "mujoco", "mcap", "cv2", "av", "serial", "websockets"),
    *("zarr", "xarray", "raptorq", "distributed", "dask", "obstore", "collada", "lib3mf", "laspy", "pye57"),
    *("rosbags", "joblib", "ray", "osmium", "svgelements", "rerun"),
)
"""Modules of all extras of a user's."""
BLOCK = """
import sys
from importlib.machinery import PathFinder
class Finder:
    def find_spec(self, name, path=None, target=None):
        is_missing = name.partition(".")[0] in BLOCKED
        return None if is_missing else PathFinder.find_spec(name, path, target)
sys.meta_path[:] = [finder for finder in sys.meta_path if finder is not PathFinder] + [Finder()]
"""
COMMANDS = """
from touchfield.cli.main import _exit_code
for line in sys.argv[1:]:
    assert _exit_code(line.split()) == 0, line
"""
LIBRARY = """
import numpy as np
import touchfield as tf
for name in sys.argv[1:]:
    with tf.open_stream(name) as stream:
        field = stream.medium[0]
        point = field.grid.to_m(field.positions()[0] if len(field.positions()) else np.zeros(3))
        force_n = tf.FieldSampler(stream.medium).force_n(0.0, point)
        assert np.abs(np.subtract(force_n, field.sample_n(point))).max() < 1e-5, name
"""


def without_extras(code: str, *arguments: object, blocked: Sequence[str] = EXTRAS) -> dict[str, Any]:
    """Arguments of `subprocess` for a program that cannot import some modules."""
    code = f"BLOCKED = {blocked}\n{BLOCK}{code}"
    command = [sys.executable, "-u", "-c", code, *map(str, arguments)]
    return {"args": command, "env": environment_with(Path(__file__).parent), "text": True}


def run_without_extras(
    code: str, *arguments: object, blocked: Sequence[str] = EXTRAS
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(**without_extras(code, *arguments, blocked=blocked), capture_output=True)


@contextmanager
def serving(folder: Path) -> Iterator[list[str]]:
    """Run `touchfield serve` for a folder; what it prints: addresses of its streams, and of a page."""
    options = without_extras(COMMANDS, f"serve {folder} --port 0")
    with subprocess.Popen(**options, stdout=subprocess.PIPE) as server:
        timer = Timer(60.0, server.kill)
        timer.start()
        try:
            yield [server.stdout.readline().strip() for _ in range(len(list(folder.iterdir())) + 1)]
        finally:
            timer.cancel()
            server.kill()


def test_numba_is_blocked() -> None:
    done = run_without_extras("import numba")
    assert done.returncode != 0 and "No module named 'numba'" in done.stderr


@pytest.mark.parametrize("name", FILES)
def test_commands_of_a_receiver(name: str, tmp_path: Path) -> None:
    file = GOLDEN / f"{name}.touch"
    lines = [
        f"decode {file} {tmp_path / 'decoded.npz'}",
        f"info {file} --json",
        f"play {file} --offline --seconds 0.02 --log {tmp_path / 'ticks.csv'}",
    ]
    if name in ON_PAGES:
        lines += [
            f"view {file} --no-open --out {tmp_path / 'view.html'}",
            f"export {file} {tmp_path / 'page.html'}",
        ]
    done = run_without_extras(COMMANDS, *lines)
    assert done.returncode == 0, done.stderr
    decoded = read_npz(tmp_path / "decoded.npz")
    with tf.open_stream(file) as stream:
        for n in range(len(stream.medium)):
            np.testing.assert_array_equal(decoded[n].bricks, stream.medium[n].bricks)
            np.testing.assert_array_equal(decoded[n].forces_n, stream.medium[n].forces_n)
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) > 20


def test_the_help_and_the_version_need_no_extra() -> None:
    done = run_without_extras(COMMANDS, "--help", "--version")  # both import all commands
    assert done.returncode == 0, done.stderr
    assert f"touchfield {tf.__version__}" in done.stdout


def test_functions_of_a_receiver() -> None:
    done = run_without_extras(LIBRARY, *(GOLDEN / f"{name}.touch" for name in FILES))
    assert done.returncode == 0, done.stderr


def test_a_folder_is_served(tmp_path: Path) -> None:
    for name in ON_PAGES:
        shutil.copy(GOLDEN / f"{name}.touch", tmp_path)
    with serving(tmp_path) as lines:
        *addresses, page = lines
        assert [address.rpartition("/")[2] for address in addresses] == [
            f"{name}.touch" for name in sorted(ON_PAGES)
        ]
        for name, address in zip(sorted(ON_PAGES), addresses):
            content = (GOLDEN / f"{name}.touch").read_bytes()
            with urlopen(address, timeout=30) as answer:
                assert answer.read() == content
            with urlopen(Request(address, headers={"Range": "bytes=10-19"}), timeout=30) as answer:
                assert (answer.status, answer.read()) == (206, content[10:20])
        with urlopen(page.partition("in a browser: ")[2], timeout=30) as answer:
            assert b"<html" in answer.read()
        played = run_without_extras(
            COMMANDS, f"play {addresses[0]} --offline --seconds 0.02 --log {tmp_path / 'ticks.csv'}"
        )
    assert played.returncode == 0, played.stderr
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) > 20


def test_datagrams_name_their_extra() -> None:
    done = run_without_extras(COMMANDS, "play udp://127.0.0.1:9 --offline")
    assert done.returncode != 0
    assert 'raptorq is not installed. Install it with: pip install "touchfield[broadcast]"' in done.stderr


def test_shapes_are_encoded_and_compared_without_kernels(tmp_path: Path) -> None:
    out = tmp_path / "shapes.touch"
    lines = f"encode sample:shapes {out} --nw 4 --report", f"compare sample:shapes {out}"
    done = run_without_extras(COMMANDS, *lines)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("nmse_db") == 2


def test_a_picture_is_refused_before_the_work(tmp_path: Path) -> None:
    line = f"encode sample:shapes {tmp_path / 'a.touch'} --nw 4 --plot {tmp_path / 'a.png'}"
    done = run_without_extras(COMMANDS, line)
    assert done.returncode != 0 and 'pip install "touchfield[report]"' in done.stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "line", ["encode sample:terrain OUT --nw 4", "encode sample:shapes OUT --nw 4 --coder paper", "warmup"]
)
def test_the_error_names_the_extra(line: str, tmp_path: Path) -> None:
    done = run_without_extras(COMMANDS, line.replace("OUT", str(tmp_path / "out.touch")), blocked=NUMBA)
    assert done.returncode != 0
    (message,) = [text for text in done.stderr.splitlines() if text.startswith("touchfield: ")]
    assert "numba is not installed" in message and 'pip install "touchfield[sources]"' in message
    assert os.listdir(tmp_path) == []


def test_doctor_reports_what_is_missing() -> None:
    done = run_without_extras(COMMANDS, "doctor")
    assert done.returncode == 0, done.stderr
