"""Disparities of a stereo camera in an archive of NumPy.

disparity    (or disparity_px, disp) pixels [height, width] or [frames, height, width]; 0 and not finite are
             unknown
K            (or intrinsics, camera_matrix) 3x3, or fx fy cx cy; else --intrinsics or a file beside it
baseline_m   (or baseline) metres; else --baseline-m
doffs        (or disparity_offset_px) pixels; else --disparity-offset-px, or 0
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.errors import SourceError, as_source_error
from touchfield.medium.stores.npz import NpzArchive
from touchfield.sources.camera import CodedSequence
from touchfield.sources.depth.intrinsics_file import CameraFile, camera_of, parse_intrinsics
from touchfield.sources.depth.inverse_depth import StereoRig, depth_of_disparity
from touchfield.sources.depth.layouts import depth_kind, source_rate
from touchfield.sources.images.pictures import ArrayFrames
from touchfield.sources.options import SourceOptions

_DISPARITIES: Final = ("disparity", "disparity_px", "disp", "disparities")
_CAMERAS: Final = ("K", "intrinsics", "camera_matrix", "cam0")
_BASELINES: Final = ("baseline_m", "baseline")
_OFFSETS: Final = ("doffs", "disparity_offset_px")


def read_archive(path: Path, options: SourceOptions) -> CodedSequence:
    """Read disparities with their camera; ``depth_scale`` stored units are one pixel, by default 1.

    Raises `SourceError` if there is no disparity, camera or baseline, or an array is invalid.
    """
    archive = NpzArchive(path)
    name = _first(archive, _DISPARITIES)
    if name is None:
        found = f"the arrays {', '.join(archive.names) or '(none)'}"
        raise SourceError(str(path), found, f"one of {', '.join(_DISPARITIES)}", "Rename the array.")
    header, where = archive.header(name), f"{path}, array {name}"
    if header.dtype.kind not in "fiu" or len(header.shape) not in (2, 3) or min(header.shape) < 1:
        raise SourceError(where, header.description, "numbers [height, width] or [frames, height, width]")
    with np.errstate(over="ignore"):  # inf means unknown
        disparity = archive.read(name).astype(np.float64) / (options.depth_scale or 1.0)
    mend = f"Add --baseline-m, or an array {_BASELINES[0]}."
    has_baseline = options.baseline_m is not None or _first(archive, _BASELINES) is not None
    camera = _camera(archive, options, (header.shape[-1], header.shape[-2]), "" if has_baseline else mend)
    baseline_m = _number(archive, _BASELINES) if options.baseline_m is None else options.baseline_m
    offset_px = options.disparity_offset_px
    offset_px = _number(archive, _OFFSETS) if offset_px is None else offset_px
    if baseline_m is None:
        raise SourceError(str(path), "no baseline", "the distance of the two cameras, metres", mend)
    with as_source_error(f"{path}: "):
        rig = StereoRig(camera.intrinsics, baseline_m, offset_px or 0.0)
    metres = partial(depth_of_disparity, rig=rig)
    frames = disparity if disparity.ndim == 3 else disparity[None]
    if not any(metres(frame).any() for frame in frames):
        raise SourceError(where, "no disparity above 0", "a disparity map in pixels")
    rate_hz, notes = source_rate(options), camera.notes
    if camera.distortion is not None:
        notes += (f"{camera.distortion.wording} is not undone: a disparity map is of rectified pictures.",)
    return CodedSequence(str(path), ArrayFrames(frames), metres, rig.intrinsics, rate_hz, notes)


def _first(archive: NpzArchive, names: tuple[str, ...]) -> str | None:
    return next((name for name in names if name in archive.names), None)


def _number(archive: NpzArchive, names: tuple[str, ...]) -> float | None:
    name = _first(archive, names)
    return None if name is None else archive.numbers(name, 1)[0]


def _camera(archive: NpzArchive, options: SourceOptions, size: tuple[int, int], missing: str) -> CameraFile:
    """Return the camera of the options, of the archive, or of a file beside it.

    `missing` says how to add what else is missing, for the error without a camera.
    """
    name = _first(archive, _CAMERAS)
    if name is None or options.intrinsics is not None:
        folders = (archive.path.absolute().parent,)
        return camera_of(str(archive.path), options.intrinsics, folders, size, None, missing)
    numbers = archive.numbers(name, math.prod(archive.header(name).shape))
    stored = parse_intrinsics(" ".join(map(repr, numbers)), f"{archive.path}, array {name}")
    return CameraFile(stored.intrinsics, notes=(f"The camera is the array {name}.", *stored.notes))


def _recognise(path: Path) -> bool:
    if path.suffix.lower() != ".npz" or not path.is_file():
        return False
    return _first(NpzArchive(path), _DISPARITIES) is not None


KIND: Final = depth_kind(
    "disparity-npz",
    "disparities of a stereo camera: .npz with disparity and, unless given as options, K and baseline_m",
    _recognise,
    read_archive,
)
