"""Depth sequences of a synthetic room with ground truth: a wall, a floor, a ball and a box that may move."""

from __future__ import annotations

from functools import cache

import numpy as np

from touchfield.medium import ForceField
from touchfield.sources.camera import DepthSequence, Intrinsics

SIZE = (120, 160)
CAMERA = Intrinsics(131.25, 131.25, 79.5, 59.5)
BOX_M = (0.55, 0.3, 2.2)
HALF_M = np.array([0.25, 0.4, 0.2])
QUANTUM_PER_M = 2.85e-3
"""Step of inverse depth: one step of a Kinect's disparity."""


def distance_m(points: np.ndarray, box: tuple[float, float, float] = BOX_M) -> np.ndarray:
    """Signed distance to the room's surfaces, negative inside."""
    x, y, z = (np.ascontiguousarray(points[..., axis]) for axis in range(3))
    a, b, c = (np.abs(p - middle) - half for p, middle, half in zip((x, y, z), box, HALF_M, strict=True))
    beyond = np.sqrt(np.maximum(a, 0) ** 2 + np.maximum(b, 0) ** 2 + np.maximum(c, 0) ** 2)
    boxed = beyond + np.minimum(np.maximum(np.maximum(a, b), c), 0)
    ball = np.sqrt((x + 0.5) ** 2 + (y - 0.2) ** 2 + (z - 2.1) ** 2) - 0.35
    return np.minimum.reduce([2.6 - z, 0.8 - y, ball, boxed])


def arc(count: int, angle: float = 0.7) -> np.ndarray:
    """Camera-to-world poses of a camera that moves around the room, float64 [count, 4, 4]."""
    out = np.tile(np.eye(4), (count, 1, 1))
    for pose, fraction in zip(out, np.linspace(-0.5, 0.5, count), strict=True):
        c, s = np.cos(fraction * angle), np.sin(fraction * angle)
        pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
        pose[:3, 3] = [1.2 * s, -0.1, 0.25 * (1 - c)]
    return out


@cache
def rendered_m(pose_bytes: bytes, box: tuple[float, float, float]) -> np.ndarray:
    """Depth of each pixel by sphere tracing; the pose as the bytes of float64 [4, 4]."""
    pose = np.frombuffer(pose_bytes).reshape(4, 4)
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    rays = (
        np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(SIZE)], -1)
        @ pose[:3, :3].T
    )
    lengths, depth = np.linalg.norm(rays, axis=-1), np.full(SIZE, 0.3)
    for _ in range(60):
        depth = depth + distance_m(pose[:3, 3] + rays * depth[..., None], box) / lengths
    return np.where(depth < 6, depth, 0.0)


def kinect(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Add the noise of Nguyen, Izadi and Lovell (2012) and a Kinect's quantisation."""
    noisy = depth_m + rng.standard_normal(depth_m.shape) * (0.0012 + 0.0019 * (depth_m - 0.4) ** 2)
    steps = np.round(1 / np.maximum(noisy, 0.2) / QUANTUM_PER_M)
    return np.where(depth_m > 0, 1 / (steps * QUANTUM_PER_M), 0).astype(np.float32)


class Room(DepthSequence):
    """The room before a depth camera; `boxes` are the centres of the box, one a frame."""

    width, height, intrinsics, rate_hz, notes, name = SIZE[1], SIZE[0], CAMERA, 30.0, (), "room"

    def __init__(self, poses: np.ndarray, boxes: list[tuple[float, float, float]] | None = None) -> None:
        self.frame_count, self.poses, rng = len(poses), poses, np.random.default_rng(1)
        self.boxes = boxes or [BOX_M] * len(poses)
        self._depths = [
            kinect(rendered_m(p.tobytes(), b), rng) for p, b in zip(poses, self.boxes, strict=True)
        ]
        self.first = poses[0]

    def depth_m(self, frame: int) -> np.ndarray:
        return self._depths[frame]

    def world(self, points_m: np.ndarray) -> np.ndarray:
        """From the coordinates of the scene (the first camera) to those of the room."""
        return points_m @ self.first[:3, :3].T + self.first[:3, 3]

    def contact_errors_m(self, field: ForceField, stiffness: float, frame: int = 0) -> np.ndarray:
        """Distance of the surface given by forces within 5 cm of it from that of the room, metres."""
        world_m = self.world(np.asarray(field.grid.to_m(field.positions())))
        depth = np.linalg.norm(field.vectors_n().astype(float), axis=1) / stiffness
        return (depth + distance_m(world_m, self.boxes[frame]))[depth < 0.05]


def walk(count: int) -> np.ndarray:
    """Camera-to-world poses of a hand-held camera that turns about all axes, float64 [count, 4, 4].

    Its steps have different lengths, so that no other reading of the poses gives the same motion.
    """
    out = np.tile(np.eye(4), (count, 1, 1))
    for i, pose in enumerate(out):
        t = 0.8 * (i / 4) ** 1.3 * 4 / max(4, count - 1)
        yaw, pitch, roll = 0.25 * np.sin(1.3 * t) - 0.1, 0.2 * np.sin(2.1 * t + 0.5), 0.15 * np.sin(1.7 * t)
        pose[:3, :3] = rotation(1, yaw) @ rotation(0, pitch) @ rotation(2, roll)
        pose[:3, 3] = 0.3 * np.sin(1.9 * t), 0.15 * np.sin(2.6 * t) - 0.1, 0.2 * np.sin(0.9 * t) - 0.1
    return out


def rotation(axis: int, angle: float) -> np.ndarray:
    """Rotation by an angle about an axis, float64 [3, 3]."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return out
