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
from touchfield.filters.field_filter import Claims, FieldFilter
from touchfield.filters.lowpass import MAX_WEIGHTS, AxisWeights
from touchfield.medium import BRICK, ForceField
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys, frozen
from touchfield.medium.neighbours import dilated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid

    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]
    Tables = tuple[AxisWeights, AxisWeights, AxisWeights]

__all__ = ["FILTER", "SMOOTHED", "ShadingFilter"]

SMOOTHED: Final = ("both", "direction", "amplitude")

MAX_TRUNCATE: Final = 16.0
_CANCELLED: Final = 1e-4
"""A mean of unit vectors shorter than this has no direction but that of rounding."""


@dataclass(frozen=True)
class ShadingFilter(FieldFilter):
    """Gaussian force shading.

    Parameters
    ----------
    sigma_m : float
        Of the Gaussian, metres. Facets vanish from about 0.4 of their edge on: those of an icosphere of 80
        triangles turn the force by 10 degrees (rms) from that of the sphere, and by 0.3 degrees after it.
    smooth : str
        "both"; "direction" keeps every amplitude, "amplitude" keeps every direction.
    truncate : float
        The Gaussian is 0 beyond so many sigma, above 0, at most 16.
    spread : bool
        Let the support grow; not with "direction", which leaves amplitudes alone, and so the zeros.

    Raises
    ------
    InvalidArgument
        If a value is out of range; on a call, if sigma is larger than the grid or too large for its samples.
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
        tables = self._tables(field.grid)
        lengths_n = _lengths(field)
        scale_n = math.ldexp(1.0, math.frexp(float(lengths_n.max()))[1])
        directions, masses = _apart(field, lengths_n, scale_n)
        bricks, reached = np.array(field.bricks), field.mask
        if self.spread:
            bricks = dilated(field.grid, field.bricks, self.claims(field.grid).reach)
        mean_masses = _smoothed(field, masses, tables, bricks)
        mean_directions = _smoothed(field, directions, tables, bricks)
        if self.spread:
            reached = mean_masses[..., 0] > 0
            placed = zero_forces(len(bricks))
            placed[np.searchsorted(brick_keys(field.grid, bricks), brick_keys(field.grid, field.bricks))] = directions
            directions = placed
        if self.smooth != "direction":
            weights = _whole_weights(tables, bricks)[reached] if self.spread else mean_masses[reached][:, 0]
            lengths_n = scale_n * mean_masses[reached][:, 1].astype(np.float64) / weights
        unit = self._directions(directions[reached], mean_directions[reached], mean_masses[reached][:, 0])
        forces = zero_forces(len(bricks))
        forces[reached] = unit * lengths_n[:, None]
        held = forces.reshape(len(forces), BRICK**3 * 3).any(axis=1)
        return ForceField(field.grid, bricks[held], forces[held])

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

    def _tables(self, grid: Grid) -> Tables:
        """The Gaussian along each axis, 1 in its middle, as the tables of the resampling kernel."""
        longest_m = max(h * n for h, n in zip(grid.spacing_m, grid.shape))
        if self.sigma_m > longest_m:
            expected = f"at most the longest edge of the grid, {longest_m:g} m"
            raise InvalidArgument("shading sigma_m", f"{self.sigma_m:g} m", expected)
        made = []
        for spacing, count, reach in zip(grid.spacing_m, grid.shape, self.claims(grid).reach):
            if (2 * reach + 1) * count > MAX_WEIGHTS:
                found = f"{self.sigma_m:g} m, {reach} samples on either side along an axis of {count}"
                raise InvalidArgument("shading sigma_m", found, f"up to {MAX_WEIGHTS} weights in all")
            taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) * spacing / self.sigma_m) ** 2)
            weights = np.ascontiguousarray(np.broadcast_to(taps.astype(np.float32), (count, len(taps))))
            made.append(AxisWeights(np.arange(-reach, count - reach), weights))
        return (made[0], made[1], made[2])


FILTER = ShadingFilter


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


def _smoothed(field: ForceField, vectors: Float32s, tables: Tables, bricks: NDArray[np.int32]) -> Float32s:
    """Weighted sums of vectors that lie in the bricks of the field, in `bricks`, float32 [n, 8, 8, 8, 3]."""
    from touchfield.filters.kernels import resample as kernels

    keys = brick_keys(field.grid, field.bricks)
    firsts = (tables[0].first, tables[1].first, tables[2].first)
    weights = (tables[0].weights, tables[1].weights, tables[2].weights)
    return kernels.resampled(bricks, field.grid.shape, keys, frozen(vectors), firsts, weights)[0]


def _whole_weights(tables: Tables, bricks: NDArray[np.int32]) -> Float64s:
    """The sum of all weights that lie within the grid, at each sample of the bricks, float64 [n, 8, 8, 8]."""
    sums = []
    for axis, table in enumerate(tables):
        count = len(table.first)
        places = table.first[:, None] + np.arange(table.taps)
        within = np.where((places >= 0) & (places < count), table.weights, 0).sum(axis=1, dtype=np.float64)
        padded = np.concatenate([within, np.ones(-count % BRICK)])
        sums.append(padded.reshape(-1, BRICK)[bricks[:, axis]])
    x, y, z = sums
    whole: Float64s = x[:, :, None, None] * y[:, None, :, None] * z[:, None, None, :]
    return whole
