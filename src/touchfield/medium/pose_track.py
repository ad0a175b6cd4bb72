"""`PoseTrack`: the motion of a rigid body, one position and rotation for each frame (paper section 4.3).

This is the paper's "object" source model.

A pose maps points from the body frame to the scene: x_scene = R x_body + t. Rotations are unit quaternions
(w, x, y, z) or matrices, vectorised, computed by SciPy's `Rotation`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import EqualByValue, Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import frozen

# frames times bodies of a scene in a file: a body at rest costs few bytes, but one pose per frame in memory
MAX_POSES: Final = 1 << 24
Frames = int | slice | Int64s
"""A frame, or several as a slice or as indices."""

_UNIT = 1e-3  # tolerance of a quaternion's length: the rounding of three digits in a text file


@dataclass(frozen=True, eq=False)
class PoseTrack(EqualByValue):
    """Rigid poses over time, one for each frame.

    quaternions : float64 [n, 4]; unit quaternions (w, x, y, z) of the rotations R. They are normalised, and
        of the two quaternions of a rotation the one nearer to the previous frame is stored (the first has w
        >= 0).
    positions_m : float64 [n, 3]; t, position of the body's origin in the scene, metres.
    Raises `InvalidArgument` if shapes differ, a number is not finite, or a quaternion is not of length 1 +-
    0.001.
    """

    quaternions: Float64s
    positions_m: Float64s

    def __post_init__(self) -> None:
        q = np.array(self.quaternions, np.float64)
        t = np.array(self.positions_m, np.float64)
        if q.ndim != 2 or q.shape[1] != 4 or not len(q):
            raise InvalidArgument(
                "pose track quaternions", f"shape {q.shape}", "float64 [n, 4], n at least 1"
            )
        if t.shape != (len(q), 3):
            raise InvalidArgument(
                "pose track positions_m", f"shape {t.shape}", f"({len(q)}, 3), one for each frame"
            )
        faulty = np.flatnonzero(~(np.isfinite(q).all(axis=1) & np.isfinite(t).all(axis=1)))
        if len(faulty):
            raise InvalidArgument(
                f"pose track, frame {faulty[0]}", "a number that is not finite", "finite poses"
            )
        length = np.sqrt((q * q).sum(axis=1))
        faulty = np.flatnonzero(np.abs(length - 1) > _UNIT)
        if len(faulty):
            where, found = f"pose track, frame {faulty[0]}", f"a quaternion of length {length[faulty[0]]:g}"
            raise InvalidArgument(where, found, "length 1, in the order w, x, y, z")
        q /= length[:, None]
        is_flipped = np.append(q[0, 0] < 0, (q[1:] * q[:-1]).sum(axis=1) < 0)
        q[np.cumsum(is_flipped) % 2 == 1] *= -1.0
        object.__setattr__(self, "quaternions", frozen(q))
        object.__setattr__(self, "positions_m", frozen(t))

    @classmethod
    def _unchecked(cls, quaternions: Float64s, **values: Any) -> PoseTrack:
        """Return a track of quaternions that another track has checked, without a copy of them."""
        track = object.__new__(cls)
        for name, value in {"quaternions": quaternions, **values}.items():
            object.__setattr__(track, name, value)
        return track

    if not TYPE_CHECKING:  # it would hide misspelt names from the type checker

        def __getattr__(self, name: str) -> Any:
            """Compute `positions_m` of a `scaled` track when it is first read."""
            if name != "positions_m":
                raise AttributeError(f"PoseTrack has no attribute {name!r}")
            positions_m = frozen(self.positions(slice(None)))
            object.__setattr__(self, "positions_m", positions_m)
            return positions_m

    @classmethod
    def constant(cls, frame_count: int = 1, position_m: ArrayLike = (0.0, 0.0, 0.0)) -> PoseTrack:
        """Return the track of a body at rest, without rotation."""
        q = np.tile([1.0, 0.0, 0.0, 0.0], (frame_count, 1))
        return cls(q, np.tile(np.asarray(position_m, np.float64), (frame_count, 1)))

    def __len__(self) -> int:
        return len(self.quaternions)

    @property
    def is_constant(self) -> bool:
        """True if all poses are the same."""
        columns = self.positions(slice(None)), self.quaternions
        return all(bool((values == values[0]).all()) for values in columns)

    def positions(self, frames: Frames) -> Float64s:
        """Return positions of frames, metres, float64 [..., 3].

        They equal ``positions_m[frames]``, which a `scaled` track would first compute and keep.
        """
        values = vars(self)
        if "positions_m" in values:
            return np.asarray(self.positions_m[frames])
        source, scale, offset_m = values["_scaled"]
        return np.asarray(scale * (source.positions(frames) - offset_m))

    def rotation(self, frame: int) -> Float64s:
        """Return R of one frame, float64 [3, 3]."""
        return rotation_matrices(self.quaternions[frame])

    def rotations(self, frames: slice = slice(None)) -> Float64s:
        """Return R of each frame, float64 [n, 3, 3]."""
        return rotation_matrices(self.quaternions[frames])

    def to_scene(self, points_m: ArrayLike, frame: int) -> Float64s:
        """Convert points [..., 3] from the body frame to the scene, metres."""
        return np.asarray(np.asarray(points_m, np.float64) @ self.rotation(frame).T + self.positions(frame))

    def to_body(self, points_m: ArrayLike, frame: int) -> Float64s:
        """Convert points [..., 3] from the scene to the body frame, metres."""
        return np.asarray((np.asarray(points_m, np.float64) - self.positions(frame)) @ self.rotation(frame))

    def velocities(self, rate_hz: float, frames: slice = slice(None)) -> tuple[Float64s, Float64s]:
        """Return linear and angular velocity in the scene, each float64 [n, 3], of all or some frames.

        The velocity is that of the body's origin, m/s; the angular velocity is in rad/s. They are central
        differences, one-sided at both ends, and zero for a single frame.
        """
        n, index = len(self), np.arange(len(self))[frames]
        if n == 1:
            return np.zeros((len(index), 3)), np.zeros((len(index), 3))
        after, before = np.minimum(index + 1, n - 1), np.maximum(index - 1, 0)
        dt = (after - before) / rate_hz
        velocity = (self.positions(after) - self.positions(before)) / dt[:, None]
        rotations = rotation_vectors(self.quaternions[before], self.quaternions[after])
        return velocity, rotations / dt[:, None]

    def surface_motions(
        self, rate_hz: float, damping_n_s_per_m: float, frames: slice = slice(None)
    ) -> Float64s:
        """Return surface damping times linear and angular velocity, N and N/m, float64 [n, 6].

        Numbers that overflow are infinite; forces are limited where they are summed. Without damping the
        array is a read-only view of a single zero.
        """
        if not damping_n_s_per_m:
            return np.broadcast_to(0.0, (len(range(len(self))[frames]), 6))
        with np.errstate(over="ignore"):
            return np.asarray(damping_n_s_per_m * np.hstack(self.velocities(rate_hz, frames)))

    def scaled(self, scale: float, offset_m: ArrayLike = (0.0, 0.0, 0.0)) -> PoseTrack:
        """Return the track after x -> scale * (x - offset).

        The body frame is scaled by the same factor. The track shares the memory of this one: its positions
        are computed when they are read. Raises `InvalidArgument` if one is not finite.
        """
        scaling = self, scale, np.asarray(offset_m, np.float64)
        track = PoseTrack._unchecked(self.quaternions, _scaled=scaling)
        with np.errstate(over="ignore"):
            faulty = np.flatnonzero(~np.isfinite(track.positions(slice(None))).all(axis=1))
        if len(faulty):
            where = f"pose track, frame {faulty[0]}"
            raise InvalidArgument(where, "a number that is not finite", "finite poses")
        return track

    def between(self, start: int, stop: int) -> PoseTrack:
        """Return frames start to stop - 1."""
        if not 0 <= start < stop <= len(self):
            raise InvalidArgument("frames", f"{start}:{stop}", f"a range within 0:{len(self)}")
        q = self.quaternions[start:stop]
        positions_m = frozen(self.positions(slice(start, stop)))
        return PoseTrack._unchecked(frozen(-q) if q[0, 0] < 0 else q, positions_m=positions_m)


_ORTHONORMAL: Final = 1e-6  # tolerance of the difference of R^T R and the identity


def _rotation(quaternions: Float64s) -> Any:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternions, scalar_first=True)


def slerp(first: Float64s, second: Float64s, weight: Float64s) -> Float64s:
    """Interpolate unit quaternions [n, 4] along the shorter arc, float64 [n, 4].

    The angular velocity is constant.

    `weight` float64 [n] is 0 at the first and 1 at the second. The order of the components does not matter.
    """
    start = _rotation(first)
    rotation = (start.inv() * _rotation(second)).as_rotvec()
    return np.asarray(
        (start * type(start).from_rotvec(weight[:, None] * rotation)).as_quat(scalar_first=True)
    )


def rotation_vectors(before: Float64s, after: Float64s) -> Float64s:
    """Return the rotation vectors (axis times angle, rad) between quaternions."""
    return np.asarray((_rotation(after) * _rotation(before).inv()).as_rotvec())


def rotation_matrices(quaternions: Float64s) -> Float64s:
    """Return the matrices R of unit quaternions [..., 4], float64 [..., 3, 3]."""
    matrices: Float64s = _rotation(quaternions.reshape(-1, 4)).as_matrix()
    return matrices.reshape(*quaternions.shape[:-1], 3, 3)


def quaternions_of(matrices: Float64s) -> Float64s:
    """Return unit quaternions of rotation matrices [n, 3, 3], float64 [n, 4].

    This is the inverse of `rotation_matrices` up to the sign of each quaternion.
    """
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(matrices).as_quat(scalar_first=True))


def checked_rotation(matrix: ArrayLike, where: str = "rotation") -> Float64s:
    """Return a checked rotation matrix, float64 [3, 3].

    Raises `InvalidArgument` if the matrix is not a rotation.
    """
    turn = np.asarray(matrix, np.float64)
    if turn.shape != (3, 3) or not np.isfinite(turn).all():
        raise InvalidArgument(where, f"shape {turn.shape}", "a finite matrix of 3 by 3")
    if np.abs(turn.T @ turn - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(turn) < 0:
        raise InvalidArgument(where, "a matrix that is none", "orthonormal columns and a determinant of +1")
    return turn
