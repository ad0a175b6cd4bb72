"""A small depth sequence for the experiments: a plane before a slightly moving camera."""

from __future__ import annotations

import numpy as np

from touchfield.sources.camera import DepthSequence, Intrinsics

NORMAL = np.array([0.2, -0.1, -1.0]) / np.linalg.norm([0.2, -0.1, -1.0])
OFFSET_M = -1.1
"""The plane NORMAL . p = OFFSET_M in world coordinates, about 1.1 m before the camera."""


class Plane(DepthSequence):
    """A plane with some unknown pixels, exact up to float32."""

    name = "/somewhere/plane"
    width, height = 48, 36
    intrinsics = Intrinsics(45.0, 46.0, 23.5, 17.5)
    rate_hz = 30.0

    def __init__(self, frame_count: int = 3, has_poses: bool = True, noise_per_m: float = 0.0) -> None:
        self.frame_count, self.noise_per_m = frame_count, noise_per_m
        self._poses = np.tile(np.eye(4), (frame_count, 1, 1))
        self._poses[:, 0, 3] = 0.01 * np.arange(frame_count)
        self.poses = self._poses if has_poses else None

    def depth_m(self, frame: int) -> np.ndarray:
        depth = plane_depth_m(self, self._poses[frame])
        noise = np.random.default_rng(frame).standard_normal(depth.shape) * self.noise_per_m
        depth = (1 / (1 / depth + noise)).astype(np.float32)
        depth[4:7, 5:8] = 0
        return depth


def plane_depth_m(sequence: DepthSequence, pose: np.ndarray) -> np.ndarray:
    """The depth of the plane for a camera at `pose`, float64 [height, width]."""
    camera = sequence.intrinsics
    v, u = np.mgrid[: sequence.height, : sequence.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    world_rays = rays @ pose[:3, :3].T
    return (OFFSET_M - NORMAL @ pose[:3, 3]) / (world_rays @ NORMAL)
