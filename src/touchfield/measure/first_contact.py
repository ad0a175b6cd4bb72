"""What a hand would meet first that moves along a line of sight: the haptic medium as a picture (paper section 4).

To set a haptic medium beside a picture of the same scene, each pixel needs one number of the field. It is looked for
along a ray, in equal steps of at most half the finest spacing, at the lattice sample nearest to each step:

"first"   |F| of the first sample that holds a force;
"peak"    the largest |F| along the whole ray.

Of a wall that pushes back the more the deeper it is entered, |F| of the first sample tells mostly how far behind the
surface the lattice happened to be sampled; the peak tells how hard the wall can push.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.medium import ForceField

    Float64s = NDArray[np.float64]

__all__ = ["READINGS", "Contact", "contact_along_axis", "contact_along_rays"]

READINGS: Final = ("first", "peak")
MOST_LOOKUPS: Final = 1 << 31
_RAYS = 1 << 16  # at a time


@dataclass(frozen=True)
class Contact:
    """What the rays meet.

    Attributes
    ----------
    amplitudes_n : float64 [...]
        |F|, newtons; NaN where a ray meets no force.
    distances_m : float64 [...]
        From the start of the ray to that sample's step, metres; NaN likewise.
    """

    amplitudes_n: Float64s
    distances_m: Float64s


def contact_along_rays(field: ForceField, starts_m: ArrayLike, ends_m: ArrayLike, reading: str = "first") -> Contact:
    """Follow straight rays through a field.

    Parameters
    ----------
    field : ForceField
    starts_m, ends_m : float [..., 3]
        Of each ray, in the metres of the field, of shapes that broadcast: one start is a camera, many a plane.
    reading : {"first", "peak"}

    Returns
    -------
    Contact
        Of the shape of the rays.

    Raises
    ------
    InvalidArgument
        If a point is not finite, the shapes do not fit, the reading is unknown, or rays and steps are too many.
    """
    if reading not in READINGS:
        raise InvalidArgument("reading", repr(reading), f"one of {', '.join(READINGS)}")
    begin, end = (np.asarray(p, np.float64) for p in (starts_m, ends_m))
    try:
        shape = np.broadcast_shapes(begin.shape, end.shape)
    except ValueError:
        raise InvalidArgument("rays", f"shapes {begin.shape} and {end.shape}", "one shape [..., 3]") from None
    if not shape or shape[-1] != 3 or not math.prod(shape):
        raise InvalidArgument("rays", f"shape {shape}", "[..., 3], at least one")
    if not (np.isfinite(begin).all() and np.isfinite(end).all()):
        raise InvalidArgument("rays", "a point that is not finite", "metres")
    begin, end = (np.broadcast_to(p, shape).reshape(-1, 3) for p in (begin, end))
    longest = float(np.sqrt(((end - begin) ** 2).sum(axis=1)).max())
    steps = longest / (min(field.grid.spacing_m) / 2)
    if steps * len(begin) > MOST_LOOKUPS:
        raise InvalidArgument(
            "rays", f"{len(begin)} rays of {steps:.3g} steps", f"up to {MOST_LOOKUPS} steps in all",
            "Take fewer pixels, or shorter rays.",
        )  # fmt: skip
    looked_at = np.linspace(0.0, 1.0, 1 + math.ceil(steps))
    found, at = np.full(len(begin), np.nan), np.full(len(begin), np.nan)
    for b in range(0, len(begin), _RAYS):
        some = slice(b, b + _RAYS)
        found[some], at[some] = _followed(field, begin[some], end[some], looked_at, reading == "first")
    lengths = np.sqrt(((end - begin) ** 2).sum(axis=1))
    return Contact(found.reshape(shape[:-1]), (at * lengths).reshape(shape[:-1]))


def contact_along_axis(field: ForceField, axis: int = 2, from_low: bool = True, reading: str = "first") -> Contact:
    """Follow the columns of the lattice along x, y or z, from their low or their high end.

    Parameters
    ----------
    field : ForceField
    axis : int
        0, 1 or 2. In the axes of a camera the line of sight is z, from its low end.
    from_low : bool
    reading : {"first", "peak"}

    Returns
    -------
    Contact
        Of the shape of the other two axes, in order; distances from the first sample of the column.
    """
    if axis not in (0, 1, 2):
        raise InvalidArgument("axis", f"{axis}", "0, 1 or 2")
    grid = field.grid
    across = [np.arange(n) if a != axis else np.zeros(1, np.int64) for a, n in enumerate(grid.shape)]
    low = np.stack(np.meshgrid(*across, indexing="ij"), axis=-1)
    high = low.copy()
    high[..., axis] = grid.shape[axis] - 1
    ends = (grid.to_m(low), grid.to_m(high)) if from_low else (grid.to_m(high), grid.to_m(low))
    met = contact_along_rays(field, ends[0], ends[1], reading)
    return Contact(met.amplitudes_n.squeeze(axis), met.distances_m.squeeze(axis))


def _followed(
    field: ForceField, begin: Float64s, end: Float64s, looked_at: Float64s, first: bool
) -> tuple[Float64s, Float64s]:
    """|F| and the share of the way, float64 [n] each, NaN where there is none."""
    low, across = field.grid.to_index(begin), (end - begin) / np.asarray(field.grid.spacing_m)
    found, at = np.full(len(begin), np.nan), np.full(len(begin), np.nan)
    open_ = np.arange(len(begin))
    for share in looked_at.tolist():
        # ties to the lower sample, but for what rounding leaves of a column of the lattice
        index = np.ceil(low[open_] + share * across[open_] - 0.5 - 1e-9).astype(np.int64)
        amplitudes = _amplitudes_at(field, index)
        better = amplitudes > (0.0 if first else np.nan_to_num(found[open_]))
        found[open_[better]], at[open_[better]] = amplitudes[better], share
        if first:
            open_ = open_[~better]
            if not len(open_):
                break
    return found, at


def _amplitudes_at(field: ForceField, index: NDArray[np.int64]) -> Float64s:
    """|F| at lattice points, newtons, float64 [n], of int64 [n, 3]; 0 outside the grid."""
    found = np.zeros(len(index))
    inside = ((index >= 0) & (index < field.grid.shape)).all(axis=1)
    if not len(field.bricks) or not inside.any():
        return found
    places = index[inside]
    keys, wanted = brick_keys(field.grid, field.bricks), brick_keys(field.grid, places // BRICK)
    slot = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    x, y, z = (places % BRICK).T
    forces = field.forces_n[slot, x, y, z].astype(np.float64)
    found[inside] = np.where(keys[slot] == wanted, np.sqrt((forces**2).sum(axis=1)), 0.0)
    return found
