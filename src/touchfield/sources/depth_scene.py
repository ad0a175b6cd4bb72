"""The metric reading of a depth sequence: the surface that the camera saw, in its perspective.

The paper (sections 4 and 5.1) makes fields of depth video but gives no formula. Here a sample is projected to its
nearest pixel and phi is its signed distance to the tangent plane of the surface there (negative behind), n the
plane's normal towards the camera, so that F = f(phi) n. Departures from a distance field, and why:

- Only what the camera saw pushes: a pixel without depth, or without a normal to rely on, gives no force, and no
  surface is guessed behind or between silhouettes.
- *Ray limit.* A plane met at a grazing angle would carry its force far behind the surface. A force therefore lies
  no farther from the surface along its own ray (in depth z) than `RAY_LIMIT` times the distance that the profile
  reaches on that side. Walls at more than 75 degrees to the ray become thinner by it. A solid (the profile
  reaches to -inf) has no limit behind: everything hidden by the surface is solid.

With poses the scene lies in the coordinates of the first camera: a moving camera sees a standing world, and the
workspace stays in front of the viewer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.sources.normals import SurfacePlanes, noise_step_per_m, surface_planes
from touchfield.sources.scene import CAMERA_AXES, DEPTH_UNIT, Body, Scene
from touchfield.sources.segments import SegmentRule, segmented_bodies

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.camera import DepthSequence
    from touchfield.sources.kernels.depth import Query
    from touchfield.sources.profile import ForceProfile

    Float64s = NDArray[np.float64]

__all__ = ["RAY_LIMIT", "DepthScene", "force_bricks", "plane_forces", "query_of", "relative_poses"]

RAY_LIMIT: Final = 4.0
"""A force lies no farther from the surface along the ray than this many times the reach of the profile."""

_NODES_AT_ONCE = 6000  # cubes of bricks tested in the first round
_BOX_POINTS = 4_000_000  # points that `bounds_m` keeps
_BOX_STRIDE_PX = 8
_BOX_PERCENTILES = (0.5, 99.5)


class DepthScene(Scene):
    """A depth sequence as a scene of thin walls, in metres.

    Parameters
    ----------
    sequence : DepthSequence
    frame : str
        "world": in the coordinates of the first camera, where the sequence has poses; "camera": each frame in
        its own camera.
    segment : str, optional
        The rule by which `bodies` are told apart (`touchfield.sources.segments.SegmentRule.parse`).
    step_per_m : float, optional
        The noise step of the sensor, 1/m; by default it is taken from the first frame.

    Raises
    ------
    InvalidArgument
        If `frame` is neither, or the rule cannot be understood.
    SourceError
        If the poses are not rigid motions.
    """

    box_wording = "99 % of the surface along each axis"
    unit = DEPTH_UNIT

    def __init__(
        self,
        sequence: DepthSequence,
        frame: str = "world",
        segment: str | None = None,
        step_per_m: float | None = None,
    ) -> None:
        if frame not in ("world", "camera"):
            raise InvalidArgument("frame", repr(frame), "world or camera")
        self.sequence = sequence
        self.frame_count = sequence.frame_count
        self.rate_hz = sequence.rate_hz
        self.axes = CAMERA_AXES
        self.notes = tuple(sequence.notes)
        self._poses = None
        if frame == "world" and sequence.poses is not None:
            self._poses = relative_poses(sequence.poses, sequence.frame_count, sequence.name)
        self._bounds_m: tuple[tuple[int, int], Float64s] | None = None
        self._step_per_m = step_per_m
        self._frame_of_reference, self._rule = frame, SegmentRule.parse(segment)
        self._bodies: tuple[Body, ...] = ()
        self._latest: tuple[int, SurfacePlanes] | None = None

    def bounds_m(self) -> NDArray[np.float64]:
        """The box of the surface over all frames, metres, float64 [2, 3].

        From the 0.5th to the 99.5th percentile along each axis of every eighth pixel of every eighth row (fewer,
        if that would be more than four million points in all), so that stray readings do not count. Reads every
        frame once that is not interpolated; the answer is kept.

        Raises
        ------
        SourceError
            If no frame holds any depth.
        """
        return self.bounds_between_m(0, self.frame_count)

    def bounds_between_m(self, start: int, stop: int) -> NDArray[np.float64]:
        """See `bounds_m`, of frames start to stop - 1; of these those that are not interpolated, or the first."""
        if self._bounds_m is None or self._bounds_m[0] != (start, stop):
            frames = [i for i in self.sequence.key_frames() if start <= i < stop] or [start]
            count = self.sequence.width * self.sequence.height * len(frames)
            stride = max(_BOX_STRIDE_PX, int(np.ceil(np.sqrt(count / _BOX_POINTS))))
            points = np.concatenate([self._points_m(i, stride) for i in frames])
            if not len(points):
                raise SourceError(self.sequence.name, "no depth in any frame", "at least one pixel with depth")
            self._bounds_m = (start, stop), np.percentile(points, _BOX_PERCENTILES, axis=0)
        return self._bounds_m[1].copy()

    def pose(self, frame: int) -> NDArray[np.float64]:
        """The camera's pose in the scene: scene from camera, float64 [4, 4]."""
        return np.eye(4) if self._poses is None else self._poses[frame]

    def planes(self, frame: int) -> SurfacePlanes:
        """The tangent planes of one frame; those of the latest frame are kept."""
        if self._latest is None or self._latest[0] != frame:
            depth = self._depth_m(frame)
            step_per_m = self._noise_step_per_m(depth if frame == 0 else None)
            self._latest = frame, surface_planes(depth, self.sequence.intrinsics, step_per_m)
        return self._latest[1]

    def bodies(self) -> tuple[Body, ...]:
        """The objects that depth steps part from each other, and the background; see `touchfield.sources.segments`.

        Reads every frame once; the answer is kept, and a note is added to `notes`.

        Raises
        ------
        SourceError
            If no frame holds any depth, or one cannot be read.
        """
        if not self._bodies:
            step_per_m, frame = self._noise_step_per_m(), self._frame_of_reference

            def scene_of(part: DepthSequence) -> DepthScene:
                return DepthScene(part, frame, step_per_m=step_per_m)

            self._bodies, note = segmented_bodies(scene_of, self.sequence, self._rule, step_per_m)
            self.notes = (*self.notes, note)
        return self._bodies

    def _noise_step_per_m(self, first_m: NDArray[np.float32] | None = None) -> float:
        """Of the first frame (`first_m`, where it is at hand), so that a field depends on nothing but its frame."""
        if self._step_per_m is None:
            self._step_per_m = noise_step_per_m(self._depth_m(0) if first_m is None else first_m)
        return self._step_per_m

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """The force field of one frame at the points of `grid`; see the module.

        Raises
        ------
        SourceError
            If the frame cannot be read.
        InvalidArgument
            If there is no such frame, or the field is too large for the memory.
        """
        return plane_forces(self.planes(frame), self.pose(frame), grid, profile)

    def _depth_m(self, frame: int) -> NDArray[np.float32]:
        sequence = self.sequence
        if not 0 <= frame < self.frame_count:
            raise InvalidArgument("frame", str(frame), f"0 to {self.frame_count - 1}")
        depth = np.ascontiguousarray(sequence.depth_m(frame), np.float32)
        if depth.shape != (sequence.height, sequence.width):
            expected = f"({sequence.height}, {sequence.width}), as the first one"
            raise SourceError(f"{sequence.name}, frame {frame}", f"a picture of shape {depth.shape}", expected)
        return depth

    def _points_m(self, frame: int, stride: int) -> Float64s:
        """Back-projected pixels in scene coordinates, float64 [n, 3]."""
        k = self.sequence.intrinsics
        depth = self._depth_m(frame)
        half = min(stride, *depth.shape) // 2
        z = depth[half::stride, half::stride].astype(np.float64)
        v, u = np.nonzero((z > 0) & np.isfinite(z))
        z = z[v, u]
        rays = np.stack([(u * stride + half - k.cx) / k.fx, (v * stride + half - k.cy) / k.fy, np.ones(len(z))], -1)
        pose = self.pose(frame)
        points: Float64s = (rays * z[:, None]) @ pose[:3, :3].T + pose[:3, 3]
        return points


def relative_poses(poses: Float64s, count: int, name: str) -> Float64s:
    """Poses relative to the first one, with rotations made exact, float64 [count, 4, 4].

    Raises
    ------
    SourceError
        If there are too few, one is not finite, or one is not a rigid motion to within 1 %.
    """
    poses = np.asarray(poses, np.float64)
    if poses.shape != (count, 4, 4):
        raise SourceError(f"{name}, poses", f"shape {poses.shape}", f"({count}, 4, 4): one for each frame")
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(poses).all(axis=(1, 2)))
    turns = np.where(finite[:, None, None], poses, 0.0)[:, :3, :3]
    left, _, right = np.linalg.svd(turns)
    exact = left @ right
    odd = np.flatnonzero(~finite | (np.abs(turns - exact).max(axis=(1, 2)) > 0.01) | (np.linalg.det(exact) < 0))
    if len(odd):
        where = f"{name}, pose of frame {odd[0]}"
        raise SourceError(where, "no rigid motion", "a rotation and a shift", 'Read it with frame="camera".')
    clean = np.tile(np.eye(4), (count, 1, 1))
    clean[:, :3, :3] = exact
    clean[:, :3, 3] = poses[:, :3, 3]
    clean[:, :3, 3] -= clean[0, :3, 3]
    back = clean[0, :3, :3].T
    clean[:, :3] = back @ clean[:, :3]
    return clean


def plane_forces(surface: SurfacePlanes, pose: Float64s, grid: Grid, profile: ForceProfile) -> ForceField:
    """The force field of the planes of one depth map.

    Parameters
    ----------
    surface : SurfacePlanes
        In camera axes.
    pose : float64 [4, 4]
        Scene from camera, a rigid motion.
    grid : Grid
        In scene metres.
    profile : ForceProfile
        In scene metres.

    Raises
    ------
    InvalidArgument
        If the field is too large for the memory.
    """
    from touchfield.sources.kernels import depth as kernels

    query = query_of(surface, pose, grid, profile)
    bricks = force_bricks(query, grid)
    return ForceField(grid, bricks, kernels.brick_forces(bricks, query))


def force_bricks(query: Query, grid: Grid) -> NDArray[np.int32]:
    """Bricks of `grid` with at least one force, int32 [n, 3], ascending."""
    from touchfield.sources.kernels import depth as kernels

    candidates = _candidates(query, grid)
    return candidates[kernels.holds_force(candidates, query)]


def query_of(surface: SurfacePlanes, pose: Float64s, grid: Grid, profile: ForceProfile) -> Query:
    """The planes of a depth map (camera axes) before a lattice and a law in scene metres, as kernels take them."""
    from touchfield.sources.kernels.depth import Query

    turn = pose[:3, :3]
    lattice = np.empty((4, 3))
    lattice[0] = (np.asarray(grid.origin_m) - pose[:3, 3]) @ turn
    lattice[1:] = np.asarray(grid.spacing_m)[:, None] * turn
    nothing = (0.0, 0.0, 0.0, 0.0)  # an empty piece: the kernel wants at least two
    pieces = np.vstack([profile.table(), *[[nothing]] * max(0, 2 - len(profile.pieces))])
    return Query(
        planes=surface.planes,
        tiles=surface.tiles,
        places=surface.places,
        size_px=surface.size_px,
        camera_px=surface.camera_px,
        lattice_m=lattice,
        shape=grid.shape,
        turn=turn.astype(np.float32),
        pieces=pieces.astype(np.float32),
        reach=np.array([max(profile.high_m, 0.0), max(-profile.low_m, 0.0), RAY_LIMIT], np.float32),
    )


def _candidates(query: Query, grid: Grid) -> NDArray[np.int32]:
    """Bricks that cannot be ruled out, int32 [n, 3], ascending.

    Cubes of bricks are halved from a size at which they are few, so that the work and the memory follow the
    surface and not the grid.
    """
    from touchfield.sources.kernels import depth as kernels

    span = 1
    shape = grid.brick_shape
    while shape[0] * shape[1] * shape[2] > _NODES_AT_ONCE:
        span *= 2
        shape = _nodes_along(grid, span)
    nodes = kernels.all_nodes(shape)
    nodes = nodes[kernels.may_hold_force(nodes, span, query)]
    corners = kernels.all_nodes((2, 2, 2))
    sorted_already = span == 1
    while span > 1:
        span //= 2
        nodes = (2 * nodes[:, None] + corners).reshape(-1, 3)
        nodes = nodes[(nodes < _nodes_along(grid, span)).all(axis=1)]
        nodes = nodes[kernels.may_hold_force(nodes, span, query)]
    return nodes if sorted_already else nodes[np.lexsort(nodes.T[::-1])]


def _nodes_along(grid: Grid, span: int) -> tuple[int, int, int]:
    nx, ny, nz = (-(-n // (BRICK * span)) for n in grid.shape)
    return nx, ny, nz
