"""Reads the meshes of a 3MF file with lib3mf (extra ``meshes``).

What the build places is read: objects of type model and surface. Source: 3MF Consortium, 3MF Core
Specification 1.3, sections 3.4 (build items, transforms as rows) and 4 (objects and components).
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, import_extra
from touchfield.files import library_faults, readable
from touchfield.medium.stores.npz import require_plain_zip
from touchfield.sources.mesh.instances import ROOT, Definitions
from touchfield.sources.mesh.mesh_data import MeshData, Placed, join, require_bounded
from touchfield.sources.scene import UP_Z_AXES
from touchfield.sources.unread_files import without_triangles

_UNITS_M: Final = {
    "MicroMeter": 1e-6, "MilliMeter": 1e-3, "CentiMeter": 1e-2, "Inch": 0.0254, "Foot": 0.3048, "Meter": 1.0,
}  # fmt: skip
_READ_TYPES: Final = ("Model", "Surface")  # the others support the print, or are not printed
_UNPACKED_PER_BYTE, _FREE_UNPACKED = 64, 1 << 24  # bytes that an archive may declare
_ELEMENT: Final = re.compile(rb"<(/?)(?:[\w.-]+:)?(object|component|item)(?=[\s/>])([^>]*)>")
_NUMBER, _OBJECT = (re.compile(rb"""\s%s\s*=\s*(["'])(\d+)\1""" % name) for name in (b"id", b"objectid"))
_PATH: Final = re.compile(rb"""\s[\w.-]+:path\s*=\s*(["'])([^"']*)\1""")


def read_3mf(path: Path) -> MeshData:
    """Read the triangles that the build of a 3MF file places.

    Raises `SourceError` if the file cannot be read, or has no triangle; `MissingExtra` without lib3mf.
    """
    lib3mf = import_extra("lib3mf", "a mesh in 3MF", "lib3mf", "meshes")
    with readable(path, "a whole 3MF file"):
        data = path.read_bytes()
    _check_archive(path, data)
    with library_faults(path, "a 3MF file that cannot be read", "a whole 3MF file", "Export it again."):
        model = lib3mf.get_wrapper().CreateModel()
        model.QueryReader("3mf").ReadFromBuffer(data)
        build = _Build(lib3mf)
        items = list(_each(model.GetBuildItems()))
        objects = [item.GetObjectResource() for item in items]
        require_bounded(str(path), sum(build.count(entry) for entry in objects), len(data))
        placed = [
            part
            for item, entry in zip(items, objects)
            for part in build.placed(entry, _matrix(item.GetObjectTransform()))
        ]
        if not sum(len(part.triangles) for part in placed):
            raise without_triangles(path, sum(len(part.vertices) for part in placed))
        vertices, triangles = join(placed)
        unit = lib3mf.ModelUnit(model.GetUnit()).name
    return MeshData(vertices, triangles, build.notes(), _UNITS_M[unit], UP_Z_AXES)


# -- before lib3mf reads it --------------------------------------------------------------------------------
def _check_archive(path: Path, data: bytes) -> None:
    """Refuse what is no archive, and one that unpacks, or whose components expand, to far too much."""
    definitions = Definitions(str(path))
    with (
        library_faults(path, "no zip archive", "a whole 3MF file"),
        zipfile.ZipFile(io.BytesIO(data)) as archive,
    ):
        unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > _UNPACKED_PER_BYTE * len(data) + _FREE_UNPACKED:
            found = f"an archive of {len(data)} bytes that declares {unpacked}"
            raise SourceError(str(path), found, "a 3MF file", "Export it again.")
        for entry in archive.infolist():
            require_plain_zip(entry, str(path))
            if entry.filename.lower().endswith(".model"):
                _add_definitions(path, f"/{entry.filename}", archive.read(entry), definitions)
    definitions.require_bounded(unpacked)


def _add_definitions(path: Path, part: str, text: bytes, definitions: Definitions) -> None:
    """Add the objects of one part of an archive, by the name of the part and their number.

    They are found by their text, in which nothing may be hidden, as parsing would take most of the time.
    """
    if b"\0" in text or b"<!DOCTYPE" in text:
        raise SourceError(str(path), f"{part[:60]} in another encoding, or with a DOCTYPE", "XML in UTF-8")
    name, last = ROOT, 0
    for found in _ELEMENT.finditer(text):
        definitions.sizes[name] += found.start() - last
        last, closes, tag = found.start(), found[1], found[2]
        if tag == b"object":
            numbered = _NUMBER.search(found[3])
            name = ROOT if closes or numbered is None else f"{part} {int(numbered[2])}"
            continue
        numbered, elsewhere = _OBJECT.search(found[3]), _PATH.search(found[3])
        if not closes:
            if numbered is None:
                raise SourceError(str(path), f"a {tag.decode()} without the number of an object", "one")
            place = elsewhere[2].decode("utf-8", "replace") if elsewhere else part
            definitions.uses[name].append(f"{place} {int(numbered[2])}")
    definitions.sizes[name] += len(text) - last


def _each(iterator: Any) -> Iterator[Any]:
    """Yield what an iterator of lib3mf points to."""
    while iterator.MoveNext():
        yield iterator.GetCurrent()


def _matrix(transform: Any) -> Float64s:
    """Return a transform as float64 [4, 3]: three rows that multiply a row vector, and the shift."""
    return np.array([list(row) for row in transform.Fields], np.float64)


class _Build:
    """Counts and places the objects of a model; remembers what it leaves out."""

    def __init__(self, lib3mf: Any) -> None:
        self._lib3mf = lib3mf
        self._counts: dict[int, int] = {}
        self._meshes: dict[int, tuple[Float64s, Any]] = {}
        self._left_out: dict[str, set[int]] = {}

    def notes(self) -> tuple[str, ...]:
        return tuple(f"Left out: {len(ids)} {what}." for what, ids in sorted(self._left_out.items()))

    def count(self, entry: Any) -> int:
        """Return the triangles of an object with all its components, and one for each instance."""
        key = int(entry.GetUniqueResourceID())
        if key not in self._counts:
            total = 1
            if entry.IsMeshObject():
                total += int(entry.GetTriangleCount())
            elif entry.IsComponentsObject():
                total += sum(self.count(component.GetObjectResource()) for component in _components(entry))
            self._counts[key] = total
        return self._counts[key]

    def placed(self, entry: Any, matrix: Float64s) -> Iterator[Placed]:
        """Yield the meshes of an object, placed by a matrix float64 [4, 3]."""
        key = int(entry.GetUniqueResourceID())
        kind = self._lib3mf.ObjectType(entry.GetType()).name
        if kind not in _READ_TYPES:
            self._left_out.setdefault(f"objects of type {kind.lower()}", set()).add(key)
            return
        if entry.IsMeshObject():
            vertices, triangles = self._mesh(key, entry)
            is_mirrored = float(np.linalg.det(matrix[:3])) < 0
            sizes = np.ones(len(triangles), np.int64)
            if len(triangles):
                yield Placed(vertices @ matrix[:3] + matrix[3], triangles, sizes, is_mirrored)
        elif entry.IsComponentsObject():
            for component in _components(entry):
                inner = _matrix(component.GetTransform()) if component.HasTransform() else np.eye(4)[:, :3]
                yield from self.placed(
                    component.GetObjectResource(), inner @ matrix[:3] + np.eye(4)[:, 3:] * matrix[3]
                )
        else:
            self._left_out.setdefault("objects that are no meshes", set()).add(key)

    def _mesh(self, key: int, entry: Any) -> tuple[Float64s, Any]:
        """Return vertices float64 [n, 3] and triangles int64 [m, 3] of an object, read once."""
        if key not in self._meshes:
            points = [tuple(point.Coordinates) for point in entry.GetVertices()]
            corners = [tuple(triangle.Indices) for triangle in entry.GetTriangleIndices()]
            vertices = np.array(points, np.float64).reshape(-1, 3)
            self._meshes[key] = vertices, np.array(corners, np.int64).reshape(-1, 3)
            if entry.BeamLattice().GetBeamCount():
                self._left_out.setdefault("beam lattices", set()).add(key)
        return self._meshes[key]


def _components(entry: Any) -> Iterator[Any]:
    for index in range(entry.GetComponentCount()):
        yield entry.GetComponent(index)
