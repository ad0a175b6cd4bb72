"""What the frames of a medium or of a haptic scene are made of: which fields each needs, and where they are shown.

A field is named by (object, frame); of a rigid object the frame is -1, and one field serves all frames. Voxels are
object 0, their vibration is object `VIBRATION`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.medium.cells import CellPool
from touchfield.medium.haptic_scene import HapticScene
from touchfield.render.frame_block import FramePart, frame_words, write_frame

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from touchfield.medium.field import ForceField
    from touchfield.medium.medium import HapticMedium
    from touchfield.render.memory import Memory

__all__ = ["VIBRATION", "FieldName", "FrameParts"]

FieldName = tuple[int, int]
VIBRATION: Final = -1
_EVERY: Final = -1


class FrameParts:
    """Frames as fields and poses.

    Parameters
    ----------
    medium : HapticMedium or HapticScene

    Attributes
    ----------
    frame_count : int
    rate_hz : float
    words : int
        That a frame takes, without its fields.
    """

    def __init__(self, medium: HapticMedium | HapticScene) -> None:
        self.medium = medium
        self.frame_count, self.rate_hz = medium.frame_count, medium.rate_hz
        self.words = frame_words(len(medium.objects) if isinstance(medium, HapticScene) else 1)
        self._motions: list[NDArray[np.float64]] = []
        if isinstance(medium, HapticScene) and medium.surface_damping_n_s_per_m:
            for one in medium.objects:
                both = np.concatenate(one.track.velocities(medium.rate_hz), axis=1)
                with np.errstate(over="ignore"):  # the kernels cut what is beyond all bounds
                    self._motions.append(both * medium.surface_damping_n_s_per_m)

    def names(self, frame: int) -> list[FieldName]:
        """The fields that a frame needs."""
        if isinstance(self.medium, HapticScene):
            return [(n, _EVERY if one.is_rigid else frame) for n, one in enumerate(self.medium.objects)]
        own = [(0, frame)]
        return own if self.medium.vibration is None else [*own, (VIBRATION, frame)]

    @staticmethod
    def is_shared(name: FieldName) -> bool:
        """Whether one field serves all frames."""
        return name[1] == _EVERY

    def field(self, name: FieldName) -> ForceField:
        """Make one of them."""
        which, frame = name
        if isinstance(self.medium, HapticScene):
            return self.medium.objects[which].field(max(frame, 0))
        if which == VIBRATION and self.medium.vibration is not None:
            return self.medium.vibration[frame].as_field()
        return self.medium[frame]

    def cells(self, name: FieldName) -> CellPool:
        """Make one of them, as the kernels read it."""
        return CellPool.of(self.field(name))

    def write(self, memory: Memory, at: int, frame: int, places: Mapping[FieldName, int]) -> None:
        """Write a frame whose fields lie at `places`."""
        if not isinstance(self.medium, HapticScene):
            vibration_at = places.get((VIBRATION, frame), 0)
            write_frame(memory, at, [FramePart.voxels(places[0, frame])], math.inf, vibration_at)
            return
        parts = []
        for n, (one, name) in enumerate(zip(self.medium.objects, self.names(frame), strict=True)):
            quaternion, position_m = one.track.quaternions[frame], one.track.positions_m[frame]
            if self._motions:
                parts.append(FramePart(places[name], quaternion, position_m, self._motions[n][frame]))
            else:
                parts.append(FramePart(places[name], quaternion, position_m))
        write_frame(memory, at, parts, self.medium.force_max_n)
