"""How the coder `objects` lays a haptic scene out in bytes, written and read by the same functions."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from touchfield.codec.pose_track import POSES_CHAPTER
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, TruncatedFile

if TYPE_CHECKING:
    from touchfield.medium import Grid

__all__ = [
    "CHAPTER",
    "MAX_OBJECTS",
    "MAX_POSES",
    "CodedObject",
    "ObjectPart",
    "read_parameters",
    "read_parts",
    "write_parameters",
    "write_parts",
]

MAX_OBJECTS: Final = 4096
"""Objects of a scene."""

MAX_POSES: Final = 1 << 24
"""Frames times objects of a scene: a body that keeps still costs next to no bytes, but a pose in memory a frame."""

_PARAMETERS: Final = struct.Struct("<Id")
_WHERE: Final = "HEAD.coder_parameters"

CHAPTER: Final = (
    f"""\
## The body of a segment: coder `objects`

The object source model of the paper's section 4.3: "a haptic scene is comprised by its haptic objects and empty
space". Each OBJT record is an object, with a lattice in a frame of its own. A segment tells where these frames lie,
and has the fields of the objects that deform. The grid of HEAD is the lattice of the workspace, for a receiver that
wants samples of the whole; objects may reach beyond it.

`HEAD.coder_parameters`:

| offset | type | what |
|---|---|---|
| 0 | u32 | number of objects, 1 to {MAX_OBJECTS}: there are as many OBJT records |
| 4 | f64 | b_s, surface damping, N s/m, 0 or more, finite |

`frame_count` of HEAD times the number of objects is at most 2^{MAX_POSES.bit_length() - 1}.

`OBJT.field_coder` is a coder of fields on one lattice: `paper`. `OBJT.field_parameters` are its `coder_parameters`,
and the grid of its chapter is that of OBJT. `OBJT.field` of a rigid object is a segment body of one frame of that
coder. `OBJT.pose_steps` is two bytes, each an i8: the exponents of the steps s and u of the section on poses. A
varint and a *chunk* are those of the coder `paper`.

The body of a segment has for each object, in the order of the OBJT:

| part | form | what |
|---|---|---|
| poses | chunk | the poses of the frames of the segment, below |
| fields | chunk | only where `is_deforming` is 1: a segment body of the field coder, for these frames |

The parts fill the body exactly.

**Force.** A pose is a position t in metres and a unit quaternion (w, x, y, z), with the rotation

```text
    | 1 - 2 (y y + z z)   2 (x y - w z)       2 (x z + w y)     |
R = | 2 (x y + w z)       1 - 2 (x x + z z)   2 (y z - w x)     |
    | 2 (x z - w y)       2 (y z + w x)       1 - 2 (x x + y y) |
```

A point q of an object's own frame lies at R q + t in the frame of HEAD. The force of an object at a point p is
f = R F(R^T (p - t)), F being its field, interpolated linearly along x, y and z between the samples of its lattice;
samples outside the lattice are zero, so that the force falls to zero over one spacing. Where |F| is above 10^-9 times
`force_max_n` of HEAD, which leaves out the rounding of places at the edge of a support, b_s (v + omega × (p - t)) is
added to f: b_s times the velocity of the object there.

The forces of all objects are summed in their order. Where the sum is longer than `force_max_n` of HEAD it is
shortened to that length. A frame as samples is this force at the points of the grid of HEAD; it is defined to the
rounding of f32.

The velocity of frame i, with i1 = min(i + 1, `frame_count` - 1), i0 = max(i - 1, 0) and
T = (i1 - i0) / `rate_hz`: v = (t of i1, less t of i0) / T. The quaternion of i1 times the conjugate of that of i0,
with its sign chosen so that w is not negative, is (w, u): omega = u / |u| · 2 arctan2(|u|, w) / T, and zero where u
is zero. Both are zero in a file of one frame.

conformance/v0 has files of objects, what each object decodes to (`NAME.objects.npz`), and the forces at the grid of
HEAD; conformance/reference_objects.py is the part of the short decoder for them.

"""
    + POSES_CHAPTER
)
"""What `touchfield.container.format_document` prints for this coder."""


@dataclass(frozen=True)
class CodedObject:
    """One object as a file holds it; the container's OBJT record has the same fields.

    Attributes
    ----------
    name : str
    grid : Grid
        The object's own lattice, hand metres.
    is_deforming : bool
        Whether every frame has its own field.
    field_coder : str
    field_parameters : bytes
    pose_steps : bytes
    field : bytes
        The coded field of a rigid object; empty for one that deforms.
    """

    name: str
    grid: Grid
    is_deforming: bool
    field_coder: str
    field_parameters: bytes
    pose_steps: bytes
    field: bytes


@dataclass(frozen=True)
class ObjectPart:
    """What a segment holds of one object, not decoded yet; `fields` is None for a rigid one."""

    poses: bytes
    fields: bytes | None


def write_parameters(object_count: int, surface_damping_n_s_per_m: float) -> bytes:
    """`HEAD.coder_parameters` of the coder."""
    return _PARAMETERS.pack(object_count, surface_damping_n_s_per_m)


def read_parameters(data: bytes) -> tuple[int, float]:
    """Number of objects and surface damping, N s/m; CorruptFile if they are out of bounds."""
    if len(data) != _PARAMETERS.size:
        raise CorruptFile(_WHERE, f"{len(data)} bytes", f"{_PARAMETERS.size} bytes")
    count, damping = _PARAMETERS.unpack(data)
    if not 1 <= count <= MAX_OBJECTS:
        raise CorruptFile(_WHERE, f"{count} objects", f"1 to {MAX_OBJECTS}")
    if not 0 <= damping < math.inf:
        raise CorruptFile(_WHERE, f"a surface damping of {damping!r} N s/m", "finite, 0 or more")
    return count, damping


def write_parts(parts: Iterable[ObjectPart]) -> bytes:
    """The body of a segment."""
    chunks = [c for part in parts for c in (part.poses, part.fields) if c is not None]
    return b"".join(write_varint(len(chunk)) + chunk for chunk in chunks)


def read_parts(body: bytes, is_deforming: Sequence[bool]) -> list[ObjectPart]:
    """What the body of a segment holds of each object; none is decoded.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes end too early, or some are left over.
    """
    at = 0

    def chunk(what: str) -> bytes:
        nonlocal at
        length, at = read_varint(body, at, f"SEGM.body {what}")
        if length > len(body) - at:
            raise TruncatedFile(f"SEGM.body {what}", f"{len(body) - at} bytes", f"{length} bytes")
        at += length
        return body[at - length : at]

    parts = []
    for i, deforms in enumerate(is_deforming):
        poses = chunk(f"poses of object {i}")
        parts.append(ObjectPart(poses, chunk(f"fields of object {i}") if deforms else None))
    if at != len(body):
        raise CorruptFile("SEGM.body", f"{len(body) - at} bytes after the last object", "none")
    return parts
