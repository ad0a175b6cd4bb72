"""The one reader of depth sequences on disk: a `Layout` says where pictures, scale, camera and poses are found.

Pictures are decoded only when they are asked for. Each sequence then gets the rate that was asked for and becomes a
scene (`depth_scene`).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError
from touchfield.files import readable
from touchfield.sources.camera import DEFAULT_RATE_HZ, CodedSequence, DepthCode, DepthSequence, at_rate
from touchfield.sources.intrinsics_file import CameraFile, camera_of
from touchfield.sources.pictures import PICTURE_SUFFIXES, PictureFrames, picture_header
from touchfield.sources.placed_frames import PlacedFrames, placed_frames
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.scene import Scene


_MOST_SEEN: Final = 10_000
_MOST_KINDS: Final = 5


# -- folders -------------------------------------------------------------------------------------------------
def list_files(folder: Path, pattern: str) -> list[Path]:
    """The files of a folder whose whole name matches a regular expression, in the order of their numbers."""
    form = re.compile(pattern, re.IGNORECASE)
    with readable(folder, "a folder that can be read"):
        files = [p for p in folder.iterdir() if form.fullmatch(p.name) and not p.name.startswith(".")]
    return sorted(files, key=lambda p: _natural(p.name))


def with_suffix(*suffixes: str) -> str:
    """The pattern of the names with one of these suffixes."""
    return r".+\.(" + "|".join(suffix[1:] for suffix in suffixes) + ")"


def _natural(name: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", name)]


def has_files(folder: Path, pattern: str) -> bool:
    """True if a folder is there and holds such a file; False where it cannot be read."""
    try:
        return folder.is_dir() and bool(list_files(folder, pattern))
    except (OSError, SourceError):
        return False


def contents(folder: Path) -> str:
    """A folder in words: "24 .png (8-bit RGB), 1 .txt, folders colour/ and poses/"; bounded, and never an error."""
    try:
        entries = sorted(islice((p for p in folder.iterdir() if not p.name.startswith(".")), _MOST_SEEN))
    except OSError as error:
        return error.strerror or str(error)
    files = [p for p in entries if p.is_file()]
    counts = Counter(p.suffix.lower() or "without an ending" for p in files).most_common(_MOST_KINDS)
    words = [f"{count} {suffix}{_samples_of(files, suffix)}" for suffix, count in counts]
    inner = [f"{p.name}/" for p in entries if p.is_dir()]
    if inner:
        words.append("the folders " + " ".join(inner[:_MOST_KINDS]) + " ..." * (len(inner) > _MOST_KINDS))
    return ", ".join(words) or "nothing"


def _samples_of(files: list[Path], suffix: str) -> str:
    """The samples of the first picture of a kind, in brackets; nothing for other files."""
    if suffix not in PICTURE_SUFFIXES:
        return ""
    try:
        return f" ({picture_header(next(p for p in files if p.suffix.lower() == suffix)).wording})"
    except SourceError:
        return ""


# -- sequences -----------------------------------------------------------------------------------------------
class Shots(NamedTuple):
    """The depth pictures of a sequence, in files or in one file, and where what belongs to them is looked for.

    Times are seconds, NaN where a picture has none; `places` are the folders of poses, None if none are read.
    """

    paths: tuple[Path, ...]
    where: Path
    places: tuple[Path, ...] | None
    camera_places: tuple[Path, ...]
    times_s: Float64s | None = None
    notes: tuple[str, ...] = ()
    one_file: Any = None  # frames as of `PictureFrames`
    rate_hz: float | None = None


@dataclass(frozen=True)
class Layout:
    """One way to lay a depth sequence out on disk.

    name, summary, recognise : As of `SourceKind`; of what a path that cannot be read would raise, `kind` takes care.
        A folder, unless `is_file`.
    shots : callable; ``shots(path) -> Shots``.
    units_per_m : float or None; Stored units in a metre, unless a user or a file says otherwise; None where one must.
    camera : CameraFile, callable or None; The camera of pictures of 640 x 480 where no file tells, or
        ``camera(path)`` that knows it.
    poses : callable or None; ``poses(path, paths) -> PlacedFrames`` where the layout has poses of its own form, None
        if they are not there.
    is_rotated : bool; See `DepthCode`; the scale is then the layout's or the user's.
    is_timed : bool; Poses are found by the times of the pictures.
    """

    name: str
    summary: str
    recognise: Callable[[Path], bool]
    shots: Callable[[Path], Shots]
    units_per_m: float | None = None
    camera: CameraFile | Callable[[Path], CameraFile | None] | None = None
    poses: Callable[[Path, tuple[Path, ...]], PlacedFrames | None] | None = None
    is_rotated: bool = False
    is_timed: bool = False
    is_file: bool = False

    @property
    def kind(self) -> SourceKind:
        return depth_kind(self.name, self.summary, self.recognise, self.read_sequence)

    def read_sequence(self, path: Path, options: SourceOptions) -> CodedSequence:
        """A sequence in this layout; `SourceError` if pictures, poses, scale or camera are missing or at fault."""
        if path.is_dir() == self.is_file:
            mend = "Name its kind with --as depth-folder." if self.is_file else "Give the folder that holds it."
            raise SourceError(str(path), "a folder" if self.is_file else "a file", self.summary, mend)
        shots = self.shots(path)
        if not shots.paths and shots.one_file is None:
            found = f"no depth picture but {contents(path)}"
            raise SourceError(str(shots.where), found, self.summary, "Check the folder.")
        placed = self._placed(path, shots, options)
        frames = shots.one_file or PictureFrames(shots.paths)
        for file, header in zip(frames.paths, frames.headers):
            if header.channels != 1 or header.sample in ("", "uint8", "int8"):
                mend = "Give the depth pictures, not colour or previews, saved with 16 bits."
                raise SourceError(str(file), header.wording, "16-bit (or float) grey depth", mend)
        default = None if frames.size != (640, 480) else self.camera(path) if callable(self.camera) else self.camera
        camera = camera_of(str(shots.where), options.intrinsics, shots.camera_places, frames.size, default)
        is_metres = bool(frames.headers) and frames.headers[0].sample.startswith("float")
        of_file = None if self.is_rotated else camera.units_per_m
        scale = options.depth_scale or of_file or self.units_per_m or (1.0 if is_metres else None)
        if scale is None:
            mend = "Add --depth-scale, for example 1000 for millimetres."
            raise SourceError(str(path), "no depth scale", "how many stored units are in one metre", mend)
        rate_hz = shots.rate_hz or _rate_of_stamps(shots.times_s, options)
        frames = frames.only(placed.kept) if shots.paths else frames
        code = DepthCode(scale, self.is_rotated)
        sequence = CodedSequence(str(path), frames, code, camera.intrinsics, rate_hz)
        sequence.poses = camera.poses_of_pictures(placed.poses)
        if sequence.poses is not None:
            sequence.poses.flags.writeable = False
        sequence.notes = (*placed.notes, *shots.notes, *camera.notes)
        return sequence

    def _placed(self, path: Path, shots: Shots, options: SourceOptions) -> PlacedFrames:
        """The frames that are placed: by the poses asked for, the layout's own, or those that lie there."""
        if shots.places is None:
            return PlacedFrames(tuple(range(len(shots.paths))), None, ())
        if self.poses is not None and options.frame == "world" and options.poses is None:
            own = self.poses(path, shots.paths)
            if own is not None:
                return own
        times_s = shots.times_s if self.is_timed else None
        frames = shots.paths or int(shots.one_file.frame_count)
        return placed_frames(str(shots.where), frames, options, shots.places, times_s)


def _rate_of_stamps(stamps_s: Float64s | None, options: SourceOptions) -> float:
    """Frames a second from the median gap of time stamps; where there are none, `source_rate`."""
    gaps = np.diff(np.empty(0) if stamps_s is None else stamps_s)
    gaps = gaps[gaps > 1e-6]  # not NaN, and no stamp given twice
    return float(1 / np.median(gaps)) if len(gaps) else source_rate(options)


def source_rate(options: SourceOptions) -> float:
    """Frames a second of a source that does not say: what the user said of it, else the medium's, else 30."""
    return options.source_rate_hz or options.rate_hz or DEFAULT_RATE_HZ


# -- scenes --------------------------------------------------------------------------------------------------
def is_known(recognise: Callable[[Path], bool]) -> Callable[[Path], bool]:
    """The same test, but False for what cannot be read."""

    def is_known(path: Path) -> bool:
        try:
            return recognise(path)
        except (OSError, SourceError):
            return False

    return is_known


def depth_kind(
    name: str,
    summary: str,
    recognise: Callable[[Path], bool],
    read_sequence: Callable[[Path, SourceOptions], DepthSequence],
) -> SourceKind:
    """A source kind of depth sequences; what cannot be read is a `SourceError` when it is opened."""

    def open_scene(path: Path, options: SourceOptions) -> Scene:
        with readable(path, "files that can be read"):
            sequence = read_sequence(path, options)
        return depth_scene(sequence, options)

    return SourceKind(name, summary, is_known(recognise), open_scene)


def depth_scene(sequence: DepthSequence, options: SourceOptions) -> Scene:
    """The scene of a depth sequence at the rate asked for, read as a camera's view or as a height map.

    A sequence that does not say its own rate and whose `source_rate_hz` was not given already has it (`source_rate`),
    and is not interpolated.
    """
    sequence = at_rate(sequence, options.rate_hz, options.interpolation)
    if options.reading == "height":
        from touchfield.sources.height_scene import HeightScene

        return HeightScene.from_depth_sequence(sequence, options.exaggeration, options.segment)
    from touchfield.sources.depth_scene import DepthScene

    is_alone = options.world == "frames" or options.frame == "camera" or len(sequence.key_frames()) == 1
    if not is_alone:
        from touchfield.sources.fused_scene import FusedScene, stands

        if sequence.poses is not None or stands(sequence):
            return FusedScene(sequence, options.world, options.segment)
    scene = DepthScene(sequence, frame=options.frame, segment=options.segment)
    if not is_alone:
        note = "No poses, and the camera or most of what it sees moves: each frame is felt alone (--world frames)"
        scene.notes = (*scene.notes, note)
    return scene
