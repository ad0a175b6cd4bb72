"""A rigid motion of hand space, x -> R x + t: turns, moves and mirrors.

Forces are vectors and turn with it: the moved field is F'(x) = R F(R^T (x - t)). A mirror image is allowed, with
det R = -1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

__all__ = ["RigidMotion"]

_ORTHOGONAL = 1e-9
_WHOLE = 1e-12  # the sine of half a turn is 1e-16

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
            raise InvalidArgument("rigid motion offset_m", repr(self.offset_m), "three finite coordinates in metres")
        r = np.where(np.abs(r - np.rint(r)) < _WHOLE, np.rint(r), r) + 0.0
        object.__setattr__(self, "matrix", tuple(tuple(row) for row in r.tolist()))
        object.__setattr__(self, "offset_m", tuple(t.tolist()))

    @classmethod
    def move(cls, offset_m: ArrayLike) -> RigidMotion:
        """A move by `offset_m`, metres [3]."""
        return cls(offset_m=_triple(offset_m))

    @classmethod
    def turn(cls, axis: ArrayLike, angle_deg: float, about_m: ArrayLike = (0.0, 0.0, 0.0)) -> RigidMotion:
        """A turn by the right-hand rule about an axis of that direction through `about_m`."""
        x, y, z = _unit("turn axis", axis)
        angle = math.radians(angle_deg)
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        r = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * (cross @ cross)
        return cls._about(r, about_m)

    @classmethod
    def mirror(cls, normal: ArrayLike, through_m: ArrayLike = (0.0, 0.0, 0.0)) -> RigidMotion:
        """The mirror image in the plane through `through_m` that is normal to `normal`."""
        n = _unit("mirror normal", normal)
        return cls._about(np.eye(3) - 2 * np.outer(n, n), through_m)

    @classmethod
    def _about(cls, r: Float64s, fixed_m: ArrayLike) -> RigidMotion:
        fixed = np.asarray(_triple(fixed_m))
        motion = cls(_rows(r))
        return cls(motion.matrix, _triple(fixed - np.asarray(motion.matrix) @ fixed))

    @property
    def words(self) -> str:
        """The motion, for the provenance of an edit."""
        return f"R {[list(row) for row in self.matrix]}, t {list(self.offset_m)} m"

    def then(self, second: RigidMotion) -> RigidMotion:
        """This motion, and then another."""
        r = np.asarray(second.matrix)
        t = r @ np.asarray(self.offset_m) + np.asarray(second.offset_m)
        return RigidMotion(_rows(r @ np.asarray(self.matrix)), _triple(t))

    @property
    def inverse(self) -> RigidMotion:
        """The way back."""
        r = np.asarray(self.matrix).T
        return RigidMotion(_rows(r), _triple(-(r @ np.asarray(self.offset_m))))

    def points_m(self, points_m: ArrayLike) -> Float64s:
        """Points [..., 3] moved, metres."""
        moved: Float64s = self.vectors(points_m) + np.asarray(self.offset_m)
        return moved

    def vectors(self, vectors: ArrayLike) -> Float64s:
        """Vectors [..., 3], such as forces, turned."""
        turned: Float64s = np.asarray(vectors, np.float64) @ np.asarray(self.matrix).T
        return turned


def _unit(where: str, given: ArrayLike) -> Float64s:
    v = np.asarray(given, np.float64)
    length = float(np.sqrt((v * v).sum())) if v.shape == (3,) else math.nan
    if not (0 < length < math.inf):
        raise InvalidArgument(where, repr(given), "three finite numbers, not all 0")
    unit: Float64s = v / length
    return unit


def _triple(given: ArrayLike) -> Triple:
    v = np.asarray(given, np.float64)
    if v.shape != (3,):
        raise InvalidArgument("point of a rigid motion", repr(given), "three coordinates in metres")
    x, y, z = v.tolist()
    return (x, y, z)


def _rows(r: Float64s) -> tuple[Triple, Triple, Triple]:
    return (_triple(r[0]), _triple(r[1]), _triple(r[2]))
