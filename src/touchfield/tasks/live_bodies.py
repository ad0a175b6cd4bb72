"""Codes rigid bodies whose poses are not known in advance, for a live stream of coder `objects`: the fields
once, before the stream starts, and the poses of each segment.

A file's fields are coded again until the composed field keeps the error bound in every frame. Here no pose is
known when the fields are sent. The error of each body is therefore at most F_0 / n everywhere, n being the
number of bodies, but at most `MAX_OVERLAP`: whatever the poses, the sum of the errors of n bodies is at most
F_0, and clipping to F_max does not enlarge it. Each segment is checked and states its largest error, as in a
file; one that is outside the bound, since more bodies overlap, states none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.codec.objects import layout
from touchfield.codec.objects.decoder import POSITION_POWERS, QUATERNION_POWERS, PoseSteps
from touchfield.codec.objects.encoder import (
    DAMPING_FRACTION,
    MIN_K,
    PLACE_TOLERANCE_M,
    encode_poses,
    round_poses,
)
from touchfield.codec.objects.error_bound import ComposedRule, Moves, Pair
from touchfield.codec.objects.layout import CodedObject
from touchfield.codec.registry import coder_of_spec, field_decoder, field_encoder
from touchfield.codec.segment import BoundRule, MaxError, mask_text
from touchfield.errors import InvalidArgument
from touchfield.medium import HapticObject, HapticScene, PoseTrack
from touchfield.network.live_scene import MAX_SEGMENT_POSES
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.spec import DEFAULT_F0_N
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.live_simulation import Control

MAX_OVERLAP: Final = 8
"""Bodies that may overlap at a point with the error bound still kept."""

Poses = tuple[Float64s, Float64s]
"""Quaternions (w, x, y, z), float64 [bodies, 4], and positions, metres of the hand, [bodies, 3]."""


@dataclass(frozen=True)
class CodedPoses:
    """The body of a segment, and its largest error; None if it states none, as it is outside the bound."""

    body: bytes
    max_error: MaxError | None


class BodiesEncoder:
    """Encoder of a scene of rigid bodies whose poses come later.

    `spec` and `f0_n` are those of `ObjectsEncoder`. `surface_damping` forces depend on the poses of one
    segment alone. InvalidArgument for other modes than "mask" and "lossless", a body that deforms, or a
    damping whose error no poses keep within F_0.
    """

    name = layout.NAME

    def __init__(self, scene: HapticScene, spec: Any, f0_n: float) -> None:
        if not coder_of_spec(spec).has_error_bound or spec.mode not in layout.BOUNDED_MODES or spec.masking:
            found = "another mode, coder or masking than bodies have"
            raise InvalidArgument("live bodies", found, "--mode mask or lossless, without --masking")
        for body in scene.objects:
            if not body.is_rigid:
                hint = "Add --representation voxel."
                raise InvalidArgument(f"body {body.name}", "a body that deforms", "a rigid one", hint)
        self._scene, self._spec, self._f0_n = scene, spec, f0_n
        self._field_spec = self._spec_of_fields()
        self._steps = [self._pose_steps(body) for body in scene.objects]
        self._coded, self._pairs = list[CodedObject](), list[Pair]()
        for body, steps in zip(scene.objects, self._steps):
            self._encode_field(body, steps)

    def _spec_of_fields(self) -> Any:
        """The options that keep the error of every body within its part of F_0."""
        spec, scene = self._spec, self._scene
        damping = scene.surface_damping_n_s_per_m
        part_n = spec.f0_n * (1 - DAMPING_FRACTION * bool(damping)) / min(len(scene.objects), MAX_OVERLAP)
        k = part_n / scene.force_max_n
        if spec.mode == "lossless" or k < MIN_K:
            return replace(spec, mode="lossless")
        return replace(spec, k=min(k, spec.k), f0_n=part_n, support="exact" if damping else spec.support)

    def _pose_steps(self, body: HapticObject) -> PoseSteps:
        """Steps with which every pose is within the tolerance in place, and every velocity within F_0."""
        field, rate_hz = body.field(0), self._scene.rate_hz
        corners = np.abs(field.grid.to_m(field.positions())) + np.asarray(field.grid.spacing_m)
        reach_m = max(float(np.sqrt((corners * corners).sum(axis=1)).max(initial=0.0)), PLACE_TOLERANCE_M)
        position = math.floor(math.log2(0.4 * PLACE_TOLERANCE_M))  # sqrt(3) / 2 steps: 0.35 of the tolerance
        quaternion = math.floor(math.log2(0.3 * PLACE_TOLERANCE_M / reach_m))  # 2 steps of the reach
        damping, limit_n = self._scene.surface_damping_n_s_per_m, DAMPING_FRACTION * self._f0_n
        while damping * rate_hz * (math.sqrt(3) * 2.0**position + 4 * 2.0**quaternion * reach_m) > limit_n:
            position, quaternion = position - 1, quaternion - 1
        if position < POSITION_POWERS[0] or quaternion < QUATERNION_POWERS[0]:
            found = f"a reach of {reach_m:g} m, and a damping of {damping:g} N s/m at {rate_hz:g} Hz"
            mend = "Take a smaller surface damping, or a body nearer to its origin."
            raise InvalidArgument(f"body {body.name}", found, "steps of 2^-40 m and 2^-30 at least", mend)
        return PoseSteps(2.0**position, 2.0 ** min(quaternion, QUATERNION_POWERS[1]))

    def _encode_field(self, body: HapticObject, steps: PoseSteps) -> None:
        grid, source = body.medium.grid, body.field(0)
        encoder = field_encoder(grid, self._field_spec)
        coded = encoder.encode_segment([source]).body
        decoded = next(field_decoder(encoder.name, grid, encoder.parameters).frames(coded, 1))
        self._pairs.append(Pair(source, decoded))
        self._coded.append(
            CodedObject(body.name, grid, False, encoder.name, encoder.parameters, steps.to_bytes(), coded)
        )

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters`."""
        damping = self._scene.surface_damping_n_s_per_m
        return layout.Parameters(len(self._coded), damping, PLACE_TOLERANCE_M).to_bytes()

    @property
    def objects(self) -> tuple[CodedObject, ...]:
        """Contents of the OBJT records in order."""
        return tuple(self._coded)

    @property
    def bound_rule(self) -> BoundRule:
        """The bound that segments state to keep."""
        masked = BoundRule(mask_text(self._spec.k, self._spec.f0_n))
        mode = self._field_spec.mode if self._spec.mode == "lossless" else self._spec.mode
        return layout.composed_rule({mode}, masked, layout.Parameters.from_bytes(self.parameters))

    def encode_frames(self, frames: Sequence[Poses]) -> CodedPoses:
        """Code the poses of the frames of a segment."""
        quaternions, positions_m = (np.stack(column, axis=1) for column in zip(*frames, strict=True))
        tracks = [PoseTrack(*poses) for poses in zip(quaternions, positions_m)]
        chunks = [encode_poses(track, steps) for track, steps in zip(tracks, self._steps)]
        max_error = self._max_error(tracks)
        parts = [layout.ObjectPart(poses, None) for poses in chunks]
        return CodedPoses(layout.SegmentParts(max_error, parts).to_bytes(), max_error)

    def _max_error(self, tracks: Sequence[PoseTrack]) -> MaxError | None:
        """The largest error of the composed field in a segment; None if it is outside the bound."""
        bodies = zip(self._scene.objects, tracks, strict=True)
        scene = replace(self._scene, objects=tuple(replace(body, track=track) for body, track in bodies))
        decoded = [steps.track(round_poses(track, steps)) for track, steps in zip(tracks, self._steps)]
        rule, moves = ComposedRule(scene, self._spec.k, self._spec.f0_n), Moves.of(scene, decoded)
        worst = MaxError(*rule.check(self._pairs, moves, range(len(scene))).max_error)
        return worst if worst.ratio <= 1 else None


class LiveBodies:
    """Rigid bodies in motion: their encoder, and their poses in real time.

    `control` is that of `LiveSimulation`, called with MuJoCo's model and data before each frame.
    InvalidArgument if the scene has no bodies.
    """

    def __init__(self, scene: BodyScene, prepared: Prepared, control: Control | None = None) -> None:
        if prepared.objects is None:
            raise InvalidArgument("representation", "object for a scene without bodies", "voxel or auto")
        self._placement, self._objects = prepared.placement, prepared.objects.objects
        self._is_free = [body.is_free for body in scene.bodies()]
        self._simulation = None if scene.simulation is None else scene.simulation()
        if control is not None and self._simulation is None:
            raise InvalidArgument("control", "one of a scene that is not simulated", "a MuJoCo model")
        if self._simulation is not None:
            self._simulation.control = control
        self.frame_count = len(prepared.objects)
        self.encoder = BodiesEncoder(prepared.objects, prepared.coding, prepared.spec.f0_n or DEFAULT_F0_N)

    @property
    def has_end(self) -> bool:
        """True if the poses are those of tracks, which end."""
        return self._simulation is None

    @property
    def max_segment_frames(self) -> int:
        """Frames of a segment, at most, as receivers accept them."""
        return min(4096, MAX_SEGMENT_POSES // len(self._objects))

    def poses(self, index: int, on_note: Callable[[str], None]) -> Poses:
        """Return the poses of the frame `index`; of a simulation those of its next frame.

        `index` is below `frame_count`; frame 0 restarts a simulation. ``on_note(note)`` gets its warnings.
        """
        simulation = self._simulation
        if simulation is None:
            tracks = [body.track for body in self._objects]
            quaternions = np.stack([track.quaternions[index] for track in tracks])
            return quaternions, np.stack([track.positions(index) for track in tracks])
        if index == 0:
            simulation.restart()
        quaternions, positions_m = simulation.next_poses()
        while simulation.notes:
            on_note(simulation.notes.pop(0))
        placed_m = self._placement.to_hand(positions_m)
        for n, is_free in enumerate(self._is_free):
            if not is_free:  # its field is in place already
                quaternions[n], placed_m[n] = (1.0, 0.0, 0.0, 0.0), 0.0
        return quaternions, placed_m
