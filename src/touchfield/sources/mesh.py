"""Mesh files: OBJ, STL, PLY and OFF, read with trimesh; GLB and glTF, as `touchfield.sources.gltf_model` reads them.

All geometries are joined, and vertices at one place become one, so that triangles without shared indices close.
Animation (skins, morph targets, node tracks) is not evaluated: a glTF that has it is read in its rest pose
(`touchfield.sources.animated_mesh` evaluates it). Units are metres unless ``unit_m`` says, as glTF has it.
"""

from __future__ import annotations

import re
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s, Int32s
from touchfield.errors import SourceError
from touchfield.sources.gltf_model import Model
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.mesh_surface import welded
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import size_note

_GLTF: Final = (".glb", ".gltf")
_SUFFIXES: Final = (".obj", ".stl", ".ply", ".off", *_GLTF)
_RELATIVE: Final = re.compile(rb"^[ \t]*f[ \t].*-", re.MULTILINE)


def read_triangles(path: Path) -> tuple[Float64s, Int32s, tuple[str, ...]]:
    """Vertices float64 [n, 3] in the file's units, triangles int32 [m, 3], and notes.

    Raises `SourceError` if the file cannot be read, or holds no triangle.
    """
    if not path.is_file():
        raise SourceError(str(path), "a folder", "one mesh file", "Name the file in it.")
    if path.suffix.lower() in _GLTF:
        with np.errstate(all="ignore"):
            model = Model(path)
            vertices = model.at_rest()
        notes = ("The file is animated (skin, morph targets or tracks); it is read in its rest pose.",)
        return *welded(vertices, model.triangles), (*model.notes, *notes[: model.is_animated])
    trimesh: Any = import_module("trimesh")
    try:
        with np.errstate(all="ignore"), path.open("rb") as stream:  # an empty resolver: no other file is read
            kind, plain = path.suffix[1:].lower(), {"obj": _absolute, "stl": _whole}
            file = BytesIO(plain[kind](stream.read())) if kind in plain else stream
            loaded = trimesh.load_scene(file, kind, resolver={}, process=False, skip_materials=True)
            meshes = [one for one in loaded.geometry.values() if isinstance(one, trimesh.Trimesh) and len(one.faces)]
            arrays = [one.vertices for one in meshes], [one.faces for one in meshes]
            corners, faces = trimesh.util.append_faces(*arrays) if meshes else arrays
    except Exception as error:  # trimesh raises what its loaders and numpy happen to raise on damaged files
        found = f"a mesh that cannot be read ({type(error).__name__}: {str(error)[:120]})"
        raise SourceError(str(path), found, "a whole mesh file", "Export it again, as triangles.") from error
    if not meshes:
        raise SourceError(str(path), "no triangle", "a mesh of triangles", "Export it with its faces.")
    return *welded(np.asarray(corners, np.float64), np.asarray(faces, np.int64)), ()


def _whole(data: bytes) -> bytes:
    """A binary STL without what stands behind its triangles; ValueError where some of them are not there."""
    count = data[80:84]
    if b"\0" not in count:  # in a text there is no such byte
        return data
    size = 84 + 50 * int.from_bytes(count, "little")
    if len(data) < size:
        raise ValueError(f"{len(data)} bytes where its triangles take {size}")
    return data[:size]


def _absolute(data: bytes) -> bytes:
    """An OBJ whose faces name vertices by their number, also where -1 was the vertex before."""
    if _RELATIVE.search(data) is None:
        return data
    count, lines = 0, []
    for line in data.replace(b"\r\n", b"\n").replace(b"\\\n", b" ").split(b"\n"):
        words = line.split()
        count += words[:1] == [b"v"]
        if words[:1] == [b"f"]:
            numbers = [int(word.partition(b"/")[0]) for word in words[1:]]
            numbers = [n + (count + 1) * (n < 0) for n in numbers]
            if min(numbers, default=1) < 1:
                raise ValueError(f"a face of vertices that are not there: {line[:40]!r}")
            line = b"f " + b" ".join(b"%d" % n for n in numbers)
        lines.append(line)
    return b"\n".join(lines)


def _open(path: Path, options: SourceOptions) -> MeshScene:
    vertices, triangles, notes = read_triangles(path)
    unit_m = 1.0 if options.unit_m is None else options.unit_m
    with np.errstate(over="ignore", invalid="ignore"):
        beside = {"shell": options.shell, "holes": options.holes, "name": str(path)}
        scene = MeshScene(vertices * unit_m, triangles, **beside, notes=notes)
    scene.notes = (size_note(np.ptp(scene.bounds_m(), axis=0), options.unit_m), *scene.notes)
    return scene


KIND = SourceKind(
    "mesh",
    "a mesh of triangles: OBJ, STL, PLY, GLB, glTF or OFF",
    lambda path: path.suffix.lower() in _SUFFIXES and path.is_file(),
    _open,
)
