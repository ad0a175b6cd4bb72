"""The camera poses of the frames of a depth sequence: found, read, and matched to the frames.

Asked for with ``--poses``, or else, the first that is there: a folder ``pose/`` or ``poses/`` with one file a
frame, NAME.txt beside the pictures, or a text named like poses (`_LISTS`). What was read is said, and why a
text was not: a frame in a wrong place is felt in a wrong place.
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

POSE_TOLERANCE_S: Final = 0.020  # a frame takes a pose at most this far from it in time
_LISTS: Final = tuple(
    re.compile(form, re.IGNORECASE)
    for form in (
        r"groundtruth\.txt", r"trajectory\.log", r"(camera_?|gt_?)?poses?\.txt", r"traj(ectory)?\.txt",
        r".*(pose|traj|groundtruth).*\.(txt|log|tum)|.*\.gt\.freiburg", r"images\.txt", r"transforms\.json",
    )
)  # fmt: skip
_LOOSE: Final = 4  # of `_LISTS`: from here on only named like poses, so that it may be something else
_MODELS: Final = ("sparse/0", "sparse", "colmap", "colmap/sparse/0")  # places of a COLMAP model in a folder


class PlacedFrames(NamedTuple):
    """The frames that have a pose, ascending (all where there are none); the poses, float64 [n, 4, 4]; and
    notes.
    """

    kept: tuple[int, ...]
    poses: Float64s | None
    notes: tuple[str, ...]


class _Match(NamedTuple):
    """A pose or None for each frame, a note on them, and why a frame may have none."""

    poses: list[Float64s | None]
    note: str
    why: str


class _Frames(NamedTuple):
    """The frames that poses are wanted for; their names are their numbers where they have none."""

    names: tuple[str, ...]
    paths: tuple[Path, ...]
    stamps_s: Float64s | None


def placed_frames(
    name: str,
    frames: Sequence[Path] | int,
    options: SourceOptions,
    folders: Sequence[Path],
    stamps_s: Float64s | None = None,
) -> PlacedFrames:
    """The poses of frames: those asked for, or those that lie in one of the folders.

    `frames` are the pictures, or how many frames a file has, which have no names and must all have poses;
    `stamps_s` float64 [n] their times, where names do not tell them; `name` is theirs in an error. Raises
    `SourceError` if poses are at fault, or belong to no frame.
    """
    everything = tuple(range(frames if isinstance(frames, int) else len(frames)))
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


def posed_frames(
    name: str, poses: Sequence[Float64s | None], why: str, needs_all: bool = False
) -> PlacedFrames:
    """Leave out the frames without a pose, and say so: a frame that is not placed would be felt in a wrong
    place.
    """
    kept = tuple(i for i, pose in enumerate(poses) if pose is not None)
    present, count = [pose for pose in poses if pose is not None], len(poses)
    if not kept or (needs_all and len(kept) < count):
        amount = f"{len(kept)} of {count} frames" if kept else "no frame"
        mend = "Ignore the poses with --frame camera."
        raise SourceError(name, f"{amount} with a pose ({why})", "poses of these frames", mend)
    lost = (f"{count - len(kept)} of {count} frames left out: {why}.",) if len(kept) < count else ()
    return PlacedFrames(kept, np.stack(present), lost)


def _match(
    frames: _Frames, options: SourceOptions, folders: Sequence[Path]
) -> tuple[_Match | None, tuple[str, ...]]:
    """The poses that are used, and a note for each text that is named like poses and is not."""
    if options.poses is not None:
        asked = Path(options.poses)
        if asked.is_dir():
            return _of_folder(asked, frames), ()
        if not asked.is_file():
            raise InvalidArgument(
                "--poses", repr(options.poses[:80]), "a file or folder of poses that is there"
            )
        return _of_list(asked, frames), ()
    match = _of_folders(folders, frames) if frames.paths else None
    places = [*folders, *(folder / model for folder in folders for model in _MODELS)]
    files = {
        file.resolve(): file for folder in reversed(places) if folder.is_dir() for file in folder.iterdir()
    }
    ranks = {
        f: i for i, form in reversed([*enumerate(_LISTS)]) for f in files.values() if form.fullmatch(f.name)
    }
    unread: list[str] = []
    for file in sorted(ranks, key=lambda f: (ranks[f], f.name)):
        if match is not None or not file.is_file() or file.name.startswith("."):
            continue
        try:
            match = _of_list(file, frames)
        except SourceError as error:
            if ranks[file] < _LOOSE and frames.paths:
                raise
            unread.append(f"{file.name} was found and not used: {error.found}, expected {error.expected}.")
    return match, tuple(unread[:4])


def _of_folders(folders: Sequence[Path], frames: _Frames) -> _Match | None:
    """Poses of one file a frame: in ``pose/`` or ``poses/``, or beside the pictures."""
    for folder in (folder / name for folder in folders for name in ("pose", "poses")):
        if any(folder.glob("*.txt")):
            return _of_folder(folder, frames)
    beside: list[Path | None] = []
    for path in frames.paths:  # NAME.txt or NAME.pose.txt beside NAME.png or NAME.depth.png
        stem = re.sub(r"[._-]?depth$", "", path.stem, flags=re.IGNORECASE)
        names = (
            f"{path.stem}.txt",
            f"{stem}.txt",
            f"{stem}.pose.txt",
            f"{stem}_pose.txt",
            f"{stem}-pose.txt",
        )
        beside.append(next((file for name in names if (file := path.with_name(name)).is_file()), None))
    files = [file for file in beside if file is not None]
    if not files:
        return None
    try:
        read_pose_file(files[0])
    except SourceError:
        if "pose" in files[0].name.lower():
            raise
        return None  # words about the picture
    return _of_files(f"{files[0].name} and others", beside)


def _of_folder(folder: Path, frames: _Frames) -> _Match:
    files = sorted(folder.glob("*.txt"))
    indices = _by_name(frames.names, [file.name for file in files])
    return _of_files(f"{folder.name}/", [None if i < 0 else files[i] for i in indices])


def _of_files(name: str, files: Sequence[Path | None]) -> _Match:
    """The poses of a file a frame, None where there is none."""
    poses = [None if file is None else read_pose_file(file) for file in files]
    return _Match(
        poses, f"Poses of {name}, a file a frame, scene from camera.", "no pose, or tracking was lost"
    )


def _of_list(file: Path, frames: _Frames) -> _Match:
    listed = parse_poses(read_text(file), str(file))
    indices, how, why = _matched(listed, frames, file)
    poses = [None if i < 0 else listed.poses[i] for i in indices]
    return _Match(poses, f"Poses of {file.name}: {listed.form}; {how}.", f"{why} in {file.name}")


def _matched(listed: PoseList, frames: _Frames, file: Path) -> tuple[list[int], str, str]:
    """The entry of each frame, -1 for none; how they were matched, and why one may have none."""
    count, wanted = len(listed.poses), len(frames.names)
    if listed.names is not None:
        return _by_name(frames.names, listed.names), "matched by the names of pictures", "no entry"
    numbers, times_s = [_frame_number(path.stem) for path in frames.paths], frames.stamps_s
    is_numbered = bool(numbers) and None not in numbers
    if times_s is None and is_numbered:
        times_s = seconds(np.array(numbers, np.float64))
    if listed.times_s is not None and times_s is not None:
        is_counted = frames.stamps_s is None and bool((times_s % 1 == 0).all())  # 0, 1, 2 are no seconds
        if not is_counted or bool((listed.times_s % 1 == 0).all()):
            nearest = nearest_in_time(listed.times_s, times_s, POSE_TOLERANCE_S).tolist()
            if max(nearest) >= 0 or count != wanted:
                return nearest, "the nearest in time", f"no pose within {POSE_TOLERANCE_S * 1000:.0f} ms"
    if count == wanted:
        return list(range(count)), "one for each frame, in order", ""
    if listed.times_s is None and is_numbered:
        known = range(count) if listed.numbers is None else listed.numbers.tolist()
        if listed.numbers is not None or max(n or 0.0 for n in numbers) < count:
            entries = {float(number): i for i, number in enumerate(known)}
            return (
                [entries.get(n or 0.0, -1) for n in numbers],
                "matched by the numbers of frames",
                "no entry",
            )
    expected = "one for each, or frames whose names tell which (00012.png, TIME.png)"
    raise SourceError(str(file), f"{count} poses for {wanted} frames", expected, IGNORE_POSES)


def _by_name(wanted: Sequence[str], names: Sequence[str]) -> list[int]:
    """The entry named like each frame: by its stem, else by its last number, where one alone has it; -1 for
    none.
    """
    stems: dict[str, list[int]] = {}
    numbers: dict[float | None, list[int]] = {}
    for i, stem in enumerate(Path(name).stem for name in names):
        stems.setdefault(stem, []).append(i)
        numbers.setdefault(_frame_number(stem), []).append(i)
    numbers.pop(None, None)
    alike = [stems.get(name) or numbers.get(_frame_number(name)) or [] for name in wanted]
    return [entries[0] if len(entries) == 1 else -1 for entries in alike]


def _frame_number(name: str) -> float | None:
    """The last number in the name of a frame, such as 12.5 of ``depth_0012.5``; None where it has none."""
    numbers = re.findall(r"\d+(?:\.\d+)?", name)
    return float(numbers[-1]) if numbers else None
