"""Scenes for a first run with no download: real ones that well-known libraries carry, and Scene 1 of the paper.

Also tiny ones for tests.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.options import SourceOptions
from touchfield.sources.scene import Scene

SAMPLES = ("shapes", "terrain", "motorcycle", "falling-4", "falling-7")


def sample(name: str, options: SourceOptions | None = None) -> Scene:
    """A scene by name.

    "shapes" is a tray of six shapes with a formula, which needs no library beside the core.
    "terrain" is the elevation model of the Jacksboro fault, Tennessee, that matplotlib carries (344 x 403
    samples of the Shuttle Radar Topography Mission); "motorcycle" is the Middlebury 2014 stereo pair that
    scikit-image carries, as a depth map. "falling-4" and "falling-7" are Scene 1 of the paper (section 5.1), bodies
    of low complexity that fall on the ground, 2000 frames in 2 s: four as its text has it, seven as its figure 5. The
    ground itself is not felt. The shapes and their places are not the paper's, which gives none.

    Raises `InvalidArgument` if there is no such sample, or the library that carries or simulates it is not installed.
    """
    options = options or SourceOptions()
    if name == "terrain":
        from touchfield.sources.height_map import jacksboro_scene

        return jacksboro_scene(options.exaggeration)
    if name == "motorcycle":
        from touchfield.sources.depth_reader import depth_scene
        from touchfield.sources.inverse_depth import motorcycle_sequence

        return depth_scene(motorcycle_sequence(), options)
    if name in ("shapes", "falling-4", "falling-7"):
        from importlib import resources

        from touchfield.sources.analytic_scene import read_analytic
        from touchfield.sources.physics import open_physics

        with resources.as_file(resources.files("touchfield.sources") / "scenes" / f"{name}.toml") as path:
            return read_analytic(path, options.rate_hz) if name == "shapes" else open_physics(path, options)
    raise InvalidArgument("sample", repr(name), f"one of {', '.join(SAMPLES)}")


class _Ramp(DepthSequence):
    """Two frames of a tilted wall with a hole, seen by a camera that moves a little."""

    name = "ramp"
    frame_count, width, height = 2, 64, 48
    intrinsics = Intrinsics(60.0, 60.0, 31.5, 23.5)
    rate_hz = 30.0

    def __init__(self) -> None:
        self.poses = np.stack([np.eye(4), np.eye(4)])
        self.poses[1, 0, 3] = 0.01

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        depth = np.tile(np.linspace(1.0, 1.5, self.width, dtype=np.float32), (self.height, 1))
        depth[10:14, 10:14] = 0
        return depth


def tiny_scenes() -> list[Scene]:
    """One small scene for each kind of generator, to compile every kernel."""
    from touchfield.medium import PoseTrack
    from touchfield.sources.analytic_scene import AnalyticScene
    from touchfield.sources.body_scene import BodyScene
    from touchfield.sources.depth_scene import DepthScene
    from touchfield.sources.fused_scene import FusedScene
    from touchfield.sources.height_scene import HeightScene
    from touchfield.sources.mesh_scene import MeshScene
    from touchfield.sources.scene import Body
    from touchfield.sources.shapes import Ellipsoid, Sphere

    heights = np.fromfunction(lambda i, j: 0.1 * np.sin(i / 3) * np.cos(j / 4), (24, 24))
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    turning = PoseTrack(np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.6, 0.0, 0.0]]), np.array([[0.0, 0, 0], [0.1, 0, 0]]))
    return [
        DepthScene(_Ramp()),
        HeightScene(heights, (0.1, 0.1)),
        FusedScene(_Ramp()),
        AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.05), Ellipsoid((0.1, 0.0, 0.0), (0.03, 0.02, 0.01)))),
        MeshScene(corners, faces),
        MeshScene(corners, faces[:3]),
        MeshScene(np.concatenate([corners, corners + 0.1]), np.concatenate([faces, faces + 4])),
        BodyScene((Body("tetrahedron", MeshScene(corners, faces), turning),), 30.0),
    ]
