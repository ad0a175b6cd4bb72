"""Writes fields and frames into the memory of a receiver, as ``c/touch_receiver.h`` describes them.

A **field** is a `touch_cells` with what lies behind it, as `medium.cells` makes it; its offsets count from
its first byte, so that a field can be moved as it is. A **frame** is a header, the pose of each body, and
perhaps a deformation. Sizes and offsets are in bytes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.cells import CellPool
from touchfield.medium.field import ForceField
from touchfield.medium.medium import BodyPoses, HapticMedium, HapticScene
from touchfield.render.block import Memory, aligned, layout

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from touchfield.medium.deformation import Deformation

FieldName = tuple[int, int]
"""(object, frame). Of a rigid object the frame is -1: one field serves all frames. Voxels are object 0."""

VIBRATION: Final = -1  # the object that is the vibration of voxels
_ALL_FRAMES: Final = -1
_NO_FORCE: Final = (-2, _ALL_FRAMES)  # the field of every body in a frame that is absent

_FLOOR_FRACTION: Final = 1e-9
"""As in `medium.cells`: an object's force below this fraction of F_max is a rounding error at its edge."""


@dataclass(frozen=True)
class FramePart:
    """A body of a frame; body n of a frame and body n of the next are the same body."""

    field_at: int  # offset of its field
    quaternion: Sequence[float] = (1.0, 0.0, 0.0, 0.0)  # unit, w first, scene from body
    position_m: Sequence[float] = (0.0, 0.0, 0.0)
    # velocity and angular velocity, both times the surface damping: N and N/m
    velocity: Sequence[float] = (0.0,) * 6
    # neither rotated nor moved, in this frame and wherever it is shown next to it, as voxels are
    is_identity: bool = False

    @classmethod
    def voxels(cls, field_at: int) -> FramePart:
        """Return the only body of a medium of voxels, which is where it is."""
        return cls(field_at, is_identity=True)


def field_bytes(pool: CellPool) -> int:
    """Return the size of a pool of one field, ``CellPool.of(field)``."""
    return len(pool.field_data)


def write_field(memory: Memory, offset: int, pool: CellPool) -> None:
    """Write a pool of one field at an offset."""
    data = pool.field_data
    memory.bytes[offset : offset + len(data)] = data


def write_fields(
    memory: Memory, offset: int, pools: Mapping[FieldName, CellPool], offsets: dict[FieldName, int]
) -> int:
    """Write fields one behind the other, and their offsets into `offsets`; return the offset behind them."""
    for name, pool in pools.items():
        write_field(memory, offset, pool)
        offsets[name] = offset
        offset += field_bytes(pool)
    return offset


def frame_bytes(bodies: int) -> int:
    """Return the size of a frame of so many bodies, without a deformation."""
    return aligned(layout.FRAME_HEADER.itemsize + bodies * layout.BODY_POSE.itemsize)


def write_frame(
    memory: Memory, offset: int, parts: Sequence[FramePart], force_max_n: float, vibration_at: int = 0
) -> None:
    """Write a frame at an offset.

    The sum of forces is clipped to `force_max_n`; `vibration_at` is the offset of the field of a vibration, 0
    for none.
    """
    header = memory.view(layout.FRAME_HEADER, offset)
    header["body_count"], header["vibration_offset"] = len(parts), vibration_at
    header["deformation_offset"], header["is_seam"], header["force_max_n"] = 0, 0, force_max_n
    floor_n = force_max_n * _FLOOR_FRACTION if math.isfinite(force_max_n) else 0.0
    header["force_floor2_n2"] = floor_n**2
    poses = memory.array(layout.BODY_POSE, offset + layout.FRAME_HEADER.itemsize, len(parts))
    for pose, part in zip(poses, parts, strict=True):
        pose["cells_offset"], pose["is_identity"] = part.field_at, part.is_identity
        pose["quaternion"], pose["position_m"] = part.quaternion, part.position_m
        pose["surface_damping_n"] = part.velocity[:3]
        pose["surface_damping_n_per_m"] = part.velocity[3:]
        pose["rotation"] = _rotation(*map(float, part.quaternion))


def deformation_bytes(deformation: Deformation) -> int:
    """Return the size of the lattice of a deformation, which lies behind a frame."""
    points = int(np.prod(deformation.displacement_m.shape[1:]))
    return aligned(layout.DEFORMATION.itemsize + 8 * points)


def write_deformation(
    memory: Memory, frame_at: int, size: int, deformation: Deformation, frame: int, yield_at: int = 0
) -> None:
    """Write frame `frame` of a deformation behind a frame of `size` bytes at `frame_at`.

    `yield_at` is the offset of the displacements by which it yields, 0 for none.
    """
    displacements = deformation.displacement_m[min(frame, len(deformation) - 1)]
    memory.view(layout.FRAME_HEADER, frame_at)["deformation_offset"] = size
    offset = frame_at + size
    lattice = memory.view(layout.DEFORMATION, offset)
    lattice["point_count"], lattice["yield_offset"] = displacements.shape[:3], yield_at
    lattice["corner_m"] = deformation.corner_m
    lattice["cells_per_m"] = 1.0 / np.array(deformation.spacing_m)
    lattice["compliance_m_per_n"] = deformation.compliance_m_per_n
    lattice["relaxation_s"] = deformation.relax_s
    lattice["max_yield_m"] = deformation.max_yield_m
    values = memory.array(np.float64, offset + layout.DEFORMATION.itemsize, displacements.size)
    values[:] = displacements.ravel()


def _rotation(w: float, x: float, y: float, z: float) -> tuple[tuple[float, float, float], ...]:
    """Return the rotation of a unit quaternion, as `medium.pose_track.rotation_matrices`."""
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def require_medium(medium: object) -> None:
    """Raise `InvalidArgument` for what is neither a medium nor a scene."""
    if not isinstance(medium, HapticMedium | HapticScene):
        hint = "A stream has its own as `stream.medium`; HapticMedium.from_frames makes one of fields."
        raise InvalidArgument("medium", f"a {type(medium).__name__}", "a HapticMedium or a HapticScene", hint)


class FrameParts:
    """Frames of a medium or a scene as fields and poses.

    `size_bytes` is the size of a frame without its fields. A `deformation` bends a medium of voxels, by
    tracks of its frames, or by tracks that make the frames of a medium of one; `yield_at` is the offset of
    the displacements by which it yields, or 0. Raises InvalidArgument if the deformation does not fit.
    """

    def __init__(self, medium: HapticMedium | HapticScene, deformation: Deformation | None = None) -> None:
        require_medium(medium)
        self.medium, self.deformation, self.yield_at = medium, deformation, 0
        self.frame_count, self.rate_hz = medium.frame_count, medium.rate_hz
        self.size_bytes = frame_bytes(len(medium.objects) if isinstance(medium, HapticScene) else 1)
        self._is_static = deformation is not None and medium.frame_count == 1
        if deformation is not None:
            self._check_deformation(deformation)
            self.size_bytes += deformation_bytes(deformation)
            if self._is_static and len(deformation) > 1:
                self.frame_count, self.rate_hz = len(deformation), deformation.rate_hz

    def _check_deformation(self, deformation: Deformation) -> None:
        if isinstance(self.medium, HapticScene):
            hint = "Encode it with --representation voxel."
            raise InvalidArgument("deformation", "a scene of objects", "a medium of voxels", hint)
        frame_count = self.medium.frame_count
        if not (len(deformation) in (1, frame_count) or self._is_static):
            found, expected = f"tracks of {len(deformation)} frames", f"1 or {frame_count}, as the medium has"
            raise InvalidArgument("deformation", found, expected)

    def names(self, frame: int) -> list[FieldName]:
        """Return the fields that a frame needs."""
        frame = _ALL_FRAMES if self._is_static else frame
        if isinstance(self.medium, HapticScene):
            names = [
                (n, _ALL_FRAMES if scene_object.is_rigid else frame)
                for n, scene_object in enumerate(self.medium.objects)
            ]
            return [*names, _NO_FORCE] if self.medium.has_gaps else names
        own = [(0, frame)]
        return own if self.medium.vibration is None else [*own, (VIBRATION, frame)]

    @staticmethod
    def is_shared(name: FieldName) -> bool:
        """True if one field serves all frames."""
        return name[1] == _ALL_FRAMES

    def field(self, name: FieldName) -> ForceField:
        """Return a field by its name."""
        number, frame = name
        if isinstance(self.medium, HapticScene):
            if name == _NO_FORCE:
                return ForceField.empty(self.medium.grid)
            return self.medium.objects[number].field(max(frame, 0))
        if number == VIBRATION and self.medium.vibration is not None:
            return self.medium.vibration(max(frame, 0)).as_field()
        return self.medium[max(frame, 0)]

    def cells(self, name: FieldName) -> CellPool:
        """Return a field as cells."""
        return CellPool.of(self.field(name))

    def poses(self, frame: int) -> BodyPoses | None:
        """Return the poses of the bodies in a frame; None of voxels."""
        return self.medium.poses(frame) if isinstance(self.medium, HapticScene) else None

    def write(
        self,
        memory: Memory,
        offset: int,
        frame: int,
        offsets: Mapping[FieldName, int],
        poses: BodyPoses | None = None,
    ) -> None:
        """Write a frame whose fields lie at `offsets`; `poses` are those of its bodies, if known already."""
        if not isinstance(self.medium, HapticScene):
            own, *others = self.names(frame)
            vibration_at = offsets[others[0]] if others else 0
            write_frame(memory, offset, [FramePart.voxels(offsets[own])], math.inf, vibration_at)
            if self.deformation is not None:
                write_deformation(memory, offset, frame_bytes(1), self.deformation, frame, self.yield_at)
            return
        poses = poses or self.medium.poses(frame)
        names = [_NO_FORCE if poses.is_absent else name for name in self.names(frame)]
        columns = zip(names, poses.quaternions, poses.positions_m, poses.motions)
        parts = [FramePart(offsets[name], q, t, motion) for name, q, t, motion in columns]
        write_frame(memory, offset, parts, self.medium.force_max_n)
