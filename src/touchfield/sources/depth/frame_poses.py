"""Finds the camera poses that belong to a depth sequence, in files beside it or in those that the user names,
and matches them to its frames.

The poses are those of ``--poses``. Without that option, the first of these is used: a folder ``pose/`` or
``poses/`` with one file for each frame, a file NAME.txt beside each picture, or a text file whose name
matches `_LISTS`. Notes report which poses were read and why a file was rejected, since a wrong pose displaces
the surface.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.options import SourceOptions
from touchfield.sources.poses import (
    IGNORE_POSES,
    PoseList,
    nearest_in_time,
    parse_poses,
    read_pose_file,
    read_text,
    seconds,
)

POSE_TOLERANCE_S: Final = 0.020  # largest time between a frame and its pose
_LISTS: Final = tuple(
    re.compile(form, re.IGNORECASE)
    for form in (
        r"groundtruth\.txt", r"trajectory\.log", r"(camera_?|gt_?)?poses?\.txt", r"traj(ectory)?\.txt",
        r".*(pose|traj|groundtruth|odometry).*\.(txt|log|tum|csv|json)|.*\.gt\.freiburg",
        r"images\.txt", r"transforms\.json",
    )
)  # fmt: skip
_LOOSE: Final = 4  # from this index in `_LISTS` on, the name alone does not prove that a file holds poses
_MODELS: Final = (
    "sparse/0",
    "sparse",
    "colmap",
    "colmap/sparse/0",
)  # locations of a COLMAP model in a folder


class PosedFrames(NamedTuple):
    """Ascending indices of the frames that have a pose, with the poses.

    Without poses, `indices` are those of all frames.

    `poses` are float64 [n, 4, 4], and `notes` are messages for the user. `has_quaternions` as of `PoseList`.
    """

    indices: tuple[int, ...]
    poses: Float64s | None
    notes: tuple[str, ...]
    has_quaternions: bool = False


class _Match(NamedTuple):
    """A pose or None for each frame, a note on them, and the reason why a frame may have none."""

    poses: list[Float64s | None]
    note: str
    reason: str
    has_quaternions: bool = False


class _Frames(NamedTuple):
    """The frames to find poses for; a frame without a name is named by its number."""

    names: tuple[str, ...]
    paths: tuple[Path, ...]
    stamps_s: Float64s | None


def find_poses(
    name: str,
    frames: Sequence[Path] | int,
    options: SourceOptions,
    folders: Sequence[Path],
    stamps_s: Float64s | None = None,
) -> PosedFrames:
    """Find the poses of frames, in the options or in one of `folders`.

    `frames` are the paths of the pictures, or the number of frames in a single file; the frames of a single
    file have no names, and all of them must have poses. `stamps_s` float64 [n] are the times of the frames,
    if their names do not state them; `name` is the name of the source in error messages. Raises `SourceError`
    if poses are invalid, or belong to no frame.
    """
    indices = tuple(range(frames if isinstance(frames, int) else len(frames)))
    if options.frame == "camera":
        return PosedFrames(indices, None, ())
    paths = () if isinstance(frames, int) else tuple(frames)
    targets = _Frames(tuple(p.stem for p in paths) or tuple(map(str, indices)), paths, stamps_s)
    match, unread = _find_match(targets, options, folders)
    if match is None:
        note = "No poses: the camera is assumed to be static (--poses FILE)."
        return PosedFrames(indices, None, (note, *unread))
    posed = drop_unposed(name, match.poses, match.reason, needs_all=not paths)
    notes = (*posed.notes, match.note, *unread)
    return posed._replace(notes=notes, has_quaternions=match.has_quaternions)


def drop_unposed(
    name: str, poses: Sequence[Float64s | None], reason: str, needs_all: bool = False
) -> PosedFrames:
    """Drop the frames without a pose, with a note: their surface would be displaced."""
    indices = tuple(i for i, pose in enumerate(poses) if pose is not None)
    present, count = [pose for pose in poses if pose is not None], len(poses)
    if not indices or (needs_all and len(indices) < count):
        amount = f"{len(indices)} of {count} frames" if indices else "no frame"
        mend = "Ignore the poses with --frame camera."
        raise SourceError(name, f"{amount} with a pose ({reason})", "poses of these frames", mend)
    notes = (f"{count - len(indices)} of {count} frames left out: {reason}.",) if len(indices) < count else ()
    return PosedFrames(indices, np.stack(present), notes)


def _find_match(
    frames: _Frames, options: SourceOptions, folders: Sequence[Path]
) -> tuple[_Match | None, tuple[str, ...]]:
    """Return the poses to use, and a note for each file that is named like poses but was rejected."""
    if options.poses is not None:
        path = Path(options.poses)
        if path.is_dir():
            return _match_folder(path, frames), ()
        if not path.is_file():
            raise InvalidArgument(
                "--poses", repr(options.poses[:80]), "a file or folder of poses that is there"
            )
        return _match_list(path, frames), ()
    match = _match_folders(folders, frames) if frames.paths else None
    search_folders = [*folders, *(folder / model for folder in folders for model in _MODELS)]
    files: dict[Path, Path] = {}  # by resolved path; a file of an earlier folder replaces that of a later one
    for folder in reversed(search_folders):
        if folder.is_dir():
            files |= {file.resolve(): file for file in folder.iterdir()}
    ranks: dict[Path, int] = {}
    for rank, form in reversed([*enumerate(_LISTS)]):
        ranks |= {file: rank for file in files.values() if form.fullmatch(file.name)}
    unread: list[str] = []
    for file in sorted(ranks, key=lambda f: (ranks[f], f.name)):
        if match is not None or not file.is_file() or file.name.startswith("."):
            continue
        try:
            match = _match_list(file, frames)
        except SourceError as error:
            if ranks[file] < _LOOSE and frames.paths:
                raise
            unread.append(f"{file.name} was found and not used: {error.found}, expected {error.expected}.")
    return match, tuple(unread[:4])


def _match_folders(folders: Sequence[Path], frames: _Frames) -> _Match | None:
    """Match files of one pose each: in ``pose/`` or ``poses/``, or beside the pictures."""
    for folder in (folder / name for folder in folders for name in ("pose", "poses")):
        if any(folder.glob("*.txt")):
            return _match_folder(folder, frames)
    candidates: list[Path | None] = []
    for path in frames.paths:  # NAME.txt or NAME.pose.txt beside NAME.png or NAME.depth.png
        stem = re.sub(r"[._-]?depth$", "", path.stem, flags=re.IGNORECASE)
        names = (
            f"{path.stem}.txt",
            f"{stem}.txt",
            f"{stem}.pose.txt",
            f"{stem}_pose.txt",
            f"{stem}-pose.txt",
        )
        candidates.append(next((file for name in names if (file := path.with_name(name)).is_file()), None))
    files = [file for file in candidates if file is not None]
    if not files:
        return None
    try:
        read_pose_file(files[0])
    except SourceError:
        if "pose" in files[0].name.lower():
            raise
        return None  # a text file about the picture, without a pose
    return _match_files(f"{files[0].name} and others", candidates)


def _match_folder(folder: Path, frames: _Frames) -> _Match:
    files = sorted(folder.glob("*.txt"))
    indices = _match_by_name(frames.names, [file.name for file in files])
    return _match_files(f"{folder.name}/", [None if i < 0 else files[i] for i in indices])


def _match_files(name: str, files: Sequence[Path | None]) -> _Match:
    """Read files of one pose each, None for a frame without a file."""
    poses = [None if file is None else read_pose_file(file) for file in files]
    return _Match(
        poses, f"Poses of {name}, a file a frame, scene from camera.", "no pose, or tracking was lost"
    )


def _match_list(file: Path, frames: _Frames) -> _Match:
    listed = parse_poses(read_text(file), str(file))
    indices, method, reason = _match_entries(listed, frames, file)
    poses = [None if i < 0 else listed.poses[i] for i in indices]
    note = f"Poses of {file.name}: {listed.form}; {method}."
    return _Match(poses, note, f"{reason} in {file.name}", listed.has_quaternions)


def _match_entries(listed: PoseList, frames: _Frames, file: Path) -> tuple[list[int], str, str]:
    """Return the entry of each frame (-1 for none), the method, and a reason for gaps."""
    count, frame_count = len(listed.poses), len(frames.names)
    if listed.names is not None:
        return _match_by_name(frames.names, listed.names), "matched by the names of pictures", "no entry"
    numbers, times_s = [_frame_number(path.stem) for path in frames.paths], frames.stamps_s
    is_numbered = bool(numbers) and None not in numbers
    if times_s is None and is_numbered:
        times_s = seconds(np.array(numbers, np.float64))
    if listed.times_s is not None and times_s is not None:
        is_counted = frames.stamps_s is None and bool(
            (times_s % 1 == 0).all()
        )  # 0, 1, 2 are counts, not seconds
        if not is_counted or bool((listed.times_s % 1 == 0).all()):
            nearest = nearest_in_time(listed.times_s, times_s, POSE_TOLERANCE_S).tolist()
            if max(nearest) >= 0 or count != frame_count:
                return nearest, "the nearest in time", f"no pose within {POSE_TOLERANCE_S * 1000:.0f} ms"
    if count == frame_count:
        return list(range(count)), "one for each frame, in order", ""
    if listed.times_s is None and is_numbered:
        entry_numbers = range(count) if listed.numbers is None else listed.numbers.tolist()
        if listed.numbers is not None or max(n or 0.0 for n in numbers) < count:
            entries = {float(number): i for i, number in enumerate(entry_numbers)}
            return (
                [entries.get(n or 0.0, -1) for n in numbers],
                "matched by the numbers of frames",
                "no entry",
            )
    expected = "one for each, or frames with a number or time in their names (00012.png, TIME.png)"
    raise SourceError(str(file), f"{count} poses for {frame_count} frames", expected, IGNORE_POSES)


def _match_by_name(frame_names: Sequence[str], names: Sequence[str]) -> list[int]:
    """Return the entry of each frame: the same stem, else the same last number.

    The entry is -1 unless it is unique.
    """
    stems: dict[str, list[int]] = {}
    numbers: dict[float | None, list[int]] = {}
    for i, stem in enumerate(Path(name).stem for name in names):
        stems.setdefault(stem, []).append(i)
        numbers.setdefault(_frame_number(stem), []).append(i)
    numbers.pop(None, None)
    candidates = [stems.get(name) or numbers.get(_frame_number(name)) or [] for name in frame_names]
    return [entries[0] if len(entries) == 1 else -1 for entries in candidates]


def _frame_number(name: str) -> float | None:
    """Return the last number in the name of a frame, 12.5 of ``depth_0012.5``.

    Returns None without a number.
    """
    numbers = re.findall(r"\d+(?:\.\d+)?", name)
    return float(numbers[-1]) if numbers else None
