"""Converts values that are linear in 1/z to depth: stereo disparity, and relative depth as neural networks
estimate it.

*Disparity*: depth = fx * baseline / (disparity + offset). Middlebury 2014 (PFM, ``calib.txt`` with cam0,
cam1, doffs and a baseline in millimetres), KITTI (16-bit PNG, 256 units a pixel, 0 unknown), and
scikit-image's ``stereo_motorcycle``. Values that are 0 or not finite are unknown.

*Relative depth* from monocular estimators (MiDaS: Ranftl et al., TPAMI 2022; Depth Anything: Yang et al.,
CVPR 2024) has no unit. With s from 0 to 1 between the smallest and the largest value of all frames, larger
values being nearer, 1/z = (1 - s)/far + s/near. If larger values of a map are farther away, give a far
distance smaller than the near one.

Such a map belongs to a picture or video by its name (``NAME_depth.png``, ``NAME.depth.png``,
``NAME-depth.npy``, with any text after "depth"), or through ``--relative-depth``, which for a video is a grey
video or a folder of maps. The frames have the size of the map: the intrinsics of the picture are scaled.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument, SourceError, as_source_error, import_extra, require_positive
from touchfield.sources.camera import (
    DEFAULT_RATE_HZ,
    CodedSequence,
    DepthCode,
    DepthSequence,
    Frames,
    Intrinsics,
)
from touchfield.sources.depth.intrinsics_file import CameraFile, camera_of, parse_intrinsics
from touchfield.sources.depth.layouts import depth_kind, source_rate
from touchfield.sources.depth.lens import Lens, rectified
from touchfield.sources.images import pictures
from touchfield.sources.images.movies import VIDEO_SUFFIXES, GreyVideo
from touchfield.sources.options import SourceOptions
from touchfield.sources.poses import read_text

_SUFFIXES: Final = (".npy", ".pfm", ".png")
_KITTI_UNITS_PER_PX: Final = 256.0

DEFAULT_NEAR_M: Final = 1.0
FIELD_OF_VIEW_DEG: Final = 60.0
"""Default horizontal field of view: between a phone's main camera (about 65) and a webcam (about 55).
"""
SHAPE_TOLERANCE: Final = 0.03
"""Tolerance of the aspect ratio of a map: estimators round sizes to multiples of 14 or 32 px.
"""


# -- disparity ---------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class StereoRig:
    """A rectified stereo pair: the camera of the disparity map, and the baseline.

    `disparity_offset_px` is the difference of the principal points (Middlebury's doffs).
    """

    intrinsics: Intrinsics
    baseline_m: float
    disparity_offset_px: float = 0.0

    def __post_init__(self) -> None:
        require_positive(baseline_m=self.baseline_m)
        if not math.isfinite(self.disparity_offset_px):
            raise InvalidArgument(
                "disparity_offset_px", repr(self.disparity_offset_px), "a finite number of pixels"
            )


def depth_of_disparity(disparity_px: NDArray[Any], rig: StereoRig) -> Float32s:
    """Convert disparities in pixels to metres, float32.

    The depth is 0 for a disparity that is 0, not finite, or that of a point behind the camera.
    """
    disparity = np.asarray(disparity_px, np.float64)
    is_known = np.isfinite(disparity) & (disparity > 0)
    shifted = np.where(is_known, disparity, 1.0) + rig.disparity_offset_px
    is_known &= shifted > 1e-6  # a millionth of a pixel: below the accuracy of any stereo camera
    depth = rig.intrinsics.fx * rig.baseline_m / np.where(is_known, shifted, 1.0)
    return DepthCode(1.0)(np.where(is_known, depth, 0))


def _of_disparity(
    name: str, disparity_px: NDArray[Any], rig: StereoRig, notes: tuple[str, ...] = ()
) -> CodedSequence:
    """Wrap a disparity map, pixels, 0 or not finite where unknown, as a sequence of one frame."""
    metres = partial(depth_of_disparity, rig=rig)
    if not metres(disparity_px).any():
        raise SourceError(name, "no disparity above 0", "a disparity map in pixels")
    return CodedSequence(
        name, pictures.ArrayFrames(disparity_px[None]), metres, rig.intrinsics, DEFAULT_RATE_HZ, notes
    )


def motorcycle_sequence() -> CodedSequence:
    """Return scikit-image's disparity map "motorcycle" (Middlebury 2014), 741 x 500, 2 to 5 m.

    Raises `MissingExtra` without scikit-image.
    """
    data = import_extra("skimage.data", "the motorcycle scene", "scikit-image", "motorcycle")
    try:
        disparity = data.stereo_motorcycle()[2]
    except (OSError, ImportError) as error:  # a repackaged scikit-image may have to download its pictures
        raise SourceError("stereo_motorcycle", str(error), "scikit-image with its pictures") from error
    rig = StereoRig(Intrinsics(994.978, 994.978, 311.193, 254.877), 0.193001, 31.086)
    return _of_disparity("scikit-image stereo_motorcycle", disparity, rig)


def read_disparity(path: Path, options: SourceOptions) -> CodedSequence:
    """Read a disparity map: PFM or NPY in pixels, or 16-bit PNG.

    ``depth_scale`` stored units are one pixel; the default is 256 for a PNG, and 1 otherwise.
    """
    suffix = path.suffix.lower()
    values = (_pfm if suffix == ".pfm" else pictures.read_picture)(path)
    if values.dtype == np.uint8:
        raise SourceError(
            str(path), "an 8-bit picture", "16-bit PNG, PFM or NPY", "Give the disparity map itself."
        )
    with np.errstate(over="ignore", invalid="ignore"):  # inf and NaN mean unknown
        units_per_px = options.depth_scale or (_KITTI_UNITS_PER_PX if suffix == ".png" else 1.0)
        disparity = values.astype(np.float64) / units_per_px
    size, folder = (disparity.shape[1], disparity.shape[0]), path.absolute().parent
    name = "cam1" if path.stem.lower().startswith("disp1") else "cam0"
    calibration = _calibration(folder / "calib.txt", size, name)
    default = CameraFile(calibration.intrinsics) if calibration else None
    mend = "Add --baseline-m, or put a calib.txt next to it."
    missing = mend if calibration is None and options.baseline_m is None else ""
    camera = camera_of(str(path), options.intrinsics, () if default else (folder,), size, default, missing)
    baseline_m, offset_px = options.baseline_m, options.disparity_offset_px
    notes = camera.notes
    if camera.distortion is not None:  # matching needs rectified pictures
        notes += (f"{camera.distortion.wording} is not undone: a disparity map is of rectified pictures.",)
    if calibration is not None:
        notes = ("Camera and baseline are those of calib.txt, unless given as options.",)
        baseline_m = baseline_m or calibration.baseline_m
        offset_px = calibration.disparity_offset_px if offset_px is None else offset_px
    if baseline_m is None:
        raise SourceError(str(path), "no baseline", "the distance of the two cameras", mend)
    return _of_disparity(
        str(path), disparity, StereoRig(camera.intrinsics, baseline_m, offset_px or 0.0), notes
    )


def _pfm(path: Path) -> Float32s:
    """Read a grey PFM picture of either byte order."""
    expected = "a grey PFM picture, which begins with Pf"
    with pictures.opened(path, ("PPM",), expected) as image:
        pictures.bound_pixels(path, image.width, image.height)
        if image.mode != "F":
            raise SourceError(str(path), "another picture", expected)
        return np.array(image, np.float32)


def _calibration(file: Path, size: tuple[int, int], camera: str) -> StereoRig | None:
    """Read the camera of this name from Middlebury's ``calib.txt``.

    Returns None without the file.
    """
    if not file.is_file():
        return None
    lines = (line.partition("=") for line in read_text(file).splitlines())
    entries = {key.strip(): value.strip() for key, _, value in lines}
    try:
        stated = (int(entries.get("width", size[0])), int(entries.get("height", size[1])))
        baseline_m, offset_px = float(entries["baseline"]) / 1000, float(entries.get("doffs", "0"))
        matrix = entries[camera]
    except (KeyError, ValueError) as error:
        raise SourceError(
            str(file), f"no or another {error}", "Middlebury's cam0=, baseline=, doffs="
        ) from error
    if stated != size:
        raise SourceError(
            str(file), f"a camera of {stated[0]} x {stated[1]} pixels", f"{size[0]} x {size[1]}"
        )
    with as_source_error(f"{file}: "):
        return StereoRig(parse_intrinsics(matrix, f"{file}: {camera}").intrinsics, baseline_m, offset_px)


# -- relative depth ----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class InverseDepth:
    """Conversion of relative depth to metres.

    The value `high` is at `near_m`, the value `low` at `far_m`.
    """

    low: float
    high: float
    near_m: float
    far_m: float

    def __call__(self, values: NDArray[Any]) -> Float32s:
        """Convert values to depth in metres, float32, linear in 1/z.

        Values that are not finite become 0.
        """
        is_known = np.isfinite(values)
        nearness = (np.where(is_known, values, self.low).astype(np.float64) - self.low) / (
            self.high - self.low
        )
        depth = 1.0 / ((1.0 - nearness) / self.far_m + nearness / self.near_m)
        return DepthCode(1.0)(np.where(is_known, depth, 0.0))


def find_map(path: Path) -> Path | None:
    """Find the relative depth beside a picture or video, by its name.

    Returns None if there is none.
    """
    suffixes = "|".join(suffix[1:] for suffix in (*pictures.PICTURE_SUFFIXES, *VIDEO_SUFFIXES))
    files = pictures.list_files(
        path.absolute().parent, re.escape(path.stem) + rf"[._-]depth([^a-z0-9].*)?\.({suffixes})"
    )
    return files[0] if files else None


def read_relative(path: Path, options: SourceOptions) -> DepthSequence:
    """Read a picture or video with its relative depth; reads every map once.

    Raises `SourceError` if there is no map, sizes or frame counts do not agree, or all values are equal.
    """
    if path.is_dir():
        raise SourceError(str(path), "a folder", "a picture or a video, with its relative depth next to it")
    near_m, far_m, notes = options.near_m, options.far_m, tuple[str, ...]()
    if near_m is not None and near_m == far_m:
        raise InvalidArgument("--near-m, --far-m", f"{near_m:g} m both", "two distances")
    if near_m is None or far_m is None:
        near_m = near_m or (far_m / 2 if far_m else DEFAULT_NEAR_M)
        far_m = far_m or 2 * near_m
        range_text = f"{near_m:g} m (largest value) to {far_m:g} m (smallest), linear in 1/z"
        notes += (f"Relative depth taken as {range_text} (--near-m, --far-m).",)
    maps, where = _open_maps(path, options)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        video = GreyVideo(path)
        (width, height), rate_hz, count = video.size, video.rate_hz or source_rate(options), video.frame_count
    else:
        (width, height), rate_hz, count = pictures.photo_size(path), source_rate(options), 1
    if maps.frame_count != count:
        raise SourceError(
            str(where), f"{maps.frame_count} maps", f"{count}, one for each frame of {path.name}"
        )
    x_scale, y_scale = maps.size[0] / width, maps.size[1] / height
    if abs(x_scale - y_scale) > SHAPE_TOLERANCE * y_scale:
        expected = f"the shape of {path.name}, {width} x {height}"
        raise SourceError(str(where), f"{maps.size[0]} x {maps.size[1]} pixels", expected, "Check the map.")
    focal = width / 2 / math.tan(math.radians(FIELD_OF_VIEW_DEG / 2))
    note = f"No intrinsics: a field of view of {FIELD_OF_VIEW_DEG:g} degrees across is taken (--intrinsics)."
    default = CameraFile(Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2), notes=(note,))
    camera = camera_of(str(path), options.intrinsics, (path.absolute().parent,), (width, height), default)
    k, notes = camera.intrinsics, (*notes, *camera.notes)
    intrinsics = Intrinsics(
        k.fx * x_scale, k.fy * y_scale, (k.cx + 0.5) * x_scale - 0.5, (k.cy + 0.5) * y_scale - 0.5
    )
    if options.reading == "camera":
        notes += ("Relative depth has no true perspective: --reading height renders it as a relief.",)
    low, high = math.inf, -math.inf
    for values in map(maps.values, range(maps.frame_count)):
        finite = values[np.isfinite(values)]
        if finite.size:
            low, high = min(low, float(finite.min())), max(high, float(finite.max()))
    if not (low < high and math.isfinite(high - low)):
        found = f"the one value {low:g}" if low == high else "no range of numbers"
        raise SourceError(
            str(path), f"{found} in the relative depth", "near and far values", "Check the map."
        )
    metres = InverseDepth(low, high, near_m, far_m)
    sequence = CodedSequence(str(path), maps, metres, intrinsics, rate_hz, notes)
    return rectified(sequence, (Lens(intrinsics, camera.distortion),))


def _open_maps(path: Path, options: SourceOptions) -> tuple[Frames, Path]:
    source = find_map(path) if options.relative_depth is None else Path(options.relative_depth)
    if source is None or not source.exists():
        found = f"no relative depth {source}" if source else "no relative depth next to it"
        mend = "Name the map with --relative-depth."
        raise SourceError(str(path), found, f"{path.stem}_depth.png (or .npy, ...)", mend)
    if source.suffix.lower() in VIDEO_SUFFIXES and source.is_file():
        return GreyVideo(source), source
    form = pictures.with_suffix(*pictures.PICTURE_SUFFIXES)
    files = pictures.list_files(source, form) if source.is_dir() else (source,)
    if not files:
        raise SourceError(str(source), "no map", "a folder of PNG, TIFF or NPY maps")
    return pictures.PictureFrames(files, pictures.read_map), source


def _is_relative(path: Path) -> bool:
    has_suffix = path.suffix.lower() in (*pictures.PHOTO_SUFFIXES, *VIDEO_SUFFIXES)
    return has_suffix and path.is_file() and find_map(path) is not None


KINDS: Final = {
    "disparity": depth_kind(
        "disparity",
        "disparity map named *disp*: PFM, NPY or 16-bit PNG (needs --baseline-m and --intrinsics, or "
        "calib.txt)",
        lambda path: "disp" in path.name.lower() and path.suffix.lower() in _SUFFIXES and path.is_file(),
        read_disparity,
    ),
    "relative-depth": depth_kind(
        "relative-depth",
        "picture or video with a relative depth next to it, NAME_depth.png (1/z, larger is nearer; --near-m, "
        "--far-m)",
        _is_relative,
        read_relative,
    ),
}
