"""The part of the second decoder for VIBR: which samples vibrate, how strongly and how fast.

It follows docs/format/vibration.md; the support and the arithmetic decoder are those of docs/format/paper.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from reading import Cursor, need
from support import Coder, Models, Position, Support, check_end, decode_support, samples_of

__all__ = ["decode_segment"]


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
    check_end(data, data[: coder.used] + coder.ending())
    return numbers


def values(
    numbers: Sequence[int], frames: list[list[Position]], least: int, most: int
) -> Iterator[dict[Position, int]]:
    """One kind of value for each sample of each frame."""
    coming = iter(numbers)
    before: dict[Position, int] = {}
    for samples in frames:
        own: dict[Position, int] = {}
        last = 0
        for sample in samples:
            last = own[sample] = next(coming) + before.get(sample, last)
            need(least <= last <= most, f"the value {last} of a vibration")
        before = own
        yield own


def decode_segment(body: bytes, shape: Position, frame_count: int) -> Iterator[NDArray[np.float32]]:
    """Amplitudes in newtons and frequencies in hertz, float32 [2, nx, ny, nz] for each frame."""
    c = Cursor(body)
    frames: list[list[Position]] = []
    support: Support = {}
    for _ in range(frame_count):
        support = decode_support(c.chunk(), shape, support)
        frames.append(sorted(s for brick, mask in support.items() for s in samples_of(brick, mask)))
    total = sum(map(len, frames))
    steps = list(values(whole_numbers(c.chunk(), total), frames, 0, 159))
    hertz = list(values(whole_numbers(c.chunk(), total), frames, 1, 10000))
    c.end()
    for own, frequencies in zip(steps, hertz, strict=True):
        made = np.zeros((2, *shape), np.float32)
        for sample, step in own.items():
            made[(slice(None), *sample)] = (4 + step % 4) * 2.0 ** (step // 4 - 22), frequencies[sample]
        yield made
