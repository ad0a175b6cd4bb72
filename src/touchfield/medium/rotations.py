"""Rotations as unit quaternions (w, x, y, z) and as matrices, many at once; reckoned by SciPy's `Rotation`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

_ORTHONORMAL: Final = 1e-6
"""Tolerance of R^T R against the unit matrix."""


def slerp(first: Float64s, second: Float64s, share: Float64s) -> Float64s:
    """Between unit quaternions [n, 4] along the shorter way, at constant angular velocity, float64 [n, 4].

    `share` float64 [n] is 0 at the first and 1 at the second; the components may stand in any order, as what lies
    between two points of a sphere does not depend on it.
    """
    from scipy.spatial.transform import Rotation

    begin = Rotation.from_quat(first, scalar_first=True)
    turn = begin.inv() * Rotation.from_quat(second, scalar_first=True)
    part = Rotation.from_rotvec(share[:, None] * turn.as_rotvec())
    mixed: Float64s = (begin * part).as_quat(scalar_first=True)
    return mixed


def rotation_vectors(before: Float64s, after: Float64s) -> Float64s:
    """The turns that lead from quaternions to others, float64 [n, 3]: along the axis, as long as the angle, rad."""
    from scipy.spatial.transform import Rotation

    begin, end = (Rotation.from_quat(each, scalar_first=True) for each in (before, after))
    vectors: Float64s = (end * begin.inv()).as_rotvec()
    return vectors


def rotation_matrices(quaternions: Float64s) -> Float64s:
    """The matrices R of unit quaternions float64 [..., 4], float64 [..., 3, 3]."""
    from scipy.spatial.transform import Rotation

    matrices: Float64s = Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True).as_matrix()
    return matrices.reshape(*quaternions.shape[:-1], 3, 3)


def quaternions_of(matrices: Float64s) -> Float64s:
    """The inverse of `rotation_matrices` but for the sign, float64 [n, 4], of rotations float64 [n, 3, 3]."""
    from scipy.spatial.transform import Rotation

    quaternions: Float64s = Rotation.from_matrix(matrices).as_quat(scalar_first=True)
    return quaternions


def checked_rotation(matrix: ArrayLike, where: str = "rotation") -> Float64s:
    """A rotation, float64 [3, 3]; `InvalidArgument` for any other matrix."""
    turn = np.asarray(matrix, np.float64)
    if turn.shape != (3, 3) or not np.isfinite(turn).all():
        raise InvalidArgument(where, f"shape {turn.shape}", "a finite matrix of 3 by 3")
    if np.abs(turn.T @ turn - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(turn) < 0:
        raise InvalidArgument(where, "a matrix that is none", "orthonormal columns and a determinant of +1")
    return turn
