"""Simple shapes (plane, ball, box, capsule and others): the signed distance of a point to each, and its
gradient.

Plane, sphere, box, capsule and cylinder have exact closed forms (Quilez, "distance functions",
iquilezles.org). The point of an ellipsoid that is nearest to p is x_i = e_i^2 p_i / (t + e_i^2) with t the
greatest root of sum (e_i p_i / (t + e_i^2))^2 = 1 (Eberly, "Distance from a point to an ellipse, an
ellipsoid, or a hyperellipsoid", geometrictools.com). The root is found by Newton's iteration on the
reciprocal of the norm, as trust-region methods do (More and Sorensen 1983): that function is concave, so that
the iteration converges from below and cannot overshoot.

The superquadric (Barr 1981) has no closed form; its distance is that to the tangent plane where the ray from
the centre leaves the surface: with the gauge g(x) = F(x)^(e1/2), which is homogeneous of degree one
(Solina and Bajcsy 1990), it is Taubin's (1991) first-order distance (g - 1) / |grad g|. It is exact on the
surface and for a sphere, never more than the true distance outside, and never less deep than it inside.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s
from touchfield.compute.native import native
from touchfield.errors import InvalidArgument
from touchfield.medium.pose_track import checked_rotation

Triple = tuple[float, float, float]

_MIN_LENGTH_M, _MAX_LENGTH_M = 1e-9, 1e9
"""Range of lengths whose squares and products are finite, and that a simulation can handle."""

_NEGLIGIBLE: Final = 1e-100
"""Coordinates below this fraction of the half extent do not change the nearest point of an ellipsoid."""


class Shape(ABC):
    """A solid with a signed distance, negative inside.

    Raises `InvalidArgument` if a value is out of range.
    """

    def __post_init__(self) -> None:
        for name, value in ((f.name, getattr(self, f.name)) for f in fields(self)):  # type: ignore[arg-type]
            if name in ("point_m", "normal", "center_m", "rotation_deg"):
                checked_triple(name, value)
            elif name in ("radius_m", "half_length_m", "half_extents_m"):
                for length in checked_triple(name, value).tolist() if name == "half_extents_m" else (value,):
                    if not _MIN_LENGTH_M <= length <= _MAX_LENGTH_M:
                        expected = f"a positive length, {_MIN_LENGTH_M:g} to {_MAX_LENGTH_M:g} m"
                        raise InvalidArgument(name, repr(length), expected)

    @abstractmethod
    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """Return signed distance, metres, and outward unit normal at points [n, 3].

        They are float64 [n] and [n, 3].
        """

    @abstractmethod
    def box_m(self) -> Float64s:
        """Return the box of the surface, metres, float64 [2, 3]."""

    def distance_range(self, centres: Float64s, radius_m: float) -> tuple[Float64s, Float64s]:
        """Return bounds of the signed distance within `radius_m` of points [n, 3].

        They are float64 [n] each.
        """
        phi, _ = self.signed_distance_and_normal(centres)
        return phi - radius_m, phi + radius_m


@dataclass(frozen=True)
class Plane(Shape):
    """The half-space behind a plane.

    `point_m` is a point of the plane, and `normal` points outwards.
    """

    point_m: Triple
    normal: Triple

    def __post_init__(self) -> None:
        super().__post_init__()
        if not any(self.normal):
            raise InvalidArgument("normal", repr(self.normal), "a direction, not zero")

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        normal = self._unit()
        phi = (points - np.asarray(self.point_m)) @ normal
        return phi, np.broadcast_to(normal, points.shape)

    def box_m(self) -> Float64s:
        """Return the box of a square of one metre around the point."""
        normal = self._unit()
        aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        aside /= np.linalg.norm(aside)
        return _box_around(self.point_m, (np.abs(aside) + np.abs(np.cross(normal, aside))) / 2)

    def _unit(self) -> Float64s:
        normal = np.asarray(self.normal, np.float64)
        normal = normal / np.abs(normal).max()  # so that no square overflows
        return np.asarray(normal / np.linalg.norm(normal))


@dataclass(frozen=True)
class Sphere(Shape):
    """A ball; at its centre the normal is +z."""

    center_m: Triple
    radius_m: float

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        offset = points - np.asarray(self.center_m)
        length = np.sqrt((offset * offset).sum(axis=-1))
        normal = np.divide(offset, length[:, None], out=np.zeros_like(offset), where=length[:, None] > 0)
        normal[length == 0, 2] = 1.0
        return length - self.radius_m, normal

    def box_m(self) -> Float64s:
        return _box_around(self.center_m, self.radius_m)


class _RotatedShape(Shape):
    """A shape with its own frame, rotated about the fixed x, then y, then z axis."""

    center_m: Triple
    half_extents_m: Triple
    rotation_deg: Triple

    @cached_property
    def axes(self) -> Float64s:
        """Matrix whose columns are the axes of its frame, float64 [3, 3].

        `move_shape` also rotates it.
        """
        return rotation_matrix(self.rotation_deg)

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        phi, normal = self._local_distance(self._local(points))
        return phi, normal @ self.axes.T

    def box_m(self) -> Float64s:
        """See `Shape.box_m`; for a superquadric, the box of its cuboid."""
        return _box_around(self.center_m, self._reach(self.axes))

    def _local(self, points: Float64s) -> Float64s:
        return np.asarray((points - np.asarray(self.center_m)) @ self.axes)

    @abstractmethod
    def _local_distance(self, local: Float64s) -> tuple[Float64s, Float64s]:
        """Return signed distance and normal at points in its own frame."""

    def _reach(self, rotation: Float64s) -> Float64s:
        """Return half the sides of its box after a rotation, float64 [3].

        By default they are those of a cuboid.
        """
        return np.asarray(np.abs(rotation) @ np.asarray(self.half_extents_m))


@dataclass(frozen=True)
class Box(_RotatedShape):
    """A cuboid; the normal inside is that of the nearest face."""

    center_m: Triple
    half_extents_m: Triple
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def _local_distance(self, local: Float64s) -> tuple[Float64s, Float64s]:
        phi, weight = _of_faces(np.abs(local) - np.asarray(self.half_extents_m))
        return phi, np.copysign(weight, local)


@dataclass(frozen=True)
class Superquadric(_RotatedShape):
    """((|x/a|^(2/e2) + |y/b|^(2/e2))^(e2/e1) + |z/c|^(2/e1)) <= 1, convex.

    For the distance see the module.

    `exponents` are e1 (along z) and e2 (across), each from 0.1 (nearly a box) over 1 (an ellipsoid) to 2 (an
    octahedron). At the centre the normal is +z.
    """

    center_m: Triple
    half_extents_m: Triple
    exponents: tuple[float, float]
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.exponents) != 2 or not all(0.1 <= e <= 2 for e in self.exponents):
            raise InvalidArgument("exponents", repr(self.exponents), "two numbers from 0.1 to 2")

    def _local_distance(self, local: Float64s) -> tuple[Float64s, Float64s]:
        unit, size = self._scaled(local)
        gauge, gradient = self._gauge(unit)
        gradient /= np.asarray(self.half_extents_m)
        steepness = np.sqrt((gradient * gradient).sum(axis=-1))
        return (gauge * size - 1) / steepness, gradient / steepness[:, None]

    def _scaled(self, local: Float64s) -> tuple[Float64s, Float64s]:
        """Divide points by the half extents.

        Returns directions of largest component 1, and sizes. The direction at the centre is +z.
        """
        scaled = local / np.asarray(self.half_extents_m)
        size = np.abs(scaled).max(axis=-1)
        scaled[size == 0] = (0.0, 0.0, 1.0)
        return scaled / np.where(size == 0, 1.0, size)[:, None], size

    def _gauge(self, u: Float64s) -> tuple[Float64s, Float64s]:
        """Return g and its gradient in the scaled space, at points of largest component 1 (no overflow)."""
        e1, e2 = self.exponents
        magnitude = np.abs(u)
        xy = (magnitude[:, :2] ** (2 / e2)).sum(axis=-1)
        flat = xy ** (e2 / 2)  # the gauge of the cross-section
        total = flat ** (2 / e1) + magnitude[:, 2] ** (2 / e1)
        gauge = total ** (e1 / 2)
        gradient = np.zeros_like(u)
        gradient[:, 2] = (magnitude[:, 2] / gauge) ** (2 / e1 - 1)
        is_aside = flat > 0
        ring = (flat[is_aside] / gauge[is_aside]) ** (2 / e1 - 1)
        gradient[is_aside, :2] = ring[:, None] * (magnitude[is_aside, :2] / flat[is_aside, None]) ** (
            2 / e2 - 1
        )
        return gauge, np.copysign(gradient, u)

    def distance_range(self, centres: Float64s, radius_m: float) -> tuple[Float64s, Float64s]:
        """See `Shape`; the gauge is a norm, at most 1/r times the Euclidean one.

        r is the radius of the ball in the inscribed octahedron.
        """
        half = np.asarray(self.half_extents_m)
        nearest, farthest = 1 / float(np.sqrt((half**-2.0).sum())), float(np.linalg.norm(half))
        unit, size = self._scaled(self._local(centres))
        gauge = self._gauge(unit)[0] * size
        low, high = gauge - radius_m / nearest - 1, gauge + radius_m / nearest - 1
        return (
            np.where(low > 0, low * nearest, low * farthest),
            np.where(high > 0, high * farthest, high * nearest),
        )


@dataclass(frozen=True)
class Capsule(_RotatedShape):
    """A cylinder with hemispheres at its ends, along its own z axis.

    On that axis the normal is its +x.

    `half_length_m` is the distance from the centre to the centre of either hemisphere.
    """

    center_m: Triple
    radius_m: float
    half_length_m: float
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def _local_distance(self, local: Float64s) -> tuple[Float64s, Float64s]:
        local[:, 2] -= np.clip(local[:, 2], -self.half_length_m, self.half_length_m)
        length = np.sqrt((local * local).sum(axis=-1))
        local[length == 0] = (1.0, 0.0, 0.0)
        return length - self.radius_m, local / np.where(length > 0, length, 1.0)[:, None]

    def _reach(self, rotation: Float64s) -> Float64s:
        return np.abs(rotation[:, 2]) * self.half_length_m + self.radius_m


@dataclass(frozen=True)
class Cylinder(_RotatedShape):
    """A cylinder along its own z axis; the normal inside is that of the nearest face.

    `half_length_m` is the distance from the centre to either flat face.
    """

    center_m: Triple
    radius_m: float
    half_length_m: float
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def _local_distance(self, local: Float64s) -> tuple[Float64s, Float64s]:
        from_axis = np.sqrt((local[:, :2] ** 2).sum(axis=-1))
        outwards = np.where(from_axis[:, None] > 0, local[:, :2], (1.0, 0.0))
        outwards /= np.where(from_axis > 0, from_axis, 1.0)[:, None]
        beyond = np.stack([from_axis - self.radius_m, np.abs(local[:, 2]) - self.half_length_m], axis=-1)
        phi, weight = _of_faces(beyond)
        upwards = np.copysign(weight[:, 1:], local[:, 2:])
        return phi, np.concatenate([weight[:, :1] * outwards, upwards], axis=-1)

    def _reach(self, rotation: Float64s) -> Float64s:
        along = np.abs(rotation[:, 2])
        across = np.sqrt(np.maximum(1.0 - along * along, 0.0))
        return np.asarray(along * self.half_length_m + across * self.radius_m)


@dataclass(frozen=True)
class Ellipsoid(_RotatedShape):
    """An ellipsoid.

    If several of its points are nearest, the normal is that of one of them.
    """

    center_m: Triple
    half_extents_m: Triple
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def _local_distance(self, local: Float64s) -> tuple[Float64s, Float64s]:
        half = np.asarray(self.half_extents_m, np.float64)
        smallest = int(half.argmin())
        ratio = (half / half[smallest]) ** 2
        scaled = np.abs(local) / half
        scaled[scaled < _NEGLIGIBLE] = 0.0  # its root, and the cube of the root, would underflow
        root = np.empty(len(scaled))  # t / e_min^2 + 1, which keeps precision near the smallest axis
        native.ellipsoid_roots(scaled, tuple(ratio.tolist()), root)
        denominator = root[:, None] + (ratio - 1.0)
        on_unit = np.divide(ratio * scaled, denominator, out=np.zeros_like(scaled), where=denominator > 0)
        focal = root == 0  # two nearest points, on both sides of the plane across the smallest axis
        on_unit[focal, smallest] = np.sqrt(np.maximum(1.0 - (on_unit[focal] ** 2).sum(axis=-1), 0.0))
        gradient = np.copysign(on_unit / half, local)
        steepness = np.sqrt((gradient * gradient).sum(axis=-1))
        # p - x = t x / e^2 in each axis, and x / e^2 is the gradient: this avoids cancellation
        return (root - 1.0) * half[smallest] ** 2 * steepness, gradient / steepness[:, None]

    def _reach(self, rotation: Float64s) -> Float64s:
        return np.asarray(np.sqrt(((rotation * np.asarray(self.half_extents_m)) ** 2).sum(axis=1)))


SHAPES: Final[dict[str, type[Shape]]] = {
    kind.__name__.lower(): kind for kind in (Plane, Sphere, Box, Superquadric, Capsule, Cylinder, Ellipsoid)
}
"""The kinds of shape, each a dataclass with a signed distance."""


def move_shape(shape: Shape, rotation: ArrayLike, shift_m: ArrayLike) -> Shape:
    """Return a shape of this module after x -> R x + t, R float [3, 3], t float [3].

    Raises `InvalidArgument` if R is not a rotation, or a number is not finite.
    """
    matrix, shift = checked_rotation(rotation), checked_triple("shift_m", shift_m)
    if isinstance(shape, Plane):
        return Plane(_as_triple(matrix @ shape.point_m + shift), _as_triple(matrix @ shape.normal))
    solid: Any = shape
    other: Shape = replace(solid, center_m=_as_triple(matrix @ solid.center_m + shift))
    if isinstance(shape, _RotatedShape):
        vars(other)["axes"] = matrix @ shape.axes
    return other


def rotation_matrix(rotation_deg: Triple) -> Float64s:
    """Return the rotation matrix of Euler angles, float64 [3, 3].

    The rotations are about the fixed x, then y, then z axis.
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", rotation_deg, degrees=True).as_matrix())


def _of_faces(beyond: Float64s) -> tuple[Float64s, Float64s]:
    """Return the signed distance to a block and the weights of its normals.

    `beyond` [n, d] are the distances beyond each pair of faces.

    """
    outside = np.maximum(beyond, 0.0)
    distance = np.sqrt((outside * outside).sum(axis=-1))
    is_out = distance > 0
    weight = np.eye(beyond.shape[1])[beyond.argmax(axis=-1)]
    weight[is_out] = outside[is_out] / distance[is_out, None]
    return np.where(is_out, distance, beyond.max(axis=-1)), weight


def checked_triple(name: str, values: ArrayLike) -> Float64s:
    """Check three numbers, metres, float64 [3].

    Raises `InvalidArgument` if they are out of range.
    """
    triple = np.asarray(values, np.float64)
    if triple.shape != (3,) or not (np.abs(triple) <= _MAX_LENGTH_M).all():
        raise InvalidArgument(
            name, repr(values), f"three numbers from {-_MAX_LENGTH_M:g} to {_MAX_LENGTH_M:g}"
        )
    return triple


def _as_triple(values: Float64s) -> Triple:
    x, y, z = values.tolist()
    return x, y, z


def _box_around(middle: ArrayLike, reach: Float64s | float) -> Float64s:
    centre = np.asarray(middle, np.float64)
    return np.stack([centre - reach, centre + reach])
