"""A depth sequence over pictures on disk, one file a frame; each is decoded only when it is asked for.

What the layouts (TUM, Redwood, SUN3D, 3DMatch, plain folders) share: which files there are, that they are 16-bit and
of one size, how a stored value becomes metres, and what is done with frames that have no pose. A value of 0 means
unknown in all of them; so does 65535, by the 7-Scenes and 3DMatch convention and as the end of the scale elsewhere.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.intrinsics_file import CameraFile
from touchfield.sources.pictures import PICTURE_SUFFIXES, PictureHeader, picture_header, read_picture
from touchfield.sources.placed_frames import placed_frames
from touchfield.sources.time_interpolation import at_rate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions
    from touchfield.sources.scene import Scene

__all__ = [
    "DEFAULT_RATE_HZ",
    "DepthCode",
    "FolderSequence",
    "common_size",
    "contents",
    "depth_scene",
    "has_files",
    "is_layout",
    "list_files",
    "opener",
    "placed_sequence",
    "rate_of_stamps",
    "require_scale",
    "source_rate",
]

DEFAULT_RATE_HZ: Final = 30.0

_MOST_SEEN: Final = 10_000
_MOST_KINDS: Final = 5


@dataclass(frozen=True)
class DepthCode:
    """How a stored value becomes metres.

    Parameters
    ----------
    units_per_m : float
        Stored units in one metre: 1000 for millimetres, 5000 for TUM, 1 for floats in metres.
    is_rotated : bool
        SUN3D's rotated bits: value = (v >> 3) | (v << 13) in 16 bits.
    """

    units_per_m: float
    is_rotated: bool = False

    def metres(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Depth in metres, float32, of stored values of any numeric type; 0 where unknown.

        Unknown are 0, negative values and what is not finite, and 65535 in 16 bits.
        """
        if values.dtype == np.uint16:
            depth: NDArray[np.float32] = _table(self)[values]
            return depth
        with np.errstate(over="ignore"):  # what float32 cannot hold becomes inf, and so unknown
            depth = (values.astype(np.float64) / self.units_per_m).astype(np.float32)
        depth[~(np.isfinite(depth) & (depth > 0))] = 0
        return depth


@lru_cache(maxsize=16)
def _table(code: DepthCode) -> NDArray[np.float32]:
    """Metres of all 65536 values: one look-up a pixel is the fastest way in numpy."""
    values = np.arange(1 << 16, dtype=np.uint16)
    if code.is_rotated:
        values = ((values >> 3) | (values << 13)).astype(np.uint16)
    with np.errstate(over="ignore"):
        table = (values / code.units_per_m).astype(np.float32)
    table[(values == 0xFFFF) | ~np.isfinite(table)] = 0
    table.flags.writeable = False
    return table


class FolderSequence(DepthSequence):
    """Depth frames from picture files, decoded one by one when asked for.

    Parameters
    ----------
    name : str
        What to call it in messages.
    paths : sequence of Path
    code : DepthCode
    intrinsics : Intrinsics
    size : (int, int)
        Width and height, as `common_size` found them.
    """

    def __init__(
        self, name: str, paths: Sequence[Path], code: DepthCode, intrinsics: Intrinsics, size: tuple[int, int]
    ) -> None:
        self.name, self.intrinsics, self.code = name, intrinsics, code
        self.paths = tuple(paths)
        self.frame_count = len(self.paths)
        self.width, self.height = size

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        if not 0 <= frame < self.frame_count:
            raise InvalidArgument(f"{self.name}, frame", str(frame), f"0 to {self.frame_count - 1}")
        path = self.paths[frame]
        values = read_picture(path)
        if values.shape != (self.height, self.width):
            found = f"{values.shape[1]} x {values.shape[0]} pixels"
            raise SourceError(str(path), found, f"{self.width} x {self.height}, as before")
        return self.code.metres(values)


def common_size(paths: Sequence[Path]) -> tuple[int, int]:
    """Width and height of all pictures, from their headers alone.

    Raises
    ------
    SourceError
        If one cannot hold depth (8 bits, colour) or its size differs from that of the first.
    """
    first = _depth_header(paths[0])
    for path in paths[1:]:
        other = _depth_header(path)
        if (other.width, other.height) != (first.width, first.height):
            raise SourceError(
                str(path),
                f"{other.width} x {other.height} pixels",
                f"{first.width} x {first.height}, as in {paths[0].name}",
                "Put pictures of one size into the folder.",
            )
    return first.width, first.height


def _depth_header(path: Path) -> PictureHeader:
    header = picture_header(path)
    if header.channels != 1 or header.sample in ("", "uint8", "int8"):
        raise SourceError(
            str(path),
            header.wording,
            "16-bit (or float) grey depth",
            "Give the depth pictures, not colour or previews, saved with 16 bits.",
        )
    return header


def list_files(folder: Path, pattern: str) -> list[Path]:
    """The files of a folder whose whole name matches a regular expression, in the order of their numbers.

    Raises
    ------
    SourceError
        If the folder cannot be read.
    """
    form = re.compile(pattern, re.IGNORECASE)
    try:
        found = [p for p in folder.iterdir() if form.fullmatch(p.name) and not p.name.startswith(".")]
    except OSError as error:
        raise SourceError(str(folder), error.strerror or str(error), "a folder that can be read") from error
    return sorted(found, key=lambda p: _natural(p.name))


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def has_files(folder: Path, pattern: str) -> bool:
    """Whether a folder is there and holds such a file; False where it cannot be read."""
    try:
        return folder.is_dir() and bool(list_files(folder, pattern))
    except (OSError, SourceError):
        return False


def is_layout(test: Callable[[Path], bool]) -> Callable[[Path], bool]:
    """A recogniser that takes a folder it may not read for one that it does not know."""

    def recognise(path: Path) -> bool:
        try:
            return test(path)
        except (OSError, SourceError):
            return False

    return recognise


def contents(folder: Path) -> str:
    """A folder in words: "24 .png (8-bit RGB), 1 .txt, folders colour/ and poses/"; bounded, and never an error."""
    try:
        entries = sorted(islice((p for p in folder.iterdir() if not p.name.startswith(".")), _MOST_SEEN))
    except OSError as error:
        return error.strerror or str(error)
    files = [p for p in entries if p.is_file()]
    kinds = Counter(p.suffix.lower() or "without an ending" for p in files).most_common(_MOST_KINDS)
    told = [f"{count} {kind}{_kind_of(files, kind)}" for kind, count in kinds]
    inner = [f"{p.name}/" for p in entries if p.is_dir()]
    if inner:
        told.append("the folders " + " ".join(inner[:_MOST_KINDS]) + " ..." * (len(inner) > _MOST_KINDS))
    return ", ".join(told) or "nothing"


def _kind_of(files: list[Path], suffix: str) -> str:
    """The samples of the first picture of a kind, in brackets; nothing for other files."""
    if suffix not in PICTURE_SUFFIXES:
        return ""
    try:
        return f" ({picture_header(next(p for p in files if p.suffix.lower() == suffix)).wording})"
    except SourceError:
        return ""


def rate_of_stamps(stamps_s: NDArray[np.float64], options: SourceOptions) -> float:
    """Frames a second from the median gap of time stamps; where there are none, `source_rate`."""
    gaps = np.diff(stamps_s)
    gaps = gaps[gaps > 1e-6]  # not NaN, and no stamp given twice
    if len(gaps):
        return float(1 / np.median(gaps))
    return source_rate(options)


def source_rate(options: SourceOptions) -> float:
    """Frames a second of a source that does not say: what the user said of it, else the medium's, else 30."""
    return options.source_rate_hz or options.rate_hz or DEFAULT_RATE_HZ


def require_scale(name: str, options: SourceOptions, sample: str, camera: CameraFile) -> float:
    """Stored units in one metre: what was asked or the camera's file says; 1 for floats, metres by default.

    Raises
    ------
    SourceError
        If the samples are whole numbers and nothing was asked.
    """
    if options.depth_scale is not None:
        return options.depth_scale
    if camera.units_per_m is not None:
        return camera.units_per_m
    if sample.startswith("float"):
        return 1.0
    raise SourceError(
        name,
        "no depth scale",
        "how many stored units are in one metre",
        "Add --depth-scale, for example 1000 for millimetres.",
    )


def placed_sequence(
    sequence: DepthSequence, options: SourceOptions, folders: Sequence[Path], camera: CameraFile
) -> DepthSequence:
    """A sequence of one file with the poses asked for, or found in these folders, one for each frame, and notes.

    Raises
    ------
    SourceError
        If poses are at fault, or there are fewer than frames.
    """
    found = placed_frames(sequence.name, sequence.frame_count, options, folders)
    sequence.poses = camera.poses_of_pictures(found.poses)
    sequence.notes = (*sequence.notes, *found.notes, *camera.notes)
    return sequence


def opener(
    read_sequence: Callable[[Path, SourceOptions], DepthSequence],
) -> Callable[[Path, SourceOptions], Scene]:
    """The ``open`` of a source kind: read the sequence, make it a scene; what cannot be read is a `SourceError`."""

    def open_scene(path: Path, options: SourceOptions) -> Scene:
        try:
            sequence = read_sequence(path, options)
        except OSError as error:
            raise SourceError(str(path), error.strerror or str(error), "files that can be read") from error
        return depth_scene(sequence, options)

    return open_scene


def depth_scene(sequence: DepthSequence, options: SourceOptions) -> Scene:
    """The scene of a depth sequence, read as a camera's view or as a height map (``options.reading``).

    Every kind of depth sequence comes through here, so here it gets the rate that was asked for
    (`touchfield.sources.time_interpolation`). A sequence that does not say its own rate and whose `source_rate_hz`
    was not given already has it (`source_rate`), and is not interpolated.
    """
    sequence = at_rate(sequence, options.rate_hz, options.interpolation)
    if options.reading == "height":
        from touchfield.sources.height_scene import HeightScene

        return HeightScene.from_depth_sequence(sequence, options.exaggeration, options.segment)
    from touchfield.sources.depth_scene import DepthScene

    is_alone = options.world == "frames" or options.frame == "camera" or len(sequence.key_frames()) == 1
    told: tuple[str, ...] = ()
    if not is_alone:
        from touchfield.sources.fused_scene import FusedScene, stands

        if sequence.poses is not None or stands(sequence):
            return FusedScene(sequence, options.world, options.segment)
        told = ("No poses, and the camera or most of what it sees moves: each frame is felt alone (--world frames)",)
    scene = DepthScene(sequence, frame=options.frame, segment=options.segment)
    scene.notes = (*scene.notes, *told)
    return scene
