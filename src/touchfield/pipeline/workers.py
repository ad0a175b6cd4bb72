"""Encodes a source with several processes or machines: each codes ranges of frames, and the results are
joined to one file.

A range is coded to the same bytes in any process (`segments`). Its segments are stored as a part, a small
``.touch`` file, until all parts are there.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple

from touchfield._version import __version__
from touchfield.codec.registry import field_encoder
from touchfield.compute.executor_kinds import TaskExecutor
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Progress
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.errors import CorruptFile, InvalidArgument, SourceError, TouchfieldError
from touchfield.pipeline.empty_result import refuse_empty
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.segments import (
    EncodedSegment,
    FrameRange,
    encode_segments,
    file_head,
    frame_ranges,
    segment_inputs,
    silent_frame_notes,
    write_segments,
)
from touchfield.pipeline.spec import EncodeSpec

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
    executor: TaskExecutor,
    report: Progress,
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
    try:
        supported, silent_frames = parts.join(
            out, all_ranges, provenance, lambda *counts: refuse_empty(prepared, *counts)
        )
    except SourceError:  # the same parts would be empty again
        parts.remove()
        raise
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
        self,
        out: Path,
        frame_ranges: list[FrameRange],
        provenance: Mapping[str, str],
        check: Callable[[int, int], None],
    ) -> tuple[int, int]:
        """Write all parts as one file; the supported samples and the silent frames of all of them.

        `check` gets both before the file is complete; no file is left if it raises.
        """
        supported = silent_frames = 0
        with TouchWriter(out) as writer:
            writer.write_head(self._head, provenance)
            for segment in write_segments(writer, chain.from_iterable(map(self.read, frame_ranges))):
                supported += segment.supported
                silent_frames += segment.silent_frames
            check(supported, silent_frames)
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
