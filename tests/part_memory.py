"""Decoders of C in memory of a given size, by ctypes: supports and vibrations."""

from __future__ import annotations

import functools
import sys
import tempfile
from pathlib import Path

import pytest

from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import Grid

sys.path.append(str(Path(__file__).parent / "conformance"))
from native_encoder import COMPILER, NativeEncoder, build

_ERRORS = {2: TruncatedFile, 3: CorruptFile, 5: MemoryError}


@functools.cache
def _native() -> NativeEncoder:
    if COMPILER is None:
        pytest.skip("there is no C compiler here")
    return NativeEncoder(build(Path(tempfile.mkdtemp()), "-O1"))


def decode_support_in(memory_bytes: int, data: bytes, grid: Grid) -> int:
    """The number of bricks; TruncatedFile, CorruptFile or MemoryError."""
    code, bricks = _native().decode_support(grid, data, memory_bytes=memory_bytes)
    return _result(code, bricks)


def decode_vibration_in(memory_bytes: int, body: bytes, grid: Grid, frame_count: int) -> int:
    """The number of samples; TruncatedFile, CorruptFile or MemoryError."""
    code, samples = _native().decode_vibration(grid, body, frame_count, memory_bytes=memory_bytes)
    return _result(code, samples)


def _result(code: int, count: int) -> int:
    if code:
        raise _ERRORS[code]("code")
    return count
