"""The decoder of the coder `objects`: poses of all bodies in a segment, and their fields when asked for.

The paper's rigid objects need one field and a pose a frame (section 4.3), and it leaves the coding of these
"parameters of the source model" open. Here a pose is seven whole numbers, multiples of two steps; each is
predicted from those before it, and the residuals are whole numbers (docs/format/objects.md).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools, Int64s
from touchfield.codec.kernels import NUMBER_CONTEXTS, NUMBER_SETS, Bits, code_numbers, fresh, reader
from touchfield.codec.objects.layout import NAME, CodedObject, Parameters, SegmentParts
from touchfield.codec.registry import FieldDecoder, field_decoder
from touchfield.codec.segment import BitAccount
from touchfield.codec.support import check_end
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium import ForceField, PoseTrack

MOST_POSES: Final = (1 << 16) - 1  # poses in one piece of code; a segment of a file has no more frames
MOST_STEPS: Final = 1 << 50  # of a position; seven of them, as the quadratic predictor adds, stay exact
POSITION_POWERS: Final = (-40, 0)
QUATERNION_POWERS: Final = (-30, -2)
_CHANGED = "The file was changed or cut."


@dataclass(frozen=True)
class PoseSteps:
    """The steps whose multiples a coded track consists of, powers of two; InvalidArgument for others.

    Of positions from 2^-40 to 1 metres, of each component of the quaternion from 2^-30 to 2^-2.
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
        """Two bytes: the exponents of both steps as int8."""
        return struct.pack("bb", *(math.frexp(step)[1] - 1 for step in (self.position_m, self.quaternion)))

    @classmethod
    def from_bytes(cls, data: bytes, where: str = "pose steps") -> PoseSteps:
        """The inverse of `to_bytes`; TruncatedFile or CorruptFile, which call the bytes `where`, if it has
        none.
        """
        if len(data) != 2:
            error = TruncatedFile if len(data) < 2 else CorruptFile
            raise error(where, f"{len(data)} bytes", "2")
        powers = struct.unpack("bb", data)
        for power, (low, high) in zip(powers, (POSITION_POWERS, QUATERNION_POWERS), strict=True):
            if not low <= power <= high:
                raise CorruptFile(where, f"a step of 2^{power}", f"2^{low} to 2^{high}")
        return cls(2.0 ** powers[0], 2.0 ** powers[1])

    @property
    def limits(self) -> Int64s:
        """The largest |number| of each component, int64 [7]."""
        return np.array([MOST_STEPS] * 3 + [round(1 / self.quaternion)] * 4, np.int64)

    def are_units(self, turns: Int64s) -> Bools:
        """True for quaternions int64 [n, 4] within one step of length 1; rounding keeps to it."""
        one = round(1 / self.quaternion)
        squares = (turns * turns).sum(axis=1)
        held: Bools = (squares >= (one - 1) ** 2) & (squares <= (one + 1) ** 2)
        return held

    def track(self, numbers: Int64s) -> PoseTrack:
        """The poses that whole numbers int64 [n, 7] tell."""
        turns = numbers[:, 3:].astype(np.float64)
        unit = turns / np.sqrt((turns * turns).sum(axis=1, keepdims=True))
        return PoseTrack(unit, numbers[:, :3].astype(np.float64) * self.position_m)


# of a predictor: 0 for a number that never changes, 1 the number before, 2 a line, 3 a parabola through those
MOST_ORDER: Final = 3
MODELS: Final = 8 * NUMBER_CONTEXTS, 8 * NUMBER_SETS
"""Of the first pose and the predictors, and of what these leave of each component."""


def code_residuals(bits: Bits, component: int, residuals: Int64s) -> None:
    """Write or read what the predictor of a component leaves, int64 [n]."""
    code_numbers(bits, (1 + component) * NUMBER_CONTEXTS, (1 + component) * NUMBER_SETS, residuals)


def decode_poses(data: bytes, frame_count: int, steps: PoseSteps, where: str = "poses") -> PoseTrack:
    """The track that `encode_poses` has coded.

    `frame_count`: poses that were coded, 1 to `MOST_POSES`; some 120 bytes are taken for each. `where`: what
    to call the bytes in an error. TruncatedFile or CorruptFile if the bytes are not the code of so many
    poses.
    """
    if not 1 <= frame_count <= MOST_POSES:
        raise InvalidArgument("frame_count", repr(frame_count), f"1 to {MOST_POSES}")
    bits = reader(data, fresh(*MODELS))
    head = np.zeros(14, np.int64)
    code_numbers(bits, 0, 0, head)
    orders, numbers = head[:7].tolist(), np.tile(head[7:], (frame_count, 1))
    if not 0 <= min(orders) <= max(orders) <= MOST_ORDER:
        raise CorruptFile(where, f"predictors {orders}", f"0 to {MOST_ORDER} each", _CHANGED)
    for c, order in enumerate(orders):
        column = np.zeros(frame_count, np.int64)
        if order:
            code_residuals(bits, c, column[1:])
        for _ in range(order):
            column = np.cumsum(column)
        numbers[:, c] += column
    check_end(bits, 0, where)
    # a sum that goes round has left the limits before
    if ((numbers > steps.limits) | (numbers < -steps.limits)).any():
        raise CorruptFile(
            where, "a number beyond its limit", "positions to 2^50 steps, quaternions to 1", _CHANGED
        )
    odd = np.flatnonzero(~steps.are_units(numbers[:, 3:]))
    if len(odd):
        found = f"the quaternion {tuple(numbers[odd[0], 3:].tolist())} in steps"
        expected = f"one of length {round(1 / steps.quaternion)} within 1"
        raise CorruptFile(f"{where}, frame {odd[0]}", found, expected, _CHANGED)
    return steps.track(numbers)


class ObjectsDecoder:
    """Decodes segments of one stream of objects; needs nothing but the stream.

    `parameters`: `HEAD.coder_parameters`, whose damping and tolerance in place become attributes. `objects`:
    what the OBJT records hold, in their order. CorruptFile if there are more or fewer objects than the
    parameters say, or one of them contradicts itself. UnsupportedVersion if the coder of a field is unknown.
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
        latest = (
            self._latest
        )  # each of thousands of objects asks for the same body, and other threads for another
        if latest is None or latest[0] is not body:
            self._latest = latest = (
                body,
                SegmentParts.from_bytes(body, [one.is_deforming for one in self.objects]),
            )
        return latest[1]

    def tracks(self, body: bytes, frame_count: int) -> tuple[PoseTrack, ...]:
        """The poses of each object in a segment; CorruptFile or TruncatedFile for other bytes than the
        encoder's.
        """
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
