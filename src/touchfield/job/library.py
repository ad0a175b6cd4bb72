"""A folder of media as a library: filed and searched (paper section 4: "indexing"; 5.1: "data indexing").

The file of a library is that of `MediumIndex` with one array more: of each file its size, time and CRC-32, and what
is wrong with those that cannot be described.
"""

from __future__ import annotations

import json
import time
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError
from touchfield.job.executors import in_order
from touchfield.job.stream_scene import decode
from touchfield.measure.descriptors import Descriptor, descriptor
from touchfield.measure.retrieval import Match, MediumIndex
from touchfield.medium import HapticMedium
from touchfield.medium.atomic import atomic_path
from touchfield.medium.npz import NpzArchive
from touchfield.parallel import Report, silent

MOST_BYTES_UNDER_WAY: Final = 1 << 24
"""No further file is begun while those under way take more, packed."""

SAVE_EVERY_S: Final = 5.0
"""So much work at most is lost by a kill; more where saving itself takes a twentieth of it."""

_READ_BYTES: Final = 1 << 20
_UNREAD: Final = -1
_MOST_STATE_BYTES: Final = 1 << 29


@dataclass(frozen=True)
class Entry:
    """A file as it was when it was described; `fault` tells why it could not be, "" where it could."""

    size: int
    mtime_ns: int
    crc: int
    fault: str = ""


@dataclass
class Library:
    """Index of a folder: `entries` of all its files, and the descriptors of those that have one."""

    entries: dict[str, Entry] = field(default_factory=dict)
    rows: dict[str, Float64s] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Library:
        """Read what `save` wrote.

        SourceError if it is no such file, is damaged, or was made by another version of the descriptor.
        """
        index, archive = MediumIndex.load(path), NpzArchive(path)
        where, expected = f"{path}, array files", "what `touchfield index` wrote"
        if "files" not in archive.names or archive.header("files").data_bytes > _MOST_STATE_BYTES:
            raise SourceError(where, "no such array, or one that is too large", expected)
        try:
            told: dict[str, Any] = json.loads(archive.read("files").tobytes())
            entries = {name: Entry(int(s), int(t), int(c), str(f)) for name, (s, t, c, f) in told.items()}
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            raise SourceError(where, f"text that cannot be read ({error})", expected) from None
        rows = {name: index[name].values for name in index.names if name in entries}
        return cls(entries, rows)

    def file(self, name: str, entry: Entry, row: Float64s | None) -> None:
        """Keep a file, and its descriptor if it has one, in place of what was known of it."""
        self.forget(name)
        self.entries[name] = entry
        if row is not None:
            self.rows[name] = row

    def forget(self, name: str) -> None:
        """Keep nothing of a file."""
        self.entries.pop(name, None)
        self.rows.pop(name, None)

    def index(self) -> MediumIndex:
        """The descriptors, to be searched."""
        index = MediumIndex()
        for name in sorted(self.rows):
            index.add(name, Descriptor(self.rows[name]))
        return index

    def save(self, path: Path) -> None:
        """Write the library, whole or not at all; equal ones give equal bytes."""
        told = {name: astuple(self.entries[name]) for name in sorted(self.entries)}
        with atomic_path(path) as temporary:
            self.index().save(temporary)
            array = np.frombuffer(json.dumps(told).encode(), np.uint8)
            with (
                zipfile.ZipFile(temporary, "a") as archive,
                archive.open(zipfile.ZipInfo("files.npy"), "w") as stream,
            ):
                np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)


def library_path(folder: Path, path: Path | None = None) -> Path:
    """The file of a folder's library: beside it, unless another is named."""
    whole = folder.resolve()
    if not whole.is_dir():
        raise InvalidArgument(str(folder), "no folder", "a folder of .touch files")
    return path or whole.parent / f"{whole.name or 'root'}.index.npz"


@dataclass(frozen=True)
class Indexed:
    """Counts of one run of `index_folder`."""

    path: Path
    library: Library
    described: int
    kept: int
    gone: int
    seconds: float

    @property
    def faults(self) -> dict[str, str]:
        """Faults of the files that are left out, by name."""
        return {name: entry.fault for name, entry in self.library.entries.items() if entry.fault}

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            "index": str(self.path),
            "media": len(self.library.rows),
            "described": self.described,
            "kept": self.kept,
            "gone": self.gone,
            "left_out": len(self.faults),
            "seconds": self.seconds,
        }


def index_folder(
    folder: str | Path, path: Path | None = None, report: Report = silent, executor: Executor | None = None
) -> Indexed:
    """File every .touch file of a folder and its folders under its descriptor; only what changed is decoded.

    A file of the same size and time is kept as it is, and one of the same bytes takes over its descriptor, whatever
    it is called now. What was described is saved every few seconds and after an error, so that the next run goes on.

    `path` is the file to write, FOLDER.index.npz beside the folder unless another is named; `report` counts files;
    with `executor` its workers read them.

    TouchfieldError if there is no such folder, or the file cannot be read or written. A damaged .touch file is told
    in `faults`.
    """
    began, folder = time.perf_counter(), Path(folder)
    target = library_path(folder, path)
    before = Library.load(target) if target.exists() else Library()
    files = {name: (size, mtime) for name, size, mtime in _files(folder)}
    changed = sorted(name for name, told in files.items() if not _same(before.entries.get(name), told))
    checks = {name: _crc(folder / name) for name in changed}
    known = {(e.size, e.crc): name for name, e in before.entries.items() if e.crc != _UNREAD}
    twins = {name: known[files[name][0], crc] for name, crc in checks.items() if (files[name][0], crc) in known}
    kept = Library(dict(before.entries), dict(before.rows))
    for name, twin in twins.items():
        kept.file(name, replace(before.entries[twin], mtime_ns=files[name][1]), before.rows.get(twin))
    fresh = [name for name in changed if name not in twins]
    done, saved, pause = len(files) - len(fresh), time.perf_counter(), SAVE_EVERY_S
    report(done, len(files))
    try:
        results = in_order(
            described, [folder.resolve() / name for name in fresh], _bytes_of, MOST_BYTES_UNDER_WAY, executor
        )
        for name, (values, fault) in zip(fresh, results, strict=True):
            kept.file(name, Entry(*files[name], checks[name], fault), values)
            done += 1
            report(done, len(files))
            if time.perf_counter() - saved > pause:
                start = time.perf_counter()
                kept.save(target)
                saved = time.perf_counter()
                pause = max(SAVE_EVERY_S, 20 * (saved - start))
    except BaseException:
        kept.save(target)
        raise
    gone = before.entries.keys() - files.keys()
    for name in gone:
        kept.forget(name)
    if changed or gone or not target.exists():
        kept.save(target)
    return Indexed(target, kept, len(fresh), len(files) - len(fresh), len(gone), time.perf_counter() - began)


def described(path: Path) -> tuple[Float64s | None, str]:
    """The descriptor of a file, or what is wrong with it."""
    try:
        return descriptor(decode(path)).values, ""
    except (TouchfieldError, OSError, MemoryError) as error:
        return None, str(error) or type(error).__name__


def _bytes_of(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _files(folder: Path) -> Iterator[tuple[str, int, int]]:
    """Name, size and time of every .touch file."""
    for path in folder.rglob("*.touch"):
        if path.is_file():
            told = path.stat()
            yield path.relative_to(folder).as_posix(), told.st_size, told.st_mtime_ns


def _same(entry: Entry | None, told: tuple[int, int]) -> bool:
    return entry is not None and (entry.size, entry.mtime_ns) == told and entry.crc != _UNREAD


def _crc(path: Path) -> int:
    """CRC-32 of a file's bytes; `_UNREAD` where it cannot be read, which its description then tells."""
    crc = 0
    try:
        with path.open("rb") as stream:
            while part := stream.read(_READ_BYTES):
                crc = zlib.crc32(part, crc)
    except OSError:
        return _UNREAD
    return crc


# -- search ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Retrieved:
    """The media of a library that are nearest to one."""

    matches: tuple[Match, ...]
    media: int
    query_ms: float
    notes: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        rows = [{"rank": n, "name": m.name, "distance": m.distance} for n, m in enumerate(self.matches, start=1)]
        return {"media": self.media, "query_ms": self.query_ms, "matches": rows}


def search(
    folder: str | Path,
    like: str | Path | HapticMedium,
    count: int = 10,
    weights: Mapping[str, float] | None = None,
    path: Path | None = None,
) -> Retrieved:
    """The media of an indexed folder that are most like one, the nearest first; a file is not compared with itself.

    `like` is a .touch file, in the folder or not, or a medium; `weights` are those of the parts of the descriptor
    (`MediumIndex.query`; `touchfield.measure.retrieval.ANY_POSE` for any pose), and `path` is the library's file.

    TouchfieldError if the folder was not indexed, or `like` cannot be described.
    """
    folder, target = Path(folder), library_path(Path(folder), path)
    if count < 1:
        raise InvalidArgument("count", f"{count}", "1 or more")
    if not target.exists():
        raise SourceError(str(target), "no such file", "the folder's index", f"Make it: touchfield index {folder}")
    library = Library.load(target)
    files = {name: (size, mtime) for name, size, mtime in _files(folder)}
    stale = sum(not _same(library.entries.get(name), told) for name, told in files.items())
    stale += len(library.entries.keys() - files.keys())
    notes = (f"{stale} files changed since: touchfield index {folder}",) if stale else ()
    own = _name_in(folder, like)
    if own in library.rows and _same(library.entries[own], files.get(own, (-1, -1))):
        entry = Descriptor(library.rows[own])
    else:
        entry = descriptor(like if isinstance(like, HapticMedium) else decode(like))
    index = library.index()
    began = time.perf_counter()
    found = index.query(entry, count + (own in library.rows), weights)
    matches = tuple(match for match in found if match.name != own)[:count]
    return Retrieved(matches, len(index), 1e3 * (time.perf_counter() - began), notes)


def _name_in(folder: Path, like: str | Path | HapticMedium) -> str:
    """The name of a file in the library of a folder; "" for one that lies elsewhere, and for a medium."""
    if isinstance(like, HapticMedium):
        return ""
    try:
        return Path(like).resolve().relative_to(folder.resolve()).as_posix()
    except ValueError:
        return ""
