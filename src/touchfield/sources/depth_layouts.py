"""Depth sequences as data sets lay them out on disk: a table of layouts for `touchfield.sources.depth_reader`.

tum         TUM RGB-D (Sturm et al., IROS 2012), and Bonn's and ICL-NUIM's: ``depth/TIME.png``, ``depth.txt``,
            ``groundtruth.txt``; value / 5000 = metres. It ships no intrinsics file: the published ones are used
            where a name says which camera it was.
redwood     Redwood (Choi et al., CVPR 2015) and Open3D: ``depth/*.png`` in millimetres, ``trajectory.log``.
sun3d       SUN3D (Xiao et al., ICCV 2013), the recordings of the paper's section 5.2 ("hotel barcelona"):
            ``depth/FRAME-MICROSECONDS.png`` with rotated bits, mm = (v >> 3) | (v << 13) in 16 bits, and
            ``extrinsics/*.txt`` with the 3x4 camera-to-world matrices of all colour frames, one under the other (of
            several files the last is the newest). A depth frame takes the pose of the colour frame nearest in time.
3dmatch     3DMatch (Zeng et al., CVPR 2017) and 7-Scenes (Shotton et al., CVPR 2013): ``frame-NNNNNN.depth.png`` in
            millimetres and ``frame-NNNNNN.pose.txt``. Of a scene that holds ``seq-01``, ``seq-02``, ... the first is
            read. ``camera-intrinsics.txt`` lies beside the frames or one folder up; 7-Scenes ships none.
depth-folder  16-bit PNG or TIFF, or NPY, in a folder, in its ``depth/`` or in a folder of it. Scale and intrinsics
            must be said, or lie in a file. Of a folder named like depth the folder above it is searched, too.
depth-map   One such picture.
depth-stack Frames in one file: NPY of shape [frames, height, width], or a TIFF of several pages. Named *depth*: an
            NPY of heights over time has the same shape.
depth-video  9 to 16 bits of grey a pixel, coded without loss (FFV1, 16-bit PNG), in MKV, AVI, MOV or MP4.

Floats are metres unless a scale is given; whole numbers of the last four need one.
A frame without a pose is left out, and a note says so (`touchfield.sources.placed_frames`).
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import MissingExtra, SourceError
from touchfield.medium.npz import read_npy_header
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth_reader import Layout, Shots, has_files, list_files
from touchfield.sources.intrinsics_file import CameraFile, named_like_intrinsics
from touchfield.sources.moving_pictures import VIDEO_SUFFIXES, GreyVideo, video_header
from touchfield.sources.pictures import (
    PICTURE_SUFFIXES,
    NpyFrames,
    PictureHeader,
    TiffFrames,
    page_sizes,
    picture_header,
)
from touchfield.sources.placed_frames import POSE_TOLERANCE_S, PlacedFrames, posed_frames
from touchfield.sources.poses import MAX_TIME_S, nearest_in_time, parse_extrinsics, read_text
from touchfield.sources.registry import kinds

_ANY_PNG: Final = r".+\.png"
_STAMPED_PNG: Final = r"\d+(\.\d+)?\.png"
_FRAME_PNG: Final = r"frame-\d+\.depth\.png"
_PLAIN: Final = (r".+\.(png|tif|tiff|pgm)", r".+\.npy")
_TRAJECTORY: Final = r"trajectory\.log|.*traj(ectory)?\.(log|txt)"
_COLOUR: Final = r".+\.(jpg|jpeg|png)"
_TEXT: Final = r".+\.txt"
_MICROSECONDS: Final = re.compile(r"\d+-(\d{1,15})")
_MOST_NAMES: Final = 6
_TIFF: Final = (".tif", ".tiff")

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


def _files(folder: Path, form: str) -> tuple[Path, ...]:
    return tuple(list_files(folder, form)) if folder.is_dir() else ()


def _stamped(path: Path) -> Shots:
    """Pictures that are there, in order of time, of ``depth.txt`` or of ``depth/TIME.png``."""
    listing, depth = path / "depth.txt", path / "depth"
    notes: tuple[str, ...] = ()
    if listing.is_file():
        listed = _listed(listing)
        stamped = sorted((stamp, file) for stamp, file in listed if file.is_file())
        if len(stamped) < len(listed):
            notes = (f"{len(stamped)} of the {len(listed)} frames in depth.txt are there.",)
    else:
        stamped = sorted((float(file.stem), file) for file in _files(depth, _STAMPED_PNG))
    times_s = np.array([stamp for stamp, _ in stamped])
    paths = tuple(file for _, file in stamped)
    where = path if paths else listing if listing.is_file() else depth
    return Shots(paths, where, (path,), (path,), times_s, notes)


def _listed(listing: Path) -> list[tuple[float, Path]]:
    """Time stamps and files of ``depth.txt``: lines of ``time filename``."""
    entries = []
    for number, line in enumerate(read_text(listing).splitlines(), 1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        try:
            stamp, name = float(words[0]), PurePosixPath(words[1])
        except (ValueError, IndexError) as error:
            raise SourceError(f"{listing} line {number}", repr(line[:60]), "a time and a file name") from error
        if not abs(stamp) < MAX_TIME_S or name.is_absolute() or ".." in name.parts:
            raise SourceError(f"{listing} line {number}", repr(line[:60]), "a time, and a file inside the folder")
        entries.append((stamp, listing.parent / name))
    return entries


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
            note = f"No intrinsics file: the published ones of {camera}, {k.fx}, {k.fy}, {k.cx}, {k.cy}, are used."
            return CameraFile(k, notes=(note,), is_mirrored=camera == "icl")
    return None


def _microseconds(paths: tuple[Path, ...]) -> Float64s:
    """Time stamps in seconds from names FRAME-MICROSECONDS."""
    matches = [_MICROSECONDS.fullmatch(file.stem) for file in paths]
    return np.array([int(match[1]) * 1e-6 if match else np.nan for match in matches])


def _sun3d(path: Path) -> Shots:
    paths = _files(path / "depth", _ANY_PNG)
    return Shots(paths, path, (path,), (path,), _microseconds(paths))


def _extrinsics(path: Path, paths: tuple[Path, ...]) -> PlacedFrames | None:
    """SUN3D's poses of colour frames, for the depth frames nearest in time."""
    if not has_files(path / "extrinsics", _TEXT):
        return None
    file = list_files(path / "extrinsics", _TEXT)[-1]
    poses = parse_extrinsics(read_text(file), str(file))
    colour = _files(path / "image", _COLOUR)
    times_s, wanted_s = _microseconds(colour), _microseconds(paths)
    if len(colour) == len(poses) and np.isfinite(times_s).all() and np.isfinite(wanted_s).all():
        order = np.argsort(times_s, kind="stable")
        nearest = nearest_in_time(times_s[order], wanted_s, POSE_TOLERANCE_S)
        taken = [poses[order[i]] if i >= 0 else None for i in nearest]
        return posed_frames(str(file), taken, "no posed colour frame within 20 ms")
    if len(poses) == len(paths):
        return PlacedFrames(tuple(range(len(paths))), poses, ())
    found = f"{len(poses)} poses for {len(paths)} depth and {len(colour)} colour frames"
    mend = "Copy all frames of the sequence, or ignore the poses with --frame camera."
    raise SourceError(str(file), found, "one for each frame", mend)


def _redwood(path: Path) -> Shots:
    return Shots(_files(path / "depth", _ANY_PNG), path, (path,), (path, path / "depth"))


def _threedmatch(path: Path) -> Shots:
    """Frames of a folder, or of the first of its parts, with a note."""
    folder = path
    notes: tuple[str, ...] = ()
    if not has_files(path, _FRAME_PNG):
        parts = [part for part in list_files(path, r"seq-\d+") if has_files(part, _FRAME_PNG)]
        folder = parts[0] if parts else path
        if len(parts) > 1:
            notes = (f"The first of {len(parts)} sequences, {folder.name}, is read.",)
    places = tuple(dict.fromkeys((folder, path)))
    return Shots(_files(folder, _FRAME_PNG), folder, places, (folder, folder.absolute().parent), None, notes)


def _plain(path: Path) -> Shots:
    """Pictures in ``depth/``, in the folder itself or, with a note, in its one folder with depth."""
    folder = next((folder for folder in (path / "depth", path) if _depth_pictures(folder)), None)
    notes: tuple[str, ...] = ()
    if folder is None:
        inside = [inner for inner in sorted(p for p in path.iterdir() if p.is_dir()) if _is_depth(inner)]
        named = [inner for inner in inside if "depth" in inner.name.lower()]
        inside = named if len(named) == 1 else inside
        if len(inside) > 1:
            names = ", ".join(f"{inner.name}/" for inner in inside[:_MOST_NAMES])
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
    for form in _PLAIN:
        if has_files(folder, form):
            paths = list_files(folder, form)
            return tuple([path for path in paths if "depth" in path.stem.lower()] or paths)
    return ()


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
    has_camera = any(named_like_intrinsics((path,)))
    if _depth_pictures(path):
        return (has_camera or _is_named_depth(path)) and _is_depth(path)
    inner = [folder for folder in path.iterdir() if folder.is_dir() and (has_camera or _is_named_depth(folder))]
    return any(_is_depth(folder) and not _is_of_a_layout(folder) for folder in inner)


def _is_of_a_layout(folder: Path) -> bool:
    """Tell a folder that is a source of another kind, and to be opened itself."""
    return any(kind.recognise(folder) for kind in kinds() if kind.name != "depth-folder")


def _is_named_depth(folder: Path) -> bool:
    """Tell a folder that is named like depth, or whose pictures are."""
    return any("depth" in path.stem.lower() for path in (folder, *_depth_pictures(folder)[:1]))


# -- one file ------------------------------------------------------------------------------------------------
def _one(path: Path) -> Shots:
    """One picture; poses are not asked for."""
    return Shots((path,), path, None, (path.absolute().parent,))


def _is_one(path: Path) -> bool:
    return "depth" in path.name.lower() and path.suffix.lower() in PICTURE_SUFFIXES and path.is_file()


def _stack(path: Path) -> Shots:
    folder = (path.absolute().parent,)
    frames = TiffFrames(path) if path.suffix.lower() in _TIFF else NpyFrames(path)
    return Shots((), path, folder, folder, one_file=frames)


def _is_stack(path: Path) -> bool:
    if "depth" not in path.name.lower() or not path.is_file():
        return False
    if path.suffix.lower() == ".npy":
        with path.open("rb") as stream:
            shape = read_npy_header(stream, str(path)).shape
        return len(shape) == 3 and shape[2] != 1
    if path.suffix.lower() not in _TIFF or picture_header(path).channels != 1:
        return False
    sizes = page_sizes(path, most=2)
    return len(sizes) > 1 and sizes[1] == sizes[0]  # an elevation model keeps smaller copies of itself as pages


class _DeepVideo(GreyVideo):
    """A video of more than 8 bits a pixel, as frames."""

    paths: tuple[Path, ...] = ()
    headers: tuple[PictureHeader, ...] = ()

    def _values(self, picture: Any) -> NDArray[Any]:
        values = super()._values(picture)
        if values.dtype != np.uint16:
            raise _shallow(str(self.path), "a frame of 8 bits")
        return values


def _shallow(where: str, found: str) -> SourceError:
    mend = "It looks like an ordinary video: take --as saliency, or --as relative-depth with its depth beside it."
    return SourceError(where, found, "16-bit grey (gray16le, gray12le, ...)", mend)


def _video(path: Path) -> Shots:
    header = video_header(path)
    if not header.is_deep_grey:
        raise _shallow(str(path), f"{header.codec} video of {header.pixels} pixels")
    folder = (path.absolute().parent,)
    return Shots((), path, folder, folder, one_file=_DeepVideo(path), rate_hz=header.rate_hz)


def _is_video(path: Path) -> bool:
    if path.suffix.lower() not in VIDEO_SUFFIXES or not path.is_file():
        return False
    try:
        return video_header(path).is_deep_grey
    except (MissingExtra, SourceError):
        return True  # so that the user is told which extra reads videos, or what is wrong with this one


LAYOUTS: Final = (
    Layout(
        "tum",
        "TUM RGB-D sequence: a folder with depth/TIME.png (value/5000 m), depth.txt, groundtruth.txt",
        _is_stamped,
        _stamped,
        5000.0,
        _published,
        is_timed=True,
    ),
    Layout(
        "redwood",
        "Redwood or Open3D sequence: a folder with depth/*.png (millimetres) and trajectory.log",
        lambda path: has_files(path, _TRAJECTORY) and has_files(path / "depth", _ANY_PNG),
        _redwood,
        1000.0,
        _PRIMESENSE,
    ),
    Layout(
        "sun3d",
        "SUN3D sequence: a folder with depth/*.png (rotated bits), intrinsics.txt, extrinsics/*.txt",
        lambda path: has_files(path / "extrinsics", _TEXT) and has_files(path / "depth", _ANY_PNG),
        _sun3d,
        1000.0,
        poses=_extrinsics,
        is_rotated=True,
    ),
    Layout(
        "3dmatch",
        "3DMatch or 7-Scenes sequence: a folder with frame-NNNNNN.depth.png (millimetres) and .pose.txt",
        lambda path: path.is_dir() and bool(_threedmatch(path).paths),
        _threedmatch,
        1000.0,
        _SEVEN_SCENES,
    ),
    Layout(
        "depth-folder",
        "folder of 16-bit depth pictures, here or in depth/, poses beside them "
        "(needs --depth-scale and --intrinsics)",
        _is_plain,
        _plain,
    ),
    Layout(
        "depth-map",
        "one depth picture named *depth*: 16-bit PNG or TIFF (needs --depth-scale), NPY in metres (--intrinsics)",
        _is_one,
        _one,
        is_file=True,
    ),
    Layout(
        "depth-stack",
        "depth frames in one file named *depth*: NPY [frames, height, width] in metres, or a TIFF of several pages",
        _is_stack,
        _stack,
        is_file=True,
    ),
    Layout(
        "depth-video",
        "video of depth: 16-bit grey in MKV, AVI, MOV, MP4 (needs --depth-scale and --intrinsics; extra: video)",
        _is_video,
        _video,
        is_file=True,
    ),
)

KINDS: Final = {layout.name: layout.kind for layout in LAYOUTS}
