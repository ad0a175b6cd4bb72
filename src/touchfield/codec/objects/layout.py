"""Writes and reads the byte layout of coder `objects`: the record of each body, and the poses and fields in
each segment. It also registers the coder."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from touchfield.codec.registry import Coder
from touchfield.codec.segment import RATIO_STEPS, BoundRule, MaxError
from touchfield.codec.varint import Parts, chunk, write_varint
from touchfield.errors import CorruptFile
from touchfield.medium import Grid

NAME: Final = "objects"

MAX_FRAMES: Final = (1 << 16) - 1  # of a segment
MAX_OBJECTS: Final = 4096  # objects of a scene
_PARAMETERS: Final = struct.Struct("<Idd")
_WHERE: Final = "HEAD.coder_parameters"
_MAX_AXIS_SAMPLES: Final = 1 << 20


@dataclass(frozen=True)
class CodedObject:
    """Contents of an OBJT record.

    `grid` is the object's own lattice; `field` is empty if the object deforms.
    """

    name: str
    grid: Grid
    is_deforming: bool
    field_coder: str
    field_parameters: bytes
    pose_steps: bytes
    field: bytes


class Parameters(NamedTuple):
    """Fields of `HEAD.coder_parameters`.

    They are the number of objects, the surface damping in N s/m, and the tolerance in place in metres (0 if
    unknown).
    """

    object_count: int
    surface_damping_n_s_per_m: float
    place_tolerance_m: float

    def to_bytes(self) -> bytes:
        """The parameters as 20 bytes."""
        return _PARAMETERS.pack(*self)

    @classmethod
    def from_bytes(cls, data: bytes) -> Parameters:
        """The inverse of `to_bytes`; CorruptFile if a number is out of bounds."""
        if len(data) != _PARAMETERS.size:
            raise CorruptFile(_WHERE, f"{len(data)} bytes", f"{_PARAMETERS.size} bytes")
        count, damping, tolerance = _PARAMETERS.unpack(data)
        if not 1 <= count <= MAX_OBJECTS:
            raise CorruptFile(_WHERE, f"{count} objects", f"1 to {MAX_OBJECTS}")
        for quantity, value in (("a surface damping", damping), ("a tolerance in place", tolerance)):
            if not 0 <= value < math.inf:
                raise CorruptFile(_WHERE, f"{quantity} of {value!r}", "finite, 0 or more")
        return cls(count, damping, tolerance)


class ObjectPart(NamedTuple):
    """Undecoded chunks of one object in a segment; `fields` is None for a rigid one."""

    poses: bytes
    fields: bytes | None


class SegmentParts(NamedTuple):
    """The body of a segment.

    `max_error` is None if the composed field has no error bound.
    """

    max_error: MaxError | None
    objects: list[ObjectPart]

    def to_bytes(self) -> bytes:
        """The bytes of the largest error and of each object's chunks.

        The ratio of the largest error is rounded up to a multiple of 1/65535.
        """
        _, frame, voxel = self.max_error or (0.0, 0, (0, 0, 0))
        numbers = [1 + self.max_error.rounded_up, frame, *voxel] if self.max_error else [0]
        chunks = [chunk(data) for part in self.objects for data in part if data is not None]
        return b"".join([*map(write_varint, numbers), *chunks])

    @classmethod
    def from_bytes(
        cls, body: bytes, is_deforming: Sequence[bool], frame_count: int = MAX_FRAMES
    ) -> SegmentParts:
        """The inverse of `to_bytes`, without decoding the chunks.

        The largest error lies in one of `frame_count` frames. `is_deforming` tells for each object whether it
        has a chunk of fields. TruncatedFile or CorruptFile if the bytes end too early, or some remain.
        """
        reader, max_error = Parts(body), None
        if ratio := reader.varint("worst ratio", RATIO_STEPS + 2):
            frame = reader.varint("worst frame", frame_count)
            x, y, z = (reader.varint("worst voxel", _MAX_AXIS_SAMPLES) for _ in range(3))
            max_error = MaxError((ratio - 1) / RATIO_STEPS, frame, (x, y, z))
        parts = []
        for i, deforms in enumerate(is_deforming):
            poses = reader.chunk(f"poses of object {i}")
            parts.append(ObjectPart(poses, reader.chunk(f"fields of object {i}") if deforms else None))
        reader.check_end("object")
        return cls(max_error, parts)


BOUNDED_MODES: Final = ("mask", "lossless")
"""Modes of the fields in which the largest error of the composed field is known."""


def composed_rule(modes: Iterable[str], masked: BoundRule, parameters: Parameters) -> BoundRule:
    """Error bound of the composed field of bodies whose fields are coded in `modes`.

    `masked` is the bound of mode "mask" with the k and F_0 of the file.
    """
    all_modes = set(modes)
    for mode in sorted(all_modes - set(BOUNDED_MODES)):
        mend = "take --mode mask" + (" or --representation voxel" if mode != "nmse" else "")
        return BoundRule(None, f"mode {mode} bounds no force that several bodies have together; {mend}")
    exact = all_modes == {"lossless"} and not parameters.surface_damping_n_s_per_m
    bound = "every force of every body bit for bit" if exact else masked.text
    return BoundRule(
        f"{bound}, with every body within {1e6 * parameters.place_tolerance_m:g} um of its place"
    )


_PACKAGE = "touchfield.codec.objects"

CODER = Coder("objects", f"{_PACKAGE}.encoder:ObjectsEncoder", f"{_PACKAGE}.decoder:ObjectsDecoder")
