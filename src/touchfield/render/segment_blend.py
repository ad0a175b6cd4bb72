"""Blending of segments: removes the step at the start of a segment during playback.

Each segment is encoded independently, so that the force of a static world jumps at the start of a segment, by
less than the mask. Here the last frame of the segment before is blended into the new one by a raised cosine
of `BLEND_S`, or half the segment if that is shorter. This is done voxel by voxel, where both forces can come
from one source; elsewhere the new frame is used at once. Where the source does not move, both forces are
within its mask, which is a ball, and so is every blend of them. A source that moves by less than two masks is
shown late by `BLEND_S` at most.

The frames depend on what was played before. `HapticMedium` itself, and all that reads it, stays exact.
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
"""Length of a blend, seconds of the medium; half of it makes half of the change.

At 30 Hz it is three frames, none of which makes more than half of the change; with 0.05 s the first would
make three quarters. In fast media, the edge of a raised cosine of duration T has at most 1 / (4 f^2 T^2 - 1)
of the amplitude that a step has at frequency f: 36 dB less at 40 Hz, where the band begins in which a hand
feels vibration best. A longer blend gained nothing on a room at 30 Hz, and delays what moves by less than the
mask.
"""

MAX_UNBLENDED_HZ: Final = 20.0
"""Highest frame rate that is not blended.

At this rate and below, the receiver interpolates between frames for 50 ms or more.
"""

_CHUNK_BRICKS: Final = 64


class SegmentBlend:
    """The frames of a decoded medium in the order of play; used by one thread.

    A frame that follows the frame requested before neither within its segment nor in a loop is returned as it
    was decoded, and so are the frames after it, up to the next segment.
    """

    def __init__(self, medium: HapticMedium, segments: Segments) -> None:
        self._medium, self._segments = medium, segments
        self.forget()

    def forget(self) -> None:
        """Start anew: the next frame does not follow the latest one."""
        self._latest: tuple[int, ForceField] | None = None
        self._previous: ForceField | None = None

    def __call__(self, frame: int) -> ForceField:
        """Decode a frame, and blend it if a segment has just started."""
        latest_frame, latest = self._latest or (-1, None)
        if latest_frame == frame and latest is not None:
            return latest
        field, count = self._medium[frame], len(self._medium)
        first, length = self._segments.segment_at(frame, count)
        if frame == first:
            self._previous = latest if latest_frame >= 0 and (latest_frame + 1) % count == frame else None
        elif not first <= latest_frame < frame:
            self._previous = None
        blend_frames = BLEND_S * self._medium.rate_hz
        if first + length < count:  # the last segment, perhaps of a single frame, is not followed by another
            blend_frames = min(blend_frames, length / 2)
        if frame - first + 1 >= blend_frames:
            self._previous = None
        if self._previous is not None:
            weight = 0.5 - 0.5 * math.cos(math.pi * (frame - first + 1) / blend_frames)
            field = _blend_fields(self._previous, field, weight, self._segments)
        self._latest = frame, field
        return field


def with_blends(
    medium: HapticMedium | HapticScene,
) -> tuple[HapticMedium | HapticScene, tuple[SegmentBlend, ...]]:
    """A medium or a scene that blends its segments, and the blends that do so.

    The fields must be requested in the order of play. A rigid body has one field, which is encoded once. Of
    bodies that deform, each field is blended in its own frame of reference.
    """
    if isinstance(medium, HapticMedium):
        return _with_blend(medium)
    pairs = [_with_blend(body.medium) for body in medium.objects]
    blends = tuple(blend for _, body_blends in pairs for blend in body_blends)
    if not blends:
        return medium, ()
    objects = (replace(body, medium=blended) for body, (blended, _) in zip(medium.objects, pairs))
    return replace(medium, objects=tuple(objects)), blends


def _with_blend(medium: HapticMedium) -> tuple[HapticMedium, tuple[SegmentBlend, ...]]:
    if medium.segments is None or len(medium) == 1 or medium.rate_hz <= MAX_UNBLENDED_HZ:
        return medium, ()
    blend = SegmentBlend(medium, medium.segments)
    return replace(medium, make_frame=blend, segments=None), (blend,)


def _blend_fields(previous: ForceField, current: ForceField, weight: float, segments: Segments) -> ForceField:
    """`previous` blended into `current` by a weight, where both can be one source."""
    from touchfield.render.kernels.points import blend_bricks

    keys_of_fields = [brick_keys(field.grid, field.bricks) for field in (previous, current)]
    keys = np.union1d(*keys_of_fields)
    slots = np.full((2, len(keys)), -1)
    for field_slots, field_keys in zip(slots, keys_of_fields):
        field_slots[np.searchsorted(keys, field_keys)] = np.arange(len(field_keys))
    bricks = bricks_of(current.grid, keys)
    forces, is_supported = (
        np.empty((len(keys), BRICK, BRICK, BRICK, 3), np.float32),
        np.empty(len(keys), np.bool_),
    )
    rows = [field.forces_n.reshape(-1, 3 * BRICK**3) for field in (previous, current)]
    arguments = (slots, *rows, weight, segments.k, segments.f0_n, forces.reshape(len(keys), -1), is_supported)
    for_chunks(blend_bricks, len(keys), *arguments, chunk=_CHUNK_BRICKS)
    if not is_supported.all():
        bricks, forces = bricks[is_supported], forces[is_supported]
    return ForceField(current.grid, bricks, forces)
