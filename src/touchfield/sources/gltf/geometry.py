"""Primitives: the triangles of a mesh, and where its morph targets take their vertices.

Source: Khronos, glTF 2.0 specification (2021), section 3.7.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.gltf.accessors import Accessors
    from touchfield.sources.gltf.document import Document
    from touchfield.sources.gltf.elements import Element

    Floats = NDArray[np.float64]

__all__ = ["MOST_TRIANGLES", "Geometry", "read_geometry"]

MOST_TRIANGLES: Final = 10_000_000
"""A node tree may use one mesh many times; a frame of this many takes about 3 GB."""

_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_COMPRESSIONS: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


@dataclass(frozen=True)
class Geometry:
    """The triangles of a primitive.

    Parameters
    ----------
    element : Element; Where it stands.
    vertices : float64 [n, 3]; Those that a triangle uses.
    triangles : int64 [m, 3]
    targets : float64 [t, n, 3]; What each morph target adds.
    used : int64 [n]; Their numbers in the accessors.
    vertex_count : int; Vertices in the accessors.
    """

    element: Element
    vertices: Floats
    triangles: NDArray[np.int64]
    targets: Floats
    used: NDArray[np.int64]
    vertex_count: int

    def morphed(self, weights: Floats) -> Floats:
        """The vertices with each target added, times its weight; float64 [n, 3]."""
        vertices = self.vertices
        for number in np.flatnonzero(weights):
            vertices = vertices + weights[number] * self.targets[number]
        return vertices


def read_geometry(document: Document, accessors: Accessors, primitive: Element) -> Geometry | None:
    """Read a primitive; None where it has no triangle (points or lines).

    Raises `SourceError` if an accessor is missing or does not fit.
    """
    mode = primitive.integer("mode", _TRIANGLES)
    if mode > _FAN:
        raise primitive.fault(f"mode {mode}", "0 to 6")
    attributes = primitive.child("attributes")
    place = None if attributes is None else attributes.index("POSITION", len(accessors))
    if mode < _TRIANGLES or place is None:
        return None
    extensions = primitive.child("extensions")
    for name in _COMPRESSIONS:
        if extensions is not None and name in extensions and not accessors.has_data(place):
            raise primitive.fault(f"a mesh compressed with {name}", "a mesh without it", "Export it uncompressed.")
    vertices = accessors.floats(place, "VEC3")
    number = primitive.index("indices", len(accessors))
    if number is None:
        corners = np.arange(len(vertices))
    else:
        corners = accessors.indices(number, "SCALAR", len(vertices))[:, 0]
    if mode == _TRIANGLES and len(corners) % 3:
        raise primitive.fault(f"{len(corners)} corners", "three for each triangle")
    if len(corners) > 3 * MOST_TRIANGLES:
        raise primitive.fault("too many triangles", f"at most {MOST_TRIANGLES}", "Simplify the mesh.")
    used, numbers = np.unique(corners, return_inverse=True)
    triangles = _triangles(numbers.reshape(-1), mode)
    if not len(triangles):
        return None
    targets = primitive.children("targets")
    document.charge(len(targets) * len(used), primitive)
    moves = np.zeros((len(targets), len(used), 3))
    for target, move in zip(targets, moves, strict=True):
        place = target.index("POSITION", len(accessors))
        if place is not None:
            values = accessors.floats(place, "VEC3")
            if len(values) != len(vertices):
                raise target.fault(f"{len(values)} positions", f"one for each of {len(vertices)} vertices")
            move[:] = values[used]
    return Geometry(primitive, vertices[used], triangles, moves, used, len(vertices))


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _TRIANGLES:
        return corners.reshape(-1, 3)
    i = np.arange(max(len(corners) - 2, 0))
    if mode == _STRIP:  # every second one is turned over
        return np.stack([corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]], axis=1)
    return np.stack([corners[i + 1], corners[i + 2], np.broadcast_to(corners[:1], len(i))], axis=1)
