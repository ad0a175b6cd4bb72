"""Rotations as unit quaternions and as matrices, many at once.

A quaternion is (w, x, y, z). `slerp` takes its components in any order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

__all__ = ["checked_rotation", "product", "quaternions_of", "rotation_matrices", "slerp"]

_NEARLY_ONE: Final = 1.0 - 1e-12
"""A cosine beyond this is that of an angle too small to divide by its sine."""

_ORTHONORMAL: Final = 1e-6
"""How far from the unit matrix R^T R of a rotation may be."""


def slerp(first: Float64s, second: Float64s, share: Float64s) -> Float64s:
    """Between unit quaternions along the shorter way, at constant angular velocity, float64 [n, 4].

    Source: Shoemake, "Animating rotation with quaternion curves", 1985.

    Parameters
    ----------
    first, second : float64 [n, 4]; Of length 1.
    share : float64 [n]; 0 at the first, 1 at the second.
    """
    cosine = (first * second).sum(axis=1)
    nearer = np.where(cosine[:, None] < 0, -second, second)
    is_far = np.abs(cosine) < _NEARLY_ONE
    angle = np.arccos(np.where(is_far, np.abs(cosine), 0.0))
    sine = np.sin(angle)
    of_first = np.where(is_far, np.sin((1 - share) * angle) / sine, 1 - share)
    of_second = np.where(is_far, np.sin(share * angle) / sine, share)
    mixed = of_first[:, None] * first + of_second[:, None] * nearer
    unit: Float64s = mixed / np.sqrt((mixed * mixed).sum(axis=1, keepdims=True))
    return unit


def product(a: Float64s, b: Float64s) -> Float64s:
    """Quaternion product of each pair, the rotation b and then a, float64 [n, 4]."""
    aw, ax, ay, az = a.T
    bw, bx, by, bz = b.T
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=1,
    )


def rotation_matrices(quaternions: Float64s) -> Float64s:
    """The matrices R of unit quaternions float64 [..., 4], float64 [..., 3, 3]."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrices: Float64s = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return matrices


def quaternions_of(matrices: Float64s) -> Float64s:
    """The inverse of `rotation_matrices` but for the sign, float64 [n, 4], of rotations float64 [n, 3, 3].

    The matrix tells the products of every two components; each row of them is the quaternion times one component,
    and the row of the largest keeps its digits (Shepperd, "Quaternion from rotation matrix", 1978).
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.moveaxis(matrices, 0, -1)
    rows = [
        [1 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz],
    ]
    products = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.diagonal(products, axis1=1, axis2=2).argmax(axis=1)
    chosen = products[np.arange(len(products)), largest]
    unit: Float64s = chosen / np.sqrt((chosen * chosen).sum(axis=1, keepdims=True))
    return unit


def checked_rotation(matrix: ArrayLike, where: str = "rotation") -> Float64s:
    """A rotation, float64 [3, 3]; `InvalidArgument` for any other matrix."""
    turn = np.asarray(matrix, np.float64)
    if turn.shape != (3, 3) or not np.isfinite(turn).all():
        raise InvalidArgument(where, f"shape {turn.shape}", "a finite matrix of 3 by 3")
    if np.abs(turn.T @ turn - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(turn) < 0:
        raise InvalidArgument(where, "a matrix that is none", "orthonormal columns and a determinant of +1")
    return turn
