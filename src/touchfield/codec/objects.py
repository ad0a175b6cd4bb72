"""The coder `objects`: the object source model of figure 4 (paper section 4.3).

"If a model is adopted that describes a scene as several objects, then the parameters will be force vectors that
correspond to each specific object." A rigid object costs one field, coded by `touch` or `paper`, and a pose for each
frame; one that deforms costs a field for each frame. Empty space costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from touchfield.codec.object_steps import object_steps
from touchfield.codec.objects_format import (
    MAX_OBJECTS,
    MAX_POSES,
    CodedObject,
    ObjectPart,
    read_parameters,
    read_parts,
    write_parameters,
    write_parts,
)
from touchfield.codec.paper import PaperEncoder
from touchfield.codec.paper_format import FrameStats
from touchfield.codec.paper_spec import PaperSpec
from touchfield.codec.pose_track import PoseSteps, decode_poses, encode_poses
from touchfield.codec.registry import FieldDecoder, field_decoder
from touchfield.codec.segment_length import segment_length
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.measure.rate import BitAccount

if TYPE_CHECKING:
    from touchfield.codec.paper_encoder import CodedSegment
    from touchfield.codec.paper_format import FrameCost
    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.medium import ForceField, Grid, HapticObject, HapticScene, PoseTrack

__all__ = ["ObjectsAccount", "ObjectsDecoder", "ObjectsEncoder", "check_pose_count"]

NAME: Final = "objects"

_RIGID_SEGMENT_FRAMES: Final = 2048
"""Where no object deforms: poses alone are small, and each segment begins its predictions anew."""


@dataclass(frozen=True)
class ObjectsAccount:
    """What a stream of objects costs.

    Attributes
    ----------
    poses : int
        Bits of poses.
    fields : BitAccount
        Bits of the objects' fields, and of the lengths of chunks.
    supported : int
        Samples with a force among the coded fields: those of a rigid object count once.
    """

    poses: int = 0
    fields: BitAccount = field(default_factory=BitAccount)
    supported: int = 0

    @property
    def bits(self) -> BitAccount:
        """All bits by kind."""
        return self.fields + BitAccount(poses=self.poses)

    @property
    def total(self) -> int:
        """All bits."""
        return self.bits.total

    def __add__(self, other: ObjectsAccount) -> ObjectsAccount:
        return ObjectsAccount(self.poses + other.poses, self.fields + other.fields, self.supported + other.supported)


def check_pose_count(object_count: int, frame_count: int) -> None:
    """InvalidArgument where a scene has more objects or poses than a file may hold."""
    if object_count > MAX_OBJECTS:
        raise InvalidArgument("haptic scene", f"{object_count} objects", f"at most {MAX_OBJECTS}")
    if object_count * frame_count > MAX_POSES:
        found = f"{frame_count} frames of {object_count} objects"
        raise InvalidArgument("haptic scene", found, f"at most {MAX_POSES} poses", "Take fewer frames or objects.")


class ObjectsEncoder:
    """Codes a haptic scene, one segment after another.

    Parameters
    ----------
    scene : HapticScene
    spec : PaperSpec or TouchSpec
        How the fields are coded, and by which coder.
    f0_n : float
        F_0, newtons: poses are quantised so that no force changes by more than half of it. For a rigid object this
        is said of its decoded field, for one that deforms of its fields before they are coded; and of the surface
        damping, which begins at once where a force begins, wherever both have a force.

    Attributes
    ----------
    account : ObjectsAccount
        What all that was made so far costs.

    Raises
    ------
    InvalidArgument
        If the scene has more objects or poses than a file may hold.
    """

    name = NAME

    def __init__(self, scene: HapticScene, spec: PaperSpec | TouchSpec, f0_n: float) -> None:
        check_pose_count(len(scene.objects), scene.frame_count)
        self._scene, self._spec, self._f0_n = scene, spec, f0_n
        self._encoders = [_field_encoder(one.medium.grid, spec) for one in scene.objects]
        self._steps: list[PoseSteps | None] = [None] * len(scene.objects)
        self.account = ObjectsAccount()

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters`: the number of objects and the surface damping."""
        return write_parameters(len(self._scene.objects), self._scene.surface_damping_n_s_per_m)

    def objects(self) -> Iterator[CodedObject]:
        """What the OBJT records hold, one object after another."""
        for i, one in enumerate(self._scene.objects):
            coded = self._rigid(i) if one.is_rigid else None
            self._steps[i] = self._chosen_steps(i, coded)
            if coded is not None:
                self.account += _of_segment(coded.body, coded.frames)
            yield CodedObject(
                name=one.name,
                grid=one.medium.grid,
                is_deforming=not one.is_rigid,
                field_coder=self._encoders[i].name,
                field_parameters=self._encoders[i].parameters,
                pose_steps=self._steps_of(i).to_bytes(),
                field=b"" if coded is None else coded.body,
            )

    def segments(self) -> Iterator[tuple[int, int]]:
        """First and last + 1 frame of each segment: many where all objects are rigid, otherwise as `spec` says."""
        rigid = all(one.is_rigid for one in self._scene.objects)
        step = _RIGID_SEGMENT_FRAMES if rigid else segment_length(self._spec.segment_frames, self._scene.rate_hz)
        for start in range(0, self._scene.frame_count, step):
            yield start, min(start + step, self._scene.frame_count)

    def encode_segment(self, start: int, stop: int) -> bytes:
        """Frames start to stop - 1 as the body of a segment; the fields of objects that deform are held meanwhile."""
        return write_parts(self._part(i, one, start, stop) for i, one in enumerate(self._scene.objects))

    def _part(self, i: int, one: HapticObject, start: int, stop: int) -> ObjectPart:
        poses = encode_poses(one.track.between(start, stop), self._steps_of(i))
        coded = None
        if not one.is_rigid:
            coded = self._encoders[i].encode_segment([one.field(frame) for frame in range(start, stop)])
        part = ObjectPart(poses, None if coded is None else coded.body)
        account = ObjectsAccount(8 * len(poses))
        if coded is not None:
            account += _of_segment(coded.body, coded.frames)
        lengths = BitAccount(side=8 * len(write_parts([part])) - account.total)
        self.account += account + ObjectsAccount(fields=lengths)
        return part

    def _rigid(self, i: int) -> CodedSegment:
        return self._encoders[i].encode_segment([self._scene.objects[i].field(0)])

    def _steps_of(self, i: int) -> PoseSteps:
        steps = self._steps[i]
        if steps is None:
            steps = self._chosen_steps(i, self._rigid(i) if self._scene.objects[i].is_rigid else None)
            self._steps[i] = steps
        return steps

    def _chosen_steps(self, i: int, coded: CodedSegment | None) -> PoseSteps:
        """The steps that keep the mask; poses of the field that a receiver will have, where that is known."""
        one, scene = self._scene.objects[i], self._scene
        fields: Iterable[ForceField] = one.medium
        if coded is not None:
            encoder = self._encoders[i]
            decoder = field_decoder(encoder.name, one.medium.grid, encoder.parameters)
            fields = [_only(decoder.frames(coded.body, 1))]
        return object_steps(one.track, fields, self._f0_n, scene.surface_damping_n_s_per_m, scene.rate_hz)


def _field_encoder(grid: Grid, spec: PaperSpec | TouchSpec) -> PaperEncoder | TouchEncoder:
    return PaperEncoder(grid, spec) if isinstance(spec, PaperSpec) else TouchEncoder(grid, spec)


def _only(frames: Iterator[ForceField]) -> ForceField:
    """The one frame of a segment, read to the end of its body."""
    (frame,) = frames
    return frame


def _of_segment(body: bytes, costs: Sequence[FrameStats] | Sequence[FrameCost]) -> ObjectsAccount:
    """What a segment of fields costs; the lengths and tables that belong to no frame are side bits."""
    bits = sum((c.bits for c in costs), BitAccount())
    bits += BitAccount(side=8 * len(body) - bits.total)
    return ObjectsAccount(fields=bits, supported=sum(c.supported for c in costs if isinstance(c, FrameStats)))


class ObjectsDecoder:
    """Decodes segments of one stream of objects; needs nothing but the stream.

    Parameters
    ----------
    parameters : bytes
        `HEAD.coder_parameters`.
    objects : sequence of CodedObject
        What the OBJT records hold, in their order.

    Attributes
    ----------
    surface_damping_n_s_per_m : float

    Raises
    ------
    CorruptFile
        If there are more or fewer objects than the parameters say, or one of them contradicts itself.
    UnsupportedVersion
        If the coder of a field is unknown.
    """

    name = NAME

    def __init__(self, parameters: bytes, objects: Sequence[CodedObject]) -> None:
        count, self.surface_damping_n_s_per_m = read_parameters(parameters)
        if count != len(objects):
            raise CorruptFile("OBJT records", str(len(objects)), f"{count}, as HEAD.coder_parameters says")
        self.objects = tuple(objects)
        for i, one in enumerate(self.objects):
            if one.is_deforming and one.field:
                raise CorruptFile(f"OBJT {i} field", f"{len(one.field)} bytes", "none, as the object deforms")
        self._latest: tuple[bytes, list[ObjectPart]] | None = None
        self._steps = [
            PoseSteps.from_bytes(one.pose_steps, f"OBJT {i} pose_steps") for i, one in enumerate(self.objects)
        ]
        self._fields: list[FieldDecoder] = [
            field_decoder(one.field_coder, one.grid, one.field_parameters, f"OBJT {i}")
            for i, one in enumerate(self.objects)
        ]

    def parts(self, body: bytes) -> list[ObjectPart]:
        """What the body of a segment holds of each object, not decoded yet; of the latest body they are kept."""
        latest = self._latest  # each of thousands of objects asks for the same body, and other threads for another
        if latest is None or latest[0] is not body:
            self._latest = latest = body, read_parts(body, [one.is_deforming for one in self.objects])
        return latest[1]

    def tracks(self, body: bytes, frame_count: int) -> tuple[PoseTrack, ...]:
        """The poses of each object in the frames of a segment.

        Raises
        ------
        CorruptFile, TruncatedFile
            If the bytes are not what the encoder writes.
        """
        return tuple(
            decode_poses(part.poses, frame_count, steps, f"SEGM.body poses of object {i}")
            for i, (part, steps) in enumerate(zip(self.parts(body), self._steps, strict=True))
        )

    def rigid_field(self, index: int) -> ForceField:
        """The field of a rigid object, decoded now."""
        return _only(self._fields[index].frames(self.objects[index].field, 1))

    def fields(self, body: bytes, index: int, frame_count: int) -> Iterator[ForceField]:
        """The fields of an object that deforms in the frames of a segment, one after another."""
        coded = self.parts(body)[index].fields
        if coded is None:
            raise InvalidArgument("object", f"{index}, which is rigid", "one that deforms")
        return self._fields[index].frames(coded, frame_count)

    def object_cost(self, index: int) -> ObjectsAccount:
        """What the field of an object in its OBJT record costs, and how many samples it holds."""
        one = self.objects[index]
        if one.is_deforming:
            return ObjectsAccount()
        return _of_segment(one.field, self._fields[index].stats(one.field, 1))

    def cost(self, body: bytes, frame_count: int) -> ObjectsAccount:
        """What a segment costs, without decoding it; its supported samples are not counted."""
        parts = self.parts(body)
        poses = 8 * sum(len(part.poses) for part in parts)
        account = ObjectsAccount(poses)
        for decoder, part in zip(self._fields, parts, strict=True):
            if part.fields is not None:
                account += _of_segment(part.fields, decoder.costs(part.fields, frame_count))
        return account + ObjectsAccount(fields=BitAccount(side=8 * len(body) - account.total))

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
