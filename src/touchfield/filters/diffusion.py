"""Anisotropic diffusion: force shading that smooths within surfaces and stops at edges (paper section 3.2).

Perona and Malik, "Scale-space and edge detection using anisotropic diffusion", IEEE PAMI 12(7), 1990, equations 7 to
9, for vectors. In each step a sample takes from each neighbour j along the axes ::

    F_i  <-  F_i + sum_j lambda_ij g(|F_j - F_i|) (F_j - F_i)
    g(d) = exp(-(d/kappa)^2)   "exponential", keeps high edges       g(d) = 1/(1 + (d/kappa)^2)   "rational"

with one conductance g for the three components, of the length of the vector difference along the edge: a change of
direction is an edge as much as a change of amplitude, and turning the axes of the force changes nothing.

What follows from it. The flux of an edge leaves one side and enters the other, so that the sum of the forces stays.
A new force is a mean of old ones with weights that are not negative and sum to 1 as long as lambda <= 1/(2 axes), so
that no component and no |F| exceeds what was there (to float32 rounding). At that limit a checkerboard changes its
sign in each step and never fades; the default lambda = 1/(2 axes + 1) gives the sample itself the weight of a
neighbour. With g = 1 (kappa = inf) n steps blur as a Gaussian of sigma = spacing sqrt(2 lambda n).

Spacings that differ. The flux is that of a diffusion in metres: lambda along an axis is (finest spacing / spacing)^2
of the lambda asked for, and the blur is the same number of metres along each axis. kappa is not divided by the
spacing, as image libraries do: a contact is a jump of so many newtons however far apart the samples are.

Nothing crosses the border of the grid. With the region "support", the default, nothing crosses the edge of the
support either: walls stay where they are, and empty space does not wear them away. With "all" empty space is force 0
like another; walls bleed into it where they are weaker than kappa, one sample further in each step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.separable import within_grid
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys, bricks_of, dilated, neighbour_slots

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

CONDUCTANCES: Final = ("exponential", "rational")
REGIONS: Final = ("support", "all")

MAX_STEPS: Final = 10_000
_LEAST_KAPPA: Final = 1e-30
_MOST: Final = 1e37
"""Beyond, the difference of two float32 values may not be one."""


@dataclass(frozen=True)
class DiffusionFilter(FieldFilter):
    """Perona-Malik diffusion of a force field.

    kappa_n : float; newtons: of a force difference to the next sample well below it little is left, well above it is
        an edge. inf makes every conductance 1.
    steps : int; 1 to 10000.
    lam : float, optional; lambda along the axis with the finest spacing, above 0, at most 1/6; by default 1/7.
    conductance : str; "exponential" or "rational".
    region : str; "support": forces are exchanged within the support only. "all": empty space takes part.
    Raises `InvalidArgument` if a value is out of range; on a call, if the forces are too great for float32.
    """

    kappa_n: float
    steps: int = 10
    lam: float | None = None
    conductance: str = "exponential"
    region: str = "support"

    name: ClassVar[str] = "perona-malik"
    summary: ClassVar[str] = "smooth within surfaces and keep edges, steps=10,kappa=0.3 (newtons)"
    example: ClassVar[str] = "steps=2,kappa=0.3"

    def __post_init__(self) -> None:
        _check(self.steps, self.kappa_n, self.conductance)
        _lambda(self.lam, 3)
        if self.region not in REGIONS:
            raise InvalidArgument("perona-malik region", repr(self.region), " or ".join(REGIONS))

    def claims(self, grid: Grid) -> Claims:
        """One sample further in each step; linear only where neither the conductance nor the region depends on F."""
        x, y, z = (min(self.steps, n - 1) for n in grid.shape)
        return Claims(
            reach=(x, y, z),
            linear=self.kappa_n == np.inf and self.region == "all",
            dc_gain=1.0,
            keeps_mean=True,
            max_principle=True,
            keeps_support=self.region == "support",
        )

    def __call__(self, field: ForceField) -> ForceField:
        """The diffused field, newtons, on the same grid."""
        from touchfield.filters.kernels import steps as kernels

        _check_size("forces_n", field.forces_n)
        bricks, support = field.bricks, field.mask.copy()
        if self.region == "all":
            bricks = dilated(field.grid, field.bricks, self.claims(field.grid).reach)
            support = within_grid(field.grid, bricks)
        forces, out = zero_forces(len(bricks)), zero_forces(len(bricks))
        keys = brick_keys(field.grid, bricks)
        forces[np.searchsorted(keys, brick_keys(field.grid, field.bricks))] = field.forces_n
        slots = neighbour_slots(field.grid, bricks)
        law = self._weights(field.grid), float(self.kappa_n), self.conductance == "rational"
        for _ in range(self.steps):
            kernels.diffused_bricks(slots, support, forces, law, out)
            forces, out = out, forces
        return ForceField.from_bricks(field.grid, bricks, forces)

    def _weights(self, grid: Grid) -> tuple[float, float, float]:
        """lambda along each axis; an axis of one sample has no edges, and its spacing does not count."""
        finest = min((h for h, n in zip(grid.spacing_m, grid.shape) if n > 1), default=1.0)
        lam = _lambda(self.lam, 3)
        x, y, z = (lam * min(1.0, finest / h) ** 2 for h in grid.spacing_m)
        return (x, y, z)


def perona_malik(
    values: ArrayLike,
    *,
    steps: int,
    kappa_n: float,
    lam: float | None = None,
    conductance: str = "exponential",
    where: ArrayLike | None = None,
) -> NDArray[np.float32]:
    """Perona-Malik diffusion of a dense array, sample by sample; see the head of this module.

    values : float array [nx, ny, nz, 3], or [nx], [nx, ny] or [nx, ny, nz]; forces, newtons; or scalars of any unit.
        Taken as float32.
    steps : int; 1 to 10000.
    kappa_n : float; in the unit of the values; inf makes every conductance 1.
    lam : float, optional; lambda, above 0, at most 1/(2 axes), the stability limit; by default 1/(2 axes + 1). Axes
        are those of space.
    conductance : str; "exponential" or "rational".
    where : bool array of the shape of space, optional; the samples that take part, such as the support; the others
        keep their values, and nothing flows to or from them. By default all.
    Returns float32: Of the shape of `values`; the same bits for any number of threads.
    Raises `InvalidArgument` if a value is out of range or not finite, or shapes do not fit.
    """
    from touchfield.filters.kernels import steps as kernels

    _check(steps, kappa_n, conductance)
    given = np.array(values, np.float32)
    if given.size == 0 or given.ndim not in (1, 2, 3, 4) or (given.ndim == 4 and given.shape[3] != 3):
        raise InvalidArgument("values", f"shape {given.shape}", "[nx, ny, nz, 3], or scalars with one to three axes")
    _check_size("values", given)
    space = given.shape[:3]
    factor = _lambda(lam, len(space))
    mask = np.ones(space, np.bool_) if where is None else np.array(where)
    if mask.shape != space or mask.dtype != np.bool_:
        raise InvalidArgument("where", f"{mask.dtype} {mask.shape}", f"bool {space}")
    nx, ny, nz = lattice = (*space, *(1,) * (3 - len(space)))
    grid = Grid((nx, ny, nz), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    slots = neighbour_slots(grid, bricks_of(grid, np.arange(math.prod(grid.brick_shape))))
    support, forces = _tiled(mask.reshape(lattice)), zero_forces(len(slots))
    values_of = given.reshape(*lattice, -1)
    forces[..., : values_of.shape[3]] = _tiled(values_of)
    out = np.empty_like(forces)
    law = (factor, factor, factor), float(kappa_n), conductance == "rational"
    for _ in range(steps):
        kernels.diffused_bricks(slots, support, forces, law, out)
        forces, out = out, forces
    rows = np.moveaxis(forces.reshape(*grid.brick_shape, BRICK, BRICK, BRICK, 3), (1, 2), (2, 4))
    dense = rows.reshape(*(n * BRICK for n in grid.brick_shape), 3)[:nx, :ny, :nz, : values_of.shape[3]]
    return np.ascontiguousarray(dense).reshape(given.shape)


def _tiled(dense: NDArray[Any]) -> NDArray[Any]:
    """Every brick of an array [nx, ny, nz, ...], with zeros beyond its end, [n, 8, 8, 8, ...]."""
    beside = dense.shape[3:]
    padded = np.pad(dense, [*((0, -n % BRICK) for n in dense.shape[:3]), *((0, 0) for _ in beside)])
    x, y, z = (n // BRICK for n in padded.shape[:3])
    rows = np.moveaxis(padded.reshape(x, BRICK, y, BRICK, z, BRICK, *beside), (2, 4), (1, 2))
    return np.ascontiguousarray(rows).reshape(-1, BRICK, BRICK, BRICK, *beside)


def _check(steps: int, kappa_n: float, conductance: str) -> None:
    if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or not 1 <= steps <= MAX_STEPS:
        raise InvalidArgument("perona-malik steps", repr(steps), f"a whole number from 1 to {MAX_STEPS}")
    if not kappa_n >= _LEAST_KAPPA:
        raise InvalidArgument("perona-malik kappa_n", repr(kappa_n), f"newtons, {_LEAST_KAPPA:g} or more, or inf")
    if conductance not in CONDUCTANCES:
        raise InvalidArgument("perona-malik conductance", repr(conductance), " or ".join(CONDUCTANCES))


def _lambda(lam: float | None, axes: int) -> float:
    """lambda, or its default, if it is within the stability limit of so many axes."""
    if lam is None:
        return 1 / (2 * axes + 1)
    if not 0 < lam <= 1 / (2 * axes):
        raise InvalidArgument(
            "perona-malik lam", repr(lam), f"above 0 and at most 1/{2 * axes}, the stability limit of {axes} axes"
        )
    return float(lam)


def _check_size(what: str, values: NDArray[np.float32]) -> None:
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    if not (low >= -_MOST and high <= _MOST):  # also where one is NaN
        raise InvalidArgument(what, f"values from {low:g} to {high:g}", f"finite values up to {_MOST:g}")
