"""`c/touch_encode.h` by ctypes: a library of it, built here, and its functions on the types of the package."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from touchfield.codec.touch.error_bound import masked_error_n
from touchfield.codec.touch.spec import MODES, TouchSpec
from touchfield.medium import ForceField, Grid

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

    _fields_ = [("bricks", ctypes.c_uint64), *((name, ctypes.c_void_p) for name in ("brick", "forces", "hidden"))]


class CSegment(ctypes.Structure):
    """`touch_segment`."""

    _fields_ = [
        ("body", ctypes.c_void_p),
        ("size", ctypes.c_uint64),
        ("ratio", ctypes.c_double),
        ("frame", ctypes.c_uint32),
        ("voxel", ctypes.c_uint32 * 3),
    ]


class CEncoder(ctypes.Structure):
    """`touch_encoder`."""

    _fields_ = [("writer", ctypes.c_void_p), ("error", ctypes.c_char_p)]


def build(folder: Path, *options: str, source: Path = C / "touch_encode.c") -> Path:
    """`libtouch.so` in a folder, compiled with every warning an error."""
    out = folder / "libtouch.so"
    command = [str(COMPILER), *STRICT, "-shared", "-fPIC", *options, f"-I{C}", "-o", str(out), str(source), "-lm"]
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
    assert compiled.returncode == 0, compiled.stderr
    return out


def c_grid(grid: Grid) -> CGrid:
    """A grid for C."""
    triple = ctypes.c_double * 3
    return CGrid((ctypes.c_uint32 * 3)(*grid.shape), triple(*grid.spacing_m), triple(*grid.origin_m))


def _pointer(array: np.ndarray) -> int | None:
    return array.ctypes.data if array.size else None


class Source:
    """A frame for C; it keeps the arrays that C looks into."""

    def __init__(self, frame: ForceField, spec: TouchSpec) -> None:
        self.bricks = np.ascontiguousarray(frame.bricks, np.int32)
        self.forces = np.ascontiguousarray(frame.forces_n, np.float32)
        self.hidden = np.ascontiguousarray(masked_error_n(frame, spec), np.float32)
        pointers = _pointer(self.bricks), _pointer(self.forces), _pointer(self.hidden)
        self.c = CSource(len(self.bricks), *pointers)


class NativeEncoder:
    """The functions of a library that `build` compiled."""

    def __init__(self, library: Path) -> None:
        self.c: Any = ctypes.CDLL(str(library))
        self.c.touch_encode_room.restype = ctypes.c_uint64
        self.c.touch_encode_room.argtypes = [ctypes.c_void_p, ctypes.c_uint64]
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
        splines: Any = None,
        out_bytes: int = 1 << 26,
    ) -> bytes:
        """The body of a segment; ValueError with the text of the encoder if it fails."""
        sources = [Source(frame, spec) for frame in frames]
        key = None if key_frame is None else Source(key_frame, spec)
        bricks = 2 * max(len(s.bricks) for s in [*sources, *([key] if key else [])])
        options = COptions(
            MODES.index(spec.mode), spec.support == "exact", _INTER.index(spec.interframe), spec.guess == "auto",
            spec.effort == "default", spec.k, spec.f0_n, spec.direction_jnd_deg, spec.step_n,
        )  # fmt: skip
        own, encoder = c_grid(grid), CEncoder()
        room = self.c.touch_encode_room(ctypes.byref(own), bricks)
        work, out = np.empty(room, np.uint8), np.empty(out_bytes, np.uint8)
        arenas = (CArena(a.ctypes.data, a.size, 0, 0) for a in (work, out))

        def check(code: int) -> None:
            if code:
                raise ValueError(f"{code}: {encoder.error.decode()}")

        start = ctypes.byref(encoder), ctypes.byref(own), ctypes.byref(options)
        check(self.c.touch_encode_start(*start, longest_n(frames, key_frame), *arenas))
        for i, source in enumerate(sources):
            coded = ctypes.byref(key.c) if key and not i else None
            check(self.c.touch_encode_next(start[0], ctypes.byref(source.c), coded, splines))
        segment, all_frames = CSegment(), (CSource * len(sources))(*(s.c for s in sources))
        check(self.c.touch_encode_finish(start[0], all_frames, ctypes.byref(segment)))
        return ctypes.string_at(segment.body, segment.size)


def longest_n(frames: Sequence[ForceField], key_frame: ForceField | None = None) -> float:
    """The limit of all forces that the encoder of the package has."""
    def length(frame: ForceField) -> float:
        vectors = frame.forces_n.reshape(-1, 3)
        return float(np.sqrt(np.einsum("ni,ni->n", vectors, vectors, dtype=np.float64).max(initial=0.0)))

    longest = max(map(length, frames))
    if key_frame is None:
        return longest
    return longest if longest > 1.01 * length(key_frame) else length(key_frame)

