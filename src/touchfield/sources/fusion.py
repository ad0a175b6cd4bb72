"""A fused volume: the mean of what posed depth maps tell each sample (Curless and Levoy 1996, KinectFusion 2011).

The volume stands on the lattice that is asked for, in bricks that a surface passes, so that its memory follows the
surface. A view says of a sample how far it lies from the tangent plane of its pixel (phi, negative behind), which is
nearer to the truth than the distance along the ray (docs/decisions/0013). With the surface's *neighbourhood* |phi| <=
2 noise(z), at least a sample wide, three things can be said:

near   |phi| is within it: the mean of phi and of the plane's normal moves, weighted by 1 / noise^2 and by the
       squared cosine between ray and normal.
guess  the sample lies behind it, as far as the wall reaches: nobody has seen that it is solid. It counts the less the
       farther behind, gives way to a surface seen near the sample, and does not return once rays have passed.
free   the ray passed in front. Two in a row carve what stood there.

What moves is found in the same pass: a surface carved, a surface in known free space, and a surface that shifts by
more than its neighbourhood count as *changes* of the sample; its mean begins anew. Behind a surface in formerly free
space the guess is allowed again, since the solid came with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import require_memory
from touchfield.sources.depth_scene import RAY_LIMIT, force_bricks, query_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from touchfield.sources.kernels.fusion import Samples, View
    from touchfield.sources.kernels.planes import SurfacePlanes
    from touchfield.sources.profile import ForceProfile

    Float64s = NDArray[np.float64]

__all__ = ["FusedVolume"]

SLACK: Final = 3.0
"""A neighbourhood is at least so many times the mean residual of a view: poses are off by more than the sensor."""

OFF_TIMES: Final = 1.5
"""A view is off whose residual is so many times the median of those so far."""

_BYTES_PER_BRICK = 512 * (5 * 4 + 4)


class FusedVolume:
    """What a depth sequence has told the samples of a lattice so far.

    Parameters
    ----------
    grid : Grid
        In scene metres.
    profile : ForceProfile
        In scene metres: how far before and behind a surface there is a force.
    step_per_m : float
        Noise of the sensor, of inverse depth, 1/m.
    first : float
        How much more the first look at a surface counts than a later one. Above 1 what is felt early moves less
        while the mean settles.

    Attributes
    ----------
    bricks : int32 [n, 3]
        In the order in which they were added.
    """

    def __init__(self, grid: Grid, profile: ForceProfile, step_per_m: float, first: float = 1.0) -> None:
        from touchfield.sources.kernels.fusion import Rules

        self.grid, self.profile = grid, profile
        self.bricks = np.empty((0, 3), np.int32)
        self._slots = np.full(grid.brick_shape, -1, np.int32)
        self._samples = _no_samples(64)
        self._residuals_m: list[float] = []
        least = max(float(np.mean(grid.spacing_m)), profile.high_m)
        behind = min(max(-profile.low_m, 0.0), float(np.ptp(grid.box_m, axis=0).sum()))
        self._rules = Rules(*(np.float32(x) for x in (step_per_m, least, behind, RAY_LIMIT, first)))

    @property
    def samples(self) -> Samples:
        """What the samples of `bricks` remember."""
        return self._samples.first(len(self.bricks))

    def cover(self, surface: SurfacePlanes, pose: Float64s) -> None:
        """Have bricks wherever this view's surface may push."""
        bricks = force_bricks(query_of(surface, pose, self.grid, self.profile), self.grid)
        self.add(bricks[self._slots[tuple(bricks.T)] < 0])

    def add(self, bricks: NDArray[np.int32]) -> None:
        """Have these bricks, int32 [n, 3], none of which the volume has.

        Raises
        ------
        InvalidArgument
            If they need more memory than there is.
        """
        count = len(self.bricks) + len(bricks)
        if count > len(self._samples.weight):
            room = max(count, len(self._samples.weight) * 3 // 2)
            require_memory("fused volume", room, room * _BYTES_PER_BRICK)
            grown = _no_samples(room)
            grown.first(len(self.bricks)).take(self.samples)
            self._samples = grown
        self._slots[tuple(bricks.T)] = np.arange(len(self.bricks), count)
        self.bricks = np.concatenate([self.bricks, bricks])

    def integrate(self, surface: SurfacePlanes, pose: Float64s) -> float | None:
        """Tell the samples what a view says.

        Parameters
        ----------
        surface : SurfacePlanes
            In camera axes.
        pose : float64 [4, 4]
            Scene from camera, a rigid motion.

        A view that misses what was known by much more than those before it (a pose that is off) tells of no changes.

        Returns
        -------
        float or None
            The mean residual against the surfaces that were known, metres; None if none was.
        """
        from touchfield.sources.kernels import fusion as kernels

        of = self.samples
        view, residual_m = self._view(surface, pose, kernels.is_free(of))
        least = max(self._rules.least_m, np.float32(SLACK * (residual_m or 0.0)))
        before = of.changes.copy() if self._is_off(residual_m) else None
        kernels.integrate(self.bricks, view, self._rules._replace(least_m=least), of)
        if before is not None:
            of.changes[...] = before
        return residual_m

    def _is_off(self, residual_m: float | None) -> bool:
        """True for a view whose residual is far above the usual one."""
        if residual_m is None:
            return False
        self._residuals_m.append(residual_m)
        return residual_m > OFF_TIMES * float(np.median(self._residuals_m))

    def mark(
        self,
        surface: SurfacePlanes,
        pose: Float64s,
        wanted: NDArray[np.bool_],
        choose: Callable[[NDArray[np.uint8]], NDArray[np.uint8]],
        out: NDArray[np.bool_],
    ) -> None:
        """Set in `out`, bool [n, 512], what lies at and behind surfaces of this view.

        `choose` makes the pixels to take of those whose surface is at a sample of `wanted`, bool [n, 512]; both
        uint8 [height, width].
        """
        from touchfield.sources.kernels import fusion as kernels

        view, _ = self._view(surface, pose, wanted)
        view.marked[:-1] = choose(view.marked[:-1].reshape(view.height, view.width)).reshape(-1)
        if view.marked.any():
            kernels.mark(self.bricks, view, self._rules, out)

    def forces_n(self) -> NDArray[np.float32]:
        """The forces of what is known, newtons, float32 [n, 8, 8, 8, 3], in the order of `bricks`."""
        from touchfield.sources.kernels import fusion as kernels

        pieces = self.profile.table().astype(np.float32)
        return kernels.brick_forces(self.samples, pieces, self.grid.shape, self.bricks)

    def field(self, forces_n: NDArray[np.float32] | None = None) -> ForceField:
        """The force field of what is known, or of these forces of `bricks`."""
        forces = self.forces_n() if forces_n is None else forces_n
        order = np.lexsort(self.bricks.T[::-1])
        held = np.asarray(forces.any(axis=(1, 2, 3, 4)))
        order = order[held[order]]
        return ForceField(self.grid, self.bricks[order], forces[order])

    def _view(self, surface: SurfacePlanes, pose: Float64s, wanted: NDArray[np.bool_]) -> tuple[View, float | None]:
        """The view, its pixels marked whose surface lies at a sample of `wanted`; its residual, metres."""
        from touchfield.sources.kernels import fusion as kernels
        from touchfield.sources.kernels.depth import brick_offsets

        query = query_of(surface, pose, self.grid, self.profile)
        height, width = surface.size_px
        view = kernels.View(
            surface.planes.reshape(-1),
            np.empty(height * width + 1, np.uint8),
            surface.camera_px,
            height,
            width,
            query.lattice_m,
            brick_offsets(query),
            query.turn,
            _nearest_per_m(surface),
        )
        return view, kernels.surfaces_in(view, self._slots, self.grid.shape, self.samples, wanted)


def _nearest_per_m(surface: SurfacePlanes) -> NDArray[np.float32]:
    """Largest inverse depth of each finest tile and its eight neighbours, 1/m, float32 [rows, columns]."""
    from scipy.ndimage import maximum_filter

    ends = [*surface.places[1:, 0], len(surface.tiles)]
    finest = surface.tiles[: ends[0], 0].reshape(-1, surface.places[0, 1])
    return np.asarray(maximum_filter(finest, 3), np.float32)


def _no_samples(count: int) -> Samples:
    from touchfield.sources.kernels.fusion import Samples

    floats = (np.zeros((count, *shape), np.float32) for shape in ((512,), (512,), (3, 512)))
    return Samples(*floats, *(np.zeros((count, 512), np.uint8) for _ in range(4)))
