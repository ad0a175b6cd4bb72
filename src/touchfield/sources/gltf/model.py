"""A model in motion: all triangles of a glTF scene once, and their vertices in the world at any time."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.sources.gltf.document import Document
from touchfield.sources.gltf.nodes import Animation, Nodes, animation_names, read_animation
from touchfield.sources.gltf.primitives import MOST_TRIANGLES, Geometry, Skin, joint_shares, read_geometry


@dataclass(frozen=True)
class Poses:
    """Places of the nodes and weights of the morph targets at some times."""

    world: Float64s  # float64 [times, nodes, 4, 4]
    weights: Mapping[int, Float64s]  # mapping from node to float64 [times, targets]


@dataclass(frozen=True)
class _Piece:
    """A primitive at its node."""

    node: int
    geometry: Geometry
    skin: int | None
    shares: Any  # a sparse matrix [vertices, joints], of a skinned piece


class Model:
    """The triangles of the scene of a glTF document: `triangles` int64 [m, 3], vertex numbers over all pieces.

    Raises `SourceError` if the document is at fault, or holds no triangle.
    """

    def __init__(self, path: Path) -> None:
        self._document = Document(path)
        self._nodes = Nodes(self._document)
        self.node_count = len(self._nodes)
        self._skins: dict[int, Skin] = {}
        self._targets = [0] * len(self._nodes)
        self._rest_weights: dict[int, Float64s] = {}
        self._pieces: list[_Piece] = []
        self.animation_names = animation_names(self._document)
        geometries = cache(self._read_mesh)
        shares = cache(lambda mesh, n, skin: joint_shares(geometries(mesh)[n], len(self._skin(skin).joints)))
        total = 0
        for node, element in enumerate(self._document.all("nodes")):
            mesh, skin = element.index("mesh", "meshes"), element.index("skin", "skins")
            if mesh is None:
                continue
            self._take_weights(node, mesh, geometries(mesh))
            for number, geometry in enumerate(geometries(mesh) if node in self._nodes.shown else ()):
                total += len(geometry.triangles)
                if total > MOST_TRIANGLES:
                    raise element.fault("too many triangles", f"at most {MOST_TRIANGLES}", "Simplify the mesh.")
                share = None if skin is None else shares(mesh, number, skin)
                self._document.charge(geometry.targets.size // 3 + (0 if share is None else share.nnz), element)
                self._pieces.append(_Piece(node, geometry, skin, share))
        if not self._pieces:
            raise self._document.root.fault("no triangle", "a mesh of triangles", "Export it with its faces.")
        self._join()

    def _read_mesh(self, mesh: int) -> list[Geometry]:
        primitives = self._document.all("meshes")[mesh].children("primitives")
        return [geometry for geometry in map(read_geometry, primitives) if geometry is not None]

    def _skin(self, number: int) -> Skin:
        if number not in self._skins:
            self._skins[number] = Skin(self._document.all("skins")[number])
        return self._skins[number]

    def _take_weights(self, node: int, mesh: int, geometries: list[Geometry]) -> None:
        """The morph weights of a node at rest: its own, or those of its mesh, or zeros."""
        element = self._document.all("meshes")[mesh]
        counts = {len(geometry.targets) for geometry in geometries}
        if len(counts) > 1:
            raise element.fault(f"primitives with {min(counts)} and with {max(counts)} targets", "the same number")
        count = self._targets[node] = max(counts, default=0)
        if count:
            given = self._document.all("nodes")[node].numbers("weights", count) or element.numbers("weights", count)
            self._rest_weights[node] = np.array([given or [0.0] * count])

    def _join(self) -> None:
        """All triangles of all pieces, with the vertices numbered through."""
        world = self._nodes.world(None, np.zeros(1))[0]
        turned = {n: np.linalg.det(skin.matrices(world)[:, :, :3]).sum() < 0 for n, skin in self._skins.items()}
        first, found = 0, []
        for piece in self._pieces:
            faces = piece.geometry.triangles + first
            is_mirrored = np.linalg.det(world[piece.node, :3, :3]) < 0 if piece.skin is None else turned[piece.skin]
            found.append(faces[:, ::-1] if is_mirrored else faces)  # turned over
            first += len(piece.geometry.vertices)
        self.triangles, self.vertex_count = np.concatenate(found), first

    def animation(self, index: int) -> Animation:
        """Read one of the animations; `SourceError` if its data are at fault."""
        return read_animation(self._document, index, self._targets)

    def poses(self, animation: Animation | None, times_s: Float64s) -> Poses:
        """The poses at times in seconds; without an animation, at rest."""
        count = len(times_s)
        weights = {n: np.broadcast_to(rest, (count, rest.shape[1])) for n, rest in self._rest_weights.items()}
        for channel in animation.channels if animation is not None else ():
            if channel.path == "weights":
                weights[channel.node] = channel.sampler.at(times_s)
        return Poses(self._nodes.world(animation, times_s), weights)

    def reduced(self, kept: Int64s) -> Model:
        """This model with only these vertices, ascending numbers, and no triangle."""
        first, pieces = 0, []
        for piece in self._pieces:
            count = len(piece.geometry.vertices)
            mine = kept[np.searchsorted(kept, first) : np.searchsorted(kept, first + count)] - first
            first += count
            if len(mine):
                all_, shares = piece.geometry, None if piece.shares is None else piece.shares[mine]
                few = replace(all_, vertices=all_.vertices[mine], targets=all_.targets[:, mine], used=all_.used[mine])
                pieces.append(replace(piece, geometry=few, shares=shares))
        fewer = copy.copy(self)
        fewer._pieces, fewer.vertex_count = pieces, len(kept)
        fewer.triangles = np.zeros((0, 3), np.int64)
        return fewer

    def vertices(self, poses: Poses, at: int) -> Float64s:
        """The vertices in the world at one of the times of `poses`, float64 [n, 3], in the file's units."""
        world = poses.world[at]
        joints = {n: skin.matrices(world).reshape(-1, 12) for n, skin in self._skins.items()}
        parts = []
        for piece in self._pieces:
            weights = poses.weights.get(piece.node)
            vertices = piece.geometry.vertices if weights is None else piece.geometry.morphed(weights[at])
            if piece.skin is None:
                matrices = world[piece.node, :3]
            else:
                matrices = (piece.shares @ joints[piece.skin]).reshape(-1, 3, 4)
            parts.append(_moved(matrices, vertices))
        return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _moved(matrices: Float64s, vertices: Float64s) -> Float64s:
    """Matrices [3, 4] or [n, 3, 4] times vertices [n, 3]; the same operations for every vertex, so that equal ones
    stay equal to the last bit."""
    moved = matrices[..., 0] * vertices[:, :1] + matrices[..., 1] * vertices[:, 1:2]
    moved += matrices[..., 2] * vertices[:, 2:]
    moved += matrices[..., 3]
    return moved
