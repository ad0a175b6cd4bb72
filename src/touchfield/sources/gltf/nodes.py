"""The node tree, and what moves it: from translations, rotations, scales or matrices to every node's place in time.

Source: Khronos, glTF 2.0 specification (2021), section 3.5: a local matrix is T R S, the world matrix of a node that
of its parent times its own; each node has one parent at most. Section 3.11 and appendix C: samplers are LINEAR
(spherical for rotations), STEP or CUBICSPLINE (Hermite, its tangents in units of value per second); before its first
and after its last time a sampler holds its value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.arrays import Float64s, Int64s
from touchfield.medium.pose_track import rotation_matrices, slerp
from touchfield.sources.gltf.document import Document, Element

_WIDTHS: Final = {"translation": 3, "rotation": 4, "scale": 3}
_INTERPOLATIONS: Final = ("LINEAR", "STEP", "CUBICSPLINE")


class Nodes:
    """The nodes of a document; `shown` are those of the scene that is shown, all where the document has no scene.

    Raises `SourceError` if a node has two parents, is its own ancestor, or has numbers at fault.
    """

    def __init__(self, document: Document) -> None:
        self._elements = document.all("nodes")
        count = len(self._elements)
        self._parents = np.full(count, -1, np.int64)
        children = [element.indices("children", "nodes") for element in self._elements]
        for node, below in enumerate(children):
            for child in below:
                if self._parents[child] >= 0:
                    raise self._elements[child].fault("a second parent", "one parent at most")
                self._parents[child] = node
        self._levels = self._by_level(children)
        self.shown = self._shown(document, children)
        self._rest = {
            "translation": np.zeros((count, 3)),
            "rotation": np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
            "scale": np.ones((count, 3)),
        }
        self._matrices: dict[int, Float64s] = {}
        for node, element in enumerate(self._elements):
            self._take(node, element)

    def __len__(self) -> int:
        return len(self._elements)

    def _by_level(self, children: list[list[int]]) -> list[Int64s]:
        """The nodes by their distance from the root; those of a cycle are reached from none."""
        levels, level = [], [node for node in range(len(self)) if self._parents[node] < 0]
        while level:
            levels.append(np.array(level, np.int64))
            level = [child for node in level for child in children[node]]
        lost = set(range(len(self))).difference(*(level.tolist() for level in levels))
        if lost:
            raise self._elements[min(lost)].fault("a node that is its own ancestor", "a tree of nodes")
        return levels

    def _shown(self, document: Document, children: list[list[int]]) -> frozenset[int]:
        scenes = document.all("scenes")
        if not scenes:
            return frozenset(range(len(self)))
        stack = scenes[document.root.index("scene", "scenes") or 0].indices("nodes", "nodes")
        shown: set[int] = set()
        while stack:
            node = stack.pop()
            if node not in shown:
                shown.add(node)
                stack.extend(children[node])
        return frozenset(shown)

    def _take(self, node: int, element: Element) -> None:
        matrix = element.numbers("matrix", 16)
        if matrix is not None:
            self._matrices[node] = np.array(matrix).reshape(4, 4).T  # stored column by column
            if not np.array_equal(self._matrices[node][3], (0, 0, 0, 1)):
                raise element.fault("a matrix whose last row is not 0, 0, 0, 1", "an affine one")
            return
        for key, values in self._rest.items():
            given = element.numbers(key, values.shape[1])
            if given is not None:
                values[node] = given
        turn = self._rest["rotation"][node]
        length = float(np.linalg.norm(turn))
        if not (length > 0 and np.isfinite(length)):
            raise element.fault("a rotation of length 0", "a unit quaternion (x, y, z, w)")
        turn /= length

    def world(self, animation: Animation | None, times_s: Float64s) -> Float64s:
        """World matrices, float64 [times, nodes, 4, 4], at times in seconds; without an animation, at rest."""
        shape = (len(times_s), len(self))
        parts = {key: np.broadcast_to(rest, (*shape, rest.shape[1])) for key, rest in self._rest.items()}
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


# -- animations -----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Sampler:
    """A value over time."""

    times_s: Float64s  # float64 [k]; ascending
    values: Float64s  # float64 [k, w]
    interpolation: str = "LINEAR"  # "LINEAR", "STEP" or "CUBICSPLINE"
    # (float64 [k, w], float64 [k, w]) or None; of CUBICSPLINE: where a key is reached, and where it is left; value
    # per second
    tangents: tuple[Float64s, Float64s] | None = None
    is_rotation: bool = False  # whether the values are unit quaternions (x, y, z, w)

    def at(self, times_s: Float64s) -> Float64s:
        """The values at times in seconds, float64 [n, w]."""
        last = len(self.times_s) - 1
        before = np.clip(np.searchsorted(self.times_s, times_s, side="right") - 1, 0, last)
        after = np.minimum(before + 1, last)
        span = self.times_s[after] - self.times_s[before]
        share = np.clip((times_s - self.times_s[before]) / np.where(span > 0, span, 1.0), 0.0, 1.0)
        a, b = self.values[before], self.values[after]
        if self.interpolation == "STEP":
            return a
        if self.tangents is not None:
            reach, leave = self.tangents[0][after], self.tangents[1][before]
            share = share[:, None]
            s2, s3 = share * share, share * share * share
            mixed = (2 * s3 - 3 * s2 + 1) * a + (3 * s2 - 2 * s3) * b
            mixed += span[:, None] * ((s3 - 2 * s2 + share) * leave + (s3 - s2) * reach)
            return _unit(mixed) if self.is_rotation else mixed
        return slerp(a, b, share) if self.is_rotation else a + share[:, None] * (b - a)


def _unit(quaternions: Float64s) -> Float64s:
    """Of length 1; no rotation where there is no length."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    turned: Float64s = np.where(lengths > 0, quaternions / np.where(lengths > 0, lengths, 1.0), (0.0, 0.0, 0.0, 1.0))
    return turned


@dataclass(frozen=True)
class Channel:
    """A sampler and its aim: `path` is translation, rotation, scale or weights of the node `node`."""

    node: int
    path: str
    sampler: Sampler


@dataclass(frozen=True)
class Animation:
    """One animation of a document."""

    name: str
    duration_s: float  # the last time of any of its channels; it begins at 0
    channels: tuple[Channel, ...]


def animation_names(document: Document) -> list[str]:
    """The names of all animations; one without a name goes by its number."""
    return [element.text("name") or str(i) for i, element in enumerate(document.all("animations"))]


def read_animation(document: Document, index: int, target_counts: Sequence[int]) -> Animation:
    """Read one animation.

    `target_counts` sequence of int: for each node, how many morph targets its mesh has.

    Raises `SourceError` if a channel, sampler or its data are at fault.
    """
    element = document.all("animations")[index]
    samplers = element.children("samplers")
    channels: dict[tuple[int, str], Channel] = {}
    nodes = document.all("nodes")
    for entry in element.children("channels"):
        target = entry.child("target")
        if target is None:
            raise entry.fault("no target", "one")
        node, path = target.index("node", "nodes"), target.text("path")
        if node is None or path not in (*_WIDTHS, "weights"):
            continue  # of an extension: the specification has it left out
        number = entry.index("sampler", len(samplers))
        if number is None:
            raise entry.fault("no sampler", "the number of one")
        if (node, path) in channels:
            raise target.fault(f"a second {path} for node {node}", "one channel for each property of a node")
        if path != "weights" and "matrix" in nodes[node]:
            raise target.fault(f"a {path} for node {node}, which has a matrix", "a node without a matrix")
        width = target_counts[node] if path == "weights" else _WIDTHS[path]
        if width == 0:
            raise target.fault(f"weights for node {node}", "a node whose mesh has morph targets")
        channels[node, path] = Channel(node, path, _sampler(samplers[number], path, width))
    duration = max((float(channel.sampler.times_s[-1]) for channel in channels.values()), default=0.0)
    return Animation(animation_names(document)[index], duration, tuple(channels.values()))


def _sampler(element: Element, path: str, width: int) -> Sampler:
    interpolation = element.text("interpolation") or "LINEAR"
    if interpolation not in _INTERPOLATIONS:
        raise element.fault(f"interpolation {interpolation[:20]!r}", ", ".join(_INTERPOLATIONS))
    times = element.floats("input", "SCALAR")
    values = element.floats("output", "SCALAR" if path == "weights" else f"VEC{width}")
    if times is None or values is None:
        raise element.fault("no input or no output", "both")
    times = times[:, 0]
    if times[0] < 0 or (np.diff(times) <= 0).any():
        raise element.fault("times that do not ascend from 0 or later", "ascending times")
    keys, parts = len(times), 3 if interpolation == "CUBICSPLINE" else 1
    if values.size != keys * parts * width:
        raise element.fault(f"{values.size} output numbers", f"{keys * parts * width} for {keys} times")
    values = values.reshape(keys, parts, width)
    middle = values[:, parts // 2]
    if path == "rotation":
        if not np.linalg.norm(middle, axis=1).all():
            raise element.fault("a rotation of length 0", "unit quaternions")
        middle = _unit(middle)
    tangents = (values[:, 0], values[:, 2]) if parts == 3 else None
    return Sampler(times, middle, interpolation, tangents, path == "rotation")
