"""Frames of the coder `touch`: the course of a scan, what both sides know before a frame, and its decoding.

Bricks are walked from deep to shallow: axis 0 of a scan is the slowest, and along each axis it goes the way
that the force points. In its coordinates components are turned and signed alike, so that nothing else knows
of axes. The bytes of a frame: the course, a byte; what a force loses along each axis, three varints; then one
arithmetic code of the list of bricks and of the bricks (`kernels.decode_pass`).

The exact mode keeps a field that is quantised already to the bit of each float32
(docs/format/touch-exact.md). A force is a few symbols, its planes: a level and a vertex of a direction
codebook, whose float32 product it is, as the coder `paper` makes them; or its components as they are. A frame
after another goes on with what that has taught.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Int32s, Int64s
from touchfield.codec.kernels import LIST_CONTEXTS, LIST_SETS, Models, fresh, reader
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.support import check_end, code_bricks, padded
from touchfield.codec.touch.kernels import exact
from touchfield.codec.touch.kernels import workspace as kernels
from touchfield.codec.touch.kernels.decode_pass import CONTEXTS, SETS, decode_bricks
from touchfield.codec.touch.kernels.workspace import CLASSES, FEATURES, Law, Scan, fresh_work
from touchfield.codec.touch.lattice import FixedField, Lattice, warp_of
from touchfield.codec.varint import Parts
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import ForceField
from touchfield.medium.field import slots_around
from touchfield.medium.grid import BRICK, Grid

SLOPE_LIMIT: Final = 1 << 17
_SAMPLES: Final = BRICK**3
_WHERE: Final = "frame of coder touch"


@dataclass(frozen=True)
class Course:
    """The course of a scan over the bricks of a grid."""

    grid: Grid
    # the axis of the grid that is the slowest of the scan, and 4, 8, 16 where axes 0, 1, 2 of it run down
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
        """Bricks of the grid in the scan's coordinates, int64 [n, 3] in scan order, and which each of them
        is.
        """
        axes = self.axes
        turned = bricks[:, axes].astype(np.int64)
        last = np.array(self.grid.brick_shape, np.int64)[axes] - 1
        turned = np.where(self.down, last - turned, turned)
        order = np.lexsort(turned.T[::-1])
        return turned[order], order.astype(np.int64)

    def turned(self, vectors: NDArray[Any], slots: Int64s, scale: float = 1.0) -> NDArray[Any]:
        """Vectors [n, 8, 8, 8, 3] of the grid as [n, 512, 3] of the scan: int32 stay whole, floats become
        float64.
        """
        kind, axes = np.int32 if vectors.dtype == np.int32 else np.float64, np.argsort(self.axes)
        out, flat = np.empty((len(slots), _SAMPLES, 3), kind), vectors.reshape(-1, _SAMPLES, 3)
        kernels.turned(flat, np.argsort(slots), axes, self.down[axes], kind(scale), out)
        return out

    def turned_back(self, cells: Int32s, slots: Int64s) -> Int32s:
        """Vectors int32 [n, 8, 8, 8, 3] of the grid, of the cells [n, 512, 8] of a scan."""
        out = np.empty((len(slots), _SAMPLES, 3), np.int32)
        kernels.turned(cells, slots, self.axes, self.down, np.int32(1), out)
        return out.reshape(-1, BRICK, BRICK, BRICK, 3)

    def scan(self, bricks: Int64s, reference: FixedField | None) -> Scan:
        """Walk of a pass: bricks in scan order, as `order` gives them, beside a reference."""
        axes, down = self.axes, self.down
        size = np.array(self.grid.shape, np.int64)[axes]
        count = np.array(self.grid.brick_shape, np.int64)[axes]
        # samples beyond the grid lie in its last bricks, which are the first ones of an axis that runs down
        rest = count * BRICK - size
        low = np.where(down & (bricks == 0), rest, 0)
        high = np.where(~down & (bricks == count - 1), BRICK - rest, BRICK)
        if reference is None:
            known, around = np.zeros((1, _SAMPLES, 4), np.int32), np.zeros((0, 27), np.int64)
        else:
            theirs, slots = self.order(reference.bricks)
            known, around = (
                np.empty((len(theirs), _SAMPLES, 4), np.int32),
                slots_around(bricks, theirs, count),
            )
            vectors = known[..., :3] = self.turned(reference.vectors, slots)
            known[..., 3] = np.sqrt(
                np.einsum("nik,nik->ni", vectors, vectors, dtype=np.float64)
            )  # exact, see `root`
        cells = np.zeros((len(bricks), _SAMPLES, 8), np.int32)
        return Scan(slots_around(bricks, bricks, count, 13), around, low, high, known, cells)


class Memory(NamedTuple):
    """Lessons of a frame: the chances and weights of its code, and the weights of the blend."""

    models: Models
    weights: Int64s  # [16, 13]

    def copy(self) -> Memory:
        """One that may be changed without this one."""
        return Memory(self.models.copy(), self.weights.copy())


def fresh_memory() -> Memory:
    """Of a frame that stands alone."""
    models = fresh(CONTEXTS + LIST_CONTEXTS, SETS + LIST_SETS)
    return Memory(models, np.zeros((CLASSES, FEATURES), np.int64))


def law_of(lattice: Lattice, slope: Int64s) -> Law:
    """The force law of a frame, for its pass."""
    steps = lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate
    return Law(slope, *steps, warp_of(lattice.floor, lattice.rate))


def decode_frame(
    payload: bytes, grid: Grid, lattice: Lattice, reference: FixedField | None, memory: Memory
) -> FixedField:
    """Decode a frame, and change the memory by it.

    `reference` is a field to predict from: a guess that was sent, or the frame decoded before. CorruptFile or
    TruncatedFile if the bytes are not what `frame_encoder.encode_frame` writes.
    """
    parts = Parts(payload, _WHERE)
    (code,) = parts.take(1, "course of the scan")
    if code & 3 == 3 or code > 31:
        raise CorruptFile(_WHERE, f"a course of {code}", "an axis of 0 to 2, and three bits")
    slope = np.array([parts.varint("slope", SLOPE_LIMIT) for _ in range(3)])
    bits = reader(parts.rest(), memory.models)
    known = None if reference is None else reference.bricks
    bricks = code_bricks(bits, CONTEXTS, SETS, grid.brick_shape, None, known)
    course = Course(grid, code)
    places, order = course.order(bricks)
    scan = course.scan(places, reference)
    decode_bricks(bits, scan, law_of(lattice, slope), fresh_work(memory.weights))
    check_end(bits, len(bricks), _WHERE)
    return FixedField(bricks, course.turned_back(scan.cells, order))


_EXACT: Final = "exact frame"


class Palette(NamedTuple):
    """How symbols become forces."""

    book: int  # 1 + the place of a codebook in `codebook_names`; 0: symbols are components
    levels: Float32s  # [k]; ascending, where there is a codebook

    @property
    def codebook(self) -> Codebook:
        """The codebook, if there is one."""
        return Codebook.get(codebook_names()[self.book - 1])

    @property
    def sizes(self) -> Int64s:
        """How many symbols each plane has, int64 [planes]."""
        return np.array([len(self.levels), len(self.codebook)] if self.book else [1 << 32] * 3)

    def forces(self, symbols: Int64s) -> Float32s:
        """Float32 [n, 3] of symbols, int64 [n, planes]."""
        if self.book:
            return self.levels[symbols[:, :1]] * self.codebook.vertices_float32[symbols[:, 1]]
        return _turned(symbols - (1 << 31)).astype(np.int32).view(np.float32)

    @classmethod
    def read(cls, data: bytes, before: Palette | None) -> tuple[Palette, bytes]:
        """The palette that a payload begins with, and the bytes behind it."""
        if data and before is not None:
            if data[0] not in (0, before.book):
                raise CorruptFile(_EXACT, f"codebook {data[0]}", f"0, or {before.book} as before")
            return before if data[0] else AS_THEY_ARE, data[1:]
        end = 3 + 4 * int.from_bytes(data[1:3], "little") if data[:1] != b"\0" else 1
        if len(data) < end:
            raise TruncatedFile(_EXACT, f"{len(data)} bytes", f"{end} bytes of a palette, or more")
        levels = np.frombuffer(data[3:end], "<f4").astype(np.float32)
        if data[0] > len(codebook_names()) or end == 3 or not np.isfinite(levels).all():
            raise CorruptFile(
                _EXACT, f"codebook {data[0]} of {len(levels)} levels", "finite levels of a codebook"
            )
        return cls(data[0], levels), data[end:]


AS_THEY_ARE: Final = Palette(0, np.zeros(0, np.float32))  # the palette that has every force


class Told(NamedTuple):
    """A frame, and what the next one may know."""

    field: ForceField  # every brick holds a sample of which a bit is set
    palette: Palette
    symbols: Int64s  # [512 * bricks, planes]; -1 where there is no force
    models: Models


BRICK_COUNTS: Final = (
    4  # bricks of a payload that one of this mode counts for: it takes more memory than others
)


def _turned(numbers: Int64s) -> Int64s:
    """Float32 bits, int64 of their sign, as numbers that ascend with the value (-0.0 is -1); or back."""
    return np.where(numbers < 0, numbers ^ 0x7FFFFFFF, numbers)


def components(forces: Float32s) -> Int64s:
    """Symbols of forces, float32 [..., 3], as they are: int64 [any, 3]; -1 where there is none."""
    words = forces.reshape(-1, 3).view(np.int32)
    return np.where(words.any(axis=1, keepdims=True), _turned(words.astype(np.int64)) + (1 << 31), -1)


def models_after(before: Told | None) -> Models:
    """Models of a frame: they have seen what those before it have."""
    return fresh(exact.CONTEXTS, exact.SETS) if before is None else before.models.copy()


def decode_exact(data: bytes, grid: Grid, before: Told | None) -> Told:
    """Decode a frame that `encoder.encode_exact` wrote.

    `before` is the frame before, unless the frame stands alone. TruncatedFile or CorruptFile if the bytes are
    not what that writes. Memory is taken for a quarter of the bricks that `codec.support` allows, some 32 KiB
    each, and 2 MiB.
    """
    palette, data = Palette.read(data, before and before.palette)
    models = models_after(before)
    bits = reader(data, models)
    bricks = code_bricks(bits, 0, 0, grid.brick_shape, None, before and before.field.bricks)
    least = len(padded(b"", BRICK_COUNTS * len(bricks)))
    if len(data) < least:
        raise TruncatedFile(_EXACT, f"{len(data)} bytes for {len(bricks)} bricks", f"{least} or more")
    symbols = np.full((512 * len(bricks), len(palette.sizes)), -1)
    if not exact.code_samples(bits, frame_of(grid, bricks, palette, symbols, before)):
        raise CorruptFile(
            _EXACT, "a symbol that there is not, or the end of the bytes", f"{len(bricks)} bricks"
        )
    check_end(bits, BRICK_COUNTS * len(bricks), _EXACT)
    there, forces = symbols[:, 0] >= 0, np.zeros((len(bricks), 8, 8, 8, 3), np.float32)
    own = forces.reshape(-1, 3)[there] = palette.forces(symbols[there])
    if not np.isfinite(own).all() or not own.view(np.uint32).any(axis=1).all():
        raise CorruptFile(_EXACT, "a sample without force, or with one that is not finite", "forces")
    if not there.reshape(-1, 512).any(axis=1).all():
        raise CorruptFile(_EXACT, "a brick without force", "none")
    return Told(ForceField(grid, bricks, forces), palette, symbols, models)


def frame_of(
    grid: Grid, bricks: Int32s, palette: Palette, symbols: Int64s, before: Told | None
) -> exact.Frame:
    """The work of the pass over the samples; `symbols`, int64 [512 * bricks, planes], are told or filled in."""
    places = bricks.astype(np.int64)
    near, then = slots_around(places, places, grid.brick_shape), np.full_like(symbols, -1)
    near[:, 14:] = -1  # told later
    if before is not None:
        known = before.symbols if before.palette.book == palette.book else components(before.field.forces_n)
        slot = slots_around(places, before.field.bricks, grid.brick_shape, 14)[:, 13]
        brick = 512 * symbols.shape[1]
        then.reshape(-1, brick)[slot >= 0] = known.reshape(-1, brick)[slot[slot >= 0]]
    inside = np.minimum(np.array(grid.shape) - 8 * places, 8)
    rows = np.zeros((exact.ROWS, symbols.shape[1]), np.int64)
    return exact.Frame(near, inside, symbols, then, palette.sizes, rows, np.zeros(3))
