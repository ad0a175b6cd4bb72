"""Writes force fields and frames into the block, the memory that player and servo share, in the layout that
the servo's compiled code reads.

A **field** is a header and, behind it, what `medium.cells` made of it: the hash table, the bits of the cells
that hold a force, the samples. Its own places count from its first word, so that a field can be moved as it
is. A **frame** is a header and a row for each part: place of its field, its pose, what its own motion adds to
the force.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.medium.cells import CellPool
from touchfield.medium.medium import HapticMedium, HapticScene
from touchfield.render.block import Memory, words as W

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from touchfield.medium.deformation import Deformation
    from touchfield.medium.field import ForceField

FieldName = tuple[int, int]
"""(object, frame); of a rigid object the frame is -1, and one field serves all frames. Voxels are object 0.

"""

VIBRATION: Final = -1  # the object that is the vibration of voxels
_EVERY: Final = -1

_FLOOR_SHARE: Final = 1e-9
"""As in `medium.placed`: an object's own force below this share of F_max is the rounding of a place on the
edge.
"""


@dataclass(frozen=True)
class FramePart:
    """One object of a frame; the same field in two frames is one body that moves."""

    field_at: int  # where its field lies in the block
    quaternion: Sequence[float] = (1.0, 0.0, 0.0, 0.0)  # unit, w first, scene from body
    position_m: Sequence[float] = (0.0, 0.0, 0.0)
    velocity: Sequence[float] = (0.0,) * 6  # and angular velocity, both times the surface damping: N and N/m
    is_identity: bool = False  # not turned, in this frame and wherever it is shown next to it, as voxels are

    @classmethod
    def voxels(cls, field_at: int) -> FramePart:
        """The part of a medium of voxels: one, where it is."""
        return cls(field_at, is_identity=True)


def field_words(pool: CellPool) -> int:
    """Words that `write_field` takes for a pool of one field."""
    return W.FIELD_WORDS + pool.tables.size + pool.supported.size + -(-pool.cells.size // 2)


def write_field(memory: Memory, at: int, pool: CellPool) -> None:
    """Write a pool of one field (``CellPool.of(field)``) at word `at`."""
    i8, u8, f8, f4 = memory.views
    table = W.FIELD_WORDS
    held = table + pool.tables.size
    cells = held + pool.supported.size
    box, (spacing, corner) = pool.boxes[0, :3], pool.lattices[0].reshape(2, 3)
    far = np.maximum(np.abs(corner), np.abs(corner + 8 * box * spacing))
    i8[at : at + W.FIELD_WORDS] = 0
    i8[at + W.FIELD_BOX : at + W.FIELD_BOX + 3] = box
    i8[at + W.FIELD_SHIFT] = pool.boxes[0, 4]
    i8[at + W.FIELD_TABLE], i8[at + W.FIELD_HELD], i8[at + W.FIELD_CELLS] = table, held, cells
    f8[at + W.FIELD_INVERSE : at + W.FIELD_INVERSE + 3] = 1.0 / spacing
    f8[at + W.FIELD_CORNER : at + W.FIELD_CORNER + 3] = corner
    f8[at + W.FIELD_REACH] = 1.000001 * float(far @ far) if len(pool.bricks) else -1.0
    i8[at + table : at + held] = pool.tables.reshape(-1)
    u8[at + held : at + cells] = pool.supported.reshape(-1)
    f4[2 * (at + cells) : 2 * (at + cells) + pool.cells.size] = pool.cells


def write_fields(
    memory: Memory, at: int, pools: Mapping[FieldName, CellPool], places: dict[FieldName, int]
) -> int:
    """Write fields one behind the other and note their places; the word behind them."""
    for name, pool in pools.items():
        write_field(memory, at, pool)
        places[name] = at
        at += field_words(pool)
    return at


def frame_words(parts: int) -> int:
    """Words that `write_frame` takes for so many parts."""
    return W.FRAME_WORDS + parts * W.PART_WORDS


def write_frame(
    memory: Memory, at: int, parts: Sequence[FramePart], force_max_n: float, vibration_at: int = 0
) -> None:
    """Write a frame at word `at`; part n of a frame and part n of the next are the same object.

    The sum of forces is cut to `force_max_n`; `vibration_at` is the word of the field of a vibration, 0 for
    none.
    """
    i8, _, f8, _ = memory.views
    i8[at + W.FRAME_PARTS], i8[at + W.FRAME_VIBRATION], i8[at + W.FRAME_WARP] = len(parts), vibration_at, 0
    f8[at + W.FRAME_LIMIT] = force_max_n
    f8[at + W.FRAME_FLOOR] = (force_max_n * _FLOOR_SHARE) ** 2 if math.isfinite(force_max_n) else 0.0
    for n, part in enumerate(parts):
        row = at + W.FRAME_WORDS + n * W.PART_WORDS
        i8[row + W.PART_FIELD], i8[row + W.PART_IS_IDENTITY] = part.field_at, part.is_identity
        f8[row + W.PART_QUATERNION : row + W.PART_QUATERNION + 4] = part.quaternion
        f8[row + W.PART_POSITION : row + W.PART_POSITION + 3] = part.position_m
        f8[row + W.PART_MOTION : row + W.PART_MOTION + 6] = part.velocity
        f8[row + W.PART_MATRIX : row + W.PART_MATRIX + 9] = _matrix(*map(float, part.quaternion))


def warp_words(deformation: Deformation) -> int:
    """Words that `write_warp` takes behind a frame."""
    return W.WARP_WORDS + int(np.prod(deformation.displacement_m.shape[1:]))


def write_warp(
    memory: Memory, frame_at: int, offset: int, deformation: Deformation, frame: int, yield_at: int = 0
) -> None:
    """Write the lattice of a deformation `offset` words behind a frame's first, and tell the frame of it."""
    i8, _, f8, _ = memory.views
    at = frame_at + offset
    u = deformation.displacement_m[min(frame, len(deformation) - 1)]
    i8[frame_at + W.FRAME_WARP] = offset
    i8[at : at + 3] = u.shape[:3]
    i8[at + W.WARP_YIELD] = yield_at
    f8[at + W.WARP_CORNER : at + W.WARP_CORNER + 3] = deformation.corner_m
    f8[at + W.WARP_INVERSE : at + W.WARP_INVERSE + 3] = 1.0 / np.array(deformation.spacing_m)
    f8[at + W.WARP_COMPLIANCE], f8[at + W.WARP_RELAX] = deformation.compliance_m_per_n, deformation.relax_s
    f8[at + W.WARP_MOST] = deformation.max_yield_m
    f8[at + W.WARP_WORDS : at + W.WARP_WORDS + u.size] = u.ravel()


def _matrix(w: float, x: float, y: float, z: float) -> tuple[float, ...]:
    """R of a unit quaternion, row by row, as `medium.pose_track.rotation_matrices`."""
    return (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def require_medium(medium: object) -> None:
    """`InvalidArgument` for what is neither a medium nor a scene."""
    if not isinstance(medium, HapticMedium | HapticScene):
        mend = "A stream has its own as `stream.medium`; HapticMedium.from_frames makes one of fields."
        raise InvalidArgument("medium", f"a {type(medium).__name__}", "a HapticMedium or a HapticScene", mend)


class FrameParts:
    """Frames of a medium or a scene as fields and poses; `words` is what a frame takes without its fields.

    A `deformation` bends a medium of voxels, by tracks of its frames, or that make the frames of a medium of
    one; `yield_at` is the word of the displacements that it yields by, or 0. InvalidArgument if it does not
    fit.
    """

    def __init__(self, medium: HapticMedium | HapticScene, deformation: Deformation | None = None) -> None:
        require_medium(medium)
        self.medium, self.deformation, self.yield_at = medium, deformation, 0
        self.frame_count, self.rate_hz = medium.frame_count, medium.rate_hz
        self.words = frame_words(len(medium.objects) if isinstance(medium, HapticScene) else 1)
        self._is_still = deformation is not None and medium.frame_count == 1
        if deformation is not None:
            if isinstance(medium, HapticScene):
                mend = "Encode it with --representation voxel."
                raise InvalidArgument("deformation", "a scene of objects", "a medium of voxels", mend)
            if not (len(deformation) in (1, medium.frame_count) or self._is_still):
                expected = f"1 or {medium.frame_count}, as the medium has"
                raise InvalidArgument("deformation", f"tracks of {len(deformation)} frames", expected)
            self.words += warp_words(deformation)
            if self._is_still and len(deformation) > 1:
                self.frame_count, self.rate_hz = len(deformation), deformation.rate_hz
        self._motions: list[Float64s] = []
        if isinstance(medium, HapticScene):
            damping = medium.surface_damping_n_s_per_m
            for one in medium.objects:
                both = np.zeros((medium.frame_count, 6))
                if damping:
                    both = np.concatenate(one.track.velocities(medium.rate_hz), axis=1)
                with np.errstate(over="ignore"):  # the kernels cut what is beyond all bounds
                    self._motions.append(both * damping)

    def names(self, frame: int) -> list[FieldName]:
        """The fields that a frame needs."""
        frame = _EVERY if self._is_still else frame
        if isinstance(self.medium, HapticScene):
            return [(n, _EVERY if one.is_rigid else frame) for n, one in enumerate(self.medium.objects)]
        own = [(0, frame)]
        return own if self.medium.vibration is None else [*own, (VIBRATION, frame)]

    @staticmethod
    def is_shared(name: FieldName) -> bool:
        """True if one field serves all frames."""
        return name[1] == _EVERY

    def field(self, name: FieldName) -> ForceField:
        """Make one of them."""
        which, frame = name
        if isinstance(self.medium, HapticScene):
            return self.medium.objects[which].field(max(frame, 0))
        if which == VIBRATION and self.medium.vibration is not None:
            return self.medium.vibration(max(frame, 0)).as_field()
        return self.medium[max(frame, 0)]

    def cells(self, name: FieldName) -> CellPool:
        """Make one of them, as the kernels read it."""
        return CellPool.of(self.field(name))

    def write(self, memory: Memory, at: int, frame: int, places: Mapping[FieldName, int]) -> None:
        """Write a frame whose fields lie at `places`."""
        if not isinstance(self.medium, HapticScene):
            own, *others = self.names(frame)
            vibration_at = places[others[0]] if others else 0
            write_frame(memory, at, [FramePart.voxels(places[own])], math.inf, vibration_at)
            if self.deformation is not None:
                write_warp(memory, at, frame_words(1), self.deformation, frame, self.yield_at)
            return
        parts = [
            FramePart(places[name], one.track.quaternions[frame], one.track.positions_m[frame], motion[frame])
            for one, name, motion in zip(self.medium.objects, self.names(frame), self._motions, strict=True)
        ]
        write_frame(memory, at, parts, self.medium.force_max_n)
