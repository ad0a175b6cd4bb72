"""Smooths how a surface feels: *force shading* smooths the direction of forces apart from their amplitude
(paper section 3.2); Perona-Malik diffusion smooths a field but keeps its edges.

The paper lists "off-line force shading" among the haptic filters and gives no formula. On-line it is the rule
of Morgenbesser and Srinivasan, "Force shading for haptic shape perception", 1996: the direction of the force
is interpolated over the facets of a coarse surface while its amplitude still tells how deep the hand is. Here
both are taken from the field itself, with the Gaussian weights w and the support S::

    u_i = sum_S w_ij F_j/|F_j|                      direction u_i / |u_i|
    a_i = sum_S w_ij |F_j| / sum_S w_ij             amplitude

Directions are unit vectors, independent of the amplitudes. The sums run over the support (a normalised
convolution, Knutsson and Westin 1993): empty space neither lowers forces nor blunts a contact. Where the
surrounding directions cancel, a sample keeps its own.

Diffusion: Perona and Malik, "Scale-space and edge detection using anisotropic diffusion", IEEE PAMI 12(7),
1990, equations 7 to 9, for vectors. In each step a sample takes from each neighbour j along the axes ::

    F_i  <-  F_i + sum_j lambda_ij g(|F_j - F_i|) (F_j - F_i)
    g(d) = exp(-(d/kappa)^2)

with one conductance g for the three components: a change of direction is an edge as much as one of amplitude.
The sum of the forces is preserved, and no |F| exceeds the input's maximum as long as lambda <= 1/(2 axes). At
that limit a checkerboard never fades, so lambda is 1/(2 axes + 1). With g = 1 (kappa = inf) n steps blur as a
Gaussian of sigma = spacing sqrt(2 lambda n). Where spacings differ, lambda along an axis is scaled by (finest
spacing / spacing)^2, a diffusion in metres; kappa is not divided by the spacing. There is no flux across the
border of the grid or the edge of the support.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Bools, Float32s, Int32s
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, require_one_of, require_positive
from touchfield.filters.fir import without_overflow
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.separable import AxisTaps, keys_of_passes, reach_of, sums_of_bricks
from touchfield.filters.smoothing import gaussian_taps
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import bricks_of, neighbour_slots, numbers_of, tiled

if TYPE_CHECKING:
    from touchfield.filters.separable import Axes

SMOOTHED: Final = ("both", "direction", "amplitude")
_CANCELLED: Final = 1e-4  # a mean of unit vectors shorter than this has no direction but that of rounding


@dataclass(frozen=True)
class ShadingFilter(FieldFilter):
    """Gaussian force shading.

    sigma_m : float; of the Gaussian, metres, cut off at 4 sigma. Facets vanish from about 0.4 of their edge
        on.
    smooth : str; "both"; "direction" keeps every amplitude, "amplitude" keeps every direction.
    Raises `InvalidArgument` if a value is out of range; on a call, if sigma reaches too many samples.
    """

    sigma_m: float
    smooth: str = "both"

    name: ClassVar[str] = "shading"
    summary: ClassVar[str] = (
        "smooth direction and amplitude apart within the support, 2mm or 2mm,smooth=direction"
    )
    example: ClassVar[str] = "2mm"

    def __post_init__(self) -> None:
        require_positive(**{"shading sigma_m": self.sigma_m})
        require_one_of("shading smooth", self.smooth, SMOOTHED)

    def claims(self, grid: Grid) -> Claims:
        """Not linear; a mean of amplitudes never exceeds the greatest of them."""
        return Claims(
            reach=reach_of(self._axes(grid)),
            dc_gain=1.0,
            max_principle=True,
            keeps_support=True,
            keeps_direction=self.smooth == "amplitude",
            keeps_amplitude=self.smooth == "direction",
        )

    def __call__(self, field: ForceField) -> ForceField:
        """The shaded field, newtons, on the same grid."""
        if not field.support_count:
            return field
        axes = self._axes(field.grid)
        forces_n = field.forces_n[field.mask].astype(np.float64)
        lengths_n = np.sqrt((forces_n * forces_n).sum(axis=1))
        scale_n = math.ldexp(1.0, math.frexp(float(lengths_n.max()))[1])
        # unit vectors, and (1, |F| / scale, 0), both zero outside the support
        directions, masses = zero_forces(len(field.bricks)), zero_forces(len(field.bricks))
        directions[field.mask] = field.forces_n[field.mask] / lengths_n[:, None]
        masses[field.mask, 0], masses[field.mask, 1] = 1, lengths_n / scale_n
        keys = keys_of_passes(field, axes)
        keys[3] = keys[0]  # bricks outside the support are not needed
        mean_masses, mean_directions = (
            sums_of_bricks(field.grid, v, axes, keys)[0] for v in (masses, directions)
        )
        support = field.mask
        weights = mean_masses[support][:, 0]
        if self.smooth != "direction":
            lengths_n = scale_n * mean_masses[support][:, 1].astype(np.float64) / weights
        unit = directions[support].astype(np.float64)
        if self.smooth != "amplitude":
            sums = mean_directions[support].astype(np.float64)
            lengths = np.sqrt((sums * sums).sum(axis=1))
            has_direction = lengths > _CANCELLED * weights
            unit[has_direction] = sums[has_direction] / lengths[has_direction, None]
        forces = zero_forces(len(field.bricks))
        forces[support] = unit * lengths_n[:, None]
        return ForceField.from_bricks(field.grid, field.bricks, forces)

    def _axes(self, grid: Grid) -> Axes:
        """The Gaussian along each axis, no longer than the grid is."""
        rows = []
        for count, spacing_m in zip(grid.shape, grid.spacing_m, strict=True):
            taps = gaussian_taps(self.sigma_m / spacing_m)
            excess = max(0, len(taps) // 2 - (count - 1))
            rows.append(AxisTaps(taps[excess : len(taps) - excess]))
        return rows[0], rows[1], rows[2]


MAX_STEPS: Final = 10_000
_MIN_KAPPA_N: Final = 1e-30


@dataclass(frozen=True)
class DiffusionFilter(FieldFilter):
    """Perona-Malik diffusion of a force field.

    kappa_n : float; newtons: differences between neighbours well below it are smoothed, those well above it
        are kept as edges. inf makes every conductance 1.
    steps : int; 1 to 10000.
    Raises `InvalidArgument` if a value is out of range; on a call, if the forces are too great for float32.
    """

    kappa_n: float
    steps: int = 10

    name: ClassVar[str] = "perona-malik"
    summary: ClassVar[str] = "smooth within surfaces and keep edges, steps=10,kappa=0.3 (newtons)"
    example: ClassVar[str] = "steps=2,kappa=0.3"

    def __post_init__(self) -> None:
        steps = self.steps
        if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or not 1 <= steps <= MAX_STEPS:
            raise InvalidArgument("perona-malik steps", repr(steps), f"a whole number from 1 to {MAX_STEPS}")
        if not self.kappa_n >= _MIN_KAPPA_N:
            expected = f"newtons, {_MIN_KAPPA_N:g} or more, or inf"
            raise InvalidArgument("perona-malik kappa_n", repr(self.kappa_n), expected)

    def claims(self, grid: Grid) -> Claims:
        """Reaches one sample further in each step, within the support."""
        x, y, z = (min(self.steps, n - 1) for n in grid.shape)
        return Claims(
            reach=(x, y, z),
            dc_gain=1.0,
            keeps_mean=True,
            max_principle=True,
            keeps_support=True,
        )

    def __call__(self, field: ForceField) -> ForceField:
        """The diffused field, newtons, on the same grid."""
        # an axis of one sample has no edges, and its spacing does not count
        finest = min((h for h, n in zip(field.grid.spacing_m, field.grid.shape) if n > 1), default=1.0)
        lam = [min(1.0, finest / h) ** 2 / 7 for h in field.grid.spacing_m]
        forces = _diffuse(field.grid, field.bricks, field.mask.copy(), field.forces_n.copy(), lam, self)
        return ForceField.from_bricks(field.grid, field.bricks, forces)


def perona_malik(
    values: ArrayLike, *, steps: int, kappa_n: float, where: ArrayLike | None = None
) -> Float32s:
    """Perona-Malik diffusion of a dense array; see the module docstring.

    values : float array [nx, ny, nz, 3], or [nx], [nx, ny] or [nx, ny, nz]; converted to float32.
    steps : int; 1 to 10000.
    kappa_n : float; in the unit of the values; inf makes every conductance 1.
    where : bool array of the shape of space, optional; the samples that take part, by default all. There is
        no flux to or from the others.
    Returns float32: Of the shape of `values`; the same bits for any number of threads.
    Raises `InvalidArgument` if a value is out of range or not finite, or shapes do not fit.
    """
    spec, array = DiffusionFilter(kappa_n, steps), numbers_of("values", values, np.float32, is_finite=True)
    if array.size == 0 or array.ndim not in (1, 2, 3, 4) or (array.ndim == 4 and array.shape[3] != 3):
        raise InvalidArgument(
            "values", f"shape {array.shape}", "[nx, ny, nz, 3], or scalars with one to three axes"
        )
    space = array.shape[:3]
    mask = np.ones(space, np.bool_) if where is None else np.array(where)
    if mask.shape != space or mask.dtype != np.bool_:
        raise InvalidArgument("where", f"{mask.dtype} {mask.shape}", f"bool {space}")
    nx, ny, nz = lattice = (*space, *(1,) * (3 - len(space)))
    grid = Grid((nx, ny, nz), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    bricks = bricks_of(grid, np.arange(math.prod(grid.brick_shape)))
    support, forces = tiled(mask.reshape(lattice)).reshape(-1, *[BRICK] * 3), zero_forces(len(bricks))
    values_of = array.reshape(*lattice, -1)
    forces[..., : values_of.shape[3]] = tiled(values_of).reshape(len(bricks), *[BRICK] * 3, -1)
    forces = _diffuse(grid, bricks, support, forces, [1 / (2 * len(space) + 1)] * 3, spec)
    rows = np.moveaxis(forces.reshape(*grid.brick_shape, BRICK, BRICK, BRICK, 3), (1, 2), (2, 4))
    dense = rows.reshape(*(n * BRICK for n in grid.brick_shape), 3)[:nx, :ny, :nz, : values_of.shape[3]]
    return np.ascontiguousarray(dense).reshape(array.shape)


def _diffuse(
    grid: Grid, bricks: Int32s, support: Bools, forces: Float32s, lam: list[float], spec: DiffusionFilter
) -> Float32s:
    """Run all steps for the samples in `support`, with lambda of each axis; `forces` are overwritten."""
    from touchfield.filters.kernels import steps as kernels

    slots = neighbour_slots(bricks, bricks, grid.brick_shape).astype(np.int32)
    count, out = len(bricks), zero_forces(len(bricks))
    x, y, z = (np.float32(part) for part in lam)
    numbers = (x, y, z), np.float32(1 / spec.kappa_n)
    mask = support.reshape(count, BRICK**3)
    for _ in range(spec.steps):
        flat, into = (array.reshape(count, BRICK**3, 3) for array in (forces, out))
        for_chunks(kernels.diffuse_bricks, count, slots, mask, flat, *numbers, into, chunk=32)
        forces, out = out, forces
    return without_overflow(forces, "perona-malik forces")
