"""The source kinds: which there are, which one a path is, and how it is opened.

A new kind is one new module that ends in ``KIND = SourceKind(...)`` and one line in `MODULES`. The modules
must be cheap to import: what is heavy (numba, trimesh, Pillow) is imported when it is used.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from touchfield.errors import InvalidArgument, SourceError
from touchfield.files import require_plain
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import Scene

__all__ = ["SourceKind", "kinds", "open_source"]

MODULES = (  # in the order in which they are asked: the particular before the general
    "physics",
    "analytic",
    "mjcf",
    "stored",
    "animated_mesh",
    "mesh",
    "tum",
    "redwood",
    "sun3d",
    "threedmatch",
    "depth_video",
    "relative_depth",
    "saliency",
    "depth_stack",
    "depth_folder",
    "disparity",
    "height_map",
    "depth_map",
)


@dataclass(frozen=True)
class SourceKind:
    """One kind of source.

    Parameters
    ----------
    name : str
        What ``--as`` takes.
    summary : str
        One line for the user: what it is and which files it takes.
    recognise : callable
        ``recognise(path) -> bool``: by names and a few bytes only; never raises for a readable path.
    open : callable
        ``open(path, options) -> Scene``; raises `SourceError` for data at fault.
    """

    name: str
    summary: str
    recognise: Callable[[Path], bool]
    open: Callable[[Path, SourceOptions], Scene]


@cache
def kinds() -> tuple[SourceKind, ...]:
    """All source kinds, the particular before the general."""
    return tuple(import_module(f"touchfield.sources.{name}").KIND for name in MODULES)


def open_source(path: str | Path, options: SourceOptions | None = None) -> Scene:
    """Open a file or folder as a scene.

    Raises
    ------
    SourceError
        If there is no file or folder at `path`, no kind recognises it, or its data are at fault.
    InvalidArgument
        If ``options.kind`` names no kind.
    """
    path, options = Path(path), options or SourceOptions()
    names = ", ".join(kind.name for kind in kinds())
    if options.kind is not None and options.kind not in [kind.name for kind in kinds()]:
        raise InvalidArgument("--as", repr(options.kind), f"one of {names}")
    if not os.path.exists(path):  # unlike Path.exists, it answers for a name that is too long as well
        raise SourceError(str(path), "nothing there", "a file or folder", "Check the path.")
    require_plain(path, "a file or folder", or_folder=True)
    asked = options.kind or ("relative-depth" if options.relative_depth else None)
    for kind in kinds():
        if kind.name == asked or (asked is None and kind.recognise(path)):
            return kind.open(path, options)
    raise SourceError(str(path), "no kind of source that is known", f"one of {names}", "Name its kind with --as.")
