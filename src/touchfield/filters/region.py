"""Where an edit acts: boxes, balls, half-spaces, sets of voxels, ranges of force, and what is made of them.

Lengths are metres of the hand. ``a | b`` is the union of two regions, ``a & b`` what they share, and ``~a`` all that
is not in `a`. A region knows its samples exactly. Its distance, by which a feather fades, is the true one of a shape
and of a set of voxels; of a union it is the smaller of the two and of an intersection the larger, which at a corner
is less than the true one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Bools, Float64s, Int64s
from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from touchfield.medium import ForceField, Grid


class Region(ABC):
    """A part of space, or of a field."""

    @property
    @abstractmethod
    def words(self) -> str:
        """The region in words, for the provenance of an edit."""

    def holds(self, points_m: Float64s) -> Bools:
        """Tell which of the points [..., 3] lie in the region, bool [...]."""
        return np.asarray(self.distance_m(points_m) <= 0)

    @abstractmethod
    def distance_m(self, points_m: Float64s) -> Float64s:
        """The distances of points [..., 3] from the region, metres, float64 [...]; negative within."""

    def on(self, field: ForceField) -> Region:
        """The region as it lies in a field: a range of force is then a set of that field's samples."""
        return self

    def __or__(self, other: Region) -> Region:
        return _Pair(self, other, True)

    def __and__(self, other: Region) -> Region:
        return _Pair(self, other, False)

    def __invert__(self) -> Region:
        return _Complement(self)


def weights(region: Region, points_m: Float64s, feather_m: float) -> Float64s:
    """1 in the region, 0 from `feather_m` outside it on, and a straight line between, float64 [...]."""
    inside = region.holds(points_m)
    if feather_m == 0:
        return inside.astype(np.float64)
    faded = np.clip(1.0 - region.distance_m(points_m) / feather_m, 0.0, 1.0)
    return np.where(inside, 1.0, faded)


@dataclass(frozen=True)
class Everywhere(Region):
    """All of space."""

    @property
    def words(self) -> str:
        return "everywhere"

    def distance_m(self, points_m: Float64s) -> Float64s:
        return np.full(points_m.shape[:-1], -np.inf)


@dataclass(frozen=True)
class Box(Region):
    """The box between two corners, its faces with it; a bound may be infinite.

    low_m, high_m : (float, float, float); corners, metres, ``low <= high``.
    Raises `InvalidArgument` if a bound is not a number, or the corners are the wrong way round.
    """

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name in ("low_m", "high_m"):
            object.__setattr__(self, name, _point(f"box {name}", getattr(self, name), may_be_infinite=True))
        if any(low > high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise InvalidArgument("box", f"low {self.low_m}, high {self.high_m}", "low <= high along each axis")

    @property
    def words(self) -> str:
        return f"box {_metres(self.low_m)} to {_metres(self.high_m)}"

    def holds(self, points_m: Float64s) -> Bools:
        low, high = np.asarray(self.low_m), np.asarray(self.high_m)
        return np.asarray(((points_m >= low) & (points_m <= high)).all(axis=-1))

    def distance_m(self, points_m: Float64s) -> Float64s:
        beyond = np.maximum(np.subtract(self.low_m, points_m), np.subtract(points_m, self.high_m))
        outside: Float64s = np.sqrt((np.maximum(beyond, 0.0) ** 2).sum(axis=-1))
        inside: Float64s = np.minimum(beyond.max(axis=-1), 0.0)
        return outside + inside


@dataclass(frozen=True)
class Ball(Region):
    """The points up to `radius_m` from a centre.

    Raises `InvalidArgument` if the centre is not finite or the radius is negative.
    """

    centre_m: tuple[float, float, float]
    radius_m: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_m", _point("ball centre_m", self.centre_m))
        if not self.radius_m >= 0:
            raise InvalidArgument("ball radius_m", repr(self.radius_m), "a length of 0 or more")

    @property
    def words(self) -> str:
        return f"ball {_metres(self.centre_m)} radius {self.radius_m:g} m"

    def distance_m(self, points_m: Float64s) -> Float64s:
        squares = ((points_m - np.asarray(self.centre_m)) ** 2).sum(axis=-1)
        return np.asarray(np.sqrt(squares) - self.radius_m)


@dataclass(frozen=True)
class HalfSpace(Region):
    """The side of a plane that `normal` points to, the plane with it.

    normal : (float, float, float); of any length but 0.
    through_m : (float, float, float); a point of the plane, metres.
    Raises `InvalidArgument` if the normal has no direction or a number is not finite.
    """

    normal: tuple[float, float, float]
    through_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        x, y, z = _point("half-space normal", self.normal)
        length = math.hypot(x, y, z)
        if not length > 0:
            raise InvalidArgument("half-space normal", repr(self.normal), "a direction")
        object.__setattr__(self, "normal", (x / length, y / length, z / length))
        object.__setattr__(self, "through_m", _point("half-space through_m", self.through_m))

    @property
    def words(self) -> str:
        return f"half-space {_metres(self.normal)} from {_metres(self.through_m)}"

    def distance_m(self, points_m: Float64s) -> Float64s:
        return np.asarray((np.asarray(self.through_m) - points_m) @ np.asarray(self.normal))


@dataclass(frozen=True, eq=False)
class Voxels(Region):
    """Samples of a lattice, by their indices; a point belongs to its nearest sample.

    grid : Grid; of the fields to be edited.
    positions : int [m, 3]; in any order and perhaps several times.
    Raises `InvalidArgument` if they are not whole numbers within the grid; from `on`, if a field has another grid.
    """

    grid: Grid
    positions: ArrayLike

    def __post_init__(self) -> None:
        given = np.asarray(self.positions)
        if given.size and (given.ndim != 2 or given.shape[1] != 3 or given.dtype.kind not in "iu"):
            raise InvalidArgument("voxels", f"{given.dtype} {given.shape}", "whole numbers [m, 3]")
        p = given.reshape(-1, 3).astype(np.int64)
        if len(p) and (p.min() < 0 or (p.max(axis=0) >= self.grid.shape).any()):
            raise InvalidArgument("voxels", "an index outside the grid", f"below {self.grid.shape}")
        object.__setattr__(self, "positions", p)

    @property
    def words(self) -> str:
        return f"{len(self._places)} voxels"

    def on(self, field: ForceField) -> Region:
        if field.grid != self.grid:
            raise InvalidArgument("region of voxels", f"a field on {field.grid}", f"the region's own {self.grid}")
        return self

    def holds(self, points_m: Float64s) -> Bools:
        index = np.rint(self.grid.to_index(points_m))
        is_within: Bools = np.asarray(((index >= 0) & (index < self.grid.shape)).all(axis=-1))
        is_within[is_within] = self._among(index[is_within].astype(np.int64))
        return is_within

    def distance_m(self, points_m: Float64s) -> Float64s:
        is_within = self.holds(points_m)
        distance = np.full(points_m.shape[:-1], np.inf)
        for which, tree in zip((~is_within, is_within), self._trees, strict=True):
            if tree is not None and which.any():
                distance[which] = tree.query(points_m[which])[0]
        return np.where(is_within, -distance, distance)

    @cached_property
    def _places(self) -> Int64s:
        """The samples in raster order (x slowest), each once."""
        return np.unique(np.ravel_multi_index(tuple(np.asarray(self.positions).T), self.grid.shape))

    def _among(self, positions: Int64s) -> Bools:
        if not len(self._places):
            return np.zeros(len(positions), np.bool_)
        places = np.ravel_multi_index(tuple(positions.T), self.grid.shape)
        slot = np.minimum(np.searchsorted(self._places, places), len(self._places) - 1)
        return np.asarray(self._places[slot] == places)

    @cached_property
    def _trees(self) -> tuple[Any, Any]:
        """Of the samples of the set that have a neighbour outside, and of those neighbours; None for none.

        The sample of the set nearest to one outside is among the first, and the other way round.
        """
        from scipy.spatial import cKDTree

        positions = np.stack(np.unravel_index(self._places, self.grid.shape), axis=1)
        edge = np.zeros(len(positions), np.bool_)
        outside = [positions[:0]]
        for axis in range(3):
            for step in (-1, 1):
                beside = positions.copy()
                beside[:, axis] += step
                free = (beside[:, axis] >= 0) & (beside[:, axis] < self.grid.shape[axis])
                free[free] = ~self._among(beside[free])
                edge |= free
                outside.append(beside[free])
        shells = (positions[edge], np.unique(np.concatenate(outside), axis=0))
        first, second = (cKDTree(self.grid.to_m(s)) if len(s) else None for s in shells)
        return first, second


@dataclass(frozen=True)
class ForceRange(Region):
    """The samples of the edited field whose |F| lies from `low_n` to `high_n`; with low_n = 0 empty space, too.

    Raises `InvalidArgument` if the range is empty or a bound is negative.
    """

    low_n: float
    high_n: float = math.inf

    def __post_init__(self) -> None:
        if not 0 <= self.low_n <= self.high_n:
            raise InvalidArgument("force range", f"{self.low_n} to {self.high_n} N", "0 <= low_n <= high_n")

    @property
    def words(self) -> str:
        return f"|F| of {self.low_n:g} to {self.high_n:g} N"

    def on(self, field: ForceField) -> Region:
        vectors = field.vectors_n().astype(np.float64)
        amplitudes = np.sqrt((vectors**2).sum(axis=1))
        within = (amplitudes >= self.low_n) & (amplitudes <= self.high_n)
        if self.low_n > 0:
            return Voxels(field.grid, field.positions()[within])
        return ~Voxels(field.grid, field.positions()[~within])

    def distance_m(self, points_m: Float64s) -> Float64s:
        raise InvalidArgument(self.words, "no field to look at", "a field", "Ask the region that on(field) gives.")


@dataclass(frozen=True)
class _Pair(Region):
    """The union of two regions, or what they share."""

    first: Region
    second: Region
    is_union: bool

    @property
    def words(self) -> str:
        return f"({self.first.words}) {'or' if self.is_union else 'and'} ({self.second.words})"

    def on(self, field: ForceField) -> Region:
        return _Pair(self.first.on(field), self.second.on(field), self.is_union)

    def holds(self, points_m: Float64s) -> Bools:
        first, second = self.first.holds(points_m), self.second.holds(points_m)
        return first | second if self.is_union else first & second

    def distance_m(self, points_m: Float64s) -> Float64s:
        nearer: Any = np.minimum if self.is_union else np.maximum
        return np.asarray(nearer(self.first.distance_m(points_m), self.second.distance_m(points_m)))


@dataclass(frozen=True)
class _Complement(Region):
    region: Region

    @property
    def words(self) -> str:
        return f"not ({self.region.words})"

    def on(self, field: ForceField) -> Region:
        return _Complement(self.region.on(field))

    def holds(self, points_m: Float64s) -> Bools:
        return ~self.region.holds(points_m)

    def distance_m(self, points_m: Float64s) -> Float64s:
        return -self.region.distance_m(points_m)


def _point(where: str, given: Any, may_be_infinite: bool = False) -> tuple[float, float, float]:
    values = tuple(float(v) for v in given) if isinstance(given, Sequence | np.ndarray) else ()
    if len(values) != 3 or any(math.isnan(v) or (math.isinf(v) and not may_be_infinite) for v in values):
        raise InvalidArgument(where, repr(given), "three numbers" if may_be_infinite else "three finite numbers")
    return (values[0], values[1], values[2])


def _metres(point: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in point) + ")"
