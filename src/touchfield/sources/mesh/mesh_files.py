"""Reads the vertices and triangles of a mesh file: OBJ, STL, PLY, OFF, glTF, COLLADA and 3MF.

GLB and glTF are read through `touchfield.sources.gltf.model`, COLLADA (``.dae``) through
`touchfield.sources.mesh.collada`, 3MF through `touchfield.sources.mesh.threemf`.

Polygons with any number of corners are triangulated, concave ones along their outline. All geometries are
joined, and vertices at the same position are merged, so that triangles without shared indices connect.
Animation (skins, morph targets, node tracks) is not evaluated: an animated glTF is read in its rest pose
(`touchfield.sources.animation.animated_mesh` evaluates it). Units are those that the file states (COLLADA,
3MF), else metres, unless ``unit_m`` is given.
"""

from __future__ import annotations

import re
from codecs import BOM_UTF8, BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.errors import SourceError
from touchfield.files import readable
from touchfield.sources.gltf.model import Model
from touchfield.sources.mesh.collada import read_collada
from touchfield.sources.mesh.mesh_data import MeshData, fans
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.mesh.ply import Properties, parse_header
from touchfield.sources.mesh.surface import weld
from touchfield.sources.mesh.threemf import read_3mf
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import size_note
from touchfield.sources.unread_files import without_triangles

_GLTF: Final = (".glb", ".gltf")
_SOLID: Final = re.compile(rb"^\s*(end)?solid", re.MULTILINE)
_CORNER: Final = re.compile(rb"^\s*vertex\s+(\S+\s+\S+\s+\S+)", re.MULTILINE)
_STL: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])
# vertices [n, 3]; number of corners of each polygon; corners of all polygons
_Polygons = tuple[Float64s, Int64s, Int64s]


def read_triangles(path: Path) -> tuple[Float64s, Int32s, tuple[str, ...]]:
    """Read vertices float64 [n, 3] in metres, triangles int32 [m, 3], and notes.

    A unit that the file does not state is taken as a metre. Raises as `read_mesh`.
    """
    mesh = read_mesh(path)
    vertices = mesh.vertices if mesh.unit_m is None else mesh.vertices * mesh.unit_m
    return vertices, mesh.triangles, mesh.notes


def read_mesh(path: Path) -> MeshData:
    """Read a mesh file in its own units and axes.

    Raises `SourceError` if the file cannot be read, or has no triangle; `MissingExtra` if its format needs a
    library that is not installed.
    """
    if not path.is_file():
        raise SourceError(str(path), "a folder", "one mesh file", "Name the file in it.")
    ending = path.suffix.lower()
    if ending in _ASSEMBLED:
        return _ASSEMBLED[ending](path)
    if ending in _GLTF:
        with np.errstate(all="ignore"):
            model = Model(path)
            vertices = model.at_rest()
        notes = ("The file is animated (skin, morph targets or tracks); it is read in its rest pose.",)
        return MeshData(*weld(vertices, model.triangles), (*model.notes, *notes[: model.is_animated]))
    try:
        with np.errstate(all="ignore"), readable(path, "a whole mesh file"):
            vertices, counts, flat = _READERS[ending](path.read_bytes())
        if len(flat) and not 0 <= flat.min() <= flat.max() < len(vertices):
            raise ValueError(f"a face of vertices that are not there; there are {len(vertices)}")
        if len(counts) and not 0 <= counts.min() <= counts.max() <= len(flat):
            raise ValueError(f"a face of {counts.max()} corners; there are {len(flat)}")
    except (ArithmeticError, LookupError, ValueError) as error:
        found = f"a mesh that cannot be read ({type(error).__name__}: {str(error)[:120]})"
        raise SourceError(str(path), found, "a whole mesh file", "Export it again.") from error
    corners, sizes = fans(counts)
    if not len(corners):
        raise without_triangles(path, len(vertices))
    with np.errstate(all="ignore"):
        return MeshData(*weld(vertices, flat[corners], sizes))


def _numbers(texts: Iterable[bytes], kind: type) -> NDArray[Any]:
    return np.fromstring(b" ".join(texts).decode("ascii"), kind, sep=" ")


def _normalise_text(data: bytes) -> bytes:
    """Remove the byte order mark of a text and normalise its line ends."""
    if data.startswith((BOM_UTF16_LE, BOM_UTF16_BE)):
        data = data.decode("utf-16").encode()
    return data.removeprefix(BOM_UTF8).replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def _parse_obj(data: bytes) -> _Polygons:
    """Parse an OBJ: lines of vertices and faces.

    In a face, the index -1 is the last vertex defined before it.
    """
    text = re.sub(rb"#.*|/\S*", b"", _normalise_text(data).replace(b"\\\n", b" "))
    lines = re.findall(rb"^[ \t]*(?:v[ \t]+(\S*[ \t]*\S*[ \t]*\S*)|f[ \t]+(.*))", text, re.MULTILINE)
    is_face = np.array([bool(face) for _, face in lines], bool)
    points = [point for point, face in lines if not face]
    vertices = _numbers(points, np.float64).reshape(len(points), 3)
    counts = np.array([len(face.split()) for _, face in lines if face], np.int64)
    flat = _numbers((face for _, face in lines), np.int64)
    before = np.repeat(np.cumsum(~is_face)[is_face], counts)  # vertices before each corner
    return vertices, counts, flat + np.where(flat < 0, before, -1)


def _parse_off(data: bytes) -> _Polygons:
    """Parse a text OFF: lines of a vertex, then lines of a corner count, corners, and an optional colour."""
    _, mark, text = re.sub(rb"#.*", b"", _normalise_text(data)).partition(b"OFF")
    rows = [tokens for tokens in map(bytes.split, text.splitlines()) if tokens]
    if not mark or not rows:
        raise ValueError("no OFF with numbers behind it")
    n, face_count = map(int, rows[0][:2])
    points, faces = rows[1 : n + 1], rows[n + 1 : n + face_count + 1]
    counts = np.array([int(face[0]) for face in faces], np.int64)
    flat = _numbers((b" ".join(face[1 : count + 1]) for face, count in zip(faces, counts.tolist())), np.int64)
    if len(faces) < face_count or len(flat) < counts.sum():
        raise ValueError(
            f"{len(faces)} faces with {len(flat)} corners where the header declares {face_count}"
        )
    return _numbers((b" ".join(point[:3]) for point in points), np.float64).reshape(n, 3), counts, flat


def _parse_ply(data: bytes) -> _Polygons:
    """Parse the vertices, faces and triangle strips of a PLY.

    A text file is first converted to bytes of float64.
    """
    header = parse_header(data)
    body = data[header.size :]
    if header.is_text:
        body = np.fromstring(body.decode("ascii"), sep=" ").astype("<f8").tobytes()
    at, vertices, corners, counts, corner = 0, np.zeros((0, 3)), list[bytes](), list[int](), np.dtype("i4")
    strips = list[NDArray[Any]]()
    for name, count, properties in header.elements:
        rows = _equal_rows(body, at, count, properties)
        if rows is not None:
            at += rows.nbytes
            if name == "vertex":
                vertices = np.stack([rows[axis] for axis in "xyz"], axis=1).astype(np.float64)
            label, (*count_types, kind) = properties[0]
            if count_types and name == "face" and label.startswith("vert"):
                corners, counts, corner = [rows[label].tobytes()], [rows[label].shape[1]] * count, kind
            elif count_types and name == "tristrips" and label.startswith("vert"):
                strips += [row.astype(np.int64) for row in rows[label]]
            continue
        for row in range(count):
            for label, (*count_types, kind) in properties:
                n = 1
                if count_types:
                    n = int(np.frombuffer(body, count_types[0], 1, at)[0]) if at < len(body) else -1
                    at += count_types[0].itemsize
                    if name == "face" and label.startswith("vert"):
                        corners.append(body[at : at + n * kind.itemsize])
                        counts.append(n)
                        corner = kind
                    elif name == "tristrips" and label.startswith("vert"):
                        strips.append(np.frombuffer(body[at : at + n * kind.itemsize], kind).astype(np.int64))
                at += n * kind.itemsize
                if n < 0 or at > len(body):
                    raise ValueError(f"it ends {count - row} rows before the declared end")
    flat = np.frombuffer(b"".join(corners), corner).astype(np.int64)
    if strips:
        triangles = [_triangles_of_strips(strip) for strip in strips]
        counts += [3] * sum(map(len, triangles))
        flat = np.concatenate([flat, *(part.reshape(-1) for part in triangles)])
    return vertices, np.array(counts, np.int64), flat


def _triangles_of_strips(indices: NDArray[Any]) -> Int64s:
    """Return the triangles of strips of vertices that -1 separates, int64 [m, 3].

    Every second triangle of a strip is turned, and those with a vertex twice only lead on.
    """
    i = np.arange(max(len(indices) - 2, 0))
    three = np.stack([indices[i], indices[i + 1], indices[i + 2]], axis=1)
    ends = np.maximum.accumulate(np.where(indices == -1, np.arange(len(indices)), -1))[i]
    is_turned = (i - ends) % 2 == 0  # the first triangle of a strip begins one behind its end
    three[is_turned] = three[is_turned][:, [0, 2, 1]]
    is_real = (three != -1).all(axis=1) & (three != np.roll(three, 1, axis=1)).all(axis=1)
    return np.asarray(three[is_real], np.int64)


def _equal_rows(body: bytes, at: int, count: int, properties: Properties) -> NDArray[Any] | None:
    """Return the rows of an element if all have one length, as in a mesh of triangles.

    Returns None otherwise.
    """
    (name, (*count_types, kind)), *others = properties
    if any(len(types) > 1 for _, types in others) or (
        count_types and at + count_types[0].itemsize > len(body)
    ):
        return None
    n = int(np.frombuffer(body, count_types[0], 1, at)[0]) if count_types else 0
    first = [("#", count_types[0]), (name, kind, (n,))] if count_types else [(name, kind)]
    row = np.dtype([*first, *((label, types[0]) for label, types in others)])
    if count_types and (n < 0 or at + count * row.itemsize > len(body)):
        return None
    rows = np.frombuffer(body, row, count, at)
    return rows if not count_types or (rows["#"] == n).all() else None


def _parse_stl(data: bytes) -> _Polygons:
    """Parse an STL, ignoring bytes after the triangles of a binary one.

    Raises ValueError if triangles are missing.
    """
    count = data[80:84]
    if b"\0" in count:  # a text has no zero byte
        size = 84 + 50 * int.from_bytes(count, "little")
        if len(data) < size:
            raise ValueError(f"{len(data)} bytes where its triangles take {size}")
        vertices = np.frombuffer(data[84:size], _STL)["corners"].reshape(-1, 3).astype(np.float64)
    else:
        text = data.lower()
        keywords = _SOLID.findall(text)
        solid_count, end_count = keywords.count(b""), keywords.count(b"end")
        if end_count < solid_count:
            raise ValueError(f"{solid_count} solids, of which {end_count} end with endsolid")
        corners, facets = _CORNER.findall(text), text.count(b"outer loop")
        if len(corners) != 3 * facets:
            raise ValueError(f"{len(corners)} corners of {facets} facets")
        vertices = _numbers(corners, np.float64).reshape(len(corners), 3)
    return vertices, np.full(len(vertices) // 3, 3), np.arange(len(vertices))


_READERS: Final[dict[str, Callable[[bytes], _Polygons]]] = {
    ".obj": _parse_obj,
    ".stl": _parse_stl,
    ".ply": _parse_ply,
    ".off": _parse_off,
}
_ASSEMBLED: Final[dict[str, Callable[[Path], MeshData]]] = {".dae": read_collada, ".3mf": read_3mf}
SUFFIXES: Final = (*_READERS, *_GLTF, *_ASSEMBLED)
"""The endings of mesh files that are read."""


def _open(path: Path, options: SourceOptions) -> MeshScene:
    mesh = read_mesh(path)
    unit_m = options.unit_m or mesh.unit_m or 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        mesh_options = {"shell": options.shell, "holes": options.holes, "name": str(path)}
        scene = MeshScene(mesh.vertices * unit_m, mesh.triangles, **mesh_options, notes=mesh.notes)
    scene.axes = mesh.axes
    size = size_note(np.ptp(scene.bounds_m(), axis=0), options.unit_m, stated_m=mesh.unit_m)
    scene.notes = (size, *scene.notes)
    return scene


KIND = SourceKind(
    "mesh",
    "a mesh of triangles: OBJ, STL, PLY, GLB, glTF or OFF; COLLADA (.dae) or 3MF with the extra meshes",
    lambda path: path.suffix.lower() in SUFFIXES and path.is_file(),
    _open,
)
