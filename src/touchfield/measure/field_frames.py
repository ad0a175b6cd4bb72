"""Frames of quantised fields, read one after the other in parts of bricks; none is held once it is counted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.field_symbols import FieldSymbols, aligned
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["Fields", "FramePairs", "Frames", "Part", "frames_changed"]

Part = tuple["NDArray[np.int32]", "NDArray[np.int64]"]
"""Bricks int32 [m, 3], and the symbols of their samples, int64 [m, 512], 0 where nothing is."""

Fields = FieldSymbols | Sequence[FieldSymbols]

_BRICKS = 1 << 11  # at a time: 8 MiB of int64


class Frames:
    """Frames of one grid and one Q, each asked for and checked when its turn comes.

    The first, asked for to know grid and Q, is held until it is counted, and so not asked for twice.
    """

    def __init__(self, given: Fields, where: str) -> None:
        if not isinstance(given, FieldSymbols | Sequence):
            raise InvalidArgument(where, f"a {type(given).__name__}", "FieldSymbols or a sequence of them")
        self._given, self._where = (given,) if isinstance(given, FieldSymbols) else given, where
        self.count = len(self._given)
        if not self.count:
            raise InvalidArgument(where, "no frame", "at least one FieldSymbols")
        first = self._checked_type(0)
        self.grid, self.alphabet, self.quantiser = first.grid, first.alphabet, first.quantiser
        self._first: FieldSymbols | None = first

    def take(self, n: int) -> FieldSymbols:
        """Frame n, which nothing here holds any longer."""
        if n == 0 and self._first is not None:
            first, self._first = self._first, None
            return first
        f = self._checked_type(n)
        if f.grid != self.grid:
            raise InvalidArgument(f"{self._where}, frame {n}", f"the grid {f.grid}", f"{self.grid}, as of frame 0")
        if (f.quantiser, f.alphabet) != (self.quantiser, self.alphabet):
            raise InvalidArgument(
                f"{self._where}, frame {n}",
                f"the quantiser {f.quantiser} with {f.alphabet} symbols",
                f"{self.quantiser} with {self.alphabet}, as of frame 0",
            )
        return f

    def parts(self) -> Iterator[Part]:
        """One pass. No name is bound to a frame here, lest it live while the next is made."""
        for n in range(self.count):
            yield from _parts(self.take(n))

    def _checked_type(self, n: int) -> FieldSymbols:
        f = self._given[n]
        if not isinstance(f, FieldSymbols):
            raise InvalidArgument(f"{self._where}, frame {n}", f"a {type(f).__name__}", "FieldSymbols")
        return f


@dataclass(frozen=True)
class FramePairs:
    """The frames of two sequences together, as joint symbols s * K_T + t."""

    first: Frames
    second: Frames

    @property
    def grid(self) -> Grid:
        return self.first.grid

    @property
    def count(self) -> int:
        return self.first.count

    @property
    def alphabet(self) -> int:
        return self.first.alphabet * self.second.alphabet

    @property
    def quantiser(self) -> str:
        a, b = self.first.quantiser, self.second.quantiser
        return a if a == b else f"{a}; {b}"

    def parts(self) -> Iterator[Part]:
        """One pass. The second is usually the frame before: asked for first, it is still there if two are kept."""
        for n in range(self.count):
            yield from _joint_parts(second=self.second.take(n), first=self.first.take(n))


def _parts(f: FieldSymbols) -> Iterator[Part]:
    for b in range(0, len(f.bricks), _BRICKS):
        some = f.symbols[b : b + _BRICKS]
        yield f.bricks[b : b + _BRICKS], some.reshape(len(some), -1).astype(np.int64)


def _joint_parts(first: FieldSymbols, second: FieldSymbols) -> Iterator[Part]:
    """Joint symbols at the union of the bricks."""
    grid = first.grid
    keys = np.union1d(brick_keys(grid, first.bricks), brick_keys(grid, second.bricks))
    for b in range(0, len(keys), _BRICKS):
        low, high = keys[b], keys[min(len(keys), b + _BRICKS) - 1]
        s, t = aligned((_between(first, low, high), _between(second, low, high)))
        bricks = np.stack(np.unravel_index(keys[b : b + _BRICKS], grid.brick_shape), axis=1)
        joint = s.astype(np.int64) * second.alphabet + t
        yield bricks.astype(np.int32), joint.reshape(len(joint), -1)


def _between(f: FieldSymbols, low: int, high: int) -> FieldSymbols:
    keys = brick_keys(f.grid, f.bricks)
    part = slice(np.searchsorted(keys, low), np.searchsorted(keys, high, side="right"))
    return replace(f, bricks=f.bricks[part], symbols=f.symbols[part])


def frames_changed() -> InvalidArgument:
    return InvalidArgument("fields", "other symbols in the second pass", "a sequence whose frames stay the same")
