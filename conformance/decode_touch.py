"""The part of the second decoder for coder `touch`: docs/format/touch.md, step by step, in plain Python and numpy.

`decode_touch_guess` makes guesses and `decode_touch_exact` the frames of the exact mode.
"""

import math
import struct
import sys
from collections.abc import Iterator
from typing import Any

import decode_touch_exact as exact_mode
import decode_touch_guess as guesses
import numpy as np
from reading import Array, Cursor, Place, UnsupportedVersion, moved, need
from touch_bits import Models, bricks
from touch_frame import Frame, Memory
from touch_residual import Lattice, borders

Units = dict[Place, Array]
"""Bricks of the grid, int64 [8, 8, 8, 3]; also bricks that hold no force."""

MASK = (0.001, 1 - 2**-53), (0, sys.float_info.max)  # bounds of k, F_0
BOUNDS = MASK, (*MASK, (5e-324, 90 - 2**-46)), ((5e-324, sys.float_info.max),), ()  # of the numbers of each mode


def is_exact(parameters: bytes) -> bool:
    """Whether the mode is "lossless"; all parameters are checked."""
    need(len(parameters) >= 2, f"{len(parameters)} bytes of parameters")
    need(parameters[0] == 1, f"version {parameters[0]} of the parameters", UnsupportedVersion)
    need(parameters[1] >> 3 <= 2, "an effort that there is not")
    bounds = BOUNDS[parameters[1] & 3]
    need(len(parameters) == 2 + 8 * len(bounds), f"{len(parameters)} bytes of parameters")
    for (low, high), value in zip(bounds, struct.unpack(f"<{len(bounds)}d", parameters[2:])):
        need(low <= value <= high, f"a parameter of {value}")
    return parameters[1] & 3 == 3


def decode_segment(body: bytes, parameters: bytes, shape: Place, frame_count: int) -> Iterator[dict[Place, Array]]:
    """The frames of a segment, one after another: bricks of forces, newtons, float32 [8, 8, 8, 3]."""
    exact, c = is_exact(parameters), Cursor(body)
    flags = c.number("B")
    need(flags <= 1, f"flags of {flags}")
    lattice = None if exact else read_lattice(c)
    if flags:  # the worst voxel
        c.number("H")
        worst = [c.varint(n) for n in (1 << 16, *shape)]
        need(worst[0] < frame_count, "a worst frame behind the last")
    known: Any = None
    previous: Units | None = None
    memory = Memory(Models({}, {}), {})
    for i in range(frame_count):
        how, support, amplitude = c.numbers("3B")
        need(how <= (1 if exact else 7) and support + amplitude <= 255, "the first bytes of a frame")
        inter = how & 1
        need(i or not inter, "a first frame that needs the one before")
        guess = c.chunk() if how & 2 else None
        payload = c.chunk()
        apart = c.chunk() if how & 4 else None
        need(guess != b"" and apart != b"", "an empty chunk")
        if lattice is None:
            known = exact_mode.decode_exact(payload, shape, known if inter else None)
            yield known.forces
            continue
        if not inter:
            memory, previous = Memory(Models({}, {}), {}), None
        if guess:
            need(guess[0] <= 1, f"a guess of kind {guess[0]}")
            previous = (guesses.spline, guesses.columns)[guess[0]](guess[1:], shape)
        previous = decode_frame(payload, shape, lattice, previous, memory)
        made = {brick: v.astype(np.float32) * np.float32(lattice.unit_n) for brick, v in previous.items()}
        put_apart(made, apart or b"", shape)
        yield made
    c.end()


def read_lattice(c: Cursor) -> Lattice:
    unit_n = c.number("f")
    need(2.0**-126 <= unit_n <= 2.0**104, f"a unit of {unit_n} N")
    floor, rate = c.varint(1 << 16, 1), c.varint(1 << 17)
    cross_floor, cross_rate = c.varint(1 << 16, 1), c.varint(1 << 17)
    need(floor >= 21 or rate >= 64, f"a floor of {floor} with a rate of {rate}")
    return Lattice(unit_n, floor, rate, cross_floor, cross_rate, borders(floor, rate))


def decode_frame(payload: bytes, shape: Place, lattice: Lattice, reference: Units | None, memory: Memory) -> Units:
    """A frame, by what both sides know before it; `memory` takes what it teaches."""
    c = Cursor(payload)
    course = c.number("B")
    need(course < 32 and course & 3 < 3, f"a course of {course}")
    axes = [course & 3, *(n for n in range(3) if n != course & 3)]
    down = [n for n in range(3) if course >> 2 + n & 1]
    signs = np.array([-1 if n in down else 1 for n in range(3)], object)
    slope = [c.varint(1 << 17) for _ in range(3)]
    frame, count = Frame(c.rest(), memory, lattice, slope), [-(-n // 8) for n in shape]

    def turned(brick: Place) -> Place:
        """The place of a brick in the scan."""
        return tuple(count[a] - 1 - brick[a] if n in down else brick[a] for n, a in enumerate(axes))

    def seen(samples: Array) -> Array:
        """A view of a brick's samples in the scan."""
        return np.flip(np.moveaxis(samples, axes, (0, 1, 2)), tuple(down))

    listed = bricks(frame.bits, shape, reference or ())
    for brick, vectors in (reference or {}).items():
        frame.known.add(place := turned(brick))
        for i, j, k in np.argwhere(seen(vectors).any(axis=-1)).tolist():
            frame.old[moved([8 * n for n in place], (i, j, k))] = seen(vectors)[i, j, k, axes].astype(object) * signs
    out = {brick: np.zeros((8, 8, 8, 3), np.int64) for brick in listed}
    for place, brick in sorted((turned(brick), brick) for brick in listed):
        within = np.zeros((8, 8, 8), bool)
        within[tuple(slice(0, m - 8 * b) for m, b in zip(shape, brick))] = True
        samples = {moved([8 * n for n in place], step): step for step in np.argwhere(seen(within)).tolist()}
        frame.brick(place, list(samples))
        for at, (i, j, k) in samples.items():
            if at in frame.cells:
                seen(out[brick])[i, j, k, axes] = frame.cells[at].vector * signs
    frame.bits.end(len(listed))
    return out


def put_apart(forces: Units, data: bytes, shape: Place) -> None:
    """Replace single forces by those that were sent as they are."""
    c, key, place = Cursor(data), 0, -1
    count = [-(-n // 8) for n in shape]
    while c.at < len(data):
        gap, coded = c.varint(math.prod(count) - key), c.varint(1024)
        need(gap or coded >> 1 > place, "samples that do not ascend")
        key, place = key + gap, coded >> 1
        force = np.zeros(3, np.float32) if coded & 1 else np.frombuffer(c.take(12), "<f4")
        brick, step = tuple(int(n) for n in np.unravel_index(key, count)), (place >> 6, place >> 3 & 7, place & 7)
        need(np.isfinite(force).all(), "a force that is not finite")
        need(all(8 * b + n < m for b, n, m in zip(brick, step, shape)), "a sample beyond the grid")
        forces.setdefault(brick, np.zeros((8, 8, 8, 3), np.float32))[step] = force
