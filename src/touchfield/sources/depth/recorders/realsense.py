"""Pictures that the RealSense viewer exports ("snapshot"; IntelRealSense/librealsense, common/rendering.h).

NAME_Depth.raw            16 bits (Z16), rows of the picture without a head
NAME_Depth_metadata.csv   lines KEY,VALUE: Format, Timestamp (ms), Resolution x and y, Fx, Fy, PPx, PPy, and
                          Distorsion, the model without its coefficients
NAME_Depth.png            a coloured preview, not read

Depth of stereo pairs is computed from rectified pictures and has no distortion. The unit is a millimetre,
unless --depth-scale is given (4000 for an L515).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import SourceError, as_source_error
from touchfield.files import readable
from touchfield.sources.camera import Intrinsics, require_frame
from touchfield.sources.depth.intrinsics_file import CameraFile
from touchfield.sources.depth.layouts import Layout, PictureSet
from touchfield.sources.images.pictures import PictureHeader, has_files, list_files, require_size
from touchfield.sources.poses import floats, read_text

_RAW: Final = r".*depth.*\.raw"
_KEYS: Final = ("Resolution x", "Resolution y", "Fx", "Fy", "PPx", "PPy")
_SUFFIX: Final = "_metadata.csv"


def _metadata(file: Path) -> dict[str, str]:
    """Return the entries of the metadata beside a raw picture."""
    metadata = file.with_name(file.stem + _SUFFIX)
    lines = (line.partition(",") for line in read_text(metadata).splitlines())
    entries = {key.strip(): value.strip() for key, _, value in lines}
    missing = [key for key in _KEYS if not entries.get(key)]
    if missing:
        raise SourceError(str(metadata), f"no {missing[0]}", ", ".join(_KEYS))
    if entries.get("Format", "Z16") != "Z16":
        raise SourceError(str(metadata), f"the format {entries['Format']}", "Z16, depth of 16 bits")
    return entries


class RawFrames:
    """Raw depth pictures of 16 bits, read on demand (`camera.Frames`)."""

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self.paths, self.frame_count = paths, len(paths)
        self.headers = tuple(self._header(file) for file in paths)
        self.size = self.headers[0][:2]
        for file, header in zip(paths, self.headers):
            require_size(str(file), header[:2], self.size, f"as in {paths[0].name}")

    @staticmethod
    def _header(file: Path) -> PictureHeader:
        metadata = _metadata(file)
        width, height = floats([metadata[key] for key in _KEYS[:2]], str(file))
        if not (1 <= width < 1e6 and 1 <= height < 1e6 and width % 1 == height % 1 == 0):
            found = f"{width:g} x {height:g} pixels"
            raise SourceError(f"{file.stem}{_SUFFIX}", found, "the width and height of the picture")
        width, height = int(width), int(height)
        size = file.stat().st_size
        if min(width, height) < 1 or size != 2 * width * height:
            expected = f"{width} x {height} pixels of 2 bytes, as {file.stem}{_SUFFIX} says"
            raise SourceError(str(file), f"{size} bytes", expected, "Copy the file again.")
        return PictureHeader(width, height, "uint16", 1)

    def values(self, frame: int) -> NDArray[Any]:
        """See ``camera.Frames``."""
        require_frame(frame, self.frame_count)
        file = self.paths[frame]
        with readable(file):
            values = np.fromfile(file, "<u2")
        if values.size != self.size[0] * self.size[1]:
            raise SourceError(str(file), f"{values.size} pixels", f"{self.size[0]} x {self.size[1]}")
        return values.astype(np.uint16).reshape(self.size[::-1])


def _list_pictures(path: Path) -> PictureSet:
    paths = tuple(file for file in list_files(path, _RAW) if file.with_name(file.stem + _SUFFIX).is_file())
    if not paths:
        return PictureSet((), path, (path,), (path,))
    stamps = [_metadata(file).get("Timestamp (ms)", "nan") for file in paths]
    times_s = np.array(floats(stamps, str(path))) / 1000
    notes = ("Millimetres, the unit of a RealSense but the L515 (--depth-scale).",)
    return PictureSet((), path, (path,), (path,), times_s, notes, RawFrames(paths))


def _cameras(path: Path, _: tuple[Path, ...], size: tuple[int, int]) -> tuple[CameraFile, ...]:
    file = next(file for file in list_files(path, _RAW) if file.with_name(file.stem + _SUFFIX).is_file())
    metadata, name = _metadata(file), f"{file.stem}{_SUFFIX}"
    with as_source_error(f"{name}: "):
        k = Intrinsics(*floats([metadata[key] for key in _KEYS[2:]], name))
    model = metadata.get("Distorsion", metadata.get("Distortion", "None"))
    return (CameraFile(k, notes=(f"The camera is that of {name} (distortion {model}, no coefficients).",)),)


LAYOUT: Final = Layout(
    "realsense",
    "pictures exported by the RealSense viewer: a folder with NAME_Depth.raw and NAME_Depth_metadata.csv",
    lambda path: has_files(path, _RAW) and has_files(path, r".*depth.*_metadata\.csv"),
    _list_pictures,
    1000.0,
    cameras=_cameras,
)
KIND: Final = LAYOUT.kind
