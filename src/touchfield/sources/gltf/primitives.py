"""Primitives: the triangles of a mesh, where its morph targets take their vertices, and which joints carry them.

Source: Khronos, glTF 2.0 specification (2021), sections 3.7.2 (geometry) and 3.7.3 (skins): a vertex goes with the
weighted mean of its joints' world matrices, each times its inverse bind matrix; the node that holds the skinned mesh
has no say.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.sources.gltf.document import Element

MOST_TRIANGLES: Final = 10_000_000  # a node tree may use one mesh many times; a frame of this many takes about 3 GB
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_COMPRESSIONS: Final = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")


@dataclass(frozen=True)
class Geometry:
    """The triangles of a primitive."""

    element: Element  # where it stands
    vertices: Float64s  # float64 [n, 3]; those that a triangle uses
    triangles: Int64s  # int64 [m, 3]
    targets: Float64s  # float64 [t, n, 3]; what each morph target adds
    used: Int64s  # int64 [n]; their numbers in the accessors
    vertex_count: int  # vertices in the accessors

    def morphed(self, weights: Float64s) -> Float64s:
        """The vertices with each target added, times its weight; float64 [n, 3]."""
        vertices = self.vertices
        for number in np.flatnonzero(weights):
            vertices = vertices + weights[number] * self.targets[number]
        return vertices


def read_geometry(primitive: Element) -> Geometry | None:
    """Read a primitive; None where it has no triangle (points or lines).

    Raises `SourceError` if an accessor is missing or does not fit.
    """
    mode = primitive.integer("mode", _TRIANGLES)
    if mode > _FAN:
        raise primitive.fault(f"mode {mode}", "0 to 6")
    attributes = primitive.child("attributes")
    if mode < _TRIANGLES or attributes is None:
        return None
    place = attributes.index("POSITION", "accessors")
    if place is None:
        return None
    extensions, positions = primitive.child("extensions"), primitive.document.all("accessors")[place]
    has_data = "bufferView" in positions or "sparse" in positions  # else they are zeros
    for name in _COMPRESSIONS:
        if extensions is not None and name in extensions and not has_data:
            raise primitive.fault(f"a mesh compressed with {name}", "a mesh without it", "Export it uncompressed.")
    vertices = primitive.document.floats(place, "VEC3")
    numbers = primitive.whole("indices", "SCALAR", len(vertices))
    corners = np.arange(len(vertices)) if numbers is None else numbers[:, 0]
    if mode == _TRIANGLES and len(corners) % 3:
        raise primitive.fault(f"{len(corners)} corners", "three for each triangle")
    if len(corners) > 3 * MOST_TRIANGLES:
        raise primitive.fault("too many triangles", f"at most {MOST_TRIANGLES}", "Simplify the mesh.")
    used, corners = np.unique(corners, return_inverse=True)
    triangles = _triangles(corners.reshape(-1), mode)
    if not len(triangles):
        return None
    targets = primitive.children("targets")
    primitive.document.charge(len(targets) * len(used), primitive)
    moves = np.zeros((len(targets), len(used), 3))
    for target, move in zip(targets, moves, strict=True):
        values = target.floats("POSITION", "VEC3")
        if values is not None:
            if len(values) != len(vertices):
                raise target.fault(f"{len(values)} positions", f"one for each of {len(vertices)} vertices")
            move[:] = values[used]
    return Geometry(primitive, vertices[used], triangles, moves, used, len(vertices))


def _triangles(corners: Int64s, mode: int) -> Int64s:
    if mode == _TRIANGLES:
        return corners.reshape(-1, 3)
    i = np.arange(max(len(corners) - 2, 0))
    if mode == _STRIP:  # every second one is turned over
        return np.stack([corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]], axis=1)
    return np.stack([corners[i + 1], corners[i + 2], np.broadcast_to(corners[:1], len(i))], axis=1)


class Skin:
    """The joints of a skin and their inverse bind matrices.

    Raises `SourceError` if there is no joint, or the matrices are too few.
    """

    def __init__(self, element: Element) -> None:
        self.joints = np.array(element.indices("joints", "nodes"), np.int64)
        if not len(self.joints):
            raise element.fault("no joint", "at least one")
        self._inverse_bind = np.tile(np.eye(4), (len(self.joints), 1, 1))
        columns = element.floats("inverseBindMatrices", "MAT4")
        if columns is not None:
            if len(columns) < len(self.joints):
                found = f"{len(columns)} inverse bind matrices"
                raise element.fault(found, f"one for each of {len(self.joints)} joints")
            self._inverse_bind = columns[: len(self.joints)].reshape(-1, 4, 4).swapaxes(1, 2)

    def matrices(self, world: Float64s) -> Float64s:
        """Motions of a vertex with each joint, float64 [joints, 3, 4], from world matrices [nodes, 4, 4]."""
        moved: Float64s = (world[self.joints] @ self._inverse_bind)[:, :3]
        return moved


def joint_shares(geometry: Geometry, joint_count: int) -> Any:
    """The share of every joint in every vertex, a sparse float64 matrix [vertices, joints] whose rows sum to 1.

    All sets JOINTS_n, WEIGHTS_n count. A vertex whose weights are all zero goes with the first of its joints.

    Raises `SourceError` if joints or weights are missing, differ in number, or are at fault.
    """
    from scipy.sparse import csr_array

    count, used = geometry.vertex_count, geometry.used
    attributes = geometry.element.child("attributes") or geometry.element
    sets: list[tuple[Int64s, Float64s]] = []
    while not sets or f"JOINTS_{len(sets)}" in attributes:
        n = len(sets)
        for name in (f"JOINTS_{n}", f"WEIGHTS_{n}"):
            if name not in attributes:
                raise attributes.fault(f"no {name}", "both, as the mesh has a skin", "Export it again.")
        attributes.document.charge(count, attributes)
        joints = attributes.whole(f"JOINTS_{n}", "VEC4", joint_count)
        weights = attributes.floats(f"WEIGHTS_{n}", "VEC4")
        assert joints is not None and weights is not None
        if len(joints) != count or len(weights) != count:
            found = f"{len(joints)} JOINTS_{n} and {len(weights)} WEIGHTS_{n}"
            raise attributes.fault(found, f"one for each of {count} vertices")
        sets.append((joints[used], weights[used]))
    columns, shares = (np.concatenate(each, axis=1) for each in zip(*sets, strict=True))
    if (shares < 0).any():
        raise attributes.fault("a weight below 0", "weights from 0 to 1")
    is_loose = ~shares.any(axis=1)
    shares[is_loose, 0] = 1.0
    shares /= shares.sum(axis=1, keepdims=True)
    starts = np.arange(len(used) + 1) * columns.shape[1]
    matrix = csr_array((shares.reshape(-1), columns.reshape(-1), starts), shape=(len(used), joint_count))
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix
