"""The node tree: from translations, rotations, scales or matrices to the place of every node in the world.

Source: Khronos, glTF 2.0 specification (2021), section 3.5: a local matrix is T R S, the world matrix of a node that
of its parent times its own; each node has one parent at most.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.medium.rotations import rotation_matrices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.gltf.animation import Animation
    from touchfield.sources.gltf.document import Document
    from touchfield.sources.gltf.elements import Element

    Floats = NDArray[np.float64]

__all__ = ["Nodes"]


class Nodes:
    """The nodes of a document.

    Attributes
    ----------
    shown : frozenset of int; The nodes of the scene that is shown; all of them where the document has no scene.

    Raises `SourceError` if a node has two parents, is its own ancestor, or has numbers at fault.
    """

    def __init__(self, document: Document) -> None:
        self._elements = document.all("nodes")
        count = len(self._elements)
        self._parents = np.full(count, -1, np.int64)
        children = [element.indices("children", count) for element in self._elements]
        for node, below in enumerate(children):
            for child in below:
                if self._parents[child] >= 0:
                    raise self._elements[child].fault("a second parent", "one parent at most")
                self._parents[child] = node
        self._levels = self._by_level(children)
        self.shown = self._shown(document, children)
        self._translations = np.zeros((count, 3))
        self._rotations = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
        self._scales = np.ones((count, 3))
        self._matrices: dict[int, Floats] = {}
        for node, element in enumerate(self._elements):
            self._take(node, element)

    def __len__(self) -> int:
        return len(self._elements)

    def _by_level(self, children: list[list[int]]) -> list[NDArray[np.int64]]:
        """The nodes by their distance from the root; those of a cycle are reached from none."""
        levels, level = [], [node for node in range(len(self)) if self._parents[node] < 0]
        seen = 0
        while level:
            seen += len(level)
            levels.append(np.array(level, np.int64))
            level = [child for node in level for child in children[node]]
        if seen < len(self):
            reached = np.zeros(len(self), np.bool_)
            reached[np.concatenate([np.zeros(0, np.int64), *levels])] = True
            raise self._elements[int(reached.argmin())].fault("a node that is its own ancestor", "a tree of nodes")
        return levels

    def _shown(self, document: Document, children: list[list[int]]) -> frozenset[int]:
        scenes = document.all("scenes")
        if not scenes:
            return frozenset(range(len(self)))
        number = document.root.index("scene", len(scenes))
        stack = scenes[number or 0].indices("nodes", len(self))
        found: set[int] = set()
        while stack:
            node = stack.pop()
            if node not in found:
                found.add(node)
                stack.extend(children[node])
        return frozenset(found)

    def _take(self, node: int, element: Element) -> None:
        matrix = element.numbers("matrix", 16)
        if matrix is not None:
            self._matrices[node] = np.array(matrix).reshape(4, 4).T  # stored column by column
            if not np.array_equal(self._matrices[node][3], (0, 0, 0, 1)):
                raise element.fault("a matrix whose last row is not 0, 0, 0, 1", "an affine one")
            return
        for key, values in (
            ("translation", self._translations),
            ("rotation", self._rotations),
            ("scale", self._scales),
        ):
            given = element.numbers(key, values.shape[1])
            if given is not None:
                values[node] = given
        length = float(np.linalg.norm(self._rotations[node]))
        if not (length > 0 and np.isfinite(length)):
            raise element.fault("a rotation of length 0", "a unit quaternion (x, y, z, w)")
        self._rotations[node] /= length

    def world(self, animation: Animation | None, times_s: Floats) -> Floats:
        """World matrices, float64 [times, nodes, 4, 4], at times in seconds; without an animation, at rest."""
        shape = (len(times_s), len(self))
        parts = {
            "translation": np.broadcast_to(self._translations, (*shape, 3)),
            "rotation": np.broadcast_to(self._rotations, (*shape, 4)),
            "scale": np.broadcast_to(self._scales, (*shape, 3)),
        }
        for channel in animation.channels if animation is not None else ():
            if channel.path in parts:
                if not parts[channel.path].flags.writeable:
                    parts[channel.path] = parts[channel.path].copy()
                parts[channel.path][:, channel.node] = channel.sampler.at(times_s)
        local = np.zeros((*shape, 4, 4))
        from_xyzw = np.roll(parts["rotation"], 1, axis=-1)
        local[..., :3, :3] = rotation_matrices(from_xyzw) * parts["scale"][..., None, :]
        local[..., :3, 3] = parts["translation"]
        local[..., 3, 3] = 1.0
        for node, matrix in self._matrices.items():
            local[:, node] = matrix
        for level in self._levels[1:]:
            local[:, level] = local[:, self._parents[level]] @ local[:, level]
        return local
