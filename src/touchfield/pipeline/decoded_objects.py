"""Opens a file of coder `objects` as a scene of moving bodies. Poses are decoded at once, the field of a body
when it is first needed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, cached_property, lru_cache, partial, wraps
from typing import Any, Concatenate, Final, ParamSpec, TypeVar

import numpy as np

from touchfield.arrays import Float64s
from touchfield.codec.objects.decoder import ObjectsDecoder
from touchfield.codec.objects.layout import CodedObject, Parameters, composed_rule
from touchfield.codec.registry import coder, field_decoder
from touchfield.codec.segment import BitAccount, BoundRule, mask_text, max_error_keys
from touchfield.container import ObjectRecord, TouchReader
from touchfield.errors import CorruptFile, naming_file
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.budget import require_memory
from touchfield.medium.pose_track import MAX_POSES
from touchfield.pipeline.decoded_frames import SegmentFrames, segment_layout
from touchfield.pipeline.stream import OpenStream

_BYTES_PER_POSE: Final = 7 * 8
"""Seven float64. What the tracks of single segments and of a single object take is small beside them."""


def coded_object(record: ObjectRecord) -> CodedObject:
    """An object of the container; the inverse of `touchfield.pipeline.encoding.record_of`."""
    values = {**vars(record), "is_deforming": bool(record.is_deforming)}
    return CodedObject(
        grid=Grid(values.pop("grid_shape"), values.pop("spacing_m"), values.pop("origin_m")), **values
    )


_P = ParamSpec("_P")
_T = TypeVar("_T")


def _naming_its_file(
    method: Callable[Concatenate[SceneStream, _P], _T],
) -> Callable[Concatenate[SceneStream, _P], _T]:
    """A method of a stream whose errors name the file."""

    @wraps(method)
    def call(self: SceneStream, /, *arguments: _P.args, **named: _P.kwargs) -> _T:
        with naming_file(self.reader.name):
            return method(self, *arguments, **named)

    return call


class SceneStream(OpenStream):
    """A file of coder `objects`; a voxel frame takes one query of the scene for each voxel near an object.

    The file must stay open while fields of deforming objects are read.

    Raises FormatError if its bytes are inconsistent; InvalidArgument if its poses would take more memory than
    `memory_budget_bytes`.
    """

    def __init__(self, reader: TouchReader) -> None:
        super().__init__(reader)
        head = reader.head
        poses = reader.object_count * head.frame_count
        if poses > MAX_POSES:
            count = f"{head.frame_count} frames of {reader.object_count} objects"
            raise CorruptFile("HEAD.frame_count", count, f"at most {MAX_POSES} poses")
        where, size = f"{reader.name}: HEAD.frame_count", poses * _BYTES_PER_POSE
        require_memory(where, "poses", size, "Set TOUCHFIELD_MEMORY_GIB.")
        objects = [coded_object(reader.read_object(i)) for i in range(reader.object_count)]
        self.decoder = ObjectsDecoder(head.coder_parameters, objects)
        self._body = lru_cache(1)(reader.read_segment)  # every deforming object reads it

    @cached_property
    @_naming_its_file
    def tracks(self) -> tuple[PoseTrack, ...]:
        """The poses of each object in all frames; reads every segment once."""
        frame_count = sum(entry.frame_count for entry in self.reader.segments)
        poses, start = list[Float64s](), 0
        for i, entry in enumerate(self.reader.segments):
            segment = self.decoder.tracks(self.reader.read_segment(i), entry.frame_count)
            if not poses:  # not before a segment has proved to be sound
                poses = [np.empty((frame_count, 7)) for _ in segment]
            stop = start + entry.frame_count
            for joined, track in zip(poses, segment, strict=True):
                joined[start:stop, :4], joined[start:stop, 4:] = track.quaternions, track.positions_m
            start = stop
        tracks = list[PoseTrack]()
        while poses:  # each is freed when its track has a copy
            joined = poses.pop()
            tracks.append(PoseTrack(joined[:, :4], joined[:, 4:]))
        return tuple(reversed(tracks))

    @cached_property
    def scene(self) -> HapticScene:
        """The decoded scene: poses now, the field of an object on first access."""
        return HapticScene(
            grid=self.grid,
            objects=tuple(
                HapticObject(coded.name, self._medium(i, coded), track)
                for i, (coded, track) in enumerate(zip(self.decoder.objects, self.tracks, strict=True))
            ),
            force_max_n=self.reader.head.force_max_n,
            surface_damping_n_s_per_m=self.decoder.surface_damping_n_s_per_m,
            file_bytes=self.file_bytes,
            **self._metadata,
        )

    @property
    def medium(self) -> HapticMedium:
        return replace(self.scene.voxelise(), vibration=self._vibration)

    @cached_property
    @_naming_its_file
    def bits(self) -> BitAccount:
        """See `OpenStream`: of the objects and of all segments; decodes nothing."""
        costs = [self.decoder.object_cost(i) for i in range(self.reader.object_count)]
        for i, entry in enumerate(self.reader.segments):
            costs.append(self.decoder.cost(self.reader.read_segment(i), entry.frame_count))
        return sum(costs, BitAccount())

    def _coder(self) -> dict[str, Any]:
        keys = {
            **self.decoder.describe(),
            "bits_poses": self.bits.poses,
            "bits_fields": self.bits.total - self.bits.poses,
            "frame_kinds": {"object": self.reader.head.frame_count},
        }
        if not self._modes:  # the composed field has no error bound
            return keys
        tolerance_um = 1e6 * self.decoder.place_tolerance_m
        return {**keys, "mode": ", ".join(sorted(self._modes)), "place_tolerance_um": tolerance_um}

    @cached_property
    def _modes(self) -> frozenset[str]:
        """Modes of the fields that have one."""
        described = [decoder.describe() for decoder in self.decoder.field_decoders]
        return frozenset(description["mode"] for description in described if "mode" in description)

    @property
    def bound_rule(self) -> BoundRule:
        """That of the composed field, by the k and F_0 of HEAD; each field keeps a fraction of them."""
        head = self.reader.head
        for coded in self.decoder.objects:
            if not coder(coded.field_coder).has_error_bound:
                return coder(coded.field_coder).bound_rule(None)
        masked = BoundRule(mask_text(head.weber_fraction, head.force_threshold_n))
        return composed_rule(self._modes, masked, Parameters.from_bytes(head.coder_parameters))

    @property
    @_naming_its_file
    def max_error_summary(self) -> dict[str, Any]:
        if not self._modes:
            return {}
        return max_error_keys(
            (entry.first_frame, self.decoder.parts(self._body(i), entry.frame_count).max_error)
            for i, entry in enumerate(self.reader.segments)
        )

    @_naming_its_file
    def _rigid_field(self, index: int, _: int) -> ForceField:
        """The only field of a rigid object."""
        return self.decoder.rigid_field(index)

    @_naming_its_file
    def _medium(self, index: int, coded: CodedObject) -> HapticMedium:
        """The fields of one object."""
        head = self.reader.head
        if not coded.is_deforming:
            return HapticMedium(coded.grid, head.rate_hz, 1, cache(partial(self._rigid_field, index)))

        def decode(segment: int) -> Iterator[ForceField]:
            return self.decoder.fields(self._body(segment), index, self.reader.segments[segment].frame_count)

        coder: Any = field_decoder(coded.field_coder, coded.grid, coded.field_parameters, f"OBJT {index}")
        frames, segments = SegmentFrames(self.reader, decode), segment_layout(self.reader, coder.describe())
        return HapticMedium(coded.grid, head.rate_hz, head.frame_count, frames, segments=segments)
