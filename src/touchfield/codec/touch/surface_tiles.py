"""The tiles of 8 x 8 columns over which a surface of the coder `touch` lies, as runs, and which lie beside which."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["read_tiles", "tiles_around", "write_tiles"]

_WHERE: Final = "surface"
_CHANGED: Final = "The file was changed or cut."


def tiles_around(tiles: Int64s, across: int) -> Int64s:
    """The tiles to the west, north, north-west and north-east, int64 [n, 4]; -1 where there is none."""
    keys = tiles[:, 0] * (across + 2) + tiles[:, 1]
    out = np.full((len(tiles), 4), -1, np.int64)
    for n, (a, b) in enumerate(((0, -1), (-1, 0), (-1, -1), (-1, 1))):
        wanted = keys + a * (across + 2) + b
        slot = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        inside = (tiles[:, 1] + b >= 0) & (tiles[:, 1] + b < across)
        out[:, n] = np.where((keys[slot] == wanted) & inside, slot, -1)
    return out


def write_tiles(tiles: Int64s, across: int) -> bytes:
    """The tiles, int64 [n, 2], ascending, as runs; `across` is how many lie side by side."""
    keys = tiles[:, 0] * across + tiles[:, 1]
    cuts = np.flatnonzero(np.diff(keys) != 1) + 1
    lows, highs = keys[np.append(0, cuts)], keys[np.append(cuts, len(keys)) - 1]
    out, at = write_varint(len(lows)), 0
    for low, high in zip(lows.tolist(), highs.tolist(), strict=True):
        out += write_varint(low - at) + write_varint(high - low)
        at = high + 2
    return out


def read_tiles(data: bytes, at: int, counts: tuple[int, int]) -> tuple[Int64s, int]:
    """The tiles at offset `at`, a byte of `data` each at least, and the offset behind them.

    Raises
    ------
    TruncatedFile, CorruptFile
        If there are none, too many for the bytes, or one beyond the `counts` of the grid.
    """
    rows, across = counts
    runs, at = read_varint(data, at, f"{_WHERE}, runs of tiles", len(data))
    keys: list[Int64s] = []
    place = total = 0
    for _ in range(runs):
        skipped, at = read_varint(data, at, f"{_WHERE}, tiles left out", rows * across)
        more, at = read_varint(data, at, f"{_WHERE}, tiles of a run", rows * across)
        total += more + 1
        if place + skipped + more >= rows * across:
            raise CorruptFile(_WHERE, "a tile beyond the grid", f"{rows} x {across} tiles", _CHANGED)
        if total > len(data):
            raise TruncatedFile(_WHERE, f"{len(data)} bytes for {total} tiles", "a byte each", _CHANGED)
        keys.append(np.arange(place + skipped, place + skipped + more + 1, dtype=np.int64))
        place += skipped + more + 2
    if not keys:
        raise CorruptFile(_WHERE, "no tile", "one at least", _CHANGED)
    return np.stack(np.divmod(np.concatenate(keys), across), axis=1), at
