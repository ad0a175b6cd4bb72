"""TUM RGB-D sequences (Sturm et al., IROS 2012): ``depth/TIME.png``, ``depth.txt``, ``groundtruth.txt``.

value / 5000 = metres, 0 unknown. Each frame takes the pose nearest in time; frames whose nearest pose is more than
20 ms away are left out, and a note says so. The data set ships no intrinsics file: the published ones of the three
cameras are used where a name says which camera it was.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.folder_contents import contents
from touchfield.sources.folder_sequence import (
    DepthCode,
    FolderSequence,
    Frames,
    common_size,
    has_files,
    is_layout,
    list_files,
    opener,
    rate_of_stamps,
    require_folder,
)
from touchfield.sources.intrinsics_file import CameraFile, camera_of
from touchfield.sources.placed_frames import placed_frames
from touchfield.sources.poses import MAX_TIME_S, read_text
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "read_sequence"]

_UNITS_PER_M: Final = 5000.0
_CAMERAS: Final = {
    "1": Intrinsics(517.3, 516.5, 318.6, 255.3),
    "2": Intrinsics(520.9, 521.0, 325.1, 249.7),
    "3": Intrinsics(535.4, 539.2, 320.1, 247.6),
    "bonn": Intrinsics(542.822841, 542.576870, 315.593520, 237.756098),
    "icl": Intrinsics(481.2, 480.0, 319.5, 239.5),  # fy is -480: its poses are of a mirrored world
}
"""The published intrinsics of freiburg1 to freiburg3, of Bonn's dynamic data set and of ICL-NUIM, for 640 x 480."""

_CAMERA_NAME: Final = re.compile(
    r"(?<![a-z0-9])(?:(?:freiburg|fr)([123])|(bonn|icl)|(?:living_room|office|living)_?(traj)\d)(?![a-z0-9])|(traj)\d_frei"
)
_STAMPED_PNG: Final = r"\d+(\.\d+)?\.png"


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of the TUM RGB-D layout.

    Raises
    ------
    SourceError
        If pictures, poses or the camera are missing or at fault.
    """
    require_folder(path, "TUM RGB-D")
    paths, stamps, notes = _frames(path)
    rate_hz = rate_of_stamps(stamps, options)
    placed = placed_frames(str(path), paths, options, (path,), stamps)
    size = common_size(paths)
    camera = camera_of(str(path), options.intrinsics, (path,), size, _published(path, size))
    frames = Frames(paths, rate_hz, notes=notes).placed(placed, camera)
    code = DepthCode(options.depth_scale or camera.units_per_m or _UNITS_PER_M)
    return FolderSequence(str(path), frames, code, camera.intrinsics, size)


def _frames(path: Path) -> tuple[tuple[Path, ...], NDArray[np.float64], tuple[str, ...]]:
    """The pictures that are there, in order of time, with their time stamps in seconds, and notes."""
    listing = path / "depth.txt"
    if listing.is_file():
        stamped = _listed(listing)
        present = [(stamp, file) for stamp, file in stamped if file.is_file()]
        where, missing = str(listing), len(stamped) - len(present)
    else:
        depth = path / "depth"
        present = [(float(p.stem), p) for p in (list_files(depth, _STAMPED_PNG) if depth.is_dir() else ())]
        where, missing = str(path / "depth"), 0
    if not present:
        found = f"no depth picture that is there, but {contents(path)}"
        raise SourceError(where, found, "depth/TIME.png", "Check the folder.")
    present.sort()
    notes = (f"{len(present)} of the {len(present) + missing} frames in depth.txt are there.",) if missing else ()
    return tuple(file for _, file in present), np.array([stamp for stamp, _ in present]), notes


def _listed(listing: Path) -> list[tuple[float, Path]]:
    """Time stamps and files of ``depth.txt``: lines of ``time filename``."""
    entries = []
    for number, line in enumerate(read_text(listing).splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            stamp, name = float(words[0]), PurePosixPath(words[1])
        except (ValueError, IndexError) as error:
            raise SourceError(f"{listing} line {number}", repr(line[:60]), "a time and a file name") from error
        if not abs(stamp) < MAX_TIME_S or name.is_absolute() or ".." in name.parts:
            raise SourceError(f"{listing} line {number}", repr(line[:60]), "a time, and a file inside the folder")
        entries.append((stamp, listing.parent / name))
    return entries


def _published(path: Path, size: tuple[int, int]) -> CameraFile | None:
    """The published camera of a name, with a note."""
    which = _camera_number(path)
    if which is None or size != (640, 480):
        return None
    k = _CAMERAS[which]
    camera = which if which.isalpha() else f"freiburg{which}"
    note = f"No intrinsics file: the published ones of {camera}, {k.fx}, {k.fy}, {k.cx}, {k.cy}, are used."
    return CameraFile(k, notes=(note,), is_mirrored=which == "icl")


def _camera_number(path: Path) -> str | None:
    """The camera that the folder, one above it or the head of ``depth.txt`` names: one of `_CAMERAS`."""
    listing = path / "depth.txt"
    head = read_text(listing)[:400] if listing.is_file() else ""
    for name in (*reversed(path.absolute().parts), head):
        found = _CAMERA_NAME.search(name.lower())
        if found:
            return found[1] or found[2] or "icl"
    return None


def _recognise(path: Path) -> bool:
    """A list of stamped pictures, or the true poses of pictures stamped in fractions of a second."""
    listed = any((path / name).is_file() for name in ("depth.txt", "associations.txt", "associated.txt"))
    if listed or not (path / "groundtruth.txt").is_file():
        return listed and has_files(path / "depth", _STAMPED_PNG)
    return has_files(path / "depth", r"\d+\.\d+\.png")


KIND = SourceKind(
    "tum",
    "TUM RGB-D sequence: a folder with depth/TIME.png (value/5000 m), depth.txt, groundtruth.txt",
    is_layout(_recognise),
    opener(read_sequence),
)
