"""Opens models of rigid bodies in MuJoCo's format (MJCF, ``.xml``) and simulates them.

Each body is a scene with a pose track.

Format: an XML file with the root element ``mujoco``; it may include other files and name mesh files, which
must lie in its folder or below it unless the user allows others. MuJoCo searches a file beside the model and
beside the file that names it, with and without the folders of a ``compiler`` element, and with or without its
own folders (``strippath``). All of these paths that exist are checked here; attributes are read by name, so
that elements of later versions are covered, too. The library `mujoco` reads and steps the model (extra
"physics"). The simulation lasts ``--seconds``, else 2 s, and starts from the keyframe named "touchfield",
else from the first keyframe, with a note, else from the model's initial state. Lengths are metres.

Touchable geoms are those that collide in MuJoCo: with contype or conaffinity, or in an explicit contact pair.
Visual geoms (both zero) are skipped. A mesh is rendered as it is, although MuJoCo collides its convex hull.
The analytic geoms of a body form one body, their union. Each mesh or height field of a body with other geoms
is a body of its own, "body/geom", with the same track; where they overlap, forces are added.
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
from touchfield.errors import SourceError, as_source_error
from touchfield.files import plain_size, readable, require_in_folder, require_plain
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.surface import merge_vertices
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene, notes_of_meshes
from touchfield.sources.physics.live_simulation import LiveSimulation
from touchfield.sources.physics.simulation import (
    FRAME_RATE_HZ,
    SECONDS,
    compile_model,
    frames_of,
    load_mujoco,
    simulate,
)
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import UP_Z_AXES, Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import SHAPES, Shape, move_shape

_HEAD_BYTES: Final = 1 << 16

_MAX_BYTES: Final = 1 << 26
_MAX_FILES: Final = 256
_MAX_PATHS: Final = 1 << 16
_NUMBER: Final = r"\d+(?:\.\d*)?(?:[eE]\+?\d+)?"
_FOLDERS: Final = ("assetdir", "meshdir", "texturedir")
_MODELS: Final = ("include", "model")
_MAX_PRODUCTS: Final = {
    ("count",): 1 << 16,
    ("nkey",): 1 << 16,
    ("nrow", "ncol"): 1 << 24,
    ("width", "height"): 1 << 24,
}
"""Attributes of an element whose product is a size without data in the file, and its limit."""


def _open(path: Path, options: SourceOptions) -> BodyScene:
    mujoco = load_mujoco()
    check_files(path, anywhere=options.allow_outside)
    read = partial(mujoco.MjModel.from_xml_path, str(path))
    model, notes = compile_model(read, str(path), "a model that MuJoCo cannot read", "a whole MJCF model")
    return scene_of_model(mujoco, model, path, options, notes)


def scene_of_model(
    mujoco: Any, model: Any, path: Path, options: SourceOptions, notes: tuple[str, ...]
) -> BodyScene:
    """Simulate a model and return its touchable bodies as a scene, with `notes` and those of its meshes.

    Raises `SourceError` and `InvalidArgument` as `simulate` and `frames_of`, or if nothing can be touched.
    """
    pieces, more = _pieces_of(mujoco, model, str(path), options.shell)
    seconds, rate = options.seconds or SECONDS, options.rate_hz or FRAME_RATE_HZ
    ids = sorted({body_id for _, body_id, _ in pieces})
    frames = frames_of(str(path), seconds, rate, len(ids))
    tracks, warnings = simulate(model, ids, frames, rate, str(path))
    track_of = dict(zip(ids, tracks, strict=True))
    bodies = [Body(name, scene, track_of[body_id]) for name, body_id, scene in pieces]
    return BodyScene(
        bodies,
        rate,
        notes=(*notes, *more, *notes_of_meshes(bodies), *warnings),
        simulation=partial(LiveSimulation, model, [body_id for _, body_id, _ in pieces], rate, str(path)),
        can_move=[bool(model.body_weldid[body_id]) for _, body_id, _ in pieces],
    )


def has_root(path: Path, name: str) -> bool:
    """Return True if the root element of a file, after declarations and comments, is `name`."""
    with path.open("rb") as stream:
        head = stream.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").lstrip()
    while head.startswith((b"<?", b"<!")):
        end = b"-->" if head.startswith(b"<!--") else b">"
        head = head.partition(end)[2].lstrip()
    start = f"<{name}".encode()
    return head.startswith(start) and head[len(start) : len(start) + 1] in b" \t\r\n/>"


def _recognise(path: Path) -> bool:
    return path.suffix.lower() == ".xml" and path.is_file() and has_root(path, "mujoco")


# -- the files that a model names, before MuJoCo opens them ------------------------------------------------
@dataclass
class _NamedFiles:
    """Names in the files of a model: files with their location in the text, folders, and base folders."""

    names: list[tuple[str, str]] = field(default_factory=list)
    folders: set[str] = field(default_factory=lambda: {""})
    base_folders: set[Path] = field(default_factory=set)


def check_files(path: Path, *, anywhere: bool = False) -> None:
    """Refuse a model with files outside its folder, special files, or excessive counts.

    `anywhere`: the user allows files outside the folder. Raises `SourceError`, which names file, element and
    attribute.
    """
    named, pending, visited = _NamedFiles(), [path], set()
    while pending:
        model = pending.pop()
        resolved = model.resolve()
        if resolved in visited:
            continue
        visited.add(resolved)
        if len(visited) > _MAX_FILES:
            raise SourceError(str(path), f"more than {_MAX_FILES} files that include others", "fewer")
        named.base_folders |= {path.parent, model.parent}
        for where, name in _read(model, named):
            for folder in (path.parent, model.parent):
                included = _checked_path(path.parent, folder / name, name, where, anywhere)
                pending += [included] if included else []
    if len(named.names) * len(named.folders) * len(named.base_folders) > _MAX_PATHS:
        raise SourceError(str(path), f"{len(named.names)} files in {len(named.folders)} folders", "fewer")
    for (where, name), folder, inner in product(named.names, named.base_folders, named.folders):
        for last in {name, os.path.basename(name)}:
            _checked_path(path.parent, folder / inner / last, name, where, anywhere)


def _checked_path(folder: Path, path: Path, name: str, where: str, anywhere: bool) -> Path | None:
    """Return a path if it exists, checked to be a plain file within the folder.

    Returns None otherwise.
    """
    if not os.path.exists(path) or os.path.isdir(path):  # both return False for an invalid name
        return None
    require_in_folder(folder, path, f"{where} {name[:80]!r}", anywhere=anywhere)
    require_plain(path, f"a file, as {where} names it")
    return path


def _read(model: Path, named: _NamedFiles) -> list[tuple[str, str]]:
    """Return the models that a file includes, with their location.

    All other names are added to `named`.
    """
    size = plain_size(model, "a MuJoCo model")
    if size > _MAX_BYTES:
        raise SourceError(str(model), f"{size} bytes", f"a model of up to {_MAX_BYTES} bytes")
    models: list[tuple[str, str]] = []
    for tag, attributes in _elements(model):
        where = f"{model}: {tag}"
        for key in _FOLDERS:
            named.folders |= set(_spellings(attributes.get(key, "")))
        for key, value in attributes.items():
            if key.startswith("file"):
                more = [(f"{where} {key}", name) for name in _spellings(value)]
                (models if tag in _MODELS else named.names).extend(more)
        for keys, max_product in _MAX_PRODUCTS.items():
            counts = {key: attributes[key] for key in keys if key in attributes}
            numbers = [float(n) for text in counts.values() for n in re.findall(_NUMBER, text)]
            if math.prod(numbers) > max_product:
                found = " ".join(f'{key}="{text[:40]}"' for key, text in counts.items())
                raise SourceError(where, found, f"at most {max_product} together")
    return models


def _spellings(name: str) -> list[str]:
    """Return the spellings MuJoCo may use: both slashes separate folders, outer blanks may count or not."""
    plain = name.replace("\\", "/")
    return sorted({plain, plain.strip()})


def _elements(model: Path) -> list[tuple[str, dict[str, str]]]:
    """Return tag and attributes of each element of a file."""
    elements: list[tuple[str, dict[str, str]]] = []

    def refuse(*_: object) -> None:
        raise SourceError(str(model), "a document type declaration", "plain MJCF", "Remove the DOCTYPE.")

    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda tag, attributes: elements.append((tag, attributes))
    parser.StartDoctypeDeclHandler = refuse
    try:
        with readable(model, "a model that can be read"):
            parser.Parse(model.read_bytes(), True)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter of unknown encodings
        mend = "Check that place, or copy the file again."
        raise SourceError(str(model), f"no XML ({error})", "a whole MJCF model", mend) from error
    if elements[0][0] not in ("mujoco", "mujocoinclude"):
        raise SourceError(str(model), f"the element {elements[0][0][:40]!r}", "mujoco")
    return elements


# -- touchable parts of the bodies -------------------------------------------------------------------------
def _pieces_of(
    mujoco: Any, model: Any, where: str, shell: str
) -> tuple[list[tuple[str, int, Scene]], tuple[str, ...]]:
    """Return touchable bodies or parts (name, id of the body of its frame, scene), in order, and notes."""
    collides = (np.array(model.geom_contype) != 0) | (np.array(model.geom_conaffinity) != 0)
    collides[np.array(model.pair_geom1, int)] = True
    collides[np.array(model.pair_geom2, int)] = True
    visual_count = int((~collides).sum())
    notes: tuple[str, ...] = ()
    if visual_count:
        notes = (f"Left out, as they only look (contype and conaffinity 0): {visual_count} geoms.",)
    # shapes of each body, and names, vertices and triangles of its meshes
    parts: defaultdict[int, tuple[list[Shape], list[tuple[str, Float64s, Int32s]]]]
    parts = defaultdict(lambda: ([], []))
    skipped_count = int(model.nflex) + int(model.nskin)
    for geom in np.flatnonzero(collides).tolist():
        shapes, meshes = parts[int(model.geom_bodyid[geom])]
        name = _name(model.geom(geom), "geom")
        with as_source_error(f"{where}: {name}: "):
            shape = _shape(mujoco, model, geom)
        triangles = None if shape else _triangles(mujoco, model, geom)
        if shape:
            shapes.append(shape)
        elif triangles:
            meshes.append((name, *triangles))
        else:
            skipped_count += 1
    if skipped_count:
        notes += (f"Left out, as neither a rigid shape nor a mesh (SDF, flex, skin): {skipped_count}.",)
    pieces: list[tuple[str, int, Scene]] = []
    for body, (shapes, meshes) in sorted(parts.items()):
        name = _name(model.body(body), "body")
        if shapes:
            pieces.append((name, body, AnalyticScene(shapes, "union", UP_Z_AXES)))
        is_alone = not shapes and len(meshes) == 1
        for geom_name, vertices, faces in meshes:
            part = name if is_alone else f"{name}/{geom_name}"
            try:
                mesh = MeshScene(vertices, faces, shell=shell, name=part)
            except SourceError as error:
                raise SourceError(f"{where}: {part}", error.found, error.expected, error.hint) from error
            pieces.append((part, body, mesh))
    if not pieces:
        expected = (
            "a rigid geom that collides: sphere, capsule, ellipsoid, cylinder, box, plane, mesh or hfield"
        )
        raise SourceError(
            where, f"nothing that can be touched, and {visual_count} geoms that only look", expected
        )
    return pieces, notes


def _name(element: Any, word: str) -> str:
    return str(element.name or f"{word} {element.id}")


def _shape(mujoco: Any, model: Any, geom: int) -> Shape | None:
    """Return the shape of a geom in the frame of its body; None if it is not analytic."""
    name = mujoco.mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_").lower()
    a, b, c = (float(s) for s in model.geom_size[geom])
    sizes: dict[str, tuple[Any, ...]] = {
        "sphere": (a,), "capsule": (a, b), "cylinder": (a, b), "plane": ((0.0, 0.0, 1.0),),
        "ellipsoid": ((a, b, c),), "box": ((a, b, c),),
    }  # fmt: skip
    if name not in sizes:
        return None
    shape = SHAPES[name]((0.0, 0.0, 0.0), *sizes[name])  # type: ignore[call-arg]
    return move_shape(shape, *_frame(mujoco, model, geom))


def _frame(mujoco: Any, model: Any, geom: int) -> tuple[Float64s, Float64s]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, np.array(model.geom_quat[geom], np.float64))
    return matrix.reshape(3, 3), np.array(model.geom_pos[geom], np.float64)


def _triangles(mujoco: Any, model: Any, geom: int) -> tuple[Float64s, Int32s] | None:
    """Return the triangles of a mesh or height field in the frame of its body.

    Returns None for other geoms.
    """
    kinds, kind = mujoco.mjtGeom, int(model.geom_type[geom])
    index = int(model.geom_dataid[geom])
    with np.errstate(over="ignore", invalid="ignore"):  # the mesh refuses vertices that are not finite
        if kind == kinds.mjGEOM_MESH:
            first, first_face = int(model.mesh_vertadr[index]), int(model.mesh_faceadr[index])
            corners = np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[index])], np.float64)
            faces = np.array(
                model.mesh_face[first_face : first_face + int(model.mesh_facenum[index])], np.int32
            )
            vertices, triangles = merge_vertices(corners, faces)
        elif kind == kinds.mjGEOM_HFIELD:
            vertices, triangles = _height_field(model, index)
        else:
            return None
        rotation, shift = _frame(mujoco, model, geom)
        return vertices @ rotation.T + shift, triangles


def _height_field(model: Any, index: int) -> tuple[Float64s, Int32s]:
    """Convert a height field to a closed mesh: its surface, four walls and a bottom.

    Each cell is divided from its corner of smallest x and y to that of largest, as in MuJoCo's collision.
    """
    rows, columns = int(model.hfield_nrow[index]), int(model.hfield_ncol[index])
    half_x, half_y, top, base = (float(s) for s in model.hfield_size[index])
    first = int(model.hfield_adr[index])
    height = top * np.array(model.hfield_data[first : first + rows * columns], np.float64)
    y, x = np.meshgrid(
        np.linspace(-half_y, half_y, rows), np.linspace(-half_x, half_x, columns), indexing="ij"
    )
    surface = np.stack([x.reshape(-1), y.reshape(-1), height], axis=-1)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (
        part.reshape(-1) for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    )
    # along the edge, anticlockwise seen from above
    edge = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    below = rows * columns + np.arange(len(edge))
    middle = np.full(len(edge), rows * columns + len(edge))
    next_edge, next_below = np.roll(edge, -1), np.roll(below, -1)
    foot = surface[edge] * (1.0, 1.0, 0.0) - (0.0, 0.0, base)
    triangles = [(a, b, c), (a, c, d), (edge, below, next_below), (edge, next_below, next_edge)]
    triangles.append((middle, next_below, below))
    faces = np.concatenate([np.stack(three, axis=-1) for three in triangles])
    return np.concatenate([surface, foot, [[0.0, 0.0, -base]]]), faces.astype(np.int32)


KIND = SourceKind("mjcf", "a MuJoCo model (.xml), simulated; needs the extra physics", _recognise, _open)
