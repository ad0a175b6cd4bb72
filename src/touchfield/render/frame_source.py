"""Frames of a medium or of a scene as they are written into the block."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.medium import HapticMedium, HapticScene
from touchfield.medium.cells import CellPool
from touchfield.render.frame_block import FramePart, field_words, frame_words, write_field, write_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid
    from touchfield.render.memory import Memory

__all__ = ["FrameSource", "Prepared", "frame_source"]

_WORDS_PER_BRICK: Final = 1200
"""More than a brick takes in the block: cells, what is held, and its share of the hash table."""
_WORDS_BESIDE: Final = 1024


class Prepared:
    """A frame that is decoded: how many words it takes, and how it is written."""

    def __init__(self, pools: list[CellPool], parts: int, write: Callable[[Memory, int, list[int]], None]) -> None:
        self._pools, self._write = pools, write
        self._sizes = [field_words(pool) for pool in pools]
        self._frame = frame_words(parts)
        self.words = sum(self._sizes) + self._frame

    def write(self, memory: Memory, at: int) -> int:
        """Write it at a word; the place of the frame, behind its own fields."""
        places = []
        for pool, words in zip(self._pools, self._sizes):
            write_field(memory, at, pool)
            places.append(at)
            at += words
        self._write(memory, at, places)
        return at


class FrameSource(ABC):
    """Frames by their number.

    Attributes
    ----------
    frame_count : int
    rate_hz : float
    friction, damping_n_s_per_m : float
        Of the medium, for the receiver.
    axes : str
    """

    frame_count: int
    rate_hz: float
    friction: float
    damping_n_s_per_m: float
    axes: str

    @property
    def shared_words(self) -> int:
        """What all frames share takes so many words."""
        return 0

    @property
    @abstractmethod
    def most_words(self) -> int:
        """No frame takes more words than so many."""

    def write_shared(self, memory: Memory, at: int) -> None:
        """Write what all frames share."""
        return

    @abstractmethod
    def prepare(self, frame: int) -> Prepared:
        """Decode a frame."""


def frame_source(medium: HapticMedium | HapticScene) -> FrameSource:
    """The frames of a medium or a scene."""
    return _SceneSource(medium) if isinstance(medium, HapticScene) else _VoxelSource(medium)


def _most_words(grid: Grid) -> int:
    """Of a field on this lattice: its cells reach a brick before its first."""
    return _WORDS_BESIDE + _WORDS_PER_BRICK * math.prod(n + 1 for n in grid.brick_shape)


class _VoxelSource(FrameSource):
    def __init__(self, medium: HapticMedium) -> None:
        self._medium = medium
        self.frame_count, self.rate_hz, self.axes = medium.frame_count, medium.rate_hz, medium.axes
        self.friction, self.damping_n_s_per_m = medium.friction, medium.damping_n_s_per_m

    @property
    def most_words(self) -> int:
        fields = 1 if self._medium.vibration is None else 2
        return fields * _most_words(self._medium.grid) + frame_words(1)

    def prepare(self, frame: int) -> Prepared:
        pools = [CellPool.of(self._medium[frame])]
        band = self._medium.vibration
        if band is not None:
            pools.append(CellPool.of(band[frame].as_field()))

        def write(memory: Memory, at: int, places: list[int]) -> None:
            vibration_at = places[1] if len(places) > 1 else 0
            write_frame(memory, at, [FramePart.voxels(places[0])], math.inf, vibration_at)

        return Prepared(pools, 1, write)


class _SceneSource(FrameSource):
    def __init__(self, scene: HapticScene) -> None:
        self._scene = scene
        self.frame_count, self.rate_hz, self.axes = scene.frame_count, scene.rate_hz, scene.axes
        self.friction, self.damping_n_s_per_m = scene.friction, scene.damping_n_s_per_m
        self._rigid = {n: CellPool.of(one.field(0)) for n, one in enumerate(scene.objects) if one.is_rigid}
        self._places: dict[int, int] = {}
        unturned = np.array([1.0, 0.0, 0.0, 0.0])
        self._is_unturned = [bool((one.track.quaternions == unturned).all()) for one in scene.objects]
        self._motions = [self._motion(n) for n in range(len(scene.objects))]

    def _motion(self, n: int) -> NDArray[np.float64]:
        """What the motion of an object adds to its force, float64 [frames, 6], as `medium.placed`."""
        scene = self._scene
        motion = np.zeros((scene.frame_count, 6))
        if scene.surface_damping_n_s_per_m:
            with np.errstate(over="ignore"):  # the kernels cut what is beyond all bounds
                moved = np.concatenate(scene.objects[n].track.velocities(scene.rate_hz), axis=1)
                motion = moved * scene.surface_damping_n_s_per_m
        return motion

    @property
    def shared_words(self) -> int:
        return sum(map(field_words, self._rigid.values()))

    @property
    def most_words(self) -> int:
        soft = (one.medium.grid for one in self._scene.objects if not one.is_rigid)
        return sum(map(_most_words, soft)) + frame_words(len(self._scene.objects))

    def write_shared(self, memory: Memory, at: int) -> None:
        for n, pool in self._rigid.items():
            write_field(memory, at, pool)
            self._places[n] = at
            at += field_words(pool)

    def prepare(self, frame: int) -> Prepared:
        objects = self._scene.objects
        soft = [n for n, one in enumerate(objects) if not one.is_rigid]
        pools = [CellPool.of(objects[n].field(frame)) for n in soft]

        def write(memory: Memory, at: int, places: list[int]) -> None:
            where = {**self._places, **dict(zip(soft, places))}
            parts = [
                FramePart(
                    where[n],
                    one.track.quaternions[frame],
                    one.track.positions_m[frame],
                    self._motions[n][frame],
                    self._is_unturned[n],
                )
                for n, one in enumerate(objects)
            ]
            write_frame(memory, at, parts, self._scene.force_max_n)

        return Prepared(pools, len(objects), write)
