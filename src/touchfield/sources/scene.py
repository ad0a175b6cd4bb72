"""Scenes, as every source gives one: generators of force fields, evaluated wherever it is asked.

A scene keeps what made it (depth maps, triangles, a formula) and is never voxelised as a whole: the device
filter asks it for the fields of the lattice that it needs (design: "keep the generator").
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float64s, Int32s
from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK, ForceField, Grid, PoseTrack
from touchfield.medium.field import brick_keys, bricks_of, frozen
from touchfield.medium.grid import CORNERS
from touchfield.sources.laws import ForceProfile

CAMERA_AXES: Final = "x right, y down, z forward"
UP_Y_AXES: Final = "x right, y up, z towards the viewer"
UP_Z_AXES: Final = "x east, y north, z up"

DEPTH_UNIT: Final = ("--depth-scale", 0.02, 200.0)
"""The option that says the unit of depth, and usual sizes of its scenes, metres (`Scene.unit`)."""


def bricks_that(may_hold: Callable[[Int32s, int], Bools], grid: Grid) -> Int32s:
    """Bricks that may hold a force, int32 [n, 3] ascending: blocks of bricks, halved where one may.

    ``may_hold(blocks, size)``, bool [n]: whether there may be a force in blocks, int32 [n, 3] in units of
    their `size`, bricks along each axis.
    """
    size = 1 << max(grid.brick_shape).bit_length()
    blocks = np.zeros((1, 3), np.int32)
    while True:
        blocks = blocks[may_hold(blocks, size)]
        if size == 1:
            return bricks_of(grid, np.sort(brick_keys(grid, blocks)))
        size //= 2
        blocks = np.repeat(2 * blocks, 8, axis=0) + np.tile(CORNERS, (len(blocks), 1))
        x, y, z = (blocks[:, axis] < -(-count // size) for axis, count in enumerate(grid.brick_shape))
        blocks = blocks[x & y & z]  # a column at a time: a row of three costs NumPy forty times as much


def bricks_near(may_hold: Callable[[Float64s, float], Bools], grid: Grid) -> Int32s:
    """The same; ``may_hold(centres, radius_m)`` tells of a force so near to points, float64 [n, 3]."""

    def in_blocks(blocks: Int32s, size: int) -> Bools:
        half = (size * BRICK - 1) / 2
        radius_m = float(np.linalg.norm(np.asarray(grid.spacing_m) * half))
        return may_hold(grid.to_m(blocks.astype(np.int64) * (size * BRICK) + half), radius_m)

    return bricks_that(in_blocks, grid)


class Scene(ABC):
    """A source of force fields over time, in scene metres.

    Attributes
    ----------
    rate_hz : float; Frames a second (any positive number for one frame).
    axes : str; One of `CAMERA_AXES`, `UP_Y_AXES`, `UP_Z_AXES`, or any other wording.
    notes : tuple of str; What the user should be told about how the source was read.
    has_law : bool; Whether a force law makes the forces; False where they are the source's own.
    is_solid : bool; Whether everything behind the surface is solid unless a thickness is asked for.
    finest_m : (float, float, float) or None; Between samples closer than this the scene has nothing to tell;
        None for a continuous one.
    box_wording : str; What `bounds_m` is the box of, in a note about the workspace that it fills.
    unit : (str, float, float) or None; The option that says the unit, and the bounds of sizes in metres that
        are usual; None where any size is.
    tags : tuple of str; Media tags of the paper's figure 1: "direct", or "symbolic" where the forces stand
        for something else.
    exaggeration : float; Factor on the heights of a height map, in which its z is told.
    is_captured : bool; Frames are taken as they are asked for (`touchfield.sources.depth.capture`).
    has_gpu : bool; Forces are computed on a GPU where one is asked for (`touchfield.compute.cuda.computing`).
    report : callable; ``report(done, total)`` is called while a scene prepares itself for the first field;
        set by who wants to know.
    """

    frame_count: int = 1
    rate_hz: float = 30.0
    axes: str = UP_Y_AXES
    notes: tuple[str, ...] = ()
    has_law: bool = True
    is_solid: bool = False
    exaggeration: float = 1.0
    finest_m: tuple[float, float, float] | None = None
    box_wording: str = "the surface"
    unit: tuple[str, float, float] | None = None
    tags: tuple[str, ...] = ("direct",)
    is_captured: bool = False
    has_gpu: bool = False
    report: Callable[[int, int], None] = staticmethod(lambda done, total: None)

    @abstractmethod
    def bounds_m(self) -> Float64s:
        """The box of the surface over all frames, metres, float64 [2, 3]: low and high corner."""

    def bounds_between_m(self, start: int, stop: int) -> Float64s:
        """The box over frames start to stop - 1, as `bounds_m` has it over all; by default that one."""
        return self.bounds_m()

    @abstractmethod
    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """The force field of one frame, sampled (not averaged) at the points of `grid`.

        `grid` and the distances of `profile` are in scene metres.
        """

    def bodies(self) -> tuple[Body, ...]:
        """The objects of the scene, for the object representation; by default the whole scene is one."""
        return (Body("scene", self, PoseTrack.still(self.frame_count)),)

    def take(self, start: int, stop: int) -> None:  # noqa: B027  (most scenes have nothing to prepare)
        """Only frames start to stop - 1 will be asked for: what is made of many frames is made of these."""

    def learnt(self) -> tuple[str, ...]:
        """Notes that are known only once fields have been made; by default none."""
        return ()

    def moved(self, rotation: Float64s, shift_m: Float64s) -> Scene:
        """This scene after x -> R x + t, a rigid motion; where it cannot be turned, `InvalidArgument`.

        `rotation` float64 [3, 3]; `shift_m` float64 [3].
        """
        raise InvalidArgument(
            type(self).__name__, "a rigid motion asked of it", "a mesh or shapes with a formula"
        )


class MovingScene(Scene):
    """A scene whose surface is another one in each frame; the latest box that was asked for is kept."""

    _box: tuple[tuple[int, int], Float64s] | None = None

    @abstractmethod
    def _box_m(self, start: int, stop: int) -> Float64s:
        """The box over frames start to stop - 1, float64 [2, 3]; `bounds_between_m` keeps it."""

    def bounds_m(self) -> Float64s:
        """The box of the surface over all frames, metres, float64 [2, 3], read-only."""
        return self.bounds_between_m(0, self.frame_count)

    def bounds_between_m(self, start: int, stop: int) -> Float64s:
        """The box over frames start to stop - 1, as `bounds_m` has it over all."""
        if self._box is None or self._box[0] != (start, stop):
            self._box = (start, stop), frozen(self._box_m(start, stop))
        return self._box[1]


def size_note(extent_m: NDArray[np.floating[Any]], unit_m: float | None, when: str = "") -> str:
    """Sides of a mesh, metres [3], in the unit that was asked for, or in metres where none was."""
    extent = " x ".join(f"{side:.4g}" for side in extent_m)
    if unit_m is not None:
        return f"One unit is {unit_m:g} m: {extent} m{when}."
    return f"Coordinates taken as metres: {extent} m{when}; say --unit-m if they are not."


@dataclass(frozen=True)
class Body:
    """An object of a scene: what it is in its own frame, and where that frame lies.

    Parameters
    ----------
    scene : Scene; In the body's frame, scene metres; one frame for a rigid body, or as many as the track has.
    track : PoseTrack; Scene from body.
    """

    name: str
    scene: Scene
    track: PoseTrack

    @property
    def is_rigid(self) -> bool:
        """True if its shape is the same in all frames."""
        return self.scene.frame_count == 1
