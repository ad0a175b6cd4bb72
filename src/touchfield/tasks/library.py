"""Indexes a folder of ``.touch`` files, finds similar ones, and compares media with each other and with a
video (paper section 4).

A library is stored as the file of `MediumIndex` with an additional array: size, time and CRC-32 of each file,
and the fault of files that cannot be described.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import shlex
import stat
import time
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.atomic import atomic_path, is_temporary
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.compute.executor_kinds import TaskExecutor
from touchfield.compute.executors import in_order
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError, as_source_error, with_notes
from touchfield.measure.descriptors import Descriptor, descriptor
from touchfield.measure.quantity import FewSamplesWarning
from touchfield.measure.retrieval import MediumIndex, OutdatedIndex, distance, part_distances
from touchfield.measure.similarity import (
    contact_along_rays,
    picture_correlation,
    similarity,
)
from touchfield.medium import HapticMedium
from touchfield.medium.grid import Placement
from touchfield.medium.selection import evenly_spaced, select_frames
from touchfield.medium.stores.npz import NpzArchive
from touchfield.pipeline.partition import SymbolFrames
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.result import Result
from touchfield.pipeline.source import Source, StreamScene, decode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.point_device import BOX_AXES, axes_matrix
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import CAMERA_AXES
from touchfield.tasks.matching import match_medium

MAX_PENDING_BYTES: Final = 1 << 24  # limit of the compressed bytes of files in progress
SAVE_EVERY_S: Final = 5.0  # interval between saves; longer if saving takes more than a twentieth of it
_UNREAD: Final = -1
_MAX_STATE_BYTES: Final = 1 << 29
_HEAD_BYTES: Final = 1 << 12  # which has the start of the first array of an index


@dataclass(frozen=True)
class Entry:
    """State of a file when it was described.

    `fault` is the reason why it could not be described, or "".
    """

    size: int
    mtime_ns: int
    crc: int
    fault: str = ""


@dataclass
class Library:
    """Index of a folder.

    `entries` are those of all files, `rows` the descriptors of those that have one.
    """

    entries: dict[str, Entry] = field(default_factory=dict)
    rows: dict[str, Float64s] = field(default_factory=dict)

    @classmethod
    def load(cls, path: Path) -> Library:
        """Read a file that `save` wrote.

        Raises SourceError if it is not such a file, is damaged, or has another version of the descriptor.
        """
        index, archive = MediumIndex.load(path), NpzArchive(path)
        where, expected = f"{path}, array files", "what `touchfield index` wrote"
        if "files" not in archive.names or archive.header("files").data_bytes > _MAX_STATE_BYTES:
            raise SourceError(where, "no such array, or one that is too large", expected)
        try:
            rows_by_name: dict[str, Any] = json.loads(archive.read("files").tobytes())
            entries = {
                name: Entry(int(s), int(t), int(c), str(f)) for name, (s, t, c, f) in rows_by_name.items()
            }
        except (ValueError, TypeError, OverflowError, AttributeError, RecursionError) as error:
            raise SourceError(where, f"text that cannot be read ({error})", expected) from None
        rows = {name: index[name].values for name in index.names if name in entries}
        return cls(entries, rows)

    def store(self, name: str, entry: Entry, row: Float64s | None) -> None:
        """Store the entry of a file and its descriptor, if any, replacing the previous ones."""
        self.forget(name)
        self.entries[name] = entry
        self.rows |= {} if row is None else {name: row}

    def forget(self, name: str) -> None:
        """Remove a file."""
        self.entries.pop(name, None)
        self.rows.pop(name, None)

    def index(self) -> MediumIndex:
        """Return the descriptors as a searchable index."""
        index = MediumIndex()
        for name in sorted(self.rows):
            index.add(name, Descriptor(self.rows[name]))
        return index

    def save(self, path: Path) -> None:
        """Write the library atomically; equal libraries give equal bytes."""
        entries = {name: astuple(self.entries[name]) for name in sorted(self.entries)}
        with atomic_path(path) as temporary:
            self.index().save(temporary)
            array = np.frombuffer(json.dumps(entries).encode(), np.uint8)
            info = zipfile.ZipInfo("files.npy")
            with zipfile.ZipFile(temporary, "a") as archive, archive.open(info, "w") as stream:
                np.lib.format.write_array(stream, array, version=(1, 0), allow_pickle=False)


def library_path(folder: Path, path: Path | None = None) -> Path:
    """Return the path of a folder's library.

    It is `path`, or FOLDER.index.npz next to the folder.
    """
    resolved = folder.resolve()
    if not resolved.is_dir():
        raise InvalidArgument(str(folder), "no folder", "a folder of .touch files", "Check the path.")
    return path or resolved.parent / f"{resolved.name or 'root'}.index.npz"


@dataclass(frozen=True, kw_only=True)
class Indexed(Result):
    """Counts of one run of `index_folder`.

    ``files`` are ``media`` and ``left_out``, which have a fault; ``media`` are ``described`` in this run and
    ``kept`` from an earlier one. ``gone`` are files that are no longer there.
    """

    path: Path
    library: Library

    @property
    def faults(self) -> dict[str, str]:
        """Faults of the files without descriptor, by name."""
        return {name: entry.fault for name, entry in self.library.entries.items() if entry.fault}


def index_folder(
    folder: str | Path,
    path: Path | None = None,
    report: Progress = silent,
    executor: TaskExecutor | None = None,
) -> Indexed:
    """Index the .touch files in a folder and its subfolders by their descriptors.

    Only changed files are decoded: an entry with the same size and time is kept, and a file with the same
    bytes, even under a new name, gets the existing descriptor. The library is saved every few seconds and
    after an error, so that the next run continues. `path` is the file to write, by default FOLDER.index.npz
    next to the folder. `report` counts files; with `executor` its workers read them. Raises TouchfieldError
    if there is no such folder, or the file cannot be read or written. Damaged .touch files are listed in
    `faults`.
    """
    start_s, folder = time.perf_counter(), Path(folder)
    target = library_path(folder, path)
    before, notes = _library_before(target)
    listing = _list_files(folder)
    files = listing.files
    changed = sorted(
        name
        for name, size_and_time in files.items()
        if not _is_unchanged(before.entries.get(name), size_and_time)
    )
    checks = {name: _crc(folder / name) for name in changed}
    names_by_content = {(e.size, e.crc): name for name, e in before.entries.items() if e.crc != _UNREAD}
    twins = {
        name: names_by_content[files[name][0], crc]
        for name, crc in checks.items()
        if (files[name][0], crc) in names_by_content
    }
    library = Library(dict(before.entries), dict(before.rows))
    for name, twin in twins.items():
        library.store(name, replace(before.entries[twin], mtime_ns=files[name][1]), before.rows.get(twin))
    new_names = [name for name in changed if name not in twins]
    done, saved_s, pause_s = len(files) - len(new_names), time.perf_counter(), SAVE_EVERY_S
    report(done, len(files))
    try:
        resolved = folder.resolve()
        sizes = {resolved / name: files[name][0] for name in new_names}
        results = in_order(describe_file, sizes, sizes.__getitem__, MAX_PENDING_BYTES, executor)
        for name, (values, fault) in zip(new_names, results, strict=True):
            library.store(name, Entry(*files[name], checks[name], fault), values)
            done += 1
            report(done, len(files))
            if time.perf_counter() - saved_s > pause_s:
                start = time.perf_counter()
                library.save(target)
                saved_s = time.perf_counter()
                pause_s = max(SAVE_EVERY_S, 20 * (saved_s - start))
    except BaseException:
        library.save(target)
        raise
    deleted = before.entries.keys() - files.keys()
    for name in deleted:
        library.forget(name)
    if changed or deleted or notes or not target.exists():
        library.save(target)
    described_count = sum(not library.entries[name].fault for name in new_names)
    media = len(library.rows)
    figures = {
        "index": str(target),
        "files": len(files),
        "media": media,
        "left_out": len(files) - media,
        "described": described_count,
        "kept": media - described_count,
        "gone": len(deleted),
        "seconds": time.perf_counter() - start_s,
    }
    notes += listing.notes() + (() if files else (f"no .touch file in {folder} or the folders in it",))
    return Indexed(figures, notes, path=target, library=library)


def _library_before(path: Path) -> tuple[Library, tuple[str, ...]]:
    """Return the library to continue, and notes: an empty one without a file, or for an outdated one."""
    if not path.exists():
        return Library(), ()
    try:
        return Library.load(path), ()
    except OutdatedIndex as error:
        return Library(), (f"{error.where} has {error.found}: every file is described again",)
    except SourceError as error:
        if not _is_damaged_index(path):
            mend = "Delete it, or name another file: --index."
            raise SourceError(error.where, error.found, error.expected, mend) from None
        return Library(), (f"{path} is damaged ({error.found}): every file is described again",)


def _is_damaged_index(path: Path) -> bool:
    """Whether a file that cannot be loaded was written by `Library.save`, and may be replaced.

    An empty file may be, too. A file of another program is not replaced.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError:
        return False
    if not head:
        return path.is_file()
    if not (head.startswith(b"PK\3\4") and b"head.npy" in head and b'"descriptor_version"' in head):
        return False
    try:
        MediumIndex.load(path)
    except SourceError:
        return True
    return "files" in NpzArchive(path).names  # without it, it is an intact index of another program


def _index_command(folder: Path, path: Path | None) -> str:
    """The command that indexes a folder, for a message."""
    arguments = ["touchfield", "index", str(folder), *(() if path is None else ("--index", str(path)))]
    return shlex.join(arguments)


def _count_of(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def describe_file(path: Path) -> tuple[Float64s | None, str]:
    """Return the descriptor of a file, or None and its fault."""
    try:
        return descriptor(decode(path)).values, ""
    except (TouchfieldError, OSError, MemoryError) as error:
        return None, str(error) or type(error).__name__


@dataclass
class _Listing:
    """What a folder contains: size and time of each .touch file by its name, and names that are left out.

    `dangling` are links named .touch whose file is not there, `unfollowed` links to folders that are listed
    by another name or contain the library, `unread` folders that may not be read.
    """

    files: dict[str, tuple[int, int]] = field(default_factory=dict)
    dangling: list[str] = field(default_factory=list)
    unfollowed: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)

    def notes(self) -> tuple[str, ...]:
        """Notes on what is left out."""
        texts = (
            ("link", self.dangling, "to files that are not there, left out"),
            ("link", self.unfollowed, "to folders that are indexed already or contain this one, left out"),
            ("folder", self.unread, "that this user may not read, left out"),
        )
        return tuple(
            f"{_count_of(len(names), noun)} {text}, such as {min(names)}"
            for noun, names, text in texts
            if names
        )


def _list_files(folder: Path) -> _Listing:
    """List the .touch files of a folder and its subfolders, without the temporary files of other runs.

    Links are followed, to files and to folders. Each folder is listed once, by its own name if it has one
    here, so that a cycle of links ends and no link multiplies the files.
    """
    root, listing = os.path.realpath(folder), _Listing()
    listed = {root}

    def is_to_list(path: str) -> bool:
        real = os.path.realpath(path)
        if os.path.islink(path) and (_contains(root, real) or _contains(real, root)):
            return False
        is_new = real not in listed
        listed.add(real)
        return is_new

    def leave_out(error: OSError) -> None:
        listing.unread.append(Path(error.filename).relative_to(folder).as_posix())

    for path, folders, names in os.walk(folder, followlinks=True, onerror=leave_out):
        subfolders, folders[:] = sorted(name for name in folders if not is_temporary(name)), list[str]()
        for name in subfolders:
            subfolder = os.path.join(path, name)
            if is_to_list(subfolder):
                folders.append(name)
            else:
                listing.unfollowed.append(Path(subfolder).relative_to(folder).as_posix())
        for name in names:
            if name.endswith(".touch") and not is_temporary(name):
                _add_file(listing, folder, Path(path, name))
    return listing


def _contains(folder: str, path: str) -> bool:
    """Return True if a folder is `path` or contains it; both are real paths."""
    return Path(path).is_relative_to(folder)


def _add_file(listing: _Listing, folder: Path, path: Path) -> None:
    """Add a file, or a link whose file is not there; pipes and devices are no media."""
    name = path.relative_to(folder).as_posix()
    try:
        status = path.stat()
    except OSError:
        listing.dangling.append(name)
        return
    if stat.S_ISREG(status.st_mode):
        listing.files[name] = status.st_size, status.st_mtime_ns


def _is_unchanged(entry: Entry | None, size_and_time: tuple[int, int]) -> bool:
    return entry is not None and (entry.size, entry.mtime_ns) == size_and_time and entry.crc != _UNREAD


def _crc(path: Path) -> int:
    """Return the CRC-32 of a file; `_UNREAD` if it cannot be read, which `describe_file` then reports."""
    crc = 0
    try:
        with path.open("rb") as stream:
            while part := stream.read(1 << 20):
                crc = zlib.crc32(part, crc)
    except OSError:
        return _UNREAD
    return crc


def search(
    folder: str | Path,
    like: str | Path | HapticMedium,
    count: int = 10,
    weights: Mapping[str, float] | None = None,
    path: Path | None = None,
) -> Result:
    """Find the media of an indexed folder that are most similar to one, the nearest first.

    `like` is a .touch file, in the folder or not, or a medium; a file is not compared with itself. `weights`
    are those of the parts of the descriptor (`MediumIndex.query`; `touchfield.measure.retrieval.ANY_POSE` for
    any pose), and `path` is the library's file. Files that are gone are left out, with a note. Raises
    TouchfieldError if the folder was not indexed, or
    `like` cannot be described.
    """
    folder, target = Path(folder), library_path(Path(folder), path)
    if count < 1:
        raise InvalidArgument("count", f"{count}", "1 or more")
    command = _index_command(folder, path)
    if not target.exists():
        raise SourceError(str(target), "no such file", "the folder's index", f"Make it: {command}")
    library = _library_to_search(target, command)
    files = _list_files(folder).files
    stale = sum(
        not _is_unchanged(library.entries.get(name), size_and_time) for name, size_and_time in files.items()
    )
    notes: tuple[str, ...] = (f"{_count_of(stale, 'file')} changed since: {command}",) if stale else ()
    gone = library.entries.keys() - files.keys()
    if gone:
        notes += (f"{_count_of(len(gone), 'file')} of the index gone and left out: {command}",)
    for name in gone:
        library.forget(name)
    if not library.rows:
        raise SourceError(
            str(target), "no medium that is still there", "at least one", f"Renew it: {command}"
        )
    own_name, resolved = "", folder.resolve()  # the name of a file in the folder
    if not isinstance(like, HapticMedium) and Path(like).resolve().is_relative_to(resolved):
        own_name = Path(like).resolve().relative_to(resolved).as_posix()
    if own_name in library.rows and _is_unchanged(library.entries[own_name], files.get(own_name, (-1, -1))):
        entry = Descriptor(library.rows[own_name])
    else:
        medium = like if isinstance(like, HapticMedium) else decode(like)
        with as_source_error("" if medium is like else f"{like}, "):
            entry = descriptor(medium)
    index = library.index()
    start_s = time.perf_counter()
    nearest = index.query(entry, count + (own_name in library.rows), weights)
    matches = [match for match in nearest if match.name != own_name][:count]
    figures = {"media": len(index), "query_ms": 1e3 * (time.perf_counter() - start_s)}
    rows = [{"rank": n, "name": m.name, "distance": m.distance} for n, m in enumerate(matches, start=1)]
    return Result({**figures, "matches": rows}, notes)


def _library_to_search(path: Path, command: str) -> Library:
    """Load a library; the error of one that can be made anew names the command."""
    try:
        return Library.load(path)
    except SourceError as error:
        if not (isinstance(error, OutdatedIndex) or _is_damaged_index(path)):
            raise
        hint = f"Make it anew: {command}"
        raise SourceError(error.where, error.found, error.expected, hint) from error


def similar(
    first: Source,
    second: Source,
    spec: EncodeSpec | None = None,
    *,
    quantiser: str = "weber:0.25/ico1",
    over: str = "object",
    frames: int = 8,
    report: Progress = silent,
) -> Result:
    """Measure the similarity of two media, by their symbols and by their descriptors.

    Symbols are compared at equal positions, after the second medium is brought to the lattice and the rate of
    the first. ``descriptor_distance`` is the distance by which `search` ranks. Each medium is a path, a
    scene, a medium or a field; `spec` has the options that make a medium of a scene. `quantiser` is Q as
    text, fitted to both media together; it is coarse, so that a small coding error does not count. `over`
    ("voxel" or "object") is mu of NMI and VI; `frames` is the number of frames to compare, evenly spaced over
    those that both have. Raises InvalidArgument if one of them has no force, or an option is unknown.
    """
    if frames < 1:
        raise InvalidArgument("frames to look at", f"{frames}", "1 or more")
    prepared = [prepare(source, spec) for source in (first, second)]
    first_medium, second_medium = (item.medium for item in prepared)
    described: list[Descriptor] = []
    for n, medium in enumerate((first_medium, second_medium)):
        try:
            described.append(descriptor(medium, frames))
        except InvalidArgument as error:
            raise with_notes(error, prepared[n].notes) from None
        report(n + 1, 3)
    matched, notes = match_medium(second_medium, first_medium, name="the second")
    if spec is not None and spec.changed_options():
        notes = (*dict.fromkeys(note for item in prepared for note in item.notes), *notes)
    count = min(len(first_medium), len(matched))
    indices = evenly_spaced(count, frames)
    media = [select_frames(m, indices) for m in (first_medium, matched)]
    quantise = FieldQuantiserSpec.parse(quantiser).fit(itertools.chain(*media))
    first_symbols, second_symbols = (SymbolFrames(m, quantise) for m in media)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)  # each quantity carries the note
        try:
            measured = similarity(first_symbols, second_symbols, over)
        except InvalidArgument as error:
            if error.where != "symbols to compress":
                raise
            measured = similarity(first_symbols, second_symbols, over, compressed=False)
            notes = (*notes, f"no NCD: {error}")
    report(3, 3)
    figures = {
        "descriptor_distance": distance(described[0], described[1]),
        "descriptor_parts": part_distances(described[0], described[1]),
        "frames": len(indices),
    }
    return Result({**measured.summary(), **figures}, notes)


def correlate(
    video: str | Path,
    stream: str | Path,
    *,
    frames: int = 4,
    reading: str = "peak",
    intrinsics: tuple[float, float, float, float] | None = None,
    source_rate_hz: float | None = None,
    report: Progress = silent,
) -> Result:
    """Measure the mutual information of a video's luma and |F| behind each pixel.

    The quantity is I(V;A).

    It is measured at a few times, each with a test against chance.

    The picture covers the lattice as seen from the front. With `intrinsics` it is the picture of a camera at
    the origin of the scene, and |F| is taken along the ray of each pixel. `video` is a video, a GIF, a
    picture or a folder of pictures, `source_rate_hz` its rate if it states none. `frames` is the number of
    times, evenly spaced over the common duration; `reading` is "first" or "peak"
    (`touchfield.measure.correlation`); `intrinsics` are fx, fy, cx, cy in pixels of the video.
    Raises InvalidArgument or SourceError if a file cannot be read, the picture meets no force, or the camera
    does not match the medium.
    """
    if frames < 1:
        raise InvalidArgument("frames to look at", f"{frames}", "1 or more")
    opened = StreamScene(stream)
    medium = opened.stored
    rate = source_rate_hz or (medium.rate_hz if len(medium) else None)
    scene: Any = open_source(video, SourceOptions(kind="saliency", source_rate_hz=rate))
    pictures, rate_hz = scene.maps.pictures, scene.rate_hz
    last = len(medium) - 1
    if pictures.frame_count > 1:
        last = min(last, math.floor((pictures.frame_count - 1) / rate_hz * medium.rate_hz + 1e-9))
    indices = evenly_spaced(last + 1, frames)
    looks: list[dict[str, Any]] = []
    notes: dict[str, None] = {}
    for n in indices:
        at = min(round(n / medium.rate_hz * rate_hz), pictures.frame_count - 1)
        luma = pictures.values(at).astype(np.float64) @ np.array([0.2126, 0.7152, 0.0722])
        rays = _rays(luma.shape, pictures, medium, opened.placement, intrinsics)
        found = picture_correlation(luma, contact_along_rays(medium[n], *rays, reading).amplitudes_n)
        figures = found.summary()
        mutual = figures.pop("mutual")["value"]
        looks.append({"frame": n, "picture": at, "mutual_bits": mutual, **figures})
        notes |= dict.fromkeys(found.mutual.notes)
        report(len(looks), len(indices))
    return Result({"looks": looks}, tuple(notes))


def _rays(
    shape: tuple[int, ...],
    pictures: Any,
    medium: HapticMedium,
    placement: Placement,
    intrinsics: tuple[float, float, float, float] | None,
) -> tuple[Float64s, Float64s]:
    """Return start and end of the ray of each pixel of the reduced picture, in hand metres."""
    height, width = shape
    v, u = np.mgrid[:height, :width] + 0.5
    low, high = (np.asarray(corner) for corner in medium.grid.box_m)
    if intrinsics is None:
        across, ways = [2 * u / width - 1, 1 - 2 * v / height], axes_matrix(BOX_AXES, medium.axes).T
        front, back = (np.stack([*across, np.full(shape, side)], axis=-1) @ ways for side in (1.0, -1.0))
        return (low + high + (high - low) * front) / 2, (low + high + (high - low) * back) / 2
    if medium.axes != CAMERA_AXES:
        raise InvalidArgument(
            "intrinsics", f"a medium whose axes are {medium.axes}", f"one whose are {CAMERA_AXES}"
        )
    fx, fy, cx, cy = intrinsics
    x, y = (u * pictures.size[0] / width - 0.5 - cx) / fx, (v * pictures.size[1] / height - 0.5 - cy) / fy
    first_m, last_m = (float(placement.to_scene(corner)[2]) for corner in (low, high))
    if not last_m > 0:
        raise InvalidArgument("intrinsics", "a workspace behind the camera", "one before it")
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    return placement.to_hand(max(first_m, 0.0) * rays), placement.to_hand(last_m * rays)
