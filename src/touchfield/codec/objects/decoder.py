"""The decoder of the coder `objects`: poses of all bodies in a segment, and their fields when asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from touchfield.codec.objects.layout import NAME, CodedObject, Parameters, SegmentParts
from touchfield.codec.objects.poses import PoseSteps, decode_poses
from touchfield.codec.rate import BitAccount
from touchfield.codec.registry import FieldDecoder, field_decoder
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, PoseTrack


class ObjectsDecoder:
    """Decodes segments of one stream of objects; needs nothing but the stream.

    `parameters`: `HEAD.coder_parameters`, whose damping and tolerance in place become attributes. `objects`: what the
    OBJT records hold, in their order. CorruptFile if there are more or fewer objects than the parameters say, or one
    of them contradicts itself. UnsupportedVersion if the coder of a field is unknown.
    """

    name = NAME

    def __init__(self, parameters: bytes, objects: Sequence[CodedObject]) -> None:
        count, self.surface_damping_n_s_per_m, self.place_tolerance_m = Parameters.from_bytes(parameters)
        if count != len(objects):
            raise CorruptFile("OBJT records", str(len(objects)), f"{count}, as HEAD.coder_parameters says")
        self.objects = tuple(objects)
        for i, one in enumerate(self.objects):
            if one.is_deforming and one.field:
                raise CorruptFile(f"OBJT {i} field", f"{len(one.field)} bytes", "none, as the object deforms")
        self._latest: tuple[bytes, SegmentParts] | None = None
        self._steps = [
            PoseSteps.from_bytes(one.pose_steps, f"OBJT {i} pose_steps") for i, one in enumerate(self.objects)
        ]
        self.field_decoders: list[FieldDecoder] = [
            field_decoder(one.field_coder, one.grid, one.field_parameters, f"OBJT {i}")
            for i, one in enumerate(self.objects)
        ]

    def parts(self, body: bytes) -> SegmentParts:
        """Parts of a segment's body, not decoded yet; those of the latest body are kept."""
        latest = self._latest  # each of thousands of objects asks for the same body, and other threads for another
        if latest is None or latest[0] is not body:
            self._latest = latest = body, SegmentParts.from_bytes(body, [one.is_deforming for one in self.objects])
        return latest[1]

    def tracks(self, body: bytes, frame_count: int) -> tuple[PoseTrack, ...]:
        """The poses of each object in a segment; CorruptFile or TruncatedFile for other bytes than the encoder's."""
        worst, parts = self.parts(body)
        if worst is not None and worst.frame >= frame_count:
            raise CorruptFile("SEGM.body worst frame", str(worst.frame), f"below {frame_count}")
        return tuple(
            decode_poses(part.poses, frame_count, steps, f"SEGM.body poses of object {i}")
            for i, (part, steps) in enumerate(zip(parts, self._steps, strict=True))
        )

    def rigid_field(self, index: int) -> ForceField:
        """The field of a rigid object, decoded now."""
        (only,) = self.field_decoders[index].frames(self.objects[index].field, 1)
        return only

    def fields(self, body: bytes, index: int, frame_count: int) -> Iterator[ForceField]:
        """The fields of an object that deforms in the frames of a segment, one after another."""
        coded = self.parts(body).objects[index].fields
        if coded is None:
            raise InvalidArgument("object", f"{index}, which is rigid", "one that deforms")
        return self.field_decoders[index].frames(coded, frame_count)

    def object_cost(self, index: int) -> BitAccount:
        """Cost of the field of an object in its OBJT record."""
        one = self.objects[index]
        return BitAccount() if one.is_deforming else self._field_cost(index, one.field, 1)

    def cost(self, body: bytes, frame_count: int) -> BitAccount:
        """Cost of a segment, without decoding it."""
        parts = self.parts(body).objects
        bits = BitAccount(poses=8 * sum(len(part.poses) for part in parts))
        for i, part in enumerate(parts):
            if part.fields is not None:
                bits += self._field_cost(i, part.fields, frame_count)
        return bits + BitAccount(side=8 * len(body) - bits.total)

    def _field_cost(self, index: int, coded: bytes, frame_count: int) -> BitAccount:
        """The lengths and tables that belong to no frame are side bits."""
        bits = sum((c.bits for c in self.field_decoders[index].costs(coded, frame_count)), BitAccount())
        return bits + BitAccount(side=8 * len(coded) - bits.total)

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        deforming = sum(one.is_deforming for one in self.objects)
        return {
            "objects": len(self.objects),
            "deforming_objects": deforming,
            "object_names": [one.name for one in self.objects],
            "surface_damping_n_s_per_m": self.surface_damping_n_s_per_m,
            "field_coders": sorted({one.field_coder for one in self.objects}),
        }
