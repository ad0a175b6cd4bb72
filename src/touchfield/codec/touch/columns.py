"""The column guess of the coder `touch`: solids with steps, told column by column (docs/format/touch-guess.md).

A penalty field is F = K d n behind a surface, F_max at most: along the main axis of the force a column of samples
shares n, and its depth grows from the surface on. So a column of a height map is told by a direction, a start, and
the force deep inside; where a low-pass has mixed the surfaces at both sides of a step, by two such surfaces whose
forces add. All is predicted from the columns beside.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.kernels.bits import PLACE, fresh, reader
from touchfield.codec.support import BRICKS_FREE, BRICKS_PER_BYTE
from touchfield.codec.touch.kernels import guess as kernels
from touchfield.codec.touch.lattice import FixedField
from touchfield.codec.varint import read_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid
from touchfield.parallel import for_chunks

DEEPEST: Final = 1 << 14  # samples of a column, at most
TILES_FREE: Final = 64  # tiles of the box that need no byte
_WHERE: Final = "columns"
_CHANGED: Final = "The file was changed or cut."


@dataclass(frozen=True)
class View:
    """Columns of a box, from outside to inside."""

    grid: Grid
    axis: int  # they run along it
    inverted: bool  # whether outside is where its samples end
    # the first tile of 8 x 8 columns along the other axes, a before b, and how many there are
    # along each
    box: tuple[int, int, int, int]

    @property
    def order(self) -> list[int]:
        """The axes across, and the main one."""
        return [*(c for c in range(3) if c != self.axis), self.axis]

    @property
    def depth(self) -> int:
        """Samples of a column."""
        return self.grid.shape[self.axis]

    @property
    def told(self) -> tuple[int, int]:
        """Rows of columns, and columns of a row, within the grid."""
        a, b = (self.grid.shape[c] for c in self.order[:2])
        return min(self.box[2] * BRICK, a - self.box[0] * BRICK), min(self.box[3] * BRICK, b - self.box[1] * BRICK)


def least_size(view: View, bricks: int) -> int:
    """Bytes that the code of the guess has at least."""
    tiles = view.box[2] * view.box[3]
    return max(tiles - TILES_FREE, -(-(bricks - BRICKS_FREE) // BRICKS_PER_BYTE), 0)


def columns_of(view: View, heads: Int64s) -> kernels.Columns:
    """Columns of a box that nothing is known of."""
    row = 2 * (view.box[3] * BRICK + 2)
    surfaces = np.zeros(((view.box[2] * BRICK + 1) * row, kernels.NUMBERS), np.int64)
    told, residuals, expected = np.zeros(4, np.int64), np.zeros((2, 4), np.int64), np.zeros(4, np.int64)
    return kernels.Columns(surfaces, row, heads, told, residuals, expected)


def forces_of(view: View, columns: kernels.Columns, size: int | None = None) -> FixedField:
    """The forces that columns stand for; `size` bytes bound how many bricks these may fill."""
    a, b, rows, row = view.box
    depth = view.depth
    surfaces = columns.surfaces.reshape(rows * BRICK + 1, -1, 2, kernels.NUMBERS)[1:, 1:-1]
    starts = np.where(surfaces[..., kernels.A] > 0, surfaces[..., kernels.Z] >> 8, depth)
    starts = starts.reshape(rows, BRICK, row, BRICK, 2).min(axis=(1, 3, 4))[..., None] + 1
    low = np.arange(0, depth, BRICK)
    held = (starts < depth) & ((low < depth - starts) if view.inverted else (low + BRICK > starts))
    found = np.argwhere(held)
    if size is not None and size < least_size(view, len(found)):
        least = f"{least_size(view, len(found))} or more"
        raise TruncatedFile(_WHERE, f"{size} bytes for {len(found)} bricks", least, _CHANGED)
    bricks = np.empty((len(found), 3), np.int32)
    bricks[:, view.order] = found + np.array([a, b, 0])
    order = np.argsort(brick_keys(view.grid, bricks))
    i, j, along = found[order].T
    vectors = np.zeros((len(found), BRICK, BRICK, BRICK, 3), np.int32)
    places = np.stack([(i * BRICK + 1) * columns.row + 2 * (j * BRICK + 1), along * BRICK], axis=1)
    seen = vectors.transpose(0, *(1 + c for c in view.order), 4)
    told = depth, view.inverted, np.array(view.order)
    for_chunks(kernels.fill_bricks, len(found), places, told, columns, seen, chunk=64)
    return FixedField(bricks[order], vectors)


def synthesise(data: bytes, grid: Grid) -> FixedField:
    """The guess from its bytes, each of which takes some 130 KiB at most, beside 2 MiB; whole numbers throughout.

    TruncatedFile or CorruptFile if they are not what the encoder writes.
    """
    axis, at = read_varint(data, 0, f"{_WHERE}, axis", 6)
    across = [n for c, n in enumerate(grid.brick_shape) if c != axis >> 1]
    head = []
    for n, limit in enumerate((*across, *across, *kernels.HEADS)):
        value, at = read_varint(data, at, f"{_WHERE}, head {n}", limit)
        head.append(value)
    a, b, tiles_a, tiles_b = head[0], head[1], head[2] + 1, head[3] + 1
    view, size = View(grid, axis >> 1, bool(axis & 1), (a, b, tiles_a, tiles_b)), len(data) - at
    if a + tiles_a > across[0] or b + tiles_b > across[1] or view.depth > DEEPEST:
        found = f"tiles {a} to {a + tiles_a}, {b} to {b + tiles_b}"
        raise CorruptFile(_WHERE, found, "a box within the grid", _CHANGED)
    if size < least_size(view, 0):
        raise TruncatedFile(_WHERE, f"{size} bytes for {tiles_a * tiles_b} tiles", "a byte each", _CHANGED)
    bits = reader(data[at:], fresh(kernels.COLUMN_CONTEXTS, kernels.COLUMN_SETS))
    columns = columns_of(view, np.array(head[4:], np.int64))
    rows, count = view.told
    for row in range(rows):
        kernels.code_row(bits, columns, row, np.zeros((count, kernels.WISHES), np.int64))
    if bits.state[PLACE] > size + 6:  # what is held in the interval, and left away where it is zero
        raise TruncatedFile(_WHERE, f"the end of the code after {size} bytes", "more of it", _CHANGED)
    return forces_of(view, columns, size)
