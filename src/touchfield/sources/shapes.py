"""Shapes with a formula: the signed distance to each, and its gradient, in float64.

Plane, sphere and box have exact closed forms (the box after Quilez, "distance functions", iquilezles.org). The
superquadric (Barr 1981) has none; its distance is the one to the tangent plane where the ray from the centre
leaves the surface: with the gauge g(x) = F(x)^(e1/2), which is homogeneous of degree one (Solina and Bajcsy
1990), it is Taubin's (1991) first-order distance (g - 1) / |grad g|. It is exact on the surface and for a
sphere, never more than the true distance outside, and never less deep than it inside. Round shapes, and shapes
after a rigid motion, are in `touchfield.sources.round_shapes`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = [
    "Box",
    "Plane",
    "Shape",
    "Sphere",
    "Superquadric",
    "Triple",
    "check_body",
    "check_positive",
    "check_triple",
    "rotation_matrix",
]

Triple = tuple[float, float, float]

_LEAST_M, _MOST_M = 1e-9, 1e9
"""Lengths that squares and products of them can be made of, and that a simulation can go on with."""


class Shape(ABC):
    """A solid with a signed distance, negative inside."""

    @abstractmethod
    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """Signed distance, metres, float64 [n], and outward unit normal, float64 [n, 3], at points [n, 3]."""

    @abstractmethod
    def box_m(self) -> Float64s:
        """The box of the surface, metres, float64 [2, 3]."""

    def distance_range(self, centres: Float64s, radius_m: float) -> tuple[Float64s, Float64s]:
        """Bounds, float64 [n] each, of the signed distance within `radius_m` of points [n, 3]."""
        phi, _ = self.signed_distance_and_normal(centres)
        return phi - radius_m, phi + radius_m


@dataclass(frozen=True)
class Plane(Shape):
    """All that lies behind a plane: exact.

    Parameters
    ----------
    point_m : (float, float, float); A point of the plane.
    normal : (float, float, float); Outwards, of any length.
    """

    point_m: Triple
    normal: Triple

    def __post_init__(self) -> None:
        check_triple("point_m", self.point_m)
        length = float(np.linalg.norm(check_triple("normal", self.normal)))
        if not length > 0:
            raise InvalidArgument("normal", repr(self.normal), "a direction, not zero")

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        normal = self._unit()
        phi = (points - np.asarray(self.point_m)) @ normal
        return phi, np.broadcast_to(normal, points.shape)

    def box_m(self) -> Float64s:
        """The box of a square of one metre around the point."""
        normal = self._unit()
        aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        aside /= np.linalg.norm(aside)
        reach = (np.abs(aside) + np.abs(np.cross(normal, aside))) / 2
        return np.stack([self.point_m - reach, self.point_m + reach])

    def _unit(self) -> Float64s:
        normal = np.asarray(self.normal, np.float64)
        normal = normal / np.abs(normal).max()  # so that no square overflows
        unit: Float64s = normal / np.linalg.norm(normal)
        return unit


@dataclass(frozen=True)
class Sphere(Shape):
    """A ball: exact; at its very centre the normal is +z."""

    center_m: Triple
    radius_m: float

    def __post_init__(self) -> None:
        check_triple("center_m", self.center_m)
        check_positive("radius_m", self.radius_m)

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        offset = points - np.asarray(self.center_m)
        length = np.sqrt((offset * offset).sum(axis=-1))
        normal = np.divide(offset, length[:, None], out=np.zeros_like(offset), where=length[:, None] > 0)
        normal[length == 0, 2] = 1.0
        return length - self.radius_m, normal

    def box_m(self) -> Float64s:
        """See `Shape`."""
        centre = np.asarray(self.center_m, np.float64)
        return np.stack([centre - self.radius_m, centre + self.radius_m])


@dataclass(frozen=True)
class Box(Shape):
    """A cuboid: exact; the normal within is that of the nearest face.

    Parameters
    ----------
    rotation_deg : (float, float, float); Turns about the fixed x, then y, then z axis, degrees.
    """

    center_m: Triple
    half_extents_m: Triple
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_body(self.center_m, self.half_extents_m, self.rotation_deg)

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        rotation = rotation_matrix(self.rotation_deg)
        local = (points - np.asarray(self.center_m)) @ rotation
        beyond = np.abs(local) - np.asarray(self.half_extents_m)
        outside = np.maximum(beyond, 0.0)
        distance = np.sqrt((outside * outside).sum(axis=-1))
        nearest = beyond.argmax(axis=-1)
        depth = np.take_along_axis(beyond, nearest[:, None], axis=-1)[:, 0]
        is_out = distance > 0
        direction = np.zeros_like(local)
        np.put_along_axis(direction, nearest[:, None], 1.0, axis=-1)
        direction[is_out] = outside[is_out] / distance[is_out, None]
        return np.where(is_out, distance, depth), np.copysign(direction, local) @ rotation.T

    def box_m(self) -> Float64s:
        """See `Shape`."""
        return _turned_box(self.center_m, self.half_extents_m, self.rotation_deg)


@dataclass(frozen=True)
class Superquadric(Shape):
    """((|x/a|^(2/e2) + |y/b|^(2/e2))^(e2/e1) + |z/c|^(2/e1)) <= 1, convex; for the distance see above.

    Parameters
    ----------
    exponents : (float, float); e1 (along z) and e2 (across), each from 0.1 (nearly a box) over 1 (an ellipsoid) to 2
        (an octahedron).
    rotation_deg : (float, float, float); As for `Box`.
    """

    center_m: Triple
    half_extents_m: Triple
    exponents: tuple[float, float]
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_body(self.center_m, self.half_extents_m, self.rotation_deg)
        if len(self.exponents) != 2 or not all(0.1 <= e <= 2 for e in self.exponents):
            raise InvalidArgument("exponents", repr(self.exponents), "two numbers from 0.1 to 2")

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`; at the very centre the normal is +z."""
        unit, size = self._scaled(points)
        gauge, gradient = self._gauge(unit)
        gradient /= np.asarray(self.half_extents_m)
        steepness = np.sqrt((gradient * gradient).sum(axis=-1))
        return (gauge * size - 1) / steepness, (gradient / steepness[:, None]) @ rotation_matrix(self.rotation_deg).T

    def _scaled(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """Points over the half extents, as ones of largest component 1 and their sizes; +z at the centre."""
        offset = points - np.asarray(self.center_m)
        scaled = (offset @ rotation_matrix(self.rotation_deg)) / np.asarray(self.half_extents_m)
        size = np.abs(scaled).max(axis=-1)
        scaled[size == 0] = (0.0, 0.0, 1.0)
        return scaled / np.where(size == 0, 1.0, size)[:, None], size

    def _gauge(self, u: Float64s) -> tuple[Float64s, Float64s]:
        """g and its gradient in the scaled space, at points of largest component 1: nothing overflows."""
        e1, e2 = self.exponents
        magnitude = np.abs(u)
        xy = (magnitude[:, :2] ** (2 / e2)).sum(axis=-1)
        flat = xy ** (e2 / 2)  # the gauge of the cross-section
        total = flat ** (2 / e1) + magnitude[:, 2] ** (2 / e1)
        gauge = total ** (e1 / 2)
        gradient = np.zeros_like(u)
        gradient[:, 2] = (magnitude[:, 2] / gauge) ** (2 / e1 - 1)
        held = flat > 0
        ring = (flat[held] / gauge[held]) ** (2 / e1 - 1)
        gradient[held, :2] = ring[:, None] * (magnitude[held, :2] / flat[held, None]) ** (2 / e2 - 1)
        return gauge, np.copysign(gradient, u)

    def distance_range(self, centres: Float64s, radius_m: float) -> tuple[Float64s, Float64s]:
        """See `Shape`; the gauge is a norm, at most 1/r of the Euclidean one, r the inscribed octahedron's ball."""
        half = np.asarray(self.half_extents_m)
        nearest, farthest = 1 / float(np.sqrt((half**-2.0).sum())), float(np.linalg.norm(half))
        unit, size = self._scaled(centres)
        gauge = self._gauge(unit)[0] * size
        low, high = gauge - radius_m / nearest - 1, gauge + radius_m / nearest - 1
        return (
            np.where(low > 0, low * nearest, low * farthest),
            np.where(high > 0, high * farthest, high * nearest),
        )

    def box_m(self) -> Float64s:
        """See `Shape`; that of the cuboid around it."""
        return _turned_box(self.center_m, self.half_extents_m, self.rotation_deg)


def check_triple(name: str, values: Triple) -> Float64s:
    """Three numbers of modulus 1e9 at most as float64 [3]; `InvalidArgument` that names them otherwise."""
    triple = np.asarray(values, np.float64)
    if triple.shape != (3,) or not (np.abs(triple) <= _MOST_M).all():
        raise InvalidArgument(name, repr(values), f"three numbers from {-_MOST_M:g} to {_MOST_M:g}")
    return triple


def check_positive(name: str, value: float) -> None:
    """`InvalidArgument` unless it is a positive length that can be reckoned with."""
    if not _LEAST_M <= value <= _MOST_M:
        raise InvalidArgument(name, repr(value), f"a positive length, {_LEAST_M:g} to {_MOST_M:g} m")


def check_body(center_m: Triple, half_extents_m: Triple, rotation_deg: Triple) -> None:
    """`InvalidArgument` unless all are within bounds and the half extents positive."""
    check_triple("center_m", center_m)
    check_triple("rotation_deg", rotation_deg)
    for half in check_triple("half_extents_m", half_extents_m):
        check_positive("half_extents_m", float(half))


def rotation_matrix(rotation_deg: Triple) -> Float64s:
    """The matrix whose columns are the body's axes, float64 [3, 3]: turns about the fixed x, then y, then z axis."""
    from scipy.spatial.transform import Rotation

    matrix: Float64s = Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix()
    return matrix


def _turned_box(center_m: Triple, half_extents_m: Triple, rotation_deg: Triple) -> Float64s:
    reach = np.abs(rotation_matrix(rotation_deg)) @ np.asarray(half_extents_m)
    return np.stack([np.asarray(center_m) - reach, np.asarray(center_m) + reach])
