"""A fused surface changes after two views in a row that contradict it, not after two that have a view which
agrees between them.
"""

from __future__ import annotations

import numpy as np
import pytest

from fusion_makers import CAMERA, SIZE
from touchfield.medium import Grid
from touchfield.sources.camera import DepthSequence
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.laws import ForceProfile

GRID = Grid.over_box(np.array([-0.3, -0.3, 1.8]), np.array([0.3, 0.3, 2.6]), (24, 24, 64))
PROFILE = ForceProfile(((-0.18, 0.0, 0.0, -18.0),))
WALL_M = 2.0


class Walls(DepthSequence):
    """A wall across the view of a camera that stands still, at another depth in each frame."""

    width, height, intrinsics, rate_hz, name = SIZE[1], SIZE[0], CAMERA, 30.0, "walls"

    def __init__(self, depths_m: list[float]) -> None:
        self.depths_m, self.frame_count = depths_m, len(depths_m)
        self.poses = np.tile(np.eye(4), (len(depths_m), 1, 1))

    def depth_m(self, frame: int) -> np.ndarray:
        return np.full(SIZE, self.depths_m[frame], np.float32)


def surface_m(*depths_m: float) -> float:
    """Depth of the first force along the optical axis after the last view."""
    scene = FusedScene(Walls([*depths_m]), "causal")
    forces = scene.field(len(depths_m) - 1, GRID, PROFILE).to_dense()
    nearest = np.flatnonzero(forces[12, 12].any(axis=-1))[0]
    return float(GRID.origin_m[2] + GRID.spacing_m[2] * nearest)


@pytest.mark.parametrize("other_m", [2.04, 2.08, 2.4])
def test_a_surface_changes_after_two_contradicting_views_in_a_row(other_m: float) -> None:
    assert surface_m(WALL_M, WALL_M, other_m, WALL_M, other_m) == pytest.approx(WALL_M, abs=GRID.spacing_m[2])
    moved_m = surface_m(WALL_M, WALL_M, other_m, other_m, other_m)
    assert moved_m == pytest.approx(other_m, abs=GRID.spacing_m[2])
