"""Encode segments of every kind with a library, and decode damaged codes: encode_all.py LIBRARY."""

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
from touchfield.medium import Grid


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


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """A code cut, extended, with bits flipped, or another one."""
    changed, kind = bytearray(data), rng.integers(4)
    if kind == 0:
        return data[: rng.integers(len(data) + 1)]
    if kind == 1:
        return data + rng.bytes(int(rng.integers(1, 9))) * int(rng.integers(2))
    if kind == 2:
        return bytes(rng.bytes(int(rng.integers(0, 40))))
    for _ in range(int(rng.integers(1, 4)) if data else 0):
        changed[rng.integers(len(data))] ^= 1 << rng.integers(8)
    return bytes(changed)


WIDE = Grid((1 << 20,) * 3, (0.001,) * 3, (0.0,) * 3)


def decode_parts(native: NativeEncoder, rounds: int = 60) -> None:
    """Codes of each kind, as they are and damaged; also empty ones, and in too little memory."""
    rng = np.random.default_rng(1)
    codes: set[int] = set()
    for seed in range(6):
        grid, supports = random_support(seed)
        vibration, (track, steps) = random_vibration(seed), random_poses(seed)
        numbers, poses = rng.integers(-99, 99, 50 * seed), round_poses(track, steps)
        body, one = native.vibration(vibration), round(1 / steps.quaternion)
        before = supports[-1] if seed % 2 else None
        support, own = native.support(grid, supports[0], before), vibration[0].grid
        assert native.decode_support(grid, support, before) == (0, len(supports[0][0]))
        code, samples = native.decode_vibration(own, body, len(vibration))
        assert code == 0 and samples <= sum(map(len, vibration))
        coded_numbers, coded_poses = native.numbers(numbers), native.poses(poses)
        assert (native.decode_numbers(coded_numbers, len(numbers))[1] == numbers).all()
        assert (native.decode_poses(coded_poses, len(poses), one)[1] == poses).all()
        for n in range(rounds):
            room = None if n % 3 else int(rng.integers(1 << 20))
            count = len(vibration) if n % 4 else int(rng.choice([0, 1, 5, 65535]))
            codes |= {
                native.decode_support(WIDE if n % 5 == 0 else grid, damaged(support, rng), None, room)[0],
                native.decode_support(grid, damaged(support, rng), before, room)[0],
                native.decode_vibration(WIDE if n % 5 == 0 else own, damaged(body, rng), count, room)[0],
                native.decode_numbers(damaged(coded_numbers, rng), int(rng.integers(300)))[0],
                native.decode_poses(damaged(coded_poses, rng), int(rng.integers(300)), one)[0],
            }
    assert codes == {0, 2, 3, 5, 6}, codes  # 6: no poses


def main(library: str) -> None:
    """Encode and decode whatever there is."""
    native = NativeEncoder(Path(library))
    encode_segments(native)
    encode_parts(native)
    decode_parts(native)


if __name__ == "__main__":
    main(sys.argv[1])
