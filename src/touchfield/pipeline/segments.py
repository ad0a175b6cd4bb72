"""medium -> coder -> segments: the encoding half of figure 4, in stretches that do not need each other.

A segment is coded alone, but where it ends, and what it begins with where the world stands, depends on what
is before it. So a medium is cut into stretches of whole segments, at places that only its rate tells; each is
coded without the others, in this process or another, to the same bytes.
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
from touchfield.codec.registry import AnchoringEncoder, FieldEncoder, field_encoder
from touchfield.codec.vibration import encode_vibration
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Report
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.errors import CorruptFile, InvalidArgument, SourceError, TouchfieldError
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.spec import EncodeSpec

Group = tuple[list[ForceField], list["VibrationFrame"], ForceField | None]
"""The frames of one segment; what vibrates in each, none where the medium does not vibrate; and an anchor."""

MOST_BYTES_HELD = (
    1 << 27
)  # a segment ends once its fields take more: eight of the largest are coded at a time
MOST_BYTES_UNDER_WAY = 1 << 30  # no further segment is begun while the fields of those being coded take more

STRETCH = 4
"""Of the longest segments: where a stretch ends, one may end early."""


class Stretch(NamedTuple):
    """Frames of whole segments; of a coder with anchors the frame that the first of them is to begin like."""

    start: int
    stop: int
    anchor: int | None = None


class Coded(NamedTuple):
    """A segment: its bytes, those of what vibrates if anything does, its frames, and its samples with a
    force.
    """

    body: bytes
    vibration: bytes | None
    frames: int
    supported: int = 0
    lost: int = 0  # frames that hold a force and are decoded without any


def stretches(
    medium: HapticMedium, spec: EncodeSpec, encoder: FieldEncoder
) -> Iterator[tuple[Stretch, tuple[ForceField, ForceField] | None]]:
    """The stretches of a medium, each with its first frame and its anchor where these had to be made.

    The anchor of a stretch is that of the one before where its first frame is as good
    (`AnchoringEncoder.anchor`).
    """
    length, longest = spec.segment_frames_at(medium.rate_hz), spec.longest_segment_at(medium.rate_hz)
    each = STRETCH * -(-longest // length) * length
    anchor, place = None, 0
    for start in range(0, len(medium), each):
        stop = min(start + each, len(medium))
        if not isinstance(encoder, AnchoringEncoder):
            yield Stretch(start, stop), None
            continue
        first = medium[start]
        kept = encoder.anchor(first, anchor)
        if kept is first:
            anchor, place = first, start
        yield Stretch(start, stop, place), (first, kept)


def groups_of(
    medium: HapticMedium,
    spec: EncodeSpec,
    encoder: FieldEncoder,
    stretch: Stretch,
    made: tuple[ForceField, ForceField] | None = None,
    tell: Callable[[int], None] = lambda count: None,
) -> Iterator[Group]:
    """The frames of a stretch in groups, each small enough to be held in memory while it is coded.

    A frame that is the very one before does not count to a segment's length, up to that of a world that
    stands. Such a world has an anchor, the field that a segment is to begin with. `made` are the first frame
    and the anchor, where they are there; ``tell(count)`` how many frames of the medium have been made.
    """
    length, longest = spec.segment_frames_at(medium.rate_hz), spec.longest_segment_at(medium.rate_hz)
    first = made[0] if made else medium[stretch.start]
    anchor = made[1] if made else first if stretch.anchor == stretch.start else None
    if made is None and stretch.anchor is not None and anchor is None:
        anchor = medium[stretch.anchor]
    frames: list[ForceField] = []
    band: list[VibrationFrame] = []
    size = counted = 0
    others = (medium[i] for i in range(stretch.start + 1, stretch.stop))
    for i, frame in enumerate(chain([first], others), stretch.start):
        if not frames or frame is not frames[-1]:
            counted += 1
            size += frame.forces_n.nbytes
        frames.append(frame)
        if medium.vibration is not None:
            band.append(medium.vibration(i))
        tell(i + 1)
        is_full = counted == length or len(frames) == longest or size > MOST_BYTES_HELD
        if is_full or i + 1 == stretch.stop:
            if isinstance(encoder, AnchoringEncoder):
                anchor = encoder.anchor(frames[0], anchor)
            yield frames, band, anchor
            frames, band, size, counted = [], [], 0, 0


def coded_segments(encoder: FieldEncoder, vibrates: bool, groups: Iterable[Group]) -> Iterator[Coded]:
    """Each group as a segment, on all cores and in order."""

    def coded(group: Group) -> Coded:
        frames, band, anchor = group
        beside = encode_vibration(band) if vibrates else None
        if isinstance(encoder, AnchoringEncoder):
            segment = encoder.encode_segment(frames, anchor)
        else:
            segment = encoder.encode_segment(frames)
        held = [frame.support_count for frame in frames]
        lost = sum(n > 0 and not one.sent for n, one in zip(held, segment.frames, strict=True))
        return Coded(segment.body, beside, len(frames), sum(held), lost)

    def weight(group: Group) -> int:
        return sum(frame.forces_n.nbytes for frame in group[0])

    return in_order(coded, groups, weight, MOST_BYTES_UNDER_WAY)


def written(writer: TouchWriter, segments: Iterable[Coded]) -> Iterator[Coded]:
    """Each segment once it is written behind those before it."""
    at = 0
    for one in segments:
        if one.vibration is not None:
            writer.write_vibration(at, one.frames, one.vibration)
        writer.write_segment(at, one.frames, one.body)
        at += one.frames
        yield one


def head_of(prepared: Prepared, encoder: FieldEncoder | ObjectsEncoder) -> Head:
    """The head of what was prepared, as it is coded."""
    medium, grid, device, place = prepared.medium, prepared.medium.grid, prepared.device, prepared.placement
    return Head(
        grid_shape=grid.shape, spacing_m=grid.spacing_m, origin_m=grid.origin_m, rate_hz=medium.rate_hz,
        frame_count=len(medium), axes=medium.axes, device_name=device.name, device_type=device.type,
        force_max_n=device.force_max_n, mapping_scale=place.scale, mapping_offset_m=place.offset_m,
        weber_fraction=prepared.spec.k, force_threshold_n=prepared.spec.f0_n, friction=medium.friction,
        damping_n_s_per_m=medium.damping_n_s_per_m, tags=medium.tags, coder=encoder.name,
        coder_parameters=encoder.parameters,
    )  # fmt: skip


def lost_notes(prepared: Prepared, lost: int) -> tuple[str, ...]:
    """A note on frames that hold a force and are decoded without any, if there are such."""
    what = f"In {lost} of {len(prepared.medium)} frames nothing can be felt: every force is below --f0-n"
    mend = " (a lower one, a greater --stiffness-n-per-m or --nw)" if prepared.has_law else ""
    return (what + mend,) if lost else ()


ALONE: Final = Lock()
"""A process makes and codes one stretch at a time, on all of its threads: sources are not made for more."""


def path_of(source: object) -> str:
    """A path as workers in any folder know it; InvalidArgument for what they could not open."""
    if not isinstance(source, str | Path):
        found = f"a {type(source).__name__}, which stays in its process"
        mend = "Write it first: touchfield.write_field."
        raise InvalidArgument("source", found, "a path, which workers can open", mend)
    path = Path(source)
    return str(path.resolve()) if path.exists() else str(source)


class Task(NamedTuple):
    """A stretch to be coded; `job` tells the tasks of one file from those of others."""

    job: str
    source: str
    spec: EncodeSpec
    stretch: Stretch
    version: str = __version__


class Part(NamedTuple):
    """Segments of a stretch, and what was learnt while its frames were made."""

    segments: tuple[Coded, ...]
    notes: tuple[str, ...]


_prepared: dict[str, Prepared] = {}
"""By the name of its job, what this process codes."""


def prepared_here(job: str, source: str, spec: EncodeSpec, version: str) -> Prepared:
    """The source of a job, prepared once in each process; InvalidArgument if another version began the job."""
    if version != __version__:
        raise InvalidArgument(
            "a worker", f"touchfield {__version__}", f"{version}, as where the job was begun"
        )
    if job not in _prepared:
        _prepared.clear()
        _prepared[job] = prepare(source, spec)
    return _prepared[job]


def code_part(task: Task) -> Part:
    """Code a stretch, in whichever process this is.

    At most the source, a frame and 1 GiB of fields are held. InvalidArgument if another version sent the
    task.
    """
    with ALONE:
        prepared = prepared_here(task.job, task.source, task.spec, task.version)
        medium = prepared.medium
        encoder = field_encoder(medium.grid, prepared.coding)
        groups = groups_of(medium, task.spec, encoder, task.stretch)
        return Part(tuple(coded_segments(encoder, medium.vibration is not None, groups)), prepared.learnt)


def spread_voxels(
    out: Path,
    source: str,
    prepared: Prepared,
    provenance: Mapping[str, str],
    executor: Executor,
    report: Report,
) -> tuple[int, tuple[str, ...]]:
    """Write the voxel representation with the workers of an executor; samples with a force, and notes.

    Parts lie in ``OUT.parts`` until the file is whole, and stay there if anything is at fault.
    """
    medium = prepared.medium
    encoder = field_encoder(medium.grid, prepared.coding)
    head = head_of(prepared, encoder)
    job, folder = name_of(source, repr(head), dict(provenance)), Path(f"{out}.parts")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise SourceError(str(folder), error.strerror or "an error", "a folder that can be made") from None
    parts = _Parts(folder, head, job)
    waiting: deque[Stretch] = deque()
    every: list[Stretch] = []

    def tasks() -> Iterator[Task]:
        cut = stretches(medium, prepared.spec, encoder)
        while True:
            with ALONE:  # this process may be a worker, too
                stretch = next(cut, (None,))[0]
            if stretch is None:
                return
            every.append(stretch)
            if not parts.has(stretch):
                waiting.append(stretch)
                yield Task(job, source, prepared.spec, stretch)

    notes: dict[str, None] = {}
    for part in in_order(code_part, tasks(), executor=executor):
        stretch = waiting.popleft()
        parts.write(stretch, part)
        notes.update(dict.fromkeys(part.notes))
        report(stretch.stop, len(medium))
    supported, lost = parts.join(out, every, provenance)
    shutil.rmtree(folder, ignore_errors=True)
    if parts.found:
        notes[f"{parts.found} of {len(every)} parts were there from an earlier run"] = None
    return supported, (*notes, *lost_notes(prepared, lost))


_SUMS: Final = ("supported", "lost")  # of a `Coded`, what a part tells of its segments together


class _Parts:
    """The folder of the parts of one job."""

    def __init__(self, folder: Path, head: Head, job: str) -> None:
        self._folder, self._head, self._job = folder, head, job
        self.found = 0

    def part(self, stretch: Stretch) -> tuple[Path, Head, dict[str, str]]:
        """The file of a stretch, its head, and the least of its provenance."""
        first, story = stretch.start, {"job": self._job, "first_frame": str(stretch.start)}
        return (
            self._folder / f"{first:010d}.touch",
            replace(self._head, frame_count=stretch.stop - first),
            story,
        )

    def has(self, stretch: Stretch) -> bool:
        """True if the part is there, of this job, and whole; one that is not is made again."""
        if not self.part(stretch)[0].exists():
            return False
        with suppress(TouchfieldError):
            for _ in self.read(stretch):
                pass
            self.found += 1
            return True
        return False

    def write(self, stretch: Stretch, part: Part) -> None:
        path, head, story = self.part(stretch)
        with TouchWriter(path) as writer:
            sums = {name: str(sum(getattr(one, name) for one in part.segments)) for name in _SUMS}
            writer.write_head(head, {**story, **sums})
            for _ in written(writer, part.segments):
                pass

    def read(self, stretch: Stretch) -> Iterator[Coded]:
        """The segments of a part, whose checksums hold; CorruptFile if one does not."""
        path, head, story = self.part(stretch)
        with TouchReader(path) as reader:
            if reader.head != head or not story.items() <= reader.provenance.items():
                raise CorruptFile(str(path), "another part, or one of another job", "this one", "Delete it.")
            sums = [int(reader.provenance[name]) for name in _SUMS]
            for i, entry in enumerate(reader.segments):
                counts = sums if i == 0 else ()
                yield Coded(reader.read_segment(i), reader.read_vibration(i), entry.frame_count, *counts)

    def join(self, out: Path, every: list[Stretch], provenance: Mapping[str, str]) -> list[int]:
        """All parts as one file; of all of them the `_SUMS`."""
        with TouchWriter(out) as writer:
            writer.write_head(self._head, provenance)
            parts = written(writer, chain.from_iterable(map(self.read, every)))
            return [sum(column) for column in zip(*((one.supported, one.lost) for one in parts))]


def name_of(source: str, *asked: Any) -> str:
    """A name for a job: what is asked, of which source, and how that is now."""
    path, state = Path(source), []
    files = sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []
    for file in files:
        state_of = file.stat()
        state.append((str(file), state_of.st_size, state_of.st_mtime_ns))
    return hashlib.sha256(json.dumps([__version__, source, state, *asked]).encode()).hexdigest()
