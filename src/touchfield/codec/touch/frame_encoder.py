"""Encoding of a frame: its course, the slope of its law, and the pass that codes it in closed loop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.brick_list import code_bricks, padded
from touchfield.codec.touch.fixed_field import TOP, FixedField
from touchfield.codec.touch.frame import SLOPE_LIMIT, Known, law_of, list_at
from touchfield.codec.touch.scan import Course
from touchfield.codec.varint import write_varint

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.medium import ForceField, Grid

__all__ = ["CodedFrame", "Sketch", "encode_frame", "sketch_of"]

_LOOKED_AT: Final = 64
"""Bricks that the law is taken from, about."""

_STEEP: Final = 0.19
"""Share of a force along an axis, from which on it tells of the law."""


@dataclass(frozen=True)
class CodedFrame:
    """A frame's bytes, and what the decoder will make of them.

    Attributes
    ----------
    payload : bytes
    decoded : FixedField
    bits : (float, float, float)
        Of support, amplitude and direction; their sum is the payload's.
    """

    payload: bytes
    decoded: FixedField
    bits: tuple[float, float, float]


@dataclass(frozen=True)
class Sketch:
    """A frame as its pass takes it, whatever it is predicted from.

    Attributes
    ----------
    course : Course
    bricks : int32 [n, 3]
        Of the grid, ascending, without those that hold no force worth coding.
    places : int64 [n, 3]
        In scan order.
    order : int64 [n]
        Which of the bricks each of these is.
    forces : float64 [n, 512, 3]
        In scan order, units.
    slope : int64 [3]
    """

    course: Course
    bricks: NDArray[np.int32]
    places: NDArray[np.int64]
    order: NDArray[np.int64]
    forces: NDArray[np.float64]
    slope: NDArray[np.int64]


def sketch_of(frame: ForceField, unit_n: float, limits: Limits) -> Sketch:
    """Course, law and forces of a frame."""
    bricks, vectors, scale = frame.bricks, frame.forces_n, 1.0 / np.float64(np.float32(unit_n))
    if not limits.exact and len(bricks):
        peak = np.abs(vectors).reshape(len(bricks), -1).max(axis=1) * scale > limits.f0 / 2
        if not peak.all():
            bricks, vectors = bricks[peak], vectors[peak]
    course = _course_of(vectors, frame.grid)
    places, order = course.order(bricks)
    forces = course.turned(vectors, order, scale)
    slope = _slope_of(forces, frame.grid, course.axes)
    return Sketch(course, bricks, places, order, forces, slope)


def _course_of(vectors: NDArray[np.float32], grid: Grid) -> Course:
    """With the force along every axis; the slowest is the one along which it points most.

    Of two alike, it is not that of the finest sampling, whose neighbours are worth more in the plane.
    """
    flat = vectors.reshape(-1, 3)
    sums, sizes = flat.sum(axis=0, dtype=np.float64), np.abs(flat).sum(axis=0, dtype=np.float64)
    spacing = np.asarray(grid.spacing_m)
    fine = spacing < min(1.01 * spacing.min(), 0.99 * spacing.max())
    axis = int(np.argmax((np.abs(sums) + 0.01 * sizes) * np.where(fine, 0.85, 1.0)))
    down = [bool(sums[c] < 0) for c in (axis, *(c for c in range(3) if c != axis))]
    return Course(grid, axis, (down[0], down[1], down[2]))


def _slope_of(forces: NDArray[np.float64], grid: Grid, axes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Loss of a force in a step along each axis, from some bricks."""
    some = forces[:: max(1, len(forces) // _LOOKED_AT)].reshape(-1, 8, 8, 8, 3)
    spacing = np.asarray(grid.spacing_m, np.float64)[axes]
    lengths = np.sqrt((some * some).sum(axis=-1))
    here, there, along = lengths[:, :-1], lengths[:, 1:], some[:, :-1, ..., 0]
    tells = (here >= 1) & (here < 0.97 * TOP) & (there >= 1) & (there < 0.97 * TOP) & (along > _STEEP * here)
    lost = TOP / 12 * spacing[0] / spacing.max()
    if tells.any():
        lost = max(0.0, float(np.median((here - there)[tells] * here[tells] / along[tells])))
    slope: NDArray[np.int64] = np.rint(np.minimum(lost * spacing / spacing[0], SLOPE_LIMIT - 1)).astype(np.int64)
    return slope


def encode_frame(sketch: Sketch, known: Known, limits: Limits) -> CodedFrame:
    """Code a frame; ``known.memory`` becomes what it has taught.

    Parameters
    ----------
    sketch : Sketch
    known : Known
    limits : Limits
    """
    from touchfield.codec.kernels.bits import end_of, writer
    from touchfield.codec.touch.kernels.encode_pass import encode_bricks
    from touchfield.codec.touch.kernels.workspace import fresh_work

    head = bytes([sketch.course.code]) + b"".join(write_varint(s) for s in sketch.slope.tolist())
    before = None if known.reference is None else known.reference.bricks
    room = (1 << 16) + 400 * len(sketch.bricks)
    while True:
        memory = known.memory.copy()
        bits = writer(room, memory.models)
        code_bricks(bits, *list_at(), known.grid.brick_shape, sketch.bricks, before)
        listed = 8.0 * len(head) + 8.0 * float(bits.state[2])
        scan = sketch.course.scan(sketch.places, known.reference)
        law, prices = law_of(known.lattice, sketch.slope), np.zeros(3)
        if encode_bricks(bits, scan, law, fresh_work(memory.weights), sketch.forces, limits, prices):
            break
        room *= 4
    payload = head + padded(end_of(bits), len(sketch.bricks))
    known.memory.become(memory)
    decoded = FixedField(sketch.bricks, sketch.course.turned_back(scan.cells, sketch.order))
    support, amplitude, direction = prices.tolist()
    return CodedFrame(payload, decoded, (support + listed, amplitude, direction))
