"""SUN3D sequences (Xiao et al., ICCV 2013), the recordings of the paper's section 5.2 ("hotel barcelona").

``depth/FRAME-MICROSECONDS.png`` with rotated bits, mm = (v >> 3) | (v << 13) in 16 bits; ``intrinsics.txt`` 3x3;
``extrinsics/*.txt`` with the 3x4 camera-to-world matrices of all colour frames, one under the other (of several
files the last is the newest). A depth frame takes the pose of the colour frame nearest in time.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence
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
from touchfield.sources.intrinsics_file import camera_of
from touchfield.sources.placed_frames import POSE_TOLERANCE_S, placed_frames
from touchfield.sources.poses import nearest_in_time, parse_extrinsics, read_text
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

    Posed = tuple[tuple[Path, ...], NDArray[np.float64], tuple[str, ...]]

__all__ = ["KIND", "read_sequence"]

_CODE: Final = DepthCode(1000.0, is_rotated=True)
_PICTURES: Final = r".+\.png"
_EXTRINSICS: Final = r".+\.txt"
_COLOUR: Final = r".+\.(jpg|jpeg|png)"
_STAMP: Final = re.compile(r"\d+-(\d{1,15})")


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of the SUN3D layout.

    Raises
    ------
    SourceError
        If pictures, poses or the camera are missing or at fault, or the poses match neither colour nor depth.
    """
    require_folder(path, "SUN3D")
    depth = path / "depth"
    paths = tuple(list_files(depth, _PICTURES)) if depth.is_dir() else ()
    if not paths:
        raise SourceError(
            str(path), f"no depth/*.png but {contents(path)}", "16-bit depth pictures", "Check the folder."
        )
    rate_hz = rate_of_stamps(_stamps_s(paths), options)
    size = common_size(paths)
    camera = camera_of(str(path), options.intrinsics, (path,), size)
    if options.frame == "world" and options.poses is None and has_files(path / "extrinsics", _EXTRINSICS):
        posed, poses, notes = _posed(path, paths)
        frames = Frames(posed, rate_hz, poses, (*notes, *camera.notes))
    else:
        frames = Frames(paths, rate_hz).placed(placed_frames(str(path), paths, options, (path,)), camera)
    code = _CODE if options.depth_scale is None else DepthCode(options.depth_scale, is_rotated=True)
    return FolderSequence(str(path), frames, code, camera.intrinsics, size)


def _stamps_s(paths: tuple[Path, ...]) -> NDArray[np.float64]:
    """Time stamps in seconds from names FRAME-MICROSECONDS, NaN where a name has none."""
    found = [_STAMP.fullmatch(file.stem) for file in paths]
    return np.array([int(match[1]) * 1e-6 if match else np.nan for match in found])


def _posed(path: Path, paths: tuple[Path, ...]) -> Posed:
    files = list_files(path / "extrinsics", _EXTRINSICS)
    poses = parse_extrinsics(read_text(files[-1]), str(files[-1]))
    colour = tuple(list_files(path / "image", _COLOUR)) if (path / "image").is_dir() else ()
    times, wanted = _stamps_s(colour), _stamps_s(paths)
    if len(colour) == len(poses) and np.isfinite(times).all() and np.isfinite(wanted).all():
        order = np.argsort(times, kind="stable")
        nearest = nearest_in_time(times[order], wanted, POSE_TOLERANCE_S)
        found = [poses[order[i]] if i >= 0 else None for i in nearest]
        return drop_unposed(str(files[-1]), paths, found, "no posed colour frame within 20 ms")
    if len(poses) == len(paths):
        return paths, poses, ()
    raise SourceError(
        str(files[-1]),
        f"{len(poses)} poses for {len(paths)} depth and {len(colour)} colour frames",
        "one for each frame",
        "Copy all frames of the sequence, or ignore the poses with --frame camera.",
    )


def _recognise(path: Path) -> bool:
    return has_files(path / "extrinsics", _EXTRINSICS) and has_files(path / "depth", _PICTURES)


KIND = SourceKind(
    "sun3d",
    "SUN3D sequence: a folder with depth/*.png (rotated bits), intrinsics.txt, extrinsics/*.txt",
    is_layout(_recognise),
    opener(read_sequence),
)
