"""`touchfield._native`, built here: its arguments and errors, and CPython as its declarations have it."""

from __future__ import annotations

import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from second import CONFORMANCE, GOLDEN

from touchfield.codec.touch.body import BodyReader, write_body
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid

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
def native(path: Path) -> Any:
    """The loaded module, another one than that of the package."""
    spec = spec_from_file_location("touchfield._native", path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
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
    printf("%d %d %d %d\\n", METH_VARARGS, METH_O, METH_NOARGS, METH_FASTCALL);
    printf("%d %d\\n", PyBUF_SIMPLE, PyBUF_WRITABLE);
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


def test_a_build_without_a_compiler_fails_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    hook = pytest.importorskip("hook")

    def fail(*_: Any) -> None:
        raise compiler.NoCompiler("no C compiler works")

    monkeypatch.setattr(hook, "_PACKAGE", tmp_path)
    monkeypatch.setattr(hook, "compile_module", fail)
    old = tmp_path / "_native.abi3.so"
    old.touch()
    build = hook.NativeModule.__new__(hook.NativeModule)
    for version, is_there in (("standard", True), ("editable", False)):
        with pytest.raises(SystemExit, match=r"no C compiler works.*pip install ziglang"):
            build.initialize(version, {})
        assert old.exists() == is_there  # a module of other sources would be imported; a wheel is apart


GRID = Grid((20, 17, 13), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))
OPTIONS = (0, 0, 0, 1, 1, 0.1, 0.05, 18.4, 0.05)


def field_of(seed: int, grid: Grid = GRID) -> ForceField:
    """A smooth field with some noise."""
    x, y, z = np.indices(grid.shape)
    depth = np.clip(z - 4 - np.sin((x + seed) / 5) - np.cos(y / 4), 0, 5)
    noise = 1 + np.random.default_rng(seed).normal(0, 0.02, grid.shape)
    return ForceField.from_dense(
        grid, ((0.3 * depth * noise)[..., None] * [0.1, 0.2, -1.0]).astype(np.float32)
    )


def arrays(frame: ForceField) -> tuple[Any, Any, None]:
    """A frame for the module."""
    return frame.bricks, frame.forces_n, None


FRAMES = [field_of(i) for i in range(3)]
SCENE = GRID.shape, GRID.spacing_m, OPTIONS
ENCODER = TouchEncoder(GRID, TouchSpec())
BODY = ENCODER.encode_segment(FRAMES).body


def encode(native: Any, frames: Any, longest_n: float | None = None, fit: Any = None) -> bytes:
    """The body of frames."""
    body: bytes = native.encode_segment(*SCENE, frames, None, longest_n, fit)[0]
    return body


def decode(native: Any, body: bytes, count: int = 3, shape: tuple[int, int, int] = GRID.shape) -> list[bytes]:
    """The forces of frames."""
    fields = native.open_fields(shape, ENCODER.parameters, body, count)
    return [forces for _, forces in iter(lambda: native.next_field(fields), None)]


def assert_refused(code: int, text: str, call: Callable[[], Any]) -> None:
    """A call raises the code and the text."""
    with pytest.raises(ValueError, match=text) as found:
        call()
    assert found.value.args[0] == code and len(found.value.args) == 2


def test_segments_are_those_of_the_package(native: Any) -> None:
    assert encode(native, [arrays(f) for f in FRAMES]) == BODY
    decoded = TouchDecoder(GRID, ENCODER.parameters).frames(BODY, 3)
    assert decode(native, BODY) == [f.forces_n.tobytes() for f in decoded]


def test_a_stated_limit_of_forces_encodes_each_frame_before_the_next_is_taken(native: Any) -> None:
    """In a second arena, too, once a frame has more bricks than the ones before."""
    rng, order = np.random.default_rng(1), list[str]()
    grid = Grid((64, 64, 64), (0.001,) * 3, (0.0,) * 3)
    fields = [
        field_of(0, grid),
        ForceField.from_dense(grid, rng.normal(0, 1, (*grid.shape, 3)).astype(np.float32)),
    ]
    small = ForceField(grid, fields[0].bricks[:2], fields[0].forces_n[:2])
    fields = [small, fields[0], fields[1], small]

    def arriving() -> Iterator[Any]:
        for i, frame in enumerate(fields):
            order.append(f"frame {i}")
            yield arrays(frame)

    def fit(frame: int, level: int, *_: float) -> None:
        order.append(f"fit {frame}")

    scene = grid.shape, grid.spacing_m, OPTIONS
    body, decoded, _ = native.encode_segment(*scene, arriving(), None, 9.0, fit)
    assert body == TouchEncoder(grid, TouchSpec()).encode_segment(fields, longest_n=9.0).body
    assert body == native.encode_segment(*scene, [arrays(f) for f in fields], None, 9.0, None)[0]
    assert order.index("fit 0") < order.index("frame 1") < order.index("frame 2")
    frames = TouchDecoder(grid, ENCODER.parameters).frames(body, 4)
    assert decoded == [frame.support_count for frame in frames]


def test_exceptions_of_callbacks_are_passed_on(native: Any) -> None:
    class Interrupt(Exception):
        """Of a caller."""

    def fit(*_: Any) -> None:
        raise Interrupt("fit")

    def arriving() -> Iterator[Any]:
        yield arrays(FRAMES[0])
        raise Interrupt("frames")

    with pytest.raises(Interrupt, match="fit"):
        encode(native, [arrays(f) for f in FRAMES], None, fit)
    for longest_n in (None, 9.0):
        with pytest.raises(Interrupt, match="frames"):
            encode(native, arriving(), longest_n)


@pytest.mark.parametrize(
    ("spline", "text"),
    [
        (((1, 3, 3), 5, (1, 1, 1), np.zeros(4)), "cannot be coded"),
        (((3, 3, 3), 0, (1, 1, 1), np.zeros(4)), "cannot be coded"),
        (((3, 3, 3), 5, (1, 1, 1 << 20), np.zeros(4)), "cannot be coded"),
        (((3, 3, 3), 5, (1, 1, 1), np.zeros(4)), "other nodes"),
        (((3, 3, 3), 5, (1, 1, 1), np.zeros(9, np.uint8)), "another size"),
    ],
)
def test_splines_that_do_not_fit_are_refused(spline: Any, text: str, native: Any) -> None:
    assert_refused(6, text, lambda: encode(native, [arrays(FRAMES[0])], None, lambda *_: spline))


def test_invalid_arguments_are_refused(native: Any) -> None:
    bricks, forces, _ = arrays(FRAMES[0])
    assert_refused(6, "too many samples", lambda: decode(native, BODY, 3, (0, 8, 8)))
    assert_refused(6, "too many samples", lambda: decode(native, BODY, 3, (1 << 20, 1 << 20, 8)))
    assert_refused(6, "number of frames", lambda: decode(native, BODY, -1))
    assert_refused(6, "another size", lambda: encode(native, [(bricks, forces[:-1], None)]))
    assert_refused(6, "another size", lambda: encode(native, [(bricks.tobytes()[:-1], forces, None)]))
    assert_refused(6, "another size", lambda: encode(native, [(bricks, forces, forces)]))
    assert_refused(6, "ascend", lambda: encode(native, [(bricks[::-1].copy(), forces, None)]))
    assert_refused(6, "beyond the grid", lambda: encode(native, [(bricks + np.int32(9), forces, None)]))
    assert_refused(6, "not finite", lambda: encode(native, [(bricks, forces * np.float32(np.nan), None)]))
    assert_refused(6, "no frames", lambda: encode(native, []))
    assert_refused(6, "no frames", lambda: encode(native, iter(()), 1.0))
    modes = (GRID.shape, GRID.spacing_m, (4, *OPTIONS[1:]), [], None, None, None)
    assert_refused(6, "a mode that there is not", lambda: native.encode_segment(*modes))
    samples = [np.zeros(0, np.uint64)] * 2
    exact = (*SCENE, BODY, [arrays(f) for f in FRAMES], samples)
    assert_refused(6, "another number of frames", lambda: native.add_exact_samples(*exact))
    for numbers, text in (
        ([3, 3], "do not ascend"),
        ([7, 2], "do not ascend"),
        ([5 * 512 + 7], "beyond the grid"),  # z = 8 + 7
        ([18 * 512], "beyond the grid"),
        ([1 << 63], "beyond the grid"),
    ):
        own = [np.array(numbers, np.uint64), *samples]
        exact = (*SCENE, BODY, [arrays(f) for f in FRAMES], own)
        assert_refused(6, text, lambda exact=exact: native.add_exact_samples(*exact))
    with pytest.raises(ValueError, match="contiguous"):
        encode(native, [(bricks, forces[:, ::2], None)])
    for arguments in ((), (None, b"", b"", 1), (GRID.shape, 1, b"", 1), (GRID.shape, b"", b"", "1")):
        with pytest.raises((TypeError, SystemError)):
            native.open_fields(*arguments)
    with pytest.raises(ValueError, match="PyCapsule"):
        native.next_field(None)


def test_invalid_arguments_of_parts_are_refused(native: Any) -> None:
    bricks, mask = np.zeros((1, 3), np.int32), np.ones((1, 8, 8, 8), np.uint8)
    coded, shape = native.encode_support((8, 8, 8), (bricks, mask), None), (8, 8, 8)
    assert native.decode_support(shape, coded, None) == (bricks.tobytes(), mask.tobytes())
    any_byte = native.encode_support(shape, (bricks, 7 * mask), (bricks, 255 * mask))  # but 0 is a sample
    assert any_byte == native.encode_support(shape, (bricks, mask), (bricks, mask))
    assert native.decode_support(shape, bytearray(any_byte), (bricks, 255 * mask))[1] == mask.tobytes()
    for call, text in (
        (lambda: native.encode_support((0, 8, 8), (bricks, mask), None), "too many samples"),
        (lambda: native.encode_support(shape, (bricks, mask[:0]), None), "another size"),
        (lambda: native.encode_support(shape, (bricks, mask), (bricks[:0], mask)), "another size"),
        (lambda: native.encode_support(shape, (bricks + np.int32(1), mask), None), "beyond the grid"),
        (lambda: native.decode_support(shape, coded, (bricks - np.int32(1), mask)), "beyond the grid"),
        (lambda: native.encode_numbers(np.zeros(9, np.int32)), "another size"),
        (lambda: native.encode_poses(np.zeros(8, np.int64)), "another size"),
        (lambda: native.encode_poses(b""), "no poses"),
        (lambda: native.decode_numbers(b"", -1), "a number of numbers"),
        (lambda: native.decode_poses(b"", -1, 4), "a number of numbers"),
        (lambda: native.decode_poses(b"", 0, 4), "no poses"),
        (lambda: native.decode_poses(b"", 1, 3), "a quaternion step"),
        (lambda: native.decode_poses(b"", 1, (1 << 30) + 1), "a quaternion step"),
        (lambda: native.encode_vibration(shape, [(bricks, b"", b"")]), "another size"),
        (lambda: native.decode_vibration(shape, b"", -1, 1), "a number of frames"),
        (lambda: native.decode_vibration(shape, b"", 1, -1), "a number of frames or of samples"),
    ):
        assert_refused(6, text, call)
    ones = np.ones(1, np.float32)
    body = native.encode_vibration(shape, [(bricks, ones, ones)] * 2)
    assert len(native.decode_vibration(shape, body, 2, 2)) == 2
    assert_refused(8, "more samples", lambda: native.decode_vibration(shape, body, 2, 1))
    assert native.encode_vibration(shape, []) == b"" and native.decode_vibration(shape, b"", 0, 0) == []
    for wrong in ((shape, (bricks,), None), (shape, None, None), (None, (bricks, mask), None), ()):
        with pytest.raises((TypeError, SystemError)):
            native.encode_support(*wrong)
    for call in (native.encode_numbers, native.encode_poses):
        with pytest.raises(TypeError):
            call(None)
    with pytest.raises(TypeError):
        native.encode_vibration(shape, 3)
    with pytest.raises((TypeError, SystemError)):
        native.encode_vibration(shape, [None])


def test_a_part_that_needs_more_memory_than_most_is_decoded(native: Any) -> None:
    """The memory at first is for few bricks; an unchanged frame has many in few bytes."""
    shape, bricks = (256, 256, 256), np.argwhere(np.ones((32, 32, 32))).astype(np.int32, "C")
    mask = np.ones((len(bricks), 8, 8, 8), np.uint8)
    coded = native.encode_support(shape, (bricks, mask), None)
    assert len(coded) < 2100 and native.decode_support(shape, coded, None) == (
        bricks.tobytes(),
        mask.tobytes(),
    )
    positions = np.argwhere(np.ones((80, 80, 80))).astype(np.int32, "C")
    ones = np.ones(len(positions), np.float32)
    body = native.encode_vibration(shape, [(positions, ones, ones)] * 2)
    assert [found[0] for found in native.decode_vibration(shape, body, 2, 1 << 30)] == [
        positions.tobytes()
    ] * 2


def test_damaged_bytes_are_refused_and_end_the_segment(native: Any) -> None:
    assert_refused(2, "too early", lambda: decode(native, BODY[:-9]))
    assert_refused(3, "behind the last frame", lambda: decode(native, BODY + b"x"))
    assert_refused(
        4, "version", lambda: native.open_fields(GRID.shape, b"\2" + ENCODER.parameters[1:], BODY, 3)
    )
    reader = BodyReader(BODY, GRID, exact=False)
    *others, last = reader.records(3)
    cut = write_body(reader.lattice, [*others, replace(last, payload=last.payload[:-9])], reader.max_error)
    fields = native.open_fields(GRID.shape, ENCODER.parameters, cut, 3)
    assert native.next_field(fields) is not None
    with pytest.raises(ValueError, match="too early"):
        list(iter(lambda: native.next_field(fields), None))
    assert native.next_field(fields) is None


def test_a_segment_that_needs_more_memory_is_decoded_from_its_start_again(native: Any) -> None:
    """The memory at first is for some 5000 bricks; here the second frame has many more."""
    grid = Grid((256, 256, 160), (0.001,) * 3, (0.0,) * 3)
    few = ForceField.from_support(grid, [[3, 4, 5], [200, 4, 5]], [[0, 0, 1], [0, 2, 0]])
    many = ForceField.from_dense(grid, np.broadcast_to(np.float32([0, 1, 2]), (*grid.shape, 3)))
    encoder = TouchEncoder(grid, TouchSpec(effort="fast", guess="off"))
    body = encoder.encode_segment([few, many, few]).body
    fields = native.open_fields(grid.shape, encoder.parameters, body, 3)
    bricks = [
        np.frombuffer(b, np.int32).reshape(-1, 3) for b, _ in iter(lambda: native.next_field(fields), None)
    ]
    assert [len(b) for b in bricks] == [2, 20480, 2] and (bricks[0] == few.bricks).all()


def test_other_threads_run_meanwhile(native: Any) -> None:
    """A thread counts while C encodes in another one."""
    grid = Grid((64, 64, 64), (0.001,) * 3, (0.0,) * 3)
    noise = np.random.default_rng(1).normal(0, 1, (*grid.shape, 3)).astype(np.float32)
    frame, done = ForceField.from_dense(grid, noise), threading.Event()
    arguments = grid.shape, grid.spacing_m, OPTIONS, [arrays(frame)], None, None, None
    worker = threading.Thread(target=lambda: (native.encode_segment(*arguments), done.set()))
    worker.start()
    count = 0
    while not done.is_set():
        count += 1
        time.sleep(0.001)
    worker.join()
    assert count > 20


def test_an_install_without_the_module_says_what_to_do(tmp_path: Path) -> None:
    code = "import sys; sys.modules['touchfield._native'] = None; import touchfield.codec.touch.decoder"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode and "pip install ziglang" in done.stderr.splitlines()[-1]


def test_decode_compiles_no_kernel(tmp_path: Path) -> None:
    stream = next(path for path in GOLDEN if path.stem == "touch-mask")
    program = (
        "import sys\n"
        "from touchfield.cli.main import run\n"
        f"try: run(['decode', {str(stream)!r}, {str(tmp_path / 'field.npz')!r}])\n"
        "except SystemExit as end: sys.exit(end.code or 'numba' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
    assert (tmp_path / "field.npz").exists()


def test_kernels_in_c_refuse_arrays_of_another_size(native: Any) -> None:
    """Each would read or write beyond an array."""
    brick, keys = np.zeros((1, 8, 8, 8, 3), np.float32), np.zeros(1, np.int64)
    two, flag = np.zeros((2, 8, 8, 8, 3), np.float32), np.zeros(1, np.bool_)
    axis = np.zeros(8, np.int64), np.ones((8, 1), np.float32)
    source, bricks = ((8, 8, 8), keys, brick), np.zeros((1, 3), np.int32)
    triple, points = (1.0, 1.0, 1.0), np.zeros((2, 3))
    native.resample_bricks(0, 1, bricks, source, (axis,) * 3, brick.copy(), flag)
    calls: list[Callable[[], object]] = [
        lambda: native.limit_bricks(0, 2, brick, 1.0, 0.0, brick.copy(), flag),
        lambda: native.limit_bricks(0, 1, brick, 1.0, 0.0, two, flag),
        lambda: native.resample_bricks(0, 1, bricks + 1, source, (axis,) * 3, brick.copy(), flag),
        lambda: native.resample_bricks(0, 1, bricks, ((8, 8, 8), keys, two), (axis,) * 3, brick.copy(), flag),
        lambda: native.resample_bricks(
            0, 1, bricks, source, ((axis[0][:3], axis[1]),) * 3, brick.copy(), flag
        ),
        lambda: native.move_to_level(points, (8, 8, 8), triple, triple, keys, two, 1.0, 1.0, 1, np.zeros(2)),
        lambda: native.move_to_level(points, (8, 8, 8), triple, triple, keys, brick, 1.0, 1.0, 1, flag),
        lambda: native.adpcm(np.zeros(2, np.int64), np.zeros(3, np.int64), True),
        lambda: native.ellipsoid_roots(points, triple, np.zeros(3)),
        lambda: native.decode_huffman(b"", keys, keys, keys, 1, flag, np.zeros(4, np.uint16)),
        lambda: native.bound_cells(0, 1, brick, brick, (0.1, 0.1, 0.0, 1.0), np.zeros((1, 512), np.float32)),
    ]
    for call in calls:
        with pytest.raises(ValueError, match=r"\(6, "):
            call()


def test_brick_keys_end_with_their_array(native: Any) -> None:
    spans, out = np.array([[[0, 2], [0, 2], [1, 3]]]), np.full(6, -1, np.int64)
    native.brick_keys(spans, (2, 2, 4), out[:5].copy())
    native.brick_keys(spans, (2, 2, 4), out)
    assert out.tolist() == [1, 2, 5, 6, 9, 10]


def test_bits_of_no_code_are_refused(native: Any) -> None:
    limits, ranks = np.zeros(25, np.int64), np.zeros(25, np.int64)
    sent, levels = np.zeros(4, np.bool_), np.zeros(4, np.uint16)
    assert native.decode_huffman(b"\xff", limits, ranks, b"", 1, sent, levels) == (-1, -1)
    limits[1:] = 1 << 24  # every code has one bit, and its symbol is not there
    assert native.decode_huffman(b"\xff", limits, ranks, b"", 1, sent, levels) == (-1, -1)
