"""Decodes coder `touch` for the conformance decoder, step by step as docs/format/touch.md says, in plain
Python and numpy. `decoder.py` calls it.

`decode_touch_base_layer` decodes base layers and `decode_touch_exact` the frames of the exact mode.
"""

import math
import struct
import sys
from collections.abc import Iterator
from typing import Any

import decode_touch_base_layer as base_layers
import decode_touch_exact as exact_mode
import numpy as np
from reading import Bricks, Cursor, Forces, Place, UnsupportedVersion, brick_of, in_bricks, need, samples_of
from touch_bits import Models, bricks
from touch_frame import Frame, FrameModels, Units
from touch_residual import StepTable, borders

MASK = (0.001, 1 - 2**-53), (0, sys.float_info.max)  # bounds of k, F_0
BOUNDS = (
    MASK,
    (*MASK, (5e-324, 90 - 2**-46)),
    ((5e-324, sys.float_info.max),),
    (),
)  # of the numbers of each mode
MASKING = (5e-324, 1), (1e-6, 1)  # bounds of its weight and radius


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
    steps = None if exact else read_steps(c)
    if flags:  # the largest error
        c.number("H")
        for limit in (frame_count, *shape):
            c.varint(limit)
    frames = []
    for i in range(frame_count):
        frame_flags, support, amplitude = c.numbers("3B")
        need(frame_flags <= (1 if exact else 7) and support + amplitude <= 255, "the first bytes of a frame")
        need(i or not frame_flags & 1, "a first frame that needs the one before")
        chunks = [
            c.chunk(least) if is_there else None
            for is_there, least in ((frame_flags & 2, 1), (True, 0), (frame_flags & 4, 1))
        ]
        frames.append((frame_flags & 1, *chunks))
    c.end()
    exact_frame: Any = None
    models, reference = FrameModels(Models(), {}), Units([], {})
    for inter, base_layer, payload, outliers in frames:
        if steps is None:
            exact_frame = exact_mode.decode_exact(payload, shape, exact_frame if inter else None)
            yield in_bricks(exact_frame.forces)
            continue
        if not inter:
            models, reference = FrameModels(Models(), {}), Units([], {})
        if base_layer:
            need(base_layer[0] <= 1, f"a base layer of kind {base_layer[0]}")
            decode = (base_layers.spline, base_layers.columns)[base_layer[0]]
            reference = decode(base_layer[1:], shape)
        reference = decode_frame(payload, shape, steps, reference, models)
        unit_n = np.float32(steps.unit_n)
        forces_n = {at: vector.astype(np.float32) * unit_n for at, vector in reference.vectors.items()}
        put_outliers(forces_n, outliers or b"", shape)
        yield in_bricks(forces_n)


def read_steps(c: Cursor) -> StepTable:
    unit_n = c.number("f")
    need(2.0**-126 <= unit_n <= 2.0**104, f"a unit of {unit_n} N")
    floor, rate = c.varint(1 << 16, 1), c.varint(1 << 17)
    cross_floor, cross_rate = c.varint(1 << 16, 1), c.varint(1 << 17)
    need(floor >= 21 or rate >= 64, f"a floor of {floor} with a rate of {rate}")
    return StepTable(unit_n, floor, rate, cross_floor, cross_rate, borders(floor, rate))


def decode_frame(
    payload: bytes, shape: Place, steps: StepTable, reference: Units, models: FrameModels
) -> Units:
    """A frame, given its reference; `models` learn from it."""
    c = Cursor(payload)
    scan_order = c.number("B")
    need(scan_order < 32 and scan_order & 3 < 3, f"a scan order of {scan_order}")
    axes = [scan_order & 3, *(n for n in range(3) if n != scan_order & 3)]
    reversed_axes = [n for n in range(3) if scan_order >> 2 + n & 1]
    signs = np.array([-1 if n in reversed_axes else 1 for n in range(3)], object)
    slope = [c.varint(1 << 17) for _ in range(3)]
    frame, last = Frame(c.rest(), models, steps, slope), [-(-n // 8) * 8 - 1 for n in shape]

    def in_scan(at: Place) -> Place:
        """The place of a sample in the scan."""
        return tuple(last[a] - at[a] if n in reversed_axes else at[a] for n, a in enumerate(axes))

    def brick_in_scan(brick: Place) -> Place:
        """The place of a brick in the scan."""
        return brick_of(in_scan((8 * brick[0], 8 * brick[1], 8 * brick[2])))

    frame.listed = set(map(brick_in_scan, reference.bricks))
    frame.reference = {in_scan(at): vector[axes] * signs for at, vector in reference.vectors.items()}
    out = Units(bricks(frame.bits, shape, reference.bricks), {})
    for brick in sorted(out.bricks, key=brick_in_scan):
        samples = sorted((in_scan(at), at) for at in samples_of(brick, shape))
        frame.brick(brick_in_scan(brick), [place for place, _ in samples])
        for place, at in samples:
            if place in frame.decoded and frame.decoded[place].vector.any():
                out.vectors[at] = np.empty(3, object)
                out.vectors[at][axes] = frame.decoded[place].vector * signs
    frame.bits.end(len(out.bricks))
    return out


def put_outliers(forces: Forces, data: bytes, shape: Place) -> None:
    """Replace the forces of outliers."""
    c, number, sample = Cursor(data), 0, -1
    count = [-(-n // 8) for n in shape]
    while c.at < len(data):
        gap, coded = c.varint(math.prod(count) - number), c.varint(1024)
        need(gap or coded >> 1 > sample, "samples that do not ascend")
        number, sample = number + gap, coded >> 1
        force = np.zeros(3, np.float32) if coded & 1 else np.frombuffer(c.take(12), "<f4")
        brick, step = np.unravel_index(number, count), (sample >> 6, sample >> 3 & 7, sample & 7)
        at = tuple(8 * int(b) + n for b, n in zip(brick, step))
        need(np.isfinite(force).all(), "a force that is not finite")
        need(all(n < m for n, m in zip(at, shape)), "a sample beyond the grid")
        forces[at] = force
