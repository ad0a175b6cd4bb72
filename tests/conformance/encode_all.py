"""Encode segments of every kind with a library: encode_all.py LIBRARY."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import numpy as np
from encode_content import (
    MODES,
    lossless_segment,
    random_poses,
    random_samples,
    random_segment,
    random_support,
    random_vibration,
)
from native_encoder import NativeEncoder

from touchfield.codec.objects.encoder import round_poses
from touchfield.codec.objects.layout import ObjectPart, SegmentParts


def encode_segments(native: NativeEncoder) -> None:
    """Segments of each mode, also with too little memory, which is an error and nothing else."""
    rng = np.random.default_rng(0)
    segments = [random_segment(mode, seed) for mode in MODES for seed in range(4)]
    segments += [lossless_segment(seed) for seed in range(4)]
    for segment in segments:
        arguments = segment.grid, segment.spec, segment.frames
        body = native.segment(*arguments, has_splines=True)
        room = native.room(segment.grid, segment.spec, max(len(frame.bricks) for frame in segment.frames))
        for fraction in rng.random(2):
            with contextlib.suppress(ValueError):
                native.segment(*arguments, has_splines=True, work_bytes=int(room * fraction))
        with contextlib.suppress(ValueError):
            native.segment(*arguments, out_bytes=int(rng.integers(0, len(body) + 100)))
        if segment.spec.mode != "lossless":
            samples = [random_samples(frame, rng) for frame in segment.frames]
            native.with_exact_samples(segment.grid, segment.spec, body, segment.frames, samples)
        native.segment(*arguments, key_frame=segment.frames[0].scaled(1.0005))
        native.is_static(segment.spec, segment.frames[-1], segment.frames[0])


def encode_parts(native: NativeEncoder) -> None:
    """Supports, vibrations, poses, bodies and whole numbers."""
    for seed in range(6):
        grid, supports = random_support(seed)
        for i, support in enumerate(supports):
            native.support(grid, support, supports[i - 1] if i else None)
        native.vibration(random_vibration(seed))
        native.poses(round_poses(*random_poses(seed)))
        native.numbers(np.random.default_rng(seed).integers(-(1 << 29), 1 << 29, 50 * seed))
        parts = [ObjectPart(b"poses", b"fields" * seed), ObjectPart(b"more poses", None)]
        native.bodies(SegmentParts(None, parts))


def main(library: str) -> None:
    """Encode whatever there is."""
    native = NativeEncoder(Path(library))
    encode_segments(native)
    encode_parts(native)


if __name__ == "__main__":
    main(sys.argv[1])
