"""`Scene`: the base class of all sources. A scene computes its force field on any lattice and at any of its
frames.

A scene keeps its geometry (depth maps, triangles, a formula) and is never voxelised as a whole: the device
filter requests the field on the lattice that it needs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float64s, Int32s
from touchfield.compute.threads import Progress, silent
from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK, ForceField, Grid, HapticMedium, PoseTrack
from touchfield.medium.field import brick_keys, bricks_of, frozen
from touchfield.medium.grid import CORNERS
from touchfield.medium.updates import FieldUpdate
from touchfield.sources.laws import ForceProfile
from touchfield.sources.thin_walls import MinThickness, ThinWall

CAMERA_AXES: Final = "x right, y down, z forward"
UP_Y_AXES: Final = "x right, y up, z towards the viewer"
UP_Z_AXES: Final = "x east, y north, z up"

DEPTH_UNIT: Final = ("--depth-scale", 0.02, 200.0)
"""Option that gives the unit of depth, and the usual range of scene sizes, metres (`Scene.unit`)."""


def find_bricks_by_block(may_hold: Callable[[Int32s, int], Bools], grid: Grid) -> Int32s:
    """Find bricks that may have a force, by halving blocks of bricks.

    The bricks are int32 [n, 3], ascending.

    ``may_hold(blocks, size)`` returns bool [n]: whether each block may hold a force. `blocks` int32 [n, 3]
    are positions in units of `size`, the number of bricks along each edge of a block.
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
        blocks = blocks[x & y & z]  # one column at a time: rows of three are 40 times slower in NumPy


def find_bricks_by_sphere(may_hold: Callable[[Float64s, float], Bools], grid: Grid) -> Int32s:
    """Find bricks that may have a force, by a test of spheres.

    The bricks are int32 [n, 3], ascending.

    ``may_hold(centres, radius_m)`` returns bool [n]: whether a force may lie within `radius_m` of each of the
    points float64 [n, 3].
    """

    def in_blocks(blocks: Int32s, size: int) -> Bools:
        half = (size * BRICK - 1) / 2
        radius_m = float(np.linalg.norm(np.asarray(grid.spacing_m) * half))
        return may_hold(grid.to_m(blocks.astype(np.int64) * (size * BRICK) + half), radius_m)

    return find_bricks_by_block(in_blocks, grid)


class Scene(ABC):
    """A source of force fields over time, in scene metres.

    Attributes
    ----------
    rate_hz : float; Frames a second (any positive number for one frame).
    axes : str; One of `CAMERA_AXES`, `UP_Y_AXES`, `UP_Z_AXES`, or any other text.
    notes : tuple of str; Messages for the user about how the source was read.
    has_law : bool; Whether a force law computes the forces; False if the source stores them.
    is_solid : bool; Whether everything behind the surface is solid unless a thickness is given.
    finest_m : (float, float, float) or None; Spacing below which the scene has no further detail; None for a
        continuous scene.
    box_wording : str; What `bounds_m` encloses, for a note about the workspace that it fills.
    unit : (str, float, float) or None; The option that gives the unit, and the usual range of sizes in
        metres; None if any size is usual.
    tags : tuple of str; Media tags of the paper's figure 1: "direct", or "symbolic" if the forces represent
        something else.
    exaggeration : float; Factor already applied to the heights (z) of a height map.
    is_captured : bool; Frames are captured when they are requested (`touchfield.sources.depth.capture`).
    stored : HapticMedium or None; The stored force field of the scene; None if the forces are computed.
    has_decoded_notes : bool; The scene compares a written file with what it was made of (`decoded_notes`).
    has_gpu : bool; Forces are computed on a GPU if one is selected (`touchfield.compute.cuda.computing`).
    report : callable; ``report(done, total)`` is called while the scene prepares its first field; callers may
        set it.
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
    stored: HapticMedium | None = None
    has_decoded_notes: bool = False
    has_gpu: bool = False
    report: Progress = staticmethod(silent)

    @abstractmethod
    def bounds_m(self) -> Float64s:
        """Return the box of the surface over all frames, metres, float64 [2, 3].

        The rows are its low and its high corner.
        """

    def bounds_between_m(self, start: int, stop: int) -> Float64s:
        """Return the box over frames start to stop - 1.

        By default it is that of all frames (`bounds_m`).
        """
        return self.bounds_m()

    @abstractmethod
    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """Return the force field of one frame, sampled (not averaged) at the points of `grid`.

        `grid` and the distances of `profile` are in scene metres.
        """

    def field_update(self, frame: int, grid: Grid, profile: ForceProfile) -> FieldUpdate | None:
        """Return the field of one frame as a change of another one, if the scene makes it that way.

        `FieldUpdate.field` is then the result of `field`, and several frames share a base. By default None.
        """
        return None

    @property
    def is_of_bodies(self) -> bool:
        """True if the scene consists of rigid bodies.

        The representation "auto" then means objects.
        """
        return False

    def bodies(self) -> tuple[Body, ...]:
        """Return the objects of the scene; by default the whole scene is one."""
        return (Body("scene", self, PoseTrack.constant(self.frame_count)),)

    def restrict_frames(self, start: int, stop: int) -> None:  # noqa: B027  (most scenes have nothing to prepare)
        """Restrict the scene to frames start to stop - 1.

        A fused scene, for example, is then built from these frames.
        """

    def set_lattice(  # noqa: B027  (most scenes are the same on any lattice)
        self, grid: Grid, force_max_n: float
    ) -> None:
        """Take notice of the medium's lattice, scene metres, before fields are computed for it.

        Forces above `force_max_n` are clipped at the samples of the lattice. Fields may be requested on finer
        lattices than that. By default nothing changes.
        """

    def skip_frame(self, frame: int) -> None:  # noqa: B027  (most scenes make frames in any order)
        """Take notice that a live sender leaves out a frame. By default nothing changes."""

    def decoded_notes(
        self, field: ForceField, to_hand: Callable[[Float64s], Float64s], force_max_n: float
    ) -> tuple[str, ...]:
        """Return notes on how well a written file reproduces the source; by default none.

        `field` is the first frame as a receiver decodes it; `to_hand` converts points [n, 3] of the scene to
        metres of the field; `force_max_n` is the device's greatest force.
        """
        return ()

    def late_notes(self) -> tuple[str, ...]:
        """Return notes that are known only after fields were computed; by default none."""
        return ()

    def thickened(self, rule: MinThickness) -> tuple[Scene, tuple[ThinWall, ...]]:
        """Return this scene with walls that are at least as thick as `rule` requires, and the thinner ones.

        Only solids have walls with two sides: by default nothing changes.
        """
        return self, ()

    def moved(self, rotation: Float64s, shift_m: Float64s) -> Scene:
        """Return this scene after the rigid motion x -> R x + t.

        `rotation` float64 [3, 3]; `shift_m` float64 [3]. Raises `InvalidArgument` if the scene cannot be
        moved.
        """
        raise InvalidArgument(
            type(self).__name__, "a rigid motion", "a mesh or analytic shapes, which can be moved"
        )


class MovingScene(Scene):
    """A scene whose surface differs between frames.

    The latest requested box is cached.
    """

    _box: tuple[tuple[int, int], Float64s] | None = None

    @abstractmethod
    def _box_m(self, start: int, stop: int) -> Float64s:
        """Compute the box over frames start to stop - 1, float64 [2, 3].

        `bounds_between_m` caches it.
        """

    def bounds_m(self) -> Float64s:
        """Return the box of the surface over all frames, metres, float64 [2, 3], read-only."""
        return self.bounds_between_m(0, self.frame_count)

    def bounds_between_m(self, start: int, stop: int) -> Float64s:
        """Return the box over frames start to stop - 1, metres, float64 [2, 3], read-only."""
        if self._box is None or self._box[0] != (start, stop):
            self._box = (start, stop), frozen(self._box_m(start, stop))
        return self._box[1]


_LARGE_M: Final = 40.0  # a mesh of this size or larger may be in millimetres or inches, as from CAD
_MILLIMETRE_M: Final = 1e-3
_INCH_M: Final = 0.0254


def size_note(
    extent_m: NDArray[np.floating[Any]],
    unit_m: float | None,
    when: str = "",
    stated_m: float | None = None,
    option: str = "--unit-m",
) -> str:
    """Describe the sides of a mesh, metres [3], and its unit.

    `unit_m` is the requested unit, `stated_m` that of the file; None stands for metres. `option` sets the
    unit.
    """
    extent = " x ".join(f"{side:.4g}" for side in extent_m)
    if unit_m is not None:
        other = f", although the file states {stated_m:g} m" if stated_m not in (None, unit_m) else ""
        return f"One unit is {unit_m:g} m{other}: {extent} m{when}."
    if stated_m is not None:
        return f"One unit is {stated_m:g} m, as the file states: {extent} m{when}."
    note = f"Coordinates taken as metres: {extent} m{when}; give {option} if they are not"
    if extent_m.max() < _LARGE_M:
        return f"{note} (millimetres: {_MILLIMETRE_M:g}, inches: {_INCH_M:g})."
    in_mm, in_inches = (
        " x ".join(f"{unit * side:.4g}" for side in extent_m) for unit in (_MILLIMETRE_M, _INCH_M)
    )
    return (
        f"{note}. As millimetres, {option} {_MILLIMETRE_M:g}, they are {in_mm} m; as inches, {in_inches} m."
    )


@dataclass(frozen=True)
class Body:
    """An object of a scene: its shape in its own frame, and the track of that frame.

    Parameters
    ----------
    scene : Scene; In the body's frame, scene metres; one frame for a rigid body, else as many as the track.
    track : PoseTrack; Poses "scene from body".
    is_free : bool; Whether it may move and turn otherwise than in the track, as in a running simulation.
    """

    name: str
    scene: Scene
    track: PoseTrack
    is_free: bool = False

    @property
    def is_rigid(self) -> bool:
        """True if its shape is the same in all frames."""
        return self.scene.frame_count == 1
