"""`HeightScene`: a height map as a scene that is solid below its surface (paper sections 4 and 5.1).

`touchfield.sources.terrain.height_files` reads height maps from files.

The paper's scenes from depth images treat the depth map as a height map. The distance to the surface is
approximated to first order, phi = (z - h(x, y)) n_z with h interpolated bilinearly: exact for planes, with an
error of about c d^2 / 2 at curvature c and depth d. The normal is that of planes fitted to 5 x 5 samples with
binomial weights, so that noise of one sample hardly affects it; unknown samples and those across a step are
excluded.
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
from touchfield.sources.camera import DepthSequence
from touchfield.sources.laws import ForceProfile
from touchfield.sources.scene import CAMERA_AXES, DEPTH_UNIT, UP_Z_AXES, MovingScene

DEPTH_STEP: Final = 0.05  # of the median depth: a larger jump between neighbours is an edge


@dataclass(frozen=True)
class HeightLattice:
    """Positions of the samples of a height map, and its solid side.

    Sample (row, col) lies at x0 + col * dx, y0 + row * dy, metres; dx and dy are signed. `facing` is 1 if the
    solid lies below the surface, and -1 if it lies behind the surface and z points away from the viewer.
    Neighbours that differ by more than `step_m` in height are separated by a step.
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
            raise InvalidArgument(
                "facing, step_m", f"{self.facing}, {self.step_m}", "1 or -1, a positive height"
            )


class HeightScene(MovingScene):
    """One height map, or several over time.

    There is no force outside it and where it is unknown.

    `heights_m` are metres, NaN where unknown: [rows, cols], [frames, rows, cols], a sequence of arrays, or a
    callable ``heights(frame) -> [rows, cols]`` for `frame_count` frames. `cell_m` is (dy, dx), the distance
    between neighbouring rows and columns, metres: row 0 is then north, the last row at y = 0 and column 0 at
    x = 0; a `HeightLattice` gives other positions. `exaggeration` is a factor on the heights; 1 keeps the
    true proportions.
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
            frames = _as_frames(heights_m)
            self._frames, self.frame_count = frames.__getitem__, len(frames)
        self.axes, self.rate_hz, self.notes, self.name = axes, float(rate_hz), notes, name
        self.exaggeration = float(exaggeration)
        self._cell_m = cell_m
        self._surface = lru_cache(maxsize=2)(self._prepare)  # a filter requests one frame many times

    @classmethod
    def from_depth_sequence(cls, sequence: DepthSequence, exaggeration: float = 1.0) -> HeightScene:
        """Read depth maps as height maps, as in the paper.

        Pixels are x and y, depth is height, and everything behind the surface is solid.

        Pixels are spaced by their size at the median depth of the first frame with depth, x = (u - cx) / fx
        z_median, so that lengths at that depth are true; nearer things are too large, farther ones too small.
        """
        for frame in range(sequence.frame_count):
            depth = sequence.depth_m(frame)
            known_m = depth[depth > 0]
            if known_m.size:
                break
        else:
            raise SourceError(sequence.name, "no depth in any frame", "at least one known pixel")
        z, k = float(np.median(known_m)), sequence.intrinsics
        dx_m, dy_m = z / k.fx, z / k.fy
        lattice = HeightLattice(
            -k.cx / k.fx * z, dx_m, -k.cy / k.fy * z, dy_m, -1, DEPTH_STEP * z * exaggeration
        )
        note = f"Depth is read as a height map: pixels are spaced as at {z:.3g} m, perspective is not undone."

        def heights(frame: int) -> Float32s:
            depth = sequence.depth_m(frame)
            return np.where(depth > 0, depth, np.float32(np.nan))

        scene = cls(
            heights, lattice, axes=CAMERA_AXES, exaggeration=exaggeration, frame_count=sequence.frame_count,
            rate_hz=sequence.rate_hz, notes=(*sequence.notes, note), name=sequence.name,
        )  # fmt: skip
        scene.unit = DEPTH_UNIT
        return scene

    def _box_m(self, start: int, stop: int) -> Float64s:
        """Return the box of the heights; reads every frame."""
        low, high, shape = math.inf, -math.inf, (2, 2)
        for frame in range(start, stop):
            heights = self._heights(frame)
            known_m = heights[np.isfinite(heights)]
            shape = heights.shape
            if known_m.size:
                low, high = min(low, float(known_m.min())), max(high, float(known_m.max()))
        if low > high:
            raise SourceError(self.name, "no known height", "at least one")
        at = self._lattice(shape)
        xs = sorted((at.x0_m, at.x0_m + at.dx_m * (shape[1] - 1)))
        ys = sorted((at.y0_m, at.y0_m + at.dy_m * (shape[0] - 1)))
        return np.array([[xs[0], ys[0], low], [xs[1], ys[1], high]])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        from touchfield.sources.terrain import kernels

        heights, slopes = self._surface(frame)
        at = self._lattice(heights.shape)
        return ForceField(grid, *kernels.bricks_and_forces(heights, slopes, at, grid, profile))

    def _lattice(self, shape: tuple[int, ...]) -> HeightLattice:
        if isinstance(self._cell_m, HeightLattice):
            return self._cell_m
        dy, dx = self._cell_m
        return HeightLattice(0.0, dx, dy * (shape[0] - 1), -dy)

    def _heights(self, frame: int) -> Float64s:
        heights = np.array(self._frames(frame), np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise InvalidArgument(
                self.name, f"heights of shape {heights.shape}", "[rows, cols], at least 2 x 2"
            )
        with np.errstate(over="ignore"):
            heights *= self.exaggeration
        heights[~np.isfinite(heights)] = np.nan
        return heights

    def _prepare(self, frame: int) -> tuple[Float64s, Float32s]:
        from touchfield.sources.terrain import kernels

        heights = self._heights(frame)
        at = self._lattice(heights.shape)
        return heights, kernels.gradients(heights, at.step_m, at.dx_m, at.dy_m)


def _as_frames(heights_m: ArrayLike | Sequence[ArrayLike]) -> list[Float64s]:
    """Return the checked frames of an array or a sequence of arrays."""
    expected = "maps [rows, cols] of one size, at least 2 x 2"
    try:
        stack = np.asarray(heights_m, np.float64)
    except (TypeError, ValueError) as error:
        raise InvalidArgument("heights_m", "no array of numbers", expected) from error
    frames = list(stack) if stack.ndim == 3 else [stack]
    if stack.ndim not in (2, 3) or not frames or min(frames[0].shape) < 2:
        raise InvalidArgument("heights_m", f"shape {stack.shape}", expected)
    return frames
