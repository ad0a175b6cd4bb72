"""A medium as a receiver plays it on from segment to segment: without the step where one starts.

Each segment is coded anew, so that the force of a world that stands still jumps at its start, within the
mask. Here the last frame of the segment before goes over into the new one by a raised cosine in `BLEND_S`, or
half the segment where that is shorter, voxel by voxel, where both forces can be of one source; elsewhere the
new one is taken at once. Where the source stands, both keep its mask, which is a ball, and so does all
between. One that moves by less than two masks is shown later by `BLEND_S` at most.

The frames depend on what was played before; `HapticMedium` itself, and all that reads it, stays exact.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.compute.threads import for_chunks
from touchfield.medium import BRICK, ForceField, HapticMedium, HapticScene
from touchfield.medium.field import brick_keys, bricks_of

if TYPE_CHECKING:
    from touchfield.medium import Segments

BLEND_S: Final = 0.1
"""Seconds of the medium; half of the way is done in half of it. At 30 Hz these are three frames, none of
which makes more than half of the way; with 0.05 s the first makes three quarters. Of fast media, the edge of
a raised cosine that lasts T has 1 / (4 f^2 T^2 - 1) of what a step has at a frequency f at most: 36 dB less
at 40 Hz, where the band in which a hand feels vibration best begins. Longer gained nothing on a room at 30
Hz, and shows later what moves by less than the mask."""

SLOW_HZ: Final = 20.0
"""At this rate and below nothing is done: from frame to frame the receiver interpolates for 50 ms or more."""

_BRICKS_AT_ONCE: Final = 64


class SegmentBlend:
    """The frames of a decoded medium in the order of play; asked for by one thread.

    A frame that does not follow the one asked for before, but in its own segment or a loop, is as it was
    decoded, and so are those after it, up to the next segment.
    """

    def __init__(self, medium: HapticMedium, segments: Segments) -> None:
        self._medium, self._segments = medium, segments
        self.forget()

    def forget(self) -> None:
        """Begin anew: the next frame does not follow the one asked for last."""
        self._latest: tuple[int, ForceField] | None = None
        self._before: ForceField | None = None

    def __call__(self, frame: int) -> ForceField:
        """Decode a frame, and blend it where a segment has just begun."""
        at, latest = self._latest or (-1, None)
        if at == frame and latest is not None:
            return latest
        shown, count = self._medium[frame], len(self._medium)
        first, length = self._segments.around(frame, count)
        if frame == first:
            self._before = latest if at >= 0 and (at + 1) % count == frame else None
        elif not first <= at < frame:
            self._before = None
        lasts = BLEND_S * self._medium.rate_hz
        if first + length < count:  # nothing follows the last one, which may be of a single frame
            lasts = min(lasts, length / 2)
        if frame - first + 1 >= lasts:
            self._before = None
        if self._before is not None:
            share = 0.5 - 0.5 * math.cos(math.pi * (frame - first + 1) / lasts)
            shown = _blended(self._before, shown, share, self._segments)
        self._latest = frame, shown
        return shown


def with_blends(
    medium: HapticMedium | HapticScene,
) -> tuple[HapticMedium | HapticScene, tuple[SegmentBlend, ...]]:
    """A medium or a scene whose fields are asked for in the order of play, and what blends them.

    Rigid bodies have one field, which is coded once; of those that deform, each field is blended in its own
    frame.
    """
    if isinstance(medium, HapticMedium):
        return _with_blend(medium)
    pairs = [_with_blend(one.medium) for one in medium.objects]
    blends = tuple(blend for _, own in pairs for blend in own)
    if not blends:
        return medium, ()
    objects = (replace(one, medium=blended) for one, (blended, _) in zip(medium.objects, pairs))
    return replace(medium, objects=tuple(objects)), blends


def _with_blend(medium: HapticMedium) -> tuple[HapticMedium, tuple[SegmentBlend, ...]]:
    if medium.segments is None or len(medium) == 1 or medium.rate_hz <= SLOW_HZ:
        return medium, ()
    blend = SegmentBlend(medium, medium.segments)
    return replace(medium, make_frame=blend, segments=None), (blend,)


def _blended(before: ForceField, after: ForceField, share: float, segments: Segments) -> ForceField:
    from touchfield.render.kernels.points import blend_bricks

    both = [brick_keys(field.grid, field.bricks) for field in (before, after)]
    keys = np.union1d(*both)
    slots = np.full((2, len(keys)), -1)
    for own, of_field in zip(slots, both):
        own[np.searchsorted(keys, of_field)] = np.arange(len(of_field))
    bricks = bricks_of(after.grid, keys)
    forces, held = np.empty((len(keys), BRICK, BRICK, BRICK, 3), np.float32), np.empty(len(keys), np.bool_)
    rows = [field.forces_n.reshape(-1, 3 * BRICK**3) for field in (before, after)]
    arguments = (slots, *rows, share, segments.k, segments.f0_n, forces.reshape(len(keys), -1), held)
    for_chunks(blend_bricks, len(keys), *arguments, chunk=_BRICKS_AT_ONCE)
    if not held.all():
        bricks, forces = bricks[held], forces[held]
    return ForceField(after.grid, bricks, forces)
