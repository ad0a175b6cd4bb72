"""Cuts a medium into segments and codes them on all cores. It also cuts long media into independent ranges of
frames, which workers can code.

A segment is coded on its own, but its length, and its key frame where the world stands still, depend on the
frames before it. The medium is therefore cut into ranges of whole segments, at frames that follow from its
rate alone. Each range is coded independently of the others, in this process or in another one, to the same
bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import chain
from typing import NamedTuple

from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.registry import FieldEncoder, KeyFrameEncoder, field_encoder
from touchfield.codec.vibration import encode_vibration
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Progress
from touchfield.container import Head, TouchWriter
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.spec import EncodeSpec

SegmentInput = tuple[list[ForceField], list["VibrationFrame"], ForceField | None]
"""Frames of one segment, their vibration (an empty list if the medium has none), and the key frame."""

MAX_SEGMENT_BYTES = 1 << 27
"""A segment ends once its fields take more. Eight of the largest are coded at a time."""

MAX_PENDING_BYTES = 1 << 30
"""No further segment is started while the fields of those being coded take more."""

SEGMENTS_PER_RANGE = 4
"""Number of segments of the greatest length in a range. The last segment of a range may end early."""


class FrameRange(NamedTuple):
    """Frames `start` to `stop`, whole segments; `key_frame` is the index of the first segment's key frame.

    `key_frame` is None for a coder without key frames.
    """

    start: int
    stop: int
    key_frame: int | None = None


class EncodedSegment(NamedTuple):
    """The bytes of a segment and of its vibration, its number of frames, and its supported samples.

    `silent_frames` counts the frames that have a force and are decoded without any.
    """

    body: bytes
    vibration: bytes | None
    frame_count: int
    supported: int = 0
    silent_frames: int = 0


def write_voxels(
    writer: TouchWriter, prepared: Prepared, provenance: Mapping[str, str], report: Progress
) -> tuple[int, int]:
    """Write the head and the segments of a medium; the number of supported samples, and of silent frames."""
    medium, spec = prepared.medium, prepared.spec
    made = coded = supported = silent_frames = 0

    def on_made(count: int) -> None:
        nonlocal made
        made = count
        report((made + coded) // 2, len(medium))  # making and coding a frame count half each

    encoder = field_encoder(medium.grid, prepared.coding)
    writer.write_head(file_head(prepared, encoder), provenance)
    inputs = chain.from_iterable(
        segment_inputs(medium, spec, encoder, frame_range, start_fields, on_made)
        for frame_range, start_fields in frame_ranges(medium, spec, encoder)
    )
    segments = encode_segments(encoder, medium.vibration is not None, inputs)
    for segment in write_segments(writer, segments):
        coded += segment.frame_count
        supported += segment.supported
        silent_frames += segment.silent_frames
        on_made(made)
    return supported, silent_frames


def frame_ranges(
    medium: HapticMedium, spec: EncodeSpec, encoder: FieldEncoder
) -> Iterator[tuple[FrameRange, tuple[ForceField, ForceField] | None]]:
    """Cut a medium into ranges; yield each with its first frame and key frame, if these had to be made.

    A range keeps the key frame of the range before it if that is as good for its first frame
    (`KeyFrameEncoder.key_frame`).
    """
    length, longest = spec.segment_frames_at(medium.rate_hz), spec.longest_segment_at(medium.rate_hz)
    range_frames = SEGMENTS_PER_RANGE * -(-longest // length) * length
    key_frame, key_frame_index = None, 0
    for start in range(0, len(medium), range_frames):
        stop = min(start + range_frames, len(medium))
        if not isinstance(encoder, KeyFrameEncoder):
            yield FrameRange(start, stop), None
            continue
        first = medium[start]
        chosen = encoder.key_frame(first, key_frame)
        if chosen is first:
            key_frame, key_frame_index = first, start
        yield FrameRange(start, stop, key_frame_index), (first, chosen)


def _start_fields(medium: HapticMedium, frame_range: FrameRange) -> tuple[ForceField, ForceField | None]:
    """The first frame of a range and its key frame, which may be the same field."""
    first = medium[frame_range.start]
    if frame_range.key_frame is None:
        return first, None
    if frame_range.key_frame == frame_range.start:
        return first, first
    return first, medium[frame_range.key_frame]


def segment_inputs(
    medium: HapticMedium,
    spec: EncodeSpec,
    encoder: FieldEncoder,
    frame_range: FrameRange,
    start_fields: tuple[ForceField, ForceField] | None = None,
    on_made: Callable[[int], None] = lambda count: None,
) -> Iterator[SegmentInput]:
    """Yield the frames of a range segment by segment, each small enough for memory while it is coded.

    A frame that is the same object as the one before does not count towards the segment's length; the length
    with such frames is bounded by `EncodeSpec.longest_segment_at`. `start_fields` are the first frame and the
    key frame, if they exist already; ``on_made(count)`` gets the number of frames of the medium made so far.
    """
    length, longest = spec.segment_frames_at(medium.rate_hz), spec.longest_segment_at(medium.rate_hz)
    first, key_frame = start_fields or _start_fields(medium, frame_range)
    frames: list[ForceField] = []
    band: list[VibrationFrame] = []
    size = counted = 0
    later_frames = (medium[i] for i in range(frame_range.start + 1, frame_range.stop))
    for i, frame in enumerate(chain([first], later_frames), frame_range.start):
        if not frames or frame is not frames[-1]:
            counted += 1
            size += frame.forces_n.nbytes
        frames.append(frame)
        if medium.vibration is not None:
            band.append(medium.vibration(i))
        on_made(i + 1)
        is_full = counted == length or len(frames) == longest or size > MAX_SEGMENT_BYTES
        if is_full or i + 1 == frame_range.stop:
            if isinstance(encoder, KeyFrameEncoder):
                key_frame = encoder.key_frame(frames[0], key_frame)
            yield frames, band, key_frame
            frames, band, size, counted = [], [], 0, 0


def encode_segments(
    encoder: FieldEncoder, has_vibration: bool, inputs: Iterable[SegmentInput]
) -> Iterator[EncodedSegment]:
    """Encode each input as a segment, on all cores; the results are in order."""

    def encode(segment_input: SegmentInput) -> EncodedSegment:
        frames, band, key_frame = segment_input
        vibration = encode_vibration(band) if has_vibration else None
        if isinstance(encoder, KeyFrameEncoder):
            segment = encoder.encode_segment(frames, key_frame)
        else:
            segment = encoder.encode_segment(frames)
        supports = [frame.support_count for frame in frames]
        silent_frames = sum(
            support > 0 and not frame.sent for support, frame in zip(supports, segment.frames, strict=True)
        )
        return EncodedSegment(segment.body, vibration, len(frames), sum(supports), silent_frames)

    def field_bytes(segment_input: SegmentInput) -> int:
        return sum(frame.forces_n.nbytes for frame in segment_input[0])

    return in_order(encode, inputs, field_bytes, MAX_PENDING_BYTES)


def write_segments(writer: TouchWriter, segments: Iterable[EncodedSegment]) -> Iterator[EncodedSegment]:
    """Write segments one after the other; yield each once it is written."""
    first_frame = 0
    for segment in segments:
        if segment.vibration is not None:
            writer.write_vibration(first_frame, segment.frame_count, segment.vibration)
        writer.write_segment(first_frame, segment.frame_count, segment.body)
        first_frame += segment.frame_count
        yield segment


def file_head(prepared: Prepared, encoder: FieldEncoder | ObjectsEncoder) -> Head:
    """The head of the file that `encoder` writes of a prepared source."""
    medium, grid, device, placement = (
        prepared.medium,
        prepared.medium.grid,
        prepared.device,
        prepared.placement,
    )
    return Head(
        grid_shape=grid.shape, spacing_m=grid.spacing_m, origin_m=grid.origin_m, rate_hz=medium.rate_hz,
        frame_count=len(medium), axes=medium.axes, device_name=device.name, device_type=device.type,
        force_max_n=device.force_max_n, mapping_scale=placement.scale, mapping_offset_m=placement.offset_m,
        weber_fraction=prepared.spec.k, force_threshold_n=prepared.spec.f0_n, friction=medium.friction,
        damping_n_s_per_m=medium.damping_n_s_per_m, tags=medium.tags, coder=encoder.name,
        coder_parameters=encoder.parameters,
    )  # fmt: skip


def silent_frame_notes(prepared: Prepared, count: int) -> tuple[str, ...]:
    """A note on the frames that have a force and are decoded without any; empty if `count` is 0."""
    if not count:
        return ()
    frames = f"{count} of {len(prepared.medium)} frames"
    note = f"{frames} are decoded without any force: all forces are below --f0-n"
    if prepared.has_law:
        note += " (lower it, or raise --stiffness-n-per-m or --nw)"
    return (note,)
