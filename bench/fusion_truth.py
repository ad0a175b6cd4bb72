"""Makes a synthetic Kinect sequence whose surface is known exactly (wall, floor, ball and box), to measure
the accuracy of fusion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from touchfield.medium import ForceField, Grid
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.laws import ForceProfile

Float64s = NDArray[np.float64]

FRAMES = 12
STIFFNESS_N_PER_M, WALL_M = 18.0, 0.18
LOOKED_AT_M = (-0.06, -0.03)
"""Depths behind the true surface that are compared; both fields have forces there."""
QUANTUM_PER_M = 2.85e-3
"""Step of the inverse depth, 1/m: one step of the Kinect's disparity."""


def distance_m(points_m: Float64s) -> Float64s:
    """Return the signed distance to the surface at points [..., 3], metres.

    It is negative inside.
    """
    wall, floor = 2.6 - points_m[..., 2], 0.8 - points_m[..., 1]
    ball = np.linalg.norm(points_m - (-0.5, 0.2, 2.1), axis=-1) - 0.35
    beyond = np.abs(points_m - (0.55, 0.3, 2.2)) - (0.25, 0.4, 0.2)
    box = np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(-1), 0)
    nearest: Float64s = np.minimum(np.minimum(wall, floor), np.minimum(ball, box))
    return nearest


class SyntheticKinect(DepthSequence):
    """The scene before a camera that turns.

    Depths have the axial noise of Nguyen, Izadi and Lovell (2012) and the steps of a Kinect's disparity.
    """

    def __init__(self) -> None:
        self.name, self.rate_hz, self.frame_count, self.notes = "room", 30.0, FRAMES, ()
        self.height, self.width = 240, 320
        self.intrinsics = Intrinsics(262.5, 262.5, 159.5, 119.5)
        self.poses = poses = np.tile(np.eye(4), (FRAMES, 1, 1))
        rng = np.random.default_rng(1)
        self._depths = []
        for pose, angle in zip(poses, np.linspace(-0.35, 0.35, FRAMES), strict=True):
            c, s = np.cos(angle), np.sin(angle)
            pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
            pose[:3, 3] = 1.2 * s, -0.1, 0.25 * (1 - c)
            self._depths.append(_measured(self._rendered(pose), rng))

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence`."""
        return self._depths[frame]

    def _rendered(self, pose: Float64s) -> Float64s:
        """Render the depth by sphere tracing, metres; 0 where nothing is within 6 m."""
        k = self.intrinsics
        v, u = np.mgrid[: self.height, : self.width]
        rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], -1) @ pose[:3, :3].T
        depth, length = np.full(u.shape, 0.3), np.linalg.norm(rays, axis=-1)
        for _ in range(120):
            depth = depth + distance_m(pose[:3, 3] + rays * depth[..., None]) / length
        return np.where(depth < 6, depth, 0.0)


def _measured(depth_m: Float64s, rng: np.random.Generator) -> NDArray[np.float32]:
    noisy = depth_m + rng.standard_normal(depth_m.shape) * (0.0012 + 0.0019 * (depth_m - 0.4) ** 2)
    steps = np.round(1 / np.maximum(noisy, 0.2) / QUANTUM_PER_M)
    return np.where((depth_m > 0) & (noisy > 0.2), 1 / (steps * QUANTUM_PER_M), 0).astype(np.float32)


def contact_errors_mm() -> dict[str, float]:
    """Return the median |error| of the surface in a single and in the fused field.

    The surface lies |F| / K in front of a sample; the same samples are compared in both fields. "ratio" is
    the fused error over that of the single frame.
    """
    sequence = SyntheticKinect()
    single, fused = DepthScene(sequence), FusedScene(sequence)
    low_m, high_m = single.bounds_m()
    grid = Grid.over_box(low_m - 0.05, high_m + 0.05, (200, 160, 200))
    profile = ForceProfile(((-WALL_M, 0.0, 0.0, -STIFFNESS_N_PER_M),))
    middle = FRAMES // 2
    amplitudes = [_amplitudes(scene.field(middle, grid, profile)) for scene in (single, fused)]
    assert sequence.poses is not None
    first = sequence.poses[0]
    indices = np.argwhere((amplitudes[0] > 0) & (amplitudes[1] > 0))
    true_m = distance_m(grid.to_m(indices) @ first[:3, :3].T + first[:3, 3])
    is_compared = (true_m > LOOKED_AT_M[0]) & (true_m < LOOKED_AT_M[1])
    at = tuple(indices[is_compared].T)
    single_mm, fused_mm = (
        1e3 * float(np.median(np.abs(f[at] / STIFFNESS_N_PER_M + true_m[is_compared]))) for f in amplitudes
    )
    return {
        "single_mm": single_mm,
        "fused_mm": fused_mm,
        "ratio": fused_mm / single_mm,
        "samples": int(is_compared.sum()),
    }


def _amplitudes(field: ForceField) -> NDArray[np.float32]:
    amplitudes: NDArray[np.float32] = np.linalg.norm(field.to_dense(), axis=-1)
    return amplitudes
