"""An ordinary picture or video with a relative depth beside it, as estimators from one picture give it.

Such a map (MiDaS: Ranftl et al., TPAMI 2022; Depth Anything: Yang et al., CVPR 2024) has no unit. Its values are
taken to be linear in inverse depth, the larger the nearer: with s from 0 to 1 between the smallest and the largest
value of all frames, 1/z = (1 - s)/far + s/near. Of a map whose larger values are farther, say a far smaller than
near: near is then the depth of the largest value all the same.

The map belongs to the picture by its name: ``NAME_depth.png``, ``NAME.depth.png``, ``NAME-depth.npy``, with anything
after the word depth; or by ``--relative-depth``, which for a video is a grey video or a folder of maps. The frames
have the map's own size, and no value is made up by resizing: intrinsics, which are those of the picture, are scaled.
"""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.files import require_plain
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth_video import rate_of_header
from touchfield.sources.folder_sequence import DepthCode, is_layout, list_files, opener, source_rate
from touchfield.sources.grey_video import VIDEO_SUFFIXES, GreyVideo, video_header
from touchfield.sources.intrinsics_file import CameraFile, camera_of
from touchfield.sources.pictures import PICTURE_SUFFIXES, bound_pixels, picture_header, read_picture
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "PHOTO_SUFFIXES", "InverseDepth", "MapFiles", "RelativeSequence", "find_map", "read_sequence"]

NEAR_M: Final = 1.0
FIELD_OF_VIEW_DEG: Final = 60.0
"""Across the width, where no camera is known: between a phone's main camera (about 65) and a webcam (about 55)."""

SHAPE_TOLERANCE: Final = 0.03
"""Width to height of map and picture may differ by this share: estimators round to multiples of 14 or 32 pixels."""

_MAP_SUFFIXES: Final = (*PICTURE_SUFFIXES, *VIDEO_SUFFIXES)


PHOTO_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tif", ".tiff")

_PHOTO_FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")
_ORIENTATION: Final = 0x0112
_ON_ITS_SIDE: Final = (5, 6, 7, 8)


class _Maps(Protocol):
    """Numbers over time: `MapFiles` or `GreyVideo`."""

    frame_count: int

    def values(self, frame: int) -> NDArray[Any]: ...


class MapFiles:
    """Maps in files, one a frame, read when they are asked for.

    Parameters
    ----------
    paths : tuple of Path

    Raises
    ------
    SourceError
        If one is no picture of the first one's size.
    """

    def __init__(self, paths: tuple[Path, ...]) -> None:
        self.paths, self.frame_count = paths, len(paths)
        first = picture_header(paths[0])
        for path in paths[1:]:
            other = picture_header(path)
            if (other.width, other.height) != (first.width, first.height):
                found = f"{other.width} x {other.height} pixels"
                raise SourceError(str(path), found, f"{first.width} x {first.height}, as in {paths[0].name}")

    def values(self, frame: int) -> NDArray[Any]:
        """The numbers of one map, [height, width]; see `read_map`."""
        return read_map(self.paths[frame])


def read_map(path: Path) -> NDArray[Any]:
    """The numbers of a map: PNG or TIFF of one channel, NPY, or an 8-bit RGB PNG whose channels are all the same.

    Raises
    ------
    SourceError
        If it cannot be read or is in colour.
    """
    header = picture_header(path)
    if (header.channels, header.sample) != (3, "uint8"):
        return read_picture(path)
    from PIL import Image

    bound_pixels(path, header.width, header.height, 3)
    try:
        with Image.open(path, formats=("PNG",)) as image:
            channels = np.asarray(image.convert("RGB"))
    except Exception as error:  # for damaged files Pillow raises almost any kind
        raise SourceError(str(path), f"a damaged picture ({error})", "a whole PNG", "Copy the file again.") from error
    if (channels != channels[:, :, :1]).any():
        raise SourceError(
            str(path),
            "a picture in colour",
            "the grey map",
            "Save the relative depth itself, not a coloured preview.",
        )
    return np.ascontiguousarray(channels[:, :, 0])


def photo_size(path: Path) -> tuple[int, int]:
    """Width and height of a photograph as it is shown, from its head alone.

    Raises
    ------
    SourceError
        If it is no picture.
    """
    from PIL import Image

    require_plain(path, "a picture")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a large photograph is no attack: it is not decoded
            with Image.open(path, formats=_PHOTO_FORMATS) as image:
                width, height = image.size
                is_on_its_side = image.getexif().get(_ORIENTATION) in _ON_ITS_SIDE
    except Image.DecompressionBombError as error:
        raise SourceError(str(path), "a picture of more than 178 million pixels", "a smaller one") from error
    except Exception as error:  # as above
        reason = getattr(error, "strerror", None) or "no picture in it"
        raise SourceError(str(path), f"{reason}", "PNG, JPEG, WebP, BMP or TIFF", "Check the file.") from error
    return (height, width) if is_on_its_side else (width, height)


@dataclass(frozen=True)
class InverseDepth:
    """How the values of a relative depth become metres: linear in 1/z; see the module.

    Attributes
    ----------
    low, high : float
        The smallest and the largest value.
    near_m, far_m : float
        Depth of the largest and of the smallest value, metres.
    """

    low: float
    high: float
    near_m: float
    far_m: float

    def metres(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Depth in metres, float32; 0 where a value is not finite."""
        known = np.isfinite(values)
        share = (np.where(known, values, self.low).astype(np.float64) - self.low) / (self.high - self.low)
        depth = 1.0 / ((1.0 - share) / self.far_m + share / self.near_m)
        return DepthCode(1.0).metres(np.where(known, depth, 0.0))


class RelativeSequence(DepthSequence):
    """Relative depth as a depth sequence between two distances.

    Parameters
    ----------
    name : str
        What to call it in messages.
    maps : MapFiles or GreyVideo
    near_m, far_m : float
        Depth of the largest and of the smallest value in all frames, metres.
    intrinsics : Intrinsics
        In pixels of the maps.
    rate_hz : float
    notes : tuple of str

    Raises
    ------
    SourceError
        If a map cannot be read, or all values are the same. Reads every map once.
    """

    def __init__(
        self,
        name: str,
        maps: _Maps,
        near_m: float,
        far_m: float,
        intrinsics: Intrinsics,
        *,
        rate_hz: float,
        notes: tuple[str, ...] = (),
    ) -> None:
        self.name, self.maps, self.intrinsics, self.notes = name, maps, intrinsics, notes
        self.frame_count, self.rate_hz = maps.frame_count, rate_hz
        low, high = math.inf, -math.inf
        for frame in range(maps.frame_count):
            values = maps.values(frame)
            self.height, self.width = values.shape
            known = values[np.isfinite(values)]
            if known.size:
                low, high = min(low, float(known.min())), max(high, float(known.max()))
        if not (low < high and math.isfinite(high - low)):
            found = f"the one value {low:g}" if low == high else "no range of numbers"
            raise SourceError(name, f"{found} in the relative depth", "near and far values", "Check the map.")
        self.scale = InverseDepth(low, high, near_m, far_m)

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        if not 0 <= frame < self.frame_count:
            raise InvalidArgument(f"{self.name}, frame", str(frame), f"0 to {self.frame_count - 1}")
        return self.scale.metres(self.maps.values(frame))


def find_map(path: Path) -> Path | None:
    """The relative depth beside a picture or video, by its name; None where there is none."""
    form = re.escape(path.stem) + r"[._-]depth([^a-z0-9].*)?\.(" + "|".join(s[1:] for s in _MAP_SUFFIXES) + ")"
    found = list_files(path.absolute().parent, form)
    return found[0] if found else None


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A picture or video with the relative depth beside it.

    Raises
    ------
    MissingExtra
        If a video is given and PyAV is not installed.
    SourceError
        If there is no map, a file is at fault, sizes or counts of frames do not go together, or a map is constant.
    InvalidArgument
        If near and far are the same.
    """
    if path.is_dir():
        raise SourceError(str(path), "a folder", "a picture or a video, with its relative depth beside it")
    near_m, far_m, notes = _range(options)
    maps, where = _maps(path, options)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        header = video_header(path)
        size, rate_hz = (header.width, header.height), rate_of_header(header, options)
        count = GreyVideo(path).frame_count
    else:
        size, rate_hz, count = photo_size(path), source_rate(options), 1
    if maps.frame_count != count:
        raise SourceError(str(where), f"{maps.frame_count} maps", f"{count}, one for each frame of {path.name}")
    rows, columns = maps.values(0).shape
    intrinsics, told = _camera(path, options, size, (columns, rows), str(where))
    if options.reading == "camera":
        told += ("Relative depth has no true perspective: --reading height feels it as a relief.",)
    return RelativeSequence(str(path), maps, near_m, far_m, intrinsics, rate_hz=rate_hz, notes=(*notes, *told))


def _range(options: SourceOptions) -> tuple[float, float, tuple[str, ...]]:
    """Near and far in metres; where one is not said, far is twice near."""
    near_m, far_m = options.near_m, options.far_m
    if near_m is not None and near_m == far_m:
        raise InvalidArgument("--near-m, --far-m", f"{near_m:g} m both", "two distances")
    notes: tuple[str, ...] = ()
    if near_m is None or far_m is None:
        near_m = near_m or (far_m / 2 if far_m else NEAR_M)
        far_m = far_m or 2 * near_m
        notes = (
            f"Relative depth taken as {near_m:g} m (largest value) to {far_m:g} m (smallest), linear in 1/z "
            "(--near-m, --far-m).",
        )
    return near_m, far_m, notes


def _maps(path: Path, options: SourceOptions) -> tuple[_Maps, Path]:
    where = find_map(path) if options.relative_depth is None else Path(options.relative_depth)
    if where is None or not where.exists():
        found = f"no relative depth {where}" if where else "no relative depth beside it"
        raise SourceError(
            str(path), found, f"{path.stem}_depth.png (or .npy, ...)", "Name the map with --relative-depth."
        )
    if where.suffix.lower() in VIDEO_SUFFIXES and where.is_file():
        return GreyVideo(where), where
    if where.is_dir():
        files = tuple(list_files(where, r".+\.(" + "|".join(s[1:] for s in PICTURE_SUFFIXES) + ")"))
        if not files:
            raise SourceError(str(where), "no map", "a folder of PNG, TIFF or NPY maps")
        return MapFiles(files), where
    return MapFiles((where,)), where


def _camera(
    path: Path, options: SourceOptions, size: tuple[int, int], map_size: tuple[int, int], where: str
) -> tuple[Intrinsics, tuple[str, ...]]:
    """Intrinsics in pixels of the map, from those of the picture: asked for, or of a field of view."""
    (width, height), (columns, rows) = size, map_size
    x, y = columns / width, rows / height
    if abs(x - y) > SHAPE_TOLERANCE * y:
        raise SourceError(
            where, f"{columns} x {rows} pixels", f"the shape of {path.name}, {width} x {height}", "Check the map."
        )
    focal = width / 2 / math.tan(math.radians(FIELD_OF_VIEW_DEG / 2))
    told = f"No intrinsics: a field of view of {FIELD_OF_VIEW_DEG:g} degrees across is taken (--intrinsics)."
    default = CameraFile(Intrinsics(focal, focal, (width - 1) / 2, (height - 1) / 2), notes=(told,))
    camera = camera_of(str(path), options.intrinsics, (path.absolute().parent,), size, default)
    k = camera.intrinsics
    return Intrinsics(k.fx * x, k.fy * y, (k.cx + 0.5) * x - 0.5, (k.cy + 0.5) * y - 0.5), camera.notes


def _recognise(path: Path) -> bool:
    is_known = path.suffix.lower() in (*PHOTO_SUFFIXES, *VIDEO_SUFFIXES)
    return is_known and path.is_file() and find_map(path) is not None


KIND = SourceKind(
    "relative-depth",
    "picture or video with a relative depth beside it, NAME_depth.png (1/z, larger is nearer; --near-m, --far-m)",
    is_layout(_recognise),
    opener(read_sequence),
)
