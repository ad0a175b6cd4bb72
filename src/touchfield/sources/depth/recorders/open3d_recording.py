"""Recordings of a RealSense or an Azure Kinect that Open3D took apart (its reconstruction system's
``sensors/realsense_recorder.py`` and ``azure_kinect_mkv_reader.py``).

depth/000000.png        16 bits, millimetres, aligned to the colour picture
color/000000.jpg        not read
camera_intrinsic.json   (RealSense) or intrinsic.json (Azure Kinect): width, height, intrinsic_matrix
trajectory.log, .json   poses, if a reconstruction was made; else the camera is taken as fixed

The unit of a RealSense L515 is 0.25 mm: --depth-scale 4000.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from touchfield.sources.depth.layouts import Layout, PictureSet
from touchfield.sources.images.pictures import has_files, list_files
from touchfield.sources.poses import read_text

_FRAME: Final = r".+\.png"
_COLOUR: Final = r".+\.(jpg|jpeg|png)"
_CAMERAS: Final = ("camera_intrinsic.json", "intrinsic.json", "intrinsics.json")


def _list_pictures(path: Path) -> PictureSet:
    notes = ("Millimetres, as Open3D's recorders store depth (--depth-scale).",)
    folders = (path, path / "scene")
    return PictureSet(list_files(path / "depth", _FRAME), path, folders, (path,), notes=notes)


def _recognise(path: Path) -> bool:
    files = (path / name for name in _CAMERAS)
    if not any(file.is_file() and '"intrinsic_matrix"' in read_text(file) for file in files):
        return False
    return has_files(path / "color", _COLOUR) and has_files(path / "depth", _FRAME)


LAYOUT: Final = Layout(
    "open3d",
    "RealSense or Azure Kinect recorded with Open3D: a folder with depth/, color/, (camera_)intrinsic.json",
    _recognise,
    _list_pictures,
    1000.0,
)
KIND: Final = LAYOUT.kind
