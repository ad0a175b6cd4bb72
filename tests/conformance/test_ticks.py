"""The golden ticks of `conformance/ticks`, by the compiled module, a program in C with the sanitizers, and
WebAssembly.
"""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from typing import Any

import numpy as np
import pytest

from touchfield.compute.native import native
from touchfield.render.block import Memory

ROOT = Path(__file__).resolve().parents[2]
TICKS = ROOT / "conformance" / "ticks"
FILES = sorted(TICKS.glob("*.ticks"))
OPTIONS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror", "-O1", "-g")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
ATOL_N = 1e-9


def contents(path: Path) -> tuple[Memory, Any]:
    """The memory before the first tick, and the rows."""
    data = path.read_bytes()
    memory_bytes, pieces, ticks, numbers = struct.unpack_from("<4q", data, 8)
    assert data[:8] == b"TICKS001"
    memory, at = Memory.empty(memory_bytes), 40
    for _ in range(pieces):
        offset, size = struct.unpack_from("<2q", data, at)
        memory.bytes[offset : offset + size] = np.frombuffer(data, np.uint8, size, at + 16)
        at += 16 + size
    return memory, np.frombuffer(data, "<f8", ticks * numbers, at).reshape(ticks, numbers)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_module_computes_the_golden_forces(path: Path) -> None:
    memory, rows = contents(path)
    receiver = memory.receiver
    for before, after, blend, x, y, z, dt_s, is_release, *rest in rows.tolist():
        if rest[3:]:
            receiver["grip"]["orientation"] = rest[3:7]
        if is_release:
            force = native.release(memory.bytes, dt_s)
        else:
            force = native.tick(memory.bytes, int(before), int(after), blend, x, y, z, dt_s)
        np.testing.assert_allclose(force, rest[:3], atol=ATOL_N, rtol=0)
        if rest[3:]:
            np.testing.assert_allclose(receiver["state"]["torque"]["output"], rest[7:], atol=ATOL_N, rtol=0)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    built, source = tmp_path_factory.mktemp("ticks") / "ticks", Path(__file__).with_name("ticks.c")
    command = [compiler, *OPTIONS, *SANITIZERS, f"-I{ROOT / 'c'}", "-o", built, source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return built


def test_c_computes_the_golden_forces(program: Path) -> None:
    done = subprocess.run([program, *FILES], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == len(FILES)


def test_c_program_reports_a_wrong_force(program: Path, tmp_path: Path) -> None:
    data = bytearray((TICKS / "voxels.ticks").read_bytes())
    data[-8:] = struct.pack("<d", 1e-8 + struct.unpack("<d", data[-8:])[0])
    (tmp_path / "wrong.ticks").write_bytes(data)
    assert (
        subprocess.run([program, tmp_path / "wrong.ticks"], capture_output=True, check=False).returncode == 1
    )


OF_THE_PAGE = ("-DTOUCH_HAS_EXTRAS=0", "-DTOUCH_INLINE=static inline", "-Oz")  # as web/hand.c has them
WITH_EXTRAS = {"deformation", "material", "tool"}  # that no file has


def wasm_module(path: Path, *options: str, source: str = "ticks_wasm.c") -> Path:
    """Compile the tick, or another source, for WebAssembly, with the page's own mathematics."""
    if which("node") is None:
        pytest.skip("there is no node here")
    if find_spec("ziglang") is None and "TOUCHFIELD_ZIG_PYTHON" not in os.environ:
        pytest.skip("zig is not here: pip install 'touchfield[web]'")
    own, freestanding = Path(__file__).parent, ROOT / "web" / "freestanding"
    command = [
        os.environ.get("TOUCHFIELD_ZIG_PYTHON", sys.executable), "-m", "ziglang", "cc",
        "-target", "wasm32-freestanding", "-mcpu=generic+bulk_memory+nontrapping_fptoint", "-O2", *options,
        "-std=c11", "-Wall", "-Wextra", "-Werror", "-fno-builtin", "-nostdlib", "-fno-sanitize=all",
        f"-I{freestanding}", f"-I{ROOT / 'c'}", "-Wl,--no-entry", "-o", str(path),
        str(own / source), str(freestanding / "library.c"),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return path


def run_wasm(module: Path, files: list[Path]) -> subprocess.CompletedProcess[str]:
    """Compare the ticks of files with those of a module, in node."""
    command = ["node", str(Path(__file__).with_name("ticks.mjs")), str(module), *map(str, files)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_webassembly_computes_the_golden_forces(tmp_path: Path) -> None:
    done = run_wasm(wasm_module(tmp_path / "ticks.wasm"), FILES)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == len(FILES)


def test_hand_of_the_page_computes_the_golden_forces(tmp_path: Path) -> None:
    module = wasm_module(tmp_path / "ticks.wasm", *OF_THE_PAGE)
    files = [path for path in FILES if path.stem not in WITH_EXTRAS]
    done = run_wasm(module, files)
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(done.stdout.splitlines()) == len(FILES) - len(WITH_EXTRAS)
    assert run_wasm(module, [TICKS / "tool.ticks"]).returncode == 1  # its force is that of a point


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_golden_ticks_have_forces(path: Path) -> None:
    _, rows = contents(path)
    forces_n = rows[:, 8:11]
    assert np.isfinite(forces_n).all() and np.linalg.norm(forces_n, axis=1).max() > 0.3
    assert np.count_nonzero(forces_n.any(axis=1)) >= 50


def test_features_change_the_forces() -> None:
    """Each feature is at work in its file: the same without it has other forces."""
    for name, section, key in (
        ("voxels", "settings", "friction"),
        ("material", "settings", "material_count"),
        ("proxy", "settings", "wall_n_per_m"),
        ("proxy", "settings", "friction"),
        ("coupling", "settings", "coupling_n_per_m"),
        ("passivity", "settings", "is_passive"),
        ("damper", "settings", "brake_n_s_per_m"),
        ("tool", "settings", "tool_point_count"),
    ):
        memory, rows = contents(TICKS / f"{name}.ticks")
        memory.receiver[section][key] = 0
        memory.receiver["state"]["friction"] = memory.receiver["settings"]["friction"]
        forces_n = [
            native.tick(memory.bytes, int(row[0]), int(row[1]), *row[2:6].tolist(), row[6]) for row in rows
        ]
        assert np.abs(np.array(forces_n) - rows[:, 8:11]).max() > 0.01, f"{name} without {key}"


def test_total_size_is_small() -> None:
    assert {path.stem for path in FILES} == set(cases())
    assert sum(path.stat().st_size for path in FILES) < 300_000


def cases() -> list[str]:
    sys.path.insert(0, str(TICKS.parent))
    from make_ticks import CASES

    return list(CASES)
