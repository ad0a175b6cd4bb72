"""Symbols of a quantised field: one whole number for each voxel, stored only for bricks (blocks of 8x8x8
samples) that have a force (S = Q(F), paper section 3.1).

Symbol 0 is "no force" and fills all space that no brick covers; 1 .. K-1 are the codewords of Q. Departure
from the text of the paper's tables: the *object* is where Q(F) is not zero, rather than where F is not zero.
A force that Q maps to zero is empty space for the receiver, and H_voxel = h2(p) + p H_object then holds for
every Q: exactly for the entropies and for their plug-in estimates, but not for bias-corrected ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import brick_keys, bricks_of, check_bricks, frozen, tiled, values_at
from touchfield.medium.grid import BRICK, Grid


@dataclass(frozen=True)
class FieldSymbols:
    """The symbols of one frame; `quantiser` is the text of the quantiser.

    `bricks` int32 [n, 3]: strictly ascending (x slowest, z fastest) and within the grid, as in `ForceField`;
    bricks with symbol 0 only are allowed. `symbols` int32 [n, 8, 8, 8]: 0 .. alphabet - 1; 0 beyond the grid.
    `alphabet`: K, the number of codewords of Q including "no force". InvalidArgument if shapes, types or
    symbols do not fit, bricks are out of order, given twice or outside the grid, or a symbol lies beyond the
    last sample of the grid.
    """

    grid: Grid
    bricks: Int32s
    symbols: Int32s
    alphabet: int
    quantiser: str

    def __post_init__(self) -> None:
        b, s = self.bricks, self.symbols
        check_bricks("FieldSymbols", self.grid, b, "symbols", s, "int32")
        if s.size and not (s.min() >= 0 and s.max() < self.alphabet):
            raise InvalidArgument(
                "FieldSymbols symbols", f"{s.min()} to {s.max()}", f"0 to {self.alphabet - 1}"
            )
        for axis, (size, bricks) in enumerate(zip(self.grid.shape, self.grid.brick_shape, strict=True)):
            # only the last bricks of an axis can extend beyond the grid, and only if its number of samples is
            # no multiple of 8
            if size % BRICK and np.moveaxis(s, axis + 1, 1)[b[:, axis] == bricks - 1, size % BRICK :].any():
                found = f"a symbol beyond the grid along {'xyz'[axis]}"
                raise InvalidArgument("FieldSymbols symbols", found, f"0 from sample {size} on")
        object.__setattr__(self, "bricks", frozen(np.ascontiguousarray(b)))
        object.__setattr__(self, "symbols", frozen(np.ascontiguousarray(s)))

    @classmethod
    def from_dense(cls, grid: Grid, symbols: ArrayLike, alphabet: int, quantiser: str) -> FieldSymbols:
        """Build from a dense array of symbols; empty bricks are omitted.

        `symbols`: integers or booleans [nx, ny, nz]. InvalidArgument if the shape is not that of the grid, or
        the symbols are no integers of 0 .. alphabet - 1.
        """
        dense = np.asarray(symbols)
        if dense.shape != grid.shape:
            raise InvalidArgument("symbols", f"shape {dense.shape}", f"{grid.shape}, as the grid says")
        if dense.dtype.kind not in "biu":
            raise InvalidArgument(
                "symbols", f"{dense.dtype}", "integers or booleans", "Quantise the values first."
            )
        low, high, last = int(dense.min()), int(dense.max()), min(alphabet, 1 << 31) - 1
        if low < 0 or high > last:  # before the cast, which would wrap them into the range
            raise InvalidArgument("symbols", f"{low} to {high}", f"0 to {last}")
        tiles = tiled(dense.astype(np.int32))
        bricks = np.argwhere(tiles.any(axis=(3, 4, 5))).astype(np.int32)
        return cls(grid, bricks, tiles[tuple(bricks.T)], alphabet, quantiser)

    def to_dense(self) -> Int32s:
        """Return all symbols, int32 [nx, ny, nz]."""
        bx, by, bz = self.grid.brick_shape
        tiles = np.zeros((bx, by, bz, BRICK, BRICK, BRICK), np.int32)
        tiles[tuple(self.bricks.T)] = self.symbols
        nx, ny, nz = self.grid.shape
        dense = tiles.transpose(0, 3, 1, 4, 2, 5).reshape(bx * BRICK, by * BRICK, bz * BRICK)
        return np.ascontiguousarray(dense[:nx, :ny, :nz])

    @property
    def object_symbols(self) -> Int32s:
        """The symbols that are not 0, brick after brick, int32 [L]."""
        return np.asarray(self.symbols[self.symbols != 0])

    @property
    def object_count(self) -> int:
        """L, the voxels whose quantised force is not zero."""
        return int(np.count_nonzero(self.symbols))

    @property
    def voxel_count(self) -> int:
        """V, all voxels of the lattice."""
        return self.grid.voxel_count

    def symbols_at(self, index: ArrayLike) -> Int32s:
        """The symbols at lattice points, int32 [m]; 0 outside the grid.

        `index`: indices of the points, int [m, 3].
        """
        return values_at(self.grid, self.bricks, self.symbols, np.asarray(index, np.int64).reshape(-1, 3))


Part = tuple["Int32s", "Int64s"]
"""Bricks int32 [m, 3], and the symbols of their samples, int64 [m, 512], 0 for no force."""

Fields = FieldSymbols | Sequence[FieldSymbols]

_BRICKS = 1 << 11  # at a time: 8 MiB of int64


class Frames:
    """Frames of one grid and one quantiser, each requested and checked in turn.

    The first frame is requested to find grid and quantiser and is kept until it is counted, so that no frame
    is requested twice in a pass.
    """

    def __init__(self, fields: Fields, where: str) -> None:
        if not isinstance(fields, FieldSymbols | Sequence):
            raise InvalidArgument(where, f"a {type(fields).__name__}", "FieldSymbols or a sequence of them")
        self._fields, self._where = (fields,) if isinstance(fields, FieldSymbols) else fields, where
        self.count = len(self._fields)
        if not self.count:
            raise InvalidArgument(where, "no frame", "at least one FieldSymbols")
        first = self._checked_type(0)
        self.grid, self.alphabet, self.quantiser = first.grid, first.alphabet, first.quantiser
        self._first: FieldSymbols | None = first

    def take(self, n: int) -> FieldSymbols:
        """Return frame n without keeping a reference to it."""
        if n == 0 and self._first is not None:
            first, self._first = self._first, None
            return first
        f = self._checked_type(n)
        self.check_like(f, f"{self._where}, frame {n}", "frame 0")
        return f

    def check_like(
        self, other: FieldSymbols | Frames, where: str, of: str, mends: tuple[str, str] = ("", "")
    ) -> None:
        """Raise InvalidArgument if grid or quantiser differ from those of these frames.

        `where` names the other frames, `of` these frames.
        """
        if other.grid != self.grid:
            raise InvalidArgument(where, f"the grid {other.grid}", f"{self.grid}, as of {of}", mends[0])
        if (other.quantiser, other.alphabet) != (self.quantiser, self.alphabet):
            found, expected = (
                f"{frames.quantiser} with {frames.alphabet} symbols" for frames in (other, self)
            )
            raise InvalidArgument(where, f"the quantiser {found}", f"{expected}, as of {of}", mends[1])

    def __iter__(self) -> Iterator[FieldSymbols]:
        return (self.take(n) for n in range(self.count))

    def parts(self) -> Iterator[Part]:
        """Yield the parts of all frames.

        No name is bound to a frame here, so that it is freed before the next is computed.
        """
        for n in range(self.count):
            yield from _parts(self.take(n))

    def _checked_type(self, n: int) -> FieldSymbols:
        f = self._fields[n]
        if not isinstance(f, FieldSymbols):
            raise InvalidArgument(f"{self._where}, frame {n}", f"a {type(f).__name__}", "FieldSymbols")
        return f


class FramePairs:
    """Pairs of frames of two sequences as joint symbols s * K_T + t.

    The sequences have the same grid and length.
    """

    def __init__(self, first: Frames, second: Frames) -> None:
        self._first, self._second = first, second
        self.grid, self.count, self.alphabet = first.grid, first.count, first.alphabet * second.alphabet
        self.quantiser = "; ".join(dict.fromkeys((first.quantiser, second.quantiser)))

    def parts(self) -> Iterator[Part]:
        """Yield the parts of all pairs.

        The second frame is requested first: it is usually the previous one, still in a cache of two.
        """
        for n in range(self.count):
            yield from _joint_parts(second=self._second.take(n), first=self._first.take(n))


def _parts(f: FieldSymbols) -> Iterator[Part]:
    for b in range(0, len(f.bricks), _BRICKS):
        symbols = f.symbols[b : b + _BRICKS]
        yield f.bricks[b : b + _BRICKS], symbols.reshape(len(symbols), -1).astype(np.int64)


def _joint_parts(first: FieldSymbols, second: FieldSymbols) -> Iterator[Part]:
    """Joint symbols at the union of the bricks of two frames."""
    grid, both = first.grid, (first, second)
    keys_of = [brick_keys(grid, f.bricks) for f in both]
    keys = np.union1d(*keys_of)
    for b in range(0, len(keys), _BRICKS):
        chunk = keys[b : b + _BRICKS]
        symbols = np.zeros((2, len(chunk), BRICK**3), np.int64)
        for f, k, out in zip(both, keys_of, symbols, strict=True):
            low, high = np.searchsorted(k, [chunk[0], chunk[-1] + 1])
            out[np.searchsorted(chunk, k[low:high])] = f.symbols[low:high].reshape(-1, BRICK**3)
        yield bricks_of(grid, chunk), symbols[0] * second.alphabet + symbols[1]


def frames_changed() -> InvalidArgument:
    return InvalidArgument(
        "fields", "other symbols in the second pass", "a sequence whose frames stay the same"
    )
