"""One depth picture: 16-bit PNG or TIFF (with a scale), or NPY or float TIFF (metres unless a scale is given)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence
from touchfield.sources.depth_folder import require_scale
from touchfield.sources.folder_sequence import (
    DepthCode,
    FolderSequence,
    Frames,
    common_size,
    is_layout,
    opener,
    source_rate,
)
from touchfield.sources.intrinsics_file import camera_of
from touchfield.sources.pictures import PICTURE_SUFFIXES, picture_header
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "read_sequence"]


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """One depth picture as a sequence of one frame.

    Raises
    ------
    SourceError
        If the picture is at fault, or the scale or the intrinsics are not known.
    """
    if path.is_dir():
        raise SourceError(str(path), "a folder", "one depth picture", "Name its kind with --as depth-folder.")
    size = common_size([path])
    camera = camera_of(str(path), options.intrinsics, (path.absolute().parent,), size)
    units_per_m = require_scale(str(path), options, picture_header(path).sample, camera)
    frames = Frames((path,), source_rate(options), notes=camera.notes)
    return FolderSequence(str(path), frames, DepthCode(units_per_m), camera.intrinsics, size)


def _recognise(path: Path) -> bool:
    return "depth" in path.name.lower() and path.suffix.lower() in PICTURE_SUFFIXES and path.is_file()


KIND = SourceKind(
    "depth-map",
    "one depth picture named *depth*: 16-bit PNG or TIFF (needs --depth-scale), NPY in metres (--intrinsics)",
    is_layout(_recognise),
    opener(read_sequence),
)
