"""Every kind of source places its surface correctly: to a hundredth of a sample, along each axis.

The surface is a plane at a known position, tilted so that a shift along any axis moves it. The depth of a
sample is derived from the force of a linear law.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from touchfield.medium import ForceField, Grid, HapticMedium, PoseTrack
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import UP_Z_AXES, Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Plane
from touchfield.sources.stored import StoredScene
from touchfield.sources.terrain.height_scene import HeightLattice, HeightScene

GRID = Grid((17, 16, 18), (0.004, 0.005, 0.003), (-0.0317, -0.0386, 0.4713))
DEPTH_M, K = 0.012, 100.0
LAW = ForceProfile(((-DEPTH_M, 0.0, 0.0, -K),))
MIDDLE = np.array([0.0, 0.0, 0.5])
TILTS = ([0.35, 0.0, -1.0], [0.0, -0.45, -1.0], [-0.3, 0.4, -1.0])  # towards a camera that looks along +z


def unit(normal: list[float]) -> np.ndarray:
    return np.array(normal) / np.linalg.norm(normal)


def block(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A rotation whose third column is the normal, and the centre of a large block below the plane."""
    turn, _ = Rotation.align_vectors([normal], [[0.0, 0.0, 1.0]])
    return turn.as_matrix(), MIDDLE - 0.2 * normal


def shape(normal: np.ndarray) -> Scene:
    return AnalyticScene((Plane(tuple(MIDDLE), tuple(normal)),), "union", UP_Z_AXES)


def body(normal: np.ndarray) -> Scene:
    turn, middle = block(normal)
    box = AnalyticScene((Box((0.0, 0.0, 0.0), (0.2, 0.2, 0.2)),), "union", UP_Z_AXES)
    quaternion = Rotation.from_matrix(turn).as_quat(scalar_first=True)
    return BodyScene([Body("block", box, PoseTrack(quaternion[None], middle[None]))], 30.0)


def mesh(normal: np.ndarray) -> Scene:
    turn, middle = block(normal)
    corners = 0.2 * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    return MeshScene(corners @ turn.T + middle, triangles)


def heights(normal: np.ndarray) -> Scene:
    """Sampled more coarsely than the lattice, at other positions; solid below the surface."""
    x, y = -0.053 + 0.0061 * np.arange(20), 0.061 - 0.0057 * np.arange(24)
    z = MIDDLE[2] - (normal[0] * x + normal[1] * y[:, None]) / normal[2]
    return HeightScene(z, HeightLattice(x[0], 0.0061, y[0], -0.0057, -1))


class Camera(DepthSequence):
    """Exact depth maps of a plane; the second camera has axes different from those of the scene."""

    def __init__(self, normal: np.ndarray) -> None:
        self.intrinsics, self.name, self.rate_hz = Intrinsics(190.0, 180.0, 70.3, 58.8), "plane", 30.0
        self.frame_count, self.height, self.width = 2, 121, 143
        self.poses, k = np.tile(np.eye(4), (2, 1, 1)), self.intrinsics
        self.poses[1, :3, :3] = Rotation.from_euler("xyz", [4.0, -3.0, 20.0], degrees=True).as_matrix()
        self.poses[1, :3, 3] = 0.02, -0.01, 0.03
        v, u = np.mgrid[: self.height, : self.width]
        self._rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], axis=-1)
        self._normal = normal

    def depth_m(self, frame: int) -> np.ndarray:
        turn, position = self.poses[frame, :3, :3], self.poses[frame, :3, 3]
        along = self._rays @ turn.T @ self._normal
        return np.asarray((MIDDLE - position) @ self._normal / along, np.float32)


def depth(normal: np.ndarray) -> Scene:
    return DepthScene(Camera(normal))


def stored(normal: np.ndarray) -> Scene:
    """The force of the plane on a shifted lattice of half the spacing; linear inside the wall."""
    fine = Grid.over_box(
        *(np.array(edge) + shift for edge, shift in zip(GRID.box_m, (-0.0071, 0.0083))), (40, 42, 46)
    )
    return StoredScene(HapticMedium.from_frames([shape(normal).field(0, fine, LAW)], 30.0, UP_Z_AXES))


SOURCES: dict[str, Callable[[np.ndarray], Scene]] = {
    "shape": shape, "body": body, "mesh": mesh, "heights": heights, "depth": depth, "stored": stored,
}  # fmt: skip


def depths_of(field: ForceField, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """True and measured depths below the plane, metres, of samples well inside the wall."""
    points = GRID.to_m(np.moveaxis(np.indices(GRID.shape), 0, -1))
    true = (MIDDLE - points) @ normal
    is_inside = (true > 0.3 * DEPTH_M) & (true < 0.7 * DEPTH_M)
    is_inside &= (np.abs(points[..., :2]) < 0.02).all(axis=-1)  # away from the rim of maps
    forces = field.to_dense().astype(np.float64)[is_inside]
    np.testing.assert_allclose(
        forces / np.linalg.norm(forces, axis=1)[:, None], np.tile(normal, (len(forces), 1)), atol=2e-3
    )
    return true[is_inside], np.linalg.norm(forces, axis=1) / K


@pytest.mark.parametrize("tilt", TILTS)
@pytest.mark.parametrize("name", SOURCES)
def test_a_surface_is_at_its_position(name: str, tilt: list[float]) -> None:
    normal = unit(tilt)
    scene = SOURCES[name](normal)
    field = scene.field(scene.frame_count - 1, GRID, LAW)
    true, measured = depths_of(field.on_grid(GRID) if field.grid != GRID else field, normal)
    assert len(true) > 100
    shift = (measured - true) / (np.abs(normal) @ GRID.spacing_m)  # in samples along the normal
    assert np.abs(shift).max() < 0.05 and abs(shift.mean()) < 0.01
