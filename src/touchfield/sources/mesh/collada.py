"""Reads the meshes of a COLLADA file (``.dae``) with pycollada (extra ``meshes``).

Instances are placed by the nodes of the default scene. Skins are read in their bind shape, and animations are
not evaluated; both are noted. Source: Khronos, COLLADA 1.4.1 specification (2008): unit and up_axis of
`asset`, and the instances of nodes, geometries and controllers.
"""

from __future__ import annotations

import io
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import numpy as np

from touchfield.errors import SourceError, import_extra
from touchfield.files import readable
from touchfield.sources.mesh.mesh_data import MeshData, Placed, join
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
_MAX_EXPANDED: Final = 1 << 28  # bytes of the text of all instances, or those of the file
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
            sizes = np.maximum(np.asarray(primitive.vcounts, np.int64) - 2, 0)
            primitive = primitive.triangleset()
        elif isinstance(primitive, collada.triangleset.BoundTriangleSet):
            sizes = np.ones(len(primitive.vertex_index), np.int64)
        else:
            continue
        if primitive.vertex is not None and len(primitive.vertex_index):
            vertices = np.asarray(primitive.vertex, np.float64)
            yield Placed(vertices, primitive.vertex_index, sizes[sizes > 0], is_mirrored)


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
    first = " ".join(str(errors[0]).split())[:120]
    return (f"{len(errors)} elements that cannot be read are left out; the first: {first}.",)


# -- before pycollada reads it -----------------------------------------------------------------------------
def _check_instances(path: Path, data: bytes) -> Counter[str]:
    """Refuse XML whose instances expand to far more than the file; return the number of each tag.

    Raises `SourceError` for what is no XML, has a document type, or another root element.
    """
    parser, tags = expat.ParserCreate(), Counter[str]()
    enclosing = [""]  # the definition of each element around the current one
    own, refers = defaultdict[str, int](int), defaultdict[str, list[str]](list)
    position = 0

    def count_bytes() -> None:
        nonlocal position
        own[enclosing[-1]] += parser.CurrentByteIndex - position
        position = parser.CurrentByteIndex

    def start(name: str, attributes: dict[str, str]) -> None:
        tag = name.rpartition(":")[2]
        if not tags and tag != "COLLADA":
            raise SourceError(str(path), f"the element {tag[:40]!r}", "a COLLADA file")
        tags[tag] += 1
        count_bytes()
        outer = enclosing[-1]
        if tag in _REFERENCES:
            refers[outer].append(attributes.get(_REFERENCES[tag], "").removeprefix("#"))
        is_definition = tag in _DEFINITIONS
        inner = (attributes.get("id") or f"#{len(own)}") if is_definition else outer
        if is_definition and outer:
            refers[outer].append(inner)
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
    except expat.ExpatError as error:
        raise SourceError(str(path), f"no XML ({error})", "a whole COLLADA file") from error
    expanded, limit = _expanded(path, own, refers), max(_MAX_EXPANDED, len(data))
    if expanded > limit:
        found = f"instances of {expanded:.3g} bytes in a file of {len(data)}"
        raise SourceError(str(path), found, f"at most {limit} bytes", "Export fewer instances.")
    return tags


def _expanded(path: Path, own: dict[str, int], refers: dict[str, list[str]]) -> int:
    """Return the bytes of the default scene with all its instances."""
    total, opened = dict[str, int](), set[str]()
    pending = [""]
    while pending:
        name = pending[-1]
        missing = [other for other in refers.get(name, ()) if other not in total]
        if name in opened:
            pending.pop()
            total.setdefault(name, own.get(name, 0) + sum(total.get(o, 0) for o in refers.get(name, ())))
            continue
        opened.add(name)
        cyclic = [other for other in missing if other in opened]
        if cyclic:
            raise SourceError(str(path), f"{cyclic[0][:40]!r} within itself", "a tree of nodes")
        pending += missing
    return total[""]
