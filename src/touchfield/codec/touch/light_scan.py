"""The order in which the light models of coder `touch` walk a frame: from deep to shallow, brick by brick."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.varint import read_varint, write_varint
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.frame_model import Known
    from touchfield.medium import Grid

    Int64s = NDArray[np.int64]

__all__ = ["Scan", "orientation", "read_slopes", "scan_of", "turn_of", "write_slopes"]

_SLOPE_LIMIT: Final = 1 << 17


@dataclass(frozen=True)
class Scan:
    """How a frame is walked, from what both sides know: see `kernels.touch_light.code_frame`."""

    where: Int64s
    reference_slot: Int64s
    tiles: Int64s
    low: Int64s
    high: Int64s
    layers: Int64s
    layer_at: Int64s
    stride: Int64s
    width: int


def turn_of(axis: int) -> Int64s:
    """The axes of the scan, slowest first."""
    return np.array([axis, *(c for c in range(3) if c != axis)], np.int64)


def orientation(sums: NDArray[np.float64], grid: Grid) -> tuple[Int64s, NDArray[np.bool_]]:
    """Which axis is slowest, and which are walked downwards: with the force, that is from deep to shallow.

    The slowest is the one along which the force points most; of two alike, not that of the finest sampling, whose
    neighbours are worth more in the plane.
    """
    fine = np.asarray(grid.spacing_m) < min(1.01 * min(grid.spacing_m), 0.99 * max(grid.spacing_m))
    return turn_of(int(np.argmax((np.abs(sums[1]) + 0.01 * sums[0]) * np.where(fine, 0.85, 1.0)))), sums[1] < 0


def scan_of(known: Known, bricks: NDArray[np.int32], way: int) -> tuple[Scan, NDArray[np.int32]]:
    """The walk over bricks in ascending order, and the vectors of the reference, int32 [m, 3]."""
    grid = known.grid
    turn = turn_of(way & 3)
    down = np.array([way >> (2 + n) & 1 for n in range(3)], np.int64)
    shape = np.asarray(grid.brick_shape, np.int64)[turn]
    extent = np.asarray(grid.shape, np.int64)[turn]
    natural = np.array([BRICK * BRICK, BRICK, 1], np.int64)[turn]
    turned = bricks[:, turn].astype(np.int64)
    at = np.where(down == 1, shape - 1 - turned, turned)
    order = np.lexsort((at[:, 2], at[:, 1], at[:, 0]))
    at, turned = at[order], turned[order]
    begin = int((down * (BRICK - 1) * natural).sum())
    left = np.clip(extent - turned * BRICK, 0, BRICK)
    low = np.where(down == 1, BRICK - left, 0)
    high = np.where(down == 1, BRICK, left)
    layers = np.flatnonzero(np.diff(at[:, 0], prepend=-1, append=-1))
    tiles, width = _tiles(at, int(shape[2]))
    reference = known.guess if known.guess is not None else known.previous
    vectors, slot = np.zeros((1, 3), np.int32), np.full(len(bricks), -1, np.int64)
    if reference is not None and len(reference.bricks):
        vectors = np.array(reference.vectors).reshape(-1, 3)
        keys, own = brick_keys(grid, reference.bricks), brick_keys(grid, bricks[order])
        place = np.minimum(np.searchsorted(keys, own), len(keys) - 1)
        slot = np.where(keys[place] == own, place * BRICK**3 + begin, -1)
    stride = np.where(down == 1, -natural, natural)
    where = order * BRICK**3 + begin
    scan = Scan(where, slot, tiles, low, high, layers.astype(np.int64), at[layers[:-1], 0], stride, width)
    return scan, vectors


def _tiles(at: Int64s, across: int) -> tuple[Int64s, int]:
    """Where each brick's tile, that before and that after it begin in a row of cells, int64 [n, 3]; and its cells.

    Tiles side by side share a border; others are two cells apart. A tile that is not there is one of zeros, 2.
    """
    keys = at[:, 1] * across + at[:, 2]
    columns, place = np.unique(keys, return_inverse=True)
    apart = (np.diff(columns, prepend=-2) != 1) | (columns % across == 0)
    offset = 10 + BRICK * np.arange(len(columns)) + 2 * np.cumsum(apart)
    found = np.empty((len(columns), 3), np.int64)
    for n, step in enumerate((0, -across, across)):
        other = columns + step
        near = np.minimum(np.searchsorted(columns, other), len(columns) - 1)
        found[:, n] = np.where(columns[near] == other, offset[near], 2)
    return found[place.reshape(-1)], int(offset[-1]) + BRICK + 4


def write_slopes(slopes: Int64s) -> bytes:
    """What the amplitude loses in a step along each axis of the scan, units, as zigzag varints."""
    return b"".join(write_varint(2 * s if s >= 0 else -2 * s - 1) for s in slopes.tolist())


def read_slopes(payload: bytes, at: int, where: str) -> tuple[Int64s, int]:
    """The inverse of `write_slopes`, int64 [3], and where it ends.

    Raises
    ------
    CorruptFile, TruncatedFile
    """
    out = []
    for _ in range(3):
        value, at = read_varint(payload, at, f"{where}, slope", 2 * _SLOPE_LIMIT)
        out.append(value >> 1 if value & 1 == 0 else -(value >> 1) - 1)
    return np.array(out, np.int64), at
