"""Redwood and Open3D sequences: ``depth/*.png`` in millimetres, ``trajectory.log``, intrinsics as JSON.

Sources: redwood-data.org (Choi et al., CVPR 2015) and Open3D's reconstruction system. Without an intrinsics file
the PrimeSense default of Open3D is used, and a note says so.
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
_PRIMESENSE: Final = CameraFile(
    Intrinsics(525.0, 525.0, 319.5, 239.5),
    notes=("No intrinsics file: the PrimeSense default 525, 525, 319.5, 239.5 is used.",),
)
_PICTURES: Final = r".+\.png"
_TRAJECTORY: Final = r"trajectory\.log|.*traj(ectory)?\.(log|txt)"


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of the Redwood layout.

    Entries of the trajectory belong to the pictures in order where there are as many, else by the number that
    names a picture; a picture without an entry is left out, and a note says so.

    Raises
    ------
    SourceError
        If pictures, poses or the camera are missing or at fault.
    """
    require_folder(path, "Redwood")
    depth = path / "depth"
    paths = tuple(list_files(depth, _PICTURES)) if depth.is_dir() else ()
    if not paths:
        raise SourceError(
            str(path), f"no depth/*.png but {contents(path)}", "16-bit depth pictures", "Check the folder."
        )
    placed = placed_frames(str(path), paths, options, (path,))
    size = common_size(paths)
    camera = camera_of(
        str(path), options.intrinsics, (path, depth), size, _PRIMESENSE if size == (640, 480) else None
    )
    frames = Frames(paths, source_rate(options)).placed(placed, camera)
    code = DepthCode(options.depth_scale or camera.units_per_m or _UNITS_PER_M)
    return FolderSequence(str(path), frames, code, camera.intrinsics, size)


def _recognise(path: Path) -> bool:
    return has_files(path, _TRAJECTORY) and has_files(path / "depth", _PICTURES)


KIND = SourceKind(
    "redwood",
    "Redwood or Open3D sequence: a folder with depth/*.png (millimetres) and trajectory.log",
    is_layout(_recognise),
    opener(read_sequence),
)
