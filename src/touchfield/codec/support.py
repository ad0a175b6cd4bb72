"""The support, coded without loss: which samples of a frame hold a force.

Paper section 5.2 codes amplitudes and directions of the supported samples and forgets to say where they are
(docs/theory.md 42). Here first the bricks are told, then the samples of those that are not full, bit by bit,
each with a chance learnt from its neighbours within four samples and, where it is given, from the previous
frame. All arithmetic is on whole numbers.

The bytes: varint count of bricks, n; nothing more where n = 0. Then, if the grid has at most 128 n + 4096
bricks, all else is one arithmetic code: a state for each brick of the grid, and the samples,
both with x slowest and z fastest, z from deep to shallow. Otherwise n
varints, the gap to the next brick and a bit for "full", and then the code of the samples. Zero bytes fill up
to a quarter of a byte for each brick, so that a few bytes never ask for much memory. Samples beyond the grid
are not coded, and a brick is full if all its samples within the grid are set.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.kernels.mixer import Coder

    Bricks = tuple[NDArray[np.int32], NDArray[np.bool_]]
    """Brick coordinates int32 [n, 3], ascending, and the mask of their samples, bool [n, 8, 8, 8]."""

    Rows = tuple[NDArray[np.int64], NDArray[np.uint8]]
    """Keys of bricks, int64 [n], and their samples, uint8 [n, 8, 8], bit z of row (x, y)."""

__all__ = ["BRICKS_PER_BYTE", "decode_support", "encode_support", "whole_rows"]

BRICKS_PER_BYTE = 4
"""A support of n bricks takes n / 4 bytes at least: 2 KiB of mask for each byte read."""

_CELLS_PER_BRICK = 128
_CELLS_FREE = 4096

_WHERE = "support"
_CHANGED = "The file was changed or cut."


def encode_support(
    grid: Grid, bricks: NDArray[np.int32], mask: NDArray[np.bool_], previous: Bricks | None = None
) -> bytes:
    """The bytes of a support.

    Parameters
    ----------
    grid : Grid
    bricks : int32 [n, 3]
        In ascending order.
    mask : bool [n, 8, 8, 8]
        At least one sample in each brick, none beyond the grid.
    previous : (int32 [m, 3], bool [m, 8, 8, 8]), optional
        The support of the frame before, on the same grid; the decoder must be given the same.

    Raises
    ------
    InvalidArgument
        If the bricks are out of order, empty, or beyond the grid.
    """
    from touchfield.codec.kernels import support as kernels

    keys, rows = _checked(grid, bricks, mask)
    before = _before(grid, previous)
    count = len(keys)
    head = write_varint(count)
    if count == 0:
        return head
    b = np.array(bricks, np.int32)  # a read-only array would be another type to the compiler
    whole = whole_rows(grid, b)
    full = (rows == whole).all(axis=(1, 2))
    if not _in_cells(grid, count):
        gaps = np.diff(keys, prepend=-1) - 1
        head += b"".join(map(write_varint, (2 * gaps + full).tolist()))
    # a bit costs 14 bits at most (its chance is 4 of 65536 at least)
    coder = _coder(np.empty(count * 1024 + _cell_count(grid, count) * 4 + 64, np.uint8), decoding=False)
    if _in_cells(grid, count):
        cells = _cells(grid, b, full)
        kernels.code_cells(coder, cells, _cells_before(grid, before), count)
    coder.fresh_models(kernels.SAMPLE_CONTEXTS[len(before[0]) > 0], kernels.SAMPLE_SETS)
    known = np.where(full[:, None, None], whole, np.uint8(0))
    kernels.code_samples(coder, _sizes(grid), (b, keys, full), (known, rows), before)
    place, end = coder.tail()
    data = head + coder.buffer[:place].tobytes() + end
    return data + bytes(max(0, -(-count // BRICKS_PER_BYTE) - len(data)))


def decode_support(
    data: bytes, grid: Grid, previous: Bricks | None = None
) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """The inverse of `encode_support`: bricks, int32 [n, 3], and mask, bool [n, 8, 8, 8].

    Whatever the bytes, some 6 KiB are taken for each of them at most, and 1 MiB.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what `encode_support` writes.
    """
    from touchfield.codec.kernels import support as kernels

    before = _before(grid, previous)
    count, at = read_varint(data, 0, f"{_WHERE}, count of bricks", _brick_count(grid) + 1)
    if count == 0:
        if len(data) > at:
            raise CorruptFile(_WHERE, f"{len(data)} bytes of an empty support", f"{at}", _CHANGED)
        return np.zeros((0, 3), np.int32), np.zeros((0, BRICK, BRICK, BRICK), np.bool_)
    if count > BRICKS_PER_BYTE * len(data):
        raise TruncatedFile(_WHERE, f"{count} bricks in {len(data)} bytes", f"{BRICKS_PER_BYTE} a byte at most")
    keys = full = None
    if not _in_cells(grid, count):
        keys, full, at = _read_listed(grid, data, at, count)
    coder = _coder(np.frombuffer(data, np.uint8, offset=at).copy(), decoding=True)
    if keys is None or full is None:
        keys, full = _decode_cells(grid, coder, before, count)
    bricks = np.stack(np.unravel_index(keys, grid.brick_shape), axis=-1).astype(np.int32)
    known = np.where(full[:, None, None], whole_rows(grid, bricks), np.uint8(0))
    coder.fresh_models(kernels.SAMPLE_CONTEXTS[len(before[0]) > 0], kernels.SAMPLE_SETS)
    status = kernels.code_samples(coder, _sizes(grid), (bricks, keys, full), (known, known), before)
    if status == kernels.ENDED:
        raise TruncatedFile(_WHERE, f"the end of the code after {len(data)} bytes", f"the samples of {count} bricks")
    if status != kernels.DONE:
        raise CorruptFile(_WHERE, "a brick that is empty or full and should not be", "mixed bricks", _CHANGED)
    _check_end(data, at, coder, count)
    mask = np.unpackbits(known.reshape(-1), bitorder="little").view(np.bool_)
    return bricks, mask.reshape(-1, BRICK, BRICK, BRICK)


def _read_listed(grid: Grid, data: bytes, at: int, count: int) -> tuple[NDArray[np.int64], NDArray[np.bool_], int]:
    values = np.empty(count, np.int64)
    for i in range(count):
        values[i], at = read_varint(data, at, f"{_WHERE}, gap between bricks", 2 * _brick_count(grid))
    keys = np.cumsum((values >> 1) + 1) - 1
    if keys.min() < 0 or keys.max() >= _brick_count(grid):  # a sum that overflows passes through one of both
        raise CorruptFile(_WHERE, "a brick beyond the grid", f"bricks below {grid.brick_shape}", _CHANGED)
    return keys, (values & 1).astype(np.bool_), at


def _decode_cells(grid: Grid, coder: Coder, before: Rows, count: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    from touchfield.codec.kernels import support as kernels

    old = _cells_before(grid, before)
    status, cells = kernels.code_cells(coder, old, old, count)
    if status != kernels.DONE:
        raise CorruptFile(_WHERE, "fewer bricks than were counted", f"{count} bricks", _CHANGED)
    states = cells[:, :, ::-1].reshape(-1)
    keys = np.flatnonzero(states)
    return keys, states[keys] == kernels.FULL


def _check_end(data: bytes, at: int, coder: Coder, count: int) -> None:
    place, end = coder.tail()
    size = max(at + place + len(end), -(-count // BRICKS_PER_BYTE))
    if len(data) < size:
        raise TruncatedFile(_WHERE, f"{len(data)} bytes", f"{size}")
    rest = data[at + place :]
    if len(data) > size or rest != end.ljust(len(rest), b"\0"):
        raise CorruptFile(_WHERE, "bytes behind the end of the code", f"the {size} bytes of the code", _CHANGED)


# -- what both sides make of the grid ---------------------------------------------------------------------


def _checked(grid: Grid, bricks: NDArray[np.int32], mask: NDArray[np.bool_]) -> Rows:
    """Keys and rows of a support that is in order."""
    b, m = np.asarray(bricks), np.asarray(mask)
    if b.dtype != np.int32 or b.ndim != 2 or b.shape[1] != 3:
        raise InvalidArgument("support bricks", f"{b.dtype} {b.shape}", "int32 [n, 3]")
    if m.dtype != np.bool_ or m.shape != (len(b), BRICK, BRICK, BRICK):
        raise InvalidArgument("support mask", f"{m.dtype} {m.shape}", f"bool [{len(b)}, 8, 8, 8]")
    if len(b) and (b.min() < 0 or (b.max(axis=0) >= grid.brick_shape).any()):
        raise InvalidArgument("support bricks", "a brick outside the grid", f"{grid.brick_shape}")
    keys = brick_keys(grid, b)
    if (np.diff(keys) <= 0).any():
        raise InvalidArgument("support bricks", "bricks out of order or twice", "ascending order")
    rows = np.packbits(m.reshape(-1), bitorder="little").reshape(-1, BRICK, BRICK)
    if not rows.any(axis=(1, 2)).all() or (rows & ~whole_rows(grid, b)).any():
        raise InvalidArgument("support mask", "a brick without samples, or one beyond the grid", "neither")
    return keys, rows


def _before(grid: Grid, previous: Bricks | None) -> Rows:
    if previous is None:
        return np.zeros(0, np.int64), np.zeros((0, BRICK, BRICK), np.uint8)
    return _checked(grid, *previous)


def whole_rows(grid: Grid, bricks: NDArray[np.int32]) -> NDArray[np.uint8]:
    """The samples within the grid, uint8 [n, 8, 8]."""
    left = np.clip(np.asarray(grid.shape) - bricks * np.int64(BRICK), 0, BRICK)
    local = np.arange(BRICK)
    inside = (local < left[:, 0, None])[:, :, None] & (local < left[:, 1, None])[:, None, :]
    return np.where(inside, ((1 << left[:, 2]) - 1)[:, None, None], 0).astype(np.uint8)


def _sizes(grid: Grid) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return np.array(grid.shape, np.int64), np.array(grid.brick_shape, np.int64)


def _brick_count(grid: Grid) -> int:
    return math.prod(grid.brick_shape)


def _in_cells(grid: Grid, count: int) -> bool:
    return _brick_count(grid) <= _CELLS_PER_BRICK * count + _CELLS_FREE


def _cell_count(grid: Grid, count: int) -> int:
    return _brick_count(grid) if _in_cells(grid, count) else 0


def _cells(grid: Grid, bricks: NDArray[np.int32], full: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """State of every brick of the grid: 0 absent, 1 mixed, 2 full; uint8 [bx, by, bz], z from deep to shallow."""
    cells = np.zeros(grid.brick_shape, np.uint8)
    x, y, z = bricks.T
    cells[x, y, grid.brick_shape[2] - 1 - z] = 1 + full.astype(np.uint8)
    return cells


def _cells_before(grid: Grid, before: Rows) -> NDArray[np.uint8]:
    keys, rows = before
    bricks = np.stack(np.unravel_index(keys, grid.brick_shape), axis=-1).astype(np.int32)
    return _cells(grid, bricks, (rows == whole_rows(grid, bricks)).all(axis=(1, 2)))


def _coder(buffer: NDArray[np.uint8], *, decoding: bool) -> Coder:
    from touchfield.codec.kernels import support as kernels

    return kernels.Coder(buffer, decoding, kernels.CELL_CONTEXTS, kernels.CELL_SETS)
