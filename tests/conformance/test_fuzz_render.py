"""Random media, settings and hands through the renderer in C, under the sanitizers.

`bench/fuzz_c.py` runs more of them.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

C = Path(__file__).resolve().parents[2] / "c"
WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror")
OPTIONS = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def built(folder: Path, headers: Path = C) -> Path:
    """Compile the fuzzer with the headers of a folder; skip without a compiler that has the sanitizers."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    program = folder / "touch_fuzz_render"
    source = headers / "touch_fuzz_render.c"
    command = [compiler, *WARNINGS, *OPTIONS, "-o", program, source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if "asan" in done.stderr:
        pytest.skip("the compiler has no address sanitizer")
    assert done.returncode == 0, done.stderr
    return program


def run(program: Path, rounds: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, "5", str(rounds)], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("rounds", [3000, pytest.param(100_000, marks=pytest.mark.thorough)])
def test_forces_obey_their_limits(tmp_path: Path, rounds: int) -> None:
    done = run(built(tmp_path), rounds)
    assert done.returncode == 0, done.stderr
    _, forces, torques = (
        int(word) for word in done.stdout.replace(" of 60 ticks", "").split() if word.isdigit()
    )
    assert forces > 10 * rounds and torques > rounds // 10


@pytest.mark.parametrize(
    ("header", "code", "fault"),
    [
        ("touch_effects.h", "state->limit - 0.5 * max_step", "state->limit - 4.0 * max_step"),
        ("touch_effects.h", "if (size > max_step) desired", "if (size > 2.0 * max_step) desired"),
        ("touch_render.h", "before - gain_step)", "before - 0.0 * gain_step)"),
    ],
)
def test_fuzzer_finds_faults_in_the_limits(tmp_path: Path, header: str, code: str, fault: str) -> None:
    headers = tmp_path / "c"
    headers.mkdir()
    for path in C.glob("*.[ch]"):
        shutil.copy(path, headers)
    text = (headers / header).read_text()
    assert code in text
    (headers / header).write_text(text.replace(code, fault))
    assert run(built(tmp_path, headers), 3000).returncode == 1
