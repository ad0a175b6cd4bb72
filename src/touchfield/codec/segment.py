"""A segment: its length where nobody asks for one, its bytes, and what each of its frames cost."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

from touchfield.codec.rate import BitAccount

SEGMENT_S: Final = 0.5
"""Seconds of the medium that a receiver which joins in the middle, or seeks, decodes before its first frame."""

LEAST_FRAMES: Final = 8
"""Of slow media: what a first frame takes more than one that follows is spread over so many."""

MOST_FRAMES: Final = 64
"""Of fast ones: a frame in the middle of a segment costs the decoding of all before it."""


STILL_S: Final = 1.0
"""Of a world that stands: a frame that is the one before again costs a few bytes and no time, and ends no segment."""


def segment_length(asked: int | None, rate_hz: float, seconds: float = SEGMENT_S) -> int:
    """Frames in a segment of a medium of that rate: `asked`, or half a second, 8 at least and 64 at most."""
    return asked or min(max(math.ceil(seconds * min(rate_hz, 1e6)), LEAST_FRAMES), MOST_FRAMES)


def longest_segment(asked: int | None, rate_hz: float) -> int:
    """Frames in a segment in which frames repeat: as `segment_length`, for a second."""
    return segment_length(asked, rate_hz, STILL_S)


class FrameKind(IntEnum):
    """How a frame is coded."""

    INTRA = 0
    """Alone."""
    INTER = 1
    """Against the decoded frame before."""
    DIFFERENCE = 2
    """As the difference of two originals (the paper's open loop)."""


@dataclass(frozen=True)
class FrameCost:
    """Cost of a frame."""

    kind: FrameKind
    bits: BitAccount


@dataclass(frozen=True)
class FrameStats:
    """Cost of a frame, and how many samples it holds and sends."""

    kind: FrameKind
    supported: int
    sent: int
    bits: BitAccount


@dataclass(frozen=True)
class CodedSegment:
    """The bytes of a segment, and what each of its frames cost."""

    body: bytes
    frames: tuple[FrameStats, ...]


class Worst(NamedTuple):
    """The voxel of a segment whose error is the largest share of what is allowed, 0 to 1: share, frame and index."""

    ratio: float
    frame: int
    voxel: tuple[int, int, int]
