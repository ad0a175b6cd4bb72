"""The files that a MuJoCo model names, before MuJoCo opens them: all lie in its folder, or the user allows more.

MuJoCo looks for a file beside the model and beside the file that names it, in the folders that a ``compiler`` names
and without them, with its folders or, with ``strippath``, without. Every place at which there is something is looked
at here; attributes are read by name, so that an element of a later version is met, too.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Final
from xml.parsers import expat

from touchfield.errors import SourceError
from touchfield.files import plain_size, require_beside, require_plain

__all__ = ["check_files"]

_MAX_BYTES: Final = 1 << 26
_MAX_FILES: Final = 256
_MAX_PLACES: Final = 1 << 16
_FOLDERS: Final = ("assetdir", "meshdir", "texturedir")
_MODELS: Final = ("include", "model")
_MOST: Final = {("count",): 1 << 16, ("nkey",): 1 << 16, ("nrow", "ncol"): 1 << 24, ("width", "height"): 1 << 24}
"""Attributes of an element whose product is how much of something is made without bytes for it in the file."""


@dataclass
class _Named:
    """What the files of a model name: files with their place in the text, folders, and where they are looked for."""

    names: list[tuple[str, str]] = field(default_factory=list)
    folders: set[str] = field(default_factory=lambda: {""})
    beside: set[Path] = field(default_factory=set)


def check_files(path: Path, *, anywhere: bool = False) -> None:
    """Refuse a model that names what lies outside its folder, or is no plain file, or asks for counts beyond reason.

    Parameters
    ----------
    anywhere : bool; Whether the user allows files outside the folder.

    Raises `SourceError`: It names the file, the element and the attribute.
    """
    named, waiting, met = _Named(), [path], set()
    while waiting:
        model = waiting.pop()
        resolved = model.resolve()
        if resolved in met:
            continue
        met.add(resolved)
        if len(met) > _MAX_FILES:
            raise SourceError(str(path), f"more than {_MAX_FILES} files that include others", "fewer")
        named.beside |= {path.parent, model.parent}
        for where, name in _read(model, named):
            for folder in (path.parent, model.parent):
                found = _there(path.parent, folder / name, name, where, anywhere)
                waiting += [found] if found else []
    if len(named.names) * len(named.folders) * len(named.beside) > _MAX_PLACES:
        raise SourceError(str(path), f"{len(named.names)} files in {len(named.folders)} folders", "fewer")
    for (where, name), folder, inner in product(named.names, named.beside, named.folders):
        for last in {name, os.path.basename(name)}:
            _there(path.parent, folder / inner / last, name, where, anywhere)


def _there(folder: Path, place: Path, name: str, where: str, anywhere: bool) -> Path | None:
    """The place, if there is something: a plain file, and within the folder."""
    try:
        if not place.exists() or place.is_dir():
            return None
    except (OSError, ValueError):
        return None
    require_beside(folder, place, f"{where} {name[:80]!r}", anywhere=anywhere)
    require_plain(place, f"a file, as {where} names it")
    return place


def _read(model: Path, named: _Named) -> list[tuple[str, str]]:
    """The further models that one includes, with where it does; all else goes into `named`."""
    size = plain_size(model, "a MuJoCo model")
    if size > _MAX_BYTES:
        raise SourceError(str(model), f"{size} bytes", f"a model of up to {_MAX_BYTES} bytes")
    models: list[tuple[str, str]] = []
    for tag, attributes in _elements(model):
        where = f"{model}: {tag}"
        for key in _FOLDERS:
            named.folders |= set(_spelt(attributes.get(key, "")))
        for key, value in attributes.items():
            if key.startswith("file"):
                more = [(f"{where} {key}", name) for name in _spelt(value)]
                (models if tag in _MODELS else named.names).extend(more)
        for keys, most in _MOST.items():
            _check_count(where, {key: attributes[key] for key in keys if key in attributes}, most)
    return models


def _spelt(name: str) -> list[str]:
    """A name as MuJoCo may take it: both slashes part folders, and blanks about it may count or not."""
    plain = name.replace("\\", "/")
    return sorted({plain, plain.strip()})


def _check_count(where: str, told: dict[str, str], most: int) -> None:
    numbers = [float(n) for text in told.values() for n in re.findall(r"\d+(?:\.\d*)?(?:[eE]\+?\d+)?", text)]
    if math.prod(numbers) > most:
        found = " ".join(f'{key}="{text[:40]}"' for key, text in told.items())
        raise SourceError(where, found, f"at most {most} together")


def _elements(model: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Tag and attributes of each element of a file."""
    found: list[tuple[str, dict[str, str]]] = []

    def refuse(*_: object) -> None:
        raise SourceError(str(model), "a document type declaration", "plain MJCF", "Remove the DOCTYPE.")

    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: found.append((tag, attributes))
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(model.read_bytes(), True)
    except expat.ExpatError as error:
        raise SourceError(str(model), f"no XML ({error})", "a whole MJCF model") from error
    except OSError as error:
        raise SourceError(str(model), error.strerror or str(error), "a model that can be read") from error
    if found[0][0] not in ("mujoco", "mujocoinclude"):
        raise SourceError(str(model), f"the element {found[0][0][:40]!r}", "mujoco")
    yield from found
