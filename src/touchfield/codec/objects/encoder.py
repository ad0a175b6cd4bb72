"""The encoder of the coder `objects`: fields and poses that keep the promise of the composed field.

"If a model is adopted that describes a scene as several objects, then the parameters will be force vectors
that correspond to each specific object." A rigid object costs one field, coded by a coder of fields, and a
pose for each frame; one that deforms costs a field for each frame. Empty space costs nothing.

Poses are coded first, within the tolerance in place. Then the decoded fields are composed and compared with
the source in every frame (`promise`), and the fields of the bodies that have a part in a voxel beyond the
mask are coded again, within a smaller share of it, until there is none. No share is small enough where forces
cancel, those of two bodies or of two sides of one, and nothing but the mask's F_0 allows an error: there, and
everywhere if F_0 is 0, the samples that such a voxel lies between are sent exactly.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.kernels import NUMBER_ROOM, code_numbers, end_of, fresh, price, writer
from touchfield.codec.objects import layout
from touchfield.codec.objects.decoder import (
    MODELS,
    MOST_ORDER,
    MOST_POSES,
    MOST_STEPS,
    POSITION_POWERS,
    QUATERNION_POWERS,
    PoseSteps,
    code_residuals,
)
from touchfield.codec.objects.layout import MAX_OBJECTS, MAX_POSES, CodedObject
from touchfield.codec.objects.promise import ComposedRule, Found, Moves, Pair, displacement_m, reach_m
from touchfield.codec.registry import (
    AmendingEncoder,
    FieldDecoder,
    FieldEncoder,
    coder_of_spec,
    field_decoder,
    field_encoder,
)
from touchfield.codec.segment import CodedSegment, Worst, segment_length
from touchfield.errors import InvalidArgument
from touchfield.medium import HapticObject, HapticScene, PoseTrack

_POSITION_COST, _QUATERNION_COST = 3, 4  # numbers that a power of two makes a bit longer


class Damping(NamedTuple):
    """Bound on velocities: the force b (v + omega x r) of a surface may be off by `most_n`, newtons."""

    n_s_per_m: float
    rate_hz: float
    most_n: float

    def is_kept(self, source: PoseTrack, decoded: PoseTrack, reach_m: float) -> bool:
        """True where it is, anywhere within `reach_m` of the body's origin."""
        if not self.n_s_per_m or source.is_still:
            return True
        (v, spin), (v1, spin1) = source.velocities(self.rate_hz), decoded.velocities(self.rate_hz)
        with np.errstate(over="ignore", invalid="ignore"):
            off = np.linalg.norm(v1 - v, axis=1) + np.linalg.norm(spin1 - spin, axis=1) * reach_m
            return bool(self.n_s_per_m * off.max() <= self.most_n)


def rounded(track: PoseTrack, steps: PoseSteps) -> Int64s:
    """The nearest multiples of the steps, int64 [n, 7]; InvalidArgument if a position is beyond 2^50 of them."""
    farthest = float(np.abs(track.positions_m).max())
    if farthest > MOST_STEPS * steps.position_m:
        expected = f"{MOST_STEPS * steps.position_m:g} m at most with a step of {steps.position_m:g} m"
        raise InvalidArgument("pose track positions_m", f"{farthest:g} m from the origin", expected)
    numbers = track.positions_m / steps.position_m, track.quaternions / steps.quaternion
    return np.rint(np.concatenate(numbers, axis=1)).astype(np.int64)


def place_steps(
    track: PoseTrack, reach_m: float, tolerance_m: float, damping: Damping | None = None
) -> PoseSteps:
    """The coarsest steps with which no point of a body leaves its place by more than a tolerance.

    The body's field reaches `reach_m` from its origin. InvalidArgument if the steps would have to be finer
    than there are any.
    """
    first = [
        min(math.ceil(math.log2(4 * tolerance_m)), POSITION_POWERS[1]),
        min(math.ceil(math.log2(2 * tolerance_m / max(reach_m, tolerance_m))), QUATERNION_POWERS[1]),
    ]
    spans = [max(first[0] - POSITION_POWERS[0] + 1, 0), max(first[1] - QUATERNION_POWERS[0] + 1, 0)]
    finer = sorted(np.ndindex(*spans), key=lambda d: _POSITION_COST * d[0] + _QUATERNION_COST * d[1])
    for less_position, less_turn in finer:
        steps = PoseSteps(2.0 ** (first[0] - less_position), 2.0 ** (first[1] - less_turn))
        if np.abs(track.positions_m).max() > MOST_STEPS * steps.position_m:
            continue
        decoded = steps.track(rounded(track, steps))
        is_near = displacement_m(track, decoded, reach_m).max() <= tolerance_m
        if is_near and (damping is None or damping.is_kept(track, decoded, reach_m)):
            return steps
    found = f"poses that keep to {1e6 * tolerance_m:g} um"
    if damping is not None and damping.n_s_per_m:
        found += f", and a damping of {damping.n_s_per_m:g} N s/m at {damping.rate_hz:g} Hz"
    mend = "Take a smaller surface damping, or a body nearer to its origin."
    raise InvalidArgument("pose track", found, "steps of 2^-40 m and 2^-30 at least", mend)


def encode_poses(track: PoseTrack, steps: PoseSteps) -> bytes:
    """The code of a track, by the multiples of `rounded`; InvalidArgument if there are too many poses."""
    if len(track) > MOST_POSES:
        raise InvalidArgument("pose track", f"{len(track)} poses", f"{MOST_POSES} at most", "Split it.")
    numbers = rounded(track, steps)
    moved = (numbers - numbers[0]).T
    orders = [_best_order(one) for one in moved]
    bits = writer(NUMBER_ROOM * (numbers.size + 14) + 64, fresh(*MODELS))
    code_numbers(bits, 0, 0, np.append(orders, numbers[0]))
    for c, order in enumerate(orders):
        if order:
            code_residuals(bits, c, _residuals(moved[c], order))
    return end_of(bits)


def _best_order(moved: Int64s) -> int:
    """The predictor with which a component, int64 [n], is shortest, coded alone."""

    def size(order: int) -> float:
        bits = writer(NUMBER_ROOM * len(moved) + 64, fresh(*MODELS))
        code_residuals(bits, 0, _residuals(moved, order))
        return float(price(bits))

    return min(range(1, MOST_ORDER + 1), key=size) if moved.any() else 0


def _residuals(moved: Int64s, order: int) -> Int64s:
    """Differences of that order, int64 [n - 1]; before the first number all are equal to it."""
    for _ in range(order):
        moved = np.diff(moved, prepend=0)
    return moved[1:]


# A fifth of what a Phantom Omni can tell of a place (0.055 mm), and 5 mN on a wall of 500 N/m
PLACE_TOLERANCE_M: Final = 1e-5
# where no object deforms: poses alone are small, and each segment begins its predictions anew
_RIGID_SEGMENT_FRAMES: Final = 2048
_SHARE_STEP: Final = 0.93
_LEAST_SHARE: Final = 1 / 64
# Of bodies with exact samples: half the mask leaves few samples beyond it. Of the shares 0.12 to 1 it is
# within 16 % of the fewest bytes in 14 scenes of bodies that meet; the whole mask takes up to 2.3 times as
# many.
_SHARE_BESIDE_EXACT: Final = 0.5
_MAX_SHARE_STEPS: Final = 100
_LEAST_K: Final = 0.001
_DAMPING_SHARE: Final = 0.25  # of F_0, for the velocity of a moving surface
_FINE: Final = 0.001  # of that where nothing but k |F| is allowed, and |F| may be small


def check_pose_count(object_count: int, frame_count: int) -> None:
    """InvalidArgument where a scene has more objects or poses than a file may hold."""
    if object_count > MAX_OBJECTS:
        raise InvalidArgument("haptic scene", f"{object_count} objects", f"at most {MAX_OBJECTS}")
    if object_count * frame_count > MAX_POSES:
        found = f"{frame_count} frames of {object_count} objects"
        raise InvalidArgument(
            "haptic scene", found, f"at most {MAX_POSES} poses", "Take fewer frames or objects."
        )


class _Fields(NamedTuple):
    """The coded fields of one object, a segment each (one in all of a rigid one); a rigid one's beside its
    source.
    """

    encoder: FieldEncoder
    decoder: FieldDecoder
    segments: list[CodedSegment]
    pair: Pair | None


class ObjectsEncoder:
    """Codes a haptic scene; all of it, when it is first asked for any.

    `spec`: how the fields are coded, and by which coder. In mode "mask" of coder `touch` the composed field
    keeps max(F_0, k |F|), and in mode "lossless" the decoded fields are the source's; else nothing is
    promised of it (`is_bounded`). `f0_n`: F_0, newtons: the surface damping of the decoded poses is off by a
    quarter of it at most, and by a millionth of a newton or so where the mask's F_0 is 0.
    InvalidArgument if the scene has more objects or poses than a file may hold. When asked: if no steps of
    poses keep to the tolerance, or no accuracy of the poses keeps the promise with a surface damping.
    """

    name = layout.NAME

    def __init__(self, scene: HapticScene, spec: Any, f0_n: float) -> None:
        check_pose_count(len(scene.objects), scene.frame_count)
        if coder_of_spec(spec).has_promise and spec.masking:
            found, expected = "it with bodies that have fields of their own", "fields of voxels"
            raise InvalidArgument("--masking", found, expected, "Add --representation voxel.")
        self._scene, self._spec, self._f0_n = scene, spec, f0_n
        self._all_rigid = all(one.is_rigid for one in scene.objects)
        self._step = (
            _RIGID_SEGMENT_FRAMES if self._all_rigid else segment_length(spec.segment_frames, scene.rate_hz)
        )
        self._ranges = [range(i, min(i + self._step, len(scene))) for i in range(0, len(scene), self._step)]

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters`."""
        scene = self._scene
        return layout.Parameters(
            len(scene.objects), scene.surface_damping_n_s_per_m, PLACE_TOLERANCE_M
        ).to_bytes()

    @property
    def is_bounded(self) -> bool:
        """True where every segment states the largest error of the composed field."""
        return coder_of_spec(self._spec).has_promise and self._spec.mode in layout.BOUNDED_MODES

    @property
    def _damping_limit_n(self) -> float:
        """The most by which the damping of a moving surface may be off, newtons."""
        spec = self._spec
        floor_n = self._f0_n
        if self.is_bounded and spec.f0_n == 0:
            floor_n *= _FINE * spec.k
        return _DAMPING_SHARE * floor_n

    @property
    def supported(self) -> int:
        """Samples with a force among the coded fields; those of a rigid object count once."""
        return sum(f.supported for fields in self._coded[0] for one in fields.segments for f in one.frames)

    def objects(self) -> Iterator[CodedObject]:
        """Contents of the OBJT records, one object after another."""
        for one, fields, steps in zip(self._scene.objects, self._coded[0], self._steps, strict=True):
            yield CodedObject(
                name=one.name,
                grid=one.medium.grid,
                is_deforming=not one.is_rigid,
                field_coder=coder_of_spec(self._spec).name,
                field_parameters=fields.encoder.parameters,
                pose_steps=steps.to_bytes(),
                field=fields.segments[0].body if one.is_rigid else b"",
            )

    def segments(self) -> Iterator[tuple[int, int, bytes]]:
        """First frame, number of frames and body of each segment."""
        coded, worst = self._coded
        for i, frames in enumerate(self._ranges):
            parts = [
                layout.ObjectPart(
                    encode_poses(one.track.between(frames.start, frames.stop), steps),
                    None if one.is_rigid else fields.segments[i].body,
                )
                for one, steps, fields in zip(self._scene.objects, self._steps, coded, strict=True)
            ]
            yield frames.start, len(frames), layout.SegmentParts(worst[i], parts).to_bytes()

    @cached_property
    def _steps(self) -> list[PoseSteps]:
        scene = self._scene
        damping = Damping(scene.surface_damping_n_s_per_m, scene.rate_hz, self._damping_limit_n)
        return [place_steps(one.track, reach_m(one), PLACE_TOLERANCE_M, damping) for one in scene.objects]

    @cached_property
    def _coded(self) -> tuple[list[_Fields], list[Worst | None]]:
        """The fields that keep the promise, and the worst voxel of each segment."""
        shares = np.ones(len(self._scene.objects))
        coded, spec = [self._fields(one, 1.0) for one in self._scene.objects], self._spec
        if not self.is_bounded:
            return coded, [None] * len(self._ranges)
        rule = ComposedRule(self._scene, spec.k, spec.f0_n)
        suspects: set[int] = set()  # frames that were beyond: looked at first
        amended: set[int] = set()  # bodies with exact samples, which another share would lose
        while True:
            results = [self._found(rule, coded, sorted(suspects))] if suspects else []
            if not results or results[0].beyond == 0:
                results = [self._found(rule, coded, frames) for frames in self._ranges]
            ratios = np.max([one.ratios for one in results], axis=0)
            if ratios.max() <= 1.0:
                worst = [Worst(*one.worst) for one in results]
                starts = [frames.start for frames in self._ranges]
                return coded, [
                    w._replace(frame=max(w.frame - i, 0)) for w, i in zip(worst, starts, strict=True)
                ]
            if self._all_rigid:
                suspects |= {int(frame) for one in results for frame in one.places[one.ratios > 1, 0]}
            violating = np.flatnonzero(ratios > 1).tolist()
            finer = {i: None if i in amended else self._finer(shares[i], ratios[i]) for i in violating}
            if not any(finer.values()):
                before, coded = coded, self._with_exact_samples(rule, coded)
                amended |= {
                    i for i, (old, new) in enumerate(zip(before, coded, strict=True)) if new is not old
                }
            for i, share in finer.items():
                if share is not None:
                    shares[i] = share
                    coded[i] = self._fields(self._scene.objects[i], share)

    def _finer(self, share: float, ratio: float) -> float | None:
        """A smaller share of the mask for a body whose error is `ratio` of it; None where no share would do."""
        if self._spec.mode != "mask":
            return None
        is_mendable = self._spec.f0_n > 0 and ratio * _LEAST_SHARE <= 1
        least = _LEAST_SHARE if is_mendable else _SHARE_BESIDE_EXACT
        if share <= least:
            return None
        steps = max(1, int(min(np.log(ratio) / -np.log(_SHARE_STEP) / 2, _MAX_SHARE_STEPS)))
        return max(float(share * _SHARE_STEP**steps), least)

    def _with_exact_samples(self, rule: ComposedRule, coded: list[_Fields]) -> list[_Fields]:
        """The fields with every sample exact that a voxel beyond the mask lies between.

        InvalidArgument if there is none: what is left of the error comes from the velocities of the poses,
        which are never exact.
        """
        wanted = [
            [np.zeros(0, np.int64)] * sum(len(one.frames) for one in fields.segments) for fields in coded
        ]
        for frames in [range(len(self._scene))] if self._all_rigid else self._ranges:
            for frame, samples in self._violating(rule, coded, frames):
                for own, one, fields in zip(wanted, samples, coded, strict=True):
                    at = 0 if fields.pair else frame
                    own[at] = np.union1d(own[at], one)
        if not any(len(samples) for own in wanted for samples in own):
            raise self._refusal()
        return [
            self._amended(i, fields, own) for i, (fields, own) in enumerate(zip(coded, wanted, strict=True))
        ]

    def _amended(self, index: int, fields: _Fields, wanted: list[Int64s]) -> _Fields:
        """The fields of a body with these samples exact, of each coded frame."""
        one, segments, at = self._scene.objects[index], list[CodedSegment](), 0
        for segment in fields.segments:
            count = len(segment.frames)
            own = wanted[at : at + count]
            if any(map(len, own)):
                assert isinstance(fields.encoder, AmendingEncoder)  # or nothing would be guaranteed of it
                sources = [one.field(i) for i in range(at, at + count)]
                segment = fields.encoder.with_exact_samples(segment, sources, own)
            segments.append(segment)
            at += count
        if not any(map(len, wanted)):
            return fields
        return _fields_of(one, fields.encoder, fields.decoder, segments)

    def _violating(
        self, rule: ComposedRule, coded: list[_Fields], frames: Sequence[int]
    ) -> Iterator[tuple[int, list[Int64s]]]:
        """`ComposedRule.violating_samples` of some frames, as `_found`; the frame is any where none deforms."""
        for now, some in self._pairs(coded, frames):
            yield some[0], rule.violating_samples(now, self._moves, some)

    def _refusal(self) -> InvalidArgument:
        """Why no accuracy keeps the promise, and what does."""
        spec, damping = self._spec, self._scene.surface_damping_n_s_per_m
        found = f"a surface damping of {damping:g} N s/m with an F_0 of {spec.f0_n:g} N"
        expected = "an F_0 that allows for the velocities of coded poses, which are never exact"
        mend = "Take a larger --f0-n, --surface-damping-n-s-per-m 0, or --representation voxel."
        return InvalidArgument("haptic scene", found, expected, mend)

    @cached_property
    def _moves(self) -> Moves:
        tracks = [
            steps.track(rounded(one.track, steps)) for one, steps in zip(self._scene.objects, self._steps)
        ]
        return Moves.of(self._scene, tracks)

    def _found(self, rule: ComposedRule, coded: list[_Fields], frames: Sequence[int]) -> Found:
        """How some frames keep the rule; where an object deforms, those of a segment."""
        total = Found.none(len(coded))
        for now, some in self._pairs(coded, frames):
            total = total.joined(rule.check(now, self._moves, some))
        return total

    def _pairs(
        self, coded: list[_Fields], frames: Sequence[int]
    ) -> Iterator[tuple[list[Pair], Sequence[int]]]:
        """The fields of all bodies, and the frames they serve: one by one, of a segment, where any deforms."""
        pairs = [fields.pair for fields in coded]
        if self._all_rigid:
            yield [pair for pair in pairs if pair], frames
            return
        segment = frames[0] // self._step
        decoded = [
            iter(()) if pair else fields.decoder.frames(fields.segments[segment].body, len(frames))
            for fields, pair in zip(coded, pairs, strict=True)
        ]
        for frame in frames:
            bodies = zip(pairs, self._scene.objects, decoded, strict=True)
            yield [pair or Pair(one.field(frame), next(made)) for pair, one, made in bodies], [frame]

    def _fields(self, one: HapticObject, share: float) -> _Fields:
        """The fields of one object, coded within a share of the mask."""
        spec = self._spec
        if coder_of_spec(spec).has_promise and spec.mode == "mask":
            if self._scene.surface_damping_n_s_per_m:  # which begins at once where a force begins
                spec = replace(spec, support="exact")
            spec = replace(spec, k=max(_LEAST_K, share * spec.k), f0_n=share * spec.f0_n)
        encoder = field_encoder(one.medium.grid, spec)
        decoder = field_decoder(encoder.name, one.medium.grid, encoder.parameters)
        ranges = [range(1)] if one.is_rigid else self._ranges
        segments = [encoder.encode_segment([one.field(i) for i in frames]) for frames in ranges]
        return _fields_of(one, encoder, decoder, segments)


def _fields_of(
    one: HapticObject, encoder: FieldEncoder, decoder: FieldDecoder, segments: list[CodedSegment]
) -> _Fields:
    """The coded fields of an object; those of a rigid one decoded beside their source."""
    pair = Pair(one.field(0), next(decoder.frames(segments[0].body, 1))) if one.is_rigid else None
    return _Fields(encoder, decoder, segments, pair)
