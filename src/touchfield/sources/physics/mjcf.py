"""Rigid-body models in MuJoCo's own format (MJCF ``.xml``), simulated: each body a scene with its pose track.

Format: an XML file whose root element is ``mujoco``; it may include other files and name mesh files, which
lie in its folder or below it unless the user allows others. MuJoCo looks for a file beside the model and
beside the file that names it, in the folders that a ``compiler`` names and without them, with its folders or,
with ``strippath``, without. Every place at which there is something is looked at here; attributes are read by
name, so that an element of a later version is met, too. The library `mujoco` reads and steps it (extra
"physics"). It lasts as long as is asked for (``--seconds``), else 2 s, and begins from the keyframe of the
name "touchfield", else from the model's own initial state. Lengths are metres.

What is touched is what collides, as in MuJoCo itself: a geom with contype or conaffinity, or of an explicit
contact pair. Geoms that only look (both zero) are left out. A mesh is touched as it is, although MuJoCo
collides its convex hull. The geoms of a body that have a formula are one body, their union. Each mesh or
height field of a body that has other geoms too is a body of its own, "body/geom", with the same track: where
they overlap, forces are added.
"""

from __future__ import annotations

import math
import os
import re
from collections import defaultdict
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import numpy as np

from touchfield.arrays import Float64s, Int32s
from touchfield.errors import SourceError, blamed_on
from touchfield.files import plain_size, readable, require_beside, require_plain
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.surface import joined
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.simulation import (
    FRAME_RATE_HZ,
    SECONDS,
    compiled,
    frames_of,
    load_mujoco,
    simulated,
)
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Z_AXES, Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import SHAPES, Shape, moved

_HEAD_BYTES: Final = 1 << 16

_MAX_BYTES: Final = 1 << 26
_MAX_FILES: Final = 256
_MAX_PLACES: Final = 1 << 16
_NUMBER: Final = r"\d+(?:\.\d*)?(?:[eE]\+?\d+)?"
_FOLDERS: Final = ("assetdir", "meshdir", "texturedir")
_MODELS: Final = ("include", "model")
_MOST: Final = {
    ("count",): 1 << 16,
    ("nkey",): 1 << 16,
    ("nrow", "ncol"): 1 << 24,
    ("width", "height"): 1 << 24,
}
"""Attributes of an element whose product is how much of something is made without bytes for it in the file.

"""


def _open(path: Path, options: SourceOptions) -> BodyScene:
    mujoco = load_mujoco()
    check_files(path, anywhere=options.allow_outside)
    read = partial(mujoco.MjModel.from_xml_path, str(path))
    model, notes = compiled(read, str(path), "a model that MuJoCo cannot read", "a whole MJCF model")
    pieces, more = _pieces_of(mujoco, model, str(path), options.shell)
    seconds, rate = options.seconds or SECONDS, options.rate_hz or FRAME_RATE_HZ
    ids = sorted({body_id for _, body_id, _ in pieces})
    frames = frames_of(str(path), seconds, rate, len(ids))
    tracks, warnings = simulated(model, ids, frames, rate, str(path))
    track_of = dict(zip(ids, tracks, strict=True))
    bodies = [Body(name, scene, track_of[body_id]) for name, body_id, scene in pieces]
    return BodyScene(bodies, rate, notes=(*notes, *more, *warnings))


def _recognise(path: Path) -> bool:
    """True if the root element is ``mujoco``: the first tag that is no declaration and no comment."""
    if path.suffix.lower() != ".xml" or not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    while head.startswith((b"<?", b"<!")):
        end = b"-->" if head.startswith(b"<!--") else b">"
        head = head.partition(end)[2].lstrip()
    return head.startswith(b"<mujoco") and head[7:8] in b" \t\r\n/>"


# -- the files that a model names, before MuJoCo opens them --------------------------------------------------
@dataclass
class _Named:
    """Names in the files of a model: files with their place in the text, folders, and where they are looked
    for.
    """

    names: list[tuple[str, str]] = field(default_factory=list)
    folders: set[str] = field(default_factory=lambda: {""})
    beside: set[Path] = field(default_factory=set)


def check_files(path: Path, *, anywhere: bool = False) -> None:
    """Refuse a model that names what lies outside its folder, or is no plain file, or asks for counts beyond
    reason.

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
    if not os.path.exists(place) or os.path.isdir(place):  # of a name that is none they say no
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
            counts = {key: attributes[key] for key in keys if key in attributes}
            numbers = [float(n) for text in counts.values() for n in re.findall(_NUMBER, text)]
            if math.prod(numbers) > most:
                found = " ".join(f'{key}="{text[:40]}"' for key, text in counts.items())
                raise SourceError(where, found, f"at most {most} together")
    return models


def _spelt(name: str) -> list[str]:
    """A name as MuJoCo may take it: both slashes part folders, and blanks about it may count or not."""
    plain = name.replace("\\", "/")
    return sorted({plain, plain.strip()})


def _elements(model: Path) -> list[tuple[str, dict[str, str]]]:
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
    return elements


# -- what of the bodies can be touched -----------------------------------------------------------------------
def _pieces_of(
    mujoco: Any, model: Any, where: str, shell: str
) -> tuple[list[tuple[str, int, Scene]], tuple[str, ...]]:
    """Touchable bodies or parts of them (name, number of the body whose frame it is in, scene), in order;
    notes.
    """
    collides = (np.array(model.geom_contype) != 0) | (np.array(model.geom_conaffinity) != 0)
    collides[np.array(model.pair_geom1, int)] = True
    collides[np.array(model.pair_geom2, int)] = True
    only_look = int((~collides).sum())
    notes: tuple[str, ...] = ()
    if only_look:
        notes = (f"Left out, as they only look (contype and conaffinity 0): {only_look} geoms.",)
    # of each body: its shapes, and the names, vertices and triangles of its meshes
    parts: defaultdict[int, tuple[list[Shape], list[tuple[str, Float64s, Int32s]]]]
    parts = defaultdict(lambda: ([], []))
    left_out = int(model.nflex) + int(model.nskin)
    for geom in np.flatnonzero(collides).tolist():
        shapes, meshes = parts[int(model.geom_bodyid[geom])]
        name = _name(model.geom(geom), "geom")
        with blamed_on(f"{where}: {name}: "):
            shape = _shape(mujoco, model, geom)
        triangles = None if shape else _triangles(mujoco, model, geom)
        if shape:
            shapes.append(shape)
        elif triangles:
            meshes.append((name, *triangles))
        else:
            left_out += 1
    if left_out:
        notes += (f"Left out, as neither a rigid shape nor a mesh (SDF, flex, skin): {left_out}.",)
    pieces: list[tuple[str, int, Scene]] = []
    for body, (shapes, meshes) in sorted(parts.items()):
        name = _name(model.body(body), "body")
        if shapes:
            pieces.append((name, body, AnalyticScene(shapes, "union", UP_Z_AXES)))
        is_alone = not shapes and len(meshes) == 1
        for geom_name, vertices, faces in meshes:
            part = name if is_alone else f"{name}/{geom_name}"
            pieces.append((part, body, MeshScene(vertices, faces, shell=shell, name=part)))
    if not pieces:
        expected = (
            "a rigid geom that collides: sphere, capsule, ellipsoid, cylinder, box, plane, mesh or hfield"
        )
        raise SourceError(
            where, f"nothing that can be touched, and {only_look} geoms that only look", expected
        )
    return pieces, notes


def _name(element: Any, word: str) -> str:
    return str(element.name or f"{word} {element.id}")


def _shape(mujoco: Any, model: Any, geom: int) -> Shape | None:
    """The shape of a geom in its body's frame; None where it has no formula."""
    name = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    a, b, c = (float(s) for s in model.geom_size[geom])
    sizes: dict[str, tuple[Any, ...]] = {
        "sphere": (a,), "capsule": (a, b), "cylinder": (a, b), "plane": ((0.0, 0.0, 1.0),),
        "ellipsoid": ((a, b, c),), "box": ((a, b, c),),
    }  # fmt: skip
    if name not in sizes:
        return None
    shape = SHAPES[name]((0.0, 0.0, 0.0), *sizes[name])  # type: ignore[call-arg]
    return moved(shape, *_frame(mujoco, model, geom))


def _frame(mujoco: Any, model: Any, geom: int) -> tuple[Float64s, Float64s]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.array(model.geom_quat[geom], np.float64))
    return matrix.reshape(3, 3), np.array(model.geom_pos[geom], np.float64)


def _triangles(mujoco: Any, model: Any, geom: int) -> tuple[Float64s, Int32s] | None:
    """The triangles of a mesh or height field in its body's frame; None where a geom is neither."""
    kinds, kind = mujoco.mjtGeom, int(model.geom_type[geom])
    which = int(model.geom_dataid[geom])
    if kind == kinds.mjGEOM_MESH:
        first, begin = int(model.mesh_vertadr[which]), int(model.mesh_faceadr[which])
        corners = np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[which])], np.float64)
        faces = np.array(model.mesh_face[begin : begin + int(model.mesh_facenum[which])], np.int32)
        vertices, triangles = joined(corners, faces)
    elif kind == kinds.mjGEOM_HFIELD:
        vertices, triangles = _height_field(model, which)
    else:
        return None
    rotation, shift = _frame(mujoco, model, geom)
    return vertices @ rotation.T + shift, triangles


def _height_field(model: Any, which: int) -> tuple[Float64s, Int32s]:
    """A height field as a closed mesh: its surface, four walls and a bottom.

    Each cell is cut from its corner of least x and y to that of most, as MuJoCo's collision does.
    """
    rows, columns = int(model.hfield_nrow[which]), int(model.hfield_ncol[which])
    half_x, half_y, top, base = (float(s) for s in model.hfield_size[which])
    first = int(model.hfield_adr[which])
    height = top * np.array(model.hfield_data[first : first + rows * columns], np.float64)
    y, x = np.meshgrid(
        np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij"
    )
    surface = np.stack([x.reshape(-1), y.reshape(-1), height], axis=-1)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (
        part.reshape(-1) for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    )
    # round the edge, anticlockwise seen from above
    edge = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    below = rows * columns + np.arange(len(edge))
    middle = np.full(len(edge), rows * columns + len(edge))
    ahead, below_ahead = np.roll(edge, -1), np.roll(below, -1)
    foot = surface[edge] * (1.0, 1.0, 0.0) - (0.0, 0.0, base)
    triangles = [(a, b, c), (a, c, d), (edge, below, below_ahead), (edge, below_ahead, ahead)]
    triangles.append((middle, below_ahead, below))
    faces = np.concatenate([np.stack(three, axis=-1) for three in triangles])
    return np.concatenate([surface, foot, [[0.0, 0.0, -base]]]), faces.astype(np.int32)


KIND = SourceKind("mjcf", "a MuJoCo model (.xml), simulated; needs the extra physics", _recognise, _open)
