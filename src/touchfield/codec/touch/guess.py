"""A field that is guessed of a frame before its voxels are told: by a spline, or column by column.

The spline is a smooth field from one potential (docs/format/touch-base-layer.md). Paper figure 4 lets "source
models" compete with plain samples. Of a penalty field F = min(K d, F_max) n the depth d grows against the
normal n: all of it follows from the potential f = K d, which is smooth through the surface and below zero
outside. So f is told by the coefficients of a cubic B-spline on a coarse lattice of nodes, and

    F = -min(f, 65536) grad f / max(|grad f|, K / 2),   where f > 0.

The spline is taken at the corners half-way between samples: f at a sample is the mean of the eight corners
around it, its gradient is their differences. What is guessed is smooth by construction; bricks that are not
told hold none.

Solids with steps are told column by column: along the main axis of the force a column of samples shares n,
and its depth grows from the surface on. So a column of a height map is a direction, a start, and the force
deep inside; where a low-pass has mixed the surfaces at both sides of a step, two such surfaces whose forces
add. All is predicted from the columns beside.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Int32s, Int64s
from touchfield.codec.kernels import LIST_CONTEXTS, LIST_SETS, fresh, reader
from touchfield.codec.support import BRICKS_FREE, BRICKS_PER_BYTE, check_read, code_bricks
from touchfield.codec.touch.kernels import guess as kernels
from touchfield.codec.touch.kernels.guess import NODE_CONTEXTS, code_nodes
from touchfield.codec.touch.lattice import TOP, FixedField
from touchfield.codec.varint import Parts, write_varint
from touchfield.compute.threads import for_chunks
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

SPLINE_CONTEXTS: Final = LIST_CONTEXTS + NODE_CONTEXTS

_WHERE: Final = "spline"
_CHUNK: Final = 64
_STEEPEST: Final = 1 << 20
_HALF_SLOPE: Final = 1 << 14


class Head(NamedTuple):
    """Numbers that all nodes share."""

    shifts: tuple[int, int, int]  # nodes lie 2^shift samples apart along x, y, z; 2 to 5
    step: int  # units between the values that a coefficient may differ by from what is expected; 1 or more
    # what a derivative is multiplied by, so that the stiffness K is 32768: 2^35 over 864 times the
    # growth of f, in units, from sample to sample of a normal along x, y, z; 1 or more
    scales: tuple[int, int, int]

    def to_bytes(self) -> bytes:
        """Seven varints."""
        return b"".join(map(write_varint, (*self.shifts, self.step, *self.scales)))

    @classmethod
    def read(cls, parts: Parts) -> Head:
        """The inverse of `to_bytes`."""
        x, y, z = (parts.varint("head", 6, 2) for _ in range(3))
        step, a, b, c = (parts.varint("head", 1 << 20, 1) for _ in range(4))
        return cls((x, y, z), step, (a, b, c))


class Nodes:
    """The nodes that bricks int32 [n, 3] need, in raster order (x slowest).

    Those of each brick are `around`, int64 [n, x, y, z]; those before each node `before`, int64 [nodes, 6]
    (`code_nodes`).
    """

    def __init__(self, bricks: Int32s, shifts: tuple[int, int, int]) -> None:
        first = bricks.astype(np.int64) * BRICK >> np.array(shifts)
        first -= first.min(axis=0) - 1  # none lies before the first layer
        counts = [max(BRICK >> shift, 1) + 3 for shift in shifts]
        _, ny, nz = (first.max(axis=0) + counts).tolist()
        x, y, z = ny * nz, nz, 1
        offsets = np.indices(counts).reshape(3, -1).T @ (x, y, z)
        keys, around = np.unique((first @ (x, y, z))[:, None] + offsets, return_inverse=True)
        self.around: Int64s = around.reshape(-1, *counts)
        steps = np.array((x, y, z, x + y, y + z, z + x))
        wanted = keys[:, None] - steps
        self.before: Int64s = np.searchsorted(keys, wanted)
        self.before[keys[self.before] != wanted] = -1


def weights(shift: int) -> Int64s:
    """Weights at a brick's corners by its place in a cell, int64 [h / 8, nodes, 9], of sum 6 h^3; h =
    2^shift.
    """
    h, cells = 1 << shift, max(BRICK >> shift, 1)
    out = np.zeros((max(h // BRICK, 1), cells + 3, BRICK + 1), np.int64)
    for brick, corner in np.ndindex(len(out), BRICK + 1):
        cell = min(corner >> shift, cells - 1)
        p = BRICK * brick + corner - cell * h
        q = h - p
        row = (q**3, 4 * h**3 - 6 * h * p**2 + 3 * p**3, 4 * h**3 - 6 * h * q**2 + 3 * q**3, p**3)
        out[brick, cell : cell + 4, corner] = row
    return out


def forces_of(head: Head, grid: Grid, bricks: Int32s, values: Int64s) -> FixedField:
    """The forces in bricks, int32 [n, 3], by the values of the nodes that they need, int64 [n, x, y, z]."""
    vectors = np.zeros((len(bricks), BRICK, BRICK, BRICK, 3), np.int32)
    tables = [weights(shift) for shift in head.shifts]

    def fill(begin: int, end: int) -> None:
        for at in range(begin, end, _CHUNK):
            some = slice(at, min(at + _CHUNK, end))
            f = values[some]
            for axis, (shift, table) in enumerate(zip(head.shifts, tables, strict=True)):
                table = table[bricks[some, axis] % len(table)]
                f = np.moveaxis(f.reshape(len(f), table.shape[1], -1), 1, 2) @ table
                f = (f + (1 << 3 * shift >> 1)) >> 3 * shift
            _fill(f.reshape(-1, BRICK + 1, BRICK + 1, BRICK + 1), head, vectors[some])

    for_chunks(fill, len(bricks), chunk=_CHUNK)
    for axis, size in enumerate(grid.shape):
        beyond = bricks[:, axis, None] * BRICK + np.arange(BRICK) >= size
        np.moveaxis(vectors, axis + 1, 1)[beyond] = 0
    return FixedField(bricks, vectors)


def _fill(corners: Int64s, head: Head, out: Int32s) -> None:
    """Forces [n, 8, 8, 8, 3] of a potential at the corners around them, int64 [n, 9, 9, 9]."""
    size, *slopes = (_mixed(corners, axis) for axis in (-1, 0, 1, 2))
    size = np.clip((size + 864) // 1728, 0, TOP)
    slopes = [
        np.clip(slope * scale >> 20, -_STEEPEST, _STEEPEST)
        for slope, scale in zip(slopes, head.scales, strict=True)
    ]
    square = slopes[0] ** 2 + slopes[1] ** 2 + slopes[2] ** 2
    steep = np.maximum(np.sqrt(square).astype(np.int64), _HALF_SLOPE)  # exact: below 2^52
    for c, slope in enumerate(slopes):
        out[..., c] = (steep - 2 * size * slope) // (2 * steep)


def _mixed(v: Int64s, along: int) -> Int64s:
    """Differences of neighbours along one axis, if any, and their sums along the others."""
    for axis in range(3):
        low, high = v[:, :-1], v[:, 1:]
        v = np.moveaxis(high - low if axis == along else high + low, 1, 3)
    return v


def spline_of(data: bytes, grid: Grid) -> FixedField:
    """The spline's field from its bytes; see `synthesise`."""
    parts = Parts(data, _WHERE)
    head, bits = Head.read(parts), reader(parts.rest(), fresh(SPLINE_CONTEXTS, LIST_SETS))
    bricks = code_bricks(bits, 0, 0, grid.brick_shape, None, None)
    if not len(bricks):
        raise CorruptFile(_WHERE, "no brick", "one at least")
    nodes = Nodes(bricks, head.shifts)
    values = np.zeros((2, len(nodes.before)), np.int64)
    code_nodes(bits, LIST_CONTEXTS, nodes.before, head.step, *values)
    check_read(bits, _WHERE)
    return forces_of(head, grid, bricks, values[0][nodes.around])


SPLINE: Final = 0
COLUMNS: Final = 1  # the first byte of a guess


def synthesise(data: bytes, grid: Grid) -> FixedField:
    """The guess from its bytes, each of which takes some 400 KiB at most, beside 6 MiB; whole numbers
    throughout.

    TruncatedFile or CorruptFile if they are not what the encoder writes.
    """
    if not data:
        raise TruncatedFile("guess", "no bytes", "its kind")
    if data[0] == SPLINE:
        return spline_of(data[1:], grid)
    if data[0] == COLUMNS:
        return columns_of_bytes(data[1:], grid)
    raise CorruptFile("guess", f"kind {data[0]}", f"{SPLINE} or {COLUMNS}")


DEEPEST: Final = 1 << 14  # samples of a column, at most
TILES_FREE: Final = 64  # tiles of the box that need no byte
_COLUMNS: Final = "columns"


class View(NamedTuple):
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
        return min(self.box[2] * BRICK, a - self.box[0] * BRICK), min(
            self.box[3] * BRICK, b - self.box[1] * BRICK
        )


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


def column_forces(view: View, columns: kernels.Columns, size: int | None = None) -> FixedField:
    """The forces that columns stand for; `size` bytes bound how many bricks these may fill."""
    a, b, rows, row = view.box
    depth = view.depth
    surfaces = columns.surfaces.reshape(rows * BRICK + 1, -1, 2, kernels.NUMBERS)[1:, 1:-1]
    starts = np.where(surfaces[..., kernels.A] > 0, surfaces[..., kernels.Z] >> 8, depth)
    starts = starts.reshape(rows, BRICK, row, BRICK, 2).min(axis=(1, 3, 4))[..., None] + 1
    low = np.arange(0, depth, BRICK)
    reached = (starts < depth) & ((low < depth - starts) if view.inverted else (low + BRICK > starts))
    bricks_at = np.argwhere(reached)
    if size is not None and size < least_size(view, len(bricks_at)):
        least = f"{least_size(view, len(bricks_at))} or more"
        raise TruncatedFile(_COLUMNS, f"{size} bytes for {len(bricks_at)} bricks", least)
    bricks = np.empty((len(bricks_at), 3), np.int32)
    bricks[:, view.order] = bricks_at + np.array([a, b, 0])
    order = np.argsort(brick_keys(view.grid, bricks))
    i, j, along = bricks_at[order].T
    vectors = np.zeros((len(bricks_at), BRICK, BRICK, BRICK, 3), np.int32)
    places = np.stack([(i * BRICK + 1) * columns.row + 2 * (j * BRICK + 1), along * BRICK], axis=1)
    seen = vectors.transpose(0, *(1 + c for c in view.order), 4)
    course = depth, view.inverted, np.array(view.order)
    for_chunks(kernels.fill_bricks, len(bricks_at), places, course, columns, seen, chunk=64)
    return FixedField(bricks[order], vectors)


def columns_of_bytes(data: bytes, grid: Grid) -> FixedField:
    """The guess from its bytes, each of which takes some 130 KiB at most, beside 2 MiB; whole numbers
    throughout.

    TruncatedFile or CorruptFile if they are not what the encoder writes.
    """
    parts = Parts(data, _COLUMNS)
    axis = parts.varint("axis", 6)
    across = [n for c, n in enumerate(grid.brick_shape) if c != axis >> 1]
    a, b = (parts.varint("first tile", n) for n in across)
    tiles_a, tiles_b = (1 + parts.varint("number of tiles", n) for n in across)
    heads = np.array([parts.varint(f"head {n}", limit) for n, limit in enumerate(kernels.HEADS)])
    view, code = View(grid, axis >> 1, bool(axis & 1), (a, b, tiles_a, tiles_b)), parts.rest()
    size = len(code)
    if a + tiles_a > across[0] or b + tiles_b > across[1] or view.depth > DEEPEST:
        found = f"tiles {a} to {a + tiles_a}, {b} to {b + tiles_b}"
        raise CorruptFile(_COLUMNS, found, "a box within the grid")
    if size < least_size(view, 0):
        raise TruncatedFile(_COLUMNS, f"{size} bytes for {tiles_a * tiles_b} tiles", "a byte each")
    bits = reader(code, fresh(kernels.COLUMN_CONTEXTS, kernels.COLUMN_SETS))
    columns = columns_of(view, heads)
    rows, count = view.told
    for row in range(rows):
        kernels.read_row(bits, columns, row, count)
    check_read(bits, _COLUMNS)
    return column_forces(view, columns, size)
