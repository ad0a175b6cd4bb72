"""`touchfield._native`, built here: bit-exact frames of every golden file, without compiling kernels."""

from __future__ import annotations

import math
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
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
STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Werror", "-O2", "-fPIC", "-shared")
PYTHON_H = Path(sysconfig.get_path("include")) / "Python.h"

sys.path.insert(0, str(ROOT / "build_backend"))
compiler = pytest.importorskip("compiler")

try:
    COMMAND = compiler.find_compiler()
except compiler.NoCompiler as no_compiler:
    pytest.skip(str(no_compiler), allow_module_level=True)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The compiled module."""
    return Path(compiler.compile_module(tmp_path_factory.mktemp("native")))


@pytest.fixture
def native(path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The loaded module, used in one test only."""
    spec = spec_from_file_location("touchfield._native", path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(native_decoder, "native_module", lambda: module)
    return module


def test_the_source_has_no_warnings(tmp_path: Path) -> None:
    subprocess.run([*COMMAND, *STRICT, "-o", str(tmp_path / "strict.so"), str(compiler.SOURCE)], check=True)


LAYOUT = """
#include <stdio.h>
#include <stddef.h>
#define FIELD(type, name) printf("%s.%s %zu\\n", #type, #name, offsetof(type, name))
int main(void) {{
    PyModuleDef empty = {{PyModuleDef_HEAD_INIT, "m", NULL, -1, NULL, NULL, NULL, NULL, NULL}};
    printf("%zu %zu %zu\\n", sizeof empty, sizeof(PyMethodDef), sizeof(Py_buffer));
    printf("%d %d %d\\n", METH_VARARGS, METH_O, PyBUF_SIMPLE);
    FIELD(PyModuleDef, m_name); FIELD(PyModuleDef, m_doc); FIELD(PyModuleDef, m_size);
    FIELD(PyModuleDef, m_methods); FIELD(PyModuleDef, m_slots); FIELD(PyModuleDef, m_free);
    FIELD(PyMethodDef, ml_name); FIELD(PyMethodDef, ml_meth); FIELD(PyMethodDef, ml_flags);
    FIELD(PyMethodDef, ml_doc); FIELD(PyObject, ob_refcnt); FIELD(PyObject, ob_type);
    FIELD(Py_buffer, buf); FIELD(Py_buffer, obj); FIELD(Py_buffer, len); FIELD(Py_buffer, itemsize);
    FIELD(Py_buffer, readonly); FIELD(Py_buffer, ndim); FIELD(Py_buffer, format); FIELD(Py_buffer, shape);
    FIELD(Py_buffer, strides); FIELD(Py_buffer, suboffsets); FIELD(Py_buffer, internal);
    return (int)empty.m_size + 1;
}}
"""


@pytest.mark.skipif(not PYTHON_H.exists(), reason="the headers of Python are not installed")
def test_declarations_agree_with_the_headers_of_python(tmp_path: Path) -> None:
    """The layouts are the same, and the source compiles without a warning against Python.h as well."""
    layouts = []
    for name in ("stable_abi.h", "Python.h"):
        source, program = tmp_path / f"{name}.c", tmp_path / f"{name}.out"
        source.write_text(f'#include "{name}"\n' + LAYOUT.format())
        folders = (f"-I{compiler.SOURCE.parent}", f"-I{PYTHON_H.parent}")
        options = ("-DPy_LIMITED_API=0x030b0000", *folders, "-o", str(program))
        subprocess.run([*COMMAND, *options, str(source)], check=True)
        layouts.append(subprocess.run([program], check=True, capture_output=True, text=True).stdout)
    assert layouts[0] == layouts[1] and "PyMethodDef.ml_doc" in layouts[0]
    options = ("-DTOUCHFIELD_PYTHON_H", "-DPy_LIMITED_API=0x030b0000", f"-I{PYTHON_H.parent}")
    out = str(tmp_path / "python_h.so")
    subprocess.run([*COMMAND, *STRICT, *options, "-o", out, str(compiler.SOURCE)], check=True)


def test_the_definition_for_windows_names_what_is_declared() -> None:
    header = compiler.SOURCE.with_name("stable_abi.h").read_text()
    declared = {
        line.split("(")[0].split()[-1].strip(" *;").removesuffix(";")
        for line in header.splitlines()
        if line.startswith("PYTHON_IMPORT")
    }
    exported = {
        line.split()[0]
        for line in compiler.SOURCE.with_name("python3.def").read_text().splitlines()
        if line.startswith("  ")
    }
    assert declared == exported and len(declared) > 10


def test_a_machine_without_a_compiler_needs_ziglang(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("CC", raising=False)
    assert compiler.requirements() == []
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda name: None)
    assert compiler.requirements() == [compiler.ZIGLANG]
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    with pytest.raises(compiler.NoCompiler, match="no C compiler works"):
        compiler.find_compiler()
    monkeypatch.setattr(compiler.importlib.util, "find_spec", lambda name: object())
    assert compiler.find_compiler()[1:] == ["-m", "ziglang", "cc"]


def voxels() -> Path:
    """A golden file of the coder `touch`."""
    for stream in GOLDEN:
        with TouchReader(stream) as reader:
            if reader.head.coder == "touch":
                return stream
    raise AssertionError("there is none")


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_frames_of_golden_files_are_bit_exact(
    stream: Path, native: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_file(stream) as opened:
        is_voxels = opened.reader.head.coder == "touch"
        assert opened.is_native == is_voxels
        medium = opened.medium
        frames = [medium[i] for i in range(len(medium))] if is_voxels else []
    monkeypatch.setattr(native_decoder, "native_module", lambda: None)
    with open_file(stream) as plain:
        assert not plain.is_native
        for n, frame in enumerate(frames):
            expected = plain.medium[n]
            np.testing.assert_array_equal(frame.bricks, expected.bricks)
            assert frame.forces_n.tobytes() == expected.forces_n.tobytes()


def test_damaged_segment_gives_the_error_of_the_python_decoder(native: Any, tmp_path: Path) -> None:
    data = bytearray(voxels().read_bytes())
    index = data.index(b"SEGM") + 30
    data[index] ^= 1
    bad = tmp_path / "bad.touch"
    bad.write_bytes(data)
    with open_file(bad) as stream, pytest.raises(FormatError, match="CRC-32"):
        stream.medium[0]


def test_python_decodes_from_the_frame_that_the_module_refuses(monkeypatch: pytest.MonkeyPatch) -> None:
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

    class Native:
        open = frames = staticmethod(lambda *given: iter([tuple(part.tobytes() for part in native_frame)]))

        @staticmethod
        def next(frames: Iterator[Any]) -> Any:
            for frame_bytes in frames:
                return frame_bytes
            raise ValueError("bytes that contradict themselves")

    monkeypatch.setattr(native_decoder, "native_module", lambda: Native)
    with open_file(voxels()) as native:
        assert native.is_native and [native.medium[i] for i in range(count)] == expected


def test_invalid_files_are_refused_with_a_message(native: Any) -> None:
    assert native.open(b"something else") is None
    with pytest.raises(ValueError, match="PyCapsule"):
        native.frames(None, 0)
    with pytest.raises(ValueError, match="a segment that there is not"):
        native.frames(native.open(voxels().read_bytes()), 4096)


def test_decode_compiles_no_kernel(path: Path, tmp_path: Path) -> None:
    stream = voxels()
    program = (
        "import sys; from importlib.util import module_from_spec, spec_from_file_location\n"
        "import touchfield\n"
        f"spec = spec_from_file_location('touchfield._native', {str(path)!r})\n"
        "module = module_from_spec(spec); spec.loader.exec_module(module)\n"
        "sys.modules['touchfield._native'] = module\n"
        "from touchfield.cli.main import run\n"
        f"try: run(['decode', {str(stream)!r}, {str(tmp_path / 'field.npz')!r}])\n"
        "except SystemExit as end: sys.exit(end.code or 'numba' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    assert (tmp_path / "field.npz").exists()
