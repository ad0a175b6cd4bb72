"""Height maps: a surface over a plane, with everything behind it solid (paper sections 4 and 5.1).

The paper's scenes from depth images treat the depth map as a height map. The distance to the surface is taken
to first order, phi = (z - h(x, y)) n_z with h interpolated bilinearly: exact for planes, and at curvature c and
depth d wrong by about c d^2 / 2. The normal comes from planes fitted to 5 x 5 samples (binomial weights), so that
noise of one sample hardly turns it; samples across a step, or unknown, take no part.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float32s, Float64s
from touchfield.errors import InvalidArgument, SourceError, require_positive
from touchfield.medium import ForceField, Grid
from touchfield.sources.camera import DepthSequence, noise_step_per_m
from touchfield.sources.laws import ForceProfile
from touchfield.sources.scene import CAMERA_AXES, DEPTH_UNIT, UP_Z_AXES, Body, MovingScene
from touchfield.sources.segments import SegmentRule, segmented_bodies

DEPTH_STEP: Final = 0.05  # of the median depth: a larger jump between neighbours is an edge


@dataclass(frozen=True)
class HeightLattice:
    """Places of the samples of a height map, and its solid side.

    x0_m, dx_m, y0_m, dy_m : float; Sample (row, col) lies at x0 + col * dx, y0 + row * dy, metres; dx and dy are
        signed.
    facing : int; 1: solid below the surface; -1: solid beyond it, where z points away from the viewer.
    step_m : float; Neighbours that differ by more in height are not joined by a slope; ``inf`` joins all.
    """

    x0_m: float
    dx_m: float
    y0_m: float
    dy_m: float
    facing: int = 1
    step_m: float = math.inf

    def __post_init__(self) -> None:
        for name in ("dx_m", "dy_m"):
            value = getattr(self, name)
            if not (value != 0 and math.isfinite(value)):
                raise InvalidArgument(name, repr(value), "a length in metres, not zero")
        if not (math.isfinite(self.x0_m) and math.isfinite(self.y0_m)):
            raise InvalidArgument("x0_m, y0_m", f"{self.x0_m}, {self.y0_m}", "finite metres")
        if self.facing not in (1, -1) or not self.step_m > 0:
            raise InvalidArgument("facing, step_m", f"{self.facing}, {self.step_m}", "1 or -1, a positive height")


class HeightScene(MovingScene):
    """One height map, or several over time; beyond its rim and where it is unknown there is no force.

    heights_m : array [rows, cols], array [frames, rows, cols], sequence of arrays, or callable; Heights, metres, NaN
        where unknown. A callable ``heights(frame) -> [rows, cols]`` is asked when a frame is needed, and needs
        `frame_count`.
    cell_m : (float, float) or HeightLattice; (dy, dx): distance between neighbouring rows and columns, metres. Row 0
        is then north, the last row at y = 0 and column 0 at x = 0; a lattice says otherwise.
    exaggeration : float; Factor on the heights (1 is honest).
    frame_count : int, optional; Of a callable.
    name : str; What to call it in messages.
    """

    is_solid = True

    def __init__(
        self,
        heights_m: ArrayLike | Sequence[ArrayLike] | Callable[[int], ArrayLike],
        cell_m: tuple[float, float] | HeightLattice,
        *,
        axes: str = UP_Z_AXES,
        exaggeration: float = 1.0,
        frame_count: int = 1,
        rate_hz: float = 30.0,
        notes: tuple[str, ...] = (),
        name: str = "height map",
    ) -> None:
        require_positive(exaggeration=exaggeration, rate_hz=rate_hz, frame_count=frame_count)
        if callable(heights_m):
            self._frames: Callable[[int], ArrayLike] = heights_m
            self.frame_count = int(frame_count)
        else:
            kept = _as_frames(heights_m)
            self._frames, self.frame_count = kept.__getitem__, len(kept)
        self.axes, self.rate_hz, self.notes, self.name = axes, float(rate_hz), notes, name
        self._exaggeration = float(exaggeration)
        self._cell_m = cell_m
        self._surface = lru_cache(maxsize=2)(self._prepare)  # a filter asks for one frame many times
        self._segmented: Callable[[], tuple[tuple[Body, ...], str]] | None = None
        self._bodies: tuple[Body, ...] = ()

    @classmethod
    def from_depth_sequence(
        cls, sequence: DepthSequence, exaggeration: float = 1.0, segment: str | None = None
    ) -> HeightScene:
        """The paper's reading of depth maps: pixels as x and y, depth as height, all behind the surface solid.

        Pixels are spaced by their size at the median depth of the first frame that has any, x = (u - cx) / fx
        z_median, so that lengths there are true; nearer things are too large and farther ones too small.
        `segment` is the rule by which `bodies` are told apart (`touchfield.sources.segments.SegmentRule.parse`).
        """
        for frame in range(sequence.frame_count):
            depth = sequence.depth_m(frame)
            known = depth[depth > 0]
            if known.size:
                break
        else:
            raise SourceError(sequence.name, "no depth in any frame", "at least one known pixel")
        z, k = float(np.median(known)), sequence.intrinsics
        dx_m, dy_m = z / k.fx, z / k.fy
        lattice = HeightLattice(-k.cx / k.fx * z, dx_m, -k.cy / k.fy * z, dy_m, -1, DEPTH_STEP * z * exaggeration)
        note = f"Depth is read as a height map: pixels are spaced as at {z:.3g} m, perspective is not undone."
        notes, rule = (*sequence.notes, note), SegmentRule.parse(segment)
        scene = cls._of_heights(sequence, lattice, exaggeration, notes)
        scene._segmented = lambda: segmented_bodies(
            lambda part: cls._of_heights(part, lattice, exaggeration, notes), sequence, rule,
            noise_step_per_m(sequence.depth_m(0)),
        )  # fmt: skip
        return scene

    @classmethod
    def _of_heights(
        cls, sequence: DepthSequence, lattice: HeightLattice, exaggeration: float, notes: tuple[str, ...]
    ) -> HeightScene:
        """The depths of a sequence as heights on a lattice."""

        def heights(frame: int) -> Float64s:
            depth = sequence.depth_m(frame).astype(np.float64)
            depth[~(depth > 0)] = np.nan
            return depth

        scene = cls(
            heights, lattice, axes=CAMERA_AXES, exaggeration=exaggeration, frame_count=sequence.frame_count,
            rate_hz=sequence.rate_hz, notes=notes, name=sequence.name,
        )  # fmt: skip
        scene.unit = DEPTH_UNIT
        return scene

    def bodies(self) -> tuple[Body, ...]:
        """Of depth maps the objects of `touchfield.sources.segments` and the background; else the whole scene."""
        if self._segmented is None:
            return super().bodies()
        if not self._bodies:
            self._bodies, note = self._segmented()
            self.notes = (*self.notes, note)
        return self._bodies

    def _box_m(self, start: int, stop: int) -> Float64s:
        """Reads every frame."""
        low, high, shape = math.inf, -math.inf, (2, 2)
        for frame in range(start, stop):
            heights = self._heights(frame)
            known = heights[np.isfinite(heights)]
            shape = heights.shape
            if known.size:
                low, high = min(low, float(known.min())), max(high, float(known.max()))
        if low > high:
            raise SourceError(self.name, "no known height", "at least one")
        at = self._lattice(shape)
        xs = sorted((at.x0_m, at.x0_m + at.dx_m * (shape[1] - 1)))
        ys = sorted((at.y0_m, at.y0_m + at.dy_m * (shape[0] - 1)))
        return np.array([[xs[0], ys[0], low], [xs[1], ys[1], high]])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        from touchfield.sources.kernels import height

        heights, slopes = self._surface(frame)
        at = self._lattice(heights.shape)
        place = (at.x0_m, at.dx_m, at.y0_m, at.dy_m)
        bricks, forces = height.bricks_and_forces((heights, slopes), place, at.facing, at.step_m, grid, profile)
        return ForceField(grid, bricks, forces)

    def _lattice(self, shape: tuple[int, ...]) -> HeightLattice:
        if isinstance(self._cell_m, HeightLattice):
            return self._cell_m
        dy, dx = self._cell_m
        return HeightLattice(0.0, dx, dy * (shape[0] - 1), -dy)

    def _heights(self, frame: int) -> Float64s:
        heights = np.array(self._frames(frame), np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InvalidArgument(self.name, f"heights of shape {heights.shape}", "[rows, cols], at least 2 x 2")
        with np.errstate(over="ignore"):
            heights *= self._exaggeration
        heights[~np.isfinite(heights)] = np.nan
        return heights

    def _prepare(self, frame: int) -> tuple[Float64s, Float32s]:
        from touchfield.sources.kernels import height

        heights = self._heights(frame)
        at = self._lattice(heights.shape)
        return heights, height.gradients(heights, at.step_m, at.dx_m, at.dy_m)


def _as_frames(heights_m: ArrayLike | Sequence[ArrayLike]) -> list[Float64s]:
    """The frames of an array or a sequence of arrays, checked."""
    expected = "maps [rows, cols] of one size, at least 2 x 2"
    try:
        stack = np.asarray(heights_m, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument("heights_m", "no array of numbers", expected) from error
    frames = list(stack) if stack.ndim == 3 else [stack]
    if stack.ndim not in (2, 3) or not frames or min(frames[0].shape) < 2:
        raise InvalidArgument("heights_m", f"shape {stack.shape}", expected)
    return frames
