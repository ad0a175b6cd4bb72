"""A haptic scene: the object representation of a medium (paper sections 4.3 and 5.1, the "object" columns).

Each object is a field in its own frame, and a pose track; two thousand frames of rigid motion are two thousand poses
and one field. Where there is no object there is no force.

Where objects overlap their forces are added, as a probe in two walls feels both, and the sum is clipped to F_max
with its direction kept. Both representations of a scene follow this rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import ForceField
from touchfield.medium.grid import Grid
from touchfield.medium.medium import HapticMedium
from touchfield.medium.pose_track import PoseTrack

if TYPE_CHECKING:
    from touchfield.medium.cells import PlacedFields


@dataclass(frozen=True)
class HapticObject:
    """A field in its own frame, and where that frame lies."""

    name: str
    medium: HapticMedium  # one frame for a rigid object; a frame for each of the scene for one that deforms
    track: PoseTrack  # scene from body, one pose for each frame of the scene

    @property
    def is_rigid(self) -> bool:
        """True if one field serves all frames."""
        return len(self.medium) == 1

    def field(self, frame: int) -> ForceField:
        """The object's own field at a frame of the scene, in its own frame."""
        return self.medium[0 if self.is_rigid else frame]


@dataclass(frozen=True)
class HapticScene:
    """Haptic objects and empty space over time.

    grid : Grid; the device's lattice over the workspace, for `voxelise`; objects may reach beyond it.
    force_max_n : float; F_max, to which the sum of overlapping objects is clipped.
    surface_damping_n_s_per_m : float; b of a moving surface: where an object has a force, b times the velocity of
        the body there is added to it (with the receiver's damping b this makes F_d = -b (v_hand - v_surface)).
    axes, friction, damping_n_s_per_m, tags, provenance; As of `HapticMedium`.
    file_bytes : int or None; the length of the file that it comes from, bytes: it bounds what `voxelise` does on the
        scene's own grid.
    """

    grid: Grid
    rate_hz: float
    objects: tuple[HapticObject, ...]
    force_max_n: float
    surface_damping_n_s_per_m: float = 0.0
    axes: str = "x, y, z"
    friction: float = 0.0
    damping_n_s_per_m: float = 0.0
    tags: tuple[str, ...] = ("direct",)
    provenance: Mapping[str, str] = field(default_factory=dict)
    file_bytes: int | None = None

    def __post_init__(self) -> None:
        if not self.objects:
            raise InvalidArgument("objects", "none", "at least one HapticObject")
        if not (self.force_max_n > 0 and np.isfinite(self.force_max_n)):
            raise InvalidArgument("force_max_n", repr(self.force_max_n), "a positive number of newtons")
        if not (self.rate_hz > 0 and np.isfinite(self.rate_hz)):
            raise InvalidArgument("rate_hz", repr(self.rate_hz), "a positive number of frames a second")
        damping = self.surface_damping_n_s_per_m
        if not (damping >= 0 and np.isfinite(damping)):
            raise InvalidArgument("surface_damping_n_s_per_m", repr(damping), "0 or a positive number")
        count = len(self.objects[0].track)
        for one in self.objects:
            where = f"object {one.name}"
            if len(one.track) != count:
                raise InvalidArgument(where, f"{len(one.track)} poses", f"{count}, as the first object has")
            if not one.is_rigid and len(one.medium) != count:
                raise InvalidArgument(where, f"{len(one.medium)} fields", f"1 or {count}")
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    @cached_property
    def _placed(self) -> PlacedFields:
        from touchfield.medium.cells import PlacedFields

        return PlacedFields(self)

    @property
    def frame_count(self) -> int:
        """Frames of the scene."""
        return len(self.objects[0].track)

    def __len__(self) -> int:
        return self.frame_count

    def between(self, start: int, stop: int) -> HapticScene:
        """Frames start to stop - 1 as a scene of their own.

        Velocities are those of its own poses: with surface damping its first and last frame, whose neighbours are
        not in it, have one-sided differences, and a single frame has none.
        """

        def cut(one: HapticObject) -> HapticObject:
            medium = one.medium if one.is_rigid else one.medium.between(start, stop)
            return HapticObject(one.name, medium, one.track.between(start, stop))

        return replace(self, objects=tuple(map(cut, self.objects)))

    def sample_n(self, frame: int, positions_m: ArrayLike) -> Float32s:
        """Force at points of the scene in metres [..., 3], newtons, float32 [..., 3]: the receiver's own query.

        Each object's field is interpolated in its own frame as `ForceField.sample_n` does.
        """
        return self._placed.sample_n(frame, positions_m)

    def voxelise(self, grid: Grid | None = None) -> HapticMedium:
        """The voxel representation: a lazy medium on `grid` (by default the scene's own).

        Each sample is `sample_n` at its point. On its own grid a frame of a scene from a file raises CorruptFile
        where its objects reach more bricks than the bytes of the file justify (docs/format/objects.md).
        """
        on, placed = self.grid if grid is None else grid, self._placed
        file_bytes = self.file_bytes if on == self.grid else None
        beside = self.axes, self.friction, self.damping_n_s_per_m, self.tags, self.provenance
        frame_count, make = self.frame_count, lambda i: placed.voxels(i, on, file_bytes)
        return HapticMedium(on, self.rate_hz, frame_count, make, *beside)
