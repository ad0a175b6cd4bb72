"""Base layers of the coder `touch`: a parametric prediction of a whole frame.

A base layer is a spline or a set of columns (docs/format/touch-base-layer.md). It is sent before the voxels
of a frame, which refine it. Paper figure 4 lets "source models" compete with plain samples.

In a penalty field F = min(K d, F_max) n the depth d grows against the normal n. All of it follows from the
potential f = K d, which is smooth through the surface and negative outside. Therefore f is coded as the
coefficients of a cubic B-spline on a coarse lattice of nodes, and

    F = -min(f, 65536) grad f / max(|grad f|, K / 2),   where f > 0.

The spline is evaluated at the corners half-way between samples: f at a sample is the mean of the eight
corners around it, and its gradient is their differences. The field is smooth by construction; bricks that are
not listed have no force.

Solids with steps are coded column by column: along the main axis of the force the samples of a column share
n, and the depth grows from the surface on. A column of a height map is thus a direction, a start, and the
force deep inside. Where a low-pass filter has mixed the surfaces on both sides of a step, a column has two
such surfaces, whose forces add. The parameters are predicted from neighbouring columns.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Int32s, Int64s
from touchfield.codec.kernels import LIST_CONTEXTS, LIST_SETS, new_models, reader
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
_MAX_SLOPE: Final = 1 << 20
_MIN_STEEPNESS: Final = 1 << 14


class Head(NamedTuple):
    """Parameters of a spline common to all nodes."""

    shifts: tuple[int, int, int]  # nodes lie 2^shift samples apart along x, y, z; 2 to 5
    step: int  # step of the difference between a coefficient and its prediction, in units; 1 or more
    # factors of the derivatives along x, y, z that scale the stiffness K to 32768: 2^35 / (864 g), where g is
    # the growth of f, in units, from one sample to the next along an axis that is parallel to the normal; 1
    # or more
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
    """Nodes of the spline over bricks, int32 [n, 3], in raster order (x slowest).

    `per_brick`, int64 [n, x, y, z]: indices of the nodes of each brick. `predecessors`, int64 [nodes, 6]:
    indices of the preceding neighbours of each node (`code_nodes`), -1 where there is none.
    """

    def __init__(self, bricks: Int32s, shifts: tuple[int, int, int]) -> None:
        first = bricks.astype(np.int64) * BRICK >> np.array(shifts)
        # an empty first layer, so that keys of missing predecessors match no node
        first -= first.min(axis=0) - 1
        counts = [max(BRICK >> shift, 1) + 3 for shift in shifts]
        _, ny, nz = (first.max(axis=0) + counts).tolist()
        x, y, z = ny * nz, nz, 1
        offsets = np.indices(counts).reshape(3, -1).T @ (x, y, z)
        keys, per_brick = np.unique((first @ (x, y, z))[:, None] + offsets, return_inverse=True)
        self.per_brick: Int64s = per_brick.reshape(-1, *counts)
        steps = np.array((x, y, z, x + y, y + z, z + x))
        earlier = keys[:, None] - steps
        self.predecessors: Int64s = np.searchsorted(keys, earlier)
        self.predecessors[keys[self.predecessors] != earlier] = -1


def corner_weights(shift: int) -> Int64s:
    """Weights of the nodes at the corners of a brick, int64 [h / 8, nodes, 9].

    The first axis is the position of the brick in its cell. With h = 2^shift, the weights at a corner sum to
    6 h^3 over the nodes.
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


def spline_forces(head: Head, grid: Grid, bricks: Int32s, values: Int64s) -> FixedField:
    """Forces in bricks, int32 [n, 3], from the values of their nodes.

    `values`: int64 [n, x, y, z].
    """
    vectors = np.zeros((len(bricks), BRICK, BRICK, BRICK, 3), np.int32)
    tables = [corner_weights(shift) for shift in head.shifts]

    def fill(start: int, stop: int) -> None:
        for first in range(start, stop, _CHUNK):
            chunk = slice(first, min(first + _CHUNK, stop))
            f = values[chunk]
            for axis, (shift, table) in enumerate(zip(head.shifts, tables, strict=True)):
                table = table[bricks[chunk, axis] % len(table)]
                f = np.moveaxis(f.reshape(len(f), table.shape[1], -1), 1, 2) @ table
                f = (f + (1 << 3 * shift >> 1)) >> 3 * shift
            _fill(f.reshape(-1, BRICK + 1, BRICK + 1, BRICK + 1), head, vectors[chunk])

    for_chunks(fill, len(bricks), chunk=_CHUNK)
    for axis, size in enumerate(grid.shape):
        is_outside = bricks[:, axis, None] * BRICK + np.arange(BRICK) >= size
        np.moveaxis(vectors, axis + 1, 1)[is_outside] = 0
    return FixedField(bricks, vectors)


def _fill(corners: Int64s, head: Head, out: Int32s) -> None:
    """Forces [n, 8, 8, 8, 3] from the potential at the corners, int64 [n, 9, 9, 9]."""
    size, *slopes = (_combine_neighbours(corners, axis) for axis in (-1, 0, 1, 2))
    size = np.clip((size + 864) // 1728, 0, TOP)
    slopes = [
        np.clip(slope * scale >> 20, -_MAX_SLOPE, _MAX_SLOPE)
        for slope, scale in zip(slopes, head.scales, strict=True)
    ]
    square = slopes[0] ** 2 + slopes[1] ** 2 + slopes[2] ** 2
    steepness = np.maximum(np.sqrt(square).astype(np.int64), _MIN_STEEPNESS)  # exact: below 2^52
    for c, slope in enumerate(slopes):
        out[..., c] = (steepness - 2 * size * slope) // (2 * steepness)


def _combine_neighbours(v: Int64s, along: int) -> Int64s:
    """Differences of neighbours along one axis, and sums along the others.

    With `along` = -1 there are only sums.
    """
    for axis in range(3):
        low, high = v[:, :-1], v[:, 1:]
        v = np.moveaxis(high - low if axis == along else high + low, 1, 3)
    return v


def decode_spline(data: bytes, grid: Grid) -> FixedField:
    """Decode a spline; see `decode_base_layer`."""
    parts = Parts(data, _WHERE)
    head, bits = Head.read(parts), reader(parts.rest(), new_models(SPLINE_CONTEXTS, LIST_SETS))
    bricks = code_bricks(bits, 0, 0, grid.brick_shape, None, None)
    if not len(bricks):
        raise CorruptFile(_WHERE, "no brick", "one at least")
    nodes = Nodes(bricks, head.shifts)
    values = np.zeros((2, len(nodes.predecessors)), np.int64)
    code_nodes(bits, LIST_CONTEXTS, nodes.predecessors, head.step, *values)
    check_read(bits, _WHERE)
    return spline_forces(head, grid, bricks, values[0][nodes.per_brick])


SPLINE: Final = 0
COLUMNS: Final = 1  # SPLINE or COLUMNS is the first byte of a base layer


def decode_base_layer(data: bytes, grid: Grid) -> FixedField:
    """Decode a base layer, with integers throughout.

    The decoder needs up to about 400 KiB of memory per byte, plus 6 MiB. TruncatedFile or CorruptFile if the
    bytes are invalid.
    """
    if not data:
        raise TruncatedFile("base layer", "no bytes", "its kind")
    if data[0] == SPLINE:
        return decode_spline(data[1:], grid)
    if data[0] == COLUMNS:
        return decode_columns(data[1:], grid)
    raise CorruptFile("base layer", f"kind {data[0]}", f"{SPLINE} or {COLUMNS}")


MAX_DEPTH: Final = 1 << 14  # maximum number of samples of a column
TILES_FREE: Final = 64  # number of tiles of the box that need no byte of code
_COLUMNS: Final = "columns"


class View(NamedTuple):
    """Box of columns along one axis, seen from outside to inside."""

    grid: Grid
    axis: int  # direction of the columns
    is_inverted: bool  # whether the outside is at the end of the axis
    # first tile of 8 x 8 columns along the other axes, a before b, and number of tiles along each
    box: tuple[int, int, int, int]

    @property
    def order(self) -> list[int]:
        """The two axes across the columns, then the main axis."""
        return [*(c for c in range(3) if c != self.axis), self.axis]

    @property
    def depth(self) -> int:
        """Number of samples of a column."""
        return self.grid.shape[self.axis]

    @property
    def coded_shape(self) -> tuple[int, int]:
        """Numbers of rows, and of columns in a row, within the grid."""
        a, b = (self.grid.shape[c] for c in self.order[:2])
        return min(self.box[2] * BRICK, a - self.box[0] * BRICK), min(
            self.box[3] * BRICK, b - self.box[1] * BRICK
        )


def min_size(view: View, bricks: int) -> int:
    """Minimum size of the code in bytes."""
    tiles = view.box[2] * view.box[3]
    return max(tiles - TILES_FREE, -(-(bricks - BRICKS_FREE) // BRICKS_PER_BYTE), 0)


def new_columns(view: View, heads: Int64s) -> kernels.Columns:
    """Columns of a box in their initial state."""
    row = 2 * (view.box[3] * BRICK + 2)
    surfaces = np.zeros(((view.box[2] * BRICK + 1) * row, kernels.NUMBERS), np.int64)
    coded, residuals, expected = np.zeros(4, np.int64), np.zeros((2, 4), np.int64), np.zeros(4, np.int64)
    return kernels.Columns(surfaces, row, heads, coded, residuals, expected)


def column_forces(view: View, columns: kernels.Columns, size: int | None = None) -> FixedField:
    """Forces of columns.

    `size`, if given, is the length of the code in bytes; it bounds the number of bricks (TruncatedFile).
    """
    a, b, rows, row = view.box
    depth = view.depth
    surfaces = columns.surfaces.reshape(rows * BRICK + 1, -1, 2, kernels.NUMBERS)[1:, 1:-1]
    starts = np.where(surfaces[..., kernels.A] > 0, surfaces[..., kernels.Z] >> 8, depth)
    starts = starts.reshape(rows, BRICK, row, BRICK, 2).min(axis=(1, 3, 4))[..., None] + 1
    low = np.arange(0, depth, BRICK)
    is_filled = (starts < depth) & ((low < depth - starts) if view.is_inverted else (low + BRICK > starts))
    bricks_at = np.argwhere(is_filled)
    if size is not None and size < min_size(view, len(bricks_at)):
        expected = f"{min_size(view, len(bricks_at))} or more"
        raise TruncatedFile(_COLUMNS, f"{size} bytes for {len(bricks_at)} bricks", expected)
    bricks = np.empty((len(bricks_at), 3), np.int32)
    bricks[:, view.order] = bricks_at + np.array([a, b, 0])
    order = np.argsort(brick_keys(view.grid, bricks))
    i, j, along = bricks_at[order].T
    vectors = np.zeros((len(bricks_at), BRICK, BRICK, BRICK, 3), np.int32)
    positions = np.stack([(i * BRICK + 1) * columns.row + 2 * (j * BRICK + 1), along * BRICK], axis=1)
    view_vectors = vectors.transpose(0, *(1 + c for c in view.order), 4)
    direction = depth, view.is_inverted, np.array(view.order)
    for_chunks(kernels.fill_bricks, len(bricks_at), positions, direction, columns, view_vectors, chunk=64)
    return FixedField(bricks[order], vectors)


def decode_columns(data: bytes, grid: Grid) -> FixedField:
    """Decode a base layer of columns, with integers throughout.

    The decoder needs up to about 130 KiB of memory per byte, plus 2 MiB. TruncatedFile or CorruptFile if the
    bytes are invalid.
    """
    parts = Parts(data, _COLUMNS)
    axis = parts.varint("axis", 6)
    across = [n for c, n in enumerate(grid.brick_shape) if c != axis >> 1]
    a, b = (parts.varint("first tile", n) for n in across)
    tiles_a, tiles_b = (1 + parts.varint("number of tiles", n) for n in across)
    heads = np.array([parts.varint(f"head {n}", limit) for n, limit in enumerate(kernels.HEADS)])
    view, code = View(grid, axis >> 1, bool(axis & 1), (a, b, tiles_a, tiles_b)), parts.rest()
    size = len(code)
    if a + tiles_a > across[0] or b + tiles_b > across[1] or view.depth > MAX_DEPTH:
        found = f"tiles {a} to {a + tiles_a}, {b} to {b + tiles_b}"
        raise CorruptFile(_COLUMNS, found, "a box within the grid")
    if size < min_size(view, 0):
        raise TruncatedFile(_COLUMNS, f"{size} bytes for {tiles_a * tiles_b} tiles", "a byte each")
    bits = reader(code, new_models(kernels.COLUMN_CONTEXTS, kernels.COLUMN_SETS))
    columns = new_columns(view, heads)
    rows, count = view.coded_shape
    for row in range(rows):
        kernels.read_row(bits, columns, row, count)
    check_read(bits, _COLUMNS)
    return column_forces(view, columns, size)
