"""Encoding of a frame: the rule that it keeps, its course and law, the pass, and the ways that are tried.

A frame is coded after the one before or alone, with a guess or without; the fewest bytes win, or in mode
"nmse" the best bargain of bytes and errors. A cell of the lattice with three equal edges s has the half
diagonal s sqrt(3) / 2: it lies within the ball of the mask where s <= 2 / sqrt(3) max(F_0, k |F|)
(docs/theory.md 31). Along and across differ in mode "mask-direction", whose ball is a disc of directions
times a span of lengths.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s
from touchfield.codec.kernels import end_of, writer
from touchfield.codec.support import code_bricks, padded
from touchfield.codec.touch.frame import Course, Memory, fresh_memory, law_of
from touchfield.codec.touch.guess_fit import fit
from touchfield.codec.touch.kernels.decode_pass import CONTEXTS, SETS
from touchfield.codec.touch.kernels.encode_pass import ROOM, Limits, encode_bricks
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
from touchfield.medium import ForceField, Grid

_CELL: Final = 1.17
"""Edge of a cell over max(F_0, k |F|).

2 / sqrt(3) = 1.1547 fits without any rounding. Of a somewhat larger cell only the corners are beyond the
ball, and an encoder goes to another point there; from 1.25 on too many voxels are sent apart.
"""

# the same along the force in mode "mask-direction", whose span of lengths alone would take 2; measured
_SPAN: Final = 1.8
_SPAN_FLOOR: Final = 1.25  # the same where F_0 rules there, a ball again for short forces
# edge of a square cell over the radius of the disc that holds it, with room for rounding
_DISC: Final = 0.97 * math.sqrt(2)
_BALL: Final = (
    0.75  # largest error in mode "nmse", steps; measured, as what a bit may cost there, squared steps
)
_THRIFT: Final = 0.1
_ROUNDING: Final = 2e-6  # of a force


def lattice_for(spec: TouchSpec, longest_n: float) -> Lattice:
    """The lattice of a segment whose longest force is `longest_n`; a uniform step is 1/3120 of it at least."""
    unit_n = float(np.float32(max(longest_n / TOP, SMALLEST_UNIT_N)))
    if spec.mode == "nmse":
        step = max(_below(FLOOR_LIMIT, spec.step_n / unit_n), LEAST_UNIFORM)
        return Lattice(unit_n, step, 0, step, 0)
    floor, rate = _below(FLOOR_LIMIT, _CELL * spec.f0_n / unit_n), _below(RATE_LIMIT, 65536 * _CELL * spec.k)
    if spec.mode == "mask":
        return Lattice(unit_n, floor, rate, floor, rate)
    cross_rate = _below(RATE_LIMIT, 65536 * _DISC * math.sin(math.radians(spec.direction_jnd_deg)))
    span = _below(FLOOR_LIMIT, _SPAN_FLOOR * spec.f0_n / unit_n), _below(RATE_LIMIT, 65536 * _SPAN * spec.k)
    return Lattice(unit_n, *span, floor, cross_rate)


def limits_for(spec: TouchSpec, lattice: Lattice) -> Limits:
    """The error that the passes may make, in units, less what is lost where whole units become float32
    newtons.
    """
    exact = spec.support == "exact"
    if spec.mode == "nmse":
        return Limits(0.0, _BALL * lattice.floor, 0.0, exact)
    share = 1 - _ROUNDING / spec.k
    sine = math.sin(math.radians(spec.direction_jnd_deg)) if spec.mode == "mask-direction" else 0.0
    return Limits(spec.k * share, spec.f0_n / lattice.unit_n * share, max(sine - _ROUNDING, sine / 2), exact)


def _below(limit: int, number: float) -> int:
    return int(min(max(number, 1), limit - 1))


class CodedFrame(NamedTuple):
    """A frame's bytes, and what the decoder will make of them and learn."""

    payload: bytes
    decoded: FixedField
    bits: tuple[float, float, float]  # of support, amplitude and direction; their sum is the payload's
    memory: Memory
    missed: float  # squares of all errors, units; 0 of frames under a promise


def _course_of(vectors: Float32s, grid: Grid) -> Course:
    """With the force along every axis; the slowest is that along which it points most, of two alike the
    coarser.
    """
    flat = vectors.reshape(-1, 3)
    sums, sizes = flat.sum(axis=0, dtype=np.float64), np.abs(flat).sum(axis=0, dtype=np.float64)
    spacing = np.asarray(grid.spacing_m)
    fine = spacing < min(1.01 * spacing.min(), 0.99 * spacing.max())
    axis = int(np.argmax((np.abs(sums) + 0.01 * sizes) * np.where(fine, 0.85, 1.0)))
    return Course(grid, axis | int((sums[Course(grid, axis).axes] < 0) @ [4, 8, 16]))


def encode_frame(
    frame: ForceField, lattice: Lattice, reference: FixedField | None, before: Memory, limits: Limits,
    hidden_n: Float32s,
) -> CodedFrame:  # fmt: skip
    """Code a frame beside what `frame.decode_frame` knows; `hidden_n` as `promise.hidden_of` has it."""
    bricks, scale = frame.bricks, 1.0 / np.float64(np.float32(lattice.unit_n))
    course = _course_of(frame.forces_n, frame.grid)
    places, order = course.order(bricks)
    forces = course.turned(frame.forces_n, order, scale)
    if len(hidden_n):  # a number of each voxel is turned as a vector of three alike, of which one is taken
        alike = np.repeat(hidden_n.reshape(-1, 8, 8, 8, 1), 3, axis=-1)
        forces = np.concatenate([forces, np.abs(course.turned(alike, order, scale))[..., :1]], axis=-1)
    head = bytes([course.code, 0, 0, 0])  # nothing is expected to be lost along an axis
    memory, law, prices = before.copy(), law_of(lattice, np.zeros(3, np.int64)), np.zeros(4)
    bits = writer((len(bricks) + 1) * ROOM, memory.models)
    code_bricks(
        bits, CONTEXTS, SETS, frame.grid.brick_shape, bricks, None if reference is None else reference.bricks
    )
    scan = course.scan(places, reference)
    encode_bricks(bits, scan, law, fresh_work(memory.weights), forces, limits, prices)
    support, amplitude, direction, _ = prices.tolist()
    return CodedFrame(
        head + padded(end_of(bits), len(bricks)),
        FixedField(bricks, course.turned_back(scan.cells, order)),
        (8.0 * len(head) + support, amplitude, direction),
        memory,
        0.0 if limits.k else float(((scan.cells[..., :3] - forces[..., :3]) ** 2).sum()),
    )


# shares of voxels that keep the rule in the frame before, from which on a frame is coded after that, and no
# guess is looked for; and in a guess, from which on nothing else is tried
_ALIKE, _STILL, _TRUSTED = 0.1, 0.8, 0.85
_EARNS: Final = 0.03  # of a frame's bytes: a guess that earns less is not looked for again in its segment

_Guess = tuple[bytes, FixedField]


class Chooser:
    """State of an encoder within a segment."""

    def __init__(self, grid: Grid, spec: TouchSpec, lattice: Lattice) -> None:
        self._grid, self._spec, self._lattice = grid, spec, lattice
        self._limits: Limits = limits_for(spec, lattice)
        self._previous: FixedField | None = None
        self._memory: Memory = fresh_memory()
        self._looks = spec.guess == "auto"

    def add(self, frame: ForceField, hidden_n: Float32s) -> tuple[CodedFrame, bool, bytes]:
        """Code the next frame; whether it knows the one before, and the bytes of its guess."""
        previous, interframe = self._previous, self._spec.interframe
        alike = 0.0
        if previous is not None and interframe == "auto":
            alike = agreement(frame, previous, self._lattice.unit_n, self._spec)
        inter = previous is not None and (interframe == "on" or alike >= _ALIKE)
        before, memory = (previous, self._memory) if inter else (None, fresh_memory())
        guesses: list[_Guess | None] = [None]
        if self._looks and alike < _STILL:  # one that is worth it, and none beside it, unless it is trusted
            guess, kept = fit(frame, self._lattice, self._limits, self._spec)
            if guess is not None and kept > alike:
                guesses = [guess] if kept >= _TRUSTED and self._spec.mode != "nmse" else [guess, None]
        tried, worths = [], []
        for guess in guesses:
            reference = guess[1] if guess else before
            coded = encode_frame(frame, self._lattice, reference, memory, self._limits, hidden_n)
            tried.append(coded)
            # bytes; in mode "nmse", where every error has its price, what they and the errors come to
            price = coded.missed / self._lattice.floor**2 / (8 * _THRIFT)
            worths.append(price + len(coded.payload) + (len(guess[0]) if guess else 0))
        if len(tried) > 1:
            self._looks = worths[0] < (1 - _EARNS) * worths[1]
        which = worths.index(min(worths))
        best, guess = tried[which], guesses[which]
        self._previous, self._memory = best.decoded, best.memory
        return best, inter, guess[0] if guess else b""
