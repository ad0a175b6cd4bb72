"""How the directions of a force field are spread over the sphere, with and without regard to pose.

Weights w_i (the amplitudes) at unit vectors u_i are a distribution on the sphere. Its real spherical-harmonic
coefficients are a_lm = sum_i w_i Y_lm(u_i), and its power of degree l, here relative to that of a single direction::

    P_l = 4 pi / (2 l + 1) sum_m a_lm^2 / (sum_i w_i)^2 = sum_ij w_i w_j Legendre_l(u_i . u_j) / (sum_i w_i)^2

(the second form is the addition theorem). It lies between 0 and 1 and depends on angles between forces alone: turning
all forces changes nothing, and neither does a common factor. P_1 is the squared length of the mean direction; of a
sphere felt from all sides every P_l is 0, of a cube P_4 is the first that is not, of a flat wall all are 1. Source:
M. Kazhdan, T. Funkhouser and S. Rusinkiewicz, "Rotation invariant spherical harmonic representation of 3D shape
descriptors", Symposium on Geometry Processing, 2003.

sqrt(P_l) is what is compared: as the length of the vector (a_lm)_m it changes by at most sqrt(l (l + 1) / 2) times
the angle by which directions move, so that small errors stay small.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

__all__ = ["DirectionSums", "direction_power", "icosahedral_directions", "real_harmonics"]

SPREAD: Final = 0.3
"""Radians: about half the angle between neighbouring directions."""

_AT_ONCE = 1 << 15


class DirectionSums:
    """Adds up forces by direction: around 42 icosahedral directions, and harmonics up to a degree.

    Parameters
    ----------
    degree : int
        The highest, 1 or more.

    Attributes
    ----------
    by_direction : float64 [42]
        Sum of the amplitudes around each of `icosahedral_directions`, newtons. A force is shared between them in
        proportion to exp(cos(angle) / `SPREAD`^2), so that a small turn moves a small part of it.
    coefficients : float64 [(degree + 1)^2]
        a_lm, newtons; a_lm at l (l + 1) + m.
    """

    def __init__(self, degree: int) -> None:
        if degree < 1:
            raise InvalidArgument("degree", f"{degree}", "1 or more")
        self.degree = degree
        self.by_direction = np.zeros(len(icosahedral_directions()))
        self.coefficients = np.zeros((degree + 1) ** 2)

    def add(self, vectors_n: ArrayLike) -> None:
        """Count force vectors, newtons, float [n, 3]; those of length 0 tell nothing."""
        forces = np.asarray(vectors_n, np.float64)
        for begin in range(0, len(forces), _AT_ONCE):
            some = forces[begin : begin + _AT_ONCE]
            lengths = np.linalg.norm(some, axis=1)
            some, lengths = some[lengths > 0], lengths[lengths > 0]
            unit = some / lengths[:, None]
            near = np.exp((unit @ icosahedral_directions().T - 1) / SPREAD**2)
            self.by_direction += lengths @ (near / near.sum(axis=1, keepdims=True))
            self.coefficients += lengths @ real_harmonics(unit, self.degree)

    def power(self) -> Float64s:
        """P_1 .. P_degree, float64 [degree], 0 to 1; all 0 where there was no force."""
        total = self.by_direction.sum()
        squares = self.coefficients**2
        edges = np.arange(self.degree + 1) ** 2
        of_degree = np.add.reduceat(squares, edges)[1:]
        factors = 4 * math.pi / (2 * np.arange(1, self.degree + 1) + 1)
        power: Float64s = np.clip(factors * of_degree / (total**2 or 1.0), 0.0, 1.0)
        return power


def direction_power(vectors_n: ArrayLike, degree: int = 8) -> Float64s:
    """P_1 .. P_degree of force vectors weighted by their lengths, float64 [degree]; see the module.

    Parameters
    ----------
    vectors_n : float [n, 3]
        Newtons.
    degree : int

    Raises
    ------
    InvalidArgument
        If the degree is below 1, or the shape is another.
    """
    forces = np.asarray(vectors_n, np.float64)
    if forces.ndim != 2 or forces.shape[1] != 3:
        raise InvalidArgument("vectors_n", f"shape {forces.shape}", "[n, 3]")
    sums = DirectionSums(degree)
    sums.add(forces)
    return sums.power()


def real_harmonics(unit: Float64s, degree: int) -> Float64s:
    """Y_lm of unit vectors [n, 3], orthonormal over the sphere, float64 [n, (degree + 1)^2], at l (l + 1) + m.

    Y_l,-m goes with sin(m phi) and Y_lm with cos(m phi), m > 0.
    """
    x, y, z = unit.T
    out = np.empty(((degree + 1) ** 2, len(unit)))
    around = np.ones(len(unit), np.complex128)  # (x + i y)^m: sin^m of the polar angle times exp(i m phi)
    for m in range(degree + 1):
        before, legendre = np.zeros(len(unit)), np.full(len(unit), (-1.0) ** m * math.prod(range(1, 2 * m, 2)))
        for order in range(m, degree + 1):
            ratio = math.factorial(order - m) / math.factorial(order + m)
            norm = math.sqrt((2 * order + 1) / (4 * math.pi) * ratio * (2 if m else 1))
            centre = order * (order + 1)
            np.multiply(norm * legendre, around.real, out=out[centre + m])
            if m:
                np.multiply(norm * legendre, around.imag, out=out[centre - m])
            above = ((2 * order + 1) * z * legendre - (order + m) * before) / (order + 1 - m)
            before, legendre = legendre, above
        around *= x + 1j * y
    return out.T


@cache
def icosahedral_directions() -> Float64s:
    """The 12 corners of an icosahedron and the middles of its 30 edges, unit vectors, float64 [42, 3], ascending.

    Those of the coder's codebook "ico2", which lies in a higher layer.
    """
    golden = (1 + math.sqrt(5)) / 2
    one = np.array([(0.0, a, b * golden) for a in (1, -1) for b in (1, -1)])
    corners = np.concatenate([np.roll(one, shift, axis=1) for shift in range(3)])
    first, second = np.nonzero(np.triu(np.isclose(corners @ corners.T, golden)))  # neighbours
    points = np.concatenate([corners, corners[first] + corners[second]])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    ordered: Float64s = points[np.lexsort(np.round(points, 9).T[::-1])]
    ordered.flags.writeable = False
    return ordered
