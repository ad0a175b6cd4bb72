"""Mesh files: OBJ, STL, PLY, GLB, glTF and OFF, read with trimesh.

Format: whatever trimesh reads; the scene graph is applied, all geometries are joined, and vertices at one place
become one, so that triangles without shared indices close. Animation (skins, morph targets, node tracks) is not
evaluated: a file that has it is read in its rest pose (`touchfield.sources.animated_mesh` evaluates it). Units are
metres unless ``unit_m`` says, as glTF has it.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.errors import SourceError
from touchfield.files import require_beside, require_plain
from touchfield.sources.gltf_document import members_of
from touchfield.sources.mesh_scene import MeshScene
from touchfield.sources.mesh_surface import welded
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import SourceKind
from touchfield.sources.scene import size_note

_SUFFIXES: Final = (".obj", ".stl", ".ply", ".glb", ".gltf", ".off")
_MOST_TRIANGLES: Final = 30_000_000  # a scene graph may use one geometry many times; this many fill about 5 GB
_EMPTY_PER_BYTE: Final = 16
"""glTF lets an accessor be of zeros without any bytes; more than this for each byte of the file are refused."""


def read_triangles(path: Path) -> tuple[Float64s, Int32s, tuple[str, ...]]:
    """Vertices float64 [n, 3] in the file's units, triangles int32 [m, 3], and notes.

    Raises `SourceError` if the file cannot be read, or holds no triangle.
    """
    if not path.is_file():
        raise SourceError(str(path), "a folder", "one mesh file", "Name the file in it.")
    notes = _gltf_notes(path) if path.suffix.lower() in (".glb", ".gltf") else ()
    trimesh: Any = import_module("trimesh")
    try:
        with np.errstate(all="ignore"):
            loaded = trimesh.load_scene(str(path), resolver=_Beside(path), process=False, skip_materials=True)
            pieces = list(_pieces(path, loaded, trimesh.Trimesh))
    except SourceError:
        raise
    except Exception as error:  # trimesh raises what its loaders and numpy happen to raise on damaged files
        found = f"a mesh that cannot be read ({type(error).__name__}: {str(error)[:120]})"
        raise SourceError(str(path), found, "a whole mesh file", "Export it again, or as PLY.") from error
    if not pieces:
        raise SourceError(str(path), "no triangle", "a mesh of triangles", "Export it with its faces.")
    first = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    vertices = np.concatenate([vertices for vertices, _ in pieces])
    triangles = np.concatenate([faces + begin for (_, faces), begin in zip(pieces, first[:-1], strict=True)])
    return *welded(vertices, triangles), notes


class _Beside:
    """The files that a mesh file names, for trimesh: only such as lie in its folder or below."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def get(self, name: str) -> bytes:
        """The bytes of a file."""
        file = require_beside(self._path.parent, name.strip(), str(self._path))
        require_plain(file, f"the file that {self._path.name} names")
        return file.read_bytes()

    __getitem__ = get  # trimesh asks in both ways


def _pieces(path: Path, loaded: Any, kind: Any) -> list[tuple[Float64s, Int64s]]:
    """Each use of a geometry in the scene graph: its vertices in the world, and its triangles."""
    pieces = []
    total = 0
    for node in loaded.graph.nodes_geometry:
        matrix, name = loaded.graph[node]
        geometry = loaded.geometry[name]
        if not isinstance(geometry, kind) or len(geometry.faces) == 0:
            continue
        total += len(geometry.faces)
        if total > _MOST_TRIANGLES:
            raise SourceError(str(path), "too many triangles", f"at most {_MOST_TRIANGLES}", "Simplify the mesh.")
        matrix = np.asarray(matrix, np.float64)
        vertices = np.asarray(geometry.vertices, np.float64)
        faces = np.asarray(geometry.faces, np.int64)
        if not np.array_equal(matrix, np.eye(4)):
            vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
            if np.linalg.det(matrix[:3, :3]) < 0:
                faces = faces[:, ::-1]  # a mirrored triangle would face the other way
        pieces.append((vertices, faces))
    return pieces


def _gltf_notes(path: Path) -> tuple[str, ...]:
    """Notes on what of a glTF document is not evaluated; refuses one that asks for more than its bytes justify.

    Damage is left to trimesh to report.
    """
    document, size = members_of(path), path.stat().st_size
    try:
        if document is None:
            return ()
        empty = sum(int(a["count"]) for a in document.get("accessors", []) if "bufferView" not in a)
        is_morphed = any("targets" in p for mesh in document.get("meshes", []) for p in mesh.get("primitives", []))
        is_moving = bool(document.get("animations") or document.get("skins"))
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError):
        return ()
    if empty > _EMPTY_PER_BYTE * size:
        raise SourceError(str(path), f"{empty} elements without data in {size} bytes", "elements with their data")
    if is_morphed or is_moving:
        return ("The file is animated (skin, morph targets or tracks); it is read in its rest pose.",)
    return ()


def _open(path: Path, options: SourceOptions) -> MeshScene:
    vertices, triangles, notes = read_triangles(path)
    unit_m = 1.0 if options.unit_m is None else options.unit_m
    with np.errstate(over="ignore", invalid="ignore"):
        asked = {"shell": options.shell, "holes": options.holes, "name": str(path)}
        scene = MeshScene(vertices * unit_m, triangles, **asked, notes=notes)
    scene.notes = (size_note(np.ptp(scene.bounds_m(), axis=0), options.unit_m), *scene.notes)
    return scene


KIND = SourceKind(
    "mesh",
    "a mesh of triangles: OBJ, STL, PLY, GLB, glTF or OFF",
    lambda path: path.suffix.lower() in _SUFFIXES and path.is_file(),
    _open,
)
