"""A coded segment, and what each of its frames cost: what every coder of fields hands back."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from touchfield.measure.rate import BitAccount

__all__ = ["CodedSegment", "FrameCost", "FrameKind", "FrameStats"]


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
    """What a frame cost."""

    kind: FrameKind
    bits: BitAccount


@dataclass(frozen=True)
class FrameStats:
    """What a frame cost, and how many samples it holds and sends."""

    kind: FrameKind
    supported: int
    sent: int
    bits: BitAccount


@dataclass(frozen=True)
class CodedSegment:
    """The bytes of a segment, and what each of its frames cost."""

    body: bytes
    frames: tuple[FrameStats, ...]
