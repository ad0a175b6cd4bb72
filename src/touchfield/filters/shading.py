"""Force shading: direction and amplitude smoothed apart, over the support (paper section 3.2).

The paper lists "off-line force shading" among the haptic filters and gives no formula. On-line it is the rule of
Morgenbesser and Srinivasan, "Force shading for haptic shape perception", 1996: the direction of the force is
interpolated over the facets of a coarse surface while its amplitude still tells how deep the hand is, so that facets
feel round. Here both are taken from the field itself, with the Gaussian weights w and the support S::

    u_i = sum_S w_ij F_j/|F_j|                      direction u_i / |u_i|
    a_i = sum_S w_ij |F_j| / sum_S w_ij             amplitude

Directions are unit vectors, each sample of the support counting by its distance alone, so that the amplitudes have no
say in them; a mean of forces would follow the deep samples. The sums run over the support (a normalised convolution,
Knutsson and Westin 1993): empty space neither pulls forces down nor blunts a contact, and the border of the grid is
no edge. Where the directions around cancel, as in the middle of a wall between two sides, a sample keeps its own.

``spread`` lets the support grow by the reach of the kernel. The amplitude is then the plain mean with empty space as
0 N, which makes a soft rim around each wall, and the direction there is that of the support nearby.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.separable import AxisTaps, keys_of_passes, places_of, sums_of_bricks, within_grid
from touchfield.medium import BRICK, ForceField
from touchfield.medium.budget import memory_budget_bytes, zero_forces
from touchfield.medium.field import bricks_of
from touchfield.parallel import worker_count

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.filters.separable import Axes
    from touchfield.medium import Grid

    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]

SMOOTHED: Final = ("both", "direction", "amplitude")

MAX_TRUNCATE: Final = 16.0
MAX_REACH: Final = 1 << 15
_CANCELLED: Final = 1e-4
"""A mean of unit vectors shorter than this has no direction but that of rounding."""


@dataclass(frozen=True)
class ShadingFilter(FieldFilter):
    """Gaussian force shading.

    sigma_m : float; of the Gaussian, metres. Facets vanish from about 0.4 of their edge on: those of an icosphere of
        80 triangles turn the force by 10 degrees (rms) from that of the sphere, and by 0.3 degrees after it.
    smooth : str; "both"; "direction" keeps every amplitude, "amplitude" keeps every direction.
    truncate : float; the Gaussian is 0 beyond so many sigma, above 0, at most 16.
    spread : bool; let the support grow; not with "direction", which leaves amplitudes alone, and so the zeros.
    Raises `InvalidArgument` if a value is out of range; on a call, if sigma is larger than the grid or reaches too
    many samples.
    """

    sigma_m: float
    smooth: str = "both"
    truncate: float = 4.0
    spread: bool = False

    name: ClassVar[str] = "shading"
    summary: ClassVar[str] = "smooth direction and amplitude apart within the support, 2mm or 2mm,smooth=direction"
    example: ClassVar[str] = "2mm"

    def __post_init__(self) -> None:
        if not 0 < self.sigma_m < math.inf:
            raise InvalidArgument("shading sigma_m", repr(self.sigma_m), "a positive length in metres")
        if self.smooth not in SMOOTHED:
            raise InvalidArgument("shading smooth", repr(self.smooth), f"one of {', '.join(SMOOTHED)}")
        if not 0 < self.truncate <= MAX_TRUNCATE:
            raise InvalidArgument("shading truncate", repr(self.truncate), f"above 0, at most {MAX_TRUNCATE:g} sigma")
        if self.spread and self.smooth == "direction":
            raise InvalidArgument("shading spread", "true with smooth=direction", "smooth=both or smooth=amplitude")

    def claims(self, grid: Grid) -> Claims:
        """The reach is truncate * sigma, rounded to samples; means of amplitudes never exceed the greatest."""
        x, y, z = (min(self._radius(h), n - 1) for h, n in zip(grid.spacing_m, grid.shape))
        return Claims(
            reach=(x, y, z),
            dc_gain=1.0,
            max_principle=True,
            keeps_support=not self.spread,
            keeps_direction=self.smooth == "amplitude",
            keeps_amplitude=self.smooth == "direction",
        )

    def _radius(self, spacing_m: float) -> int:
        return int(min(self.truncate * self.sigma_m / spacing_m + 0.5, 1 << 30))

    def __call__(self, field: ForceField) -> ForceField:
        """The shaded field, newtons, on the same grid."""
        if not field.support_count:
            return field
        axes = self._axes(field)
        lengths_n = _lengths(field)
        scale_n = math.ldexp(1.0, math.frexp(float(lengths_n.max()))[1])
        directions, masses = _apart(field, lengths_n, scale_n)
        keys = keys_of_passes(field, axes)
        if not self.spread:  # the bricks around the support need not be made
            keys[3] = keys[0]
        mean_masses, mean_directions = (_smoothed(field.grid, v, axes, keys) for v in (masses, directions))
        bricks, reached = np.array(field.bricks), field.mask
        if self.spread:
            bricks = bricks_of(field.grid, keys[3])
            reached = (mean_masses[..., 0] > 0) & within_grid(field.grid, bricks)
            placed = zero_forces(len(bricks))
            placed[np.searchsorted(keys[3], keys[0])] = directions
            directions = placed
        if self.smooth != "direction":
            weights = _whole_weights(field.grid, axes, bricks)[reached] if self.spread else mean_masses[reached][:, 0]
            lengths_n = scale_n * mean_masses[reached][:, 1].astype(np.float64) / weights
        unit = self._directions(directions[reached], mean_directions[reached], mean_masses[reached][:, 0])
        forces = zero_forces(len(bricks))
        forces[reached] = unit * lengths_n[:, None]
        return ForceField.from_bricks(field.grid, bricks, forces)

    def _directions(self, own: Float32s, around: Float32s, weights: Float32s) -> Float64s:
        """Unit vectors [L, 3], from those of the samples (0 outside the support), sums around, and their weights."""
        unit = own.astype(np.float64)
        if self.smooth == "amplitude" and not self.spread:
            return unit
        sums = around.astype(np.float64)
        lengths = np.sqrt((sums * sums).sum(axis=1))
        taken = lengths > _CANCELLED * weights
        if self.smooth == "amplitude":
            taken &= ~own.any(axis=1)
        unit[taken] = sums[taken] / lengths[taken, None]
        return unit

    def _axes(self, field: ForceField) -> Axes:
        """The Gaussian along each axis, 1 in its middle; no longer than the support is, unless that is to grow."""
        grid = field.grid
        longest_m = max(h * n for h, n in zip(grid.spacing_m, grid.shape))
        if self.sigma_m > longest_m:
            expected = f"at most the longest edge of the grid, {longest_m:g} m"
            raise InvalidArgument("shading sigma_m", f"{self.sigma_m:g} m", expected)
        extents = (field.bricks.max(axis=0) - field.bricks.min(axis=0) + 1) * BRICK
        made, needed = [], self.claims(grid).reach
        for spacing, extent, reach in zip(grid.spacing_m, extents.tolist(), needed):
            reach = reach if self.spread else min(reach, extent - 1)
            if reach > MAX_REACH:
                found = f"{self.sigma_m:g} m, {reach} samples on either side"
                raise InvalidArgument("shading sigma_m", found, f"a reach of up to {MAX_REACH} samples")
            taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) * spacing / self.sigma_m) ** 2)
            made.append(AxisTaps.centred(taps))
        axes = (made[0], made[1], made[2])
        _check_scratch(self.sigma_m, grid, axes)
        return axes


def _lengths(field: ForceField) -> Float64s:
    """|F| of the support, newtons, float64 [L], brick after brick."""
    forces = field.forces_n[field.mask].astype(np.float64)
    lengths: Float64s = np.sqrt((forces * forces).sum(axis=1))
    return lengths


def _apart(field: ForceField, lengths_n: Float64s, scale_n: float) -> tuple[Float32s, Float32s]:
    """Unit vectors, and (1, |F| / scale, 0), float32 [n, 8, 8, 8, 3], zero outside the support.

    The scale keeps sums within float32; it is a power of 2, so that it has no part in how they are rounded.
    """
    directions, masses = zero_forces(len(field.bricks)), zero_forces(len(field.bricks))
    directions[field.mask] = field.forces_n[field.mask] / lengths_n[:, None]
    masses[field.mask, 0] = 1
    masses[field.mask, 1] = lengths_n / scale_n
    return directions, masses


def _check_scratch(sigma_m: float, grid: Grid, axes: Axes) -> None:
    """Raise if the rows that the passes of each thread keep at hand are beyond the memory of a field."""
    wide, high, deep = (2 * -(-a.reach // BRICK) + 2 for a in axes)
    row_bytes = (min(grid.brick_shape[2], 32) + deep) * BRICK * 12
    needed, allowed = worker_count() * (wide + high) * BRICK**2 * row_bytes, memory_budget_bytes()
    if needed > allowed:
        raise InvalidArgument(
            "shading sigma_m", f"{sigma_m:g} m, for whose reach the threads take {needed / 2**30:.1f} GiB",
            f"at most {allowed / 2**30:.1f} GiB", "Take a smaller sigma or truncate, or a coarser grid.",
        )  # fmt: skip


def _smoothed(grid: Grid, vectors: Float32s, axes: Axes, keys: list[NDArray[np.int64]]) -> Float32s:
    """Weighted sums of vectors that lie in the bricks of the field, in the last bricks, float32 [n, 8, 8, 8, 3]."""
    sums: Float32s
    sums, tops = sums_of_bricks(grid, vectors, axes, keys)
    sums[tops == 0] = 0
    return sums


def _whole_weights(grid: Grid, axes: Axes, bricks: NDArray[np.int32]) -> Float64s:
    """The sum of all weights that lie within the grid, at each sample of the bricks, float64 [n, 8, 8, 8]."""
    sums = []
    for axis, row in enumerate(axes):
        sum_to = np.concatenate([[0.0], np.cumsum(row.taps.astype(np.float32), dtype=np.float64)])
        places = np.minimum(places_of(bricks, axis), grid.shape[axis] - 1)
        first = np.maximum(row.reach - places, 0)
        after = np.minimum(row.reach + grid.shape[axis] - places, len(row.taps))
        sums.append(sum_to[after] - sum_to[first])
    x, y, z = sums
    whole: Float64s = x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]
    return whole
