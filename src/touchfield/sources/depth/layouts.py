"""Depth sequences as data sets lay them out on disk: one table of layouts (`LAYOUTS`), and one reader of
them.

tum         TUM RGB-D (Sturm et al., IROS 2012), Bonn's and ICL-NUIM's: value / 5000 = metres. It ships no intrinsics
            file: the published ones are used where a name says which camera it was.
redwood     Redwood (Choi et al., CVPR 2015) and Open3D.
sun3d       SUN3D (Xiao et al., ICCV 2013), the recordings of the paper's section 5.2 ("hotel barcelona"):
            ``depth/FRAME-MICROSECONDS.png`` with rotated bits, and ``extrinsics/*.txt`` with the 3x4
            camera-to-world matrices of all colour frames; of several files the last is the newest.
3dmatch     3DMatch (Zeng et al., CVPR 2017) and 7-Scenes (Shotton et al., CVPR 2013), a part (``seq-01``) at a time.
            ``camera-intrinsics.txt`` lies beside the frames or one folder up.
depth-folder, depth-map, depth-stack, depth-video  Pictures of no data set. Scale and intrinsics must be said, or
            lie in a file; floats are metres. A stack is named *depth*: an NPY of heights over time is alike.

Pictures are decoded only when they are asked for.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import MissingExtra, SourceError
from touchfield.files import readable
from touchfield.medium.stores.npz import map_npy, read_npy_header
from touchfield.sources.camera import (
    DEFAULT_RATE_HZ,
    CodedSequence,
    DepthCode,
    DepthSequence,
    Intrinsics,
    at_rate,
)
from touchfield.sources.depth.frame_poses import POSE_TOLERANCE_S, PlacedFrames, placed_frames, posed_frames
from touchfield.sources.depth.intrinsics_file import CameraFile, camera_of, named_like_intrinsics
from touchfield.sources.images.movies import VIDEO_SUFFIXES, GreyVideo, video_header
from touchfield.sources.images.pictures import (
    PICTURE_SUFFIXES,
    ArrayFrames,
    PictureFrames,
    contents,
    has_files,
    list_files,
    picture_header,
)
from touchfield.sources.poses import MAX_TIME_S, nearest_in_time, parse_extrinsics, read_text, words_of
from touchfield.sources.registry import SourceKind, kinds

if TYPE_CHECKING:
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.scene import Scene


_ANY_PNG: Final = r".+\.png"
_STAMPED_PNG: Final = r"\d+(\.\d+)?\.png"
_FRAME_PNG: Final = r"frame-\d+\.depth\.png"
_PLAIN: Final = (r".+\.(png|tif|tiff|pgm)", r".+\.npy")
_TRAJECTORY: Final = r"trajectory\.log|.*traj(ectory)?\.(log|txt)"
_COLOUR: Final = r".+\.(jpg|jpeg|png)"
_TEXT: Final = r".+\.txt"
_MICROSECONDS: Final = re.compile(r"\d+-(\d{1,15})")

_CAMERAS: Final = {  # by the names in `_CAMERA_NAME`, for 640 x 480
    "1": ("freiburg1", Intrinsics(517.3, 516.5, 318.6, 255.3)),
    "2": ("freiburg2", Intrinsics(520.9, 521.0, 325.1, 249.7)),
    "3": ("freiburg3", Intrinsics(535.4, 539.2, 320.1, 247.6)),
    "bonn": ("bonn", Intrinsics(542.822841, 542.576870, 315.593520, 237.756098)),
    "icl": ("icl", Intrinsics(481.2, 480.0, 319.5, 239.5)),  # fy is -480: its poses are of a mirrored world
}
_CAMERA_NAME: Final = re.compile(
    r"(?<![a-z0-9])(?:(?:freiburg|fr)([123])|(bonn|icl)|(?:living_room|office|living)_?(traj)\d)(?![a-z0-9])|(traj)\d_frei"
)
_PRIMESENSE: Final = CameraFile(
    Intrinsics(525.0, 525.0, 319.5, 239.5),
    notes=("No intrinsics file: the PrimeSense default 525, 525, 319.5, 239.5 is used.",),
)
_SEVEN_SCENES: Final = CameraFile(
    Intrinsics(585.0, 585.0, 320.0, 240.0),
    notes=("No camera-intrinsics.txt: the default of 7-Scenes, 585, 585, 320, 240, is used.",),
)


# -- the reader ----------------------------------------------------------------------------------------------
class Shots(NamedTuple):
    """The depth pictures of a sequence, in files or in one file, and where what belongs to them is looked
    for.

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
    """One way to lay a depth sequence out on disk: a folder, unless `is_file`.

    name, summary, recognise : As of `SourceKind`.
    units_per_m : Stored units in a metre, unless a user or a file says otherwise; None where one must.
    camera : Of pictures of 640 x 480 where no file tells, or ``camera(path)`` that knows it.
    poses : ``poses(path, paths)`` where the layout has poses of its own form, None if they are not there.
    is_rotated : See `DepthCode`; the scale is then the layout's or the user's.
    is_timed : Poses are found by the times of the pictures.
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
        """A sequence in this layout; `SourceError` if pictures, poses, scale or camera are missing or at
        fault.
        """
        if path.is_dir() == self.is_file:
            mend = (
                "Name its kind with --as depth-folder." if self.is_file else "Give the folder that holds it."
            )
            raise SourceError(str(path), "a folder" if self.is_file else "a file", self.summary, mend)
        shots = self.shots(path)
        if not shots.paths and shots.one_file is None:
            found = f"no depth picture but {contents(path)}"
            raise SourceError(str(shots.where), found, self.summary, "Check the folder.")
        own, placed = None, PlacedFrames(tuple(range(len(shots.paths))), None, ())
        if self.poses is not None and options.frame == "world" and options.poses is None:
            own = self.poses(path, shots.paths)
        if shots.places is not None:
            frames_of = shots.paths or int(shots.one_file.frame_count)
            times_s = shots.times_s if self.is_timed else None
            placed = own or placed_frames(str(shots.where), frames_of, options, shots.places, times_s)
        frames = shots.one_file or PictureFrames(shots.paths)
        for file, header in zip(frames.paths, frames.headers):
            if header.channels != 1 or header.sample in ("", "uint8", "int8"):
                mend = "Give the depth pictures, not colour or previews, saved with 16 bits."
                raise SourceError(str(file), header.wording, "16-bit (or float) grey depth", mend)
        default = (
            None if frames.size != (640, 480) else self.camera(path) if callable(self.camera) else self.camera
        )
        camera = camera_of(str(shots.where), options.intrinsics, shots.camera_places, frames.size, default)
        is_metres = bool(frames.headers) and frames.headers[0].sample.startswith("float")
        of_file = None if self.is_rotated else camera.units_per_m
        scale = required_scale(str(path), options.depth_scale or of_file or self.units_per_m, is_metres)
        gaps = np.diff(np.empty(0) if shots.times_s is None else shots.times_s)
        gaps = gaps[gaps > 1e-6]  # not NaN, and no stamp given twice
        rate_hz = shots.rate_hz or (float(1 / np.median(gaps)) if len(gaps) else source_rate(options))
        frames = frames.only(placed.kept) if shots.paths else frames
        code = DepthCode(scale, self.is_rotated)
        sequence = CodedSequence(str(path), frames, code, camera.intrinsics, rate_hz)
        sequence.poses = camera.poses_of_pictures(placed.poses)
        if sequence.poses is not None:
            sequence.poses.flags.writeable = False
        sequence.notes = (*placed.notes, *shots.notes, *camera.notes)
        return sequence


def required_scale(where: str, scale: float | None, is_metres: bool) -> float:
    """Stored units in a metre: as something said, 1 of floats; else `SourceError`."""
    if scale is None and not is_metres:
        mend = "Add --depth-scale, for example 1000 for millimetres."
        raise SourceError(where, "no depth scale", "how many stored units are in one metre", mend)
    return scale or 1.0


def source_rate(options: SourceOptions) -> float:
    """Frames a second of a source that does not say: what the user said of it, else the medium's, else 30."""
    return options.source_rate_hz or options.rate_hz or DEFAULT_RATE_HZ


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

    return SourceKind(name, summary, recognise, open_scene)


def depth_scene(sequence: DepthSequence, options: SourceOptions) -> Scene:
    """The scene of a depth sequence at the rate asked for, read as a camera's view or as a height map.

    A sequence that does not say its own rate and whose `source_rate_hz` was not given already has it
    (`source_rate`), and is not interpolated.
    """
    sequence = at_rate(sequence, options.rate_hz, options.interpolation)
    if options.reading == "height":
        from touchfield.sources.terrain.height_scene import HeightScene

        return HeightScene.from_depth_sequence(sequence, options.exaggeration)
    from touchfield.sources.depth.depth_scene import DepthScene

    is_alone = options.world == "frames" or options.frame == "camera" or len(sequence.key_frames()) == 1
    if not is_alone:
        from touchfield.sources.depth.fused_scene import FusedScene, stands

        if sequence.poses is not None or stands(sequence):
            return FusedScene(sequence, options.world, options.segment)
    scene = DepthScene(sequence, frame=options.frame, segment=options.segment)
    if not is_alone:
        note = (
            "No poses, and the camera or most of what it sees moves: each frame is felt alone (--world "
            "frames)"
        )
        scene.notes = (*scene.notes, note)
    return scene


# -- folders of data sets ------------------------------------------------------------------------------------
def _stamped(path: Path) -> Shots:
    """Pictures that are there, in order of time, of ``depth.txt`` (lines of time and file) or
    ``depth/TIME.png``.
    """
    listing, depth = path / "depth.txt", path / "depth"
    notes: tuple[str, ...] = ()
    if listing.is_file():
        listed = []
        for where, words in words_of(read_text(listing), str(listing)):
            try:
                stamp, name = float(words[0]), PurePosixPath(words[1])
            except (ValueError, IndexError):
                stamp, name = np.inf, PurePosixPath()
            if not abs(stamp) < MAX_TIME_S or name.is_absolute() or ".." in name.parts:
                raise SourceError(
                    where, repr(" ".join(words)[:60]), "a time and a file name inside the folder"
                )
            listed.append((stamp, path / name))
        stamped = sorted((stamp, file) for stamp, file in listed if file.is_file())
        if len(stamped) < len(listed):
            notes = (f"{len(stamped)} of the {len(listed)} frames in depth.txt are there.",)
    else:
        stamped = sorted((float(file.stem), file) for file in list_files(depth, _STAMPED_PNG))
    paths = tuple(file for _, file in stamped)
    place = path if paths else listing if listing.is_file() else depth
    return Shots(paths, place, (path,), (path,), np.array([stamp for stamp, _ in stamped]), notes)


def _is_stamped(path: Path) -> bool:
    """A list of stamped pictures, or the true poses of pictures stamped in fractions of a second."""
    is_listed = any((path / name).is_file() for name in ("depth.txt", "associations.txt", "associated.txt"))
    if is_listed or not (path / "groundtruth.txt").is_file():
        return is_listed and has_files(path / "depth", _STAMPED_PNG)
    return has_files(path / "depth", r"\d+\.\d+\.png")


def _published(path: Path) -> CameraFile | None:
    """The published camera that the folder, one above it or the head of ``depth.txt`` names, with a note."""
    listing = path / "depth.txt"
    head = read_text(listing)[:400] if listing.is_file() else ""
    for text in (*reversed(path.absolute().parts), head):
        match = _CAMERA_NAME.search(text.lower())
        if match:
            camera, k = _CAMERAS[match[1] or match[2] or "icl"]
            note = (
                f"No intrinsics file: the published ones of {camera}, {k.fx}, {k.fy}, {k.cx}, {k.cy}, are "
                "used."
            )
            return CameraFile(k, notes=(note,), is_mirrored=camera == "icl")
    return None


def _in_depth(path: Path) -> Shots:
    return Shots(list_files(path / "depth", _ANY_PNG), path, (path,), (path, path / "depth"))


def _sun3d(path: Path) -> Shots:
    shots = _in_depth(path)
    return shots._replace(times_s=_microseconds(shots.paths))


def _microseconds(paths: tuple[Path, ...]) -> Float64s:
    """Time stamps in seconds from names FRAME-MICROSECONDS; NaN for others."""
    matches = [_MICROSECONDS.fullmatch(file.stem) for file in paths]
    return np.array([int(match[1]) * 1e-6 if match else np.nan for match in matches])


def _extrinsics(path: Path, paths: tuple[Path, ...]) -> PlacedFrames | None:
    """SUN3D's poses of colour frames, for the depth frames nearest in time."""
    files = list_files(path / "extrinsics", _TEXT)
    if not files:
        return None
    poses = parse_extrinsics(read_text(files[-1]), str(files[-1]))
    colour = list_files(path / "image", _COLOUR)
    times_s, wanted_s = _microseconds(colour), _microseconds(paths)
    if len(colour) == len(poses) and np.isfinite(times_s).all() and np.isfinite(wanted_s).all():
        order = np.argsort(times_s, kind="stable")
        nearest = nearest_in_time(times_s[order], wanted_s, POSE_TOLERANCE_S)
        some = [poses[order[i]] if i >= 0 else None for i in nearest]
        return posed_frames(str(files[-1]), some, "no posed colour frame within 20 ms")
    if len(poses) == len(paths):
        return PlacedFrames(tuple(range(len(paths))), poses, ())
    found = f"{len(poses)} poses for {len(paths)} depth and {len(colour)} colour frames"
    mend = "Copy all frames of the sequence, or ignore the poses with --frame camera."
    raise SourceError(str(files[-1]), found, "one for each frame", mend)


def _threedmatch(path: Path) -> Shots:
    return Shots(list_files(path, _FRAME_PNG), path, (path,), (path, path.absolute().parent))


# -- pictures of no data set ---------------------------------------------------------------------------------
def _plain(path: Path) -> Shots:
    """Pictures in ``depth/``, in the folder itself or, with a note, in its one folder with depth."""
    folder = next((folder for folder in (path / "depth", path) if _depth_pictures(folder)), None)
    notes: tuple[str, ...] = ()
    if folder is None:
        inside = [inner for inner in sorted(p for p in path.iterdir() if p.is_dir()) if _is_depth(inner)]
        named = [inner for inner in inside if "depth" in inner.name.lower()]
        inside = named if len(named) == 1 else inside
        if len(inside) > 1:
            names = ", ".join(f"{inner.name}/" for inner in inside[:6])
            mend = f"Name one: {path / inside[0].name}"
            raise SourceError(str(path), f"{len(inside)} folders of depth pictures ({names})", "one", mend)
        folder = inside[0] if inside else path
        notes = (f"The depth pictures are those of {folder.name}/.",)
    parent = path.absolute().parent
    above = (parent,) if "depth" in path.absolute().name.lower() else ()
    places = tuple(dict.fromkeys((path, folder, *above)))
    return Shots(_depth_pictures(folder), path, places, (*places, parent), None, notes)


def _depth_pictures(folder: Path) -> tuple[Path, ...]:
    """The pictures of a folder; where some are named like depth and others not, those that are."""
    paths = next((list_files(folder, form) for form in _PLAIN if has_files(folder, form)), ())
    return tuple([path for path in paths if "depth" in path.stem.lower()] or paths)


def _is_depth(folder: Path) -> bool:
    """Tell a folder of depth by its first picture."""
    try:
        first = picture_header(_depth_pictures(folder)[0])
    except (SourceError, IndexError):
        return False
    return first.channels == 1 and first.sample not in ("", "uint8", "int8", "bool")


def _is_plain(path: Path) -> bool:
    if not path.is_dir():
        return False
    if _depth_pictures(path / "depth"):
        return _is_depth(path / "depth")

    def is_named(folder: Path) -> bool:
        return any("depth" in path.stem.lower() for path in (folder, *_depth_pictures(folder)[:1]))

    has_camera = any(named_like_intrinsics((path,)))
    if _depth_pictures(path):
        return (has_camera or is_named(path)) and _is_depth(path)
    inner = [folder for folder in path.iterdir() if folder.is_dir() and (has_camera or is_named(folder))]
    others = [kind for kind in kinds() if kind.name != "depth-folder"]  # a source of its own is opened itself
    return any(_is_depth(folder) and not any(kind.recognise(folder) for kind in others) for folder in inner)


def _is_one(path: Path) -> bool:
    return "depth" in path.name.lower() and path.suffix.lower() in PICTURE_SUFFIXES and path.is_file()


def _stack(path: Path) -> Shots:
    folder = (path.absolute().parent,)
    return Shots((), path, folder, folder, one_file=ArrayFrames(map_npy(path), path))


def _is_stack(path: Path) -> bool:
    if not _is_one(path) or path.suffix.lower() != ".npy":
        return False
    with path.open("rb") as stream:
        shape = read_npy_header(stream, str(path)).shape
    return len(shape) == 3 and shape[2] != 1


def _video(path: Path) -> Shots:
    header = video_header(path)
    if not header.is_deep_grey:
        found, expected = (
            f"{header.codec} video of {header.pixels} pixels",
            "16-bit grey (gray16le, gray12le, ...)",
        )
        mend = (
            "It looks like an ordinary video: take --as saliency, or --as relative-depth with its depth "
            "beside it."
        )
        raise SourceError(str(path), found, expected, mend)
    folder = (path.absolute().parent,)
    return Shots((), path, folder, folder, one_file=GreyVideo(path), rate_hz=header.rate_hz)


def _is_video(path: Path) -> bool:
    if path.suffix.lower() not in VIDEO_SUFFIXES or not path.is_file():
        return False
    try:
        return video_header(path).is_deep_grey
    except (MissingExtra, SourceError):
        return True  # so that the user is told which extra reads videos, or what is wrong with this one


LAYOUTS: Final = (
    Layout(
        "tum", "TUM RGB-D sequence: a folder with depth/TIME.png (value/5000 m), depth.txt, groundtruth.txt",
        _is_stamped, _stamped, 5000.0, _published, is_timed=True,
    ),
    Layout(
        "redwood", "Redwood or Open3D sequence: a folder with depth/*.png (millimetres) and trajectory.log",
        lambda path: has_files(path, _TRAJECTORY) and has_files(path / "depth", _ANY_PNG),
        _in_depth, 1000.0, _PRIMESENSE,
    ),
    Layout(
        "sun3d", "SUN3D sequence: a folder with depth/*.png (rotated bits), intrinsics.txt, extrinsics/*.txt",
        lambda path: has_files(path / "extrinsics", _TEXT) and has_files(path / "depth", _ANY_PNG),
        _sun3d, 1000.0, poses=_extrinsics, is_rotated=True,
    ),
    Layout(
        "3dmatch", "3DMatch or 7-Scenes sequence: a folder with frame-NNNNNN.depth.png (millimetres) and "
                   ".pose.txt",
        lambda path: has_files(path, _FRAME_PNG), _threedmatch, 1000.0, _SEVEN_SCENES,
    ),
    Layout(
        "depth-folder",
        "folder of 16-bit depth pictures, here or in depth/, poses beside them "
        "(needs --depth-scale and --intrinsics)",
        _is_plain, _plain,
    ),
    Layout(
        "depth-map",
        "one depth picture named *depth*: 16-bit PNG or TIFF (needs --depth-scale), NPY in metres "
        "(--intrinsics)",
        _is_one, lambda path: Shots((path,), path, None, (path.absolute().parent,)), is_file=True,
    ),
    Layout(
        "depth-stack",
        "depth frames in one file named *depth*: NPY [frames, height, width] in metres",
        _is_stack, _stack, is_file=True,
    ),
    Layout(
        "depth-video",
        "video of depth: 16-bit grey in MKV, AVI, MOV, MP4 (needs --depth-scale and --intrinsics; extra: "
        "video)",
        _is_video, _video, is_file=True,
    ),
)  # fmt: skip

KINDS: Final = {layout.name: layout.kind for layout in LAYOUTS}
