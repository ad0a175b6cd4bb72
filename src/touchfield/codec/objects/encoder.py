"""Encodes a scene of bodies (coder `objects`): a field for each body and its poses, such that the composed
field keeps the error bound.

"If a model is adopted that describes a scene as several objects, then the parameters will be force vectors
that correspond to each specific object." A rigid object costs one field, coded by a coder of fields, and one
pose per frame; a deforming object costs one field per frame. Empty space costs nothing.

Poses are coded first, within the tolerance in place. Then the decoded fields are composed and compared with
the source in every frame (`error_bound`). The fields of bodies that contribute to a voxel outside the mask
are coded again with a smaller fraction of the mask, until no such voxel is left. No fraction is small enough
where forces cancel (those of two bodies, or of two sides of one body) and only F_0 of the mask allows an
error. There, and everywhere if F_0 is 0, the samples around such a voxel are sent exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.objects import layout
from touchfield.codec.objects.decoder import (
    MAX_SEGMENT_POSES,
    MAX_STEPS,
    POSITION_POWERS,
    QUATERNION_POWERS,
    PoseSteps,
)
from touchfield.codec.objects.error_bound import (
    BoundCheck,
    ComposedRule,
    Moves,
    Pair,
    displacement_m,
    reach_m,
)
from touchfield.codec.objects.layout import MAX_OBJECTS, CodedObject
from touchfield.codec.registry import (
    ExactSampleEncoder,
    FieldDecoder,
    FieldEncoder,
    coder_of_spec,
    field_decoder,
    field_encoder,
)
from touchfield.codec.segment import CodedSegment, MaxError, segment_length
from touchfield.compute.native import argument_errors, native
from touchfield.errors import InvalidArgument
from touchfield.medium import HapticObject, HapticScene, PoseTrack
from touchfield.medium.pose_track import MAX_POSES

_POSITION_COST, _QUATERNION_COST = 3, 4  # components that take one more bit each when the step is halved
_SEARCH_FRAMES: Final = 512  # poses that are rounded and compared at once in the search of steps


class Damping(NamedTuple):
    """Bound on the error of the force b (v + omega x r) of a moving surface.

    The bound is `max_error_n`, newtons.
    """

    n_s_per_m: float
    rate_hz: float
    max_error_n: float

    def is_within(self, source: PoseTrack, steps: PoseSteps, reach_m: float) -> bool:
        """True if the bound holds everywhere within `reach_m` of the body's origin, with rounded poses."""
        if not self.n_s_per_m or source.is_constant:
            return True
        decoded = steps.track(round_poses(source, steps))
        (v, spin), (v1, spin1) = source.velocities(self.rate_hz), decoded.velocities(self.rate_hz)
        with np.errstate(over="ignore", invalid="ignore"):
            error = np.linalg.norm(v1 - v, axis=1) + np.linalg.norm(spin1 - spin, axis=1) * reach_m
            return bool(self.n_s_per_m * error.max() <= self.max_error_n)


def round_poses(track: PoseTrack, steps: PoseSteps, frames: slice = slice(None)) -> Int64s:
    """Nearest multiples of the steps, int64 [n, 7], of all or some frames.

    InvalidArgument if a position exceeds 2^50 steps.
    """
    positions_m, quaternions = track.positions(frames), track.quaternions[frames]
    farthest = float(np.abs(positions_m).max())
    if farthest > MAX_STEPS * steps.position_m:
        expected = f"{MAX_STEPS * steps.position_m:g} m at most with a step of {steps.position_m:g} m"
        raise InvalidArgument("pose track positions_m", f"{farthest:g} m from the origin", expected)
    numbers = positions_m / steps.position_m, quaternions / steps.quaternion
    return np.rint(np.concatenate(numbers, axis=1)).astype(np.int64)


def choose_pose_steps(
    track: PoseTrack, reach_m: float, tolerance_m: float, damping: Damping | None = None
) -> PoseSteps:
    """The coarsest steps that move no point of a body by more than a tolerance.

    `reach_m` is how far the body's field extends from its origin. InvalidArgument if even the finest steps
    are too coarse.
    """
    coarsest = [
        min(math.ceil(math.log2(4 * tolerance_m)), POSITION_POWERS[1]),
        min(math.ceil(math.log2(2 * tolerance_m / max(reach_m, tolerance_m))), QUATERNION_POWERS[1]),
    ]
    spans = [max(coarsest[0] - POSITION_POWERS[0] + 1, 0), max(coarsest[1] - QUATERNION_POWERS[0] + 1, 0)]
    halvings = sorted(np.ndindex(*spans), key=lambda d: _POSITION_COST * d[0] + _QUATERNION_COST * d[1])
    farthest_m = np.abs(track.positions(slice(None))).max()
    for position_halvings, quaternion_halvings in halvings:
        steps = PoseSteps(
            2.0 ** (coarsest[0] - position_halvings), 2.0 ** (coarsest[1] - quaternion_halvings)
        )
        if farthest_m > MAX_STEPS * steps.position_m or not _is_in_place(track, steps, reach_m, tolerance_m):
            continue
        if damping is None or damping.is_within(track, steps, reach_m):
            return steps
    found = f"poses that keep to {1e6 * tolerance_m:g} um"
    if damping is not None and damping.n_s_per_m:
        found += f", and a damping of {damping.n_s_per_m:g} N s/m at {damping.rate_hz:g} Hz"
    mend = "Take a smaller surface damping, or a body nearer to its origin."
    raise InvalidArgument("pose track", found, "steps of 2^-40 m and 2^-30 at least", mend)


def _is_in_place(track: PoseTrack, steps: PoseSteps, reach_m: float, tolerance_m: float) -> bool:
    """True if rounding to the steps moves no point within `reach_m` by more than a tolerance.

    Steps that are too coarse fail in the first blocks, so that a search costs little more than one pass.
    """
    frame_count = 1 if track.is_constant else len(track)
    for start in range(0, frame_count, _SEARCH_FRAMES):
        frames = slice(start, min(start + _SEARCH_FRAMES, frame_count))
        decoded = steps.track(round_poses(track, steps, frames))
        if not displacement_m(track, decoded, reach_m, frames).max() <= tolerance_m:
            return False
    return True


def encode_poses(track: PoseTrack, steps: PoseSteps) -> bytes:
    """Code a track, rounded by `round_poses`.

    InvalidArgument if there are too many poses.
    """
    if len(track) > MAX_SEGMENT_POSES:
        raise InvalidArgument(
            "pose track", f"{len(track)} poses", f"{MAX_SEGMENT_POSES} at most", "Split it."
        )
    with argument_errors("pose track"):
        return native.encode_poses(round_poses(track, steps))


# a fifth of the position resolution of a Phantom Omni (0.055 mm); it changes the force of a wall of 500 N/m
# by 5 mN
PLACE_TOLERANCE_M: Final = 1e-5
# if no object deforms: segments contain only poses, which are small, and each segment restarts their
# prediction
_RIGID_SEGMENT_FRAMES: Final = 2048
_FRACTION_STEP: Final = 0.93
_MIN_FRACTION: Final = 1 / 64
# for bodies with exact samples: at half the mask few samples are outside the mask. In 14 scenes of bodies in
# contact it takes at most 16 % more bytes than the best fraction from 0.12 to 1; the whole mask takes up to
# 2.3 times as many bytes.
_FRACTION_WITH_EXACT: Final = 0.5
_MAX_FRACTION_STEPS: Final = 100
MIN_K: Final = 0.001
DAMPING_FRACTION: Final = 0.25  # fraction of F_0 for the error of the damping force of a moving surface
_DAMPING_FRACTION_OF_K: Final = 0.001  # times k, a further factor if the F_0 of the bound is 0


def check_pose_count(object_count: int, frame_count: int) -> None:
    """InvalidArgument if a scene has more objects or poses than a file can store."""
    if object_count > MAX_OBJECTS:
        raise InvalidArgument("haptic scene", f"{object_count} objects", f"at most {MAX_OBJECTS}")
    if object_count * frame_count > MAX_POSES:
        found = f"{frame_count} frames of {object_count} objects"
        raise InvalidArgument(
            "haptic scene", found, f"at most {MAX_POSES} poses", "Take fewer frames or objects."
        )


class _Fields(NamedTuple):
    """Coded fields of one object.

    `segments` has one entry per segment of the file, or a single one for a rigid object. `pair` holds the
    source and the decoded field of a rigid object; it is None for a deforming one.
    """

    encoder: FieldEncoder
    decoder: FieldDecoder
    segments: list[CodedSegment]
    pair: Pair | None


class ObjectsEncoder:
    """Encoder of a haptic scene; the first access to any result codes all of it.

    `spec` selects the coder of the fields and its options. In mode "mask" of the coder `touch` the error of
    the composed field is at most max(F_0, k |F|). In mode "lossless" the decoded fields equal those of the
    source. In other modes the error has no bound (`is_bounded`). `f0_n` is F_0 in newtons: the decoded poses
    change the force of the surface damping by at most a quarter of it, or by about a millionth of a newton if
    the mask's F_0 is 0. InvalidArgument if the scene has more objects or poses than a file can store. On
    access: InvalidArgument if no pose steps satisfy the tolerance or, with a surface damping, the error
    bound.
    """

    name = layout.NAME

    def __init__(self, scene: HapticScene, spec: Any, f0_n: float) -> None:
        check_pose_count(len(scene.objects), scene.frame_count)
        for option, name in (("--masking", "masking"), ("--profile", "k_by_force")):
            if coder_of_spec(spec).has_error_bound and getattr(spec, name):
                found, expected = "it with bodies that have fields of their own", "fields of voxels"
                raise InvalidArgument(option, found, expected, "Add --representation voxel.")
        self._scene, self._spec, self._f0_n = scene, spec, f0_n
        self._all_rigid = all(body.is_rigid for body in scene.objects)
        self._segment_length = (
            _RIGID_SEGMENT_FRAMES if self._all_rigid else segment_length(spec.segment_frames, scene.rate_hz)
        )
        self._ranges = [
            range(i, min(i + self._segment_length, len(scene)))
            for i in range(0, len(scene), self._segment_length)
        ]

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters`."""
        scene = self._scene
        return layout.Parameters(
            len(scene.objects), scene.surface_damping_n_s_per_m, PLACE_TOLERANCE_M
        ).to_bytes()

    @property
    def is_bounded(self) -> bool:
        """True if every segment states the largest error of the composed field."""
        return coder_of_spec(self._spec).has_error_bound and self._spec.mode in layout.BOUNDED_MODES

    @property
    def _damping_limit_n(self) -> float:
        """Largest error of the damping force of a moving surface, newtons."""
        spec = self._spec
        floor_n = self._f0_n
        if self.is_bounded and spec.f0_n == 0:
            floor_n *= _DAMPING_FRACTION_OF_K * spec.k
        return DAMPING_FRACTION * floor_n

    @property
    def supported(self) -> int:
        """Number of supported samples in the coded fields; a rigid field counts once."""
        return sum(
            f.supported for fields in self._coded[0] for segment in fields.segments for f in segment.frames
        )

    def objects(self) -> Iterator[CodedObject]:
        """Yield the contents of the OBJT records in order."""
        for body, fields, steps in zip(self._scene.objects, self._coded[0], self._steps, strict=True):
            yield CodedObject(
                name=body.name,
                grid=body.medium.grid,
                is_deforming=not body.is_rigid,
                field_coder=coder_of_spec(self._spec).name,
                field_parameters=fields.encoder.parameters,
                pose_steps=steps.to_bytes(),
                field=fields.segments[0].body if body.is_rigid else b"",
            )

    def segments(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield the first frame, the number of frames and the body of each segment."""
        coded, max_errors = self._coded
        for i, frames in enumerate(self._ranges):
            parts = [
                layout.ObjectPart(
                    encode_poses(body.track.between(frames.start, frames.stop), steps),
                    None if body.is_rigid else fields.segments[i].body,
                )
                for body, steps, fields in zip(self._scene.objects, self._steps, coded, strict=True)
            ]
            yield frames.start, len(frames), layout.SegmentParts(max_errors[i], parts).to_bytes()

    @cached_property
    def _steps(self) -> list[PoseSteps]:
        scene = self._scene
        damping = Damping(scene.surface_damping_n_s_per_m, scene.rate_hz, self._damping_limit_n)
        return [
            choose_pose_steps(body.track, reach_m(body), PLACE_TOLERANCE_M, damping) for body in scene.objects
        ]

    @cached_property
    def _coded(self) -> tuple[list[_Fields], list[MaxError | None]]:
        """Coded fields within the error bound, and the largest error of each segment."""
        fractions = np.ones(len(self._scene.objects))
        coded, spec = [self._encode_object(body, 1.0) for body in self._scene.objects], self._spec
        if not self.is_bounded:
            return coded, [None] * len(self._ranges)
        rule = ComposedRule(self._scene, spec.k, spec.f0_n)
        suspects: set[int] = set()  # frames that violated the bound, which are checked first
        amended: set[int] = set()  # bodies with exact samples; coding their fields again would lose these
        while True:
            results = [self._check(rule, coded, sorted(suspects))] if suspects else []
            if not results or results[0].violations == 0:
                results = [self._check(rule, coded, frames) for frames in self._ranges]
            ratios = np.max([result.ratios for result in results], axis=0)
            if ratios.max() <= 1.0:
                max_errors = [MaxError(*result.max_error) for result in results]
                starts = [frames.start for frames in self._ranges]
                return coded, [
                    error._replace(frame=max(error.frame - start, 0))
                    for error, start in zip(max_errors, starts, strict=True)
                ]
            if self._all_rigid:
                for result in results:
                    suspects |= {int(frame) for frame in result.voxels[result.ratios > 1, 0]}
            finer: dict[int, float | None] = {}
            for i in np.flatnonzero(ratios > 1).tolist():
                finer[i] = None if i in amended else self._finer_fraction(fractions[i], ratios[i])
            if not any(finer.values()):
                previous, coded = coded, self._with_exact_samples(rule, coded)
                amended |= {
                    i for i, (old, new) in enumerate(zip(previous, coded, strict=True)) if new is not old
                }
            for i, fraction in finer.items():
                if fraction is not None:
                    fractions[i] = fraction
                    coded[i] = self._encode_object(self._scene.objects[i], fraction)

    def _finer_fraction(self, fraction: float, ratio: float) -> float | None:
        """A smaller fraction of the mask for a body whose error ratio is `ratio`.

        None if no smaller fraction suffices.
        """
        if self._spec.mode != "mask":
            return None
        is_mendable = self._spec.f0_n > 0 and ratio * _MIN_FRACTION <= 1
        min_fraction = _MIN_FRACTION if is_mendable else _FRACTION_WITH_EXACT
        if fraction <= min_fraction:
            return None
        steps = max(1, int(min(np.log(ratio) / -np.log(_FRACTION_STEP) / 2, _MAX_FRACTION_STEPS)))
        return max(float(fraction * _FRACTION_STEP**steps), min_fraction)

    def _with_exact_samples(self, rule: ComposedRule, coded: list[_Fields]) -> list[_Fields]:
        """The fields, with every sample around a voxel outside the mask made exact.

        InvalidArgument if there is no such sample: the remaining error comes from the velocities of the
        poses, which are never exact.
        """
        exact: list[list[Int64s]] = []  # samples of each body and coded frame
        for fields in coded:
            frame_count = sum(len(segment.frames) for segment in fields.segments)
            exact.append([np.zeros(0, np.int64)] * frame_count)
        for frames in [range(len(self._scene))] if self._all_rigid else self._ranges:
            for frame, violating in self._violating(rule, coded, frames):
                for by_frame, samples, fields in zip(exact, violating, coded, strict=True):
                    index = 0 if fields.pair else frame
                    by_frame[index] = np.union1d(by_frame[index], samples)
        if not any(len(samples) for by_frame in exact for samples in by_frame):
            raise self._unbounded_error()
        return [
            self._with_samples(i, fields, by_frame)
            for i, (fields, by_frame) in enumerate(zip(coded, exact, strict=True))
        ]

    def _with_samples(self, index: int, fields: _Fields, samples: list[Int64s]) -> _Fields:
        """The fields of a body with the given samples of each coded frame exact."""
        body, segments, first = self._scene.objects[index], list[CodedSegment](), 0
        for segment in fields.segments:
            count = len(segment.frames)
            selected = samples[first : first + count]
            if any(map(len, selected)):
                # true of every coder with an error bound
                assert isinstance(fields.encoder, ExactSampleEncoder)
                sources = [body.field(i) for i in range(first, first + count)]
                segment = fields.encoder.with_exact_samples(segment, sources, selected)
            segments.append(segment)
            first += count
        if not any(map(len, samples)):
            return fields
        return _coded_fields(body, fields.encoder, fields.decoder, segments)

    def _violating(
        self, rule: ComposedRule, coded: list[_Fields], frames: Sequence[int]
    ) -> Iterator[tuple[int, list[Int64s]]]:
        """Yield frames and their `ComposedRule.violating_samples`.

        If no body deforms, a single, arbitrary frame is yielded.
        """
        for pairs, served in self._pairs(coded, frames):
            yield served[0], rule.violating_samples(pairs, self._moves, served)

    def _unbounded_error(self) -> InvalidArgument:
        """Error for a scene in which no accuracy of the poses satisfies the bound."""
        spec, damping = self._spec, self._scene.surface_damping_n_s_per_m
        found = f"a surface damping of {damping:g} N s/m with an F_0 of {spec.f0_n:g} N"
        expected = "an F_0 that allows for the velocities of coded poses, which are never exact"
        mend = "Take a larger --f0-n, --surface-damping-n-s-per-m 0, or --representation voxel."
        return InvalidArgument("haptic scene", found, expected, mend)

    @cached_property
    def _moves(self) -> Moves:
        bodies, all_steps = self._scene.objects, self._steps

        def decode(start: int, stop: int) -> list[PoseTrack]:
            frames = slice(start, stop)
            return [
                steps.track(round_poses(body.track, steps, frames))
                for body, steps in zip(bodies, all_steps, strict=True)
            ]

        return Moves(self._scene, decode)

    def _check(self, rule: ComposedRule, coded: list[_Fields], frames: Sequence[int]) -> BoundCheck:
        """Check frames against the rule; if a body deforms, they are those of one segment."""
        total = BoundCheck.empty(len(coded))
        for pairs, served in self._pairs(coded, frames):
            total = total.merged(rule.check(pairs, self._moves, served))
        return total

    def _pairs(
        self, coded: list[_Fields], frames: Sequence[int]
    ) -> Iterator[tuple[list[Pair], Sequence[int]]]:
        """Yield the source and decoded fields of all bodies, and the frames they apply to.

        If a body deforms, `frames` must be those of one segment, and one frame is yielded at a time.
        """
        pairs = [fields.pair for fields in coded]
        if self._all_rigid:
            yield [pair for pair in pairs if pair], frames
            return
        segment = frames[0] // self._segment_length
        decoded = [
            iter(()) if pair else fields.decoder.frames(fields.segments[segment].body, len(frames))
            for fields, pair in zip(coded, pairs, strict=True)
        ]
        for frame in frames:
            bodies = zip(pairs, self._scene.objects, decoded, strict=True)
            yield (
                [
                    pair or Pair(body.field(frame), next(decoder_fields))
                    for pair, body, decoder_fields in bodies
                ],
                [frame],
            )

    def _encode_object(self, body: HapticObject, fraction: float) -> _Fields:
        """Code the fields of one object within a fraction of the mask."""
        spec = self._spec
        if coder_of_spec(spec).has_error_bound and spec.mode == "mask":
            if self._scene.surface_damping_n_s_per_m:  # damping acts wherever there is a force
                spec = replace(spec, support="exact")
            spec = replace(spec, k=max(MIN_K, fraction * spec.k), f0_n=fraction * spec.f0_n)
        encoder = field_encoder(body.medium.grid, spec)
        decoder = field_decoder(encoder.name, body.medium.grid, encoder.parameters)
        ranges = [range(1)] if body.is_rigid else self._ranges
        segments = [encoder.encode_segment([body.field(i) for i in frames]) for frames in ranges]
        return _coded_fields(body, encoder, decoder, segments)


def _coded_fields(
    body: HapticObject, encoder: FieldEncoder, decoder: FieldDecoder, segments: list[CodedSegment]
) -> _Fields:
    """Coded fields of an object; a rigid one is also decoded, for its pair."""
    pair = Pair(body.field(0), next(decoder.frames(segments[0].body, 1))) if body.is_rigid else None
    return _Fields(encoder, decoder, segments, pair)
