"""Disparity maps of a stereo pair: depth = fx * baseline / (disparity + offset).

Sources: Middlebury 2014 (PFM, ``calib.txt`` with cam0, cam1, doffs and a baseline in millimetres), KITTI (16-bit PNG,
256 units a pixel, 0 unknown), and scikit-image's ``stereo_motorcycle``, which is Middlebury's at a quarter of its
size. Disparities that are 0 or not finite are unknown.
"""

from __future__ import annotations

import lzma
import math
import re
import struct
import zipfile
import zlib
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.folder_sequence import DEFAULT_RATE_HZ, DepthCode, is_layout, opener
from touchfield.sources.intrinsics_file import CameraFile, camera_of, parse_intrinsics
from touchfield.sources.pictures import bound_pixels, read_npy_stream, read_picture
from touchfield.sources.poses import read_text
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "DisparitySequence", "StereoRig", "depth_of_disparity", "motorcycle_sequence", "read_sequence"]

_SUFFIXES: Final = (".npy", ".npz", ".pfm", ".png")
_KITTI_UNITS_PER_PX: Final = 256.0
_PFM_HEADER: Final = re.compile(rb"P([fF])\s+(\d{1,9})\s+(\d{1,9})\s+([-+]?[\d.eE+-]{1,20})\s")


@dataclass(frozen=True)
class StereoRig:
    """A rectified stereo pair.

    Attributes
    ----------
    intrinsics : Intrinsics
        Of the camera whose picture the disparity map is of.
    baseline_m : float
        Distance of the two cameras, metres.
    disparity_offset_px : float
        Difference of the principal points (Middlebury's doffs), pixels.
    """

    intrinsics: Intrinsics
    baseline_m: float
    disparity_offset_px: float = 0.0

    def __post_init__(self) -> None:
        if not (self.baseline_m > 0 and math.isfinite(self.baseline_m)):
            raise InvalidArgument("baseline_m", repr(self.baseline_m), "a positive length in metres")
        if not math.isfinite(self.disparity_offset_px):
            raise InvalidArgument("disparity_offset_px", repr(self.disparity_offset_px), "a finite number of pixels")


def depth_of_disparity(disparity_px: NDArray[Any], rig: StereoRig) -> NDArray[np.float32]:
    """Depth in metres, float32, of disparities in pixels; 0 where 0, not finite, or behind the camera."""
    disparity = np.asarray(disparity_px, np.float64)
    known = np.isfinite(disparity) & (disparity > 0)
    shifted = np.where(known, disparity, 1.0) + rig.disparity_offset_px
    known &= shifted > 1e-6  # a millionth of a pixel: beyond any stereo camera
    depth = rig.intrinsics.fx * rig.baseline_m / np.where(known, shifted, 1.0)
    return DepthCode(1.0).metres(np.where(known, depth, 0))


class DisparitySequence(DepthSequence):
    """One disparity map as a sequence of one frame.

    Parameters
    ----------
    name : str
        What to call it in messages.
    disparity_px : float array [height, width]
        Pixels; 0 or not finite where unknown.
    rig : StereoRig
    notes : tuple of str

    Raises
    ------
    SourceError
        If it holds no depth at all.
    """

    def __init__(self, name: str, disparity_px: NDArray[Any], rig: StereoRig, notes: tuple[str, ...] = ()) -> None:
        self.name, self.notes, self.rig = name, notes, rig
        self.intrinsics, self.frame_count, self.rate_hz = rig.intrinsics, 1, DEFAULT_RATE_HZ
        self.height, self.width = disparity_px.shape
        self._depth_m = depth_of_disparity(disparity_px, rig)
        if not self._depth_m.any():
            raise SourceError(name, "no disparity above 0", "a disparity map in pixels")

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        if frame != 0:
            raise InvalidArgument(f"{self.name}, frame", str(frame), "0, the only one")
        return self._depth_m.copy()


def motorcycle_sequence() -> DepthSequence:
    """scikit-image's bundled disparity map "motorcycle" (Middlebury 2014), 741 x 500, about 2 to 5 m.

    Raises
    ------
    MissingExtra
        If scikit-image is not installed.
    """
    try:
        pictures: Any = import_module("skimage.data")
    except ImportError as error:
        raise MissingExtra("the motorcycle scene", "scikit-image", "motorcycle") from error
    try:
        disparity = pictures.stereo_motorcycle()[2]
    except (OSError, ImportError) as error:  # a repackaged scikit-image may have to download its pictures
        raise SourceError("stereo_motorcycle", str(error), "scikit-image with its pictures") from error
    rig = StereoRig(Intrinsics(994.978, 994.978, 311.193, 254.877), 0.193001, 31.086)
    return DisparitySequence("scikit-image stereo_motorcycle", disparity, rig)


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A disparity map: PFM, NPY or NPZ in pixels, or 16-bit PNG with 256 units a pixel (or ``depth_scale``).

    Raises
    ------
    SourceError
        If the file is at fault, or the baseline or the intrinsics are not known.
    """
    disparity = _disparity_px(path, options)
    height, width = disparity.shape
    calibration = _calibration(path, (width, height))
    folders = (path.absolute().parent,)
    default = CameraFile(calibration.intrinsics) if calibration else None
    camera = camera_of(str(path), options.intrinsics, () if default else folders, (width, height), default)
    baseline_m, offset_px = options.baseline_m, options.disparity_offset_px
    notes = camera.notes
    if calibration is not None:
        notes = ("Camera and baseline are those of calib.txt, where nothing else was asked for.",)
        baseline_m = baseline_m or calibration.baseline_m
        offset_px = calibration.disparity_offset_px if offset_px is None else offset_px
    if baseline_m is None:
        raise SourceError(
            str(path), "no baseline", "the distance of the two cameras", "Add --baseline-m, or a calib.txt beside it."
        )
    return DisparitySequence(str(path), disparity, StereoRig(camera.intrinsics, baseline_m, offset_px or 0.0), notes)


def _disparity_px(path: Path, options: SourceOptions) -> NDArray[Any]:
    """The disparities of a file, pixels, float64 [height, width]."""
    try:
        if path.suffix.lower() == ".pfm":
            values = _pfm(path)
        elif path.suffix.lower() == ".npz":
            values = _npz(path)
        else:
            values = read_picture(path)
    except OSError as error:
        raise SourceError(str(path), error.strerror or str(error), "a disparity map") from error
    units_per_px = options.depth_scale or 1.0
    if values.dtype == np.uint8:
        raise SourceError(str(path), "an 8-bit picture", "16-bit PNG, PFM or NPY", "Give the disparity map itself.")
    if path.suffix.lower() == ".png" and options.depth_scale is None:
        units_per_px = _KITTI_UNITS_PER_PX
    with np.errstate(over="ignore"):  # inf means unknown
        return values.astype(np.float64) / units_per_px


def _pfm(path: Path) -> NDArray[np.float32]:
    """A PFM picture: rows from the bottom up, little-endian where its scale is negative."""
    with path.open("rb") as stream:
        header = _PFM_HEADER.match(stream.read(80))
        if header is None or header[1] != b"f":
            raise SourceError(str(path), "no grey PFM picture", "a file that begins with Pf", "Check the file.")
        width, height = int(header[2]), int(header[3])
        try:
            order = "<" if float(header[4]) < 0 else ">"
        except ValueError as error:
            raise SourceError(str(path), f"the PFM scale {header[4]!r}", "a number") from error
        bound_pixels(path, width, height)
        stream.seek(header.end())
        data = stream.read(width * height * 4)
    if len(data) != width * height * 4:
        raise SourceError(str(path), f"{len(data)} bytes of numbers", f"{width * height * 4}", "Copy it again.")
    return np.frombuffer(data, f"{order}f4").reshape(height, width)[::-1].astype(np.float32)


def _npz(path: Path) -> NDArray[Any]:
    """The only array of an NPZ archive, or the one whose name begins with "disp"."""
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
            named = [m for m in members if m.filename.lower().startswith("disp")] or members
            if len(named) != 1:
                found = ", ".join(m.filename[:40] for m in members[:8]) or "no array"
                raise SourceError(str(path), found, 'one array, or one whose name begins with "disp"')
            size = named[0].file_size
            bound_pixels(path, 1, 1, bytes_per_pixel=size)
            with archive.open(named[0]) as stream:
                values = read_npy_stream(stream, size, f"{path}:{named[0].filename[:40]}")
    except (
        zipfile.BadZipFile,
        zlib.error,
        lzma.LZMAError,
        struct.error,
        EOFError,
        RuntimeError,
        ValueError,
    ) as error:
        raise SourceError(str(path), f"a damaged NPZ archive ({error})", "a whole one", "Copy it again.") from error
    if values.ndim != 2 or not values.size:
        raise SourceError(str(path), f"an array of shape {values.shape}", "[height, width]")
    return values


def _calibration(path: Path, size: tuple[int, int]) -> StereoRig | None:
    """What Middlebury's ``calib.txt`` beside the map says; cam1 for a map named disp1."""
    file = path.absolute().parent / "calib.txt"
    if not file.is_file():
        return None
    lines = (line.partition("=") for line in read_text(file).splitlines())
    entries = {key.strip(): value.strip() for key, _, value in lines}
    camera = "cam1" if path.stem.lower().startswith("disp1") else "cam0"
    try:
        stated = (int(entries.get("width", size[0])), int(entries.get("height", size[1])))
        baseline_m, offset_px = float(entries["baseline"]) / 1000, float(entries.get("doffs", "0"))
        matrix = entries[camera]
    except (KeyError, ValueError) as error:
        raise SourceError(str(file), f"no or another {error}", "Middlebury's cam0=, baseline=, doffs=") from error
    if stated != size:
        raise SourceError(str(file), f"a camera of {stated[0]} x {stated[1]} pixels", f"{size[0]} x {size[1]}")
    try:
        return StereoRig(parse_intrinsics(matrix, f"{file}: {camera}").intrinsics, baseline_m, offset_px)
    except InvalidArgument as error:
        raise SourceError(f"{file}: {error.where}", error.found, error.expected) from error


def _recognise(path: Path) -> bool:
    return "disp" in path.name.lower() and path.suffix.lower() in _SUFFIXES and path.is_file()


KIND = SourceKind(
    "disparity",
    "disparity map named *disp*: PFM, NPY, NPZ or 16-bit PNG (needs --baseline-m and --intrinsics, or calib.txt)",
    is_layout(_recognise),
    opener(read_sequence),
)
