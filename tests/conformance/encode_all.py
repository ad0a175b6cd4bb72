"""Encode segments of every kind with a library: encode_all.py LIBRARY."""

from __future__ import annotations

import sys
from pathlib import Path

from encode_content import (
    MODES,
    lossless_segment,
    random_poses,
    random_segment,
    random_support,
    random_vibration,
)
from native_encoder import NativeEncoder

from touchfield.codec.objects.encoder import round_poses


def main(library: str) -> None:
    """Encode some segments of each mode."""
    native = NativeEncoder(Path(library))
    for mode in MODES:
        for seed in range(6):
            segment = random_segment(mode, seed)
            native.segment(segment.grid, segment.spec, segment.frames, has_splines=True)
    for seed in range(6):
        segment = lossless_segment(seed)
        native.segment(segment.grid, segment.spec, segment.frames)
    for seed in range(4):
        grid, supports = random_support(seed)
        for i, support in enumerate(supports):
            native.support(grid, support, supports[i - 1] if i else None)
        native.vibration(random_vibration(seed))
        native.poses(round_poses(*random_poses(seed)))


if __name__ == "__main__":
    main(sys.argv[1])
