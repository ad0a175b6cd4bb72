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
from touchfield.render.block import Memory, layout

ROOT = Path(__file__).resolve().parents[2]
TICKS = ROOT / "conformance" / "ticks"
sys.path.insert(0, str(TICKS.parent))
from make_ticks import CASES, MAGIC, layout_crc  # noqa: E402

REMEDY = "run conformance/make_ticks.py"
FILES = sorted(TICKS.glob("*.ticks"))
OPTIONS = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror", "-O1", "-g")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
ATOL_N = 1e-9


class AnotherLayoutError(Exception):
    """A file of ticks whose offsets are those of another layout of the receiver."""


def contents(path: Path) -> tuple[Memory, Any]:
    """The memory before the first tick, and the rows; `AnotherLayoutError` for a file of another layout."""
    data = path.read_bytes()
    if data[:8] != MAGIC:
        raise AnotherLayoutError(f"{path.name}: found {data[:8]!r}; expected {MAGIC!r}: {REMEDY}")
    memory_bytes, receiver_bytes, crc, pieces, ticks, numbers = struct.unpack_from("<6q", data, 8)
    if (receiver_bytes, crc) != (layout.RECEIVER.itemsize, layout_crc()):
        raise AnotherLayoutError(f"{path.name}: a receiver of another layout: {REMEDY}")
    memory, at = Memory.empty(memory_bytes), 56
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


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A file of the present layout."""
    path = tmp_path / "friction.ticks"
    CASES["friction"]().write(path)
    return path


def test_c_program_reports_a_wrong_force(program: Path, written: Path, tmp_path: Path) -> None:
    data = bytearray(written.read_bytes())
    data[-8:] = struct.pack("<d", 1e-8 + struct.unpack("<d", data[-8:])[0])
    (tmp_path / "wrong.ticks").write_bytes(data)
    command = [program, tmp_path / "wrong.ticks"]
    assert subprocess.run(command, capture_output=True, check=False).returncode == 1


def test_a_file_of_another_layout_is_refused(program: Path, written: Path, tmp_path: Path) -> None:
    assert contents(written)[1].shape == (100, 11)
    assert subprocess.run([program, written], capture_output=True, check=False).returncode == 0
    data, wrong = written.read_bytes(), tmp_path / "wrong.ticks"
    for name, content in (
        ("version", b"TICKS001" + data[8:]),
        ("size", data[:16] + struct.pack("<q", layout.RECEIVER.itemsize - 8) + data[24:]),
        ("layout", data[:24] + struct.pack("<q", layout_crc() ^ 1) + data[32:]),
    ):
        wrong.write_bytes(content)
        with pytest.raises(AnotherLayoutError, match=REMEDY):
            contents(wrong)
        done = subprocess.run([program, wrong], capture_output=True, text=True, check=False)
        if name != "layout":  # C knows the size alone
            assert done.returncode == 2 and REMEDY in done.stderr, name


@pytest.mark.parametrize(
    ("at", "value", "message"),
    [(8, 8, "sizes"), (8, 1 << 40, "sizes"), (32, -1, "sizes"), (48, 12, "rows"), (56, 1 << 30, "piece")],
)
def test_c_program_refuses_a_damaged_file(
    program: Path, written: Path, tmp_path: Path, at: int, value: int, message: str
) -> None:
    data = written.read_bytes()
    (tmp_path / "wrong.ticks").write_bytes(data[:at] + struct.pack("<q", value) + data[at + 8 :])
    (tmp_path / "short.ticks").write_bytes(data[:-1])
    for name, expected in (("wrong", message), ("short", "ends early"), ("none", "cannot be opened")):
        command = [program, tmp_path / f"{name}.ticks"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2 and expected in done.stderr


def test_ticks_of_friction_slide_stick_and_rest(written: Path) -> None:
    """The case has every part of the law: at the cone, within it, constant at rest, carried by a body."""
    memory, rows = contents(written)
    ratios, drags_n = [], []
    for row in rows:
        native.tick(memory.bytes, int(row[0]), int(row[1]), *row[2:6].tolist(), row[6])
        state = memory.receiver["state"]
        drags_n.append(np.array(state["friction_n"].tolist()))
        pressure_n = np.linalg.norm(state["field_force_n"].tolist())
        ratios.append(np.linalg.norm(drags_n[-1]) / (0.5 * max(pressure_n, 1e-9)))
    ratio = np.array(ratios)
    assert ratio.max() <= 1.0 and ratio[30:40].min() > 0.999  # slides
    assert (ratio[41:55] < 0.9).any() and drags_n[40] @ drags_n[55] < 0  # sticks, turns back
    assert np.abs(drags_n[80] - drags_n[79]).max() < 1e-6 < np.linalg.norm(drags_n[80])  # rests
    assert np.linalg.norm(drags_n[99] - drags_n[80]) > 0.01  # is taken along


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
        ("friction", "settings", "friction"),
        ("friction", "settings", "stick_n_per_m"),
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
    assert {path.stem for path in FILES} == set(CASES)
    assert sum(path.stat().st_size for path in FILES) < 300_000
