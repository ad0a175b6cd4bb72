"""Decodes vibration records (VIBR) for the conformance decoder, as docs/format/vibration.md says: which
samples vibrate, how strongly and how fast.
"""

from collections.abc import Iterator

import numpy as np
from reading import Array, Place, TruncatedFile, need
from support import NOTHING, numbers, support
from touch_bits import Bits


def decode_segment(body: bytes, shape: Place, frame_count: int) -> Iterator[Array]:
    """Amplitudes in newtons and frequencies in hertz, float32 [2, nx, ny, nz] for each frame."""
    bits, frames, vibrating, count = Bits(body), [], NOTHING, 0
    for _ in range(frame_count):
        vibrating = support(bits, shape, vibrating)
        count += 16 + len(vibrating.bricks)
        need(count <= bits.max_bricks, "more frames or bricks than the bytes may list", TruncatedFile)
        frames.append(vibrating.samples)
    differences = [iter(numbers(bits, sum(map(len, frames)), name)) for name in ("amplitudes", "frequencies")]
    bits.end(count)
    previous: list[dict[Place, int]] = [{}, {}]
    made = [np.zeros((2, *shape), np.float32) for _ in frames]
    for samples, out in zip(frames, made):
        last = [0, 0]
        for n, (low, high) in enumerate(((0, 159), (1, 10000))):
            own: dict[Place, int] = {}
            for at in samples:
                last[n] = own[at] = next(differences[n]) + previous[n].get(at, last[n])
                need(low <= last[n] <= high, f"the value {last[n]} of a vibration")
                out[(n, *at)] = last[n] if n else (4 + last[n] % 4) * 2.0 ** (last[n] // 4 - 22)
            previous[n] = own
    yield from made
