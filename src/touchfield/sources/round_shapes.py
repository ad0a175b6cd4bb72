"""Round shapes with a formula, capsule, cylinder and ellipsoid, and shapes after a rigid motion; all exact.

Capsule and cylinder have closed forms (Quilez, "distance functions", iquilezles.org). The point of an ellipsoid that
is nearest to p is x_i = e_i^2 p_i / (t + e_i^2) with t the greatest root of sum (e_i p_i / (t + e_i^2))^2 = 1
(Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid", geometrictools.com). The root is
found by Newton's iteration on the reciprocal of the norm, as trust-region methods do (More and Sorensen 1983): that
function is concave, so that the iteration comes from below and cannot overshoot.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.medium.rotations import checked_rotation
from touchfield.sources.shapes import (
    Plane,
    Shape,
    Sphere,
    Triple,
    check_body,
    check_positive,
    check_triple,
    rotation_matrix,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

__all__ = ["Capsule", "Cylinder", "Ellipsoid", "Moved", "moved"]

_NOTHING: Final = 1e-100
"""A coordinate below this share of the half extent moves no nearest point."""


@dataclass(frozen=True)
class _Rod(Shape):
    """What is round about its own z axis, of one radius and a length."""

    center_m: Triple
    radius_m: float
    half_length_m: float
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_triple("center_m", self.center_m)
        check_triple("rotation_deg", self.rotation_deg)
        check_positive("radius_m", self.radius_m)
        check_positive("half_length_m", self.half_length_m)


@dataclass(frozen=True)
class Capsule(_Rod):
    """A cylinder with half balls at its ends, along its own z axis; on that axis the normal is its +x.

    Parameters
    ----------
    half_length_m : float; From the centre to the centre of either half ball.
    rotation_deg : (float, float, float); Turns about the fixed x, then y, then z axis, degrees.
    """

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        rotation = rotation_matrix(self.rotation_deg)
        offset = (points - np.asarray(self.center_m)) @ rotation
        offset[:, 2] -= np.clip(offset[:, 2], -self.half_length_m, self.half_length_m)
        length = np.sqrt((offset * offset).sum(axis=-1))
        offset[length == 0] = (1.0, 0.0, 0.0)
        normal = offset / np.where(length > 0, length, 1.0)[:, None]
        return length - self.radius_m, normal @ rotation.T

    def box_m(self) -> Float64s:
        """See `Shape`."""
        along = np.abs(rotation_matrix(self.rotation_deg)[:, 2])
        return _around(self.center_m, along * self.half_length_m + self.radius_m)


@dataclass(frozen=True)
class Cylinder(_Rod):
    """A cylinder along its own z axis; the normal within is that of the nearest face.

    Parameters
    ----------
    half_length_m : float; From the centre to either flat face.
    rotation_deg : (float, float, float); As for `Capsule`.
    """

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        rotation = rotation_matrix(self.rotation_deg)
        local = (points - np.asarray(self.center_m)) @ rotation
        from_axis = np.sqrt((local[:, :2] ** 2).sum(axis=-1))
        outwards = np.where(from_axis[:, None] > 0, local[:, :2], (1.0, 0.0))
        outwards /= np.where(from_axis > 0, from_axis, 1.0)[:, None]
        beyond = np.stack([from_axis - self.radius_m, np.abs(local[:, 2]) - self.half_length_m], axis=-1)
        outside = np.maximum(beyond, 0.0)
        distance = np.sqrt((outside * outside).sum(axis=-1))
        is_out = distance > 0
        weight = np.eye(2)[beyond.argmax(axis=-1)]
        weight[is_out] = outside[is_out] / distance[is_out, None]
        upwards = np.copysign(weight[:, 1:], local[:, 2:])
        normal = np.concatenate([weight[:, :1] * outwards, upwards], axis=-1)
        return np.where(is_out, distance, beyond.max(axis=-1)), normal @ rotation.T

    def box_m(self) -> Float64s:
        """See `Shape`."""
        along = np.abs(rotation_matrix(self.rotation_deg)[:, 2])
        across = np.sqrt(np.maximum(1.0 - along * along, 0.0))
        return _around(self.center_m, along * self.half_length_m + across * self.radius_m)


@dataclass(frozen=True)
class Ellipsoid(Shape):
    """An ellipsoid; where several of its points are nearest, the normal is that of one of them.

    Parameters
    ----------
    rotation_deg : (float, float, float); As for `Capsule`.
    """

    center_m: Triple
    half_extents_m: Triple
    rotation_deg: Triple = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_body(self.center_m, self.half_extents_m, self.rotation_deg)

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        from touchfield.sources.kernels.ellipsoid import greatest_roots

        rotation, half = rotation_matrix(self.rotation_deg), np.asarray(self.half_extents_m, np.float64)
        local = (points - np.asarray(self.center_m)) @ rotation
        least = int(half.argmin())
        ratio = (half / half[least]) ** 2
        scaled = np.abs(local) / half
        scaled[scaled < _NOTHING] = 0.0  # its root, and the cube of that, would have no digits
        root = greatest_roots(scaled, ratio)  # t / e_min^2 + 1: what is near the least axis keeps its digits
        denominator = root[:, None] + (ratio - 1.0)
        on_unit = np.divide(ratio * scaled, denominator, out=np.zeros_like(scaled), where=denominator > 0)
        focal = root == 0  # the nearest points lie to both sides of the plane across the least axis
        on_unit[focal, least] = np.sqrt(np.maximum(1.0 - (on_unit[focal] ** 2).sum(axis=-1), 0.0))
        gradient = np.copysign(on_unit / half, local)
        steepness = np.sqrt((gradient * gradient).sum(axis=-1))
        # p - x = t x / e^2 in each axis, and x / e^2 is the gradient: no difference of near numbers is taken
        return (root - 1.0) * half[least] ** 2 * steepness, (gradient / steepness[:, None]) @ rotation.T

    def box_m(self) -> Float64s:
        """See `Shape`."""
        reach = np.sqrt(((rotation_matrix(self.rotation_deg) * np.asarray(self.half_extents_m)) ** 2).sum(axis=1))
        return _around(self.center_m, reach)


@dataclass(frozen=True)
class Moved(Shape):
    """A shape after x -> R x + t; make it with `moved`, which keeps what stays a plane or a ball.

    Parameters
    ----------
    rotation : float [3, 3]; R.
    shift_m : (float, float, float); t.

    Raises `InvalidArgument` if `rotation` is not a rotation, or a number is not finite.
    """

    shape: Shape
    rotation: tuple[Triple, Triple, Triple]
    shift_m: Triple

    def __post_init__(self) -> None:
        matrix = checked_rotation(self.rotation)
        shift = check_triple("shift_m", self.shift_m)
        # as tuples: values that compare and cannot be changed
        object.__setattr__(self, "rotation", tuple(tuple(float(x) for x in row) for row in matrix))
        object.__setattr__(self, "shift_m", tuple(float(x) for x in shift))

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        rotation: Float64s = np.asarray(self.rotation)
        phi, normal = self.shape.signed_distance_and_normal(self._back(points))
        return phi, normal @ rotation.T

    def distance_range(self, centres: Float64s, radius_m: float) -> tuple[Float64s, Float64s]:
        """See `Shape`."""
        return self.shape.distance_range(self._back(centres), radius_m)

    def box_m(self) -> Float64s:
        """A box that holds the surface: that of the shape's own box after the motion."""
        box = self.shape.box_m()
        middle, half = box.mean(axis=0), np.ptp(box, axis=0) / 2
        rotation = np.asarray(self.rotation)
        return _around(rotation @ middle + np.asarray(self.shift_m), np.abs(rotation) @ half)

    def _back(self, points: Float64s) -> Float64s:
        local: Float64s = (points - np.asarray(self.shift_m)) @ np.asarray(self.rotation)
        return local


def moved(shape: Shape, rotation: ArrayLike, shift_m: ArrayLike) -> Shape:
    """A shape after x -> R x + t: planes and balls stay such, and two motions become one.

    Parameters
    ----------
    rotation : float [3, 3]; R.
    shift_m : float [3]; t.

    Raises `InvalidArgument` as `Moved` does.
    """
    inner = shape.shape if isinstance(shape, Moved) else shape
    turn, shift = np.asarray(rotation, np.float64), np.asarray(shift_m, np.float64)
    result = Moved(inner, turn, shift)  # type: ignore[arg-type]  # made tuples there, and checked
    if isinstance(shape, Moved):
        shift = turn @ np.asarray(shape.shift_m) + shift
        turn = turn @ np.asarray(shape.rotation)
        result = Moved(inner, turn, shift)
    if isinstance(inner, Plane):
        return Plane(
            _as_triple(turn @ np.asarray(inner.point_m) + shift), _as_triple(turn @ np.asarray(inner.normal))
        )
    if isinstance(inner, Sphere):
        return Sphere(_as_triple(turn @ np.asarray(inner.center_m) + shift), inner.radius_m)
    return result


def _as_triple(values: Float64s) -> Triple:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _around(middle: ArrayLike, reach: Float64s) -> Float64s:
    centre = np.asarray(middle, np.float64)
    return np.stack([centre - reach, centre + reach])
