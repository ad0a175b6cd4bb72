"""Lists the kinds of source, recognises which kind a path is, and opens it as a scene.

Other distributions add kinds through entry points of the group ``touchfield.sources``, each a `SourceKind`. A
kind of this package is either a module that ends in ``KIND = SourceKind(...)`` with a line in `_ENTRIES`, or
a row of the table of depth layouts (``touchfield.sources.depth.layouts``) with a line that names module and
row. The modules must be cheap to import: heavy libraries (numba, Pillow) are imported where they are used.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Final

from touchfield.errors import SourceError, require_one_of
from touchfield.files import require_plain
from touchfield.plugins import plugins
from touchfield.sources.images.pictures import contents
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import Scene
from touchfield.sources.unread_files import READABLE_FOLDERS, unread_file

_ENTRIES: Final = (  # in the order in which they are tried: specific kinds before general ones
    "physics.toml_file",
    "shapes.analytic_scene",
    "physics.mjcf",
    "physics.urdf",
    "stored",
    "depth.recorders.ros_bag",
    "recordings.cluster_textures",
    "recordings.matlab_contacts",
    "recordings.contact_trace",
    "animation.animated_mesh",
    "clouds.cloud_files",
    "mesh.mesh_files",
    "depth.recorders.stray_scanner/",
    "depth.recorders.polycam/",
    "depth.recorders.nerfstudio/",
    "depth.recorders.bundlefusion/",
    "depth.recorders.realsense/",
    "depth.layouts:tum/",
    "depth.layouts:redwood/",
    "depth.layouts:sun3d/",
    "depth.layouts:3dmatch/",
    "depth.recorders.open3d_recording/",
    "depth.layouts:depth-video",
    "depth.inverse_depth:relative-depth",
    "video.saliency",
    "depth.layouts:depth-stack",
    "depth.recorders.tiff_stack",
    "depth.layouts:depth-folder/",
    "depth.recorders.disparity_npz",
    "depth.inverse_depth:disparity",
    "terrain.height_files",
    "depth.layouts:depth-map",
)
"""Modules of the kinds, or "MODULE:ROW" of a table; an entry that ends in "/" recognises folders only."""

MODULES: Final = tuple(entry.removesuffix("/") for entry in _ENTRIES)

FOLDER_MODULES: Final = frozenset(entry.removesuffix("/") for entry in _ENTRIES if entry.endswith("/"))
"""Those of `MODULES` that recognise folders only, and are not imported for a file."""


@dataclass(frozen=True)
class SourceKind:
    """One kind of source.

    Parameters
    ----------
    name : str; Value of ``--as``.
    summary : str; One line for the user: what the kind is and which files it reads.
    matches : callable; ``matches(path) -> bool``: whether a path is of this kind, by names and a few bytes.
    open : callable; ``open(path, options) -> Scene``; raises `SourceError` for invalid data.
    """

    name: str
    summary: str
    matches: Callable[[Path], bool]
    open: Callable[[Path, SourceOptions], Scene]

    def recognise(self, path: Path) -> bool:
        """Return True if a path is of this kind; False if it cannot be read."""
        try:
            return self.matches(path)
        except (OSError, SourceError):
            return False


@cache
def kinds() -> tuple[SourceKind, ...]:
    """Return all source kinds: plug-ins first, then specific kinds before general ones."""
    return tuple(_kinds_in_order())


def _kinds_in_order(is_file: bool = False) -> Iterator[SourceKind]:
    """Yield the kinds in the order in which they are tried, and import no module before its turn.

    Those of folders are left out for a file.
    """
    yield from plugins("touchfield.sources", SourceKind).values()
    entries = (entry for entry in MODULES if not (is_file and entry in FOLDER_MODULES))
    yield from (_kind(*entry.split(":")) for entry in entries)


@cache
def _kind(module: str, key: str | None = None) -> SourceKind:
    """Return the kind of a module, or that of a row of its table `KINDS`."""
    namespace = import_module(f"touchfield.sources.{module}")
    kind: SourceKind = namespace.KIND if key is None else namespace.KINDS[key]
    return kind


def open_source(path: str | Path, options: SourceOptions | None = None) -> Scene:
    """Open a file or folder as a scene.

    Raises `SourceError` if there is no file or folder at `path`, no kind recognises it, or its data are
    invalid; `InvalidArgument` if ``options.kind`` is not the name of a kind.
    """
    path = Path(path)
    options = options or SourceOptions()
    name = options.kind or ("relative-depth" if options.relative_depth else None)
    by_name = {} if name is None else {kind.name: kind for kind in kinds()}
    if name is not None:
        require_one_of("--as", name, by_name)
    if not os.path.exists(path):  # unlike Path.exists, does not raise for a name that is too long
        raise SourceError(str(path), "nothing there", "a file or folder", "Check the path.")
    require_plain(path, "a file or folder", or_folder=True)
    if name is not None:
        return by_name[name].open(path, options)
    for kind in _kinds_in_order(is_file=not path.is_dir()):
        if kind.recognise(path):
            return kind.open(path, options)
    textures = import_module("touchfield.sources.recordings.texture_sets")  # as a kind: it is needed rarely
    error: SourceError | None = textures.texture_only(path)
    if error is not None:
        raise error
    if not path.is_dir():
        raise unread_file(path)
    found = f"no kind of source that is known, but {contents(path)}"
    mend = "Name a folder or a file in it, or the kind with --as (docs/depth-sequences.md)."
    raise SourceError(str(path), found, READABLE_FOLDERS, mend)
