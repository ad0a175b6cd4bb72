"""One medium coded by many workers: stretches of it as tasks, parts in a folder beside the file, and a join.

source -> prepare -> stretches -> worker: prepare, code -> part -> folder -> checks -> file

A worker opens the source itself and makes its own frames, so that only names travel there, and bytes of the stream
back. A part is a ``.touch`` file of its stretch. What a run that was broken off has finished is taken by the next one
of the same job. The file is byte for byte what one process writes.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
import tempfile
from collections import deque
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple

from numpy.typing import ArrayLike

from touchfield._version import __version__
from touchfield.codec.registry import coder, field_encoder
from touchfield.container import Head, TouchReader, TouchWriter
from touchfield.errors import CorruptFile, InvalidArgument, SourceError, TouchfieldError
from touchfield.job.coding import Coded, Stretch, coded_segments, groups_of, head_of, stretches
from touchfield.job.executors import in_order
from touchfield.job.prepare import Prepared, prepare
from touchfield.job.spec import EncodeSpec
from touchfield.job.stream_scene import as_source
from touchfield.medium import ForceField, Grid
from touchfield.parallel import Report

_MOST_NOTES: Final = 40
ALONE: Final = Lock()
"""A process makes and codes one stretch at a time, on all of its threads: sources are not made for more."""


class Sent(NamedTuple):
    """A source that can be sent to a worker: a path, an array with its grid, or a field."""

    source: str | ArrayLike | ForceField
    grid: Grid | None

    @classmethod
    def of(cls, source: object, grid: Grid | None) -> Sent:
        """A path as any folder knows it; InvalidArgument for what cannot be sent."""
        if isinstance(source, str | Path):
            path = Path(source)
            return cls(str(path.resolve()) if path.exists() else str(source), grid)
        if isinstance(source, ForceField) or (grid is not None and not hasattr(source, "make_frame")):
            return cls(source, grid)  # type: ignore[arg-type]
        found = f"a {type(source).__name__}, which stays in its process"
        raise InvalidArgument("source", found, "what workers can open: a path, an array and grid=, or a ForceField")


class Task(NamedTuple):
    """A stretch to be coded; `job` tells the tasks of one file from those of others."""

    job: str
    sent: Sent
    spec: EncodeSpec
    stretch: Stretch
    version: str = __version__


class Part(NamedTuple):
    """Segments of a stretch, and what was learnt while its frames were made."""

    segments: tuple[Coded, ...]
    notes: tuple[str, ...]


_prepared: dict[str, Prepared] = {}
"""By the name of its job, the medium that this process codes."""


def code_part(task: Task) -> Part:
    """Code a stretch, in whichever process this is; the source of a job is prepared once in each.

    At most the source, a frame and 1 GiB of fields are held. InvalidArgument if another version sent the task.
    """
    if task.version != __version__:
        raise InvalidArgument("a worker", f"touchfield {__version__}", f"{task.version}, as where the job was begun")
    with ALONE:
        if task.job not in _prepared:
            _prepared.clear()
            _prepared[task.job] = prepare(as_source(task.sent.source, task.spec.device, task.sent.grid), task.spec)
        prepared = _prepared[task.job]
        medium = prepared.medium
        encoder = field_encoder(medium.grid, prepared.coding)
        groups = groups_of(medium, task.spec, encoder, task.stretch)
        return Part(tuple(coded_segments(encoder, medium.vibration is not None, groups)), prepared.learnt)


def spread_voxels(
    out: Path,
    sent: Sent,
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
    with ExitStack() as stack:
        job = name_of(sent, repr(head), dict(provenance))
        if job is None:  # nobody could tell that it is the same source another time
            folder, job = Path(stack.enter_context(tempfile.TemporaryDirectory())), secrets.token_hex(32)
        else:
            folder = Path(f"{out}.parts")
            _make(folder)
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
                    yield Task(job, sent, prepared.spec, stretch)

        notes: dict[str, None] = {}
        for part in in_order(code_part, tasks(), executor=executor):
            stretch = waiting.popleft()
            parts.write(stretch, part)
            notes.update(dict.fromkeys(part.notes))
            report(stretch.stop, len(medium))
        supported = parts.join(out, every, provenance)
        shutil.rmtree(folder, ignore_errors=True)
    if parts.found:
        notes[f"{parts.found} of {len(every)} parts were there from an earlier run"] = None
    return supported, tuple(notes)


class _Parts:
    """The folder of the parts of one job."""

    def __init__(self, folder: Path, head: Head, job: str) -> None:
        self._folder, self._head, self._job = folder, head, job
        self.found = 0

    def path(self, stretch: Stretch) -> Path:
        return self._folder / f"{stretch.start:010d}.touch"

    def head(self, stretch: Stretch) -> Head:
        return replace(self._head, frame_count=stretch.stop - stretch.start)

    def story(self, stretch: Stretch) -> dict[str, str]:
        return {"job": self._job, "first_frame": str(stretch.start)}

    def has(self, stretch: Stretch) -> bool:
        """True if the part is there, of this job, and whole; one that is not is made again."""
        if not self.path(stretch).exists():
            return False
        with suppress(TouchfieldError):
            for _ in self.read(stretch):
                pass
            self.found += 1
            return True
        return False

    def write(self, stretch: Stretch, part: Part) -> None:
        story = {**self.story(stretch), "supported": str(sum(one.supported for one in part.segments))}
        with TouchWriter(self.path(stretch)) as writer:
            writer.write_head(self.head(stretch), story)
            at = 0
            for one in part.segments:
                if one.vibration is not None:
                    writer.write_vibration(at, one.frames, one.vibration)
                writer.write_segment(at, one.frames, one.body)
                at += one.frames

    def read(self, stretch: Stretch) -> Iterator[Coded]:
        """The segments of a part, whose checksums and promises hold; CorruptFile if one does not."""
        path, kind = self.path(stretch), coder(self._head.coder)
        grid = Grid(self._head.grid_shape, self._head.spacing_m, self._head.origin_m)
        with TouchReader(path) as reader:
            if reader.head != self.head(stretch) or not self.story(stretch).items() <= reader.provenance.items():
                raise CorruptFile(str(path), "another part, or one of another job", "this one", "Delete it.")
            decoder = kind.decoder_class(grid, reader.head.coder_parameters, str(path))
            left = int(reader.provenance["supported"])
            for i, entry in enumerate(reader.segments):
                body = reader.read_segment(i)
                worst = decoder.promise(body).worst_ratio if kind.has_promise else None
                if worst is not None and worst > 1:
                    raise CorruptFile(f"{path} segment {i}", f"a promise that is broken ({worst:g})", "at most 1")
                yield Coded(body, reader.read_vibration(i), entry.frame_count, 0 if i else left)

    def join(self, out: Path, every: list[Stretch], provenance: Mapping[str, str]) -> int:
        """All parts as one file; how many samples hold a force."""
        supported = at = 0
        with TouchWriter(out) as writer:
            writer.write_head(self._head, provenance)
            for stretch in every:
                for one in self.read(stretch):
                    if one.vibration is not None:
                        writer.write_vibration(at, one.frames, one.vibration)
                    writer.write_segment(at, one.frames, one.body)
                    at, supported = at + one.frames, supported + one.supported
        return supported


def name_of(sent: Sent, *asked: Any) -> str | None:
    """A name for a job: what is asked, of which source, and how that is now; None where nobody could tell."""
    if not isinstance(sent.source, str):
        return None
    path, state = Path(sent.source), []
    files = sorted(path.rglob("*")) if path.is_dir() else [path] if path.exists() else []
    for file in files:
        told = file.stat()
        state.append((str(file), told.st_size, told.st_mtime_ns))
    return hashlib.sha256(json.dumps([__version__, sent.source, state, *asked]).encode()).hexdigest()


def _make(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise SourceError(str(folder), error.strerror or "an error", "a folder that can be made") from None
