"""Computes the vertices of an animated glTF model at any time.

Source: Khronos, glTF 2.0 specification (2021). Section 3.5: a local matrix is T R S; the world matrix of a
node is the world matrix of its parent times its local matrix. Sections 3.7.2 and 3.7.3: primitives, morph
targets and skins; a vertex of a skinned mesh moves with the weighted mean of its joints' world matrices, each
times its inverse bind matrix; the node of the mesh has no influence. Section 3.11 and appendix C: samplers
are LINEAR (spherical for rotations), STEP or CUBICSPLINE (Hermite, tangents in value per second); a sampler
is constant before its first and after its last time.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, Int64s
from touchfield.medium.pose_track import rotation_matrices, slerp
from touchfield.sources.gltf.document import COMPRESSIONS, HARMLESS, Document, Element
from touchfield.sources.unread_files import compressed_mesh

_MAX_TRIANGLES: Final = 10_000_000  # or one per byte of the file: a node tree may use one mesh many times
_MAX_NOTED: Final = 9
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_WIDTHS: Final = {"translation": 3, "rotation": 4, "scale": 3}
_INTERPOLATIONS: Final = ("LINEAR", "STEP", "CUBICSPLINE")


# -- animations --------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Sampler:
    """A value over time; see the module."""

    times_s: Float64s  # float64 [k]; ascending
    values: Float64s  # float64 [k, w]
    interpolation: str = "LINEAR"  # "LINEAR", "STEP" or "CUBICSPLINE"
    # float64 [k, w] twice, for CUBICSPLINE: in- and out-tangents, value per second
    tangents: tuple[Float64s, Float64s] | None = None
    is_rotation: bool = False  # True if the values are unit quaternions (x, y, z, w)

    def at(self, times_s: Float64s) -> Float64s:
        """Return the values at times in seconds, float64 [n, w]."""
        last = len(self.times_s) - 1
        before = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, last)
        after = np.minimum(before + 1, last)
        span = self.times_s[after] - self.times_s[before]
        fraction = np.clip((times_s - self.times_s[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        a, b = self.values[before], self.values[after]
        if self.interpolation == "STEP":
            return a
        if self.tangents is not None:
            arriving, leaving = self.tangents[0][after], self.tangents[1][before]
            fraction = fraction[:, None]
            s2, s3 = fraction * fraction, fraction * fraction * fraction
            mixed = (2 * s3 - 3 * s2 + 1) * a + (3 * s2 - 2 * s3) * b
            mixed += span[:, None] * ((s3 - 2 * s2 + fraction) * leaving + (s3 - s2) * arriving)
            return _unit(mixed) if self.is_rotation else mixed
        return slerp(a, b, fraction) if self.is_rotation else a + fraction[:, None] * (b - a)


def _unit(quaternions: Float64s) -> Float64s:
    """Normalise quaternions; one of length 0 becomes the identity."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.asarray(
        np.where(lengths > 0, quaternions / np.where(lengths > 0, lengths, 1.0), (0.0, 0.0, 0.0, 1.0))
    )


class Animation(NamedTuple):
    """One animation of a document: samplers by node and path.

    A path is translation, rotation, scale or weights.
    """

    duration_s: float  # the last time of any of its samplers; it starts at 0
    samplers: Mapping[tuple[int, str], Sampler]

    @property
    def has_scale(self) -> bool:
        """True if it changes a scale, which may then mirror a mesh."""
        return any(path == "scale" for _, path in self.samplers)


def _sampler(element: Element, path: str, width: int) -> Sampler:
    interpolation = element.word("interpolation") or "LINEAR"
    if interpolation not in _INTERPOLATIONS:
        raise element.wrong(f"interpolation {interpolation[:20]!r}", ", ".join(_INTERPOLATIONS))
    times = element.floats("input", "SCALAR")
    values = element.floats("output", "SCALAR" if path == "weights" else f"VEC{width}")
    if times is None or values is None:
        raise element.wrong("no input or no output", "both")
    times = times[:, 0]
    if times[0] < 0 or (np.diff(times) <= 0).any():
        raise element.wrong("times that do not ascend from 0 or later", "ascending times")
    keys, parts = len(times), 3 if interpolation == "CUBICSPLINE" else 1
    if values.size != keys * parts * width:
        raise element.wrong(f"{values.size} output numbers", f"{keys * parts * width} for {keys} times")
    values = values.reshape(keys, parts, width)
    middle = values[:, parts // 2]
    if path == "rotation":
        if not np.linalg.norm(middle, axis=1).all():
            raise element.wrong("a rotation of length 0", "unit quaternions")
        middle = _unit(middle)
    tangents = (values[:, 0], values[:, 2]) if parts == 3 else None
    return Sampler(times, middle, interpolation, tangents, path == "rotation")


# -- nodes -------------------------------------------------------------------------------------------------
class Nodes:
    """The nodes of a document.

    `visible` are those of its main scene, all if it has no scene.

    Raises `SourceError` if a node has two parents, is its own ancestor, or has invalid numbers.
    """

    def __init__(self, document: Document) -> None:
        elements, scenes = document.all("nodes"), document.all("scenes")
        self.count = count = len(elements)
        self._parents = np.full(count, -1, np.int64)
        children = [element.indices("children", "nodes") for element in elements]
        for node, below in enumerate(children):
            for child in below:
                if self._parents[child] >= 0:
                    raise elements[child].wrong("a second parent", "one parent at most")
                self._parents[child] = node
        # by distance from the root; nodes of a cycle are not reached
        self._levels: list[Int64s] = []
        level = np.flatnonzero(self._parents < 0).tolist()
        while level:
            self._levels.append(np.array(level, np.int64))
            level = [child for node in level for child in children[node]]
        cyclic = set(range(count)).difference(*(level.tolist() for level in self._levels))
        if cyclic:
            raise elements[min(cyclic)].wrong("a node that is its own ancestor", "a tree of nodes")
        roots: Iterable[int] = range(count)
        if scenes:
            roots = scenes[document.root.index("scene", "scenes") or 0].indices("nodes", "nodes")
        self.visible = set(roots)
        for level_nodes in self._levels:
            self.visible |= {node for node in level_nodes.tolist() if self._parents[node] in self.visible}
        self._rest = {
            "translation": np.zeros((count, 3)),
            "rotation": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            "scale": np.ones((count, 3)),
        }
        self._matrices: dict[int, Float64s] = {}
        for node, element in enumerate(elements):
            matrix = element.numbers("matrix", 16)
            if matrix is not None:
                self._matrices[node] = np.array(matrix).reshape(4, 4).T  # stored column by column
                if not np.array_equal(self._matrices[node][3], (0, 0, 0, 1)):
                    raise element.wrong("a matrix whose last row is not 0, 0, 0, 1", "an affine one")
                continue
            for key, values in self._rest.items():
                values[node] = element.numbers(key, values.shape[1]) or values[node]
            turn = self._rest["rotation"][node]
            length = float(np.linalg.norm(turn))
            if not (length > 0 and np.isfinite(length)):
                raise element.wrong("a rotation of length 0", "a unit quaternion (x, y, z, w)")
            turn /= length

    def world(self, animation: Animation | None, times_s: Float64s) -> Float64s:
        """Return world matrices, float64 [times, nodes, 4, 4].

        Without an animation they are those of the rest pose.
        """
        shape = (len(times_s), self.count)
        parts = {key: np.tile(rest, (len(times_s), 1, 1)) for key, rest in self._rest.items()}
        for (node, path), sampler in animation.samplers.items() if animation is not None else ():
            if path in parts:
                parts[path][:, node] = sampler.at(times_s)
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


# -- primitives and skins ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Geometry:
    """The triangles of a primitive."""

    element: Element  # its JSON
    vertices: Float64s  # float64 [n, 3]; vertices of triangles
    triangles: Int64s  # int64 [m, 3]
    targets: Float64s  # float64 [t, n, 3]; displacements of each morph target
    used: Int64s  # int64 [n]; indices of the vertices in the accessors
    vertex_count: int  # vertices in the accessors


def _read_geometry(primitive: Element) -> _Geometry | None:
    """Read a primitive; None if it has no triangle (points or lines)."""
    mode = primitive.integer("mode", _TRIANGLES)
    if mode > _FAN:
        raise primitive.wrong(f"mode {mode}", "0 to 6")
    attributes = primitive.get("attributes")
    position_index = attributes.index("POSITION", "accessors") if attributes else None
    if mode < _TRIANGLES or attributes is None or position_index is None:
        return None
    extensions, positions = primitive.get("extensions"), primitive.owner.all("accessors")[position_index]
    has_data = "bufferView" in positions or "sparse" in positions  # otherwise they are zeros
    for name in COMPRESSIONS:
        if extensions is not None and name in extensions and not has_data:
            raise compressed_mesh(Path(primitive.file), name)
    vertices = primitive.owner.array(position_index, "VEC3")
    numbers = primitive.unsigned("indices", "SCALAR", len(vertices))
    corners = np.arange(len(vertices)) if numbers is None else numbers[:, 0]
    if mode == _TRIANGLES and len(corners) % 3:
        raise primitive.wrong(f"{len(corners)} corners", "three for each triangle")
    used, corners = np.unique(corners, return_inverse=True)
    corners = corners.reshape(-1)
    i = np.arange(max(len(corners) - 2, 0))
    if mode == _TRIANGLES:
        triangles = corners.reshape(-1, 3)
    elif mode == _STRIP:  # every second triangle is flipped
        triangles = np.stack([corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]], axis=1)
    else:
        triangles = np.stack([corners[i + 1], corners[i + 2], np.broadcast_to(corners[:1], len(i))], axis=1)
    if not len(triangles):
        return None
    targets = [*primitive.at("targets", []).elements()]
    primitive.owner.charge(len(targets) * len(used), primitive)
    moves = np.zeros((len(targets), len(used), 3))
    for target, move in zip(targets, moves, strict=True):
        values = target.floats("POSITION", "VEC3")
        if values is not None:
            if len(values) != len(vertices):
                raise target.wrong(f"{len(values)} positions", f"one for each of {len(vertices)} vertices")
            move[:] = values[used]
    return _Geometry(primitive, vertices[used], triangles, moves, used, len(vertices))


class _Skin:
    """The joints of a skin and their inverse bind matrices."""

    def __init__(self, element: Element) -> None:
        self.joints = np.array(element.indices("joints", "nodes"), np.int64)
        if not len(self.joints):
            raise element.wrong("no joint", "at least one")
        self._inverse_bind = np.tile(np.eye(4), (len(self.joints), 1, 1))
        columns = element.floats("inverseBindMatrices", "MAT4")
        if columns is not None:
            if len(columns) < len(self.joints):
                found = f"{len(columns)} inverse bind matrices"
                raise element.wrong(found, f"one for each of {len(self.joints)} joints")
            self._inverse_bind = columns[: len(self.joints)].reshape(-1, 4, 4).swapaxes(1, 2)

    def matrices(self, world: Float64s) -> Float64s:
        """Return the motion of a vertex with each joint, float64 [joints, 3, 4].

        `world` are the world matrices, float64 [nodes, 4, 4].
        """
        return np.asarray((world[self.joints] @ self._inverse_bind)[:, :3])


def _joint_weights(geometry: _Geometry, joint_count: int) -> Any:
    """Return the weight of every joint at every vertex, a sparse matrix [vertices, joints] with row sums 1.

    All sets JOINTS_n, WEIGHTS_n are used. A vertex whose weights are all zero moves with its first joint.
    """
    from scipy.sparse import csr_array

    count, used = geometry.vertex_count, geometry.used
    attributes = geometry.element.get("attributes") or geometry.element
    sets: list[tuple[Int64s, Float64s]] = []
    while not sets or f"JOINTS_{len(sets)}" in attributes:
        n = len(sets)
        attributes.owner.charge(count, attributes)
        joints = attributes.unsigned(f"JOINTS_{n}", "VEC4", joint_count)
        set_weights = attributes.floats(f"WEIGHTS_{n}", "VEC4")
        if joints is None or set_weights is None:
            name = f"JOINTS_{n}" if joints is None else f"WEIGHTS_{n}"
            raise attributes.wrong(f"no {name}", "both, as the mesh has a skin", "Export it again.")
        if len(joints) != count or len(set_weights) != count:
            found = f"{len(joints)} JOINTS_{n} and {len(set_weights)} WEIGHTS_{n}"
            raise attributes.wrong(found, f"one for each of {count} vertices")
        sets.append((joints[used], set_weights[used]))
    columns, weights = (np.concatenate(each, axis=1) for each in zip(*sets, strict=True))
    if (weights < 0).any():
        raise attributes.wrong("a weight below 0", "weights from 0 to 1")
    weights[~weights.any(axis=1), 0] = 1.0
    weights /= weights.sum(axis=1, keepdims=True)
    starts = np.arange(len(used) + 1) * columns.shape[1]
    matrix = csr_array((weights.reshape(-1), columns.reshape(-1), starts), shape=(len(used), joint_count))
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    return matrix


# -- the model ---------------------------------------------------------------------------------------------
class Poses(NamedTuple):
    """World matrices of the nodes and weights of the morph targets at some times."""

    world: Float64s  # float64 [times, nodes, 4, 4]
    weights: Mapping[int, Float64s]  # from node to float64 [times, targets]


@dataclass(frozen=True)
class _Piece:
    """A primitive of a node."""

    node: int
    geometry: _Geometry
    skin: int | None
    joint_weights: Any  # a sparse matrix [vertices, joints], for a skinned piece


class Model:
    """The triangles of a glTF scene, and their poses.

    `triangles` int64 [m, 3] are vertex numbers over all pieces.

    `notes` name the extensions that are not read, and other scenes.

    Raises `SourceError` if the document is invalid, or has no triangle.
    """

    def __init__(self, path: Path) -> None:
        self._document = document = Document(path)
        self._nodes = Nodes(document)
        self.node_count = self._nodes.count
        meshes = document.all("meshes")
        self._skin = cache(lambda number: _Skin(document.all("skins")[number]))
        self._targets = [0] * self.node_count
        self._rest_weights: dict[int, Float64s] = {}
        self._pieces: list[_Piece] = []
        # an animation without a name is named by its number
        self.animation_names = [e.word("name") or str(i) for i, e in enumerate(document.all("animations"))]
        geometries = cache(
            lambda mesh: [g for g in map(_read_geometry, meshes[mesh].at("primitives", []).elements()) if g]
        )
        joint_weights = cache(
            lambda mesh, n, skin: _joint_weights(geometries(mesh)[n], len(self._skin(skin).joints))
        )
        total = 0
        for node, element in enumerate(document.all("nodes")):
            mesh, skin = element.index("mesh", "meshes"), element.index("skin", "skins")
            if mesh is None:
                continue
            counts = {len(geometry.targets) for geometry in geometries(mesh)}
            if len(counts) > 1:
                found = f"primitives with {min(counts)} and with {max(counts)} targets"
                raise meshes[mesh].wrong(found, "the same number")
            count = self._targets[node] = max(counts, default=0)
            if count:  # rest weights: those of the node, or of its mesh, or zeros
                rest_weights = element.numbers("weights", count) or meshes[mesh].numbers("weights", count)
                self._rest_weights[node] = np.array([rest_weights or [0.0] * count])
            for number, geometry in enumerate(geometries(mesh) if node in self._nodes.visible else ()):
                total += len(geometry.triangles)
                if total > max(_MAX_TRIANGLES, document.size_bytes):
                    raise element.wrong(
                        "too many triangles", f"at most {_MAX_TRIANGLES}", "Simplify the mesh."
                    )
                weights = None if skin is None else joint_weights(mesh, number, skin)
                document.charge(geometry.targets.size // 3 + (0 if weights is None else weights.nnz), element)
                self._pieces.append(_Piece(node, geometry, skin, weights))
        if not self._pieces:
            raise document.root.wrong("no triangle", "a mesh of triangles", "Export it with its faces.")
        self._is_mirrored_at_rest = self._is_mirrored(self._nodes.world(None, np.zeros(1))[0])
        first, faces = 0, []
        for piece, is_mirrored in zip(self._pieces, self._is_mirrored_at_rest, strict=True):
            piece_faces = piece.geometry.triangles + first
            faces.append(piece_faces[:, ::-1] if is_mirrored else piece_faces)
            first += len(piece.geometry.vertices)
        self.triangles = np.concatenate(faces)
        used = [str(name)[:60] for name in document.root.at("extensionsUsed", []).items()]
        unread = [name for name in used if not name.startswith((*HARMLESS, *COMPRESSIONS))]
        notes = [f"Not read, and left out: {', '.join(map(repr, unread[:_MAX_NOTED]))}"] if unread else []
        number, count = document.root.index("scene", "scenes") or 0, len(document.all("scenes"))
        if count > 1:
            notes.append(f"Of {count} scenes in the file number {number} is read.")
        self.notes = tuple(notes)

    def _is_mirrored(self, world: Float64s) -> Bools:
        """Return whether the winding of each piece is reversed by its node or joints, bool [pieces].

        Section 3.7.4: it is if the determinant of the transform is negative. `world` float64 [nodes, 4, 4].
        """
        nodes = [piece.node for piece in self._pieces]
        is_mirrored = np.asarray(np.linalg.det(world[nodes, :3, :3]) < 0)
        for number, piece in enumerate(self._pieces):
            if piece.skin is not None:
                motions = self._skin(piece.skin).matrices(world)
                is_mirrored[number] = np.linalg.det(motions[..., :3]).sum() < 0
        return is_mirrored

    def turned_vertices(self, poses: Poses, at: int) -> Bools | None:
        """Return the vertices whose triangles face the other way than in `triangles`, bool [n].

        They are those of pieces that an animated scale mirrors. None if there are none.
        """
        is_turned = self._is_mirrored(poses.world[at]) != self._is_mirrored_at_rest
        if not is_turned.any():
            return None
        counts = [len(piece.geometry.vertices) for piece in self._pieces]
        return np.asarray(np.repeat(is_turned, counts))

    @property
    def is_animated(self) -> bool:
        """True if the document has an animation, a skin or morph targets."""
        return bool(self.animation_names or self._document.all("skins") or any(self._targets))

    def animation(self, index: int) -> Animation:
        """Read one of the animations.

        Raises `SourceError` if a channel, a sampler or its data are invalid.
        """
        element, nodes = self._document.all("animations")[index], self._document.all("nodes")
        entries = [*element.at("samplers", []).elements()]
        samplers: dict[tuple[int, str], Sampler] = {}
        for entry in element.at("channels", []).elements():
            target = entry.get("target")
            if target is None:
                raise entry.wrong("no target", "one")
            node, path = target.index("node", "nodes"), target.word("path")
            if node is None or path not in (*_WIDTHS, "weights"):
                continue  # target of an extension: the specification says to ignore it
            number = entry.index("sampler", len(entries))
            if number is None:
                raise entry.wrong("no sampler", "the number of one")
            if (node, path) in samplers:
                raise target.wrong(
                    f"a second {path} for node {node}", "one channel for each property of a node"
                )
            if path != "weights" and "matrix" in nodes[node]:
                raise target.wrong(f"a {path} for node {node}, which has a matrix", "a node without a matrix")
            width = self._targets[node] if path == "weights" else _WIDTHS[path]
            if width == 0:
                raise target.wrong(f"weights for node {node}", "a node whose mesh has morph targets")
            samplers[node, path] = _sampler(entries[number], path, width)
        duration = max((float(sampler.times_s[-1]) for sampler in samplers.values()), default=0.0)
        return Animation(duration, samplers)

    def poses(self, animation: Animation | None, times_s: Float64s) -> Poses:
        """Return the poses at times in seconds; without an animation, the rest pose."""
        count = len(times_s)
        weights = {n: np.broadcast_to(rest, (count, rest.shape[1])) for n, rest in self._rest_weights.items()}
        for (node, path), sampler in animation.samplers.items() if animation is not None else ():
            if path == "weights":
                weights[node] = sampler.at(times_s)
        return Poses(self._nodes.world(animation, times_s), weights)

    def at_rest(self) -> Float64s:
        """Return the vertices in the rest pose, float64 [n, 3], in the units of the file."""
        return self.vertices(self.poses(None, np.zeros(1)), 0)

    def vertices(self, poses: Poses, at: int) -> Float64s:
        """Return the vertices at one time of `poses`, float64 [n, 3].

        They are in world coordinates and in the units of the file.
        """
        world = poses.world[at]
        skins = {piece.skin for piece in self._pieces if piece.skin is not None}
        joints = {number: self._skin(number).matrices(world).reshape(-1, 12) for number in skins}
        parts = []
        for piece in self._pieces:
            vertices, weights = piece.geometry.vertices, poses.weights.get(piece.node)
            target_weights = np.zeros(0) if weights is None else weights[at]
            for number in np.flatnonzero(target_weights):
                vertices = vertices + target_weights[number] * piece.geometry.targets[number]
            matrices = world[piece.node, :3]
            if piece.skin is not None:
                matrices = (piece.joint_weights @ joints[piece.skin]).reshape(-1, 3, 4)
            # the same operations for every vertex, so that equal ones stay bit-identical
            moved = matrices[..., 0] * vertices[:, :1] + matrices[..., 1] * vertices[:, 1:2]
            moved += matrices[..., 2] * vertices[:, 2:]
            moved += matrices[..., 3]
            parts.append(moved)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)
