"""Regions in which an edit applies: boxes, balls, half-spaces, sets of voxels, ranges of force, and
combinations of them.

Lengths are in metres of the hand. ``a | b`` is the union of two regions, ``a & b`` their intersection, and
``~a`` the complement. Membership of a sample is exact. The distance, by which a feather fades, is the true
one for a shape and for a set of voxels. For a union it is the smaller of the two distances and for an
intersection the larger one, which at a corner is less than the true distance.

Forces rotate with a motion x -> R x + t: the moved field is F'(x) = R F(R^T (x - t)). A mirror image is
allowed, with det R = -1.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Bools, Float64s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import numbers_of

if TYPE_CHECKING:
    from touchfield.medium import ForceField, Grid


class Region(ABC):
    """A part of space, or of a field."""

    @property
    @abstractmethod
    def text(self) -> str:
        """A description of the region, for the provenance of an edit."""

    def holds(self, points_m: Float64s) -> Bools:
        """Return which of the points [..., 3] lie in the region, bool [...]."""
        return np.asarray(self.distance_m(points_m) <= 0)

    @abstractmethod
    def distance_m(self, points_m: Float64s) -> Float64s:
        """Return the distances of points [..., 3] from the region, metres, float64 [...]; negative inside."""

    def on(self, field: ForceField) -> Region:
        """Resolve the region in a field: a range of force becomes a set of that field's samples."""
        return self

    def __or__(self, other: Region) -> Region:
        return _Combined("or", (self, other))

    def __and__(self, other: Region) -> Region:
        return _Combined("and", (self, other))

    def __invert__(self) -> Region:
        return _Combined("not", (self,))


def weights(region: Region, points_m: Float64s, feather_m: float) -> Float64s:
    """Return 1 in the region, falling linearly to 0 at `feather_m` outside it, float64 [...]."""
    inside = region.holds(points_m)
    if feather_m == 0:
        return inside.astype(np.float64)
    faded = np.clip(1.0 - region.distance_m(points_m) / feather_m, 0.0, 1.0)
    return np.where(inside, 1.0, faded)


@dataclass(frozen=True)
class Everywhere(Region):
    """All of space."""

    @property
    def text(self) -> str:
        return "everywhere"

    def distance_m(self, points_m: Float64s) -> Float64s:
        return np.full(points_m.shape[:-1], -np.inf)


@dataclass(frozen=True)
class Box(Region):
    """The box between two corners, including its faces; a bound may be infinite.

    low_m, high_m : (float, float, float); corners, metres, ``low <= high``.
    Raises `InvalidArgument` if a bound is not a number, or the corners are the wrong way round.
    """

    low_m: tuple[float, float, float]
    high_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        for name in ("low_m", "high_m"):
            object.__setattr__(self, name, _point(f"box {name}", getattr(self, name), may_be_infinite=True))
        if any(low > high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise InvalidArgument(
                "box", f"low {self.low_m}, high {self.high_m}", "low <= high along each axis"
            )

    @property
    def text(self) -> str:
        return f"box {_metres(self.low_m)} to {_metres(self.high_m)}"

    def holds(self, points_m: Float64s) -> Bools:
        low, high = np.asarray(self.low_m), np.asarray(self.high_m)
        return np.asarray(((points_m >= low) & (points_m <= high)).all(axis=-1))

    def distance_m(self, points_m: Float64s) -> Float64s:
        excess = np.maximum(np.subtract(self.low_m, points_m), np.subtract(points_m, self.high_m))
        outside: Float64s = np.sqrt((np.maximum(excess, 0.0) ** 2).sum(axis=-1))
        inside: Float64s = np.minimum(excess.max(axis=-1), 0.0)
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
    def text(self) -> str:
        return f"ball {_metres(self.centre_m)} radius {self.radius_m:g} m"

    def distance_m(self, points_m: Float64s) -> Float64s:
        squares = ((points_m - np.asarray(self.centre_m)) ** 2).sum(axis=-1)
        return np.asarray(np.sqrt(squares) - self.radius_m)


@dataclass(frozen=True)
class HalfSpace(Region):
    """The side of a plane that `normal` points to, including the plane.

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
    def text(self) -> str:
        return f"half-space {_metres(self.normal)} from {_metres(self.through_m)}"

    def distance_m(self, points_m: Float64s) -> Float64s:
        return np.asarray((np.asarray(self.through_m) - points_m) @ np.asarray(self.normal))


@dataclass(frozen=True, eq=False)
class Voxels(Region):
    """Samples of a lattice, by their indices; a point belongs to its nearest sample.

    grid : Grid; of the fields to be edited.
    positions : int [m, 3]; in any order, with or without repetitions.
    Raises `InvalidArgument` if they are not whole numbers within the grid; from `on`, if a field has another
    grid.
    """

    grid: Grid
    positions: ArrayLike

    def __post_init__(self) -> None:
        array = np.asarray(self.positions)
        if array.size and (array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu"):
            raise InvalidArgument("voxels", f"{array.dtype} {array.shape}", "whole numbers [m, 3]")
        p = array.reshape(-1, 3).astype(np.int64)
        if len(p) and (p.min() < 0 or (p.max(axis=0) >= self.grid.shape).any()):
            raise InvalidArgument("voxels", "an index outside the grid", f"below {self.grid.shape}")
        object.__setattr__(self, "positions", p)

    @property
    def text(self) -> str:
        return f"{np.count_nonzero(self._mask)} voxels"

    def on(self, field: ForceField) -> Region:
        if field.grid != self.grid:
            raise InvalidArgument(
                "region of voxels", f"a field on {field.grid}", f"the region's own {self.grid}"
            )
        return self

    def holds(self, points_m: Float64s) -> Bools:
        index = np.rint(self.grid.to_index(points_m))
        is_within: Bools = np.asarray(((index >= 0) & (index < self.grid.shape)).all(axis=-1))
        is_within[is_within] = self._mask[tuple(index[is_within].astype(np.int64).T)]
        return is_within

    def distance_m(self, points_m: Float64s) -> Float64s:
        is_within = self.holds(points_m)
        distance = np.full(points_m.shape[:-1], np.inf)
        for is_side, tree in zip((~is_within, is_within), self._trees, strict=True):
            if tree is not None and is_side.any():
                distance[is_side] = tree.query(points_m[is_side])[0]
        return np.where(is_within, -distance, distance)

    @cached_property
    def _mask(self) -> Bools:
        """The samples of the set, bool of the grid's shape."""
        mask = np.zeros(self.grid.shape, np.bool_)
        mask[tuple(np.asarray(self.positions).T)] = True
        return mask

    @cached_property
    def _trees(self) -> tuple[Any, Any]:
        """Trees of the set's samples with a neighbour outside, and of those neighbours; None for none.

        The sample of the set nearest to a sample outside is in the first tree, and vice versa.
        """
        from scipy.ndimage import binary_dilation
        from scipy.spatial import cKDTree

        shells = binary_dilation(~self._mask) & self._mask, binary_dilation(self._mask) & ~self._mask
        first, second = (cKDTree(self.grid.to_m(np.argwhere(s))) if s.any() else None for s in shells)
        return first, second


@dataclass(frozen=True)
class ForceRange(Region):
    """The samples of the edited field whose |F| is `low_n` to `high_n`; low_n = 0 includes empty space.

    Raises `InvalidArgument` if the range is empty or a bound is negative.
    """

    low_n: float
    high_n: float = math.inf

    def __post_init__(self) -> None:
        if not 0 <= self.low_n <= self.high_n:
            raise InvalidArgument("force range", f"{self.low_n} to {self.high_n} N", "0 <= low_n <= high_n")

    @property
    def text(self) -> str:
        return f"|F| of {self.low_n:g} to {self.high_n:g} N"

    def on(self, field: ForceField) -> Region:
        vectors = field.vectors_n().astype(np.float64)
        amplitudes = np.sqrt((vectors**2).sum(axis=1))
        within = (amplitudes >= self.low_n) & (amplitudes <= self.high_n)
        if self.low_n > 0:
            return Voxels(field.grid, field.positions()[within])
        return ~Voxels(field.grid, field.positions()[~within])

    def distance_m(self, points_m: Float64s) -> Float64s:
        raise InvalidArgument(
            self.text, "no field to look at", "a field", "Ask the region that on(field) gives."
        )


_CONTAINS: Final[dict[str, Any]] = {"or": np.logical_or, "and": np.logical_and, "not": np.logical_not}
_DISTANCE: Final[dict[str, Any]] = {"or": np.minimum, "and": np.maximum, "not": np.negative}


@dataclass(frozen=True)
class _Combined(Region):
    """The union or the intersection of two regions, or the complement of one."""

    mode: str
    regions: tuple[Region, ...]

    @property
    def text(self) -> str:
        texts = [f"({region.text})" for region in self.regions]
        return f"not {texts[0]}" if self.mode == "not" else f" {self.mode} ".join(texts)

    def on(self, field: ForceField) -> Region:
        return _Combined(self.mode, tuple(region.on(field) for region in self.regions))

    def holds(self, points_m: Float64s) -> Bools:
        return np.asarray(_CONTAINS[self.mode](*(region.holds(points_m) for region in self.regions)))

    def distance_m(self, points_m: Float64s) -> Float64s:
        return np.asarray(_DISTANCE[self.mode](*(region.distance_m(points_m) for region in self.regions)))


_ORTHOGONAL: Final = 1e-9
_ROUNDING: Final = 1e-12  # the sine of half a turn is 1e-16

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class RigidMotion:
    """x -> R x + t.

    matrix : three rows of three; R, orthogonal.
    offset_m : (float, float, float); t, metres.
    Raises `InvalidArgument` if R is not orthogonal or a number is not finite.
    """

    matrix: tuple[Triple, Triple, Triple] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    offset_m: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        r, t = np.asarray(self.matrix, np.float64), np.asarray(self.offset_m, np.float64)
        if r.shape != (3, 3) or not np.isfinite(r).all() or np.abs(r @ r.T - np.eye(3)).max() > _ORTHOGONAL:
            raise InvalidArgument("rigid motion matrix", repr(self.matrix), "an orthogonal 3 x 3 matrix")
        if t.shape != (3,) or not np.isfinite(t).all():
            raise InvalidArgument(
                "rigid motion offset_m", repr(self.offset_m), "three finite coordinates in metres"
            )
        r = np.where(np.abs(r - np.rint(r)) < _ROUNDING, np.rint(r), r) + 0.0
        object.__setattr__(self, "matrix", tuple(tuple(row) for row in r.tolist()))
        object.__setattr__(self, "offset_m", tuple(t.tolist()))

    @classmethod
    def move(cls, offset_m: ArrayLike) -> RigidMotion:
        """A move by `offset_m`, metres [3]."""
        return cls(offset_m=_point("motion offset_m", np.asarray(offset_m)))

    @classmethod
    def turn(cls, axis: ArrayLike, angle_deg: float, about_m: ArrayLike = (0.0, 0.0, 0.0)) -> RigidMotion:
        """A rotation by the right-hand rule about the axis through `about_m` in direction `axis`."""
        x, y, z = _unit("turn axis", axis)
        angle = math.radians(angle_deg)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        return cls._about(
            np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross), about_m
        )

    @classmethod
    def mirror(cls, normal: ArrayLike, through_m: ArrayLike = (0.0, 0.0, 0.0)) -> RigidMotion:
        """The mirror image in the plane through `through_m` that is normal to `normal`."""
        n = _unit("mirror normal", normal)
        return cls._about(np.eye(3) - 2 * np.outer(n, n), through_m)

    @classmethod
    def _about(cls, matrix: Any, fixed_m: ArrayLike) -> RigidMotion:
        fixed, rotation = (
            _point("point of a rigid motion", np.asarray(fixed_m)),
            np.asarray(cls(matrix).matrix),
        )
        offset: Any = fixed - rotation @ fixed
        return cls(matrix, offset)

    @property
    def text(self) -> str:
        """The motion, for the provenance of an edit."""
        return f"R {[list(row) for row in self.matrix]}, t {list(self.offset_m)} m"

    def followed_by(self, second: RigidMotion) -> RigidMotion:
        """Return this motion followed by another."""
        r: Any = np.asarray(second.matrix)
        return RigidMotion(
            r @ np.asarray(self.matrix), r @ np.asarray(self.offset_m) + np.asarray(second.offset_m)
        )

    @property
    def inverse(self) -> RigidMotion:
        """The inverse motion."""
        r: Any = np.asarray(self.matrix).T
        return RigidMotion(r, -(r @ np.asarray(self.offset_m)))

    def points_m(self, points_m: ArrayLike) -> Float64s:
        """Move points [..., 3], metres."""
        return np.asarray(self.vectors(points_m) + np.asarray(self.offset_m))

    def vectors(self, vectors: ArrayLike) -> Float64s:
        """Rotate vectors [..., 3], such as forces."""
        return np.asarray(np.asarray(vectors, np.float64) @ np.asarray(self.matrix).T)


def _unit(where: str, values: ArrayLike) -> Float64s:
    v = numbers_of(where, values)
    length = float(np.sqrt((v * v).sum())) if v.shape == (3,) else math.nan
    if not (0 < length < math.inf):
        raise InvalidArgument(where, repr(values), "three finite numbers, not all 0")
    return np.asarray(v / length)


def _point(where: str, point: Any, may_be_infinite: bool = False) -> tuple[float, float, float]:
    values = numbers_of(where, point).tolist()
    if np.shape(point) != (3,) or any(
        math.isnan(v) or (math.isinf(v) and not may_be_infinite) for v in values
    ):
        raise InvalidArgument(
            where, repr(point), "three numbers" if may_be_infinite else "three finite numbers"
        )
    return (values[0], values[1], values[2])


def _metres(point: tuple[float, float, float]) -> str:
    return "(" + ", ".join(f"{v:g}" for v in point) + ")"
