"""Gives programs a live stream of rigid bodies as a scene: their fields are in the opening, and each segment
has only their poses (coder `objects`).

A segment is complete in itself: the velocities of its bodies are those of its own poses, one-sided at its
first and last frame. In a frame that did not arrive no body has a force.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final, NamedTuple

from numpy.typing import ArrayLike

from touchfield.arrays import Float32s
from touchfield.codec.objects.decoder import ObjectsDecoder
from touchfield.codec.objects.layout import NAME
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.medium import BodyPoses
from touchfield.network.live import ENDLESS, LiveSegment, Opened
from touchfield.network.live_medium import LiveFrames
from touchfield.pipeline.decoded_objects import coded_object

MAX_SEGMENT_POSES: Final = 1 << 20
"""Maximum number of bodies times frames in a segment; their poses take 112 MB."""

MAX_FIELD_BYTES: Final = 1 << 30
"""Maximum size of the fields of all bodies in memory: an opening of some bytes may hold many empty bricks."""


def live_frames(
    opened: Opened, report: Callable[[str], None] = lambda note: None, coarse: LiveFrames | None = None
) -> LiveFrames:
    """Return the frames of a programme, by its coder; see `LiveFrames`."""
    if opened.head.coder != NAME:
        return LiveFrames(opened, report, coarse=coarse)
    if coarse is not None:
        raise InvalidArgument("coarse", "a layer of a stream of bodies", "a layer of a stream of fields")
    return LivePoses(opened, report)


class _Frame(NamedTuple):
    """A frame of a segment: the scene of the segment, and the number of the frame in it."""

    scene: HapticScene
    number: int


class LivePoses(LiveFrames):
    """Frames of a live stream of rigid bodies; see `LiveFrames`.

    ``frames(i)`` returns the composed field of frame i, and ``frames.poses(i)`` the poses of its bodies.

    Raises FormatError if the bodies cannot be decoded, or are too large; UnsupportedVersion if one deforms.
    """

    _latest_poses: BodyPoses | None

    def _open_decoder(self) -> None:
        head, self._latest_poses = self.opened.head, None
        self._objects = ObjectsDecoder(head.coder_parameters, list(map(coded_object, self.opened.objects)))
        for body in self._objects.objects:
            if body.is_deforming:
                raise UnsupportedVersion("live stream", f"{body.name}, a body that deforms", "rigid bodies")
        self._fields, size = list[ForceField](), 0
        for i in range(len(self._objects.objects)):
            self._fields.append(self._objects.rigid_field(i))
            size += self._fields[-1].forces_n.nbytes
            if size > MAX_FIELD_BYTES:
                found = f"bodies whose fields take more than {size >> 20} MiB"
                raise CorruptFile("live stream", found, f"at most {MAX_FIELD_BYTES >> 20} MiB")
        self._opening_bytes = sum(len(body.field) for body in self._objects.objects)

    def _decoded(self, segment: LiveSegment) -> Iterator[Any]:
        if segment.frame_count * len(self._fields) > MAX_SEGMENT_POSES:
            found = f"{segment.frame_count} frames of {len(self._fields)} bodies"
            raise CorruptFile("segment", found, f"at most {MAX_SEGMENT_POSES} poses")
        tracks = self._objects.tracks(segment.body, segment.frame_count)
        scene = self._scene_of(tracks, self._opening_bytes + len(segment.body))
        return (_Frame(scene, i) for i in range(segment.frame_count))

    def _scene_of(self, tracks: tuple[PoseTrack, ...], file_bytes: int | None) -> HapticScene:
        head = self.opened.head
        bodies = zip(self._objects.objects, self._fields, tracks, strict=True)
        return HapticScene(
            self.grid,
            head.rate_hz,
            tuple(
                HapticObject(coded.name, HapticMedium.from_frames([body], head.rate_hz), track)
                for coded, body, track in bodies
            ),
            head.force_max_n,
            self._objects.surface_damping_n_s_per_m,
            head.axes,
            head.friction,
            head.damping_n_s_per_m,
            head.tags,
            self.opened.provenance,
            file_bytes,
        )

    @cached_property
    def scene(self) -> LiveScene:
        """The bodies, in frames that arrive."""
        at_start = self._scene_of((PoseTrack.constant(),) * len(self._fields), None)
        return LiveScene(**vars(at_start), frames=self)

    def _find(self, index: int) -> _Frame | None:
        """Wait for a frame; None if it is lost. See `LiveFrames.__call__` for errors."""
        frame, segment = self._find_frame(index)
        self._note_part(index, frame, segment, None)
        return None if segment is None else segment.fields[frame - segment.first]

    def __call__(self, index: int) -> ForceField:
        found = self._find(index)
        return ForceField.empty(self.grid) if found is None else found.scene.voxelise()[found.number]

    def poses(self, index: int) -> BodyPoses:
        """Wait for a frame and return its poses; those of a lost frame are absent."""
        found = self._find(index)
        if found is not None:
            self._latest_poses = found.scene.poses(found.number)
            return self._latest_poses
        return (self._latest_poses or self.scene.at_rest)._replace(is_absent=True)

    def sample_n(self, index: int, positions_m: ArrayLike) -> Float32s:
        """Wait for a frame and return its force at points; see `HapticScene.sample_n`."""
        found = self._find(index)
        if found is None:
            return ForceField.empty(self.grid).sample_n(positions_m)
        return found.scene.sample_n(found.number, positions_m)


@dataclass(frozen=True)
class LiveScene(HapticScene):
    """Rigid bodies of a live stream. Access to a frame waits until it has arrived.

    The tracks of `objects` are empty of motion; `poses` returns those that arrived.
    """

    frames: LivePoses = field(kw_only=True)

    has_gaps: ClassVar[bool] = True

    @property
    def frame_count(self) -> int:
        """Number of frames, which has no meaning in a stream without end."""
        return ENDLESS

    @property
    def at_rest(self) -> BodyPoses:
        """Poses before the first frame."""
        return super().poses(0)

    def poses(self, frame: int) -> BodyPoses:
        """See `LivePoses.poses`."""
        return self.frames.poses(frame)

    def is_there(self, frame: int) -> bool:
        """See `LiveFrames.is_there`."""
        return self.frames.is_there(frame)

    def is_seam(self, frame: int) -> bool:
        """See `LiveFrames.is_seam`."""
        return self.frames.is_seam(frame)

    def sample_n(self, frame: int, positions_m: ArrayLike) -> Float32s:
        """See `LivePoses.sample_n`."""
        return self.frames.sample_n(frame, positions_m)

    def between(self, start: int, stop: int) -> HapticScene:
        """Raise InvalidArgument: the poses of later frames are not known."""
        raise InvalidArgument("frames", f"{start}:{stop} of a live stream", "frames of a file")

    def voxelise(self, grid: Grid | None = None) -> HapticMedium:
        """See `HapticScene.voxelise`; a frame waits until it has arrived."""
        if grid not in (None, self.grid):
            raise InvalidArgument("grid", "another lattice of a live stream", "its own")
        metadata = self.axes, self.friction, self.damping_n_s_per_m, self.tags, self.provenance
        return HapticMedium(self.grid, self.rate_hz, ENDLESS, self.frames, *metadata)
