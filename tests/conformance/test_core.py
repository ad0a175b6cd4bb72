"""`touchfield_core`, built here: bit-exact frames of every golden file, without compiling kernels."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from second import CONFORMANCE, GOLDEN

from touchfield.container import TouchReader
from touchfield.errors import FormatError
from touchfield.pipeline import native_decoder
from touchfield.pipeline.decoding import open_file

ROOT = CONFORMANCE.parent
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror", "-O2")
PYTHON_H = Path(sysconfig.get_path("include")) / "Python.h"

pytestmark = pytest.mark.skipif(
    COMPILER is None or not PYTHON_H.exists() or sys.platform != "linux",
    reason="there is no C compiler here, or no headers of Python",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the module."""
    out = tmp_path_factory.mktemp("core")
    options = ("-DPy_LIMITED_API=0x030b0000", "-shared", "-fPIC", f"-I{PYTHON_H.parent}", f"-I{ROOT / 'c'}")
    target = ("-o", str(out / "touchfield_core.abi3.so"), str(ROOT / "core" / "touchfield_core.c"))
    subprocess.run([str(COMPILER), *STRICT, *options, *target], check=True)
    return out


@pytest.fixture
def core(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The imported module, used in one test only."""
    monkeypatch.syspath_prepend(str(folder))
    module = import_module("touchfield_core")
    monkeypatch.setattr(native_decoder, "_core", lambda: module)
    return module


def voxels() -> Path:
    """A golden file of the coder `touch`."""
    for stream in GOLDEN:
        with TouchReader(stream) as reader:
            if reader.head.coder == "touch":
                return stream
    raise AssertionError("there is none")


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_frames_of_golden_files_are_bit_exact(
    stream: Path, core: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_file(stream) as native:
        is_voxels = native.reader.head.coder == "touch"
        assert native.is_native == is_voxels
        medium = native.medium
        frames = [medium[i] for i in range(len(medium))] if is_voxels else []
    monkeypatch.setattr(native_decoder, "_core", lambda: None)
    with open_file(stream) as plain:
        assert not plain.is_native
        for n, frame in enumerate(frames):
            expected = plain.medium[n]
            np.testing.assert_array_equal(frame.bricks, expected.bricks)
            assert frame.forces_n.tobytes() == expected.forces_n.tobytes()


def test_damaged_segment_gives_the_error_of_the_python_decoder(core: Any, tmp_path: Path) -> None:
    data = bytearray(voxels().read_bytes())
    index = data.index(b"SEGM") + 30
    data[index] ^= 1
    bad = tmp_path / "bad.touch"
    bad.write_bytes(data)
    with open_file(bad) as stream, pytest.raises(FormatError, match="CRC-32"):
        stream.medium[0]


def test_python_decodes_from_the_frame_that_the_core_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
    with open_file(voxels()) as plain:
        count = plain.reader.segments[0].frame_count
        expected = [plain.medium[i] for i in range(count)]
    frame = expected[0]
    numbers = np.ravel_multi_index(frame.bricks.T, frame.grid.brick_shape).astype(np.uint32)
    # in any order, with an empty brick; twice as large, to distinguish it from Python's frames
    empty, expected[0] = (
        np.setdiff1d(np.arange(math.prod(frame.grid.brick_shape)), numbers)[:1],
        frame.scaled(2),
    )
    forces = np.concatenate([np.zeros_like(frame.forces_n[:1]), 2 * frame.forces_n[::-1]])
    native_frame = np.append(empty, numbers[::-1]).astype(np.uint32), forces

    class Core:
        open = frames = staticmethod(lambda *given: iter([tuple(part.tobytes() for part in native_frame)]))

        @staticmethod
        def next(frames: Iterator[Any]) -> Any:
            for frame_bytes in frames:
                return frame_bytes
            raise ValueError("bytes that contradict themselves")

    monkeypatch.setattr(native_decoder, "_core", lambda: Core)
    with open_file(voxels()) as native:
        assert native.is_native and [native.medium[i] for i in range(count)] == expected


def test_invalid_files_are_refused_with_a_message(core: Any) -> None:
    assert core.open(b"something else") is None
    with pytest.raises(ValueError, match="PyCapsule"):
        core.frames(None, 0)
    with pytest.raises(ValueError, match="a segment that there is not"):
        core.frames(core.open(voxels().read_bytes()), 4096)


def test_decode_compiles_no_kernel(folder: Path, tmp_path: Path) -> None:
    stream = voxels()
    program = (
        "import sys; from touchfield.cli.main import run\n"
        f"try: run(['decode', {str(stream)!r}, {str(tmp_path / 'field.npz')!r}])\n"
        "except SystemExit as end: sys.exit(end.code or 'numba' in sys.modules)"
    )
    env = {**os.environ, "PYTHONPATH": str(folder)}
    subprocess.run([sys.executable, "-c", program], env=env, check=True)
    assert (tmp_path / "field.npz").exists()
