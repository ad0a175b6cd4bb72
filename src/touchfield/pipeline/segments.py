"""medium -> coder -> segments: the encoding half of figure 4, in independent ranges of frames.

A segment is coded on its own, but its length, and its key frame where the world stands still, depend on the
frames before it. The medium is therefore cut into ranges of whole segments, at frames that follow from its
rate alone. Each range is coded independently of the others, in this process or in another one, to the same
bytes.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple

from touchfield._version import __version__
from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.registry import FieldEncoder, KeyFrameEncoder, field_encoder
from touchfield.codec.vibration import encode_vibration
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Report
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.errors import CorruptFile, InvalidArgument, SourceError, TouchfieldError
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline.preparation import Prepared, prepare
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


ENCODING_LOCK: Final = Lock()
"""A process makes and codes one range at a time, on all of its threads: sources are not thread-safe."""


def worker_path(source: object) -> str:
    """The path by which workers in any folder open a source; InvalidArgument if it is no path."""
    if not isinstance(source, str | Path):
        found = f"a {type(source).__name__}, which stays in its process"
        hint = "Write it first: touchfield.write_field."
        raise InvalidArgument("source", found, "a path, which workers can open", hint)
    path = Path(source)
    return str(path.resolve()) if path.exists() else str(source)


class EncodeTask(NamedTuple):
    """A range to be coded; `job` identifies the file that it belongs to (`job_name`)."""

    job: str
    source: str
    spec: EncodeSpec
    frame_range: FrameRange
    version: str = __version__


class EncodedPart(NamedTuple):
    """The segments of a range, and the notes that its source had once the frames were made."""

    segments: tuple[EncodedSegment, ...]
    notes: tuple[str, ...]


_prepared: dict[str, Prepared] = {}
"""The source that this process codes, by the name of its job; at most one."""


def prepare_once(job: str, source: str, spec: EncodeSpec, version: str) -> Prepared:
    """Prepare the source of a job, once in each process; InvalidArgument if `version` is another one."""
    if version != __version__:
        raise InvalidArgument(
            "a worker", f"touchfield {__version__}", f"{version}, as where the job was started"
        )
    if job not in _prepared:
        _prepared.clear()
        _prepared[job] = prepare(source, spec)
    return _prepared[job]


def encode_part(task: EncodeTask) -> EncodedPart:
    """Encode one range, in this process; run by a worker.

    Memory holds at most the source, a frame and 1 GiB of fields. InvalidArgument if another version sent the
    task.
    """
    with ENCODING_LOCK:
        prepared = prepare_once(task.job, task.source, task.spec, task.version)
        medium = prepared.medium
        encoder = field_encoder(medium.grid, prepared.coding)
        inputs = segment_inputs(medium, task.spec, encoder, task.frame_range)
        segments = tuple(encode_segments(encoder, medium.vibration is not None, inputs))
        return EncodedPart(segments, prepared.learnt)


def encode_with_workers(
    out: Path,
    source: str,
    prepared: Prepared,
    provenance: Mapping[str, str],
    executor: Executor,
    report: Report,
) -> tuple[int, tuple[str, ...]]:
    """Write the voxel representation with the workers of an executor.

    Returns the number of supported samples, and notes. The encoded parts are in the folder ``OUT.parts``
    until the file is complete, and stay there after an error.
    """
    medium = prepared.medium
    encoder = field_encoder(medium.grid, prepared.coding)
    head = file_head(prepared, encoder)
    job = job_name(source, repr(head), dict(provenance))
    parts = _PartFolder(Path(f"{out}.parts"), head, job)
    pending: deque[FrameRange] = deque()
    all_ranges: list[FrameRange] = []

    def tasks() -> Iterator[EncodeTask]:
        ranges = frame_ranges(medium, prepared.spec, encoder)
        while True:
            with ENCODING_LOCK:  # this process may also be a worker
                frame_range = next(ranges, (None,))[0]
            if frame_range is None:
                return
            all_ranges.append(frame_range)
            if not parts.has(frame_range):
                pending.append(frame_range)
                yield EncodeTask(job, source, prepared.spec, frame_range)

    notes: dict[str, None] = {}
    for part in in_order(encode_part, tasks(), executor=executor):
        frame_range = pending.popleft()
        parts.write(frame_range, part)
        notes.update(dict.fromkeys(part.notes))
        report(frame_range.stop, len(medium))
    supported, silent_frames = parts.join(out, all_ranges, provenance)
    parts.remove()
    if parts.reused:
        notes[f"{parts.reused} of {len(all_ranges)} parts were there from an earlier run"] = None
    return supported, (*notes, *silent_frame_notes(prepared, silent_frames))


class _PartFolder:
    """The folder of the encoded parts of one job, a small ``.touch`` file for each range.

    The provenance of a part names its job and its first frame, and has the totals of its segments:
    "supported" samples, and "lost", the frames that are decoded without a force. `reused` counts the parts of
    an earlier run. SourceError if the folder cannot be made.
    """

    def __init__(self, folder: Path, head: Head, job: str) -> None:
        self._folder, self._head, self._job = folder, head, job
        self.reused = 0
        try:
            folder.mkdir(exist_ok=True)
        except OSError as error:
            found = error.strerror or "an error"
            raise SourceError(str(folder), found, "a folder that can be made") from None

    def part(self, frame_range: FrameRange) -> tuple[Path, Head, dict[str, str]]:
        """The file of a range, its head, and the provenance that identifies it."""
        path = self._folder / f"{frame_range.start:010d}.touch"
        head = replace(self._head, frame_count=frame_range.stop - frame_range.start)
        return path, head, {"job": self._job, "first_frame": str(frame_range.start)}

    def has(self, frame_range: FrameRange) -> bool:
        """True if the part exists, belongs to this job and is undamaged; any other is made again."""
        if not self.part(frame_range)[0].exists():
            return False
        with suppress(TouchfieldError):
            for _ in self.read(frame_range):
                pass
            self.reused += 1
            return True
        return False

    def write(self, frame_range: FrameRange, part: EncodedPart) -> None:
        """Write a part."""
        path, head, provenance = self.part(frame_range)
        supported = sum(segment.supported for segment in part.segments)
        silent_frames = sum(segment.silent_frames for segment in part.segments)
        totals = {"supported": str(supported), "lost": str(silent_frames)}
        with TouchWriter(path) as writer:
            writer.write_head(head, {**provenance, **totals})
            for _ in write_segments(writer, part.segments):
                pass

    def read(self, frame_range: FrameRange) -> Iterator[EncodedSegment]:
        """The segments of a part, the first with the totals of all; CorruptFile if a checksum is wrong."""
        path, head, provenance = self.part(frame_range)
        with TouchReader(path) as reader:
            if reader.head != head or not provenance.items() <= reader.provenance.items():
                raise CorruptFile(str(path), "another part, or one of another job", "this one", "Delete it.")
            totals = _totals_of(path, reader.provenance)
            for i, entry in enumerate(reader.segments):
                counts = totals if i == 0 else ()
                body, vibration = reader.read_segment(i), reader.read_vibration(i)
                yield EncodedSegment(body, vibration, entry.frame_count, *counts)

    def join(
        self, out: Path, frame_ranges: list[FrameRange], provenance: Mapping[str, str]
    ) -> tuple[int, int]:
        """Write all parts as one file; the supported samples and the silent frames of all of them."""
        supported = silent_frames = 0
        with TouchWriter(out) as writer:
            writer.write_head(self._head, provenance)
            for segment in write_segments(writer, chain.from_iterable(map(self.read, frame_ranges))):
                supported += segment.supported
                silent_frames += segment.silent_frames
        return supported, silent_frames

    def remove(self) -> None:
        """Remove the folder and all parts."""
        shutil.rmtree(self._folder, ignore_errors=True)


def _totals_of(path: Path, provenance: Mapping[str, str]) -> tuple[int, int]:
    """The totals of a part: supported samples, and silent frames; CorruptFile if it states none."""
    try:
        return int(provenance["supported"]), int(provenance["lost"])
    except (KeyError, ValueError):
        found = ", ".join(f"{key} {str(provenance.get(key))[:40]!r}" for key in ("supported", "lost"))
        expected = "whole numbers: the supported samples and the silent frames of the part"
        raise CorruptFile(str(path), found, expected, "Delete it.") from None


def job_name(source: str, *options: Any) -> str:
    """A name for a job: a hash of its options, its source, and the sizes and times of the source's files."""
    path, state = Path(source), []
    if path.is_dir():
        files = sorted(path.rglob("*"))
    else:
        files = [path] if path.exists() else []
    for file in files:
        status = file.stat()
        state.append((str(file), status.st_size, status.st_mtime_ns))
    return hashlib.sha256(json.dumps([__version__, source, state, *options]).encode()).hexdigest()
