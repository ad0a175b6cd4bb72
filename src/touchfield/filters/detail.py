"""Levels of detail: a pyramid of fields on ever coarser lattices (paper section 4), and multiresolution on one (3.2).

Level 0 of a pyramid is the field. Each next level is the one before through a low-pass and decimation by 2 on a grid
of its own, whose cells are two of the finer one along each axis. What lies beyond a grid counts as zero (`resample`),
so that a force at the border of the workspace fades by a cell or two at every level.

The multiresolution filter keeps the lattice: the field is taken down the FCC chain of `touchfield.filters.lifting` by
some stages, its details are put to zero, and it is rebuilt. A flat field, one sample deep, is lifted as a quincunx
image: of each three stages one finds nothing to drop, and the other two are those of the quincunx. The field stays
sparse, and no larger than its result: all is done in place, in the bricks that a force may reach. A site is computed
by the same sums as in a dense array, so that the result has the bits of `coarse_only`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.interpolate import interpolated
from touchfield.filters.lifting import FCC, Split, whole_stages
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.filters.resample import LowPass, resample
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys
from touchfield.medium.neighbours import dilated, neighbour_slots

if TYPE_CHECKING:
    from numpy.typing import NDArray


def halved(grid: Grid) -> Grid:
    """The grid whose cells are two cells of `grid` along each axis; an axis of one sample stays.

    With an odd number of samples the last cell reaches one spacing beyond the finer grid.
    """
    wide = [n > 1 for n in grid.shape]
    nx, ny, nz = (-(-n // 2) for n in grid.shape)
    x, y, z = (h * (1 + w) for h, w in zip(grid.spacing_m, wide, strict=True))
    a, b, c = (o + h / 2 * w for o, h, w in zip(grid.origin_m, grid.spacing_m, wide, strict=True))
    return Grid((nx, ny, nz), (x, y, z), (a, b, c))


def most_levels(grid: Grid) -> int:
    """The number of halvings of a grid until one sample is left."""
    return (max(grid.shape) - 1).bit_length()


def pyramid(field: ForceField, levels: int, kernel: str | LowPass = "spline") -> tuple[ForceField, ...]:
    """The levels of detail of a field, the finest first.

    levels : int; how often it is halved, 0 to `most_levels`.
    kernel : str or LowPass; the low-pass, its cut-off the Nyquist rate of the coarser grid; "box" is the mean of each
        cell.
    Returns tuple of ForceField: `levels` + 1 fields; level l has 1/8 of the samples of level l - 1. Linear in the
    field.
    Raises `InvalidArgument` if the grid cannot be halved so often, or the kernel is unknown.
    """
    most = most_levels(field.grid)
    if isinstance(levels, bool) or not isinstance(levels, int) or not 0 <= levels <= most:
        raise InvalidArgument("levels", repr(levels), f"0 to {most} for {field.grid.shape} samples")
    made = [field]
    for _ in range(levels):
        made.append(resample(made[-1], halved(made[-1].grid), kernel))
    return tuple(made)


def rebuilt(level: ForceField, grid: Grid) -> ForceField:
    """A level of detail as a receiver renders it: trilinear between its samples, at those of a finer grid."""
    return interpolated(level, grid, border="cell")


MAX_STAGES: Final = 12
"""Four octaves, a sixteenth of the resolution along each axis; one more would reach beyond the next brick."""


@dataclass(frozen=True)
class MultiresolutionFilter(FieldFilter):
    """The field at a coarser level of detail, on the same lattice.

    stages : int; 1 to 12; each halves the number of independent samples, three halve the resolution along each axis.
    keep : str; "coarse", the level of detail; or "details", the field less that, which is zero where the field is
        constant.
    Raises `InvalidArgument` if `stages` or `keep` is out of range.
    """

    name: ClassVar[str] = "multiresolution"
    summary: ClassVar[str] = "a level of detail by FCC lifting, three stages to half the resolution: stages=3"
    example: ClassVar[str] = "stages=3"

    stages: int = 3
    keep: str = "coarse"

    def __post_init__(self) -> None:
        whole_stages(self.stages, 1, MAX_STAGES)
        if self.keep not in ("coarse", "details"):
            raise InvalidArgument("keep", repr(self.keep), "coarse or details")

    def claims(self, grid: Grid) -> Claims:
        """Linear; a constant passes with gain 1 (as details: with 0), and the coarse field keeps the mean.

        Not invariant under a shift that moves the sublattice, and short filters overshoot at a contact: no maximum
        principle.
        """
        coarse = self.keep == "coarse"
        return Claims(_reach(self.stages, grid), linear=True, dc_gain=1.0 if coarse else 0.0, keeps_mean=coarse)

    def __call__(self, field: ForceField) -> ForceField:
        """See `FieldFilter`; the time goes with the number of bricks that a force may reach."""
        coarse = _coarse(field, self.stages)
        return coarse if self.keep == "coarse" else field + coarse.scaled(-1.0)


FILTER = MultiresolutionFilter


def _reach(stages: int, grid: Grid) -> tuple[int, int, int]:
    """The reach of a force, samples: each stage takes a coarse site two neighbours far, and back one."""
    far = [0, 0, 0]
    for split in FCC.splits(stages):
        for axis in range(3):
            if grid.shape[axis] > split.scale:
                far[axis] += 3 * split.scale * max(o[axis] for o in split.offsets)
    return (far[0], far[1], far[2])


def _coarse(field: ForceField, stages: int) -> ForceField:
    """The field without the details of its first `stages` stages."""
    grid = field.grid
    bricks = dilated(grid, field.bricks, _reach(stages, grid))
    forces = field.forces_at(brick_keys(grid, bricks))
    place = (bricks, neighbour_slots(grid, bricks), grid.shape)
    splits = FCC.splits(stages)
    for split in splits:
        _step(place, forces, split, "predict", 1.0, -1)
        _step(place, forces, split, "update", 1.0, 1)
    for split in reversed(splits):
        _step(place, forces, split, "predict", 0.0, 1)  # the prediction in place of the detail
    held = forces.any(axis=(1, 2, 3, 4))
    return ForceField(grid, bricks, forces) if held.all() else ForceField(grid, bricks[held], forces[held])


def _step(place: Any, forces: NDArray[np.float32], split: Split, kind: str, hold: float, sign: int) -> None:
    from touchfield.filters.kernels import lifting as kernels

    offsets = split.offsets_in(place[2])
    if not offsets:
        return
    starts = np.full((2, 2), -1, np.int64)
    for x, y, z in split.details if kind == "predict" else split.kept:
        starts[x, y] = z
    divisor = len(offsets) * (1 if kind == "predict" else 2)
    kernels.brick_step(place, forces, split.scale, (starts, np.array(offsets, np.int64)), (hold, sign / divisor))
