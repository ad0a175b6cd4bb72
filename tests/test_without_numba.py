"""Without numba (extra ``sources``) a receiver does all its work, and what needs numba names the extra."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from child_environment import environment_with
from touchfield.medium.stores.npz import read_npz

GOLDEN = Path(__file__).parents[1] / "conformance" / "v1"
FILES = ("touch-block", "objects-touch", "objects-rigid", "paper-closed-loop", "paper-adpcm")
"""A golden file of each coder, and one of the stage whose decoder was a kernel."""
ON_PAGES = ("touch-block", "objects-touch")
BLOCK = """
import sys
from importlib.machinery import PathFinder
class Finder:
    def find_spec(self, name, path=None, target=None):
        is_missing = name.partition(".")[0] in ("numba", "llvmlite")
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


def run_without_numba(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    environment = environment_with(Path(__file__).parent)
    command = [sys.executable, "-c", BLOCK + code, *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True)


def test_numba_is_blocked() -> None:
    done = run_without_numba("import numba")
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
    done = run_without_numba(COMMANDS, *lines)
    assert done.returncode == 0, done.stderr
    decoded = read_npz(tmp_path / "decoded.npz")
    with tf.open_stream(file) as stream:
        for n in range(len(stream.medium)):
            np.testing.assert_array_equal(decoded[n].bricks, stream.medium[n].bricks)
            np.testing.assert_array_equal(decoded[n].forces_n, stream.medium[n].forces_n)
    assert len((tmp_path / "ticks.csv").read_text().splitlines()) > 20


def test_functions_of_a_receiver() -> None:
    done = run_without_numba(LIBRARY, *(GOLDEN / f"{name}.touch" for name in FILES))
    assert done.returncode == 0, done.stderr


def test_shapes_are_encoded_and_compared_without_kernels(tmp_path: Path) -> None:
    out = tmp_path / "shapes.touch"
    lines = f"encode sample:shapes {out} --nw 4", f"compare sample:shapes {out}"
    done = run_without_numba(COMMANDS, *lines)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "line", ["encode sample:terrain OUT --nw 4", "encode sample:shapes OUT --nw 4 --coder paper", "warmup"]
)
def test_the_error_names_the_extra(line: str, tmp_path: Path) -> None:
    done = run_without_numba(COMMANDS, line.replace("OUT", str(tmp_path / "out.touch")))
    assert done.returncode != 0
    (message,) = [text for text in done.stderr.splitlines() if text.startswith("touchfield: ")]
    assert "numba is not installed" in message and 'pip install "touchfield[sources]"' in message
    assert os.listdir(tmp_path) == []


def test_doctor_reports_what_is_missing() -> None:
    done = run_without_numba(COMMANDS, "doctor")
    assert done.returncode == 0, done.stderr
