"""The part of the second decoder for coder `touch`: a segment's body, its lattice and geometry, and its exceptions.

It follows docs/format.md as `reference_decoder` does, of which it takes varints, the arithmetic decoder and supports;
`reference_touch_motion`, `reference_touch_surface`, `reference_touch_light`, `reference_touch_max`,
`reference_touch_post` and `reference_touch_lossless` are the parts that it loads where a frame needs them. Whole
numbers are Python's; but for one sum of frame model 2, none of them needs more than 53 bits.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from reference_decoder import Cursor, Forces, Position, brick_counts, need

__all__ = ["Field", "Lattice", "Vector", "along_axes", "decode_touch_body", "rebuilt", "root"]

Vector = tuple[int, int, int]
LIMIT = (1 << 17) - 1


@dataclass
class Field:
    """A frame in units: its bricks, of which one may hold no force, and the vectors of its samples with a force."""

    bricks: list[Position] = field(default_factory=list)
    vectors: dict[Position, Vector] = field(default_factory=dict)


# -- the lattice and its geometry -------------------------------------------------------------------------


def root(n: int) -> int:
    """The square root, rounded down."""
    return math.isqrt(n)


@dataclass(frozen=True)
class Lattice:
    """Steps along and across a force."""

    unit_n: np.float32
    floor: int
    rate: int
    cross_floor: int
    cross_rate: int

    @cached_property
    def borders(self) -> list[int]:
        """Amplitudes of each sixteenth of a step, 1/256 units."""
        borders = [0]
        while borders[-1] <= 1 << 26:
            step = max(256 * self.floor, borders[-1] * self.rate >> 16)
            borders.append(borders[-1] + max(1, step >> 4))
        return borders

    def level_of(self, a: int) -> int:
        """The level of an amplitude, 1/256 steps."""
        x = a << 8
        low, high = 0, len(self.borders) - 1
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if self.borders[middle] <= x else (low, middle)
        return 16 * low + 16 * (x - self.borders[low]) // (self.borders[low + 1] - self.borders[low])

    def amplitude_of(self, level: int) -> int:
        """The amplitude of a level."""
        size = min(abs(level), 16 * (len(self.borders) - 1) - 1)
        i, rest = size >> 4, size & 15
        a = self.borders[i] + ((self.borders[i + 1] - self.borders[i]) * rest >> 4) + 128 >> 8
        return a if level >= 0 else -a

    def step(self, a: int) -> int:
        """The step along a force."""
        return max(self.floor, a * self.rate >> 16)

    def cross_step(self, a: int) -> int:
        """The step across a force."""
        return max(self.cross_floor, a * self.cross_rate >> 16)


def along_axes(p: Vector, a: int) -> tuple[Vector, Vector, Vector]:
    """Unit vectors along p, whose length is `a`, and across it, in 1/16384."""

    def shortened(v: Vector, length: int) -> Vector:
        inverse = (1 << 44) // length
        x, y, z = (c * inverse + (1 << 29) >> 30 for c in v)
        return x, y, z

    e = shortened(p, a)
    h = (-e[1], e[0], 0) if abs(e[2]) < 14746 else (0, -e[2], e[1])
    h = shortened(h, max(1, root(sum(c * c for c in h))))
    k = (
        e[1] * h[2] - e[2] * h[1] >> 14,
        e[2] * h[0] - e[0] * h[2] >> 14,
        e[0] * h[1] - e[1] * h[0] >> 14,
    )
    return e, h, k


def rebuilt(along: int, s1: int, s2: int, axes: tuple[Vector, Vector, Vector]) -> Vector:
    """The vector of three lengths along three axes."""
    e, h, k = axes
    x, y, z = (max(-LIMIT, min(along * e[c] + s1 * h[c] + s2 * k[c] + 8192 >> 14, LIMIT)) for c in range(3))
    return x, y, z


# -- the body ---------------------------------------------------------------------------------------------


def read_lattice(c: Cursor) -> Lattice:
    """Unit and steps."""
    unit_n = np.float32(c.number("f"))
    need(2.0**-126 <= unit_n <= 2.0**104, f"a unit of {unit_n} N")
    floor, rate, cross_floor, cross_rate = (c.varint() for _ in range(4))
    need(min(floor, cross_floor) >= 1 and max(floor, cross_floor) < 1 << 16, "a floor of the lattice")
    need(max(rate, cross_rate) < 1 << 17, "a rate of the lattice")
    need(floor >= 21 or rate >= 64, "a lattice that is too fine")
    return Lattice(unit_n, floor, rate, cross_floor, cross_rate)


def is_lossless(parameters: bytes) -> bool:
    """Whether the mode of `HEAD.coder_parameters` is 3."""
    c = Cursor(parameters)
    version, asked = c.numbers("BB")
    mode = asked & 3
    need(version == 1 and asked >> 3 <= 2, "the coder parameters")
    numbers = c.numbers(f"{(2, 3, 1, 0)[mode]}d")
    c.end()
    if mode < 2:
        need(0.001 <= numbers[0] < 1 and numbers[1] >= 0, "k or F_0")
    need(mode != 1 or 0 < numbers[2] < 90, "the direction JND")
    need(mode != 2 or numbers[0] > 0, "the step")
    return bool(mode == 3)


def decode_touch_body(
    body: bytes, frame_count: int, shape: Position, spacing_m: tuple[float, ...], parameters: bytes
) -> Iterator[Forces]:
    """The frames of a segment, one after another."""
    c, lossless = Cursor(body), is_lossless(parameters)
    flags = c.number("B")
    need(flags < 2, "unknown flags")
    lattice = None if lossless else read_lattice(c)
    if flags:
        c.number("H")
        need(c.varint() < frame_count, "the frame of the worst voxel")
        need(all(c.varint() < n for n in shape), "the worst voxel")
    known = Known(shape, spacing_m, lattice)
    before: Forces = {}
    for i in range(frame_count):
        how, support, amplitude = c.numbers("BBB")
        model, inter, guess, more, smooth = how & 7, how >> 3 & 1, how >> 4 & 3, how >> 6 & 1, how >> 7
        need(guess < 3 and (model == 3) == lossless and model <= 3, "a frame of an unknown kind")
        need(i or not (inter or guess == 1), "a first frame that needs the one before")
        need(support + amplitude <= 255, "the shares of a frame")
        need(not lossless or not (guess or more or smooth), "a lossless frame with a guess, a filter or exceptions")
        told = c.chunk() if guess else b""
        payload = c.chunk()
        terms = c.chunk() if smooth else b""
        need(terms or not smooth, "an empty filter")
        exceptions = c.chunk() if more else b""
        need(exceptions or not more, "an empty chunk of exceptions")
        if lattice is None:
            lossless_part = import_module("reference_touch_lossless")
            before = lossless_part.decode_lossless(payload, shape, before if inter else None)
            yield before
        else:
            known.previous = known.decoded(model, bool(inter), guess, told, payload)
            shown = known.previous
            if smooth:
                shown = import_module("reference_touch_post").filtered(shown, terms, lattice.floor)
            yield with_exceptions(in_newtons(shown, lattice.unit_n), exceptions, shape)
    c.end()


@dataclass
class Known:
    """What is known before a frame of a segment."""

    shape: Position
    spacing_m: tuple[float, ...]
    lattice: Lattice | None
    previous: Field | None = None
    learnt: Any = None
    """What frame model 2 has learnt."""

    def decoded(self, model: int, inter: bool, guess: int, told: bytes, payload: bytes) -> Field:
        """The next frame, in units."""
        made = None
        if guess == 1:
            made = import_module("reference_touch_motion").moved(told, self.shape, self.lattice, self.previous)
        elif guess == 2:
            made = import_module("reference_touch_surface").synthesised(told, self.shape)
        if model == 2:
            known = self.learnt if inter else None
            others = (self.previous if inter else None), made
            latest = import_module("reference_touch_max")
            one: Field
            one, self.learnt = latest.decode_max(payload, self.shape, self.lattice, others, known)
            return one
        if model == 0:
            quick = import_module("reference_touch_quick")
            known_frame = self.previous if inter else None
            quickly: Field = quick.decode_quick(payload, self.shape, self.lattice, known_frame, made)
            return quickly
        light = import_module("reference_touch_light")
        frame: Field = light.decode_light(payload, self.shape, self.lattice, self.previous if inter else None, made)
        return frame


def in_newtons(frame: Field, unit_n: np.float32) -> Forces:
    """The forces of a frame: one product of float32 each."""
    forces: Forces = {}
    for (x, y, z), vector in sorted(frame.vectors.items()):
        brick = forces.setdefault((x >> 3, y >> 3, z >> 3), np.zeros((8, 8, 8, 3), np.float32))
        brick[x & 7, y & 7, z & 7] = np.array(vector, np.float32) * unit_n
    return forces


def with_exceptions(forces: Forces, data: bytes, shape: Position) -> Forces:
    """The frame with some forces replaced."""
    c, counts = Cursor(data), brick_counts(shape)
    key, last = 0, -1
    while c.at < len(data):
        gap, coded = c.varint(), c.varint()
        key, place = key + gap, coded >> 1
        need(key < math.prod(counts) and place < 512, "an exception beyond the grid")
        need(gap or place > last, "exceptions out of order")
        last = place
        force = np.zeros(3, np.float32) if coded & 1 else np.array(c.numbers("3f"), np.float32)
        brick = (key // counts[2] // counts[1], key // counts[2] % counts[1], key % counts[2])
        local = (place >> 6, place >> 3 & 7, place & 7)
        need(all(8 * b + i < n for b, i, n in zip(brick, local, shape)), "an exception beyond the grid")
        forces.setdefault(brick, np.zeros((8, 8, 8, 3), np.float32))[local] = force
    return {brick: forces[brick] for brick in sorted(forces)}
