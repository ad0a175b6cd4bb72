"""Rigid-body models in MuJoCo's own format (MJCF ``.xml``), simulated: each body a scene with its pose track.

Format: an XML file whose root element is ``mujoco``; it may include other files and name mesh files, which lie in
its folder or below it unless the user allows others. MuJoCo looks for a file beside the model and beside the file
that names it, in the folders that a ``compiler`` names and without them, with its folders or, with ``strippath``,
without. Every place at which there is something is looked at here; attributes are read by name, so that an element
of a later version is met, too. The library `mujoco` reads and steps it (extra "physics"). The duration is what is
asked for, else ``<custom><numeric name="touchfield_seconds" data="..."/></custom>``, else 2 s. The simulation begins
from the keyframe of the name "touchfield", else from the model's own initial state. Lengths are metres.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

from touchfield.errors import SourceError
from touchfield.files import plain_size, readable, require_beside, require_plain
from touchfield.sources.body_scene import BodyScene
from touchfield.sources.mujoco_bodies import pieces_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import Body
from touchfield.sources.simulation import FRAME_RATE_HZ, compiled, frames_of, load_mujoco, simulated

_SECONDS: Final = 2.0
_SECONDS_NAME: Final = "touchfield_seconds"
_HEAD_BYTES: Final = 1 << 16

_MAX_BYTES: Final = 1 << 26
_MAX_FILES: Final = 256
_MAX_PLACES: Final = 1 << 16
_FOLDERS: Final = ("assetdir", "meshdir", "texturedir")
_MODELS: Final = ("include", "model")
_MOST: Final = {("count",): 1 << 16, ("nkey",): 1 << 16, ("nrow", "ncol"): 1 << 24, ("width", "height"): 1 << 24}
"""Attributes of an element whose product is how much of something is made without bytes for it in the file."""


def _open(path: Path, options: SourceOptions) -> BodyScene:
    mujoco = load_mujoco()
    check_files(path, anywhere=options.allow_outside)
    read = partial(mujoco.MjModel.from_xml_path, str(path))
    model, notes = compiled(read, str(path), "a model that MuJoCo cannot read", "a whole MJCF model")
    pieces, more = pieces_of(mujoco, model, str(path), options.shell)
    seconds, rate = _seconds(mujoco, model, path, options), options.rate_hz or FRAME_RATE_HZ
    bodies = sorted({piece.body_id for piece in pieces})
    frames = frames_of(str(path), seconds, rate, len(bodies))
    tracks, told = simulated(model, bodies, frames, rate, str(path))
    track_of = dict(zip(bodies, tracks, strict=True))
    posed = [Body(piece.name, piece.scene, track_of[piece.body_id]) for piece in pieces]
    return BodyScene(posed, rate, notes=(*notes, *more, *told))


def _seconds(mujoco: Any, model: Any, path: Path, options: SourceOptions) -> float:
    if options.seconds is not None:
        return options.seconds
    numeric = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, _SECONDS_NAME)
    if numeric < 0:
        return _SECONDS
    seconds = float(model.numeric_data[model.numeric_adr[numeric]])
    if not (seconds > 0 and math.isfinite(seconds)):
        raise SourceError(f"{path}: {_SECONDS_NAME}", f"{seconds:g}", "a positive number of seconds")
    return seconds


def _recognise(path: Path) -> bool:
    """True if the root element is ``mujoco``: the first tag that is no declaration and no comment."""
    if path.suffix.lower() != ".xml" or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    except OSError:
        return False
    while head.startswith((b"<?", b"<!")):
        end = b"-->" if head.startswith(b"<!--") else b">"
        head = head.partition(end)[2].lstrip()
    return head.startswith(b"<mujoco") and head[7:8] in b" \t\r\n/>"


# -- the files that a model names, before MuJoCo opens them --------------------------------------------------
@dataclass
class _Named:
    """Names in the files of a model: files with their place in the text, folders, and where they are looked for."""

    names: list[tuple[str, str]] = field(default_factory=list)
    folders: set[str] = field(default_factory=lambda: {""})
    beside: set[Path] = field(default_factory=set)


def check_files(path: Path, *, anywhere: bool = False) -> None:
    """Refuse a model that names what lies outside its folder, or is no plain file, or asks for counts beyond reason.

    `anywhere`: the user allows files outside the folder. `SourceError` names file, element and attribute.
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
                place = _there(path.parent, folder / name, name, where, anywhere)
                waiting += [place] if place else []
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
    elements: list[tuple[str, dict[str, str]]] = []

    def refuse(*_: object) -> None:
        raise SourceError(str(model), "a document type declaration", "plain MJCF", "Remove the DOCTYPE.")

    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: elements.append((tag, attributes))
    parser.StartDoctypeDeclHandler = refuse
    try:
        with readable(model, "a model that can be read"):
            parser.Parse(model.read_bytes(), True)
    except expat.ExpatError as error:
        raise SourceError(str(model), f"no XML ({error})", "a whole MJCF model") from error
    if elements[0][0] not in ("mujoco", "mujocoinclude"):
        raise SourceError(str(model), f"the element {elements[0][0][:40]!r}", "mujoco")
    yield from elements


KIND = SourceKind("mjcf", "a MuJoCo model (.xml), simulated; needs the extra physics", _recognise, _open)
