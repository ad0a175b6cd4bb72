"""Reads the meshes of a COLLADA file (``.dae``) with pycollada (extra ``meshes``).

Instances are placed by the nodes of the default scene. Skins are read in their bind shape, and animations are
not evaluated; both are noted. Source: Khronos, COLLADA 1.4.1 specification (2008): unit and up_axis of
`asset`, and the instances of nodes, geometries and controllers.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import numpy as np

from touchfield.errors import SourceError, import_extra
from touchfield.files import readable
from touchfield.sources.mesh.instances import ROOT, Definitions
from touchfield.sources.mesh.mesh_data import MeshData, Placed, fans, join
from touchfield.sources.scene import UP_Y_AXES, UP_Z_AXES
from touchfield.sources.unread_files import without_triangles

_DEFINITIONS: Final = ("visual_scene", "node", "geometry", "controller")
_REFERENCES: Final = {
    **dict.fromkeys(
        ("instance_visual_scene", "instance_node", "instance_geometry", "instance_controller"), "url"
    ),
    "skin": "source",
    "morph": "source",
}
_AXES: Final = {"Y_UP": UP_Y_AXES, "Z_UP": UP_Z_AXES, "X_UP": "x up, y left, z towards the viewer"}
_LEFT_OUT: Final = {
    "lines": "lines",
    "linestrips": "lines",
    "convex_mesh": "convex hulls",
    "spline": "splines",
    "morph": "morph targets",
}
"""Geometry that is not read, by its tag."""


def read_collada(path: Path) -> MeshData:
    """Read the triangles of the default scene of a COLLADA file.

    Raises `SourceError` if the file cannot be read, or has no triangle; `MissingExtra` without pycollada.
    """
    collada = import_extra("collada", "a mesh in COLLADA", "pycollada", "meshes")
    with readable(path, "a whole COLLADA file"):
        data = path.read_bytes()
    tags = _check_instances(path, data)
    try:
        with np.errstate(all="ignore"):
            document = collada.Collada(io.BytesIO(data), ignore=[collada.common.DaeError])
            bound = _bound_geometries(document.scene) if document.scene else []
            placed = [part for geometry in bound for part in _placed(collada, geometry)]
            if not sum(len(part.triangles) for part in placed):
                if document.errors:
                    found = f"no triangle that can be read ({_text(document.errors[0])})"
                    raise SourceError(str(path), found, "a whole COLLADA file", "Export it again.")
                raise without_triangles(path, sum(len(part.vertices) for part in placed))
            vertices, triangles = join(placed)
    except SourceError:
        raise
    except Exception as error:  # of a file that is not as it should be, pycollada raises errors of any kind
        found = f"a COLLADA file that cannot be read ({type(error).__name__}: {str(error)[:120]})"
        raise SourceError(str(path), found, "a whole COLLADA file", "Export it again.") from error
    asset = document.assetInfo
    notes = (*_left_out_notes(tags), *_fault_notes(document.errors))
    return MeshData(vertices, triangles, notes, asset.unitmeter, _AXES.get(str(asset.upaxis), UP_Y_AXES))


def _bound_geometries(scene: Any) -> Iterator[Any]:
    """Yield the geometries of a scene, placed; those of skins in their bind shape."""
    yield from scene.objects("geometry")
    for controller in scene.objects("controller"):
        geometry = getattr(controller, "geometry", None)  # a morph has none
        if geometry is not None:
            yield geometry


def _placed(collada: Any, geometry: Any) -> Iterator[Placed]:
    is_mirrored = float(np.linalg.det(geometry.matrix[:3, :3])) < 0
    for primitive in geometry.primitives():
        if isinstance(primitive, collada.polylist.BoundPolylist):
            start, stop = np.asarray(primitive.polyindex, np.int64).T
            counts = stop - start
        elif isinstance(primitive, collada.triangleset.BoundTriangleSet):
            counts = np.full(len(primitive.vertex_index), 3)
        else:
            continue
        if primitive.vertex is not None and len(counts):
            corners, sizes = fans(counts)
            indices = np.asarray(primitive.vertex_index, np.int64).reshape(-1)
            yield Placed(np.asarray(primitive.vertex, np.float64), indices[corners], sizes, is_mirrored)


def _left_out_notes(tags: Counter[str]) -> tuple[str, ...]:
    """Return notes on what a file has and is not read, by the number of its tags."""
    notes = list[str]()
    if tags["skin"]:
        notes.append(f"{tags['skin']} skinned meshes are read in their bind shape.")
    if tags["animation"]:
        notes.append("The file is animated; it is read at rest (glTF is read with its animation).")
    words = sorted({word for tag, word in _LEFT_OUT.items() if tags[tag]})
    if words:
        notes.append(f"Left out: {', '.join(words)}.")
    return tuple(notes)


def _fault_notes(errors: list[Exception]) -> tuple[str, ...]:
    if not errors:
        return ()
    return (f"{len(errors)} elements that cannot be read are left out; the first: {_text(errors[0])}.",)


def _text(error: Exception) -> str:
    return " ".join(str(error).split())[:120].rstrip(".")


# -- before pycollada reads it -----------------------------------------------------------------------------
def _check_instances(path: Path, data: bytes) -> Counter[str]:
    """Refuse XML whose instances expand to far more than the file; return the number of each tag.

    Raises `SourceError` for what is no XML, has a document type, or another root element.
    """
    parser, tags, definitions = expat.ParserCreate(), Counter[str](), Definitions(str(path))
    enclosing = [ROOT]  # the definition of each element around the current one
    position = count = 0

    def count_bytes() -> None:
        nonlocal position
        definitions.sizes[enclosing[-1]] += parser.CurrentByteIndex - position
        position = parser.CurrentByteIndex

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal count
        tag = name.rpartition(":")[2]
        if not tags and tag != "COLLADA":
            raise SourceError(str(path), f"the element {tag[:40]!r}", "a COLLADA file")
        tags[tag] += 1
        count_bytes()
        outer = inner = enclosing[-1]
        if tag in _REFERENCES:
            definitions.uses[outer].append(attributes.get(_REFERENCES[tag], "").removeprefix("#") or " ")
        if tag in _DEFINITIONS:
            count += 1
            inner = attributes.get("id") or f" {count}"
            if outer != ROOT:
                definitions.uses[outer].append(inner)
        enclosing.append(inner)

    def end(_: str) -> None:
        count_bytes()
        enclosing.pop()

    def refuse(*_: object) -> None:
        raise SourceError(str(path), "a document type declaration", "plain XML", "Remove the DOCTYPE.")

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter of unknown encodings
        raise SourceError(str(path), f"no XML ({error})", "a whole COLLADA file") from error
    definitions.require_bounded(len(data))
    return tags
