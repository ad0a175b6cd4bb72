"""Level of detail: a pyramid of fields, each of half the resolution along every axis (paper section 4).

Level 0 is the field. Each next level is the one before through a low-pass and decimation by 2 on a grid of its own,
whose cells are two of the finer one along each axis. What lies beyond a grid counts as zero (`resample`), so that a
force at the border of the workspace fades by a cell or two at every level.

`touchfield.filters.multiresolution` keeps the lattice and drops the details; here the lattice itself gets smaller,
and the samples with it.
"""

from __future__ import annotations

from touchfield.errors import InvalidArgument
from touchfield.filters.interpolate import interpolated
from touchfield.filters.resample import LowPass, resample
from touchfield.medium import ForceField, Grid

__all__ = ["halved", "most_levels", "pyramid", "rebuilt"]


def halved(grid: Grid) -> Grid:
    """The grid whose cells are two cells of `grid` along each axis; an axis of one sample stays.

    With an odd number of samples the last cell reaches one spacing beyond the finer grid.
    """
    shape, spacing, origin = [], [], []
    for n, h, o in zip(grid.shape, grid.spacing_m, grid.origin_m, strict=True):
        shape.append(n if n == 1 else -(-n // 2))
        spacing.append(h if n == 1 else 2 * h)
        origin.append(o if n == 1 else o + h / 2)
    return Grid((shape[0], shape[1], shape[2]), _three(spacing), _three(origin))


def most_levels(grid: Grid) -> int:
    """How often a grid can be halved until one sample is left."""
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


def _three(values: list[float]) -> tuple[float, float, float]:
    return (values[0], values[1], values[2])
