"""Frames of the coder `touch`: scan order, state between frames, and decoding.

Bricks are scanned from deep to shallow: axis 0 of a scan is the slowest, and each axis runs in the direction
of the force. In scan coordinates the components of a force are permuted and signed accordingly, so that no
other code depends on the axes. A frame consists of the scan order (one byte), the loss of force along each
axis (three varints), and one arithmetic code of the list of bricks and of their samples
(`kernels.decode_pass`).

The exact mode keeps every bit of a field that is already quantised (docs/format/touch-exact.md). A force is
coded as a few symbols, one in each of several planes. They are a level and a vertex of a direction codebook,
whose float32 product is the force, as the coder `paper` quantises; or the three components of the force. An
inter frame continues with the models of the frame before it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s, Int64s
from touchfield.codec.kernels import LIST_CONTEXTS, LIST_SETS, Models, new_models, reader
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.support import check_end, code_bricks, pad_payload
from touchfield.codec.touch.kernels import exact, workspace as kernels
from touchfield.codec.touch.kernels.decode_pass import CONTEXTS, SETS, decode_bricks
from touchfield.codec.touch.kernels.workspace import CLASSES, FEATURES, Law, Scan, fresh_work
from touchfield.codec.touch.lattice import FixedField, Lattice, warp_of
from touchfield.codec.varint import Parts
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import ForceField
from touchfield.medium.field import neighbour_slots
from touchfield.medium.grid import BRICK, Grid

SLOPE_LIMIT: Final = 1 << 17
_SAMPLES: Final = BRICK**3
_WHERE: Final = "frame of coder touch"


@dataclass(frozen=True)
class ScanOrder:
    """Order and directions of a scan over the bricks of a grid."""

    grid: Grid
    # index of the grid axis that is slowest in the scan, plus 4, 8, 16 if axis 0, 1, 2 of the scan runs
    # downwards
    code: int

    @property
    def axes(self) -> Int64s:
        """Axes of the grid, slowest first; the others ascend."""
        slowest = self.code & 3
        return np.array([slowest, *(c for c in range(3) if c != slowest)], np.int64)

    @property
    def down(self) -> Bools:
        """True where an axis of the scan runs against that of the grid, bool [3]."""
        return self.code & np.array([4, 8, 16]) > 0

    def order(self, bricks: Int32s) -> tuple[Int64s, Int64s]:
        """Sort bricks in scan order.

        Returns the bricks in scan coordinates, int64 [n, 3], and the index of each in `bricks`.
        """
        axes = self.axes
        scan_bricks = bricks[:, axes].astype(np.int64)
        last = np.array(self.grid.brick_shape, np.int64)[axes] - 1
        scan_bricks = np.where(self.down, last - scan_bricks, scan_bricks)
        order = np.lexsort(scan_bricks.T[::-1])
        return scan_bricks[order], order.astype(np.int64)

    def permute(self, vectors: NDArray[Any], slots: Int64s, scale: float = 1.0) -> NDArray[Any]:
        """Permute vectors [n, 8, 8, 8, 3] of the grid to [n, 512, 3] of the scan.

        int32 stays int32, floats become float64.
        """
        kind, axes = np.int32 if vectors.dtype == np.int32 else np.float64, np.argsort(self.axes)
        out, flat = np.empty((len(slots), _SAMPLES, 3), kind), vectors.reshape(-1, _SAMPLES, 3)
        kernels.turned(flat, np.argsort(slots), axes, self.down[axes], kind(scale), out)
        return out

    def unpermute(self, cells: Int32s, slots: Int64s) -> Int32s:
        """Permute cells of a scan, [n, 512, 8], to vectors of the grid.

        int32 [n, 8, 8, 8, 3].
        """
        out = np.empty((len(slots), _SAMPLES, 3), np.int32)
        kernels.turned(cells, slots, self.axes, self.down, np.int32(1), out)
        return out.reshape(-1, BRICK, BRICK, BRICK, 3)

    def scan(self, bricks: Int64s, reference: FixedField | None) -> Scan:
        """Arguments of a coding pass over `bricks`, with a reference field.

        `bricks` are those that `order` returns.
        """
        axes, down = self.axes, self.down
        size = np.array(self.grid.shape, np.int64)[axes]
        count = np.array(self.grid.brick_shape, np.int64)[axes]
        # samples outside the grid lie in the last bricks, which come first on an axis that runs downwards
        rest = count * BRICK - size
        low = np.where(down & (bricks == 0), rest, 0)
        high = np.where(~down & (bricks == count - 1), BRICK - rest, BRICK)
        if reference is None:
            reference_cells, around = np.zeros((1, _SAMPLES, 4), np.int32), np.zeros((0, 27), np.int64)
        else:
            reference_bricks, slots = self.order(reference.bricks)
            reference_cells, around = (
                np.empty((len(reference_bricks), _SAMPLES, 4), np.int32),
                neighbour_slots(bricks, reference_bricks, count),
            )
            vectors = reference_cells[..., :3] = self.permute(reference.vectors, slots)
            reference_cells[..., 3] = np.sqrt(
                np.einsum("nik,nik->ni", vectors, vectors, dtype=np.float64)
            )  # exact, see `root`
        cells = np.zeros((len(bricks), _SAMPLES, 8), np.int32)
        return Scan(neighbour_slots(bricks, bricks, count, 13), around, low, high, reference_cells, cells)


class Memory(NamedTuple):
    """State after a frame: models of its code, and weights of the adaptive predictor."""

    models: Models
    weights: Int64s  # [16, 13]

    def copy(self) -> Memory:
        """Copy of all arrays."""
        return Memory(self.models.copy(), self.weights.copy())


def new_memory() -> Memory:
    """Initial state, for a frame coded on its own."""
    models = new_models(CONTEXTS + LIST_CONTEXTS, SETS + LIST_SETS)
    return Memory(models, np.zeros((CLASSES, FEATURES), np.int64))


def step_table(lattice: Lattice, slope: Int64s) -> Law:
    """Step sizes by amplitude of a frame, for its pass."""
    steps = lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate
    return Law(slope, *steps, warp_of(lattice.floor, lattice.rate))


def decode_frame(
    payload: bytes, grid: Grid, lattice: Lattice, reference: FixedField | None, memory: Memory
) -> FixedField:
    """Decode a frame, and update `memory` in place.

    `reference` is the field to predict from: a base layer, or the frame decoded before. CorruptFile or
    TruncatedFile if the bytes are not those of `frame_encoder.encode_frame`.
    """
    parts = Parts(payload, _WHERE)
    (code,) = parts.take(1, "scan order")
    if code & 3 == 3 or code > 31:
        raise CorruptFile(_WHERE, f"a scan order of {code}", "an axis of 0 to 2, and three bits")
    slope = np.array([parts.varint("slope", SLOPE_LIMIT) for _ in range(3)])
    bits = reader(parts.rest(), memory.models)
    listed = None if reference is None else reference.bricks
    bricks = code_bricks(bits, CONTEXTS, SETS, grid.brick_shape, None, listed)
    scan_order = ScanOrder(grid, code)
    scan_bricks, order = scan_order.order(bricks)
    scan = scan_order.scan(scan_bricks, reference)
    decode_bricks(bits, scan, step_table(lattice, slope), fresh_work(memory.weights))
    check_end(bits, len(bricks), _WHERE)
    return FixedField(bricks, scan_order.unpermute(scan.cells, order))


_EXACT: Final = "exact frame"


class Palette(NamedTuple):
    """Mapping of symbols to forces."""

    book: int  # 1 + index of a codebook in `codebook_names`; 0: symbols are components
    levels: Float32s  # [k]; ascending; empty without a codebook

    @property
    def codebook(self) -> Codebook:
        """The direction codebook; only if `book` is not 0."""
        return Codebook.get(codebook_names()[self.book - 1])

    @property
    def sizes(self) -> Int64s:
        """Number of symbols of each plane, int64 [planes]."""
        return np.array([len(self.levels), len(self.codebook)] if self.book else [1 << 32] * 3)

    def forces(self, symbols: Int64s) -> Float32s:
        """Forces, float32 [n, 3], of symbols, int64 [n, planes]."""
        if self.book:
            return self.levels[symbols[:, :1]] * self.codebook.vertices_float32[symbols[:, 1]]
        return _ordered(symbols - (1 << 31)).astype(np.int32).view(np.float32)

    @classmethod
    def read(cls, data: bytes, previous: Palette | None) -> tuple[Palette, bytes]:
        """The palette at the start of a payload, and the bytes after it."""
        if data and previous is not None:
            if data[0] not in (0, previous.book):
                raise CorruptFile(_EXACT, f"codebook {data[0]}", f"0, or {previous.book} as before")
            return previous if data[0] else COMPONENTS, data[1:]
        size = 3 + 4 * int.from_bytes(data[1:3], "little") if data[:1] != b"\0" else 1
        if len(data) < size:
            raise TruncatedFile(_EXACT, f"{len(data)} bytes", f"{size} bytes of a palette, or more")
        levels = np.frombuffer(data[3:size], "<f4").astype(np.float32)
        if data[0] > len(codebook_names()) or size == 3 or not np.isfinite(levels).all():
            raise CorruptFile(
                _EXACT, f"codebook {data[0]} of {len(levels)} levels", "finite levels of a codebook"
            )
        return cls(data[0], levels), data[size:]


COMPONENTS: Final = Palette(0, np.zeros(0, np.float32))  # the palette of all float32 components


class DecodedFrame(NamedTuple):
    """A decoded frame, and the state that the next frame may use."""

    field: ForceField  # every brick has a sample with at least one bit set
    palette: Palette
    symbols: Int64s  # [512 * bricks, planes]; -1 where there is no force
    models: Models


# each brick of the exact mode counts as four in the minimum size of a payload, because it takes more memory
BRICK_WEIGHT: Final = 4


def _ordered(numbers: Int64s) -> Int64s:
    """Map the bits of float32, signed int64, to numbers that ascend with the value.

    -0.0 becomes -1. The map is its own inverse.
    """
    return np.where(numbers < 0, numbers ^ 0x7FFFFFFF, numbers)


def components(forces: Float32s) -> Int64s:
    """Component symbols, int64 [any, 3], of forces, float32 [..., 3].

    -1 where there is no force.
    """
    floats = forces.reshape(-1, 3).view(np.int32)
    return np.where(floats.any(axis=1, keepdims=True), _ordered(floats.astype(np.int64)) + (1 << 31), -1)


def models_after(previous: DecodedFrame | None) -> Models:
    """Models for a frame: a copy of those after the frame before, or new ones."""
    return new_models(exact.CONTEXTS, exact.SETS) if previous is None else previous.models.copy()


def decode_exact(data: bytes, grid: Grid, previous: DecodedFrame | None) -> DecodedFrame:
    """Decode a frame of `encoder.encode_exact`.

    `previous` is the frame before, or None for a frame coded on its own. TruncatedFile or CorruptFile if the
    bytes are invalid. The number of bricks is limited to a quarter of what `codec.support` allows; each takes
    some 32 KiB of memory, plus 2 MiB in all.
    """
    palette, data = Palette.read(data, previous and previous.palette)
    models = models_after(previous)
    bits = reader(data, models)
    bricks = code_bricks(bits, 0, 0, grid.brick_shape, None, previous and previous.field.bricks)
    min_size = len(pad_payload(b"", BRICK_WEIGHT * len(bricks)))
    if len(data) < min_size:
        raise TruncatedFile(_EXACT, f"{len(data)} bytes for {len(bricks)} bricks", f"{min_size} or more")
    symbols = np.full((512 * len(bricks), len(palette.sizes)), -1)
    if not exact.code_samples(bits, exact_frame(grid, bricks, palette, symbols, previous)):
        raise CorruptFile(
            _EXACT, "a symbol that there is not, or the end of the bytes", f"{len(bricks)} bricks"
        )
    check_end(bits, BRICK_WEIGHT * len(bricks), _EXACT)
    supported, forces = symbols[:, 0] >= 0, np.zeros((len(bricks), 8, 8, 8, 3), np.float32)
    values = forces.reshape(-1, 3)[supported] = palette.forces(symbols[supported])
    if not np.isfinite(values).all() or not values.view(np.uint32).any(axis=1).all():
        raise CorruptFile(_EXACT, "a sample without force, or with one that is not finite", "forces")
    if not supported.reshape(-1, 512).any(axis=1).all():
        raise CorruptFile(_EXACT, "a brick without force", "none")
    return DecodedFrame(ForceField(grid, bricks, forces), palette, symbols, models)


def exact_frame(
    grid: Grid, bricks: Int32s, palette: Palette, symbols: Int64s, previous: DecodedFrame | None
) -> exact.Frame:
    """Arguments of the exact pass, which codes or fills `symbols`.

    `symbols`: int64 [512 * bricks, planes].
    """
    origins = bricks.astype(np.int64)
    neighbours, previous_symbols = (
        neighbour_slots(origins, origins, grid.brick_shape),
        np.full_like(symbols, -1),
    )
    neighbours[:, 14:] = -1  # coded later
    if previous is not None:
        symbols_before = (
            previous.symbols if previous.palette.book == palette.book else components(previous.field.forces_n)
        )
        slot = neighbour_slots(origins, previous.field.bricks, grid.brick_shape, 14)[:, 13]
        brick = 512 * symbols.shape[1]
        previous_symbols.reshape(-1, brick)[slot >= 0] = symbols_before.reshape(-1, brick)[slot[slot >= 0]]
    inside = np.minimum(np.array(grid.shape) - 8 * origins, 8)
    rows = np.zeros((exact.ROWS, symbols.shape[1]), np.int64)
    return exact.Frame(neighbours, inside, symbols, previous_symbols, palette.sizes, rows, np.zeros(3))
