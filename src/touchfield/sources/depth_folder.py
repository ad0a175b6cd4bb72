"""A plain folder of depth pictures: 16-bit PNG or TIFF, or NPY, directly in it, in ``depth/`` or in a folder of it.

What no data set's layout tells must be said: how many units are in one metre, and the intrinsics (asked for, or in a
file of the folder). Poses are looked for beside the pictures (`touchfield.sources.placed_frames`). Of a folder named
like depth (``SEQUENCE/depth``) the folder above it is searched, too.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence
from touchfield.sources.folder_contents import contents
from touchfield.sources.folder_sequence import (
    DepthCode,
    FolderSequence,
    Frames,
    common_size,
    has_files,
    is_layout,
    list_files,
    opener,
    require_folder,
    source_rate,
)
from touchfield.sources.intrinsics_file import CameraFile, camera_of, find_intrinsics
from touchfield.sources.pictures import picture_header
from touchfield.sources.placed_frames import placed_frames
from touchfield.sources.registry import SourceKind, kinds

if TYPE_CHECKING:
    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "read_sequence", "require_scale"]

_PICTURES: Final = (r".+\.(png|tif|tiff|pgm)", r".+\.npy")
_MOST_NAMES: Final = 6


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of depth pictures of one size.

    Raises
    ------
    SourceError
        If there is no picture, one is at fault, or the scale or the intrinsics are not known.
    """
    require_folder(path, "depth folder")
    folder, told = _folder_of_pictures(path)
    paths = _pictures(folder)
    folders = tuple(dict.fromkeys((path, folder, *_above(path))))
    placed = placed_frames(str(path), paths, options, folders)
    size = common_size(paths)
    camera = camera_of(str(path), options.intrinsics, (*folders, path.absolute().parent), size)
    units_per_m = require_scale(str(path), options, picture_header(paths[0]).sample, camera)
    frames = Frames(paths, source_rate(options), notes=told).placed(placed, camera)
    return FolderSequence(str(path), frames, DepthCode(units_per_m), camera.intrinsics, size)


def _above(path: Path) -> tuple[Path, ...]:
    """The folder above one that is only the depth of a sequence."""
    return (path.absolute().parent,) if "depth" in path.absolute().name.lower() else ()


def _folder_of_pictures(path: Path) -> tuple[Path, tuple[str, ...]]:
    """The folder of the pictures: ``depth/``, the folder itself or, with a note, its one folder with depth.

    Raises
    ------
    SourceError
        If there are none, or several folders of them.
    """
    for folder in (path / "depth", path):
        if _pictures(folder):
            return folder, ()
    held = [inner for inner in sorted(p for p in path.iterdir() if p.is_dir()) if _is_depth(inner)]
    named = [inner for inner in held if "depth" in inner.name.lower()]
    found = named if len(named) == 1 else held
    if len(found) == 1:
        return found[0], (f"The depth pictures are those of {found[0].name}/.",)
    if found:
        names = ", ".join(f"{inner.name}/" for inner in found[:_MOST_NAMES])
        mend = f"Name one: {path / found[0].name}"
        raise SourceError(str(path), f"{len(found)} folders of depth pictures ({names})", "one", mend)
    mend = "Check the folder."
    raise SourceError(
        str(path), f"no depth picture but {contents(path)}", "16-bit PNG or TIFF here or in depth/", mend
    )


def _pictures(folder: Path) -> tuple[Path, ...]:
    """The pictures of a folder; where some are named like depth and others not, those that are."""
    for form in _PICTURES:
        if has_files(folder, form):
            paths = list_files(folder, form)
            return tuple([path for path in paths if "depth" in path.stem.lower()] or paths)
    return ()


def _is_depth(folder: Path) -> bool:
    """Tell a folder of depth by its first picture."""
    try:
        first = picture_header(_pictures(folder)[0])
    except (SourceError, IndexError):
        return False
    return first.channels == 1 and first.sample not in ("", "uint8", "int8", "bool")


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


def _recognise(path: Path) -> bool:
    if not path.is_dir():
        return False
    if _pictures(path / "depth"):
        return _is_depth(path / "depth")
    told = find_intrinsics((path,)) is not None
    if _pictures(path):
        return (told or _is_named_depth(path)) and _is_depth(path)
    inner = [folder for folder in path.iterdir() if folder.is_dir() and (told or _is_named_depth(folder))]
    return any(_is_depth(folder) and not _is_of_a_layout(folder) for folder in inner)


def _is_of_a_layout(folder: Path) -> bool:
    """Tell a folder that is a source of another kind, and to be opened itself."""
    return any(kind.recognise(folder) for kind in kinds() if kind is not KIND)


def _is_named_depth(folder: Path) -> bool:
    """Tell a folder that is named like depth, or whose pictures are."""
    return any("depth" in path.stem.lower() for path in (folder, *_pictures(folder)[:1]))


KIND = SourceKind(
    "depth-folder",
    "folder of 16-bit depth pictures, here or in depth/, poses beside them (needs --depth-scale and --intrinsics)",
    is_layout(_recognise),
    opener(read_sequence),
)
