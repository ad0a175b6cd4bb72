"""The folders of data sets, as a table: TUM RGB-D, Redwood and Open3D, SUN3D, 3DMatch and 7-Scenes.

A layout says where its pictures lie, what a stored value is, which camera is taken where none is told, and where
times and poses come from; one reader does the rest. Sources: Sturm et al., IROS 2012; Choi et al., CVPR 2015, and
Open3D's reconstruction system; Xiao et al., ICCV 2013 (the paper's section 5.2, "hotel barcelona"); Zeng et al., CVPR
2017, and Shotton et al., CVPR 2013.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.folder_contents import contents
from touchfield.sources.folder_sequence import (
    DepthCode,
    FolderSequence,
    Frames,
    common_size,
    drop_unposed,
    has_files,
    is_layout,
    list_files,
    opener,
    rate_of_stamps,
    require_folder,
)
from touchfield.sources.intrinsics_file import CameraFile, camera_of
from touchfield.sources.placed_frames import POSE_TOLERANCE_S, placed_frames
from touchfield.sources.poses import MAX_TIME_S, nearest_in_time, parse_extrinsics, read_text
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

    Float64s = NDArray[np.float64]

__all__ = ["KINDS", "LAYOUTS", "read_sequence"]

_PNG: Final = r".+\.png"
_STAMPED_PNG: Final = r"\d+(\.\d+)?\.png"
_NUMBERED_PNG: Final = r"frame-\d+\.depth\.png"
_TRAJECTORY: Final = r"trajectory\.log|.*traj(ectory)?\.(log|txt)"
_EXTRINSICS: Final = r".+\.txt"
_VGA: Final = (640, 480)


class Pictures(NamedTuple):
    """The pictures of a sequence, the folder they belong to, their times in seconds or None, and notes."""

    paths: tuple[Path, ...]
    folder: Path
    stamps_s: Float64s | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Layout:
    """A folder of a data set.

    Attributes
    ----------
    title, wording : str
        As an error names the layout, and the pictures that it misses.
    summary : str
        Of the source kind.
    code : DepthCode
        Where nobody says otherwise.
    recognise, pictures : callable
        ``recognise(path)``; ``pictures(path)``, whose paths may be none.
    camera : callable
        ``camera(path, size)``: the published one, or None.
    poses : callable, optional
        ``poses(path, paths)``: those that only this layout has, or None where they are not there.
    """

    title: str
    wording: str
    summary: str
    code: DepthCode
    recognise: Callable[[Path], bool]
    pictures: Callable[[Path], Pictures]
    camera: Callable[[Path, tuple[int, int]], CameraFile | None] = lambda path, size: None
    poses: Callable[[Path, tuple[Path, ...]], tuple[tuple[Path, ...], Float64s, tuple[str, ...]] | None] = (
        lambda path, paths: None
    )


def read_sequence(name: str, path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of the layout `name`.

    Frames without a pose, or whose pose is not finite (tracking was lost), are left out, and a note says so.

    Raises
    ------
    SourceError
        If pictures, poses or the camera are missing or at fault.
    """
    layout = LAYOUTS[name]
    require_folder(path, layout.title)
    paths, folder, stamps_s, told = layout.pictures(path)
    if not paths:
        raise SourceError(
            str(folder), f"no {layout.wording} but {contents(folder)}", "16-bit depth pictures", "Check the folder."
        )
    rate_hz = rate_of_stamps(np.empty(0) if stamps_s is None else stamps_s, options)
    own = None
    if options.frame == "world" and options.poses is None:
        own = layout.poses(path, paths)
    around = tuple(dict.fromkeys((folder, path)))
    times_s = stamps_s if name == "tum" else None
    placed = None if own else placed_frames(str(folder), paths, options, around, times_s)
    size = common_size(paths)
    beside = (*around, folder / "depth", *((folder.absolute().parent,) if name == "3dmatch" else ()))
    camera = camera_of(str(folder), options.intrinsics, beside, size, layout.camera(path, size))
    if own:
        frames = Frames(own[0], rate_hz, own[1], (*own[2], *camera.notes))
    elif placed is not None:
        frames = Frames(paths, rate_hz, notes=told).placed(placed, camera)
    units_per_m = options.depth_scale or camera.units_per_m or layout.code.units_per_m
    code = DepthCode(units_per_m, layout.code.is_rotated)
    return FolderSequence(str(path), frames, code, camera.intrinsics, size)


def _in_depth(path: Path, form: str = _PNG) -> tuple[Path, ...]:
    depth = path / "depth"
    return tuple(list_files(depth, form)) if depth.is_dir() else ()


# -- TUM RGB-D: depth/TIME.png, depth.txt, groundtruth.txt; value / 5000 = metres

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


def _tum_pictures(path: Path) -> Pictures:
    """The pictures that are there, in order of time."""
    listing = path / "depth.txt"
    if listing.is_file():
        stamped = _listed(listing)
        present = [(stamp, file) for stamp, file in stamped if file.is_file()]
        where, missing = listing, len(stamped) - len(present)
    else:
        present = [(float(file.stem), file) for file in _in_depth(path, _STAMPED_PNG)]
        where, missing = path / "depth", 0
    if not present:
        found = f"no depth picture that is there, but {contents(path)}"
        raise SourceError(str(where), found, "depth/TIME.png", "Check the folder.")
    present.sort()
    notes = (f"{len(present)} of the {len(present) + missing} frames in depth.txt are there.",) if missing else ()
    return Pictures(tuple(file for _, file in present), path, np.array([stamp for stamp, _ in present]), notes)


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


def _tum_camera(path: Path, size: tuple[int, int]) -> CameraFile | None:
    """The published camera that the folder, one above it or the head of ``depth.txt`` names, with a note."""
    listing = path / "depth.txt"
    head = read_text(listing)[:400] if listing.is_file() else ""
    names = (_CAMERA_NAME.search(name.lower()) for name in (*reversed(path.absolute().parts), head))
    name = next(filter(None, names), None)
    if name is None or size != _VGA:
        return None
    which = name[1] or name[2] or "icl"
    k, camera = _CAMERAS[which], which if which.isalpha() else f"freiburg{which}"
    note = f"No intrinsics file: the published ones of {camera}, {k.fx}, {k.fy}, {k.cx}, {k.cy}, are used."
    return CameraFile(k, notes=(note,), is_mirrored=which == "icl")


def _is_tum(path: Path) -> bool:
    """A list of stamped pictures, or the true poses of pictures stamped in fractions of a second."""
    listed = any((path / name).is_file() for name in ("depth.txt", "associations.txt", "associated.txt"))
    if listed or not (path / "groundtruth.txt").is_file():
        return listed and has_files(path / "depth", _STAMPED_PNG)
    return has_files(path / "depth", r"\d+\.\d+\.png")


# -- SUN3D: depth/FRAME-MICROSECONDS.png with rotated bits, extrinsics of all colour frames in one file

_COLOUR: Final = r".+\.(jpg|jpeg|png)"
_STAMP: Final = re.compile(r"\d+-(\d{1,15})")


def _stamps_s(paths: tuple[Path, ...]) -> Float64s:
    """Time stamps in seconds from names FRAME-MICROSECONDS, NaN where a name has none."""
    stamps = [_STAMP.fullmatch(file.stem) for file in paths]
    return np.array([int(stamp[1]) * 1e-6 if stamp else np.nan for stamp in stamps])


def _sun3d_poses(path: Path, paths: tuple[Path, ...]) -> tuple[tuple[Path, ...], Float64s, tuple[str, ...]] | None:
    """3x4 camera-to-world of the colour frame nearest in time; of several files the last is the newest."""
    if not has_files(path / "extrinsics", _EXTRINSICS):
        return None
    file = list_files(path / "extrinsics", _EXTRINSICS)[-1]
    poses = parse_extrinsics(read_text(file), str(file))
    colour = tuple(list_files(path / "image", _COLOUR)) if (path / "image").is_dir() else ()
    times, wanted = _stamps_s(colour), _stamps_s(paths)
    if len(colour) == len(poses) and np.isfinite(times).all() and np.isfinite(wanted).all():
        order = np.argsort(times, kind="stable")
        nearest = nearest_in_time(times[order], wanted, POSE_TOLERANCE_S)
        own = [poses[order[i]] if i >= 0 else None for i in nearest]
        return drop_unposed(str(file), paths, own, "no posed colour frame within 20 ms")
    if len(poses) == len(paths):
        return paths, poses, ()
    raise SourceError(
        str(file),
        f"{len(poses)} poses for {len(paths)} depth and {len(colour)} colour frames",
        "one for each frame",
        "Copy all frames of the sequence, or ignore the poses with --frame camera.",
    )


# -- 3DMatch and 7-Scenes: frame-NNNNNN.depth.png, .pose.txt; of a scene of seq-01, seq-02, ... the first


def _numbered(path: Path) -> Pictures:
    folder, notes = path, tuple[str, ...]()
    if not has_files(path, _NUMBERED_PNG):
        parts = [part for part in list_files(path, r"seq-\d+") if has_files(part, _NUMBERED_PNG)]
        folder = parts[0] if parts else path
        if len(parts) > 1:
            notes = (f"The first of {len(parts)} sequences, {parts[0].name}, is read.",)
    return Pictures(tuple(list_files(folder, _NUMBERED_PNG)), folder, notes=notes)


def _default(k: Intrinsics, note: str) -> Callable[[Path, tuple[int, int]], CameraFile | None]:
    """The camera of a kind of sensor, for pictures of 640 x 480."""
    return lambda path, size: CameraFile(k, notes=(note,)) if size == _VGA else None


LAYOUTS: Final = {
    "tum": Layout(
        "TUM RGB-D",
        "depth/TIME.png",
        "TUM RGB-D sequence: a folder with depth/TIME.png (value/5000 m), depth.txt, groundtruth.txt",
        DepthCode(5000.0),
        _is_tum,
        _tum_pictures,
        _tum_camera,
    ),
    "redwood": Layout(
        "Redwood",
        "depth/*.png",
        "Redwood or Open3D sequence: a folder with depth/*.png (millimetres) and trajectory.log",
        DepthCode(1000.0),
        lambda path: (
            has_files(path, r"trajectory\.log|.*traj(ectory)?\.(log|txt)") and has_files(path / "depth", _PNG)
        ),
        lambda path: Pictures(_in_depth(path), path),
        _default(
            Intrinsics(525.0, 525.0, 319.5, 239.5),
            "No intrinsics file: the PrimeSense default 525, 525, 319.5, 239.5 is used.",
        ),
    ),
    "sun3d": Layout(
        "SUN3D",
        "depth/*.png",
        "SUN3D sequence: a folder with depth/*.png (rotated bits), intrinsics.txt, extrinsics/*.txt",
        DepthCode(1000.0, is_rotated=True),
        lambda path: has_files(path / "extrinsics", _EXTRINSICS) and has_files(path / "depth", _PNG),
        lambda path: Pictures(_in_depth(path), path, _stamps_s(_in_depth(path))),
        poses=_sun3d_poses,
    ),
    "3dmatch": Layout(
        "3DMatch",
        "frame-NNNNNN.depth.png",
        "3DMatch or 7-Scenes sequence: a folder with frame-NNNNNN.depth.png (millimetres) and .pose.txt",
        DepthCode(1000.0),
        lambda path: path.is_dir() and bool(_numbered(path).paths),
        _numbered,
        _default(
            Intrinsics(585.0, 585.0, 320.0, 240.0),
            "No camera-intrinsics.txt: the default of 7-Scenes, 585, 585, 320, 240, is used.",
        ),
    ),
}

KINDS: Final = tuple(
    SourceKind(name, layout.summary, is_layout(layout.recognise), opener(partial(read_sequence, name)))
    for name, layout in LAYOUTS.items()
)
