"""Makes one tiny scene of each kind. `touchfield warmup` uses them to compile every inner loop, and so do
tests."""

from __future__ import annotations

import numpy as np

from touchfield.arrays import Float32s
from touchfield.medium import PoseTrack
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Ellipsoid, Sphere
from touchfield.sources.terrain.height_scene import HeightScene


class _Ramp(DepthSequence):
    """Two frames of a tilted wall with a hole, seen by a camera that moves a little."""

    name = "ramp"
    frame_count, width, height = 2, 64, 48
    intrinsics = Intrinsics(60.0, 60.0, 31.5, 23.5)
    rate_hz = 30.0

    def __init__(self) -> None:
        self.poses = np.stack([np.eye(4), np.eye(4)])
        self.poses[1, 0, 3] = 0.01

    def depth_m(self, frame: int) -> Float32s:
        depth = np.tile(np.linspace(1.0, 1.5, self.width, dtype=np.float32), (self.height, 1))
        depth[10:14, 10:14] = 0
        return depth


def tiny_scenes() -> list[Scene]:
    """Return one small scene for each kind of generator."""
    heights = np.fromfunction(lambda i, j: 0.1 * np.sin(i / 3) * np.cos(j / 4), (24, 24))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    track = PoseTrack(
        np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.6, 0.0, 0.0]]), np.array([[0.0, 0, 0], [0.1, 0, 0]])
    )
    return [
        DepthScene(_Ramp()),
        HeightScene(heights, (0.1, 0.1)),
        FusedScene(_Ramp()),
        AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.05), Ellipsoid((0.1, 0.0, 0.0), (0.03, 0.02, 0.01)))),
        MeshScene(corners, faces),
        MeshScene(corners, faces[:3]),
        MeshScene(np.concatenate([corners, corners + 0.1]), np.concatenate([faces, faces + 4])),
        BodyScene((Body("tetrahedron", MeshScene(corners, faces), track),), 30.0),
    ]
