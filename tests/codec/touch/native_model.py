"""Parts of the coder by themselves, by ctypes: bits, lattices, the error bound, base layers (`model.c`)."""

from __future__ import annotations

import ctypes
import functools
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from touchfield.codec.touch import base_layer_fit
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import ForceField, Grid

ROOT = Path(__file__).resolve().parents[3]
sys.path += [str(ROOT / "tests" / "conformance"), str(ROOT / "build_backend")]

import compiler  # noqa: E402
from native_encoder import (  # noqa: E402
    CArena,
    CBytes,
    CSamples,
    CSource,
    CSpline,
    Source,
    c_grid,
    c_options,
)

SPLINE, COLUMNS = 0, 1
_ERRORS = {2: TruncatedFile, 3: CorruptFile, 5: MemoryError}
_BYTES = 64 << 20


class _Steps(ctypes.Structure):
    _fields_ = [
        ("unit_n", ctypes.c_float),
        *((name, ctypes.c_int64) for name in ("floor", "rate", "cross_floor", "cross_rate")),
        ("border", ctypes.POINTER(ctypes.c_int32)),
        ("borders", ctypes.c_int64),
    ]


class _Comparison(ctypes.Structure):
    _fields_ = [
        ("outlier", ctypes.POINTER(ctypes.c_uint64)),
        ("outliers", ctypes.c_uint64),
        ("max_ratio", ctypes.c_double),
        ("voxel", ctypes.c_uint32 * 3),
        ("within", ctypes.c_uint64),
        ("decoded", ctypes.c_uint64),
        ("are_sent", ctypes.c_int),
    ]


class _Layer(ctypes.Structure):
    _fields_ = [
        ("bytes", ctypes.c_void_p),
        *((name, ctypes.c_uint64) for name in ("size", "bricks")),
        *((name, ctypes.c_void_p) for name in ("key", "v")),
    ]


@functools.cache
def library() -> Any:
    """The compiled `model.c`."""
    try:
        command = compiler.find_compiler()
    except compiler.NoCompiler as error:
        pytest.skip(str(error))
    out = Path(tempfile.mkdtemp()) / "libmodel.so"
    source = Path(__file__).with_name("model.c")
    options = ("-std=c99", "-O1", "-ffp-contract=off", "-shared", "-fPIC", f"-I{ROOT / 'c'}")
    subprocess.run([*command, *options, "-o", str(out), str(source), "-lm"], check=True)
    c: Any = ctypes.CDLL(str(out))
    i64, f64, pointer = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
    for name, result, arguments in (
        ("root", i64, [i64]),
        ("border", i64, [i64, i64, CArena, pointer]),
        ("level_of", i64, [pointer, i64]),
        ("length_of", i64, [pointer, i64]),
        ("basis", None, [pointer, i64, i64, i64, pointer, pointer]),
        ("lattice", None, [pointer, f64, pointer]),
        ("fractions", None, [pointer, pointer]),
        ("scan", None, [ctypes.c_int, *[pointer] * 5]),
        ("compare", ctypes.c_int, [pointer] * 4 + [ctypes.c_int, CArena, pointer]),
        ("columns", ctypes.c_int, [pointer, pointer, f64, f64, f64, CArena, pointer]),
        ("spline", ctypes.c_int, [pointer, pointer, pointer, CArena, pointer]),
        ("read", ctypes.c_int, [pointer, CBytes, CArena, pointer, pointer]),
        ("write_bits", ctypes.c_int, [pointer, ctypes.c_uint64, pointer, CArena, pointer, pointer, pointer]),
        ("read_bits", None, [pointer, ctypes.c_uint64, CBytes, CArena, pointer, pointer, pointer]),
        ("tables", None, [pointer, pointer]),
        ("write_list", ctypes.c_int, [pointer, pointer, pointer, CArena, pointer]),
        ("read_list", ctypes.c_int, [pointer, CBytes, pointer, CArena, pointer, pointer, pointer]),
    ):
        function = getattr(c, f"model_{name}")
        function.restype, function.argtypes = result, arguments
    return c


class _Memory:
    """An arena of C."""

    def __init__(self, size: int = _BYTES) -> None:
        self.array = np.empty(size, np.uint8)
        self.arena = CArena(self.array.ctypes.data, size, 0, 0)


def _view(data: bytes) -> CBytes:
    return CBytes(ctypes.cast(ctypes.c_char_p(data), ctypes.c_void_p), len(data))


# -- bits --------------------------------------------------------------------------------------------------

CODE, MIX, EVEN, GAMMA = range(4)
CONTEXTS, MAX_INPUTS = 64, 4


class Coded(NamedTuple):
    """What a script of calls has left: its values, bytes that are coded, contexts and weights."""

    values: np.ndarray
    position: int
    models: bytes


_MODELS_BYTES = 8 * CONTEXTS + 8 * 3 * 5 * 4


def write_bits(calls: np.ndarray, values: np.ndarray) -> tuple[Coded, bytes]:
    """Write values by calls int64 [n, 3]: a function, and two arguments."""
    calls, values = np.ascontiguousarray(calls, np.int64), np.ascontiguousarray(values, np.int64)
    models, out, position = np.zeros(_MODELS_BYTES, np.uint8), CBytes(), ctypes.c_uint64()
    pointers = calls.ctypes.data, len(calls), values.ctypes.data
    memory = _Memory((1 << 16) + 256 * len(calls))
    last = models.ctypes.data, ctypes.byref(out), ctypes.byref(position)
    assert library().model_write_bits(*pointers, memory.arena, *last)
    return Coded(values, position.value, models.tobytes()), ctypes.string_at(out.bytes, out.size)


def read_bits(calls: np.ndarray, data: bytes) -> Coded:
    """The inverse of `write_bits`."""
    calls, values = np.ascontiguousarray(calls, np.int64), np.zeros(len(calls), np.int64)
    models, position, memory = np.zeros(_MODELS_BYTES, np.uint8), ctypes.c_uint64(), _Memory(1 << 16)
    last = models.ctypes.data, values.ctypes.data, ctypes.byref(position)
    library().model_read_bits(calls.ctypes.data, len(calls), _view(data), memory.arena, *last)
    return Coded(values, position.value, models.tobytes())


def logistic_tables() -> tuple[np.ndarray, np.ndarray]:
    """The tables of the logistic function, int32 [6143], and of its inverse, int32 [4096]."""
    squash, stretch = np.zeros(6143, np.int32), np.zeros(4096, np.int32)
    library().model_tables(squash.ctypes.data, stretch.ctypes.data)
    return squash, stretch


class _List(ctypes.Structure):
    _fields_ = [("key", ctypes.c_void_p), ("count", ctypes.c_uint64)]


def _list_arguments(
    brick_shape: Sequence[int], *lists: np.ndarray | None
) -> tuple[Any, list[Any], list[Any]]:
    """Samples of a grid of such a shape in bricks, lists for C, and the arrays they point into."""
    shape = (ctypes.c_uint32 * 3)(*(8 * n for n in brick_shape))
    arrays = [np.ascontiguousarray([] if a is None else a, np.int32).reshape(-1, 3) for a in lists]
    return shape, [ctypes.byref(CSamples(len(a), a.ctypes.data, None)) for a in arrays], arrays


def write_list(brick_shape: Sequence[int], bricks: np.ndarray, before: np.ndarray | None = None) -> bytes:
    """The code of a list of bricks, followed by a bit that is 1."""
    shape, (own, known), arrays = _list_arguments(brick_shape, bricks, before)
    out, memory = CBytes(), _Memory((4 << 20) + 2048 * sum(map(len, arrays)))
    assert not library().model_write_list(shape, own, known, memory.arena, ctypes.byref(out))
    return ctypes.string_at(out.bytes, out.size)


def read_list(
    data: bytes, brick_shape: Sequence[int], before: np.ndarray | None = None, memory_bytes: int = _BYTES
) -> tuple[np.ndarray, int]:
    """The list, and the bit after it; CorruptFile for other bytes, MemoryError if the memory is too small."""
    shape, (known,), _arrays = _list_arguments(brick_shape, before)
    out, bit, text, memory = _List(), ctypes.c_int32(), ctypes.c_char_p(), _Memory(memory_bytes)
    last = ctypes.byref(out), ctypes.byref(bit), ctypes.byref(text)
    code = library().model_read_list(shape, _view(data), known, memory.arena, *last)
    if code:
        raise _ERRORS[code]("list of bricks", (text.value or b"").decode())
    return _bricks_of_keys(out.key, out.count), bit.value


def _bricks_of_keys(key: int, count: int) -> np.ndarray:
    keys = np.frombuffer(ctypes.string_at(key, 8 * count), np.uint64).astype(np.int64)
    bricks = np.stack([(keys >> 42) - 8, (keys >> 21 & 0x1FFFFF) - 8, (keys & 0x1FFFFF) - 8], axis=1)
    return bricks.astype(np.int32)


# -- lattices ----------------------------------------------------------------------------------------------


class StepTable:
    """Lengths in 1/256 units at each sixteenth of a step, int64 [n], and the map between both."""

    def __init__(self, floor: int, rate: int) -> None:
        self._memory, self._steps = _Memory(1 << 20), _Steps()
        count = library().model_border(floor, rate, self._memory.arena, ctypes.byref(self._steps))
        assert count > 0
        self.border = np.ctypeslib.as_array(self._steps.border, (count,)).astype(np.int64)

    def level_of(self, length: int) -> int:
        """The level of a length, in 1/256 steps."""
        return int(library().model_level_of(ctypes.byref(self._steps), length))

    def length_of(self, level: int) -> int:
        """The inverse."""
        return int(library().model_length_of(ctypes.byref(self._steps), level))


@dataclass(frozen=True)
class SegmentLattice:
    """The lattice that an encoder selects, and the bound of its passes in units."""

    unit_n: float
    floor: int
    rate: int
    cross_floor: int
    cross_rate: int
    k: float
    f0: float


def lattice_for(spec: TouchSpec, longest_n: float) -> SegmentLattice:
    """The lattice of a segment with such a longest force."""
    out = np.zeros(7)
    library().model_lattice(ctypes.byref(c_options(spec)), longest_n, out.ctypes.data)
    return SegmentLattice(out[0], *map(int, out[1:5]), *out[5:])


def lattice_of(frame: ForceField, **options: Any) -> SegmentLattice:
    """The lattice of a field, by default with the default options."""
    lengths = np.linalg.norm(frame.forces_n.astype(np.float64), axis=-1)
    return lattice_for(TouchSpec(**options), float(lengths.max(initial=0)))


def root(n: int) -> int:
    """The largest number whose square is at most n."""
    return int(library().model_root(n))


def axes_and_vector(centre: Sequence[int], along: int, b: int, c: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along and across a vector, in 1/16384, and the vector of three components."""
    axes, vector, start = np.zeros((3, 3), np.int64), np.zeros(3, np.int32), np.array(centre, np.int32)
    library().model_basis(start.ctypes.data, along, b, c, axes.ctypes.data, vector.ctypes.data)
    return axes, vector.astype(np.int64)


class Scan(NamedTuple):
    """An order of the scan: samples of the grid in it, [8, 8, 8]; a brick in it; samples within the grid."""

    sample: np.ndarray
    brick: np.ndarray
    low: np.ndarray
    high: np.ndarray


def scan_of(order: int, grid: Grid, brick: Sequence[int]) -> Scan:
    """The scan of a brick of a grid."""
    sample, to, inside = np.zeros((8, 8, 8), np.int32), np.zeros(3, np.int32), np.zeros((2, 3), np.int32)
    given = np.array(brick, np.int32)
    pointers = (array.ctypes.data for array in (given, sample, to, inside))
    library().model_scan(order, ctypes.byref(c_grid(grid)), *pointers)
    return Scan(sample, to, *inside)


def bit_fractions(bits: tuple[float, float, float]) -> tuple[int, int]:
    """Fractions of a payload for support and amplitude, in 1/255."""
    given, out = np.array(bits), np.zeros(2, np.uint8)
    library().model_fractions(given.ctypes.data, out.ctypes.data)
    return int(out[0]), int(out[1])


# -- the error bound ---------------------------------------------------------------------------------------


class Comparison(NamedTuple):
    """A decoded frame compared with its original by the encoder."""

    keys: np.ndarray
    samples: np.ndarray
    max_error_ratio: float
    voxel: tuple[int, int, int]
    within_bound: int
    decoded: int
    violations: int


def compare_frames(
    original: ForceField, decoded: ForceField, spec: TouchSpec, is_prediction: bool = False
) -> Comparison:
    """Compare a decoded frame with its original as the encoder does."""
    sources = [Source(f, spec) for f in (original, decoded)]
    out, memory = _Comparison(), _Memory()
    arguments = [ctypes.byref(x) for x in (c_grid(original.grid), c_options(spec), *(s.c for s in sources))]
    assert library().model_compare(*arguments, int(is_prediction), memory.arena, ctypes.byref(out))
    is_listed = out.outliers and spec.mode != "lossless"
    listed = np.ctypeslib.as_array(out.outlier, (out.outliers,)) if is_listed else np.zeros(0, np.uint64)
    numbers, voxel = listed.astype(np.int64), (int(out.voxel[0]), int(out.voxel[1]), int(out.voxel[2]))
    counts = out.within, out.decoded, out.outliers
    return Comparison(numbers >> 9, numbers & 511, out.max_ratio, voxel, *counts)


def fraction_within_bound(original: ForceField, prediction: ForceField, spec: TouchSpec) -> float:
    """Fraction of the voxels with a force in either field that a prediction brings within the bound."""
    found = compare_frames(original, prediction, spec, is_prediction=True)
    return found.within_bound / (found.within_bound + found.violations) if found.violations else 1.0


# -- base layers -------------------------------------------------------------------------------------------


class Layer(NamedTuple):
    """A base layer: bricks int32 [n, 3], and vectors int32 [n, 8, 8, 8, 3], units."""

    bricks: np.ndarray
    vectors: np.ndarray

    def field(self, grid: Grid, unit_n: float) -> ForceField:
        """The forces in newtons."""
        forces = self.vectors.astype(np.float32) * np.float32(unit_n)
        has_force = forces.any(axis=(1, 2, 3, 4))
        return ForceField(grid, self.bricks[has_force], forces[has_force])


def _layer_of(layer: _Layer) -> Layer:
    count = layer.bricks
    size = 512 * 3 * 4
    vectors = np.frombuffer(ctypes.string_at(layer.v, size * count), np.int32).reshape(count, 8, 8, 8, 3)
    return Layer(_bricks_of_keys(layer.key, count), vectors)


def _fitted(found: int, layer: _Layer) -> tuple[bytes, Layer] | None:
    if found < 0:
        raise AssertionError(f"code {-found}")
    return (ctypes.string_at(layer.bytes, layer.size), _layer_of(layer)) if found else None


def fit_columns(frame: ForceField, **options: Any) -> tuple[bytes, Layer] | None:
    """Columns of a frame with the given options: their bytes with the kind in front, and the base layer."""
    lattice, source = lattice_of(frame, **options), Source(frame, TouchSpec())
    out, memory = _Layer(), _Memory(256 << 20)
    k, f0 = lattice.k, 0.35 * lattice.floor if options.get("mode") == "nmse" else lattice.f0
    arguments = ctypes.byref(c_grid(frame.grid)), ctypes.byref(source.c), lattice.unit_n, k, f0
    return _fitted(library().model_columns(*arguments, memory.arena, ctypes.byref(out)), out)


def fit_spline(frame: ForceField, level: int = 3, **options: Any) -> tuple[bytes, Layer] | None:
    """The same for a spline."""
    lattice = lattice_of(frame, **options)
    k, f0 = lattice.k, 0.35 * lattice.floor if options.get("mode") == "nmse" else lattice.f0
    fitted = base_layer_fit.fit_spline(frame, level, lattice.unit_n, k, f0)
    return None if fitted is None else code_spline(frame.grid, frame.bricks, fitted)


def code_spline(grid: Grid, bricks: np.ndarray, spline: Any) -> tuple[bytes, Layer] | None:
    """The bytes of a spline over bricks, with the kind in front, and its base layer."""
    shifts, step, scales, coefficients = spline
    values, triple = np.ascontiguousarray(coefficients, np.float64), ctypes.c_int64 * 3
    c_spline = CSpline((ctypes.c_int32 * 3)(*shifts), step, triple(*scales), values.ctypes.data, values.size)
    source, out, memory = np.ascontiguousarray(bricks, np.int32), _Layer(), _Memory()
    frame = CSource(len(source), source.ctypes.data, None, None)
    arguments = ctypes.byref(c_grid(grid)), ctypes.byref(frame), ctypes.byref(c_spline)
    return _fitted(library().model_spline(*arguments, memory.arena, ctypes.byref(out)), out)


def decode_base_layer(data: bytes, grid: Grid, memory_bytes: int = _BYTES) -> Layer:
    """Decode a base layer, with the kind in front; CorruptFile or TruncatedFile if the bytes are invalid."""
    out, memory, text = _Layer(), _Memory(memory_bytes), ctypes.c_char_p()
    arguments = ctypes.byref(c_grid(grid)), _view(data), memory.arena, ctypes.byref(out), ctypes.byref(text)
    code = library().model_read(*arguments)
    if code < 0:
        raise _ERRORS[-code]("base layer", (text.value or b"").decode())
    return _layer_of(out)
