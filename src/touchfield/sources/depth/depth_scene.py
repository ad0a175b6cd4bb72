"""`DepthScene`: turns a sequence of depth images into a scene in metres. Each pixel becomes a piece of
surface in space, as the camera saw it.

The paper (sections 4 and 5.1) computes fields from depth video but gives no formula; nor does its reference
[21]. Here a sample is projected to its nearest pixel; phi is its signed distance to the tangent plane of the
surface there (negative behind) and n the normal of that plane towards the camera, so that F = f(phi) n. Only
visible surfaces exert forces: a pixel without depth, or without a reliable normal, gives none. A sample has a
force only if its distance from the surface along its own ray (in depth z) is at most `RAY_LIMIT` times the
reach of the profile on that side; otherwise a plane at a grazing angle would produce forces far behind the
surface. For a solid, whose profile reaches to -inf, there is no limit behind the surface.

With poses the scene lies in the coordinates of the first camera, so that the scene of a moving camera is
static.

Tangent planes use a property of the pinhole camera: over the pixels of a plane n . p = c the inverse depth
w = 1/z is a linear function of the pixel. A line fit to w is therefore exact on a plane, and its slopes give
the normal::

    n / c = (fx w_u, fy w_v, w - (u - cx) w_u - (v - cy) w_v)

The noise of disparity sensors is also constant in w. The steps for each pixel:

1. *Links.* Two neighbours lie on one surface if their w differ by at most a step g
   (`camera.noise_step_per_m`), or if their difference equals the previous or next one (within g) and is no
   steeper than `SLOPE_LIMIT_PX` pixels of depth per pixel. Links never cross a pixel without depth.
2. *Rows.* A least-squares line is fitted to the pixel and up to 4 pixels on each side that an unbroken chain
   of links reaches.
3. *Columns.* The same fit is made along columns, over the results of the rows; the slopes of the rows are
   averaged, weighted by their support. The plane goes through the fitted w, not through the noisy pixel.
4. A pixel has no plane if too few pixels support it (fewer than three in line), or if the ray meets the
   surface at more than 84 degrees.

A step edge that is higher than g (in w) and than `SLOPE_LIMIT_PX` pixel footprints therefore ends the support
and never tilts a normal.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int32s
from touchfield.compute.cuda import on_device, uses_gpu
from touchfield.errors import SourceError, require_one_of
from touchfield.medium import BRICK, ForceField, Grid
from touchfield.sources.camera import DepthSequence, noise_step_per_m, require_frame
from touchfield.sources.depth.kernels import field as kernels
from touchfield.sources.depth.kernels.field import Query
from touchfield.sources.depth.kernels.planes import SurfacePlanes, surface_planes
from touchfield.sources.depth.segmentation import SegmentRule, segmented_bodies
from touchfield.sources.laws import ForceProfile
from touchfield.sources.poses import checked_poses
from touchfield.sources.scene import CAMERA_AXES, DEPTH_UNIT, Body, MovingScene, find_bricks_by_block

RAY_LIMIT: Final = 4.0  # limits the thickness of walls at more than 75 degrees to the ray

_IJK = np.indices((BRICK, BRICK, BRICK), np.float64).reshape(3, -1)
_BOX_POINTS = 4_000_000  # maximum number of points that `bounds_m` uses
_BOX_STRIDE_PX = 8
_BOX_PERCENTILES = (0.5, 99.5)


class DepthScene(MovingScene):
    """A depth sequence as a scene of thin walls, in metres.

    frame : str; "world": in the coordinates of the first camera, if the sequence has poses; "camera": each
        frame in the coordinates of its own camera.
    segment : str, optional; Segmentation rule of `bodies` (`segmentation.SegmentRule.parse`).
    step_per_m : float, optional; The noise step of the sensor, 1/m; by default estimated from the first
        frame.
    """

    box_wording = "99 % of the surface along each axis"
    unit = DEPTH_UNIT
    has_gpu = True

    def __init__(
        self,
        sequence: DepthSequence,
        frame: str = "world",
        segment: str | None = None,
        step_per_m: float | None = None,
    ) -> None:
        require_one_of("frame", frame, ("world", "camera"))
        self.sequence = sequence
        self.frame_count = sequence.frame_count
        self.rate_hz = sequence.rate_hz
        self.axes = CAMERA_AXES
        self.notes, self.is_captured = tuple(sequence.notes), sequence.is_captured
        self._poses = None
        if frame == "world" and sequence.poses is not None:
            poses, where = np.asarray(sequence.poses, np.float64), f"{sequence.name}, poses"
            if poses.shape != (sequence.frame_count, 4, 4):
                expected = f"({sequence.frame_count}, 4, 4): one for each frame"
                raise SourceError(where, f"shape {poses.shape}", expected)
            self._poses = checked_poses(poses[:, :3], where)
            self._poses[:, :3, 3] -= self._poses[0, :3, 3]
            self._poses[:, :3] = self._poses[0, :3, :3].T @ self._poses[:, :3]
        self._step_per_m = step_per_m
        self._frame_of_reference, self._rule = frame, SegmentRule.parse(segment)
        self._bodies: tuple[Body, ...] = ()
        self._latest: tuple[int, SurfacePlanes] | None = None

    def _box_m(self, start: int, stop: int) -> Float64s:
        """Return the 0.5th to 99.5th percentile along each axis, so that outliers do not count.

        Uses every eighth pixel of every eighth row, or fewer if that exceeds four million points. Reads each
        key frame of the range once, or the first frame of the range if it has no key frame. Raises
        `SourceError` if no frame has any depth.
        """
        sequence, k = self.sequence, self.sequence.intrinsics
        keys = () if sequence.is_captured else sequence.key_frames()
        frames = [i for i in keys if start <= i < stop] or [start]
        count = sequence.width * sequence.height * len(frames)
        stride = max(_BOX_STRIDE_PX, int(np.ceil(np.sqrt(count / _BOX_POINTS))))
        half = min(stride, sequence.height, sequence.width) // 2
        points: list[Float64s] = []
        for frame in frames:
            z = self._depth_m(frame)[half::stride, half::stride].astype(np.float64)
            v, u = np.nonzero((z > 0) & np.isfinite(z))
            z = z[v, u]
            x, y = (u * stride + half - k.cx) / k.fx, (v * stride + half - k.cy) / k.fy
            rays, pose = np.stack([x, y, np.ones(len(z))], -1), self.pose(frame)
            points.append((rays * z[:, None]) @ pose[:3, :3].T + pose[:3, 3])
        if not any(map(len, points)):
            raise SourceError(sequence.name, "no depth in any frame", "at least one pixel with depth")
        box: Float64s = np.percentile(np.concatenate(points), _BOX_PERCENTILES, axis=0)
        return box

    def pose(self, frame: int) -> Float64s:
        """Return the pose of the camera, scene from camera, float64 [4, 4]."""
        return np.eye(4) if self._poses is None else self._poses[frame]

    def planes(self, frame: int) -> SurfacePlanes:
        """Return the tangent planes of one frame; those of the latest frame are cached."""
        if self._latest is None or self._latest[0] != frame:
            depth = self._depth_m(frame)
            step_per_m = self._noise_step_per_m(depth if frame == 0 else None)
            self._latest = frame, surface_planes(depth, self.sequence.intrinsics, step_per_m)
        return self._latest[1]

    def bodies(self) -> tuple[Body, ...]:
        """Return the objects separated by depth steps, and the background.

        See `segmentation`.
        """
        if not self._bodies:
            step_per_m, frame = self._noise_step_per_m(), self._frame_of_reference
            self._bodies, note = segmented_bodies(
                lambda part: DepthScene(part, frame, step_per_m=step_per_m),
                self.sequence,
                self._rule,
                step_per_m,
            )
            self.notes = (*self.notes, note)
        return self._bodies

    def _noise_step_per_m(self, first_m: Float32s | None = None) -> float:
        """Return the noise step of the first frame (`first_m`, if given) for all frames.

        A field then depends on its frame only, not on the order of requests.
        """
        if self._step_per_m is None:
            self._step_per_m = noise_step_per_m(self._depth_m(0) if first_m is None else first_m)
        return self._step_per_m

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """Return the force field of one frame at the points of `grid`; see the module."""
        return plane_forces(self.planes(frame), self.pose(frame), grid, profile)

    def skip_frame(self, frame: int) -> None:
        """See `Scene.skip_frame`: pictures that are shown in order lose one, so that they stay in time."""
        self.sequence.skip_frame(frame)

    def _depth_m(self, frame: int) -> Float32s:
        sequence = self.sequence
        require_frame(frame, self.frame_count)
        depth = np.ascontiguousarray(sequence.depth_m(frame), np.float32)
        if depth.shape != (sequence.height, sequence.width):
            expected = f"({sequence.height}, {sequence.width}), as the first one"
            raise SourceError(
                f"{sequence.name}, frame {frame}", f"a picture of shape {depth.shape}", expected
            )
        return depth


def plane_forces(surface: SurfacePlanes, pose: Float64s, grid: Grid, profile: ForceProfile) -> ForceField:
    """Return the force field of the planes of a depth map.

    `pose` float64 [4, 4] is scene from camera.
    """
    query = query_of(surface, pose, grid, profile)
    if uses_gpu():
        query = on_device(query)
    bricks = force_bricks(query, grid)
    return ForceField(grid, bricks, kernels.brick_forces(bricks, query))


def force_bricks(query: Query, grid: Grid) -> Int32s:
    """Find the bricks of `grid` with at least one force, int32 [n, 3], ascending."""
    if uses_gpu():
        return kernels.bricks_by_gpu(query, grid)
    candidates = find_bricks_by_block(lambda blocks, size: kernels.may_hold_force(blocks, size, query), grid)
    return candidates[kernels.holds_force(candidates, query)]


def query_of(surface: SurfacePlanes, pose: Float64s, grid: Grid, profile: ForceProfile) -> Query:
    """Combine planes with a lattice and a profile for the kernels.

    Planes are in camera axes, lattice and profile in scene metres.
    """
    rotation = pose[:3, :3]
    lattice = np.empty((4, 3))
    lattice[0] = (np.asarray(grid.origin_m) - pose[:3, 3]) @ rotation
    lattice[1:] = np.asarray(grid.spacing_m)[:, None] * rotation
    reach = RAY_LIMIT * np.array([max(profile.high_m, 0.0), max(-profile.low_m, 0.0)], np.float32)
    with np.errstate(divide="ignore"):  # inf if there is no plane
        nearest_m = np.float32(0.999) / surface.tiles[..., 0].max()
    offsets = (lattice[1:].T @ _IJK).astype(np.float32).reshape(-1)
    pieces, first_m = profile.table().astype(np.float32), max(0.0, float(nearest_m - reach[0]))
    return Query(surface, lattice, grid.shape, offsets, rotation.astype(np.float32), pieces, reach, first_m)
