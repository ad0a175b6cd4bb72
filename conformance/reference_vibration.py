"""The part of the reference decoder for VIBR: which samples vibrate, how strongly and how fast.

It follows the chapter on vibration of docs/format.md, as `reference_decoder` follows the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from reference_decoder import Coder, Cursor, Models, Position, Support, decode_support, need, samples_of

__all__ = ["decode_vibration", "laid_out"]

Values = dict[Position, int]


def whole_numbers(data: bytes, count: int) -> list[int]:
    """So many whole numbers, which `data` tells to its end."""
    coder = Coder(data)
    models = Models(coder)
    numbers: list[int] = []
    a = b = 0
    for _ in range(count):
        node = 1
        for _ in range(5):
            node = 2 * node + models.mixed(32 * a + node, 32 * (32 * a + b) + node, node)
        digits = node - 32
        v = int(digits > 0)
        for i in range(digits - 1):
            if i < 3:
                h = v % 8
                bit = models.mixed(2048 + 8 * digits + h, 65536 + 8 * digits + h, 32 + h)
            else:
                bit = coder.bit(32768)
            v = 2 * v + bit
        a, b = digits, a
        numbers.append(-(v + 1) // 2 if v % 2 else v // 2)
    need(data == data[: coder.used] + coder.ending(), "the end of the whole numbers")
    return numbers


def values(numbers: Sequence[int], frames: list[list[Position]], bounds: tuple[int, int]) -> list[Values]:
    """One kind of value for each sample of each frame."""
    coming = iter(numbers)
    found: list[Values] = []
    for samples in frames:
        own: Values = {}
        last = 0
        for sample in samples:
            last = next(coming) + (found[-1][sample] if found and sample in found[-1] else last)
            need(bounds[0] <= last <= bounds[1], f"the value {last} of a vibration")
            own[sample] = last
        found.append(own)
    return found


def decode_vibration(body: bytes, frame_count: int, shape: Position) -> list[tuple[Values, Values]]:
    """Amplitudes in steps and frequencies in hertz, by their samples, for each frame of a segment."""
    c = Cursor(body)
    frames: list[list[Position]] = []
    before: Support = {}
    for _ in range(frame_count):
        before = decode_support(c.chunk(), shape, before)
        frames.append(sorted(s for brick, mask in before.items() for s in samples_of(brick, mask)))
    total = sum(map(len, frames))
    steps = values(whole_numbers(c.chunk(), total), frames, (0, 159))
    hertz = values(whole_numbers(c.chunk(), total), frames, (1, 10000))
    c.end()
    return list(zip(steps, hertz, strict=True))


def laid_out(head: dict[str, Any], counts: Sequence[int]) -> dict[str, NDArray[np.float32]]:
    """Amplitudes in newtons and frequencies in hertz as dense arrays, float32 [frame, nx, ny, nz]."""
    amplitudes_n = np.zeros((head["frame_count"], *head["shape"]), np.float32)
    frequencies_hz = np.zeros_like(amplitudes_n)
    first = 0
    for body, count in zip(head["vibrations"], counts, strict=True):
        frames = [] if body is None else decode_vibration(body, count, head["shape"])
        for i, (steps, hertz) in enumerate(frames):
            for sample, step in steps.items():
                amplitudes_n[first + i][sample] = (4 + step % 4) * 2.0 ** (step // 4 - 22)
                frequencies_hz[first + i][sample] = hertz[sample]
        first += count
    return {"amplitudes_n": amplitudes_n, "frequencies_hz": frequencies_hz}
