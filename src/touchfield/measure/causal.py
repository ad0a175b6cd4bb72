"""Contexts of a causal code: frames one after the other, voxels in order, nothing beyond (theory: coding limit).

Frames are `FieldSymbols` of one grid and one Q, or arrays of symbols of one shape. What lies outside the grid or the
array, and before the first frame, is symbol 0 to all of them: every voxel then has all its neighbours, and all
quantities are over the same voxels. Arrays stay what they are; only a box of them at a time is copied, with its halo.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.symbol_keys import as_array
from touchfield.medium.budget import memory_budget_bytes
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

Place = tuple[int, int, int]


_FIRST_KEYS = 1 << 12
_MOST_KEYS = 1 << 30


class CellCounter:
    """Counts rows of `columns` symbols, packed as the kernels pack them.

    `columns`: symbols to a row. `bits`: bits to a symbol, at most 32.
    """

    def __init__(self, columns: int, bits: int) -> None:
        self.columns, self.bits = columns, bits
        self._per_word = 64 // bits
        self.words = -(-columns // self._per_word)
        self.zeros = 0
        self._used = 0
        self._allocate(_FIRST_KEYS)

    def _allocate(self, size: int) -> None:
        needed = size * (8 * self.words + 16)
        if size > _MOST_KEYS or needed > memory_budget_bytes() // 2:
            raise InvalidArgument(
                "joint cells", f"more than {size // 2} different ones", f"up to {memory_budget_bytes() // 2} bytes",
                "Give fewer frames or a coarser quantiser, or set TOUCHFIELD_MEMORY_GIB.",
            )  # fmt: skip
        self._slots = np.full(2 * size, -1, np.int32)
        self._keys = np.zeros((size, self.words), np.uint64)
        self._counts = np.zeros(size, np.int64)

    def add(self, rows: NDArray[np.uint64], weights: Int64s | None = None) -> None:
        """Count rows, uint64 [n, words], each once or as often as its weight says."""
        from touchfield.measure.kernels.context import insert

        times = np.zeros(0, np.int64) if weights is None else weights
        done = 0
        while True:
            done, self._used = insert(rows, times, done, (self._slots, self._keys, self._counts), self._used)
            if done == len(rows):
                return
            keys, counts = self._keys[: self._used], self._counts[: self._used]
            self._allocate(2 * len(self._keys))
            _, self._used = insert(keys, counts, 0, (self._slots, self._keys, self._counts), 0)

    def add_zeros(self, count: int) -> None:
        """Count so many rows of nothing but 0, in closed form."""
        self.zeros += count

    @property
    def samples(self) -> int:
        """n, the rows counted."""
        return int(self._counts[: self._used].sum()) + self.zeros

    def counts(self, columns: tuple[int, ...] | None = None) -> Int64s:
        """How often each cell was counted, int64 [K]; of the marginal of some columns if they are named."""
        found = self if columns is None else self.marginal(columns)
        counts = found._counts[: found._used]
        return np.append(counts, found.zeros) if found.zeros else counts.copy()

    def marginal(self, columns: tuple[int, ...]) -> CellCounter:
        """The counter of some columns alone; the others read 0."""
        mask = np.zeros(self.words, np.uint64)
        for c in columns:
            mask[c // self._per_word] |= np.uint64(((1 << self.bits) - 1) << (c % self._per_word * self.bits))
        out = CellCounter(self.columns, self.bits)
        rows, weights = self._keys[: self._used] & mask, self._counts[: self._used]
        empty = ~rows.any(axis=1)
        out.add(rows[~empty], weights[~empty])
        out.add_zeros(self.zeros + int(weights[empty].sum()))
        return out


MOST_SYMBOLS = 1 << 31
"""Symbols are below this."""


def checked_symbols(name: str, x: Any, dimensions: Sequence[int]) -> NDArray[Any]:
    """Symbols as an array of whole numbers or booleans, not copied where they are one already.

    InvalidArgument if it is empty or ragged, has another number of dimensions, or holds anything but whole numbers
    from 0 to 2^31 - 1.
    """
    array = as_array(x, name)
    if array.dtype.kind not in "biu":
        raise InvalidArgument(name, f"values of type {array.dtype}", "whole numbers", "Quantise first.")
    if array.ndim not in dimensions or not array.size:
        wanted = " or ".join(str(d) for d in dimensions)
        raise InvalidArgument(name, f"shape {array.shape}", f"{wanted} dimensions and at least one symbol")
    if array.dtype.kind != "b" and not (array.min() >= 0 and array.max() < MOST_SYMBOLS):
        raise InvalidArgument(name, f"symbols {array.min()} to {array.max()}", f"0 to {MOST_SYMBOLS - 1}")
    return array


def array_of(name: str, frames: Any) -> NDArray[Any] | None:
    """Symbols given as an array, or as lists of numbers; None where frames of `FieldSymbols` were given.

    InvalidArgument as `checked_symbols` does, for arrays of one to four dimensions.
    """
    if isinstance(frames, list | tuple):
        if frames and isinstance(frames[0], FieldSymbols):
            return None
    elif not hasattr(frames, "__array__"):
        return None
    return checked_symbols(name, frames, (1, 2, 3, 4))


def array_frames(x: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """The frames [nx, ny, nz] of an array of 1 to 4 dimensions; of four, the first is time."""
    if x.ndim == 4:
        yield from x
    else:
        yield x.reshape((1,) * (3 - x.ndim) + x.shape)


def frames_of(frames: FieldSymbols | Iterable[FieldSymbols]) -> Iterator[FieldSymbols]:
    """Frames one by one, all of one grid and one Q.

    InvalidArgument if a frame is something else, or of another grid, alphabet or quantiser than the first; if there
    is none.
    """
    first: FieldSymbols | None = None
    if not isinstance(frames, Iterable | FieldSymbols):
        raise InvalidArgument(
            "frames", f"a {type(frames).__name__}", "FieldSymbols, an iterable of them, or an array"
        )
    for frame in [frames] if isinstance(frames, FieldSymbols) else frames:
        if not isinstance(frame, FieldSymbols):
            raise InvalidArgument("frames", f"a {type(frame).__name__}", "FieldSymbols")
        first = first or frame
        if frame.grid != first.grid:
            raise InvalidArgument("frames", "quantised fields on different grids", "one grid")
        if (frame.alphabet, frame.quantiser) != (first.alphabet, first.quantiser):
            raise InvalidArgument(
                "frames",
                f"quantisers {first.quantiser} ({first.alphabet} symbols), {frame.quantiser} ({frame.alphabet})",
                "one quantiser",
            )
        yield frame
    if first is None:
        raise InvalidArgument("frames", "no frame", "at least one")


def scan_order(grid: Grid) -> tuple[int, int, int]:
    """The axes of a grid from the slowest to the fastest of its raster; the scan lines run along the last.

    x, y, z; but where z has a single sample, axes of a single sample come first, as in an array without them: the
    medium of a flat array of actuators is scanned along y, that of a row of them along x.
    """
    if grid.shape[2] > 1:
        return 0, 1, 2
    x, y, z = sorted(range(3), key=lambda axis: grid.shape[axis] > 1)  # stable
    return x, y, z


def scan_relabelled(frame: FieldSymbols) -> FieldSymbols:
    """A frame with its axes in `scan_order`, named x, y, z anew; exact, since axes are only labels of the symbols."""
    order = scan_order(frame.grid)
    if order == (0, 1, 2):
        return frame
    x, y, z = order
    shape, spacing, origin = (
        (v[x], v[y], v[z]) for v in (frame.grid.shape, frame.grid.spacing_m, frame.grid.origin_m)
    )
    grid = Grid(shape, spacing, origin)  # type: ignore[arg-type]
    bricks = np.ascontiguousarray(frame.bricks[:, order])
    raster = np.argsort(brick_keys(grid, bricks))
    symbols = frame.symbols[raster].transpose(0, 1 + x, 1 + y, 1 + z)
    return FieldSymbols(grid, bricks[raster], symbols, frame.alphabet, frame.quantiser)


def boxes_of(shape: Sequence[int], most: int) -> Iterator[tuple[Place, Place]]:
    """Boxes of at most so many voxels that fill an array [nx, ny, nz]: where each begins and where it ends.

    All voxels of a box come before those of the next in raster order: an axis is cut only where the boxes are one
    sample thick along those before it.
    """
    nx, ny, nz = shape
    dz = min(nz, most)
    dy = min(ny, most // dz) if dz == nz else 1
    dx = min(nx, most // (dy * dz)) if (dy, dz) == (ny, nz) else 1
    for x, y, z in itertools.product(range(0, nx, dx), range(0, ny, dy), range(0, nz, dz)):
        yield (x, y, z), (min(nx, x + dx), min(ny, y + dy), min(nz, z + dz))


def haloed(x: NDArray[Any], box: tuple[Place, Place], low: int, high: int) -> Int32s:
    """A box of an array [nx, ny, nz] with `low` samples before it and `high` after it along each axis.

    Of a box [a, b, c], int32 [a + low + high, b + low + high, c + low + high]; 0 beyond the array.
    """
    out = np.zeros([end - begin + low + high for begin, end in zip(*box, strict=True)], np.int32)
    there, here = [], []
    for begin, end, size in zip(*box, x.shape, strict=True):
        first, last = max(0, begin - low), min(size, end + high)
        there.append(slice(first, last))
        here.append(slice(first - begin + low, last - begin + low))
    out[tuple(here)] = x[tuple(there)]
    return out


def _corners(low: int) -> Int32s:
    return np.stack(np.meshgrid(*[np.arange(low, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.int32)


def reached_bricks(grid: Grid, frame: FieldSymbols, previous: FieldSymbols | None) -> Int32s:
    """The bricks outside which a voxel, its causal neighbours and its predecessor are all 0, int32 [n, 3]."""
    held = frame.bricks[frame.symbols.any(axis=(1, 2, 3))]
    there = (held[:, None] + _corners(0)).reshape(-1, 3)
    if previous is not None:
        there = np.concatenate([there, previous.bricks])
    there = there[(there < grid.brick_shape).all(axis=1)]
    keys = np.unique(brick_keys(grid, there))
    return np.stack(np.unravel_index(keys, grid.brick_shape), axis=1).astype(np.int32)


def extents_of(grid: Grid, bricks: Int32s) -> Int64s:
    """Samples of each brick within the grid along x, y, z, int64 [n, 3]."""
    return np.clip(np.asarray(grid.shape) - bricks.astype(np.int64) * BRICK, 0, BRICK)
