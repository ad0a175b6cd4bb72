"""Frames of an independent segment where nobody asks for a number."""

from __future__ import annotations

import math
from typing import Final

__all__ = ["segment_length"]

SEGMENT_S: Final = 0.25
"""Seconds of the medium that a receiver which joins in the middle, or seeks, decodes before its first frame."""

LEAST_FRAMES: Final = 8
"""Of slow media: what a first frame takes more than one that follows is spread over so many."""

MOST_FRAMES: Final = 64
"""Of fast ones: a frame in the middle of a segment costs the decoding of all before it."""


def segment_length(asked: int | None, rate_hz: float) -> int:
    """Frames in a segment of a medium of that rate: `asked`, or a quarter of a second, 8 at least and 64 at most."""
    if asked is not None:
        return asked
    return min(max(math.ceil(SEGMENT_S * min(rate_hz, 1e6)), LEAST_FRAMES), MOST_FRAMES)
