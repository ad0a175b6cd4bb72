"""Animations: samplers over time for the nodes' translations, rotations, scales and morph weights.

Source: Khronos, glTF 2.0 specification (2021), section 3.11 and appendix C: LINEAR (spherical for rotations), STEP
and CUBICSPLINE (Hermite, its tangents in units of value per second). Before its first and after its last time a
sampler holds its value.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.medium.rotations import slerp

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from touchfield.sources.gltf.accessors import Accessors
    from touchfield.sources.gltf.document import Document
    from touchfield.sources.gltf.elements import Element

    Floats = NDArray[np.float64]

__all__ = ["Animation", "Channel", "Sampler", "animation_names", "read_animation"]

_WIDTHS: Final = {"translation": 3, "rotation": 4, "scale": 3}
_INTERPOLATIONS: Final = ("LINEAR", "STEP", "CUBICSPLINE")


@dataclass(frozen=True)
class Sampler:
    """A value over time.

    Parameters
    ----------
    times_s : float64 [k]; Ascending.
    values : float64 [k, w]
    interpolation : str; "LINEAR", "STEP" or "CUBICSPLINE".
    tangents : (float64 [k, w], float64 [k, w]) or None; Of CUBICSPLINE: where a key is reached, and where it is
        left; value per second.
    is_rotation : bool; Whether the values are unit quaternions (x, y, z, w).
    """

    times_s: Floats
    values: Floats
    interpolation: str = "LINEAR"
    tangents: tuple[Floats, Floats] | None = None
    is_rotation: bool = False

    def at(self, times_s: Floats) -> Floats:
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


def _unit(quaternions: Floats) -> Floats:
    """Of length 1; no rotation where there is no length."""
    lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
    turned: Floats = np.where(lengths > 0, quaternions / np.where(lengths > 0, lengths, 1.0), (0.0, 0.0, 0.0, 1.0))
    return turned


@dataclass(frozen=True)
class Channel:
    """What a sampler moves: `path` is translation, rotation, scale or weights of the node `node`."""

    node: int
    path: str
    sampler: Sampler


@dataclass(frozen=True)
class Animation:
    """One animation of a document.

    Parameters
    ----------
    duration_s : float; The last time of any of its channels; it begins at 0.
    """

    name: str
    duration_s: float
    channels: tuple[Channel, ...]


def animation_names(document: Document) -> list[str]:
    """The names of all animations; one without a name goes by its number."""
    return [element.text("name") or str(i) for i, element in enumerate(document.all("animations"))]


def read_animation(document: Document, accessors: Accessors, index: int, target_counts: Sequence[int]) -> Animation:
    """Read one animation.

    Parameters
    ----------
    target_counts : sequence of int; For each node, how many morph targets its mesh has.

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
        node, path = target.index("node", len(nodes)), target.text("path")
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
        channels[node, path] = Channel(node, path, _sampler(samplers[number], accessors, path, width))
    duration = max((float(channel.sampler.times_s[-1]) for channel in channels.values()), default=0.0)
    return Animation(animation_names(document)[index], duration, tuple(channels.values()))


def _sampler(element: Element, accessors: Accessors, path: str, width: int) -> Sampler:
    interpolation = element.text("interpolation") or "LINEAR"
    if interpolation not in _INTERPOLATIONS:
        raise element.fault(f"interpolation {interpolation[:20]!r}", ", ".join(_INTERPOLATIONS))
    given, put = element.index("input", len(accessors)), element.index("output", len(accessors))
    if given is None or put is None:
        raise element.fault("no input or no output", "both")
    times = accessors.floats(given, "SCALAR")[:, 0]
    if times[0] < 0 or (np.diff(times) <= 0).any():
        raise element.fault("times that do not ascend from 0 or later", "ascending times")
    values = accessors.floats(put, "SCALAR" if path == "weights" else f"VEC{width}")
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
