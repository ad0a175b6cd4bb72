"""The source kinds: which there are, which one a path is, and how it is opened.

Other distributions add kinds by entry points of the group ``touchfield.sources``, each a `SourceKind`. A kind
of this package is a module that ends in ``KIND = SourceKind(...)`` and a line in `MODULES`, or a row of the
table of depth layouts (``touchfield.sources.depth.layouts``) and a line that names module and row. The
modules must be cheap to import: what is heavy (numba, Pillow) is imported when it is used.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np

from touchfield.errors import SourceError, require_one_of
from touchfield.files import require_plain
from touchfield.plugins import plugins
from touchfield.sources.images.pictures import contents
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import Scene

MODULES = (  # in the order in which they are asked: the particular before the general
    "physics.toml_file",
    "shapes.analytic_scene",
    "physics.mjcf",
    "stored",
    "recordings.contact_trace",
    "animation.animated_mesh",
    "mesh.mesh_files",
    "depth.layouts:tum",
    "depth.layouts:redwood",
    "depth.layouts:sun3d",
    "depth.layouts:3dmatch",
    "depth.layouts:depth-video",
    "depth.inverse_depth:relative-depth",
    "video.saliency",
    "depth.layouts:depth-stack",
    "depth.layouts:depth-folder",
    "depth.inverse_depth:disparity",
    "terrain.height_scene",
    "depth.layouts:depth-map",
)


@dataclass(frozen=True)
class SourceKind:
    """One kind of source.

    Parameters
    ----------
    name : str; What ``--as`` takes.
    summary : str; One line for the user: what it is and which files it takes.
    tell : callable; ``tell(path) -> bool``: whether a path is of this kind, by names and a few bytes.
    open : callable; ``open(path, options) -> Scene``; raises `SourceError` for data at fault.
    """

    name: str
    summary: str
    tell: Callable[[Path], bool]
    open: Callable[[Path, SourceOptions], Scene]

    def recognise(self, path: Path) -> bool:
        """True if a path is of this kind; what cannot be read is not."""
        try:
            return self.tell(path)
        except (OSError, SourceError):
            return False


@cache
def kinds() -> tuple[SourceKind, ...]:
    """All source kinds, the particular before the general: plug-ins, which were installed on purpose, come
    first.
    """
    built_in = tuple(_kind(*entry.split(":")) for entry in MODULES)
    return (*plugins("touchfield.sources", SourceKind).values(), *built_in)


def _kind(module: str, row: str | None = None) -> SourceKind:
    holder = import_module(f"touchfield.sources.{module}")
    kind: SourceKind = holder.KIND if row is None else holder.KINDS[row]
    return kind


def open_source(path: str | Path, options: SourceOptions | None = None) -> Scene:
    """Open a file or folder as a scene.

    Raises `SourceError` if there is no file or folder at `path`, no kind recognises it, or its data are at
    fault; `InvalidArgument` if ``options.kind`` names no kind.
    """
    path, options = Path(path), options or SourceOptions()
    by_name = {kind.name: kind for kind in kinds()}
    name = options.kind or ("relative-depth" if options.relative_depth else None)
    if name is not None:
        require_one_of("--as", name, by_name)
    if not os.path.exists(path):  # unlike Path.exists, it answers for a name that is too long as well
        raise SourceError(str(path), "nothing there", "a file or folder", "Check the path.")
    require_plain(path, "a file or folder", or_folder=True)
    kind = (
        by_name[name] if name is not None else next((kind for kind in kinds() if kind.recognise(path)), None)
    )
    if kind is None:
        found = "no kind of source that is known" + (f", but {contents(path)}" if path.is_dir() else "")
        mend = "Name its kind with --as, or a folder in it." if path.is_dir() else "Name its kind with --as."
        raise SourceError(str(path), found, f"one of {', '.join(by_name)}", mend)
    return kind.open(path, options)


def unit_notes(scene: Scene, start: int, stop: int) -> tuple[str, ...]:
    """A question where frames start to stop - 1 are out of all proportion."""
    if scene.unit is None:
        return ()
    option, low, high = scene.unit
    size_m = float(np.ptp(scene.bounds_between_m(start, stop), axis=0).max())
    return (
        ()
        if low <= size_m <= high
        else (f"Is the unit right? The scene measures {size_m:.3g} m across ({option}).",)
    )
