"""Encode segments of every kind with a library: encode_all.py LIBRARY."""

from __future__ import annotations

import sys
from pathlib import Path

from encode_content import MODES, lossless_segment, random_segment
from native_encoder import NativeEncoder


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


if __name__ == "__main__":
    main(sys.argv[1])
