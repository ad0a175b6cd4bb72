"""A field on another lattice by trilinear interpolation, turned, moved or mirrored on the way if that is asked.

What a receiver renders between samples is this interpolation (`ForceField.sample_n`). It has no low-pass: to go to a
coarser lattice take `touchfield.filters.resample`. Forces are vectors and turn with a motion x -> R x + t: the moved
field is F'(x) = R F(R^T (x - t)). A mirror image is allowed, with det R = -1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]
    Int64s = NDArray[np.int64]

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


BORDERS: Final = ("zero", "cell")
MAX_PAIRS: Final = 1 << 26
_PAIRS_AT_ONCE: Final = 1 << 20
BRICKS_AT_ONCE: Final = 512
_ON_A_SAMPLE: Final = 1e-6
"""A point as near to a sample as this share of the spacing is taken to lie on it, so that whole steps are exact."""

_CORNERS: Final = np.stack(np.meshgrid(*[np.arange(2)] * 3, indexing="ij"), axis=-1).reshape(8, 3)
LOCAL: Final = np.stack(np.meshgrid(*[np.arange(BRICK)] * 3, indexing="ij"), axis=-1)


def interpolated(
    field: ForceField, grid: Grid, motion: RigidMotion | None = None, border: str = "zero"
) -> ForceField:
    """The field at the samples of another lattice, trilinear between its own.

    grid : Grid; the target, in the same metres.
    motion : RigidMotion, optional; moves and turns the field on the way.
    border : str; "zero": beyond the outermost samples the force falls to zero over one spacing, as
        `ForceField.sample_n` does. "cell": the outermost sample stands for all of its cell, half a spacing more, and
        beyond that there is none.
    Returns ForceField: On `grid`. No |F| is greater than the greatest of the field.
    Raises `InvalidArgument` if the border is unknown, or the target is too fine for a field of that size.
    """
    if border not in BORDERS:
        raise InvalidArgument("border", repr(border), " or ".join(BORDERS))
    motion = None if motion == RigidMotion() else motion
    keys = _reached(field, grid, motion)
    bricks = np.stack(np.unravel_index(keys, grid.brick_shape), axis=1).astype(np.int32)
    forces = zero_forces(len(bricks))
    for begin in range(0, len(bricks), BRICKS_AT_ONCE):
        some = slice(begin, begin + BRICKS_AT_ONCE)
        forces[some] = _values(field, grid, motion, border, bricks[some])
    return ForceField.from_bricks(grid, bricks, forces)


def _values(
    field: ForceField, grid: Grid, motion: RigidMotion | None, border: str, bricks: NDArray[np.int32]
) -> NDArray[Any]:
    """The forces of some bricks, newtons [m, 8, 8, 8, 3]."""
    from touchfield.medium import kernels

    points = grid.to_m(bricks[:, None, None, None] * BRICK + LOCAL)
    index = field.grid.to_index(points if motion is None else motion.inverse.points_m(points))
    whole = np.rint(index)
    index = np.where(np.abs(index - whole) < _ON_A_SAMPLE, whole, index)
    if border == "cell":
        last = np.array(field.grid.shape) - 1.0
        beyond = ((index < -0.5 - _ON_A_SAMPLE) | (index > last + 0.5 + _ON_A_SAMPLE)).any(axis=-1)
        index = np.clip(index, 0.0, last)
        index[beyond] = -2.0
    flat = np.ascontiguousarray(index.reshape(-1, 3))
    found = kernels.sample(flat, field.grid, brick_keys(field.grid, field.bricks), field.forces_n)
    turned: NDArray[Any] = found if motion is None else motion.vectors(found)
    return turned.reshape(*bricks.shape[:1], BRICK, BRICK, BRICK, 3)


def _reached(field: ForceField, grid: Grid, motion: RigidMotion | None) -> Int64s:
    """Keys of the bricks of `grid` that a force may reach, ascending: each sample acts within one spacing."""
    corners = field.bricks[:, None] * BRICK + np.where(_CORNERS, BRICK, -1)
    points = field.grid.to_m(corners)
    index = grid.to_index(points if motion is None else motion.points_m(points))
    low, high = index.min(axis=1) - _ON_A_SAMPLE, index.max(axis=1) + _ON_A_SAMPLE
    last = np.array(grid.shape) - 1
    met = ((high >= 0) & (low <= last)).all(axis=1)
    first = (np.clip(np.floor(low[met]), 0, last) // BRICK).astype(np.int64)
    count = (np.clip(np.ceil(high[met]), 0, last) // BRICK).astype(np.int64) - first + 1
    pairs = float(count.astype(np.float64).prod(axis=1).sum())
    if pairs > MAX_PAIRS:
        raise InvalidArgument("grid", f"{pairs:.3g} bricks reached", f"up to {MAX_PAIRS}", "Take a coarser lattice.")
    keys = np.zeros(0, np.int64)
    for some in _keys_of_spans(first, count, grid):
        keys = np.union1d(keys, some)
    return keys


def _keys_of_spans(first: Int64s, count: Int64s, grid: Grid) -> Iterator[Int64s]:
    for n in np.unique(count, axis=0):  # few: bricks that are turned alike reach alike
        offsets = np.stack(np.meshgrid(*[np.arange(k) for k in n], indexing="ij"), axis=-1).reshape(-1, 3)
        own = first[(count == n).all(axis=1)]
        step = max(1, _PAIRS_AT_ONCE // len(offsets))
        for begin in range(0, len(own), step):
            reached = (own[begin : begin + step, None] + offsets).reshape(-1, 3)
            yield np.unique(brick_keys(grid, reached))
