"""The column guess of the coder `touch`: solids with steps, told column by column (docs/format/touch-guess.md).

A penalty field is F = K d n behind a surface, F_max at most: along the main axis of the force a column of samples
shares n, and its depth grows from the surface on. So a column of a height map is told by a direction, a start, and
the force deep inside; where a low-pass has mixed the surfaces at both sides of a step, by two such surfaces whose
forces add. All is predicted from the columns beside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.brick_list import BRICKS_FREE, BRICKS_PER_BYTE, code_bricks
from touchfield.codec.brick_list import CONTEXTS as LIST_CONTEXTS
from touchfield.codec.brick_list import SETS as LIST_SETS
from touchfield.codec.kernels.bits import PLACE, fresh, reader
from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.kernels import columns as kernels
from touchfield.codec.touch.kernels import columns_code as coder
from touchfield.codec.varint import read_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["AT", "CONTEXTS", "SETS", "View", "columns_of", "forces_of", "least_size", "synthesise"]

CONTEXTS: Final = LIST_CONTEXTS + coder.CONTEXTS
SETS: Final = LIST_SETS + coder.SETS

AT: Final = (LIST_CONTEXTS, LIST_SETS)
"""Where the chances and the weights of columns begin, behind those of the list of tiles."""

_WHERE: Final = "columns"
_CHANGED: Final = "The file was changed or cut."


@dataclass(frozen=True)
class View:
    """Columns along `axis`, from outside to inside; `inverted` where that is against the grid's sense."""

    grid: Grid
    axis: int
    inverted: bool

    @property
    def order(self) -> tuple[int, int, int]:
        """The axes across, and the main one."""
        a, b = (c for c in range(3) if c != self.axis)
        return a, b, self.axis

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Samples along these axes."""
        a, b, c = (self.grid.shape[axis] for axis in self.order)
        return a, b, c

    @property
    def tiles_shape(self) -> tuple[int, int, int]:
        """Tiles of 8 x 8 columns, as bricks of a grid that is one brick thick."""
        a, b, _ = (self.grid.brick_shape[axis] for axis in self.order)
        return a, b, 1


def least_size(tiles: int, bricks: int) -> int:
    """Bytes that the code of so many tiles and bricks of the guess has at least."""
    return max(tiles - BRICKS_FREE, -(-(bricks - BRICKS_FREE) // BRICKS_PER_BYTE), 0)


def columns_of(view: View, tiles: NDArray[np.int32], heads: Int64s) -> kernels.Columns:
    """Columns of tiles, int32 [n, 3] ascending, that nothing is known of."""
    across = view.tiles_shape[1] + 2
    keys = tiles[:, 0].astype(np.int64) * across + tiles[:, 1]
    around = np.full((len(tiles), 4), -1, np.int64)
    for n, step in enumerate((-1, -across, -across - 1, -across + 1)):
        slot = np.minimum(np.searchsorted(keys, keys + step), len(keys) - 1)
        around[:, n] = np.where(keys[slot] == keys + step, slot, -1)
    cols = np.zeros((len(tiles) * BRICK * BRICK + 1, kernels.WIDTH), np.int64)
    cols[-1, kernels.U + 2] = 1  # stands in for none where that takes no part
    sizes = np.array(view.sizes[:2], np.int64)
    return kernels.Columns(tiles[:, :2].astype(np.int64), around, sizes, heads, cols)


def forces_of(view: View, columns: kernels.Columns, size: int | None = None) -> FixedField:
    """The forces that columns stand for; `size` bytes bound how many bricks these may fill."""
    depth, tiles = view.sizes[2], columns.tiles
    first = np.empty(len(tiles), np.int64)
    kernels.tile_spans(columns.cols, depth, first)
    low = np.zeros(len(tiles), np.int64) if view.inverted else first // BRICK
    high = -(-(depth - first if view.inverted else np.full(len(tiles), depth)) // BRICK)
    count = np.where(first < depth, high - low, 0)
    total = int(count.sum())
    if size is not None and size < least_size(len(tiles), total):
        least = least_size(len(tiles), total)
        raise TruncatedFile(_WHERE, f"{size} bytes for {total} bricks", f"{least} or more", _CHANGED)
    tile_of = np.repeat(np.arange(len(tiles)), count)
    along = np.arange(total) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    bricks = np.zeros((total, 3), np.int32)
    bricks[:, list(view.order[:2])] = tiles[tile_of]
    bricks[:, view.axis] = along
    order = np.argsort(brick_keys(view.grid, bricks))
    vectors = np.zeros((total, BRICK, BRICK, BRICK, 3), np.int32)
    seen = vectors.transpose(0, *(1 + c for c in view.order), 4)
    what = kernels.Layout(tile_of[order], along[order] * BRICK, depth, view.inverted, np.array(view.order))
    for_chunks(kernels.fill_bricks, total, what, columns.heads, columns.cols, seen, chunk=64)
    return FixedField(bricks[order], vectors)


def synthesise(data: bytes, grid: Grid) -> FixedField:
    """The guess from its bytes; whole numbers throughout.

    Some 110 KiB are taken for each byte at most, beside 2 MiB.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what the encoder writes.
    """
    axis, at = read_varint(data, 0, f"{_WHERE}, axis", 6)
    view = View(grid, axis >> 1, bool(axis & 1))
    heads = np.zeros(kernels.HEADS, np.int64)
    for n, limit in enumerate(kernels.HEAD_LIMITS):
        heads[n], at = read_varint(data, at, f"{_WHERE}, head {n}", limit)
    bits = reader(data[at:], fresh(CONTEXTS, SETS))
    tiles = code_bricks(bits, 0, 0, view.tiles_shape, None, None)
    size = len(data) - at
    if not len(tiles):
        raise CorruptFile(_WHERE, "no tile", "one at least", _CHANGED)
    if size < least_size(len(tiles), 0):
        raise TruncatedFile(_WHERE, f"{size} bytes for {len(tiles)} tiles", "a byte each", _CHANGED)
    columns = columns_of(view, tiles, heads)
    if not coder.read_columns(bits, AT, columns, coder.room()):
        raise CorruptFile(_WHERE, "a column predicted from none", "one beside it", _CHANGED)
    if bits.state[PLACE] > size + 6:  # what is held in the interval, and left away where it is zero
        raise TruncatedFile(_WHERE, f"the end of the code after {size} bytes", "more of it", _CHANGED)
    return forces_of(view, columns, size)
