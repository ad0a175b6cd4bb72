"""Chooses the slice of a field that shows the most: a plane along which strong forces lie, where they vary.

Arrows can show only the part of a force that lies in the plane, |F| cos a. The axis across the slice is
therefore that of the plane with the largest sum of |F|^2 cos^4 a: large planes that most forces cross, such
as a level section of a terrain, count little. Of the planes across it, the one in which these parts vary the
most is chosen, which cuts the most surface.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s

_X, _Y, _Z = 0, 1, 2
_TOLERANCE: Final = 0.01  # sums that differ by less are equal
_PLANES: Final = ((_Y, _X, _Z), (_X, _Y, _Z), (_Z, _X, _Y))
"""Axis across each plane, in order of preference, and the horizontal and vertical axis of its picture."""


@dataclass(frozen=True)
class FieldSlice:
    """The samples of a field at one `index` along `axis`, shown with the axes `across` and `up`."""

    axis: int
    index: int
    across: int
    up: int

    def of(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the samples of the slice, [across, up, ...], of an array [x, y, z, ...]."""
        plane: NDArray[Any] = np.take(values, self.index, axis=self.axis)
        return plane if self.across < self.up else plane.swapaxes(0, 1)


def choose_slice(forces_n: Float32s, spacing_m: tuple[float, ...], axes: str = "") -> FieldSlice:
    """Return the slice that shows the most of the forces, float32 [nx, ny, nz, 3].

    `axes` names the direction of each axis, such as "x right, y down, z forward": one that points up or down
    is drawn vertically. A field of one sample along z is shown as it is. Of slices that show as much, the
    middle one is returned; of a field without forces, the middle one across y.
    """
    planes = [(_Z, _X, _Y)] if forces_n.shape[_Z] == 1 else _PLANES
    merits = np.array([_merit(forces_n, spacing_m, axis) for axis, _, _ in planes])
    axis, across, up = planes[int(np.argmax(merits >= (1 - _TOLERANCE) * merits.max()))]
    variations = _variations(forces_n, spacing_m, axis, (across, up))
    return _upright(FieldSlice(axis, _middle_of_best(variations), across, up), axes)


def largest_slice(samples: Bools, spacing_m: tuple[float, ...], axes: str = "") -> FieldSlice:
    """Return the slice with the largest area of the given samples, bool [nx, ny, nz]; see `choose_slice`."""
    areas = []
    for axis, *_ in _PLANES:
        others = tuple(n for n in range(3) if n != axis)
        areas.append(np.count_nonzero(samples, axis=others) * np.prod([spacing_m[n] for n in others]))
    chosen = int(np.argmax([area.max() for area in areas]))
    axis, across, up = _PLANES[chosen]
    return _upright(FieldSlice(axis, _middle_of_best(areas[chosen]), across, up), axes)


def _merit(forces_n: Float32s, spacing_m: tuple[float, ...], axis: int) -> float:
    """Return the largest sum of |F|^2 cos^4 a in a plane across an axis, times its area, N^2 m^2."""
    squares = np.einsum("...c,...c->...", forces_n, forces_n)
    in_plane = squares - forces_n[..., axis] ** 2
    merit = np.divide(in_plane**2, squares, out=np.zeros_like(squares), where=squares > 0)
    others = tuple(n for n in range(3) if n != axis)
    sums = merit.sum(axis=others, dtype=np.float64)
    return float(sums.max() * np.prod([spacing_m[n] for n in others]))


def _variations(
    forces_n: Float32s, spacing_m: tuple[float, ...], axis: int, in_plane: tuple[int, int]
) -> Float64s:
    """Return the total variation of the forces' parts in each plane across an axis, N m, float64 [n]."""
    parts = forces_n[..., list(in_plane)]
    variations = np.zeros(forces_n.shape[axis])
    for along, other in (in_plane, in_plane[::-1]):
        steps_n = np.abs(np.diff(parts, axis=along)).sum(axis=-1)
        variations += spacing_m[other] * steps_n.sum(axis=in_plane, dtype=np.float64)
    return variations


def _middle_of_best(values: Float64s) -> int:
    best = np.flatnonzero(values >= (1 - _TOLERANCE) * values.max())
    return int(best[len(best) // 2])


def _upright(plane: FieldSlice, axes: str) -> FieldSlice:
    """Return a slice whose vertical axis is the one that points up or down by `axes`, if one does."""
    is_vertical = any(f"{'xyz'[plane.across]} {way}" in axes for way in ("up", "down"))
    return replace(plane, across=plane.up, up=plane.across) if is_vertical else plane


def supported_span(has_force: Bools, axis: int) -> slice:
    """Return the range of samples with forces along an axis, with a margin of a twentieth.

    Without forces it is the whole range.
    """
    others = tuple(n for n in range(has_force.ndim) if n != axis)
    indices, count = np.flatnonzero(has_force.any(axis=others)), has_force.shape[axis]
    if not len(indices):
        return slice(0, count)
    margin = 1 + (indices[-1] - indices[0]) // 20
    return slice(max(0, int(indices[0] - margin)), min(count, int(indices[-1] + margin + 1)))
