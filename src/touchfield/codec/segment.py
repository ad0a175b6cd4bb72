"""What all coders share about segments, which are runs of frames that are coded together: their length, the
count of coded bits by purpose, the compression ratio, and the report of the largest error and its bound.

Eq. 9 of the paper is CR = (C_a + C_d) / (m V 96), where C_a and C_d are the lengths in bits of the coded
amplitudes and directions (the paper calls these vectors), m the number of frames, V the number of voxels of
the device lattice, and 96 the bits of a raw vector. It omits the support, the code tables and the headers;
"CR full" counts every bit of the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, Final, NamedTuple

SEGMENT_S: Final = 0.5
"""Default length of a segment: a receiver that joins or seeks decodes up to so much before its first
frame."""

MIN_SEGMENT_FRAMES: Final = 8
"""Minimum for slow media: spreads the extra cost of a first frame over this many frames."""

MAX_SEGMENT_FRAMES: Final = 64
"""Maximum for fast media: decoding a frame requires all frames before it in its segment."""

REPEATING_SEGMENT_S: Final = 1.0
"""Length of a segment in which frames repeat: a repeated frame costs a few bytes and no time."""


def segment_length(requested: int | None, rate_hz: float, seconds: float = SEGMENT_S) -> int:
    """Number of frames in a segment at a frame rate.

    `requested` if given, else as many frames as `seconds` hold, at least 8 and at most 64.
    """
    return requested or min(
        max(math.ceil(seconds * min(rate_hz, 1e6)), MIN_SEGMENT_FRAMES), MAX_SEGMENT_FRAMES
    )


def longest_segment(requested: int | None, rate_hz: float) -> int:
    """Number of frames in a segment in which frames repeat.

    As `segment_length`, with one second in place of half a second.
    """
    return segment_length(requested, rate_hz, REPEATING_SEGMENT_S)


RAW_BITS_PER_VECTOR: Final = 96  # three float32 components (paper table 1, "raw storage per sample")


@dataclass(frozen=True)
class BitAccount:
    """Bits by purpose."""

    support: int = 0  # where the force is not zero
    amplitude: int = 0  # C_a: amplitudes, and the flags of samples held by the deadband
    direction: int = 0  # C_d: directions
    side: int = 0  # code tables, lengths, headers, checksums, index, provenance
    poses: int = 0  # poses of objects (`touchfield.codec.objects`)
    models: int = 0  # base layers that predict a frame (`touchfield.codec.touch`)

    @property
    def total(self) -> int:
        """Sum of all bits."""
        return sum(getattr(self, f.name) for f in fields(self))

    def __add__(self, other: BitAccount) -> BitAccount:
        return BitAccount(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


def compression_ratio(bits: float, frame_count: int, voxel_count: int) -> float:
    """Coded bits over the raw bits of the device-filtered lattice; lower is better.

    The raw bits are the denominator of eq. 9.
    """
    return bits / (frame_count * voxel_count * RAW_BITS_PER_VECTOR)


class FrameKind(IntEnum):
    """How a frame is coded."""

    INTRA = 0
    """On its own."""
    INTER = 1
    """Predicted from the decoded frame before."""
    DIFFERENCE = 2
    """As the difference of two original frames (the paper's open loop)."""


@dataclass(frozen=True)
class FrameCost:
    """Cost of a frame."""

    kind: FrameKind
    bits: BitAccount


@dataclass(frozen=True)
class FrameStats(FrameCost):
    """Cost of a frame, with its numbers of supported samples and of samples sent."""

    supported: int
    sent: int


MAX_ERROR_KEYS: Final = ("promise_kept", "worst_mask_ratio", "worst_frame", "worst_voxel")


@dataclass(frozen=True)
class CodedSegment:
    """Bytes of a segment, statistics of its frames, and its largest error.

    `max_error` is None if the error is not known.
    """

    body: bytes
    frames: tuple[FrameStats, ...]
    max_error: MaxError | None = None


RATIO_STEPS: Final = 65535
"""A file stores the largest error ratio of a segment in steps of 1/65535, rounded up."""


class MaxError(NamedTuple):
    """Largest error of a segment over the error bound, with its frame and voxel.

    `ratio` is 0 to 1.
    """

    ratio: float
    frame: int
    voxel: tuple[int, int, int]

    @property
    def rounded_up(self) -> int:
        """The ratio in steps of 1 / `RATIO_STEPS`, rounded up.

        AssertionError for NaN or a ratio above 1: clipping it would store a bound that does not hold.
        """
        if not 0.0 <= self.ratio <= 1.0:
            raise AssertionError(f"a segment whose largest error is {self.ratio!r} of what is allowed")
        return math.ceil(self.ratio * RATIO_STEPS)


def max_error_keys(segments: Iterable[tuple[int, MaxError | None]]) -> dict[str, Any]:
    """Summary keys of the largest error of a file.

    `segments`: the first frame and the `MaxError` of each segment. All values are None if any segment states
    no largest error.
    """
    per_segment = [
        max_error and max_error._replace(frame=first + max_error.frame) for first, max_error in segments
    ]
    stated = [max_error for max_error in per_segment if max_error is not None]
    if not stated or len(stated) < len(per_segment):
        return dict.fromkeys(MAX_ERROR_KEYS)
    ratio, frame, voxel = max(stated, key=lambda max_error: max_error.ratio)
    return {
        "promise_kept": ratio <= 1,
        "worst_mask_ratio": ratio,
        "worst_frame": frame,
        "worst_voxel": list(voxel),
    }


class BoundRule(NamedTuple):
    """Error bound of a coder under its options; `text` is None if there is none.

    `reason` then explains why, and which options give a bound.
    """

    text: str | None
    reason: str = ""


def mask_text(k: float, f0_n: float, masking: str = "", by_force: str = "") -> str:
    """Text of the mask max(F_0, k |F|).

    `masking` is a further term, added to k |F|. `by_force` describes k(|F|), which then replaces `k`.
    """
    largest = f"{'k(|F|)' if by_force else f'{k:g}'} |F|{masking}"
    allowed = f"max({f0_n:g} N, {largest})" if f0_n else largest
    where = f"; {by_force}" if by_force else ""
    return f"|error| <= {allowed} at every voxel of every frame{where}"


BOUND_KEYS: Final = ("error_bound", "error_bound_note", *MAX_ERROR_KEYS)
"""Keys under which commands report the error bound."""


def bound_keys(rule: BoundRule, max_error: Mapping[str, Any]) -> dict[str, Any]:
    """Keys that report the proven error bound.

    `rule` is the rule of the coder, `max_error` the result of `max_error_keys`. ``error_bound`` is the text
    of the rule if the bound is proven, else None; ``error_bound_note`` then gives the reason, which commands
    print as a warning.
    """
    if rule.text is not None and max_error.get("promise_kept"):
        return {"error_bound": rule.text}
    reason = (
        rule.reason
        or "a segment states no largest error: it was not written by touchfield, or it was changed"
    )
    return {"error_bound": None, "error_bound_note": f"no error bound is proved: {reason}"}
