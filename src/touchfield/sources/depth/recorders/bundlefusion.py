"""BundleFusion (Dai et al., TOG 2017) and 3RScan (Wald et al., ICCV 2019): folders with ``info.txt``.

info.txt, _info.txt        lines KEY = VALUE: m_depthShift (stored units in a metre), m_depthWidth,
                           m_depthHeight, m_calibrationDepthIntrinsic and m_calibrationDepthExtrinsic, 4x4
frame-000000.depth.png     16 bits; .pgm in 3RScan
frame-000000.pose.txt      4x4 camera to world; not finite where tracking was lost
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from touchfield.errors import SourceError
from touchfield.sources.depth.intrinsics_file import CameraFile, parse_intrinsics
from touchfield.sources.depth.layouts import Layout, PictureSet
from touchfield.sources.images.pictures import has_files, list_files
from touchfield.sources.poses import floats, read_text

_FRAME: Final = r"frame-\d+\.depth\.(png|pgm)"
_NAMES: Final = ("info.txt", "_info.txt")
_KEYS: Final = ("m_depthWidth", "m_depthHeight", "m_depthShift", "m_calibrationDepthIntrinsic")


def _info_file(path: Path) -> Path | None:
    return next((path / name for name in _NAMES if (path / name).is_file()), None)


def _list_pictures(path: Path) -> PictureSet:
    return PictureSet(list_files(path, _FRAME), path, (path,), (path,))


def _cameras(path: Path, _: tuple[Path, ...], size: tuple[int, int]) -> tuple[CameraFile, ...]:
    file = _info_file(path)
    if file is None:
        raise SourceError(str(path), "no info.txt", f"{' or '.join(_NAMES)}", "Copy it too.")
    lines = (line.partition("=") for line in read_text(file).splitlines())
    info = {key.strip(): value.strip() for key, _, value in lines}
    missing = [key for key in _KEYS if not info.get(key)]
    if missing:
        raise SourceError(str(file), f"no {missing[0]}", ", ".join(_KEYS))
    width, height, units_per_m = floats([info[key] for key in _KEYS[:3]], str(file))
    if (width, height) != size or not units_per_m > 0:
        found = f"{width:g} x {height:g} pixels, {units_per_m:g} units in a metre"
        raise SourceError(str(file), found, f"{size[0]} x {size[1]} pixels, as the pictures have")
    camera = parse_intrinsics(info[_KEYS[3]], f"{file}: {_KEYS[3]}")
    notes: tuple[str, ...] = (
        f"Camera and depth unit ({units_per_m:g} in a metre) are those of {file.name}.",
    )
    extrinsic = info.get("m_calibrationDepthExtrinsic", "")
    numbers = floats(extrinsic.split(), str(file))
    if numbers and (len(numbers) != 16 or not np.allclose(numbers, np.eye(4).ravel(), atol=1e-6)):
        notes += (f"m_calibrationDepthExtrinsic in {file.name} is not used: poses are taken as the depth's.",)
    return (CameraFile(camera.intrinsics, units_per_m, notes),)


LAYOUT: Final = Layout(
    "bundlefusion",
    "BundleFusion or 3RScan sequence: a folder with info.txt, frame-NNNNNN.depth.png (.pgm) and .pose.txt",
    lambda path: _info_file(path) is not None and has_files(path, _FRAME),
    _list_pictures,
    cameras=_cameras,
)
KIND: Final = LAYOUT.kind
