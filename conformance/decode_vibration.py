"""The part of the second decoder for VIBR: which samples vibrate, how strongly and how fast.

It follows docs/format/vibration.md; the support and the whole numbers are those of docs/format/bits.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from reading import TruncatedFile, need
from support import Position, Support, numbers, samples_of, support
from touch_bits import Bits, allowed, ended

__all__ = ["decode_segment"]


def values(told: Sequence[int], frames: list[list[Position]], least: int, most: int) -> Iterator[dict[Position, int]]:
    """One kind of value for each sample of each frame."""
    coming = iter(told)
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
    bits, frames, held, count = Bits(body), [], Support(), 0
    for _ in range(frame_count):
        held = support(bits, shape, held)
        count += 16 + len(held)
        need(count <= allowed(len(body)), "more frames or bricks than the bytes may tell", TruncatedFile)
        frames.append(samples_of(held))
    told = [numbers(bits, sum(map(len, frames)), name) for name in ("amplitudes", "frequencies")]
    ended(bits, count)
    steps, hertz = list(values(told[0], frames, 0, 159)), list(values(told[1], frames, 1, 10000))
    for own, frequencies in zip(steps, hertz, strict=True):
        made = np.zeros((2, *shape), np.float32)
        for sample, step in own.items():
            made[(slice(None), *sample)] = (4 + step % 4) * 2.0 ** (step // 4 - 22), frequencies[sample]
        yield made
