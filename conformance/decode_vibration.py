"""The part of the second decoder for VIBR: which samples vibrate, how strongly and how fast.

It follows docs/format/vibration.md; the support and the arithmetic decoder are those of docs/format/paper.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from reading import Cursor, need
from support import Position, Support, decode_support, samples_of, whole_numbers

__all__ = ["decode_segment"]


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
