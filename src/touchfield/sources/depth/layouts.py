"""Opens depth sequences in the file layouts of public data sets (TUM, Redwood and others), and finds out
which one a folder has.

`LAYOUTS` is the table of layouts; `Layout.read_sequence` reads all of them.

tum         TUM RGB-D (Sturm et al., IROS 2012), Bonn's and ICL-NUIM's: value / 5000 = metres. It has no
            intrinsics file: the published intrinsics are used if a name identifies the camera.
redwood     Redwood (Choi et al., CVPR 2015) and Open3D.
sun3d       SUN3D (Xiao et al., ICCV 2013), the recordings of the paper's section 5.2 ("hotel barcelona"):
            ``depth/FRAME-MICROSECONDS.png`` with rotated bits, and ``extrinsics/*.txt`` with the 3x4
            camera-to-world matrices of all colour frames; the last of several files is the newest.
3dmatch     3DMatch (Zeng et al., CVPR 2017) and 7-Scenes (Shotton et al., CVPR 2013), one part (``seq-01``).
            ``camera-intrinsics.txt`` lies beside the frames or one folder up.
others      (depth-folder, depth-map, depth-stack, depth-video) Scale and intrinsics must be given as options
            or in a file; floats are metres. A stack must be named *depth*, since an NPY of heights has the
            same form.

Pictures are decoded on demand.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Set
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.files import readable, recorded_reads
from touchfield.medium.stores.npz import map_npy, read_npy_header
from touchfield.sources.camera import (
    DEFAULT_RATE_HZ,
    CodedSequence,
    DepthCode,
    DepthSequence,
    Intrinsics,
    change_rate,
)
from touchfield.sources.depth.depth_check import range_notes
from touchfield.sources.depth.frame_poses import POSE_TOLERANCE_S, PosedFrames, drop_unposed, find_poses
from touchfield.sources.depth.intrinsics_file import CameraFile, camera_of, named_like_intrinsics
from touchfield.sources.depth.lens import rectified
from touchfield.sources.depth.pose_check import check_poses
from touchfield.sources.depth.pose_form import parse_pose_form, read_poses_as
from touchfield.sources.images.movies import VIDEO_SUFFIXES, GreyVideo, video_header
from touchfield.sources.images.pictures import (
    PICTURE_SUFFIXES,
    ArrayFrames,
    PictureFrames,
    contents,
    has_files,
    list_files,
    picture_header,
    read_picture,
    with_suffix,
)
from touchfield.sources.poses import MAX_TIME_S, nearest_in_time, parse_extrinsics, read_text, split_lines
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    from touchfield.sources.options import SourceOptions
    from touchfield.sources.scene import Scene


_ANY_PNG: Final = r".+\.png"
_STAMPED_PNG: Final = r"\d+(\.\d+)?\.png"
_FRAME_PNG: Final = r"frame-\d+\.depth\.png"
_PLAIN: Final = (r".+\.(png|tif|tiff|pgm)", r".+\.exr", r".+\.npy")
_TRAJECTORY: Final = r"trajectory\.log|.*traj(ectory)?\.(log|txt)"
_COLOUR: Final = r".+\.(jpg|jpeg|png)"
_TEXT: Final = r".+\.txt"
_TEXT_SUFFIXES: Final = (
    ".txt", ".json", ".log", ".csv", ".yaml", ".yml", ".xml", ".ini", ".cfg", ".toml", ".tum", ".freiburg",
)  # fmt: skip
_ABOUT: Final = re.compile(r"(readme|licen[cs]e|copying|authors|citation|source|changelog)\b", re.IGNORECASE)
_LISTED_FILES: Final = 6
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


# -- the reader --------------------------------------------------------------------------------------------
class PictureSet(NamedTuple):
    """The depth pictures of a sequence, and the folders of its poses and camera.

    Times are seconds, NaN if a picture has none; `pose_folders` are the folders of poses, None if none are
    read.
    """

    paths: tuple[Path, ...]
    where: Path
    pose_folders: tuple[Path, ...] | None
    camera_folders: tuple[Path, ...]
    times_s: Float64s | None = None
    notes: tuple[str, ...] = ()
    file_frames: Any = None  # frames as of `PictureFrames`
    rate_hz: float | None = None


@dataclass(frozen=True)
class Layout:
    """A layout of depth sequences on disk: a folder, unless `is_file`.

    name, summary, recognise : As of `SourceKind`.
    units_per_m : Stored units in a metre, unless an option or a file gives them; None if there is no default.
    camera : Default camera of pictures of 640 x 480, or ``camera(path)`` that returns it.
    poses : ``poses(path, paths)`` if the layout has its own form of poses; returns None if there are none.
    is_rotated : See `DepthCode`; the scale is then that of the layout or of the options.
    is_timed : Poses are matched by the times of the pictures.
    cameras : ``cameras(path, paths, size)`` if the layout has its own form of cameras: that of all pictures,
        or one for each; `size` is the width and height of the pictures.
    read : Reads a picture of the layout.
    """

    name: str
    summary: str
    recognise: Callable[[Path], bool]
    list_pictures: Callable[[Path], PictureSet]
    units_per_m: float | None = None
    camera: CameraFile | Callable[[Path], CameraFile | None] | None = None
    poses: Callable[[Path, tuple[Path, ...]], PosedFrames | None] | None = None
    is_rotated: bool = False
    is_timed: bool = False
    is_file: bool = False
    cameras: Callable[[Path, tuple[Path, ...], tuple[int, int]], tuple[CameraFile, ...]] | None = None
    read: Callable[[Path], Any] = read_picture

    @property
    def kind(self) -> SourceKind:
        return depth_kind(self.name, self.summary, self.recognise, self.read_sequence)

    def read_sequence(self, path: Path, options: SourceOptions) -> DepthSequence:
        """Read a sequence in this layout.

        Raises `SourceError` if pictures, poses, scale or camera are missing or invalid.
        """
        if path.is_dir() == self.is_file:
            mend = (
                "Name its kind with --as depth-folder." if self.is_file else "Give the folder that holds it."
            )
            raise SourceError(str(path), "a folder" if self.is_file else "a file", self.summary, mend)
        pictures = self.list_pictures(path)
        if not pictures.paths and pictures.file_frames is None:
            found = f"no depth picture but {contents(path)}"
            raise SourceError(str(pictures.where), found, self.summary, "Check the folder.")
        layout_poses, posed = None, PosedFrames(tuple(range(len(pictures.paths))), None, ())
        if self.poses is not None and options.frame == "world" and options.poses is None:
            layout_poses = self.poses(path, pictures.paths)
        if pictures.pose_folders is not None:
            frames_to_pose = pictures.paths or int(pictures.file_frames.frame_count)
            times_s = pictures.times_s if self.is_timed else None
            posed = layout_poses or find_poses(
                str(pictures.where), frames_to_pose, options, pictures.pose_folders, times_s
            )
        frames = pictures.file_frames or PictureFrames(pictures.paths, self.read)
        for file, header in zip(frames.paths, frames.headers):
            if header.channels != 1 or header.sample in ("", "uint8", "int8"):
                mend = "Give the depth pictures, not colour or previews, saved with 16 bits."
                if header.channels == 1 and header.sample == "uint8":
                    named = shlex.quote(str(file))
                    mend = (
                        "8 bits hold no depth in metres. Give the pictures with 16 bits, or use one as "
                        f"relative depth: touchfield encode {named} OUT --relative-depth {named} "
                        "--near-m 0.5 --far-m 3."
                    )
                raise SourceError(str(file), header.wording, "16-bit (or float) grey depth", mend)
        is_metres = any(header.sample.startswith("float") for header in frames.headers)
        has_scale = options.depth_scale or self.units_per_m or is_metres
        missing = "" if has_scale else SCALE_HINT
        cameras = self._cameras(path, pictures, frames.size, options, missing)
        camera = cameras[0]
        code, unit_notes = self._depth_code(path, options, camera.units_per_m, frames)
        gaps = np.diff(np.empty(0) if pictures.times_s is None else pictures.times_s)
        gaps = gaps[gaps > 1e-6]  # drops NaN and repeated stamps
        rate_hz = pictures.rate_hz or (float(1 / np.median(gaps)) if len(gaps) else source_rate(options))
        frames = frames.only(posed.indices) if pictures.paths else frames
        sequence = CodedSequence(str(path), frames, code, camera.intrinsics, rate_hz)
        sequence.poses = camera.poses_of_pictures(posed.poses)
        if sequence.poses is not None:
            sequence.poses.flags.writeable = False
        sequence.has_quaternions, sequence.is_unit_assumed = posed.has_quaternions, bool(unit_notes)
        sequence.frame_names = tuple(file.name for file in frames.paths) if pictures.paths else ()
        sequence.notes = (*posed.notes, *pictures.notes, *camera.notes, *unit_notes)
        lenses = [camera.lens for camera in cameras]
        return rectified(sequence, [lenses[i] for i in posed.indices] if len(lenses) > 1 else lenses)

    def _cameras(
        self,
        path: Path,
        pictures: PictureSet,
        size: tuple[int, int],
        options: SourceOptions,
        missing: str,
    ) -> tuple[CameraFile, ...]:
        """Return the camera of all pictures, or one for each; `size` is the width and height of a picture.

        `missing` says how to add what else is missing, for the error without a camera.
        """
        if self.cameras is not None and options.intrinsics is None:
            return self.cameras(path, pictures.paths, size)
        default = None
        if size == (640, 480):
            default = self.camera(path) if callable(self.camera) else self.camera
        where, folders = str(pictures.where), pictures.camera_folders
        return (camera_of(where, options.intrinsics, folders, size, default, missing),)

    def _depth_code(
        self, path: Path, options: SourceOptions, file_scale: float | None, frames: Any
    ) -> tuple[DepthCode, tuple[str, ...]]:
        """Return the code of stored depth, and notes on what no file and no option states of it."""
        samples = {header.sample for header in frames.headers}
        is_rotated, notes = self.is_rotated, list[str]()
        if options.depth_encoding is not None:
            is_rotated = options.depth_encoding == "rotated"
        elif is_rotated:
            notes.append("Bits of depth are read as rotated by 3, as in SUN3D (--depth-encoding plain).")
        if is_rotated and samples and samples != {"uint16"}:
            raise InvalidArgument(
                "--depth-encoding", f"rotated bits of {min(samples)}", "pictures of 16 bits"
            )
        stated = options.depth_scale or (None if self.is_rotated else file_scale)
        is_metres = any(sample.startswith("float") for sample in samples)
        scale = required_scale(str(path), stated or self.units_per_m, is_metres)
        if stated is None:
            source = f"as in the layout {self.name}" if self.units_per_m else "as floats usually are"
            unit = "metres" if scale == 1 else f"{scale:g} to a metre"
            notes.append(f"No file states the unit of depth: {unit}, {source} (--depth-scale).")
        return DepthCode(scale, is_rotated), tuple(notes)


SCALE_HINT: Final = "Add --depth-scale, for example 1000 for millimetres."


def required_scale(where: str, scale: float | None, is_metres: bool) -> float:
    """Return the stored units in a metre, by default 1 for floats.

    Raises `SourceError` if there is no scale and the values are not floats.
    """
    if scale is None and not is_metres:
        raise SourceError(where, "no depth scale", "how many stored units are in one metre", SCALE_HINT)
    return scale or 1.0


def source_rate(options: SourceOptions) -> float:
    """Return the rate of a source that does not state it.

    It is `source_rate_hz`, else `rate_hz`, else 30 Hz.
    """
    return options.source_rate_hz or options.rate_hz or DEFAULT_RATE_HZ


def depth_kind(
    name: str,
    summary: str,
    recognise: Callable[[Path], bool],
    read_sequence: Callable[[Path, SourceOptions], DepthSequence],
) -> SourceKind:
    """Return a source kind of depth sequences.

    Unreadable files raise `SourceError` on opening.
    """

    def open_scene(path: Path, options: SourceOptions) -> Scene:
        with readable(path, "files that can be read"), recorded_reads() as read_files:
            sequence = read_sequence(path, options)
        sequence.notes = (*sequence.notes, *unread_note(path, read_files))
        return depth_scene(sequence, options)

    return SourceKind(name, summary, recognise, open_scene)


def unread_note(path: Path, read_files: Set[Path]) -> tuple[str, ...]:
    """Return a note that names the text files in a folder that were not read; none for a file."""
    if not path.is_dir():
        return ()
    unread = [
        file.name
        for file in list_files(path, with_suffix(*_TEXT_SUFFIXES))
        if file.resolve() not in read_files and not _ABOUT.match(file.name)
    ]
    if not unread:
        return ()
    rest = f" and {len(unread) - _LISTED_FILES} more" if len(unread) > _LISTED_FILES else ""
    return (f"Text files in the folder that are not read: {', '.join(unread[:_LISTED_FILES])}{rest}.",)


def checked_sequence(sequence: DepthSequence, options: SourceOptions) -> DepthSequence:
    """Read the poses in the requested form, and add notes on the range of depth and the poses."""
    poses = sequence.poses
    if options.pose_form is not None:
        form = parse_pose_form(options.pose_form)
        if poses is None:
            raise InvalidArgument("--pose-form", "a source without poses", "poses", "Name them with --poses.")
        if "wxyz" in form and not sequence.has_quaternions:
            raise InvalidArgument("--pose-form", "wxyz for poses without quaternions", "other words")
        sequence.poses = read_poses_as(poses, form, sequence.frame_names)
        sequence.notes += (f"Poses are read as {', '.join(form)} (--pose-form).",)
    notes = range_notes(sequence)
    check = check_poses(sequence, poses)
    if check is not None:
        sequence.has_wrong_poses = not check.is_right
        notes += (check.note,)
    sequence.notes = (*sequence.notes, *notes)
    return sequence


def depth_scene(sequence: DepthSequence, options: SourceOptions) -> Scene:
    """Return the scene of a depth sequence at the requested rate.

    It is a camera's view or a height map, depending on ``reading``.

    A sequence that does not state its rate and has no `source_rate_hz` already has the requested rate
    (`source_rate`) and is not interpolated.
    """
    checked = checked_sequence(sequence, options)
    sequence = change_rate(checked, options.rate_hz, options.interpolation)
    sequence.has_wrong_poses = checked.has_wrong_poses
    if options.reading == "height":
        from touchfield.sources.terrain.height_scene import HeightScene

        return HeightScene.from_depth_sequence(sequence, options.exaggeration)
    from touchfield.sources.depth.depth_scene import DepthScene

    is_frame_alone = options.world == "frames" or options.frame == "camera" or len(sequence.key_frames()) == 1
    if not is_frame_alone:
        from touchfield.sources.depth.fused_scene import FusedScene, is_static

        if sequence.poses is not None or is_static(sequence):
            return FusedScene(sequence, options.world, options.segment)
    scene = DepthScene(sequence, frame=options.frame, segment=options.segment)
    if not is_frame_alone:
        note = (
            "No poses, and the camera or most of what it sees moves: each frame is rendered alone (--world "
            "frames)"
        )
        scene.notes = (*scene.notes, note)
    return scene


# -- folders of data sets ----------------------------------------------------------------------------------
def _list_stamped(path: Path) -> PictureSet:
    """List the existing pictures of ``depth.txt`` (lines of time and file) or ``depth/TIME.png`` by time."""
    listing, depth = path / "depth.txt", path / "depth"
    notes: tuple[str, ...] = ()
    if listing.is_file():
        listed = []
        for where, tokens in split_lines(read_text(listing), str(listing)):
            try:
                stamp, name = float(tokens[0]), PurePosixPath(tokens[1])
            except (ValueError, IndexError):
                stamp, name = np.inf, PurePosixPath()
            if not abs(stamp) < MAX_TIME_S or name.is_absolute() or ".." in name.parts:
                raise SourceError(
                    where, repr(" ".join(tokens)[:60]), "a time and a file name inside the folder"
                )
            listed.append((stamp, path / name))
        stamped = sorted((stamp, file) for stamp, file in listed if os.path.isfile(file))
        if len(stamped) < len(listed):
            notes = (f"{len(stamped)} of the {len(listed)} frames in depth.txt are there.",)
    else:
        stamped = sorted((float(file.stem), file) for file in list_files(depth, _STAMPED_PNG))
    paths = tuple(file for _, file in stamped)
    source = path if paths else listing if listing.is_file() else depth
    return PictureSet(paths, source, (path,), (path,), np.array([stamp for stamp, _ in stamped]), notes)


def _is_stamped(path: Path) -> bool:
    """Return True for a list of stamped pictures, or ground truth with stamps in fractions of a second."""
    is_listed = any((path / name).is_file() for name in ("depth.txt", "associations.txt", "associated.txt"))
    if is_listed or not (path / "groundtruth.txt").is_file():
        return is_listed and has_files(path / "depth", _STAMPED_PNG)
    return has_files(path / "depth", r"\d+\.\d+\.png")


def _published_camera(path: Path) -> CameraFile | None:
    """Return the published camera named by the path or the head of ``depth.txt``, with a note."""
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


def _list_in_depth(path: Path) -> PictureSet:
    return PictureSet(list_files(path / "depth", _ANY_PNG), path, (path,), (path, path / "depth"))


def _list_sun3d(path: Path) -> PictureSet:
    pictures = _list_in_depth(path)
    return pictures._replace(times_s=_microseconds(pictures.paths))


def _microseconds(paths: tuple[Path, ...]) -> Float64s:
    """Return time stamps in seconds from names FRAME-MICROSECONDS.

    Other names give NaN.
    """
    matches = [_MICROSECONDS.fullmatch(file.stem) for file in paths]
    return np.array([int(match[1]) * 1e-6 if match else np.nan for match in matches])


def _read_extrinsics(path: Path, paths: tuple[Path, ...]) -> PosedFrames | None:
    """Read SUN3D's poses of colour frames and assign them to the depth frames nearest in time."""
    files = list_files(path / "extrinsics", _TEXT)
    if not files:
        return None
    poses = parse_extrinsics(read_text(files[-1]), str(files[-1]))
    colour = list_files(path / "image", _COLOUR)
    times_s, depth_times_s = _microseconds(colour), _microseconds(paths)
    if len(colour) == len(poses) and np.isfinite(times_s).all() and np.isfinite(depth_times_s).all():
        order = np.argsort(times_s, kind="stable")
        nearest = nearest_in_time(times_s[order], depth_times_s, POSE_TOLERANCE_S)
        frame_poses = [poses[order[i]] if i >= 0 else None for i in nearest]
        return drop_unposed(str(files[-1]), frame_poses, "no posed colour frame within 20 ms")
    if len(poses) == len(paths):
        return PosedFrames(tuple(range(len(paths))), poses, ())
    found = f"{len(poses)} poses for {len(paths)} depth and {len(colour)} colour frames"
    mend = "Copy all frames of the sequence, or ignore the poses with --frame camera."
    raise SourceError(str(files[-1]), found, "one for each frame", mend)


def _list_threedmatch(path: Path) -> PictureSet:
    """List the frames of a folder, or with a note of the one folder in it that has frames."""
    folders = _parts_of(path)
    if len(folders) > 1:
        names = ", ".join(f"{folder.name}/" for folder in folders[:6])
        mend = f"Name one: {folders[0]}"
        raise SourceError(str(path), f"{len(folders)} sequences ({names})", "one", mend)
    folder = folders[0] if folders else path
    notes = () if folder == path else (f"The sequence is that of {folder.relative_to(path)}/.",)
    levels = len(folder.parts) - len(path.parts) + 1
    camera_folders = (folder, *folder.absolute().parents[:levels])
    return PictureSet(list_files(folder, _FRAME_PNG), path, (folder,), camera_folders, None, notes)


def _parts_of(path: Path) -> tuple[Path, ...]:
    """Return the folders with frames: a folder itself, else those in it, else those in a folder of its name.

    7-Scenes is unpacked to ``chess/seq-01/frame-...``, or to ``chess/seq-01/seq-01/frame-...``.
    """
    if has_files(path, _FRAME_PNG) or not path.is_dir():
        return (path,)
    inner = [folder for folder in sorted(path.iterdir()) if folder.is_dir()]
    inner += [nested for folder in inner if (nested := folder / folder.name).is_dir()]
    return tuple(folder for folder in inner if has_files(folder, _FRAME_PNG))


# -- pictures of no data set -------------------------------------------------------------------------------
def _list_plain(path: Path) -> PictureSet:
    """List the pictures in ``depth/``, in the folder itself or, with a note, in its one folder with depth."""
    folder = next((folder for folder in (path / "depth", path) if _depth_pictures(folder)), None)
    notes: tuple[str, ...] = ()
    if folder is None:
        candidates = [inner for inner in sorted(p for p in path.iterdir() if p.is_dir()) if _is_depth(inner)]
        named = [inner for inner in candidates if "depth" in inner.name.lower()]
        candidates = named if len(named) == 1 else candidates
        if len(candidates) > 1:
            names = ", ".join(f"{inner.name}/" for inner in candidates[:6])
            mend = f"Name one: {path / candidates[0].name}"
            raise SourceError(
                str(path), f"{len(candidates)} folders of depth pictures ({names})", "one", mend
            )
        folder = candidates[0] if candidates else path
        notes = (f"The depth pictures are those of {folder.name}/.",)
    parent = path.absolute().parent
    parents = (parent,) if "depth" in path.absolute().name.lower() else ()
    folders = tuple(dict.fromkeys((path, folder, *parents)))
    return PictureSet(_depth_pictures(folder), path, folders, (*folders, parent), None, notes)


def _depth_pictures(folder: Path) -> tuple[Path, ...]:
    """Return the pictures of a folder, or only those with "depth" in their name if there are any."""
    paths = next((list_files(folder, form) for form in _PLAIN if has_files(folder, form)), ())
    return tuple([path for path in paths if "depth" in path.stem.lower()] or paths)


def _is_depth(folder: Path, or_8_bits: bool = False) -> bool:
    """Return True if the first picture of a folder holds depth; optionally also if it is grey with 8 bits."""
    try:
        first = picture_header(_depth_pictures(folder)[0])
    except (SourceError, IndexError):
        return False
    excluded = ("", "int8", "bool") if or_8_bits else ("", "uint8", "int8", "bool")
    return first.channels == 1 and first.sample not in excluded


def _is_plain(path: Path) -> bool:
    if not path.is_dir():
        return False
    if _depth_pictures(path / "depth"):
        return _is_depth(path / "depth", or_8_bits=True)  # reading it then reports how to mend 8 bits

    def is_named(folder: Path) -> bool:
        return any("depth" in path.stem.lower() for path in (folder, *_depth_pictures(folder)[:1]))

    has_camera = any(named_like_intrinsics((path,)))
    if _depth_pictures(path):
        return (has_camera or is_named(path)) and _is_depth(path)
    folders = [folder for folder in path.iterdir() if folder.is_dir() and (has_camera or is_named(folder))]
    # a part of a data set is opened in its own layout
    data_sets = [layout.kind for layout in LAYOUTS if layout.name != "depth-folder" and not layout.is_file]
    return any(
        _is_depth(folder) and not any(kind.recognise(folder) for kind in data_sets) for folder in folders
    )


def _is_depth_file(path: Path) -> bool:
    return "depth" in path.name.lower() and path.suffix.lower() in PICTURE_SUFFIXES and path.is_file()


def _open_stack(path: Path) -> PictureSet:
    folder = (path.absolute().parent,)
    return PictureSet((), path, folder, folder, file_frames=ArrayFrames(map_npy(path), path))


def _is_stack(path: Path) -> bool:
    if not _is_depth_file(path) or path.suffix.lower() != ".npy":
        return False
    with path.open("rb") as stream:
        shape = read_npy_header(stream, str(path)).shape
    return len(shape) == 3 and shape[2] != 1


def _open_video(path: Path) -> PictureSet:
    header = video_header(path)
    if not header.is_deep_grey:
        found, expected = (
            f"{header.codec} video of {header.pixels} pixels",
            "16-bit grey (gray16le, gray12le, ...)",
        )
        mend = (
            "It looks like an ordinary video: take --as saliency, or --as relative-depth with its depth "
            "next to it."
        )
        raise SourceError(str(path), found, expected, mend)
    folder = (path.absolute().parent,)
    video = GreyVideo(path)
    return PictureSet((), path, folder, folder, file_frames=video, rate_hz=header.rate_hz, notes=video.notes)


def _is_video(path: Path) -> bool:
    if path.suffix.lower() not in VIDEO_SUFFIXES or not path.is_file():
        return False
    try:
        return video_header(path).is_deep_grey
    except (MissingExtra, SourceError):
        return True  # opening it then reports the missing extra, or what is wrong with the video


LAYOUTS: Final = (
    Layout(
        "tum", "TUM RGB-D sequence: a folder with depth/TIME.png (value/5000 m), depth.txt, groundtruth.txt",
        _is_stamped, _list_stamped, 5000.0, _published_camera, is_timed=True,
    ),
    Layout(
        "redwood", "Redwood or Open3D sequence: a folder with depth/*.png (millimetres) and trajectory.log",
        lambda path: has_files(path, _TRAJECTORY) and has_files(path / "depth", _ANY_PNG),
        _list_in_depth, 1000.0, _PRIMESENSE,
    ),
    Layout(
        "sun3d", "SUN3D sequence: a folder with depth/*.png (rotated bits), intrinsics.txt, extrinsics/*.txt",
        lambda path: has_files(path / "extrinsics", _TEXT) and has_files(path / "depth", _ANY_PNG),
        _list_sun3d, 1000.0, poses=_read_extrinsics, is_rotated=True,
    ),
    Layout(
        "3dmatch", "3DMatch or 7-Scenes sequence: a folder with frame-NNNNNN.depth.png (millimetres) and "
                   ".pose.txt",
        lambda path: any(has_files(folder, _FRAME_PNG) for folder in _parts_of(path)),
        _list_threedmatch, 1000.0, _SEVEN_SCENES,
    ),
    Layout(
        "depth-folder",
        "folder of 16-bit depth pictures, here or in depth/, poses next to them "
        "(needs --depth-scale and --intrinsics)",
        _is_plain, _list_plain,
    ),
    Layout(
        "depth-map",
        "one depth picture named *depth*: 16-bit PNG or TIFF (needs --depth-scale), NPY in metres "
        "(--intrinsics)",
        _is_depth_file, lambda path: PictureSet((path,), path, None, (path.absolute().parent,)), is_file=True,
    ),
    Layout(
        "depth-stack",
        "depth frames in one file named *depth*: NPY [frames, height, width] in metres",
        _is_stack, _open_stack, is_file=True,
    ),
    Layout(
        "depth-video",
        "video of depth: 16-bit grey in MKV, AVI, MOV, MP4 (needs --depth-scale and --intrinsics; extra: "
        "video)",
        _is_video, _open_video, is_file=True,
    ),
)  # fmt: skip

KINDS: Final = {layout.name: layout.kind for layout in LAYOUTS}
