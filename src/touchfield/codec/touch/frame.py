"""Frames of the coder `touch`: what both sides know before one, and its decoding.

The bytes of a frame: the course of its scan, a byte; what a force
loses along each axis, three varints; then one arithmetic code of the list of bricks and of the bricks
(`kernels.decode_pass`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.brick_list import CONTEXTS as _LIST_CONTEXTS
from touchfield.codec.brick_list import SETS as _LIST_SETS
from touchfield.codec.brick_list import check_end, code_bricks
from touchfield.codec.touch.fixed_field import FixedField
from touchfield.codec.touch.lattice import Lattice, warp_of
from touchfield.codec.touch.scan import Course
from touchfield.codec.varint import read_varint
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.kernels.bits import Models
    from touchfield.codec.touch.kernels.workspace import Law
    from touchfield.medium import Grid

__all__ = ["SLOPE_LIMIT", "Known", "Memory", "decode_frame", "fresh_memory", "law_of", "list_at"]

SLOPE_LIMIT: Final = 1 << 17
_WHERE: Final = "frame of coder touch"


@dataclass(frozen=True)
class Memory:
    """Lessons of a frame: the chances and weights of its code, and the weights of the blend.

    Attributes
    ----------
    models : Models
    weights : int64 [16, 13]
    """

    models: Models
    weights: NDArray[np.int64]

    def copy(self) -> Memory:
        """One that may be changed without this one."""
        models = self.models._replace(chances=self.models.chances.copy(), weights=self.models.weights.copy())
        return Memory(models, self.weights.copy())

    def become(self, other: Memory) -> None:
        """Take what another one has learnt."""
        self.models.chances[:] = other.models.chances
        self.models.weights[:] = other.models.weights
        self.weights[:] = other.weights


@dataclass(frozen=True)
class Known:
    """Knowledge of encoder and decoder before a frame.

    Attributes
    ----------
    grid : Grid
    lattice : Lattice
    reference : FixedField or None
        A field to predict from: a guess that was sent, or the frame decoded before.
    memory : Memory
        Changed by whoever codes the frame.
    """

    grid: Grid
    lattice: Lattice
    reference: FixedField | None
    memory: Memory


def list_at() -> tuple[int, int]:
    """Where the contexts and the sets of weights of the list of bricks begin, behind those of the pass."""
    from touchfield.codec.touch.kernels import support

    return support.CONTEXTS, support.SETS


def fresh_memory() -> Memory:
    """Of a frame that stands alone."""
    from touchfield.codec.kernels.bits import fresh
    from touchfield.codec.touch.kernels.workspace import CLASSES, FEATURES

    contexts, sets = list_at()
    return Memory(fresh(contexts + _LIST_CONTEXTS, sets + _LIST_SETS), np.zeros((CLASSES, FEATURES), np.int64))


def law_of(lattice: Lattice, slope: NDArray[np.int64]) -> Law:
    """The force law of a frame, for its pass."""
    from touchfield.codec.touch.kernels.workspace import Law

    steps = lattice.floor, lattice.rate, lattice.cross_floor, lattice.cross_rate
    return Law(slope, *steps, *warp_of(lattice.floor, lattice.rate))


def decode_frame(payload: bytes, known: Known) -> FixedField:
    """Decode a frame.

    Raises
    ------
    CorruptFile, TruncatedFile
        If the bytes are not what `frame_encoder.encode_frame` writes.
    """
    from touchfield.codec.kernels.bits import reader
    from touchfield.codec.touch.kernels.decode_pass import decode_bricks
    from touchfield.codec.touch.kernels.workspace import fresh_work

    if not payload:
        raise TruncatedFile(_WHERE, "no bytes", "the course of the scan")
    if payload[0] & 3 == 3 or payload[0] > 31:
        raise CorruptFile(_WHERE, f"a course of {payload[0]}", "an axis of 0 to 2, and three bits")
    slope, at = np.zeros(3, np.int64), 1
    for n in range(3):
        slope[n], at = read_varint(payload, at, f"{_WHERE}, slope", SLOPE_LIMIT)
    bits = reader(payload[at:], known.memory.models)
    before = None if known.reference is None else known.reference.bricks
    bricks = code_bricks(bits, *list_at(), known.grid.brick_shape, None, before)
    course = Course.of_code(known.grid, payload[0])
    places, order = course.order(bricks)
    scan = course.scan(places, known.reference)
    if not decode_bricks(bits, scan, law_of(known.lattice, slope), fresh_work(known.memory.weights)):
        raise TruncatedFile(_WHERE, f"the end of the code after {len(payload)} bytes", f"{len(bricks)} bricks")
    check_end(bits, len(bricks), _WHERE)
    return FixedField(bricks, course.turned_back(scan.cells, order))
