"""`CloudScene`: a point cloud as a scene. A sample's force follows from its signed distance to the surface
through the points.

The force is F = f(phi) n, by the same law as for a mesh. The surface is a weighted mean of the planes of the
points near it (`touchfield.sources.clouds.kernels.surface`), after F. Ryden and H. J. Chizeck, A proxy method
for real-time 3-DOF haptic rendering of streaming point cloud data, IEEE Transactions on Haptics 6(3), 2013.
They move a proxy over the points at run time; here the field is computed ahead of use. The points are reduced
to discs in cells (`touchfield.sources.clouds.surfels`); the wall lies behind them, or on both sides where
nothing tells their side, and ends where the points end.
"""

from __future__ import annotations

import copy
import math
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.arrays import Float64s, Int32s
from touchfield.compute.threads import for_chunks, worker_count
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.brick_buffer import BrickBuffer
from touchfield.medium.field import frozen
from touchfield.medium.grid import LOCAL
from touchfield.medium.pose_track import checked_rotation
from touchfield.sources.laws import ForceProfile
from touchfield.sources.scene import UP_Y_AXES, Scene, find_bricks_by_sphere
from touchfield.sources.thin_walls import MinThickness, ThinWall

if TYPE_CHECKING:
    from touchfield.sources.clouds.kernels.surface import Surfels
    from touchfield.sources.clouds.surfels import CloudSurface

_BRICKS_AT_ONCE: Final = 256
_EDGE_SAMPLES: Final = 0.6  # longest edge of merged cells, in samples
_GAP_EDGES: Final = 2.0  # farthest that the foot of a sample with a force lies from a disc


class CloudScene(Scene):
    """A static point cloud.

    surface : CloudSurface; Discs, metres (`touchfield.sources.clouds.surfels.surface_of`).
    shell : str; Side of the wall: "one" sided, "two" sided, or "auto", which is one-sided if the normals of
        neighbours face alike.
    name : str; Its name in messages.
    axes : str; As of `Scene`.
    notes : tuple of str; Notes of the reader; those of the surface follow them.
    """

    unit = ("--unit-m", 0.001, 1e5)
    box_wording = "the cloud without outliers"

    def __init__(
        self,
        surface: CloudSurface,
        shell: str = "auto",
        name: str = "cloud",
        axes: str = UP_Y_AXES,
        notes: tuple[str, ...] = (),
    ) -> None:
        require_one_of("shell", shell, ("auto", "one", "two"))
        self.surface, self.name, self.axes = surface, name, axes
        self.is_one_sided = shell == "one" or (shell == "auto" and surface.is_trusted)
        kind = "a one-sided shell, the wall behind the points" if self.is_one_sided else "a two-sided shell"
        is_closed = surface.is_closed and self.is_one_sided
        reason = ", closed" if is_closed else "" if shell == "auto" else ", as requested"
        self.notes = (*notes, *surface.notes, f"The points are taken as {kind}{reason}.")
        self._rotation, self._shift_m = np.eye(3), np.zeros(3)
        self._sample_m = 0.0
        self._latest: tuple[int, Surfels, Any] | None = None

    def bounds_m(self) -> Float64s:
        points = self._positions_m
        return frozen(np.stack([points.min(axis=0), points.max(axis=0)]))

    def set_lattice(self, grid: Grid, force_max_n: float) -> None:
        """See `Scene.set_lattice`."""
        self._sample_m = max(grid.spacing_m)

    def late_notes(self) -> tuple[str, ...]:
        """See `Scene.late_notes`: whether the points are sparser than the lattice."""
        samples = self.surface.spacing_m / self._sample_m if self._sample_m else 0.0
        if samples <= 1:
            return ()
        return (
            f"The points are {samples:.2g} samples of the lattice apart: the surface between is a guess.",
        )

    def thickened(self, rule: MinThickness) -> tuple[CloudScene, tuple[ThinWall, ...]]:
        """See `Scene.thickened`: walls are where points of both sides lie back to back.

        Points that fill a volume make no wall.
        """
        from touchfield.sources.clouds.surfels import grown, growth_of

        if not self.is_one_sided or self.surface.is_bulky:
            return self, ()
        surfels, _ = self._discs_for(min(rule.spacing_m))
        growth = growth_of(surfels, rule.along(surfels.normals @ self._rotation.T))
        if growth is None:
            return self, ()
        other = copy.copy(self)
        other.__dict__.pop("_positions_m", None)
        other.surface = replace(self.surface, surfels=grown(surfels, growth.motions_m))
        other._latest = None
        return other, (ThinWall(Path(self.name).name, growth.thickness_m, growth.thickened_m),)

    def moved(self, rotation: Float64s, shift_m: Float64s) -> CloudScene:
        """See `Scene.moved`."""
        matrix = checked_rotation(rotation)
        other = copy.copy(self)
        other.__dict__.pop("_positions_m", None)
        other._rotation = matrix @ self._rotation
        other._shift_m = matrix @ self._shift_m + np.asarray(shift_m, np.float64)
        return other

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`.

        Raises `InvalidArgument` if `frame` is not 0, or `profile` a solid's and the surface is not closed.
        """
        if frame != 0:
            raise InvalidArgument(f"{self.name}, frame", str(frame), "0, the only one")
        half_m, reach_m = self._wall(profile)
        surfels, tree = self._discs_for(min(grid.spacing_m))
        search_m = reach_m + _GAP_EDGES * surfels.edge_m

        def may_hold(centres_m: Float64s, radius_m: float) -> Any:
            near_m, _ = tree.query(
                self._to_cloud(centres_m), distance_upper_bound=search_m + radius_m, workers=worker_count()
            )
            return np.isfinite(near_m)

        bricks = find_bricks_by_sphere(may_hold, grid)
        buffer, rotation = BrickBuffer(), self._rotation.T.astype(np.float32)
        for first in range(0, len(bricks), _BRICKS_AT_ONCE):
            self.report(first, len(bricks))
            part = bricks[first : first + _BRICKS_AT_ONCE]
            points, rows = self._nearest(tree, part, grid, search_m)
            forces = np.zeros((len(part), BRICK, BRICK, BRICK, 3), np.float32)
            arguments = (points, rows, surfels, half_m, profile.table(), forces.reshape(-1, 3))
            from touchfield.sources.clouds.kernels.surface import cloud_forces

            for_chunks(cloud_forces, len(points), *arguments, chunk=BRICK**3)
            buffer.append(part, forces @ rotation, np.asarray(forces.any(axis=(1, 2, 3, 4))))
        self.report(len(bricks), len(bricks))
        return ForceField(grid, *buffer.take())

    def _wall(self, profile: ForceProfile) -> tuple[float, float]:
        """Return half the thickness of a two-sided wall, 0 for a one-sided one, and the reach of forces."""
        low, high = profile.low_m, max(profile.high_m, 0.0)
        if math.isinf(low):
            if not (self.is_one_sided and self.surface.is_closed):
                mend = "Give --thickness-m."
                raise InvalidArgument(
                    f"{self.name}, thickness_m", "a solid law for an open surface", "a length", mend
                )
            low = -float(np.ptp(self.bounds_m(), axis=0).min()) / 2
        depth = max(-low, 0.0)
        if self.is_one_sided:
            return 0.0, max(depth, high)
        return max(depth / 2, 1e-300), depth / 2 + high

    def _nearest(self, tree: Any, bricks: Int32s, grid: Grid, search_m: float) -> tuple[Float64s, Int32s]:
        """Return the samples of bricks in the axes of the discs, [m, 3], and the nearest disc (-1: none)."""
        index = (bricks[:, None, None, None].astype(np.int64) * BRICK + LOCAL).reshape(-1, 3)
        points = self._to_cloud(grid.to_m(index))
        distances, rows = tree.query(points, distance_upper_bound=search_m, workers=worker_count())
        is_far = ~np.isfinite(distances) | (index >= np.asarray(grid.shape)).any(axis=1)
        return points, np.where(is_far, -1, rows).astype(np.int32)

    def _to_cloud(self, points_m: Float64s) -> Float64s:
        """Convert points of the scene to those of the discs, which a motion leaves in place."""
        return np.ascontiguousarray((points_m - self._shift_m) @ self._rotation)

    def _discs_for(self, sample_m: float) -> tuple[Surfels, Any]:
        """Return discs not much finer than samples `sample_m` apart, and their k-d tree.

        The latest are cached.
        """
        from touchfield.sources.clouds.surfels import coarser

        wanted = _EDGE_SAMPLES * sample_m / self.surface.surfels.edge_m
        factor = 1 << max(0, math.floor(math.log2(max(wanted, 1.0))))
        if self._latest is None or self._latest[0] != factor:
            surfels = self.surface.surfels if factor == 1 else coarser(self.surface.surfels, factor)
            self._latest = factor, surfels, _tree_of(surfels.positions_m)
        return self._latest[1:]

    @cached_property
    def _positions_m(self) -> Float64s:
        return np.asarray(self.surface.surfels.positions_m @ self._rotation.T + self._shift_m)


def _tree_of(points: Float64s) -> Any:
    from scipy.spatial import cKDTree

    return cKDTree(points, balanced_tree=False, compact_nodes=False)
