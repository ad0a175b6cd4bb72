"""Round trips of random fields through writer and reader in C, under the sanitizers.

`bench/fuzz_c.py` runs more of them.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from shutil import which

import pytest

C = Path(__file__).resolve().parents[2] / "c"
OPTIONS = ("-O1", "-std=c99", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`touch_fuzz_write`, with the sanitizers; skips without a compiler that has them."""
    compiler = which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    folder = tmp_path_factory.mktemp("fuzz_write")
    probe = folder / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    if subprocess.run(
        [compiler, *OPTIONS, "-o", folder / "probe", probe], capture_output=True, check=False
    ).returncode:
        pytest.skip("the compiler has no address sanitizer")
    built = folder / "touch_fuzz_write"
    command = [compiler, *OPTIONS, f"-I{C}", "-o", built, C / "touch_fuzz_write.c", "-lm"]
    subprocess.run(command, check=True)
    return built


@pytest.mark.parametrize("rounds", [300, pytest.param(30_000, marks=pytest.mark.thorough)])
def test_round_trips_keep_the_error_bound(program: Path, tmp_path: Path, rounds: int) -> None:
    done = subprocess.run([program, "5", str(rounds), tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{rounds} files, ")
    assert len(list(tmp_path.glob("*.touch"))) == 256
