"""The source kinds: which there are, which one a path is, and how it is opened.

A new kind is one new module that ends in ``KIND = SourceKind(...)`` and one line in `MODULES`, or a row of the table
of depth layouts (``touchfield.sources.depth_layouts``) and a line that names module and row. The modules must be
cheap to import: what is heavy (numba, Pillow) is imported when it is used.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.files import require_plain
from touchfield.sources.options import SourceOptions
from touchfield.sources.pictures import contents
from touchfield.sources.scene import Scene

MODULES = (  # in the order in which they are asked: the particular before the general
    "physics",
    "analytic_scene",
    "mjcf",
    "stored",
    "contact_trace",
    "animated_mesh",
    "mesh",
    "depth_layouts:tum",
    "depth_layouts:redwood",
    "depth_layouts:sun3d",
    "depth_layouts:3dmatch",
    "depth_layouts:depth-video",
    "inverse_depth:relative-depth",
    "saliency",
    "depth_layouts:depth-stack",
    "depth_layouts:depth-folder",
    "inverse_depth:disparity",
    "height_scene",
    "depth_layouts:depth-map",
)

_UNIT_FACTORS: Final = (1000.0, 100.0, 1e4, 1e6, 10.0)  # between units that are mistaken, the usual first
_LIKELY_M: Final = (0.01, 20.0)  # usual sizes of things and rooms
_MOST_FOLDERS = 1000
_MOST_TOLD = 6


@dataclass(frozen=True)
class SourceKind:
    """One kind of source.

    Parameters
    ----------
    name : str; What ``--as`` takes.
    summary : str; One line for the user: what it is and which files it takes; ``--as`` takes its words, too.
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
    """All source kinds, the particular before the general."""
    return tuple(_kind(*entry.split(":")) for entry in MODULES)


def _kind(module: str, row: str | None = None) -> SourceKind:
    holder = import_module(f"touchfield.sources.{module}")
    kind: SourceKind = holder.KIND if row is None else holder.KINDS[row]
    return kind


def open_source(path: str | Path, options: SourceOptions | None = None) -> Scene:
    """Open a file or folder as a scene.

    Of a folder that is no source itself, the one folder in it that is a source is opened, and a note says so.

    Raises `SourceError` if there is no file or folder at `path`, no kind recognises it, or its data are at fault;
    `InvalidArgument` if ``options.kind`` names no kind.
    """
    path, options = Path(path), options or SourceOptions()
    asked = _named(options.kind or ("relative-depth" if options.relative_depth else None))
    if not os.path.exists(path):  # unlike Path.exists, it answers for a name that is too long as well
        raise SourceError(str(path), "nothing there", "a file or folder", "Check the path.")
    require_plain(path, "a file or folder", or_folder=True)
    known = asked if len(asked) == 1 else tuple(kind for kind in asked if kind.recognise(path))
    if known:
        return known[0].open(path, options)
    if options.kind is not None:
        names = ", ".join(kind.name for kind in asked)
        raise SourceError(str(path), f"no source that {options.kind!r} alone tells", f"--as with one of {names}")
    return _open_inner(path, options)


def _named(word: str | None) -> tuple[SourceKind, ...]:
    """The kinds that are called by a word: by their name, or else those whose description names it."""
    if word is None:
        return kinds()
    asked = _words(word)
    named = tuple(kind for kind in kinds() if kind.name == word)
    named = named or tuple(kind for kind in kinds() if asked and asked <= _words(f"{kind.name} {kind.summary}"))
    if not named:
        names = ", ".join(kind.name for kind in kinds())
        raise InvalidArgument("--as", repr(word), f"one of {names}, or a word of their descriptions")
    return named


def _words(text: str) -> frozenset[str]:
    """The words of a text in small letters; of one with a hyphen its parts, and both together."""
    whole = re.findall(r"[a-z0-9]+(?:-[a-z0-9]+)*", text.lower())
    return frozenset(part for word in whole for part in (*word.split("-"), word.replace("-", "")))


def _open_inner(path: Path, options: SourceOptions) -> Scene:
    """The one folder of a folder that is a source."""
    names = ", ".join(kind.name for kind in kinds())
    if not path.is_dir():
        raise SourceError(str(path), "no kind of source that is known", f"one of {names}", "Name its kind with --as.")
    inner = sorted(islice((p for p in path.iterdir() if p.is_dir()), _MOST_FOLDERS))
    firsts = ((p, next((kind for kind in kinds() if kind.recognise(p)), None)) for p in inner)
    sources = [(p, kind) for p, kind in firsts if kind]
    if len(sources) == 1:
        ((folder, kind),) = sources
        scene = kind.open(folder, options)
        scene.notes = (f"{folder.name}/ is read, the one folder here that is a source ({kind.name}).", *scene.notes)
        return scene
    if sources:
        text = ", ".join(f"{p.name}/ ({kind.name})" for p, kind in sources[:_MOST_TOLD])
        text = f"{len(sources)} folders that are sources: {text}{', ...' * (len(sources) > _MOST_TOLD)}"
        raise SourceError(str(path), text, "one", f"Name one: {sources[0][0]}")
    found = f"no kind of source that is known, but {contents(path)}"
    raise SourceError(str(path), found, f"one of {names}", "Name its kind with --as.")


def unit_notes(scene: Scene, start: int, stop: int) -> tuple[str, ...]:
    """A warning where frames start to stop - 1 are out of all proportion, with the factor that would mend it."""
    if scene.unit is None:
        return ()
    option, (low, high), is_divided = scene.unit
    size_m = float(np.ptp(scene.bounds_between_m(start, stop), axis=0).max())
    if low <= size_m <= high:
        return ()
    is_large = size_m > high
    sizes = [(factor, size_m / factor if is_large else size_m * factor) for factor in _UNIT_FACTORS]
    factor, mended_m = next((s for s in sizes if _LIKELY_M[0] <= s[1] <= _LIKELY_M[1]), sizes[0])
    way = "larger" if is_large == is_divided else "smaller"
    return (
        f"Is the unit right? The scene measures {size_m:.3g} m across: with {option} {factor:g} times {way} it would "
        f"be {mended_m:.3g} m.",
    )
