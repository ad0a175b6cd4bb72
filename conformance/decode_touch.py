"""Decodes coder `touch` for the conformance decoder, step by step as docs/format/touch.md says, in plain
Python and numpy. `decoder.py` calls it.

`decode_touch_guess` decodes base layers and `decode_touch_exact` the frames of the exact mode.
"""

import math
import struct
import sys
from collections.abc import Iterator
from typing import Any

import decode_touch_exact as exact_mode
import decode_touch_guess as guesses
import numpy as np
from reading import Bricks, Cursor, Forces, Place, UnsupportedVersion, brick_of, in_bricks, need, samples_of
from touch_bits import Models, bricks
from touch_frame import Frame, Memory, Units
from touch_residual import Lattice, borders

MASK = (0.001, 1 - 2**-53), (0, sys.float_info.max)  # bounds of k, F_0
BOUNDS = (
    MASK,
    (*MASK, (5e-324, 90 - 2**-46)),
    ((5e-324, sys.float_info.max),),
    (),
)  # of the numbers of each mode
MASKING = (5e-324, 1), (1e-6, 1)  # bounds of its share and radius


def is_exact(parameters: bytes) -> bool:
    """Whether the mode is "lossless"; all parameters are checked."""
    need(len(parameters) >= 2, f"{len(parameters)} bytes of parameters")
    need(parameters[0] == 1, f"version {parameters[0]} of the parameters", UnsupportedVersion)
    mode, masking = parameters[1] & 3, parameters[1] >> 5
    need(parameters[1] >> 3 & 3 <= 2 and masking <= (mode == 0), "an effort or a masking that there is not")
    bounds = BOUNDS[mode] + MASKING * masking
    need(len(parameters) == 2 + 8 * len(bounds), f"{len(parameters)} bytes of parameters")
    for (low, high), value in zip(bounds, struct.unpack(f"<{len(bounds)}d", parameters[2:])):
        need(low <= value <= high, f"a parameter of {value}")
    return mode == 3


def decode_segment(body: bytes, parameters: bytes, shape: Place, frame_count: int) -> Iterator[Bricks]:
    """The frames of a segment, one after another."""
    exact, c = is_exact(parameters), Cursor(body)
    flags = c.number("B")
    need(flags <= 1, f"flags of {flags}")
    lattice = None if exact else read_lattice(c)
    if flags:  # the worst voxel
        c.number("H")
        for limit in (frame_count, *shape):
            c.varint(limit)
    frames = []
    for i in range(frame_count):
        how, support, amplitude = c.numbers("3B")
        need(how <= (1 if exact else 7) and support + amplitude <= 255, "the first bytes of a frame")
        need(i or not how & 1, "a first frame that needs the one before")
        chunks = [
            c.chunk(least) if is_there else None
            for is_there, least in ((how & 2, 1), (True, 0), (how & 4, 1))
        ]
        frames.append((how & 1, *chunks))
    c.end()
    known: Any = None
    memory, previous = Memory(Models(), {}), Units([], {})
    for inter, guess, payload, apart in frames:
        if lattice is None:
            known = exact_mode.decode_exact(payload, shape, known if inter else None)
            yield in_bricks(known.forces)
            continue
        if not inter:
            memory, previous = Memory(Models(), {}), Units([], {})
        if guess:
            need(guess[0] <= 1, f"a guess of kind {guess[0]}")
            previous = (guesses.spline, guesses.columns)[guess[0]](guess[1:], shape)
        previous = decode_frame(payload, shape, lattice, previous, memory)
        made = {at: v.astype(np.float32) * np.float32(lattice.unit_n) for at, v in previous.vectors.items()}
        put_apart(made, apart or b"", shape)
        yield in_bricks(made)


def read_lattice(c: Cursor) -> Lattice:
    unit_n = c.number("f")
    need(2.0**-126 <= unit_n <= 2.0**104, f"a unit of {unit_n} N")
    floor, rate = c.varint(1 << 16, 1), c.varint(1 << 17)
    cross_floor, cross_rate = c.varint(1 << 16, 1), c.varint(1 << 17)
    need(floor >= 21 or rate >= 64, f"a floor of {floor} with a rate of {rate}")
    return Lattice(unit_n, floor, rate, cross_floor, cross_rate, borders(floor, rate))


def decode_frame(payload: bytes, shape: Place, lattice: Lattice, reference: Units, memory: Memory) -> Units:
    """A frame, by what both sides know before it; `memory` takes what it teaches."""
    c = Cursor(payload)
    course = c.number("B")
    need(course < 32 and course & 3 < 3, f"a course of {course}")
    axes = [course & 3, *(n for n in range(3) if n != course & 3)]
    down = [n for n in range(3) if course >> 2 + n & 1]
    signs = np.array([-1 if n in down else 1 for n in range(3)], object)
    slope = [c.varint(1 << 17) for _ in range(3)]
    frame, ends = Frame(c.rest(), memory, lattice, slope), [-(-n // 8) * 8 - 1 for n in shape]

    def turned(at: Place) -> Place:
        """The place of a sample in the scan."""
        return tuple(ends[a] - at[a] if n in down else at[a] for n, a in enumerate(axes))

    def scanned(brick: Place) -> Place:
        """The place of a brick in the scan."""
        return brick_of(turned((8 * brick[0], 8 * brick[1], 8 * brick[2])))

    frame.known = set(map(scanned, reference.bricks))
    frame.old = {turned(at): vector[axes] * signs for at, vector in reference.vectors.items()}
    out = Units(bricks(frame.bits, shape, reference.bricks), {})
    for brick in sorted(out.bricks, key=scanned):
        samples = sorted((turned(at), at) for at in samples_of(brick, shape))
        frame.brick(scanned(brick), [place for place, _ in samples])
        for place, at in samples:
            if place in frame.cells and frame.cells[place].vector.any():
                out.vectors[at] = np.empty(3, object)
                out.vectors[at][axes] = frame.cells[place].vector * signs
    frame.bits.end(len(out.bricks))
    return out


def put_apart(forces: Forces, data: bytes, shape: Place) -> None:
    """Replace single forces by those that were sent as they are."""
    c, key, place = Cursor(data), 0, -1
    count = [-(-n // 8) for n in shape]
    while c.at < len(data):
        gap, coded = c.varint(math.prod(count) - key), c.varint(1024)
        need(gap or coded >> 1 > place, "samples that do not ascend")
        key, place = key + gap, coded >> 1
        force = np.zeros(3, np.float32) if coded & 1 else np.frombuffer(c.take(12), "<f4")
        brick, step = np.unravel_index(key, count), (place >> 6, place >> 3 & 7, place & 7)
        at = tuple(8 * int(b) + n for b, n in zip(brick, step))
        need(np.isfinite(force).all(), "a force that is not finite")
        need(all(n < m for n, m in zip(at, shape)), "a sample beyond the grid")
        forces[at] = force
