"""Editing in time: pieces of media put together, and one faded into the next (paper section 4, "haptic editing").

A piece of a medium is `HapticMedium.between`. Frames stay lazy: nothing is made before it is asked for.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate

from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, HapticMedium

__all__ = ["concatenated", "cross_faded", "without"]

_SHARED = ("grid", "rate_hz", "axes", "friction", "damping_n_s_per_m", "tags")
"""What one medium has one of, and pieces of it cannot differ in."""


def concatenated(*media: HapticMedium) -> HapticMedium:
    """One medium after the other.

    Raises `InvalidArgument` if there is none, or they differ in grid, rate, axes, friction, damping or tags.
    """
    if not media:
        raise InvalidArgument("media to concatenate", "none", "at least one")
    _check_alike(media)
    ends = list(accumulate(len(m) for m in media))

    def make(i: int) -> ForceField:
        which = bisect_right(ends, i)
        return media[which][i - ends[which] + len(media[which])]

    counts = " + ".join(str(len(m)) for m in media)
    return _spliced(media, ends[-1], make, f"{counts} frames") if len(media) > 1 else media[0]


def without(medium: HapticMedium, start: int, stop: int) -> HapticMedium:
    """The medium with frames start to stop - 1 cut out.

    Raises `InvalidArgument` if there is no such range, or nothing would be left.
    """
    count, gap = len(medium), stop - start
    if not 0 <= start < stop <= count or gap == count:
        raise InvalidArgument("frames to cut", f"{start}:{stop}", f"a range within 0:{count}, and not all of it")
    words = f"frames {start}:{stop} cut"
    return _spliced((medium,), count - gap, lambda i: medium[i if i < start else i + gap], words)


def cross_faded(first: HapticMedium, second: HapticMedium, frames: int) -> HapticMedium:
    """The first medium into the second, the last `frames` of the one mixed with as many of the other.

    frames : int; of the transition, 0 or more. Frame i of it is (1 - w) F + w G with w = (i + 1) / (frames + 1): the
        frames before and after it are those of one medium, and go on in equal steps.
    Raises `InvalidArgument` if a medium is shorter than the transition, or they differ as for `concatenated`.
    """
    shortest = min(len(first), len(second))
    if isinstance(frames, bool) or not isinstance(frames, int) or not 0 <= frames <= shortest:
        raise InvalidArgument("frames of a cross-fade", repr(frames), f"0 to {shortest}, the shorter medium")
    _check_alike((first, second))
    begin = len(first) - frames

    def make(i: int) -> ForceField:
        if i < begin:
            return first[i]
        if i >= len(first):
            return second[i - begin]
        share = (i - begin + 1) / (frames + 1)
        return first[i].scaled(1 - share) + second[i - begin].scaled(share)

    words = f"{len(first)} frames into {len(second)} over {frames}"
    return _spliced((first, second), begin + len(second), make, words)


def _check_alike(media: tuple[HapticMedium, ...]) -> None:
    for n, one in enumerate(media[1:], start=1):
        for name in _SHARED:
            mine, theirs = getattr(one, name), getattr(media[0], name)
            if mine != theirs:
                raise InvalidArgument(f"medium {n} to splice, {name}", str(mine), f"{theirs}, as of medium 0")


def _spliced(
    media: tuple[HapticMedium, ...], count: int, make: Callable[[int], ForceField], words: str
) -> HapticMedium:
    before = "; ".join(m.provenance["splices"] for m in media if "splices" in m.provenance)
    provenance = {**media[0].provenance, "splices": f"{before}; {words}" if before else words}
    return replace(media[0], frame_count=count, make_frame=make, provenance=provenance, vibration=None, segments=None)
