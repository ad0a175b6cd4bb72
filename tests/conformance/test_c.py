"""`c/touch.h` decodes each golden file to the same forces, and refuses faulty ones for the same reason."""

from __future__ import annotations

import importlib
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from second import CONFORMANCE, FAULTY, GOLDEN, decoder

C = CONFORMANCE.parent / "c"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror")
CODES = ("", "ForeignFile", "TruncatedFile", "CorruptFile", "UnsupportedVersion")
OBJECTS_ATOL_N = 2e-6

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")


def is_paper(stream: Path) -> bool:
    """Whether a file needs the paper's coder, which touch.h does not support."""
    return b"\x05\x00paper" in stream.read_bytes()


def built(folder: Path, name: str, *options: str, source: Path | None = None) -> Path:
    """Compile a program of the folder c, or of another source."""
    out = folder / name
    command = [str(COMPILER), *STRICT, *options, "-o", str(out), str(source or C / f"{name}.c"), "-lm"]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    return out


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`touch_decode`, compiled with warnings as errors."""
    return built(tmp_path_factory.mktemp("c"), "touch_decode", "-O2")


def run(program: Path, stream: Path, out: Path) -> tuple[int, str]:
    """Exit code and output."""
    return run_with(program, stream, out)


def run_with(program: Path, *paths: Path) -> tuple[int, str]:
    """Exit code and output of a program with any files."""
    done = subprocess.run([program, *paths], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.strip()


class Raw:
    """The output of `touch_decode`, read sequentially."""

    def __init__(self, data: bytes, shape: tuple[int, int, int]) -> None:
        self.data, self.shape, self.at = data, shape, 0

    def numbers(self, dtype: str, count: int) -> Any:
        out = np.frombuffer(self.data, dtype, count, self.at)
        self.at += 4 * count
        return out

    def bricks(self) -> dict[tuple[int, ...], np.ndarray]:
        """Bricks that are not all zero, by their indices."""
        out, grid = {}, [-(-n // 8) for n in self.shape]
        for _ in range(int(self.numbers("<u4", 1)[0])):
            brick = tuple(int(n) for n in np.unravel_index(int(self.numbers("<u4", 1)[0]), grid))
            forces = self.numbers("<f4", 1536).reshape(8, 8, 8, 3)
            if forces.any():
                out[brick] = forces
        return out

    def field(self) -> np.ndarray:
        dense = np.zeros((*(-(-n // 8) * 8 for n in self.shape), 3), np.float32)
        for (i, j, k), forces in self.bricks().items():
            dense[8 * i : 8 * i + 8, 8 * j : 8 * j + 8, 8 * k : 8 * k + 8] = forces
        x, y, z = self.shape
        return dense[:x, :y, :z]


@pytest.mark.parametrize("stream", [s for s in GOLDEN if not is_paper(s)], ids=lambda p: p.stem)
def test_golden_files_decode_alike(stream: Path, program: Path, tmp_path: Path) -> None:
    assert run(program, stream, tmp_path / "raw") == (0, "0")
    head = decoder.read_file(stream.read_bytes()).head
    raw = Raw((tmp_path / "raw").read_bytes(), head["grid_shape"])
    with np.load(stream.with_suffix(".npz")) as golden:
        expected = dict(golden)
    vibration = stream.with_suffix(".vibration.npz")
    for i in range(head["frame_count"]):
        if "bricks" in expected:
            in_frame = expected["frames"] == i
            bricks_expected = [tuple(p) for p in expected["bricks"][in_frame].tolist()]
            bricks = raw.bricks()
            assert bricks.keys() == set(bricks_expected)
            for brick, forces in zip(bricks_expected, expected["forces_n"][in_frame]):
                assert (bricks[brick] == forces).all()
        elif head["coder"] == "objects":
            forces = raw.numbers("<f4", 3 * math.prod(raw.shape)).reshape(*raw.shape, 3)
            np.testing.assert_allclose(forces, expected["forces_n"][i], rtol=0, atol=OBJECTS_ATOL_N)
        else:
            assert (raw.field() == expected["forces_n"][i]).all()
        if vibration.exists():
            vibrating = raw.field()
            with np.load(vibration) as both:
                assert (vibrating[..., 0] == both["amplitudes_n"][i]).all()
                assert (vibrating[..., 1] == both["frequencies_hz"][i]).all()
        else:
            assert not raw.bricks()
    assert raw.at == len(raw.data)


@pytest.mark.parametrize("name", sorted(FAULTY))
def test_faulty_files_are_refused_for_the_same_reason(name: str, program: Path, tmp_path: Path) -> None:
    stream = CONFORMANCE / "faulty" / f"{name}.touch"
    code, message = run(program, stream, tmp_path / "raw")
    assert CODES[code] == (
        "UnsupportedVersion" if is_paper(stream) and not is_container(name) else FAULTY[name]
    )
    assert message.partition(" ")[2]


def is_container(name: str) -> bool:
    """Whether a faulty file fails before a coder is selected."""
    return not name.startswith(
        ("paper", "objects-rigid-", "vibration-cut", "vibration-flipped", "vibration-long")
    )


def test_objects_on_a_huge_grid_are_not_laid_out(program: Path, tmp_path: Path) -> None:
    """The grid is valid: a receiver may query forces at points of it."""
    faults: Any = importlib.import_module("make_faulty")
    head, *others = faults.records_of((CONFORMANCE / "v1" / "objects-touch.touch").read_bytes())
    (tmp_path / "huge.touch").write_bytes(
        faults.assembled([head.changed(0, "3I", 4096, 4096, 2048), *others])
    )
    command = [program, tmp_path / "huge.touch", tmp_path / "raw"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 64 and done.stderr == (
        "a grid of 34359738368 points, more than 2^24, cannot be laid out\n"
    )


def test_mutated_files_cause_no_invalid_memory_access(tmp_path: Path) -> None:
    options = ("-Og", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    fuzzing = "-DFUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION"
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [str(COMPILER), *options, "-o", str(tmp_path / "probe"), str(probe)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("the compiler has no address sanitizer")
    fuzz = built(tmp_path, "touch_fuzz", *options, fuzzing)
    streams = [s for s in GOLDEN if not is_paper(s) and s.stem != "touch-large"]
    done = subprocess.run([fuzz, "1", "1", *streams], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    counts = [int(line.split()[2]) for line in done.stdout.splitlines()]
    assert sum(counts) > 100 and counts[2] > 0 and counts[3] > 0


@pytest.mark.parametrize("is_watched", [False, pytest.param(True, marks=pytest.mark.thorough)])
def test_too_small_arena_is_reported_at_every_allocation(is_watched: bool, tmp_path: Path) -> None:
    """Each allocation in turn is the first to fail: the decoder reports it, and touches no other memory."""
    options = ["-Og", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"] if is_watched else ["-O2"]
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }\n")
    command = [str(COMPILER), *options, "-o", str(tmp_path / "probe"), str(probe)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("the compiler has no address sanitizer")
    program = built(tmp_path, "arena", *options, f"-I{C}", source=Path(__file__).parent / "arena.c")
    names = (
        "touch-block",
        "touch-lossless",
        "touch-solid",
        "vibration-touch",
        "objects-touch",
        "objects-touch-deforming",
    )
    streams = [CONFORMANCE / "v1" / f"{name}.touch" for name in names]
    done = subprocess.run([program, *streams], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for line in done.stdout.splitlines():
        tries, failed = map(int, line.split())
        # an allocation may reuse the memory of an earlier one
        assert 0.8 * tries <= failed <= tries and tries > 10
