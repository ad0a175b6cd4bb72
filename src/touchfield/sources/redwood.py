"""Redwood and Open3D sequences: ``depth/*.png`` in millimetres, ``trajectory.log``, intrinsics as JSON.

Sources: redwood-data.org (Choi et al., CVPR 2015) and Open3D's reconstruction system. Without an intrinsics file
the PrimeSense default of Open3D is used, and a note says so.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from touchfield.errors import SourceError
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.folder_sequence import (
    DepthCode,
    FolderSequence,
    Frames,
    common_size,
    drop_unposed,
    has_files,
    is_layout,
    list_files,
    missing_intrinsics,
    opener,
    require_folder,
    source_rate,
)
from touchfield.sources.intrinsics_file import resolve_intrinsics
from touchfield.sources.poses import parse_trajectory_log, read_text
from touchfield.sources.registry import SourceKind

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from touchfield.sources.options import SourceOptions

__all__ = ["KIND", "read_sequence"]

_UNITS_PER_M: Final = 1000.0
_PRIMESENSE: Final = Intrinsics(525.0, 525.0, 319.5, 239.5)
_PICTURES: Final = r".+\.png"
_TRAJECTORY: Final = r"trajectory\.log|.*traj(ectory)?\.(log|txt)"


def read_sequence(path: Path, options: SourceOptions) -> DepthSequence:
    """A folder of the Redwood layout.

    Entries of the trajectory belong to the pictures in order where there are as many, else by the number that
    names a picture; a picture without an entry is left out, and a note says so.

    Raises
    ------
    SourceError
        If pictures, poses or the camera are missing or at fault.
    """
    require_folder(path, "Redwood")
    depth = path / "depth"
    paths = tuple(list_files(depth, _PICTURES)) if depth.is_dir() else ()
    if not paths:
        raise SourceError(str(path), "no depth/*.png", "16-bit depth pictures", "Check the folder.")
    poses: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    if options.frame == "world":
        paths, poses, notes = _posed(path, paths)
    size = common_size(paths)
    intrinsics = resolve_intrinsics(options.intrinsics, (path, depth), size)
    if intrinsics is None:
        if size != (640, 480):
            raise missing_intrinsics(str(path))
        intrinsics = _PRIMESENSE
        notes += ("No intrinsics file: the PrimeSense default 525, 525, 319.5, 239.5 is used.",)
    frames = Frames(paths, source_rate(options), poses, notes)
    return FolderSequence(str(path), frames, DepthCode(options.depth_scale or _UNITS_PER_M), intrinsics, size)


def _posed(
    path: Path, paths: tuple[Path, ...]
) -> tuple[tuple[Path, ...], NDArray[np.float64] | None, tuple[str, ...]]:
    files = list_files(path, _TRAJECTORY)
    if not files:
        return paths, None, ("No trajectory.log: the camera is taken to stand still.",)
    log = min(files, key=lambda file: (file.name != "trajectory.log", file.name))
    numbers, poses = parse_trajectory_log(read_text(log), str(log))
    if len(poses) == len(paths):
        return paths, poses, ()
    by_number = dict(zip(numbers.tolist(), poses))
    if not all(file.stem.isdecimal() for file in paths):
        raise SourceError(
            str(log),
            f"{len(poses)} poses for {len(paths)} depth pictures",
            "one for each, or pictures named 00000, 00001, ...",
        )
    return drop_unposed(str(log), paths, [by_number.get(int(file.stem)) for file in paths], f"no entry in {log.name}")


def _recognise(path: Path) -> bool:
    return has_files(path, _TRAJECTORY) and has_files(path / "depth", _PICTURES)


KIND = SourceKind(
    "redwood",
    "Redwood or Open3D sequence: a folder with depth/*.png (millimetres) and trajectory.log",
    is_layout(_recognise),
    opener(read_sequence),
)
