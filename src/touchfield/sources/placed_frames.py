"""Depth frames with the camera poses that lie beside them: found, read, and matched to the frames.

Asked for with ``--poses``, or else, the first that is there: a folder ``pose/`` or ``poses/`` with one file a frame,
NAME.txt beside the pictures, or a text named like poses (`_LISTS`). What was read is said, and in which convention;
what is named like poses and was not read is said too, with why: a frame in a wrong place is felt in a wrong place.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
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

POSE_TOLERANCE_S: Final = 0.020  # a frame takes a pose at most this far from it in time
_LISTS: Final = tuple(
    re.compile(form, re.IGNORECASE)
    for form in (
        r"groundtruth\.txt", r"trajectory\.log", r"(camera_?|gt_?)?poses?\.txt", r"traj(ectory)?\.txt",
        r".*(pose|traj|groundtruth).*\.(txt|log|tum)|.*\.gt\.freiburg", r"images\.txt", r"transforms\.json",
    )
)  # fmt: skip
_LIKE_POSES: Final = re.compile(
    r".*(pose|traj|groundtruth|odometry|extrinsic).*|images\.(txt|bin)|transforms.*\.json|.*\.freiburg", re.I
)
_PICTURES: Final = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".ply", ".mp4")
_MODELS: Final = ("sparse/0", "sparse", "colmap", "colmap/sparse/0")  # places of a COLMAP model in a folder
_LOOSE: Final = 4  # of `_LISTS`: from here on only named like poses, so that it may be something else
_MOST_NOTES: Final = 4


class PlacedFrames(NamedTuple):
    """The frames that have a pose, ascending (all where there are none); the poses, float64 [n, 4, 4]; and notes."""

    kept: tuple[int, ...]
    poses: Float64s | None
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Frames:
    """The frames that poses are wanted for; their names are their numbers where they have none."""

    names: tuple[str, ...]
    paths: tuple[Path, ...]
    stamps_s: Float64s | None

    def times_s(self) -> Float64s | None:
        """Time stamps: those given, or those that file names hold; None where one holds none."""
        if self.stamps_s is not None or not self.paths:
            return self.stamps_s
        numbers = [frame_number(name) for name in self.names]
        return None if None in numbers else seconds(np.array(numbers, np.float64))


def placed_frames(
    name: str,
    frames: Sequence[Path] | int,
    options: SourceOptions,
    folders: Sequence[Path],
    stamps_s: Float64s | None = None,
) -> PlacedFrames:
    """The poses of frames: those asked for, or those that lie in one of the folders.

    `frames` are the pictures, or how many frames a file has, which have no names and must all have poses; `stamps_s`
    float64 [n] their times, where names do not tell them; `name` is theirs in an error. Raises `SourceError` if poses
    are at fault, or belong to no frame.
    """
    count = frames if isinstance(frames, int) else len(frames)
    everything = tuple(range(count))
    if options.frame == "camera":
        return PlacedFrames(everything, None, ())
    paths = () if isinstance(frames, int) else tuple(frames)
    known = _Frames(tuple(p.stem for p in paths) or tuple(map(str, everything)), paths, stamps_s)
    match, unread = _match(known, options, folders)
    if match is None:
        still = "No poses: the camera is taken to stand still (--poses FILE)."
        return PlacedFrames(everything, None, (still, *unread))
    placed = posed_frames(name, match.poses, match.why, needs_all=not paths)
    return placed._replace(notes=(*placed.notes, match.note, *unread))


def posed_frames(name: str, poses: Sequence[Float64s | None], why: str, needs_all: bool = False) -> PlacedFrames:
    """Leave out the frames without a pose, and say so: a frame that is not placed would be felt in a wrong place."""
    kept = tuple(i for i, pose in enumerate(poses) if pose is not None)
    present, count = [pose for pose in poses if pose is not None], len(poses)
    if not kept or (needs_all and len(kept) < count):
        amount = f"{len(kept)} of {count} frames" if kept else "no frame"
        mend = "Ignore the poses with --frame camera."
        raise SourceError(name, f"{amount} with a pose ({why})", "poses of these frames", mend)
    lost = (f"{count - len(kept)} of {count} frames left out: {why}.",) if len(kept) < count else ()
    return PlacedFrames(kept, np.stack(present), lost)


def frame_number(name: str) -> float | None:
    """The last number in the name of a frame, such as 12.5 of ``depth_0012.5``; None where it has none."""
    numbers = re.findall(r"\d+(?:\.\d+)?", name)
    return float(numbers[-1]) if numbers else None


class _Match(NamedTuple):
    """A pose or None for each frame, a note on them, why a frame may have none, and their files."""

    poses: list[Float64s | None]
    note: str
    why: str
    files: set[Path]


def _match(frames: _Frames, options: SourceOptions, folders: Sequence[Path]) -> tuple[_Match | None, tuple[str, ...]]:
    """The poses that are used, and a note for what is named like poses and is not used."""
    if options.poses is not None:
        asked = Path(options.poses)
        if asked.is_dir():
            return _of_files(f"{asked.name}/", sorted(asked.glob("*.txt")), frames), ()
        if not asked.is_file():
            raise InvalidArgument("--poses", repr(options.poses[:80]), "a file or folder of poses that is there")
        return _of_list(asked, frames), ()
    like = _named_like_poses(folders, frames)
    match, refused = _of_folders(folders, frames), {}
    for file in sorted((f for f in like if _rank(f) is not None), key=lambda f: (_rank(f), f.name)):
        if match is not None:
            break
        try:
            match = _of_list(file, frames)
        except SourceError as error:
            if (_rank(file) or 0) < _LOOSE and frames.paths:
                raise
            refused[file] = f"{error.found}, expected {error.expected}"
    reason = "others are" if match else "only text is, as --poses takes it"
    used = match.files if match else set()
    unread = {f: refused.get(f, reason) for f in like if f not in used and not used.intersection(_inside(f))}
    notes = [f"{f.name} was found and not used: {why}." for f, why in unread.items()]
    if len(notes) > _MOST_NOTES:
        notes[_MOST_NOTES:] = [f"{len(notes) - _MOST_NOTES} more files named like poses were not used."]
    return match, tuple(notes)


def _rank(file: Path) -> int | None:
    """The place in `_LISTS` of what a file is named like."""
    return next((i for i, form in enumerate(_LISTS) if form.fullmatch(file.name) and file.is_file()), None)


def _inside(folder: Path) -> tuple[Path, ...]:
    return tuple(folder.glob("*.txt")) if folder.is_dir() else ()


def _named_like_poses(folders: Sequence[Path], frames: _Frames) -> list[Path]:
    """Files and folders beside the frames that are named like poses, each once."""
    places = [*folders, *(folder / model for folder in folders for model in _MODELS)]
    files: dict[Path, Path] = {}
    for folder in places:
        for file in sorted(folder.iterdir()) if folder.is_dir() else ():
            is_picture = file.suffix.lower() in _PICTURES
            if _LIKE_POSES.fullmatch(file.name) and not is_picture and not file.name.startswith("."):
                files.setdefault(file.resolve(), file)
    for path in frames.paths[:1]:
        files.pop(path.resolve(), None)
        files.pop(path.resolve().parent, None)
    return list(files.values())


def _of_folders(folders: Sequence[Path], frames: _Frames) -> _Match | None:
    """Poses of one file a frame: in ``pose/`` or ``poses/``, or beside the pictures."""
    if not frames.paths:
        return None
    for folder in folders:
        for name in ("pose", "poses"):
            files = sorted((folder / name).glob("*.txt"))
            if files:
                return _of_files(f"{name}/", files, frames)
    beside = [_beside(path) for path in frames.paths]
    first = next((file for file in beside if file is not None), None)
    if first is None:
        return None
    try:
        read_pose_file(first)
    except SourceError:
        if "pose" in first.name.lower():
            raise
        return None  # words about the picture
    poses = [None if file is None else read_pose_file(file) for file in beside]
    return _a_file_each(f"{first.name} and others", poses, {file for file in beside if file is not None})


def _beside(path: Path) -> Path | None:
    """NAME.txt or NAME.pose.txt beside NAME.png or NAME.depth.png."""
    stem = re.sub(r"[._-]?depth$", "", path.stem, flags=re.IGNORECASE)
    names = (f"{path.stem}.txt", f"{stem}.txt", f"{stem}.pose.txt", f"{stem}_pose.txt", f"{stem}-pose.txt")
    return next((file for name in names if (file := path.with_name(name)).is_file()), None)


def _of_files(name: str, files: Sequence[Path], frames: _Frames) -> _Match:
    indices = _by_name(frames.names, [file.name for file in files])
    poses = [None if i < 0 else read_pose_file(files[i]) for i in indices]
    return _a_file_each(name, poses, set(files))


def _a_file_each(name: str, poses: list[Float64s | None], files: set[Path]) -> _Match:
    note = f"Poses of {name}, a file a frame, scene from camera."
    return _Match(poses, note, "no pose, or tracking was lost", files)


def _of_list(file: Path, frames: _Frames) -> _Match:
    listed = parse_poses(read_text(file), str(file))
    indices, how, why = _matched(listed, frames, file)
    poses = [None if i < 0 else listed.poses[i] for i in indices]
    return _Match(poses, f"Poses of {file.name}: {listed.form}; {how}.", f"{why} in {file.name}", {file})


def _matched(listed: PoseList, frames: _Frames, file: Path) -> tuple[list[int], str, str]:
    """The entry of each frame, -1 for none; how they were matched, and why one may have none."""
    count, wanted = len(listed.poses), len(frames.names)
    if listed.names is not None:
        return _by_name(frames.names, listed.names), "matched by the names of pictures", "no entry"
    times_s = frames.times_s()
    if listed.times_s is not None and times_s is not None:
        is_counted = frames.stamps_s is None and bool((times_s % 1 == 0).all())  # 0, 1, 2 are no seconds
        if not is_counted or bool((listed.times_s % 1 == 0).all()):
            nearest = nearest_in_time(listed.times_s, times_s, POSE_TOLERANCE_S).tolist()
            if max(nearest) >= 0 or count != wanted:
                return nearest, "the nearest in time", f"no pose within {POSE_TOLERANCE_S * 1000:.0f} ms"
    if count == wanted:
        return list(range(count)), "one for each frame, in order", ""
    numbers = [frame_number(path.stem) for path in frames.paths]
    if listed.times_s is None and numbers and None not in numbers:
        known = range(count) if listed.numbers is None else listed.numbers.tolist()
        if listed.numbers is not None or max(n or 0.0 for n in numbers) < count:
            entries = {float(number): i for i, number in enumerate(known)}
            return [entries.get(n or 0.0, -1) for n in numbers], "matched by the numbers of frames", "no entry"
    expected = "one for each, or frames whose names tell which (00012.png, TIME.png)"
    raise SourceError(str(file), f"{count} poses for {wanted} frames", expected, IGNORE_POSES)


def _by_name(wanted: Sequence[str], names: Sequence[str]) -> list[int]:
    """The entry named like each frame: by its stem, else by its last number, where one alone has it; -1 for none."""
    stems: dict[str, list[int]] = {}
    numbers: dict[float | None, list[int]] = {}
    for i, stem in enumerate(Path(name).stem for name in names):
        stems.setdefault(stem, []).append(i)
        numbers.setdefault(frame_number(stem), []).append(i)
    numbers.pop(None, None)
    alike = [stems.get(name) or numbers.get(frame_number(name)) or [] for name in wanted]
    return [entries[0] if len(entries) == 1 else -1 for entries in alike]
