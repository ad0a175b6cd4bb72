"""Frames of the coder `touch`: the course of a scan, what both sides know before a frame, and its decoding.

Bricks are walked from deep to shallow: axis 0 of a scan is the slowest, and along each axis it goes the way that the
force points. In its coordinates components are turned and signed alike, so that nothing else knows of axes. The bytes
of a frame: the course, a byte; what a force loses along each axis, three varints; then one arithmetic code of the
list of bricks and of the bricks (`kernels.decode_pass`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int32s, Int64s
from touchfield.codec.kernels.bits import Models, fresh, reader
from touchfield.codec.kernels.support import LIST_CONTEXTS, LIST_SETS
from touchfield.codec.support import check_end, code_bricks
from touchfield.codec.touch.kernels import workspace as kernels
from touchfield.codec.touch.kernels.decode_pass import CONTEXTS, SETS, decode_bricks
from touchfield.codec.touch.kernels.workspace import CLASSES, FEATURES, Law, Scan, fresh_work
from touchfield.codec.touch.lattice import FixedField, Lattice, warp_of
from touchfield.codec.varint import read_varint
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium.field import slots_around
from touchfield.medium.grid import BRICK, Grid

SLOPE_LIMIT: Final = 1 << 17
_SAMPLES: Final = BRICK**3
_WHERE: Final = "frame of coder touch"


@dataclass(frozen=True)
class Course:
    """The course of a scan over the bricks of a grid."""

    grid: Grid
    axis: int  # of the grid, the slowest of the scan; the others follow in ascending order
    down: tuple[bool, bool, bool]  # whether the axes of the scan run against those of the grid

    @property
    def axes(self) -> Int64s:
        """Axes of the grid, slowest first."""
        return np.array([self.axis, *(c for c in range(3) if c != self.axis)], np.int64)

    @property
    def code(self) -> int:
        """The number that a file has for it: the axis, and 4, 8, 16 where axes 0, 1, 2 of the scan run down."""
        return self.axis | sum(4 << n for n in range(3) if self.down[n])

    @classmethod
    def of_code(cls, grid: Grid, code: int) -> Course:
        """The course of such a number, below 32 and not 3 modulo 4."""
        return cls(grid, code & 3, (bool(code & 4), bool(code & 8), bool(code & 16)))

    def order(self, bricks: Int32s) -> tuple[Int64s, Int64s]:
        """Bricks of the grid in the scan's coordinates, int64 [n, 3] in scan order, and which each of them is."""
        axes = self.axes
        turned = bricks[:, axes].astype(np.int64)
        last = np.array(self.grid.brick_shape, np.int64)[axes] - 1
        turned = np.where(self.down, last - turned, turned)
        order = np.lexsort(turned.T[::-1])
        return turned[order], order.astype(np.int64)

    def turned(self, vectors: NDArray[Any], slots: Int64s, scale: float = 1.0) -> NDArray[Any]:
        """Vectors [n, 8, 8, 8, 3] of the grid as [n, 512, 3] of the scan: int32 stay whole, floats become float64."""
        whole = vectors.dtype == np.int32
        out = np.empty((len(slots), _SAMPLES, 3), np.int32 if whole else np.float64)
        factor = np.int32(1) if whole else np.float64(scale)
        kernels.turned(vectors.reshape(-1, _SAMPLES, 3), slots, self.axes, np.array(self.down), factor, out)
        return out

    def turned_back(self, cells: Int32s, slots: Int64s) -> Int32s:
        """Vectors int32 [n, 8, 8, 8, 3] of the grid, of the cells [n, 512, 8] of a scan."""
        out = np.empty((len(slots), BRICK, BRICK, BRICK, 3), np.int32)
        kernels.turned_back(cells, slots, self.axes, np.array(self.down), out.reshape(-1, _SAMPLES, 3))
        return out

    def scan(self, bricks: Int64s, reference: FixedField | None) -> Scan:
        """Walk of a pass: bricks in scan order, as `order` gives them, beside a reference."""
        axes, down = self.axes, np.array(self.down)
        size = np.array(self.grid.shape, np.int64)[axes]
        count = np.array(self.grid.brick_shape, np.int64)[axes]
        # samples beyond the grid lie in its last bricks, which are the first ones of an axis that runs down
        rest = count * BRICK - size
        low = np.where(down & (bricks == 0), rest, 0)
        high = np.where(~down & (bricks == count - 1), BRICK - rest, BRICK)
        if reference is None:
            vectors, around = np.zeros((1, _SAMPLES, 3), np.int32), np.zeros((0, 27), np.int64)
        else:
            theirs, slots = self.order(reference.bricks)
            vectors, around = self.turned(reference.vectors, slots), slots_around(bricks, theirs, count, 27)
        cells = np.zeros((len(bricks), _SAMPLES, 8), np.int32)
        return Scan(slots_around(bricks, bricks, count, 13), around, low, high, vectors, cells)


@dataclass(frozen=True)
class Memory:
    """Lessons of a frame: the chances and weights of its code, and the weights of the blend."""

    models: Models
    weights: Int64s  # [16, 13]

    def copy(self) -> Memory:
        """One that may be changed without this one."""
        models = self.models._replace(chances=self.models.chances.copy(), weights=self.models.weights.copy())
        return Memory(models, self.weights.copy())


@dataclass(frozen=True)
class Known:
    """Knowledge of encoder and decoder before a frame."""

    grid: Grid
    lattice: Lattice
    reference: FixedField | None  # a field to predict from: a guess that was sent, or the frame decoded before
    memory: Memory  # changed by who decodes the frame


def fresh_memory() -> Memory:
    """Of a frame that stands alone."""
    models = fresh(CONTEXTS + LIST_CONTEXTS, SETS + LIST_SETS)
    return Memory(models, np.zeros((CLASSES, FEATURES), np.int64))


def law_of(lattice: Lattice, slope: Int64s) -> Law:
    """The force law of a frame, for its pass."""
    steps = lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate
    return Law(slope, *steps, *warp_of(lattice.floor, lattice.rate))


def decode_frame(payload: bytes, known: Known) -> FixedField:
    """Decode a frame. CorruptFile or TruncatedFile if the bytes are not what `frame_encoder.encode_frame` writes."""
    if not payload:
        raise TruncatedFile(_WHERE, "no bytes", "the course of the scan")
    if payload[0] & 3 == 3 or payload[0] > 31:
        raise CorruptFile(_WHERE, f"a course of {payload[0]}", "an axis of 0 to 2, and three bits")
    slope, at = np.zeros(3, np.int64), 1
    for n in range(3):
        slope[n], at = read_varint(payload, at, f"{_WHERE}, slope", SLOPE_LIMIT)
    bits = reader(payload[at:], known.memory.models)
    before = None if known.reference is None else known.reference.bricks
    bricks = code_bricks(bits, CONTEXTS, SETS, known.grid.brick_shape, None, before)
    course = Course.of_code(known.grid, payload[0])
    places, order = course.order(bricks)
    scan = course.scan(places, known.reference)
    if not decode_bricks(bits, scan, law_of(known.lattice, slope), fresh_work(known.memory.weights)):
        raise TruncatedFile(_WHERE, f"the end of the code after {len(payload)} bytes", f"{len(bricks)} bricks")
    check_end(bits, len(bricks), _WHERE)
    return FixedField(bricks, course.turned_back(scan.cells, order))
