"""Skins: which joints carry a vertex, and how far each (linear blend skinning).

Source: Khronos, glTF 2.0 specification (2021), section 3.7.3: a vertex goes with the weighted mean of its joints'
world matrices, each times its inverse bind matrix; the node that holds the skinned mesh has no say.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.gltf.accessors import Accessors
    from touchfield.sources.gltf.document import Document
    from touchfield.sources.gltf.elements import Element

    Floats = NDArray[np.float64]

__all__ = ["Skin", "read_joint_weights"]


class Skin:
    """The joints of a skin and their inverse bind matrices.

    Raises `SourceError` if there is no joint, or the matrices are too few.
    """

    def __init__(self, document: Document, accessors: Accessors, index: int) -> None:
        element = document.all("skins")[index]
        self.joints = np.array(element.indices("joints", len(document.all("nodes"))), np.int64)
        if not len(self.joints):
            raise element.fault("no joint", "at least one")
        self._inverse_bind = np.tile(np.eye(4), (len(self.joints), 1, 1))
        number = element.index("inverseBindMatrices", len(accessors))
        if number is not None:
            columns = accessors.floats(number, "MAT4")
            if len(columns) < len(self.joints):
                found = f"{len(columns)} inverse bind matrices"
                raise element.fault(found, f"one for each of {len(self.joints)} joints")
            self._inverse_bind = columns[: len(self.joints)].reshape(-1, 4, 4).swapaxes(1, 2)

    def matrices(self, world: Floats) -> Floats:
        """What takes a vertex with each joint, float64 [joints, 3, 4], from world matrices [nodes, 4, 4]."""
        moved: Floats = (world[self.joints] @ self._inverse_bind)[:, :3]
        return moved


def read_joint_weights(
    document: Document,
    accessors: Accessors,
    primitive: Element,
    used: NDArray[np.int64],
    vertex_count: int,
    joint_count: int,
) -> Any:
    """The share of every joint in every used vertex, a sparse float64 matrix [used, joints] whose rows sum to 1.

    All sets JOINTS_n, WEIGHTS_n count. A vertex whose weights are all zero goes with the first of its joints.

    Raises `SourceError` if joints or weights are missing, differ in number, or are at fault.
    """
    from scipy.sparse import csr_array

    attributes = primitive.child("attributes") or primitive
    joints: list[NDArray[np.int64]] = []
    weights: list[Floats] = []
    while not joints or f"JOINTS_{len(joints)}" in attributes:
        n = len(joints)
        which = attributes.index(f"JOINTS_{n}", len(accessors))
        much = attributes.index(f"WEIGHTS_{n}", len(accessors))
        if which is None or much is None:
            missing = f"no JOINTS_{n}" if which is None else f"no WEIGHTS_{n}"
            raise attributes.fault(missing, "both, as the mesh has a skin", "Export it again.")
        document.charge(vertex_count, attributes)
        joints.append(accessors.indices(which, "VEC4", joint_count))
        weights.append(accessors.floats(much, "VEC4"))
        if len(joints[-1]) != vertex_count or len(weights[-1]) != vertex_count:
            found = f"{len(joints[-1])} JOINTS_{n} and {len(weights[-1])} WEIGHTS_{n}"
            raise attributes.fault(found, f"one for each of {vertex_count} vertices")
    columns = np.concatenate([each[used] for each in joints], axis=1)
    shares = np.concatenate([each[used] for each in weights], axis=1)
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
