"""How the coder `objects` lays a haptic scene out in bytes, written and read by the same functions; its
entry.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from touchfield.codec.registry import Coder
from touchfield.codec.segment import RATIO_STEPS, BoundRule, Worst
from touchfield.codec.varint import Parts, chunk, write_varint
from touchfield.errors import CorruptFile
from touchfield.medium import Grid

NAME: Final = "objects"

MAX_OBJECTS: Final = 4096  # objects of a scene
# frames times objects of a scene: a body that keeps still costs next to no bytes, but a pose in memory a
# frame
MAX_POSES: Final = 1 << 24
_PARAMETERS: Final = struct.Struct("<Idd")
_WHERE: Final = "HEAD.coder_parameters"
_MOST_SAMPLES: Final = 1 << 20


@dataclass(frozen=True)
class CodedObject:
    """One object as a file and its OBJT hold it; `field` is empty where it deforms; its own grid, hand
    metres.
    """

    name: str
    grid: Grid
    is_deforming: bool
    field_coder: str
    field_parameters: bytes
    pose_steps: bytes
    field: bytes


class Parameters(NamedTuple):
    """`HEAD.coder_parameters`: objects, surface damping in N s/m, and the tolerance in place, metres (0:
    unknown).
    """

    object_count: int
    surface_damping_n_s_per_m: float
    place_tolerance_m: float

    def to_bytes(self) -> bytes:
        """20 bytes."""
        return _PARAMETERS.pack(*self)

    @classmethod
    def from_bytes(cls, data: bytes) -> Parameters:
        """The inverse of `to_bytes`; CorruptFile if a number is out of bounds."""
        if len(data) != _PARAMETERS.size:
            raise CorruptFile(_WHERE, f"{len(data)} bytes", f"{_PARAMETERS.size} bytes")
        count, damping, tolerance = _PARAMETERS.unpack(data)
        if not 1 <= count <= MAX_OBJECTS:
            raise CorruptFile(_WHERE, f"{count} objects", f"1 to {MAX_OBJECTS}")
        for what, value in (("a surface damping", damping), ("a tolerance in place", tolerance)):
            if not 0 <= value < math.inf:
                raise CorruptFile(_WHERE, f"{what} of {value!r}", "finite, 0 or more")
        return cls(count, damping, tolerance)


class ObjectPart(NamedTuple):
    """Share of one object in a segment, not decoded yet; `fields` is None for a rigid one."""

    poses: bytes
    fields: bytes | None


class SegmentParts(NamedTuple):
    """The body of a segment; `worst` is None where nothing is promised of the composed field."""

    worst: Worst | None
    objects: list[ObjectPart]

    def to_bytes(self) -> bytes:
        """The worst voxel, its ratio rounded up to 1/65535, and each object's chunks."""
        _, frame, voxel = self.worst or (0.0, 0, (0, 0, 0))
        numbers = [1 + self.worst.rounded_up, frame, *voxel] if self.worst else [0]
        chunks = [chunk(data) for part in self.objects for data in part if data is not None]
        return b"".join([*map(write_varint, numbers), *chunks])

    @classmethod
    def from_bytes(cls, body: bytes, is_deforming: Sequence[bool]) -> SegmentParts:
        """The inverse of `to_bytes`; nothing is decoded.

        TruncatedFile or CorruptFile if the bytes end too early, or some are left over.
        """
        read, worst = Parts(body), None
        if ratio := read.varint("worst ratio", RATIO_STEPS + 2):
            frame = read.varint("worst frame", 1 << 16)
            x, y, z = (read.varint("worst voxel", _MOST_SAMPLES) for _ in range(3))
            worst = Worst((ratio - 1) / RATIO_STEPS, frame, (x, y, z))
        parts = []
        for i, deforms in enumerate(is_deforming):
            poses = read.chunk(f"poses of object {i}")
            parts.append(ObjectPart(poses, read.chunk(f"fields of object {i}") if deforms else None))
        read.check_end("object")
        return cls(worst, parts)


BOUNDED_MODES: Final = ("mask", "lossless")
"""Modes of the fields in which the largest error of the composed field is known."""


def composed_rule(modes: Iterable[str], masked: BoundRule, parameters: Parameters) -> BoundRule:
    """What is guaranteed of the composed field, its fields being coded in these modes.

    `masked` is the rule of the mask by the k and F_0 of the file.
    """
    every = set(modes)
    for mode in sorted(every - set(BOUNDED_MODES)):
        mend = "take --mode mask" + (" or --representation voxel" if mode != "nmse" else "")
        return BoundRule(None, f"mode {mode} bounds no force that several bodies have together; {mend}")
    exact = every == {"lossless"} and not parameters.surface_damping_n_s_per_m
    own = "every force of every body bit for bit" if exact else masked.text
    return BoundRule(f"{own}, with every body within {1e6 * parameters.place_tolerance_m:g} um of its place")


_PLACE = "touchfield.codec.objects"

CODER = Coder("objects", f"{_PLACE}.encoder:ObjectsEncoder", f"{_PLACE}.decoder:ObjectsDecoder")
