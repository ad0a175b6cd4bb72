"""How a field and a frame lie in `Memory`, in words of eight bytes.

A **field** is a header and, behind it, what `medium.cells` made of it: the hash table, the bits of the cells that
hold a force, the samples. Its own places count from its first word, so that a field can be moved as it is.

=========  =====  ==================================================================================================
BOX        3 i8   bricks of cells along x, y, z; zero for a field without force
SHIFT      i8     64 - bits of the hash table
TABLE      i8     where the table begins, int64 [2^bits, 2]: brick and slot
HELD       i8     where the bits begin, uint64 [n, 8]
CELLS      i8     where the samples begin, float32 [n, 9, 9, 9, 3]
INVERSE    3 f8   one by the spacing, 1/m
CORNER     3 f8   corner of the box in the field's own frame, metres
REACH      f8     square of the distance from the frame's origin within which all forces lie, m^2; -1 without force
=========  =====  ==================================================================================================

A **frame** is a header (COUNT of parts, place of the field of VIBRATION or 0, LIMIT of the sum in newtons, FLOOR: the
square of what counts as no force) and a row for each part: place of its field, whether it is unturned, its pose, what
its own motion adds to the force, and the matrix of its rotation. Places in a frame are words of the block.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from collections.abc import Sequence

    from touchfield.medium.cells import CellPool
    from touchfield.render.memory import Memory

__all__ = ["FramePart", "field_words", "frame_words", "write_field", "write_frame"]

FIELD_BOX: Final = 0
FIELD_SHIFT: Final = 3
FIELD_TABLE: Final = 4
FIELD_HELD: Final = 5
FIELD_CELLS: Final = 6
FIELD_INVERSE: Final = 8
FIELD_CORNER: Final = 11
FIELD_REACH: Final = 14
FIELD_WORDS: Final = 16

FRAME_COUNT: Final = 0
FRAME_VIBRATION: Final = 1
FRAME_LIMIT: Final = 2
FRAME_FLOOR: Final = 3
FRAME_WORDS: Final = 4

PART_FIELD: Final = 0
PART_IS_IDENTITY: Final = 1
PART_QUATERNION: Final = 2
PART_POSITION: Final = 6
PART_MOTION: Final = 9
PART_MATRIX: Final = 15
PART_WORDS: Final = 24

AT_A_FRAME: Final = 1e-9
"""Frames: an instant so near to a frame is that frame, whatever the rounding of its seconds says."""

_FLOOR_SHARE: Final = 1e-9
"""As in `medium.placed`: an object's own force below this share of F_max is the rounding of a place on the edge."""

_STILL: Final = (0.0,) * 6


@dataclass(frozen=True)
class FramePart:
    """One object of a frame: where its field lies in the block, and how the object lies in the scene.

    Parameters
    ----------
    field_at : int
        Word of a field (`write_field`). The same field in two frames is one body that moves.
    quaternion : (w, x, y, z)
        Unit; scene from body.
    position_m : (x, y, z)
        Of the body's origin in the scene.
    velocity : six numbers
        Velocity of the body, then its angular velocity, both times the surface damping of the scene: N and N/m, added
        to the object's force where it has one (`medium.placed`). Zeros where the scene has no surface damping.
    is_identity : bool
        Whether the body is not turned, in this frame and wherever it is shown next to it; voxels are.
    """

    field_at: int
    quaternion: Sequence[float] = (1.0, 0.0, 0.0, 0.0)
    position_m: Sequence[float] = (0.0, 0.0, 0.0)
    velocity: Sequence[float] = _STILL
    is_identity: bool = False

    @classmethod
    def voxels(cls, field_at: int) -> FramePart:
        """The part of a medium of voxels: one, where it is."""
        return cls(field_at, is_identity=True)


def field_words(pool: CellPool) -> int:
    """Words that `write_field` takes for a pool of one field."""
    return FIELD_WORDS + pool.tables.size + pool.held.size + -(-pool.cells.size // 2)


def write_field(memory: Memory, at: int, pool: CellPool) -> None:
    """Write a pool of one field (``CellPool.of(field)``) at word `at`.

    Raises
    ------
    InvalidArgument
        If it does not lie within the block, or the pool has several fields.
    """
    if len(pool.boxes) != 1:
        raise InvalidArgument("pool", f"{len(pool.boxes)} fields", "one field")
    _check_place(memory, at, field_words(pool))
    i8, u8, f8, f4 = memory.views
    table = FIELD_WORDS
    held = table + pool.tables.size
    cells = held + pool.held.size
    box, (spacing, corner) = pool.boxes[0, :3], pool.lattices[0].reshape(2, 3)
    far = np.maximum(np.abs(corner), np.abs(corner + 8 * box * spacing))
    i8[at : at + FIELD_WORDS] = 0
    i8[at + FIELD_BOX : at + FIELD_BOX + 3] = box
    i8[at + FIELD_SHIFT] = pool.boxes[0, 4]
    i8[at + FIELD_TABLE], i8[at + FIELD_HELD], i8[at + FIELD_CELLS] = table, held, cells
    f8[at + FIELD_INVERSE : at + FIELD_INVERSE + 3] = 1.0 / spacing
    f8[at + FIELD_CORNER : at + FIELD_CORNER + 3] = corner
    f8[at + FIELD_REACH] = 1.000001 * float(far @ far) if len(pool.bricks) else -1.0
    i8[at + table : at + held] = pool.tables.reshape(-1)
    u8[at + held : at + cells] = pool.held.reshape(-1)
    f4[2 * (at + cells) : 2 * (at + cells) + pool.cells.size] = pool.cells


def frame_words(parts: int) -> int:
    """Words that `write_frame` takes for so many parts."""
    return FRAME_WORDS + parts * PART_WORDS


def write_frame(
    memory: Memory, at: int, parts: Sequence[FramePart], force_max_n: float, vibration_at: int = 0
) -> None:
    """Write a frame at word `at`.

    Parameters
    ----------
    memory : Memory
    at : int
    parts : sequence of FramePart
        Part n of a frame and part n of the next are the same object.
    force_max_n : float
        To which the sum is cut, as in `HapticScene`; infinite for voxels.
    vibration_at : int
        Word of a field written from ``VibrationFrame.as_field()``; 0 for none.

    Raises
    ------
    InvalidArgument
        If it does not lie within the block.
    """
    _check_place(memory, at, frame_words(len(parts)))
    i8, _, f8, _ = memory.views
    i8[at + FRAME_COUNT], i8[at + FRAME_VIBRATION] = len(parts), vibration_at
    f8[at + FRAME_LIMIT] = force_max_n
    f8[at + FRAME_FLOOR] = (force_max_n * _FLOOR_SHARE) ** 2 if math.isfinite(force_max_n) else 0.0
    for n, part in enumerate(parts):
        row = at + FRAME_WORDS + n * PART_WORDS
        i8[row + PART_FIELD], i8[row + PART_IS_IDENTITY] = part.field_at, part.is_identity
        f8[row + PART_QUATERNION : row + PART_QUATERNION + 4] = part.quaternion
        f8[row + PART_POSITION : row + PART_POSITION + 3] = part.position_m
        f8[row + PART_MOTION : row + PART_MOTION + 6] = part.velocity
        f8[row + PART_MATRIX : row + PART_MATRIX + 9] = _matrix(*map(float, part.quaternion))


def _matrix(w: float, x: float, y: float, z: float) -> tuple[float, ...]:
    """R of a unit quaternion, row by row, as `medium.rotations.rotation_matrices`."""
    return (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _check_place(memory: Memory, at: int, words: int) -> None:
    if at < 0 or at + words > memory.words:
        raise InvalidArgument("place in the block", f"words {at} to {at + words}", f"0 to {memory.words}")
