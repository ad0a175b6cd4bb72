"""Smooths the small step in force where playback passes from one coded segment to the next, by blending the
last frame of the one into the start of the other.

Each segment is encoded independently, so that the force of a static world jumps at the start of a segment, by
less than the mask. Here the last frame of the previous segment is blended into the new segment by a raised
cosine over 0.1 s of the medium, or over half the segment if that is shorter (``c/touch_segment_blend.h``).
Media of 20 Hz and less are not blended. Voxels are blended if both forces can come from the same source
force; elsewhere the new frame is used immediately. Where the source does not move, both forces are within its
mask, which is a ball, and so is every blend of them. A source that moves by less than two masks is shown late
by 0.1 s at most.

The frames depend on what was played before. `HapticMedium` itself, and all that reads it, stays exact.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.medium import BRICK, ForceField, HapticMedium, HapticScene
from touchfield.medium.field import brick_keys, bricks_of

if TYPE_CHECKING:
    from touchfield.medium import Segments

_CHUNK_BRICKS: Final = 64


class SegmentBlend:
    """Blended frames of a decoded medium, in the order of playback; used by one thread.

    After a jump, frames are returned as they were decoded, up to the next segment. A jump is a request that
    does not continue from the previous one within its segment, into the next segment or through the repeat of
    a loop.
    """

    def __init__(self, medium: HapticMedium, segments: Segments) -> None:
        self._medium, self._segments = medium, segments
        self.forget()

    def forget(self) -> None:
        """Forget the latest frame: the next one does not follow it."""
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
        # the last segment, perhaps of a single frame, is not followed by another
        is_last = first + length >= count
        weight = native.blend_weight(self._medium.rate_hz, frame - first, length, is_last)
        if weight == 1.0:
            self._previous = None
        if self._previous is not None:
            field = _blend_fields(self._previous, field, weight, self._segments)
        self._latest = frame, field
        return field


def with_blends(
    medium: HapticMedium | HapticScene,
) -> tuple[HapticMedium | HapticScene, tuple[SegmentBlend, ...]]:
    """Return a medium or a scene that blends its segments, and the blends that do so.

    The fields must be requested in the order of play. A rigid body has one field, which is encoded once. The
    fields of deforming bodies are blended in their body frames.
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
    is_blended = native.blend_weight(medium.rate_hz, 0, len(medium), True) < 1.0
    if medium.segments is None or len(medium) == 1 or not is_blended:
        return medium, ()
    blend = SegmentBlend(medium, medium.segments)
    return replace(medium, make_frame=blend, segments=None), (blend,)


def _blend_fields(previous: ForceField, current: ForceField, weight: float, segments: Segments) -> ForceField:
    """Blend `previous` into `current` by a weight, where both can come from one source force."""
    keys_of_fields = [brick_keys(field.grid, field.bricks) for field in (previous, current)]
    keys = np.union1d(*keys_of_fields)
    slots = np.full((2, len(keys)), -1, np.int64)
    for field_slots, field_keys in zip(slots, keys_of_fields):
        field_slots[np.searchsorted(keys, field_keys)] = np.arange(len(field_keys))
    bricks = bricks_of(current.grid, keys)
    forces, is_supported = (
        np.empty((len(keys), BRICK, BRICK, BRICK, 3), np.float32),
        np.empty(len(keys), np.bool_),
    )
    rule = weight, segments.k, segments.f0_n
    arguments = slots, previous.forces_n, current.forces_n, *rule, forces, is_supported
    for_chunks(native.blend_bricks, len(keys), *arguments, chunk=_CHUNK_BRICKS)
    if not is_supported.all():
        bricks, forces = bricks[is_supported], forces[is_supported]
    return ForceField(current.grid, bricks, forces)
