"""A small synthetic room seen by a depth camera from known poses, for tests of layouts and lenses.

The room is the inside of the box from (-1.6, -1.1, -0.5) to (1.7, 1.2, 3.1), metres, in the axes of the first
picture: x right, y down, z forward. Depth is exact at pixel centres.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

LOW, HIGH = np.array([-1.6, -1.1, -0.5]), np.array([1.7, 1.2, 3.1])
WIDTH, HEIGHT = 96, 72
CAMERA = (80.0, 82.0, 46.5, 36.0)  # fx, fy, cx, cy
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])

Distort = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def poses(count: int = 4) -> np.ndarray:
    """Camera to world, float64 [count, 4, 4]: turning about all axes, moving by 6 cm a frame."""
    matrices = np.tile(np.eye(4), (count, 1, 1))
    for i, matrix in enumerate(matrices):
        yaw, pitch, roll = 0.10 * i, 0.05 * i, -0.04 * i
        about_y = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
        about_x = [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
        about_z = [[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]]
        matrix[:3, :3] = np.array(about_y) @ about_x @ about_z
        matrix[:3, 3] = 0.06 * i, -0.03 * i, 0.04 * i
    return matrices


def quaternions(matrices: np.ndarray) -> np.ndarray:
    """x, y, z, w, float64 [n, 4]."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(matrices[:, :3, :3]).as_quat()


def undistorted(x: np.ndarray, y: np.ndarray, distort: Distort) -> tuple[np.ndarray, np.ndarray]:
    """Normalised coordinates whose distortion is x, y, by iteration."""
    found_x, found_y = x.copy(), y.copy()
    for _ in range(200):
        at_x, at_y = distort(found_x, found_y)
        found_x, found_y = found_x + 0.5 * (x - at_x), found_y + 0.5 * (y - at_y)
    return found_x, found_y


def brown(*k: float) -> Distort:
    """Brown's distortion with k1, k2, p1, p2, k3."""
    k1, k2, p1, p2, k3 = (*k, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]

    def distort(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        to_x = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        to_y = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return x * radial + to_x, y * radial + to_y

    return distort


def fisheye(*k: float) -> Distort:
    """Kannala and Brandt's distortion with k1 to k4."""

    def distort(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r = np.hypot(x, y) + 1e-12
        theta = np.arctan(r)
        bent = theta * (1 + sum(value * theta ** (2 * i + 2) for i, value in enumerate(k)))
        return x * bent / r, y * bent / r

    return distort


def depth_m(
    pose: np.ndarray,
    camera: tuple[float, float, float, float] = CAMERA,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    distort: Distort | None = None,
) -> np.ndarray:
    """Depth along the optical axis, metres, float64 [height, width]."""
    fx, fy, cx, cy = camera
    v, u = np.mgrid[0 : size[1], 0 : size[0]].astype(np.float64)
    x, y = (u - cx) / fx, (v - cy) / fy
    if distort is not None:
        x, y = undistorted(x, y, distort)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ pose[:3, :3].T
    return along_rays_m(rays, pose[:3, 3])


def along_rays_m(rays: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Multiples of rays, float64 [..., 3], at which they meet a wall."""
    rays = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    distances = np.where(rays > 0, (HIGH - start) / rays, (LOW - start) / rays)
    return distances.min(axis=-1)


def depths_mm(count: int = 4, **options: object) -> np.ndarray:
    """Millimetres of all poses, uint16 [count, height, width]."""
    return np.stack([np.rint(1000 * depth_m(pose, **options)) for pose in poses(count)]).astype(np.uint16)


def write_png(path: Path, values: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(values).save(path)
    return path


def distances_to_walls_m(sequence: object, frame: int) -> np.ndarray:
    """Distance of each point of a frame to the nearest wall, in the coordinates of the first pose, [n].

    The poses of the sequence may be of any world: only their change from the first frame counts.
    """
    k, depth = sequence.intrinsics, np.asarray(sequence.depth_m(frame), np.float64)
    v, u = np.nonzero(depth > 0)
    z = depth[v, u]
    points = np.stack([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z], axis=-1)
    pose = np.linalg.inv(sequence.poses[0]) @ sequence.poses[frame]
    points = points @ pose[:3, :3].T + pose[:3, 3]
    return np.minimum(np.abs(points - LOW), np.abs(points - HIGH)).min(axis=1)


def assert_room(sequence: object, tolerance_m: float = 0.004, known: float = 0.95, count: int = 4) -> None:
    """Assert that every frame shows the room where the poses say: 95 % of the points within the tolerance."""
    assert sequence.frame_count == count
    assert sequence.poses is not None
    for frame in range(count):
        distances = distances_to_walls_m(sequence, frame)
        assert len(distances) >= known * sequence.width * sequence.height
        assert np.quantile(distances, 0.95) < tolerance_m, (
            frame,
            np.quantile(distances, [0.5, 0.9, 0.95, 1]),
        )
