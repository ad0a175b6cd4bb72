"""A segment: its length where nobody asks for one, its bytes, and what each of its frames cost.

Paper eq. 9, literal: CR = (C_a + C_d) / (m V 96) with C_a, C_d the lengths in bits of the coded amplitudes
and directions (the paper calls them vectors), m frames, V voxels of the device lattice, 96 bits a vector. It
omits the support, the code tables and the headers; CR full counts every bit of the file.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, Final, NamedTuple

SEGMENT_S: Final = 0.5
"""Seconds of the medium that a receiver which joins in the middle, or seeks, decodes before its first frame.

"""

LEAST_FRAMES: Final = 8
"""Of slow media: what a first frame takes more than one that follows is spread over so many."""

MOST_FRAMES: Final = 64
"""Of fast ones: a frame in the middle of a segment costs the decoding of all before it."""


STILL_S: Final = 1.0
"""Of a world that stands: a frame that is the one before again costs a few bytes and no time, and ends no
segment.
"""


def segment_length(asked: int | None, rate_hz: float, seconds: float = SEGMENT_S) -> int:
    """Frames in a segment of a medium of that rate: `asked`, or half a second, 8 at least and 64 at most."""
    return asked or min(max(math.ceil(seconds * min(rate_hz, 1e6)), LEAST_FRAMES), MOST_FRAMES)


def longest_segment(asked: int | None, rate_hz: float) -> int:
    """Frames in a segment in which frames repeat: as `segment_length`, for a second."""
    return segment_length(asked, rate_hz, STILL_S)


RAW_BITS_PER_VECTOR: Final = 96  # three float32 components (paper table 1, "raw storage per sample")


@dataclass(frozen=True)
class BitAccount:
    """Bits by what they tell."""

    support: int = 0  # where the force is not zero
    amplitude: int = 0  # C_a: amplitudes, with what says which samples are held
    direction: int = 0  # C_d
    side: int = 0  # code tables, lengths, headers, checksums, index, provenance
    poses: int = 0  # poses of objects (`touchfield.codec.objects`)
    models: int = 0  # what a frame is predicted from: a surface, moved blocks (`touchfield.codec.touch`)

    @property
    def total(self) -> int:
        """All bits."""
        return sum(getattr(self, f.name) for f in fields(self))

    def __add__(self, other: BitAccount) -> BitAccount:
        return BitAccount(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))


def compression_ratio(bits: float, frame_count: int, voxel_count: int) -> float:
    """Bits over the raw bits of the device-filtered lattice (eq. 9's denominator); lower is better."""
    return bits / (frame_count * voxel_count * RAW_BITS_PER_VECTOR)


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
class FrameStats(FrameCost):
    """Cost of a frame, and how many samples it holds and sends."""

    supported: int
    sent: int


PROMISE_KEYS: Final = ("promise_kept", "worst_mask_ratio", "worst_frame", "worst_voxel")


@dataclass(frozen=True)
class CodedSegment:
    """The bytes of a segment, what each of its frames cost, and its worst voxel; None where none is known."""

    body: bytes
    frames: tuple[FrameStats, ...]
    worst: Worst | None = None


RATIO_STEPS: Final = 65535
"""A file states the largest ratio of a segment in whole steps of 1/65535, rounded up."""


class Worst(NamedTuple):
    """The voxel of a segment whose error is the largest share of what is allowed, 0 to 1: share, frame and
    index.
    """

    ratio: float
    frame: int
    voxel: tuple[int, int, int]

    @property
    def rounded_up(self) -> int:
        """The ratio in steps of 1 / `RATIO_STEPS`; AssertionError if it proves no bound, as NaN or one
        above 1.

        It is the guarantee itself and no statistic: to saturate it would state a bound that is not kept.
        """
        if not 0.0 <= self.ratio <= 1.0:
            raise AssertionError(f"a segment whose largest error is {self.ratio!r} of what is allowed")
        return math.ceil(self.ratio * RATIO_STEPS)


def promise_kept(segments: Iterable[tuple[int, Worst | None]]) -> dict[str, Any]:
    """Keys of the promise of a file, of first frames and worst voxels of its segments.

    All are None where any segment states none: what is not known of one is not known of the file.
    """
    every = [worst and worst._replace(frame=first + worst.frame) for first, worst in segments]
    known = [worst for worst in every if worst is not None]
    if not known or len(known) < len(every):
        return dict.fromkeys(PROMISE_KEYS)
    ratio, frame, voxel = max(known, key=lambda worst: worst.ratio)
    return {
        "promise_kept": ratio <= 1,
        "worst_mask_ratio": ratio,
        "worst_frame": frame,
        "worst_voxel": list(voxel),
    }


class BoundRule(NamedTuple):
    """What a coder guarantees of each voxel under its options; `text` is None where it guarantees nothing.

    `reason` says then why, and which options do.
    """

    text: str | None
    reason: str = ""


def mask_text(k: float, f0_n: float, hidden: str = "") -> str:
    """The mask max(F_0, k |F|) in words; `hidden`: what else is allowed beside k |F|."""
    largest = f"{k:g} |F|{hidden}"
    allowed = f"max({f0_n:g} N, {largest})" if f0_n else largest
    return f"|error| <= {allowed} at every voxel of every frame"


BOUND_KEYS: Final = ("error_bound", "error_bound_note", *PROMISE_KEYS)
"""Keys with which a command reports a bound."""


def bound_keys(rule: BoundRule, promise: Mapping[str, Any]) -> dict[str, Any]:
    """Keys of the error bound that is proved, of a coder's rule and the keys of `promise_kept`.

    ``error_bound`` is the rule in words, or None; then ``error_bound_note`` says why, which commands print as
    a warning.
    """
    if rule.text is not None and promise.get("promise_kept"):
        return {"error_bound": rule.text}
    reason = (
        rule.reason
        or "a segment states no largest error: it was not written by touchfield, or it was changed"
    )
    return {"error_bound": None, "error_bound_note": f"no error bound is proved: {reason}"}
