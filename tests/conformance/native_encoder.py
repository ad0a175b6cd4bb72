"""`c/touch_encode.h` by ctypes: builds a library, and wraps its functions for the types of the package."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from touchfield.codec.objects.layout import SegmentParts
from touchfield.codec.support import Bricks
from touchfield.codec.touch.base_layer_fit import fit_spline
from touchfield.codec.touch.error_bound import allowed_error_n
from touchfield.codec.touch.spec import MODES, TouchSpec
from touchfield.medium import ForceField, Grid
from touchfield.medium.medium import VibrationFrame

C = Path(__file__).resolve().parents[2] / "c"
COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
_INTER = ("auto", "off", "on")


class CGrid(ctypes.Structure):
    """`touch_grid`."""

    _fields_ = [
        ("shape", ctypes.c_uint32 * 3),
        ("spacing_m", ctypes.c_double * 3),
        ("origin_m", ctypes.c_double * 3),
    ]


class CArena(ctypes.Structure):
    """`touch_arena`."""

    _fields_ = [("base", ctypes.c_void_p), *((name, ctypes.c_uint64) for name in ("size", "used", "peak"))]


class COptions(ctypes.Structure):
    """`touch_options`."""

    _fields_ = [
        *((name, ctypes.c_int32) for name in ("mode", "exact", "interframe", "base_layers", "checked")),
        *((name, ctypes.c_double) for name in ("k", "f0_n", "direction_jnd_deg", "step_n")),
    ]


class CSource(ctypes.Structure):
    """`touch_source`."""

    _fields_ = [
        ("bricks", ctypes.c_uint64),
        *((name, ctypes.c_void_p) for name in ("brick", "forces", "hidden")),
    ]


class CSegment(ctypes.Structure):
    """`touch_segment`."""

    _fields_ = [
        ("body", ctypes.c_void_p),
        ("size", ctypes.c_uint64),
        ("ratio", ctypes.c_double),
        ("frame", ctypes.c_uint32),
        ("voxel", ctypes.c_uint32 * 3),
    ]


class CSpline(ctypes.Structure):
    """`touch_spline`."""

    _fields_ = [
        ("shift", ctypes.c_int32 * 3),
        ("step", ctypes.c_int64),
        ("scale", ctypes.c_int64 * 3),
        ("coefficient", ctypes.c_void_p),
        ("nodes", ctypes.c_uint64),
    ]


class CBytes(ctypes.Structure):
    """`touch_bytes`."""

    _fields_ = [("bytes", ctypes.c_void_p), ("size", ctypes.c_uint64)]


class CSamples(ctypes.Structure):
    """`touch_samples`."""

    _fields_ = [("bricks", ctypes.c_uint64), ("brick", ctypes.c_void_p), ("is_set", ctypes.c_void_p)]


class CVibration(ctypes.Structure):
    """`touch_vibration_samples`."""

    _fields_ = [
        ("samples", ctypes.c_uint64),
        *((name, ctypes.c_void_p) for name in ("position", "amplitude_n", "frequency_hz")),
    ]


class CVibrationSteps(ctypes.Structure):
    """`touch_vibration_steps`."""

    _fields_ = [
        ("samples", ctypes.c_uint64),
        *((name, ctypes.c_void_p) for name in ("position", "step", "hertz")),
    ]


class CExact(ctypes.Structure):
    """`touch_outlier_samples`."""

    _fields_ = [("samples", ctypes.c_uint64), ("sample", ctypes.c_void_p)]


class CBody(ctypes.Structure):
    """`touch_body_part`."""

    _fields_ = [("poses", CBytes), ("fields", CBytes), ("is_deforming", ctypes.c_int32)]


FIXED_ROOM = 1 << 18  # TOUCH_FIXED_ROOM
_FIT = ctypes.CFUNCTYPE(
    ctypes.c_int,
    ctypes.c_void_p,
    ctypes.POINTER(CSource),
    ctypes.c_int,
    *[ctypes.c_double] * 3,
    ctypes.POINTER(CSpline),
)


class CSplineFit(ctypes.Structure):
    """`touch_spline_fit`."""

    _fields_ = [("fit", _FIT), ("self", ctypes.c_void_p)]


class CEncoder(ctypes.Structure):
    """`touch_encoder`."""

    _fields_ = [
        ("writer", ctypes.c_void_p),
        ("error", ctypes.c_char_p),
        *((name, ctypes.c_void_p) for name in ("grow", "self", "decoded")),
    ]


def build(folder: Path, *options: str, source: Path = C / "touch_encode.c") -> Path:
    """`libtouch.so` in a folder, compiled with every warning an error."""
    out = folder / "libtouch.so"
    command = [
        str(COMPILER),
        *STRICT,
        "-shared",
        "-fPIC",
        *options,
        f"-I{C}",
        "-o",
        str(out),
        str(source),
        "-lm",
    ]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    return out


def c_options(spec: TouchSpec) -> COptions:
    """Options for C."""
    return COptions(
        MODES.index(spec.mode), spec.support == "exact", _INTER.index(spec.interframe), spec.guess == "auto",
        spec.effort == "default", spec.k, spec.f0_n, spec.direction_jnd_deg, spec.step_n,
    )  # fmt: skip


def c_grid(grid: Grid) -> CGrid:
    """A grid for C."""
    triple = ctypes.c_double * 3
    return CGrid((ctypes.c_uint32 * 3)(*grid.shape), triple(*grid.spacing_m), triple(*grid.origin_m))


def memory(size: int) -> np.ndarray:
    """Bytes for an arena, never of the small pieces that numpy uses again and a sanitizer still watches."""
    return np.empty(size + 4096, np.uint8)[:size]


def _pointer(array: np.ndarray) -> int | None:
    return array.ctypes.data if array.size else None


def _view(data: bytes | None) -> CBytes:
    """Bytes for C; empty ones have no address."""
    return CBytes(ctypes.cast(ctypes.c_char_p(data or None), ctypes.c_void_p), len(data or b""))


class Source:
    """A frame for C; it keeps the arrays that C looks into."""

    def __init__(self, frame: ForceField, spec: TouchSpec) -> None:
        self.bricks = np.ascontiguousarray(frame.bricks, np.int32)
        self.forces = np.ascontiguousarray(frame.forces_n, np.float32)
        self.hidden = np.ascontiguousarray(allowed_error_n(frame, spec), np.float32)
        pointers = _pointer(self.bricks), _pointer(self.forces), _pointer(self.hidden)
        self.c = CSource(len(self.bricks), *pointers)


class Splines:
    """Splines as the package fits them, for C to ask for."""

    def __init__(self, grid: Grid) -> None:
        self._grid, self._coefficients = grid, np.zeros(0)
        self.c = CSplineFit(_FIT(self._fit), None)

    def _fit(self, _: Any, source: Any, level: int, unit_n: float, k: float, f0: float, out: Any) -> int:
        count = source.contents.bricks
        bricks = np.ctypeslib.as_array(
            ctypes.cast(source.contents.brick, ctypes.POINTER(ctypes.c_int32)), (count, 3)
        )
        forces = ctypes.cast(source.contents.forces, ctypes.POINTER(ctypes.c_float))
        frame = ForceField(self._grid, bricks, np.ctypeslib.as_array(forces, (count, 8, 8, 8, 3)))
        fitted = fit_spline(frame, level, unit_n, k, f0)
        if fitted is None:
            return 0
        shifts, out.contents.step, scales, coefficients = fitted
        out.contents.shift[:], out.contents.scale[:] = shifts, scales
        self._coefficients = np.asarray(coefficients)
        out.contents.coefficient, out.contents.nodes = self._coefficients.ctypes.data, len(self._coefficients)
        return 1


class NativeEncoder:
    """The functions of a library that `build` compiled."""

    def __init__(self, library: Path) -> None:
        self.c: Any = ctypes.CDLL(str(library))
        self.c.touch_encode_room.restype = ctypes.c_uint64
        self.c.touch_encode_room.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint64]
        self.c.touch_segment_room.restype = ctypes.c_uint64
        self.c.touch_segment_room.argtypes = [ctypes.c_uint64, ctypes.c_uint32]
        self.c.touch_part_room.restype = ctypes.c_uint64
        self.c.touch_part_room.argtypes = [ctypes.c_uint64] * 3
        self.c.touch_support_room.restype = ctypes.c_uint64
        self.c.touch_support_room.argtypes = [ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint64]
        self.c.touch_vibration_room.restype = ctypes.c_uint64
        self.c.touch_vibration_room.argtypes = [ctypes.c_void_p, ctypes.c_uint64, ctypes.c_uint32]
        self.c.touch_vibration_frames.restype = ctypes.c_uint32
        self.c.touch_vibration_frames.argtypes = [ctypes.c_uint64, ctypes.c_uint32]
        self.c.touch_longest_n.restype = ctypes.c_double
        arena, pointer = CArena, ctypes.c_void_p
        self.c.touch_encode_start.argtypes = [pointer, pointer, pointer, ctypes.c_double, arena, arena]
        for name in ("touch_encode_next", "touch_encode_finish"):
            getattr(self.c, name).argtypes = [pointer] * (4 if name.endswith("next") else 3)

    def segment(
        self,
        grid: Grid,
        spec: TouchSpec,
        frames: Sequence[ForceField],
        key_frame: ForceField | None = None,
        has_splines: bool = False,
        longest_n: float | None = None,
        work_bytes: int | None = None,
        out_bytes: int | None = None,
    ) -> bytes:
        """The body of a segment; ValueError with the text of the encoder if it fails."""
        sources, own = [Source(frame, spec) for frame in frames], c_grid(grid)
        key = None if key_frame is None else Source(key_frame, spec)
        bricks = max(len(s.bricks) for s in [*sources, *([key] if key else [])])
        options, encoder = c_options(spec), CEncoder()
        longest = max(self.longest_n(source) for source in sources) if longest_n is None else longest_n
        if key:  # the unit of the key frame is kept if possible
            longest = longest if longest > 1.01 * self.longest_n(key) else self.longest_n(key)
        splines = Splines(grid) if has_splines else None
        work = memory(self.room(grid, spec, bricks) if work_bytes is None else work_bytes)
        out = memory(self.c.touch_segment_room(bricks, len(frames)) if out_bytes is None else out_bytes)
        arenas = (CArena(a.ctypes.data, a.size, 0, 0) for a in (work, out))

        def check(code: int) -> None:
            if code:
                raise ValueError(f"{code}: {encoder.error.decode()}")

        start = ctypes.byref(encoder), ctypes.byref(own), ctypes.byref(options)
        check(self.c.touch_encode_start(*start, longest, *arenas))
        for i, source in enumerate(sources):
            coded = ctypes.byref(key.c) if key and not i else None
            check(
                self.c.touch_encode_next(
                    start[0], ctypes.byref(source.c), coded, splines and ctypes.byref(splines.c)
                )
            )
        segment, all_frames = CSegment(), (CSource * len(sources))(*(s.c for s in sources))
        check(self.c.touch_encode_finish(start[0], all_frames, ctypes.byref(segment)))
        return ctypes.string_at(segment.body, segment.size)

    def room(self, grid: Grid, spec: TouchSpec, bricks: int) -> int:
        """The bytes of memory that an encoder of frames of so many bricks needs at most."""
        return int(
            self.c.touch_encode_room(ctypes.byref(c_grid(grid)), ctypes.byref(c_options(spec)), bricks)
        )

    def longest_n(self, source: Source) -> float:
        """The length of the longest force of a frame."""
        return float(self.c.touch_longest_n(ctypes.byref(source.c)))

    def is_static(self, spec: TouchSpec, frame: ForceField, earlier: ForceField) -> bool:
        """Whether an earlier frame serves as the key frame of a frame."""
        sources, work = [Source(f, spec) for f in (frame, earlier)], np.empty(1 << 24, np.uint8)
        arguments = (ctypes.byref(x) for x in (c_grid(frame.grid), c_options(spec), *(s.c for s in sources)))
        return bool(self.c.touch_is_static(*arguments, CArena(work.ctypes.data, work.size, 0, 0)))

    def with_exact_samples(
        self,
        grid: Grid,
        spec: TouchSpec,
        body: bytes,
        frames: Sequence[ForceField],
        samples: Sequence[np.ndarray],
    ) -> bytes:
        """A body with samples of each frame exact."""
        sources, own, encoder = [Source(frame, spec) for frame in frames], c_grid(grid), CEncoder()
        lists = [np.ascontiguousarray(s, np.uint64) for s in samples]
        bricks = max(len(s.bricks) for s in sources)
        work, segment = memory(self.room(grid, spec, bricks)), CSegment()
        out = memory(self.c.touch_segment_room(bricks, len(frames)))
        arenas = (CArena(a.ctypes.data, a.size, 0, 0) for a in (work, out))
        data = CBytes(ctypes.cast(ctypes.c_char_p(body), ctypes.c_void_p), len(body))
        code = self.c.touch_encode_with_outliers(
            ctypes.byref(encoder), ctypes.byref(own), ctypes.byref(c_options(spec)), data,
            (CSource * len(sources))(*(s.c for s in sources)),
            (CExact * len(lists))(*(CExact(len(s), _pointer(s)) for s in lists)),
            ctypes.c_uint32(len(sources)), *arenas, ctypes.byref(segment),
        )  # fmt: skip
        if code:
            raise ValueError(f"{code}: {encoder.error.decode()}")
        return ctypes.string_at(segment.body, segment.size)

    def _part(self, name: str, room: int, *arguments: Any) -> bytes:
        """The bytes of a function that takes an arena, a place for them, and one for the text of an error."""
        work, out, text = memory(room), CBytes(), ctypes.c_char_p()
        arena = CArena(work.ctypes.data, work.size, 0, 0)
        last = ctypes.byref(arena), ctypes.byref(out), ctypes.byref(text)
        if getattr(self.c, name)(*arguments, *last):
            raise ValueError(text.value.decode() if text.value else name)
        return ctypes.string_at(out.bytes, out.size)

    def support(self, grid: Grid, support: Bricks, before: Bricks | None = None) -> bytes:
        """A support by itself."""
        arrays = [
            (np.ascontiguousarray(b, np.int32), np.ascontiguousarray(m, np.uint8))
            for b, m in (support, before or support)
        ]
        own, other = (CSamples(len(b), _pointer(b), _pointer(m)) for b, m in arrays)
        room = self.c.touch_part_room(len(support[0]) + (len(before[0]) if before else 0), 0, 2)
        arguments = ctypes.byref(c_grid(grid)), ctypes.byref(own), before and ctypes.byref(other)
        return self._part("touch_encode_support", room, *arguments)

    def numbers(self, numbers: np.ndarray) -> bytes:
        """Whole numbers by themselves."""
        values = np.ascontiguousarray(numbers, np.int64)
        arguments = ctypes.c_void_p(values.ctypes.data), ctypes.c_uint64(len(values))
        return self._part("touch_encode_numbers", self.c.touch_part_room(0, len(values), 0), *arguments)

    def vibration(self, frames: Sequence[VibrationFrame]) -> bytes:
        """The body of VIBR."""
        frames = list(frames)
        arrays = [(f.positions, f.amplitudes_n, f.frequencies_hz) for f in frames]
        return self.vibration_arrays(frames[0].grid, arrays)

    def vibration_arrays(self, grid: Grid, frames: Sequence[tuple[np.ndarray, ...]]) -> bytes:
        """The body of VIBR of positions, amplitudes and frequencies."""
        sources = (CVibration * len(frames))(
            *(CVibration(len(arrays[0]), *(_pointer(a) for a in arrays)) for arrays in frames)
        )
        bricks = sum(len(np.unique(positions >> 3, axis=0)) for positions, *_ in frames)
        samples = sum(len(positions) for positions, *_ in frames)
        room = self.c.touch_part_room(bricks, 2 * samples, len(frames))
        arguments = ctypes.byref(c_grid(grid)), sources, ctypes.c_uint32(len(frames))
        return self._part("touch_encode_vibration", room, *arguments)

    def poses(self, numbers: np.ndarray) -> bytes:
        """Poses of a body in steps, [n, 7]."""
        values = np.ascontiguousarray(numbers, np.int64)
        arguments = ctypes.c_void_p(values.ctypes.data), ctypes.c_uint32(len(values))
        return self._part("touch_encode_poses", self.c.touch_part_room(0, 7 * len(values), 0), *arguments)

    def decode_support(
        self, grid: Grid, data: bytes, before: Bricks | None = None, memory_bytes: int | None = None
    ) -> tuple[int, int]:
        """The code of `touch_decode_support`, and the number of bricks; by default in the memory it says."""
        bricks, mask = before or (np.zeros((0, 3), np.int32), np.zeros((0, 8, 8, 8), np.uint8))
        arrays = np.ascontiguousarray(bricks, np.int32), np.ascontiguousarray(mask, np.uint8)
        other, out, own = CSamples(len(bricks), *map(_pointer, arrays)), CSamples(), c_grid(grid)
        if memory_bytes is None:
            memory_bytes = self.c.touch_support_room(ctypes.byref(own), len(data), len(bricks))
        given = before and ctypes.byref(other)
        code = self._decode(
            "support", memory_bytes, (ctypes.byref(own), _view(data), given), ctypes.byref(out)
        )
        return code, 0 if code else out.bricks

    def decode_vibration(
        self, grid: Grid, body: bytes, frame_count: int, memory_bytes: int | None = None
    ) -> tuple[int, int]:
        """The same of `touch_decode_vibration`, and the number of samples."""
        own, frames = c_grid(grid), self.c.touch_vibration_frames(len(body), frame_count)
        out = (CVibrationSteps * frames)()
        if memory_bytes is None:
            memory_bytes = self.c.touch_vibration_room(ctypes.byref(own), len(body), frame_count)
        arguments = (
            ctypes.byref(own), _view(body), ctypes.c_uint32(frame_count), ctypes.c_uint64(1 << 40)
        )  # fmt: skip
        code = self._decode("vibration", memory_bytes, arguments, out)
        return code, 0 if code else sum(frame.samples for frame in out)

    def decode_numbers(self, data: bytes, count: int) -> tuple[int, np.ndarray]:
        """The same of `touch_decode_numbers`, and the numbers."""
        out = np.zeros(count, np.int64)
        arguments = _view(data), ctypes.c_uint64(count)
        return self._decode("numbers", FIXED_ROOM, arguments, ctypes.c_void_p(out.ctypes.data)), out

    def decode_poses(self, data: bytes, count: int, one: int) -> tuple[int, np.ndarray]:
        """The same of `touch_decode_poses`, and the poses in steps."""
        out = np.zeros((count, 7), np.int64)
        arguments = _view(data), ctypes.c_uint32(count), ctypes.c_int64(one)
        return self._decode("poses", FIXED_ROOM, arguments, ctypes.c_void_p(out.ctypes.data)), out

    def _decode(self, name: str, memory_bytes: int, arguments: tuple[Any, ...], out: Any) -> int:
        work, text = memory(memory_bytes), ctypes.c_char_p()
        arena = CArena(work.ctypes.data, work.size, 0, 0)
        last = ctypes.byref(arena), out, ctypes.byref(text)
        code = int(getattr(self.c, f"touch_decode_{name}")(*arguments, *last))
        assert bool(text.value) == bool(code)
        return code

    def bodies(self, parts: SegmentParts) -> bytes:
        """The body of a segment of objects."""
        bodies = (CBody * len(parts.objects))(
            *(CBody(_view(part.poses), _view(part.fields), part.fields is not None) for part in parts.objects)
        )
        worst = None
        if parts.max_error:
            voxel = (ctypes.c_uint32 * 3)(*parts.max_error.voxel)
            worst = CSegment(None, 0, parts.max_error.ratio, parts.max_error.frame, voxel)
        room = 64 + sum(16 + body.poses.size + body.fields.size for body in bodies) + 64
        arguments = bodies, ctypes.c_uint32(len(bodies)), worst and ctypes.byref(worst)
        return self._part("touch_encode_bodies", room, *arguments)
