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

from touchfield.codec.brick_list import BRICKS_FREE, BRICKS_PER_BYTE
from touchfield.codec.kernels.bits import PLACE, fresh, reader
from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.kernels import columns as kernels
from touchfield.codec.varint import read_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]

__all__ = ["AT", "BRICKS_FREE", "View", "columns_of", "forces_of", "least_size", "synthesise"]

AT: Final = (0, 0)
_WHERE: Final = "columns"
_CHANGED: Final = "The file was changed or cut."
_AT_ONCE: Final = 256


@dataclass(frozen=True)
class View:
    """Columns along `axis`, from outside to inside; `inverted` where that is against the grid's sense.

    Attributes
    ----------
    grid : Grid
    axis : int
    inverted : bool
    box : (int, int, int, int)
        First tile of 8 x 8 columns along the two other axes, and how many there are along each.
    """

    grid: Grid
    axis: int
    inverted: bool
    box: tuple[int, int, int, int]

    @property
    def order(self) -> list[int]:
        """The axes across, and the main one."""
        return [*(c for c in range(3) if c != self.axis), self.axis]

    @property
    def told(self) -> tuple[int, int]:
        """Rows of columns, and columns of a row, within the grid."""
        a, b, _ = (self.grid.shape[axis] for axis in self.order)
        return min(self.box[2] * BRICK, a - self.box[0] * BRICK), min(self.box[3] * BRICK, b - self.box[1] * BRICK)

    @property
    def depth(self) -> int:
        """Samples of a column."""
        return self.grid.shape[self.axis]


def least_size(view: View, bricks: int) -> int:
    """Bytes that the code of so many bricks has at least."""
    tiles = view.box[2] * view.box[3]
    return max(tiles - BRICKS_FREE, -(-(bricks - BRICKS_FREE) // BRICKS_PER_BYTE), 0)


def columns_of(view: View, heads: Int64s) -> kernels.Columns:
    """Columns of a box that nothing is known of."""
    rows, row = view.box[2] * BRICK + 1, view.box[3] * BRICK + 2
    surfaces = np.zeros((rows * row * kernels.SLOTS, kernels.WIDTH), np.int64)
    residuals, four = np.zeros((kernels.SLOTS, 4), np.int64), np.zeros(4, np.int64)
    return kernels.Columns(surfaces, row * kernels.SLOTS, heads, np.zeros(2, np.int64), residuals, four)


def forces_of(view: View, columns: kernels.Columns, size: int | None = None) -> FixedField:
    """The forces that columns stand for; `size` bytes bound how many bricks these may fill."""
    a0, b0, rows, row = view.box
    depth, heads = view.depth, columns.heads
    image = columns.surfaces.reshape(rows * BRICK + 1, row * BRICK + 2, kernels.SLOTS, kernels.WIDTH)[1:, 1:-1]
    image = image.reshape(rows, BRICK, row, BRICK, kernels.SLOTS, kernels.WIDTH).transpose(0, 2, 1, 3, 4, 5)
    image = image.reshape(rows * row, BRICK, BRICK, kernels.SLOTS, kernels.WIDTH)
    start = np.where(image[..., kernels.A] > 0, np.clip((image[..., kernels.Z] >> 8) + 1, 0, depth), depth)
    first = start.min(axis=(1, 2, 3))
    low = np.zeros(len(first), np.int64) if view.inverted else first // BRICK
    high = -(-(depth - first if view.inverted else np.full(len(first), depth)) // BRICK)
    count = np.where(first < depth, high - low, 0)
    total = int(count.sum())
    if size is not None and size < least_size(view, total):
        raise TruncatedFile(_WHERE, f"{size} bytes for {total} bricks", f"{least_size(view, total)} or more", _CHANGED)
    tile_of = np.repeat(np.arange(len(first)), count)
    along = np.arange(total) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    bricks = np.zeros((total, 3), np.int32)
    bricks[:, view.order] = np.stack([a0 + tile_of // row, b0 + tile_of % row, along], axis=1)
    order = np.argsort(brick_keys(view.grid, bricks))
    bricks, tile_of, along = bricks[order], tile_of[order], along[order]
    vectors = np.zeros((total, BRICK, BRICK, BRICK, 3), np.int32)
    seen = vectors.transpose(0, *(1 + c for c in view.order), 4)
    for n in range(0, total, _AT_ONCE):
        t = along[n : n + _AT_ONCE, None] * BRICK + np.arange(BRICK)
        t = depth - 1 - t if view.inverted else t
        seen[n : n + _AT_ONCE][..., view.order] = _forces(image[tile_of[n : n + _AT_ONCE]], start[tile_of[n : n + _AT_ONCE]], t, depth, heads, view.inverted)
    return FixedField(bricks, vectors)


def _forces(image: Int64s, start: Int64s, t: Int64s, depth: int, heads: Int64s, inverted: bool) -> Int64s:
    """Of bricks: image [n, 8, 8, slots, numbers] and samples t [n, 8]; [n, 8, 8, 8, 3]."""
    t = t[:, None, None]
    total = np.zeros((*image.shape[:3], BRICK, 3), np.int64)
    length = np.zeros(total.shape[:-1], np.int64)
    for slot in range(kernels.SLOTS):
        s = image[:, :, :, slot, :, None]
        if not s[:, :, :, kernels.A].any():
            continue
        slope = np.maximum(16, heads[kernels.RAMP] * s[:, :, :, kernels.U + 2] >> 14)
        share = np.clip(((t << 8) - s[:, :, :, kernels.Z]) * slope >> 8, 0, 65536)
        length += share * s[:, :, :, kernels.A]
        for c in range(3):
            total[..., c] += share * ((s[:, :, :, kernels.A] * s[:, :, :, kernels.U + c] + 8192) >> 14)
    total = np.clip((total + 32768) >> 16, -kernels.LIMIT, kernels.LIMIT)
    if not inverted:
        total[..., 2] *= -1
    total[(length <= heads[kernels.CUT] << 16) | (t < start.min(axis=3)[..., None]) | (t < 0) | (t >= depth)] = 0
    return total


def synthesise(data: bytes, grid: Grid) -> FixedField:
    """The guess from its bytes; whole numbers throughout.

    Some 110 KiB are taken for each byte at most, beside 2 MiB.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what the encoder writes.
    """
    axis, at = read_varint(data, 0, f"{_WHERE}, axis", 6)
    across = [n for c, n in enumerate(grid.brick_shape) if c != axis >> 1]
    told = []
    for n, limit in enumerate((*across, *across, *kernels.HEADS)):
        value, at = read_varint(data, at, f"{_WHERE}, head {n}", limit)
        told.append(value)
    a, b, rows, row = told[0], told[1], told[2] + 1, told[3] + 1
    view = View(grid, axis >> 1, bool(axis & 1), (a, b, rows, row))
    size = len(data) - at
    if a + rows > across[0] or b + row > across[1]:
        raise CorruptFile(_WHERE, "a box beyond the grid", "one within it", _CHANGED)
    if size < least_size(view, 0):
        raise TruncatedFile(_WHERE, f"{size} bytes for {rows * row} tiles", "a byte each", _CHANGED)
    bits = reader(data[at:], fresh(kernels.CONTEXTS, kernels.SETS))
    columns = columns_of(view, np.array(told[4:], np.int64))
    if not kernels.read_columns(bits, AT, columns, *view.told):
        raise CorruptFile(_WHERE, "a column predicted from none", "one beside it", _CHANGED)
    if bits.state[PLACE] > size + 6:  # what is held in the interval, and left away where it is zero
        raise TruncatedFile(_WHERE, f"the end of the code after {size} bytes", "more of it", _CHANGED)
    return forces_of(view, columns, size)
