"""Decodes a scene of bodies (coder `objects`): the poses of a segment, and the fields of bodies on request.

In the paper a rigid object needs one field, and one pose per frame (section 4.3); the paper does not say how
to code these "parameters of the source model". Here a pose is seven whole numbers, multiples of a position
step and a quaternion step. Each number is predicted from those of earlier poses, and the residuals are coded
as whole numbers (docs/format/objects.md).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.objects.layout import MAX_FRAMES, NAME, CodedObject, Parameters, SegmentParts
from touchfield.codec.registry import FieldDecoder, field_decoder
from touchfield.codec.segment import BitAccount
from touchfield.compute.native import decoding_errors, native
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, PoseTrack

MAX_SEGMENT_POSES: Final = MAX_FRAMES  # poses in one code
# largest position in steps; sums of seven, as in the quadratic predictor, stay exact
MAX_STEPS: Final = 1 << 50
POSITION_POWERS: Final = (-40, 0)
QUATERNION_POWERS: Final = (-30, -2)


@dataclass(frozen=True)
class PoseSteps:
    """Quantisation steps of a coded track, powers of two.

    Steps of positions are from 2^-40 to 1 metres, those of quaternion components from 2^-30 to 2^-2;
    InvalidArgument for other numbers.
    """

    position_m: float
    quaternion: float

    def __post_init__(self) -> None:
        for name, (low, high) in (("position_m", POSITION_POWERS), ("quaternion", QUATERNION_POWERS)):
            step = float(getattr(self, name))
            if not (2.0**low <= step <= 2.0**high) or math.frexp(step)[0] != 0.5:
                raise InvalidArgument(
                    f"pose step {name}", repr(step), f"a power of two from 2^{low} to 2^{high}"
                )
            object.__setattr__(self, name, step)

    def to_bytes(self) -> bytes:
        """The exponents of both steps as int8, two bytes."""
        return struct.pack("bb", *(math.frexp(step)[1] - 1 for step in (self.position_m, self.quaternion)))

    @classmethod
    def from_bytes(cls, data: bytes, where: str = "pose steps") -> PoseSteps:
        """The inverse of `to_bytes`.

        CorruptFile, naming `where`, for invalid bytes.
        """
        if len(data) != 2:
            raise CorruptFile(where, f"{len(data)} bytes", "2")
        powers = struct.unpack("bb", data)
        for power, (low, high) in zip(powers, (POSITION_POWERS, QUATERNION_POWERS), strict=True):
            if not low <= power <= high:
                raise CorruptFile(where, f"a step of 2^{power}", f"2^{low} to 2^{high}")
        return cls(2.0 ** powers[0], 2.0 ** powers[1])

    def track(self, numbers: Int64s) -> PoseTrack:
        """The poses of whole numbers int64 [n, 7]."""
        quaternions = numbers[:, 3:].astype(np.float64)
        unit = quaternions / np.sqrt((quaternions * quaternions).sum(axis=1, keepdims=True))
        return PoseTrack(unit, numbers[:, :3].astype(np.float64) * self.position_m)


def decode_poses(data: bytes, frame_count: int, steps: PoseSteps, where: str = "poses") -> PoseTrack:
    """Decode a track of `encode_poses`.

    `frame_count` is the number of poses, 1 to `MAX_SEGMENT_POSES`; each takes some 120 bytes of memory.
    `where` names the bytes in errors. TruncatedFile or CorruptFile if the bytes do not code exactly
    `frame_count` poses.
    """
    if not 1 <= frame_count <= MAX_SEGMENT_POSES:
        raise InvalidArgument("frame_count", repr(frame_count), f"1 to {MAX_SEGMENT_POSES}")
    with decoding_errors(where):
        numbers = native.decode_poses(data, frame_count, round(1 / steps.quaternion))
    return steps.track(np.frombuffer(numbers, np.int64).reshape(-1, 7))


class ObjectsDecoder:
    """Decoder of the segments of one stream of objects, from the stream alone.

    `parameters` is `HEAD.coder_parameters`; its damping and its tolerance in place become attributes.
    `objects` are the contents of the OBJT records, in file order. CorruptFile if the number of objects
    differs from that in the parameters, or an object is inconsistent. UnsupportedVersion if the coder of a
    field is unknown.
    """

    name = NAME

    def __init__(self, parameters: bytes, objects: Sequence[CodedObject]) -> None:
        count, self.surface_damping_n_s_per_m, self.place_tolerance_m = Parameters.from_bytes(parameters)
        if count != len(objects):
            raise CorruptFile("OBJT records", str(len(objects)), f"{count}, as HEAD.coder_parameters says")
        self.objects = tuple(objects)
        self._latest: tuple[bytes, SegmentParts] | None = None
        self._steps, self.field_decoders = list[PoseSteps](), list[FieldDecoder]()
        for i, coded in enumerate(self.objects):  # fields in the order of the record
            self.field_decoders.append(
                field_decoder(coded.field_coder, coded.grid, coded.field_parameters, f"OBJT {i}")
            )
            self._steps.append(PoseSteps.from_bytes(coded.pose_steps, f"OBJT {i} pose_steps"))
            if coded.is_deforming and coded.field:
                found = f"{len(coded.field)} bytes"
                raise CorruptFile(f"OBJT {i} field", found, "none, as the object deforms")

    def parts(self, body: bytes, frame_count: int = MAX_FRAMES) -> SegmentParts:
        """The parts of a segment's body, not decoded yet; the latest body is cached."""
        # thousands of objects request the same body; read once, as other threads may replace it
        latest = self._latest
        if latest is None or latest[0] is not body:
            self._latest = latest = (
                body,
                SegmentParts.from_bytes(body, [coded.is_deforming for coded in self.objects], frame_count),
            )
        return latest[1]

    def tracks(self, body: bytes, frame_count: int) -> tuple[PoseTrack, ...]:
        """Poses of each object in a segment.

        CorruptFile or TruncatedFile if the bytes are invalid.
        """
        parts = self.parts(body, frame_count).objects
        return tuple(
            decode_poses(part.poses, frame_count, steps, f"SEGM.body poses of object {i}")
            for i, (part, steps) in enumerate(zip(parts, self._steps, strict=True))
        )

    def rigid_field(self, index: int) -> ForceField:
        """Decode the field of a rigid object."""
        (field,) = self.field_decoders[index].frames(self.objects[index].field, 1)
        return field

    def fields(self, body: bytes, index: int, frame_count: int) -> Iterator[ForceField]:
        """Yield the fields of a deforming object in the frames of a segment, in order."""
        coded = self.parts(body, frame_count).objects[index].fields
        if coded is None:
            raise InvalidArgument("object", f"{index}, which is rigid", "one that deforms")
        return self.field_decoders[index].frames(coded, frame_count)

    def object_cost(self, index: int) -> BitAccount:
        """Cost of the field of an object in its OBJT record."""
        coded = self.objects[index]
        return BitAccount() if coded.is_deforming else self._field_cost(index, coded.field, 1)

    def cost(self, body: bytes, frame_count: int) -> BitAccount:
        """Cost of a segment, without decoding it."""
        parts = self.parts(body, frame_count).objects
        bits = BitAccount(poses=8 * sum(len(part.poses) for part in parts))
        for i, part in enumerate(parts):
            if part.fields is not None:
                bits += self._field_cost(i, part.fields, frame_count)
        return bits + BitAccount(side=8 * len(body) - bits.total)

    def _field_cost(self, index: int, coded: bytes, frame_count: int) -> BitAccount:
        """Cost of coded fields; lengths and tables that belong to no frame are side bits."""
        bits = sum((c.bits for c in self.field_decoders[index].costs(coded, frame_count)), BitAccount())
        return bits + BitAccount(side=8 * len(coded) - bits.total)

    def describe(self) -> dict[str, Any]:
        """Parameters of the stream, under stable keys."""
        deforming = sum(coded.is_deforming for coded in self.objects)
        return {
            "objects": len(self.objects),
            "deforming_objects": deforming,
            "object_names": [coded.name for coded in self.objects],
            "surface_damping_n_s_per_m": self.surface_damping_n_s_per_m,
            "field_coders": sorted({coded.field_coder for coded in self.objects}),
        }
