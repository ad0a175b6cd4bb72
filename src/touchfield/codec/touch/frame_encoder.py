"""Encoding of a frame: the rule that it keeps, its course and law, the pass, and the ways that an effort tries.

A frame is coded after the one before or alone, with a guess or without; the fewest bytes win, or, where every error
has its price, the best bargain. A cell of the lattice with three equal edges s has the half diagonal s sqrt(3) / 2:
it lies within the ball of the mask where s <= 2 / sqrt(3) max(F_0, k |F|) (docs/theory.md 31). Along and across
differ in mode "mask-direction", whose ball is a disc of directions times a span of lengths.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int32s, Int64s
from touchfield.codec.kernels import end_of, writer
from touchfield.codec.support import code_bricks, padded
from touchfield.codec.touch.frame import SLOPE_LIMIT, Course, Known, Memory, fresh_memory, law_of
from touchfield.codec.touch.guess_fit import fit
from touchfield.codec.touch.kernels.decode_pass import CONTEXTS, SETS
from touchfield.codec.touch.kernels.encode_pass import Limits, encode_bricks
from touchfield.codec.touch.kernels.workspace import fresh_work
from touchfield.codec.touch.lattice import (
    FLOOR_LIMIT,
    LEAST_UNIFORM,
    RATE_LIMIT,
    SMALLEST_UNIT_N,
    TOP,
    FixedField,
    Lattice,
)
from touchfield.codec.touch.promise import agreement
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import write_varint
from touchfield.medium import ForceField, Grid

_CELL: Final = 1.17
"""Edge of a cell over max(F_0, k |F|).

2 / sqrt(3) = 1.1547 fits without any rounding. Of a somewhat larger cell only the corners are beyond the ball, and
an encoder goes to another point there; from 1.25 on too many voxels are sent apart.
"""

# the same along the force in mode "mask-direction", whose span of lengths alone would take 2; measured
_SPAN: Final = 1.8
_SPAN_FLOOR: Final = 1.25  # the same where F_0 rules there, a ball again for short forces
# edge of a square cell over the radius of the disc that holds it, with room for rounding
_DISC: Final = 0.97 * math.sqrt(2)
_THRIFT: Final = 0.1  # what a bit may cost in mode "nmse", squared steps; measured


def lattice_for(spec: TouchSpec, longest_n: float) -> Lattice:
    """The lattice of a segment whose longest force is `longest_n`; a uniform step is 1/3120 of it at least."""
    unit_n = float(np.float32(max(longest_n / TOP, SMALLEST_UNIT_N)))
    if spec.mode == "nmse":
        step = max(_floor(spec.step_n / unit_n), LEAST_UNIFORM)
        return Lattice(unit_n, step, 0, step, 0)
    floor, rate = _floor(_CELL * spec.f0_n / unit_n), _rate(_CELL * spec.k)
    if spec.mode == "mask":
        return Lattice(unit_n, floor, rate, floor, rate)
    cross_rate = _rate(_DISC * math.sin(math.radians(spec.direction_jnd_deg)))
    return Lattice(unit_n, _floor(_SPAN_FLOOR * spec.f0_n / unit_n), _rate(_SPAN * spec.k), floor, cross_rate)


def limits_for(spec: TouchSpec, lattice: Lattice) -> Limits:
    """The error that the passes may make, in units of the lattice."""
    free = spec.mode == "nmse"
    sine = math.sin(math.radians(spec.direction_jnd_deg)) if spec.mode == "mask-direction" else 0.0
    f0 = lattice.floor * 0.5 if free else spec.f0_n / lattice.unit_n
    exact, thorough = spec.support == "exact", spec.effort == "max"
    return Limits(0.0 if free else spec.k, f0, sine, _THRIFT, free, exact, thorough)


def _floor(units: float) -> int:
    return int(min(max(units, 1), FLOOR_LIMIT - 1))


def _rate(share: float) -> int:
    return min(int(share * 65536), RATE_LIMIT - 1)


_LOOKED_AT: Final = 64  # bricks that the law is taken from, about
_STEEP: Final = 0.19  # share of a force along an axis, from which on it tells of the law


class CodedFrame(NamedTuple):
    """A frame's bytes, and what the decoder will make of them and learn."""

    payload: bytes
    decoded: FixedField
    bits: tuple[float, float, float]  # of support, amplitude and direction; their sum is the payload's
    memory: Memory


class Sketch(NamedTuple):
    """A frame as its pass takes it, whatever it is predicted from."""

    course: Course
    bricks: Int32s  # [n, 3]; of the grid, ascending, without those that hold no force worth coding
    places: Int64s  # [n, 3]; in scan order
    order: Int64s  # [n]; which of the bricks each of these is
    # [n, 512, 3]; in scan order, units; with spatial masking [n, 512, 4], the last what forces around hide
    forces: Float64s
    slope: Int64s  # [3]


def sketch_of(frame: ForceField, unit_n: float, limits: Limits, hidden_n: Float32s) -> Sketch:
    """Course, law and forces of a frame; `hidden_n` as `promise.hidden_of` has it."""
    bricks, vectors, scale = frame.bricks, frame.forces_n, 1.0 / np.float64(np.float32(unit_n))
    if not limits.exact and len(bricks):
        peak = np.abs(vectors).reshape(len(bricks), -1).max(axis=1) * scale > limits.f0 / 2
        if not peak.all():
            bricks, vectors = bricks[peak], vectors[peak]
            hidden_n = hidden_n[peak] if len(hidden_n) else hidden_n
    course = _course_of(vectors, frame.grid)
    places, order = course.order(bricks)
    forces = course.turned(vectors, order, scale)
    slope = _slope_of(forces, frame.grid, course.axes)
    if len(hidden_n):  # a number of each voxel is turned as a vector of three alike, of which one is taken
        alike = np.repeat(hidden_n.reshape(-1, 8, 8, 8, 1), 3, axis=-1)
        forces = np.concatenate([forces, np.abs(course.turned(alike, order, scale))[..., :1]], axis=-1)
    return Sketch(course, bricks, places, order, forces, slope)


def _course_of(vectors: Float32s, grid: Grid) -> Course:
    """With the force along every axis; the slowest is that along which it points most, of two alike the coarser."""
    flat = vectors.reshape(-1, 3)
    sums, sizes = flat.sum(axis=0, dtype=np.float64), np.abs(flat).sum(axis=0, dtype=np.float64)
    spacing = np.asarray(grid.spacing_m)
    fine = spacing < min(1.01 * spacing.min(), 0.99 * spacing.max())
    axis = int(np.argmax((np.abs(sums) + 0.01 * sizes) * np.where(fine, 0.85, 1.0)))
    down = [bool(sums[c] < 0) for c in (axis, *(c for c in range(3) if c != axis))]
    return Course(grid, axis, (down[0], down[1], down[2]))


def _slope_of(forces: Float64s, grid: Grid, axes: Int64s) -> Int64s:
    """Loss of a force in a step along each axis, from some bricks."""
    some = forces[:: max(1, len(forces) // _LOOKED_AT)].reshape(-1, 8, 8, 8, 3)
    spacing = np.asarray(grid.spacing_m, np.float64)[axes]
    lengths = np.sqrt((some * some).sum(axis=-1))
    here, there, along = lengths[:, :-1], lengths[:, 1:], some[:, :-1, ..., 0]
    tells = (here >= 1) & (here < 0.97 * TOP) & (there >= 1) & (there < 0.97 * TOP) & (along > _STEEP * here)
    lost = TOP / 12 * spacing[0] / spacing.max()
    if tells.any():
        lost = max(0.0, float(np.median((here - there)[tells] * here[tells] / along[tells])))
    slope: Int64s = np.rint(np.minimum(lost * spacing / spacing[0], SLOPE_LIMIT - 1)).astype(np.int64)
    return slope


def encode_frame(sketch: Sketch, known: Known, limits: Limits) -> CodedFrame:
    """Code a frame; `known` stays as it is."""
    head = bytes([sketch.course.code]) + b"".join(write_varint(s) for s in sketch.slope.tolist())
    before = None if known.reference is None else known.reference.bricks
    room = (1 << 16) + 400 * len(sketch.bricks)
    while True:
        memory = known.memory.copy()
        bits = writer(room, memory.models)
        code_bricks(bits, CONTEXTS, SETS, known.grid.brick_shape, sketch.bricks, before)
        listed = 8.0 * len(head) + 8.0 * float(bits.state[2])
        scan = sketch.course.scan(sketch.places, known.reference)
        law, prices = law_of(known.lattice, sketch.slope), np.zeros(3)
        if encode_bricks(bits, scan, law, fresh_work(memory.weights), sketch.forces, limits, prices):
            break
        room *= 4
    payload = head + padded(end_of(bits), len(sketch.bricks))
    decoded = FixedField(sketch.bricks, sketch.course.turned_back(scan.cells, sketch.order))
    support, amplitude, direction = prices.tolist()
    return CodedFrame(payload, decoded, (support + listed, amplitude, direction), memory)


class Way(NamedTuple):
    """How a frame is coded: whether the frame before is known, and a guess."""

    inter: bool
    guess: tuple[bytes, FixedField] | None


class _Effort(NamedTuple):
    """Trials of an effort, by shares of voxels at which a field keeps the rule."""

    alike: float  # of the frame before: from it on a frame is coded after that,
    unlike: float  # below this alone, and between them both ways are tried
    still: float  # of the frame before: from it on no guess is looked for
    trusted: float  # of a guess: from it on nothing else is tried
    earns: float  # of a frame's bytes: a guess that earns less is not looked for again in its segment


_EFFORTS: Final = {
    "fast": _Effort(0.1, 0.1, 0.8, 0.85, 0.1),
    "default": _Effort(0.1, 0.02, 0.8, 0.85, 0.03),
    "max": _Effort(1.1, -1.0, 1.1, 1.1, -1.0),
}


class Chooser:
    """State of an encoder within a segment."""

    def __init__(self, grid: Grid, spec: TouchSpec, lattice: Lattice) -> None:
        self._grid, self._spec, self._lattice, self._effort = grid, spec, lattice, _EFFORTS[spec.effort]
        self._limits: Limits = limits_for(spec, lattice)
        self._previous: FixedField | None = None
        self._memory: Memory = fresh_memory()
        self._looks = spec.guess == "auto"

    def add(self, frame: ForceField, hidden_n: Float32s) -> tuple[CodedFrame, bool, bytes]:
        """Code the next frame; whether it knows the one before, and the bytes of its guess."""
        sketch = sketch_of(frame, self._lattice.unit_n, self._limits, hidden_n)
        limits = self._limits._replace(thorough=False)
        tried = [(self._coded(sketch, way, limits), way) for way in self._ways(frame, sketch)]
        worths = [self._worth(sketch, coded, way) for coded, way in tried]
        best, way = tried[worths.index(min(worths))]
        if tried[0][1].guess is not None and len(tried) > 1:  # the guess stands first
            self._looks = worths[0] < (1 - self._effort.earns) * min(worths[1:])
        if self._limits.thorough:
            best = min(best, self._coded(sketch, way, self._limits), key=lambda one: self._worth(sketch, one, way))
        self._previous, self._memory = best.decoded, best.memory
        return best, way.inter, way.guess[0] if way.guess else b""

    def _ways(self, frame: ForceField, sketch: Sketch) -> list[Way]:
        effort, previous = self._effort, self._previous
        alike = 0.0
        if previous is not None and self._spec.interframe == "auto":
            alike = agreement(frame, previous, self._lattice.unit_n, self._spec)
        inters = [False, True]
        if previous is None or self._spec.interframe == "off":
            inters = [False]
        elif self._spec.interframe == "on" or alike >= effort.alike:
            inters = [True]
        elif alike < effort.unlike:
            inters = [False]
        guess, kept = None, 0.0
        if self._looks and alike < effort.still and len(sketch.bricks):
            guess, kept = fit(frame, self._lattice, self._limits, self._spec)
        ways = [Way(inter, None) for inter in inters]
        if guess is None or kept <= alike:
            return ways
        guessed = [Way(inters[-1], guess)]
        return guessed if kept >= effort.trusted and not self._limits.free else guessed + ways

    def _coded(self, sketch: Sketch, way: Way, limits: Limits) -> CodedFrame:
        reference, memory = (self._previous, self._memory) if way.inter else (None, fresh_memory())
        if way.guess is not None:
            reference = way.guess[1]
        return encode_frame(sketch, Known(self._grid, self._lattice, reference, memory), limits)

    def _worth(self, sketch: Sketch, coded: CodedFrame, way: Way) -> float:
        """Bytes; where every error has its price, what they and the errors come to."""
        size = len(coded.payload) + (len(way.guess[0]) if way.guess else 0)
        if not self._limits.free:
            return float(size)
        made = sketch.course.turned(coded.decoded.vectors, sketch.order)
        error = float(((made - sketch.forces) ** 2).sum()) / self._lattice.floor**2
        return error / (8 * self._limits.thrift) + size
