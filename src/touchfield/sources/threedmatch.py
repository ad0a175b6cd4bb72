"""3DMatch (Zeng et al., CVPR 2017) and 7-Scenes (Shotton et al., CVPR 2013): ``frame-NNNNNN.depth.png``.

Millimetres, 0 and 65535 unknown; ``frame-NNNNNN.pose.txt`` is 4x4 camera-to-world; ``camera-intrinsics.txt`` (3x3)
lies beside the frames or one folder up. Of a scene that holds ``seq-01``, ``seq-02``, ... the first is read.
7-Scenes ships no intrinsics file: its published default is used, and a note says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

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
    require_folder,
    source_rate,
)
from touchfield.sources.intrinsics_file import CameraFile, camera_of
from touchfield.sources.placed_frames import placed_frames
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "read_sequence"]

_UNITS_PER_M: Final = 1000.0
_SEVEN_SCENES: Final = CameraFile(
    Intrinsics(585.0, 585.0, 320.0, 240.0),
    notes=("No camera-intrinsics.txt: the default of 7-Scenes, 585, 585, 320, 240, is used.",),
)
_PICTURES: Final = r"frame-\d+\.depth\.png"
_PARTS: Final = r"seq-\d+"


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of the 3DMatch or 7-Scenes layout.

    Frames without a pose, or whose pose is not finite (tracking was lost), are left out, and a note says so.

    Raises
    ------
    SourceError
        If pictures, poses or the camera are missing or at fault.
    """
    require_folder(path, "3DMatch")
    folder, notes = _part(path)
    paths = tuple(list_files(folder, _PICTURES))
    if not paths:
        found = f"no frame-NNNNNN.depth.png but {contents(folder)}"
        raise SourceError(str(folder), found, "16-bit depth pictures", "Check the folder.")
    placed = placed_frames(str(folder), paths, options, (folder, path) if folder != path else (folder,))
    size = common_size(paths)
    default = _SEVEN_SCENES if size == (640, 480) else None
    camera = camera_of(str(folder), options.intrinsics, (folder, folder.absolute().parent), size, default)
    frames = Frames(paths, source_rate(options), notes=notes).placed(placed, camera)
    code = DepthCode(options.depth_scale or camera.units_per_m or _UNITS_PER_M)
    return FolderSequence(str(path), frames, code, camera.intrinsics, size)


def _part(path: Path) -> tuple[Path, tuple[str, ...]]:
    """The folder that holds the frames: `path`, or the first of its parts."""
    if has_files(path, _PICTURES):
        return path, ()
    parts = [part for part in list_files(path, _PARTS) if has_files(part, _PICTURES)]
    if not parts:
        return path, ()
    told = (f"The first of {len(parts)} sequences, {parts[0].name}, is read.",) if len(parts) > 1 else ()
    return parts[0], told


def _recognise(path: Path) -> bool:
    return path.is_dir() and has_files(_part(path)[0], _PICTURES)


KIND = SourceKind(
    "3dmatch",
    "3DMatch or 7-Scenes sequence: a folder with frame-NNNNNN.depth.png (millimetres) and .pose.txt",
    is_layout(_recognise),
    opener(read_sequence),
)
