"""A plain folder of depth pictures: 16-bit PNG or TIFF directly in it or in ``depth/``, the camera held still.

What no data set's layout tells must be said: how many units are in one metre, and the intrinsics (asked for, or in a
file of the folder). Camera poses may lie as 4x4 matrices in ``pose/NAME.txt``, as in ScanNet's export.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence
from touchfield.sources.folder_sequence import (
    DepthCode,
    FolderSequence,
    Frames,
    common_size,
    drop_unposed,
    has_files,
    is_layout,
    list_files,
    missing_intrinsics,
    opener,
    require_folder,
    source_rate,
)
from touchfield.sources.intrinsics_file import find_intrinsics, resolve_intrinsics
from touchfield.sources.pictures import picture_header
from touchfield.sources.poses import read_pose_file
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "read_sequence", "require_scale"]

_PICTURES: Final = r".+\.(png|tif|tiff)"


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of depth pictures of one size.

    Raises
    ------
    SourceError
        If there is no picture, one is at fault, or the scale or the intrinsics are not known.
    """
    require_folder(path, "depth folder")
    folder = path / "depth" if has_files(path / "depth", _PICTURES) else path
    paths = tuple(list_files(folder, _PICTURES))
    if not paths:
        raise SourceError(str(path), "no depth picture", "16-bit PNG or TIFF here or in depth/", "Check the folder.")
    poses: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    if options.frame == "world" and has_files(path / "pose", r".+\.txt"):
        files = [path / "pose" / f"{file.stem}.txt" for file in paths]
        found = [read_pose_file(file) if file.is_file() else None for file in files]
        paths, poses, notes = drop_unposed(str(path), paths, found, "no pose, or tracking was lost")
    size = common_size(paths)
    units_per_m = require_scale(str(path), options, picture_header(paths[0]).sample)
    intrinsics = resolve_intrinsics(options.intrinsics, (path, folder), size)
    if intrinsics is None:
        raise missing_intrinsics(str(path))
    frames = Frames(paths, source_rate(options), poses, notes)
    return FolderSequence(str(path), frames, DepthCode(units_per_m), intrinsics, size)


def require_scale(name: str, options: SourceOptions, sample: str) -> float:
    """Stored units in one metre: what was asked; 1 for floats, which hold metres by default.

    Raises
    ------
    SourceError
        If the samples are whole numbers and nothing was asked.
    """
    if options.depth_scale is not None:
        return options.depth_scale
    if sample.startswith("float"):
        return 1.0
    raise SourceError(
        name,
        "no depth scale",
        "how many stored units are in one metre",
        "Add --depth-scale, for example 1000 for millimetres.",
    )


def _recognise(path: Path) -> bool:
    if not path.is_dir():
        return False
    inner = has_files(path / "depth", _PICTURES)
    told = inner or "depth" in path.name.lower() or find_intrinsics((path,)) is not None
    folder = path / "depth" if inner else path
    if not (told and has_files(folder, _PICTURES)):
        return False
    first = picture_header(list_files(folder, _PICTURES)[0])
    return first.channels == 1 and first.sample not in ("", "uint8")


KIND = SourceKind(
    "depth-folder",
    "folder of 16-bit depth pictures, here or in depth/ (needs --depth-scale and --intrinsics)",
    is_layout(_recognise),
    opener(read_sequence),
)
