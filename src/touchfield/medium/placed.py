"""Fields in motion: the force that the objects of a haptic scene make at points, and on a lattice."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.medium.field import ForceField

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.medium.grid import Grid
    from touchfield.medium.haptic_scene import HapticScene

__all__ = ["sample", "voxels"]


def sample(scene: HapticScene, frame: int, positions_m: ArrayLike) -> NDArray[np.float32]:
    """See `HapticScene.sample_n`."""
    points = np.asarray(positions_m, np.float64)
    total = np.zeros((*points.shape[:-1], 3))
    for one in scene.objects:
        own = one.field(frame).sample_n(one.track.to_body(points, frame)).astype(np.float64)
        total += own @ one.track.rotation(frame).T
    length = np.sqrt((total * total).sum(axis=-1, keepdims=True))
    return (total * np.minimum(1.0, scene.force_max_n / np.where(length > 0, length, 1.0))).astype(np.float32)


def voxels(scene: HapticScene, frame: int, grid: Grid) -> ForceField:
    """One frame on a lattice."""
    index = np.moveaxis(np.indices(grid.shape), 0, -1)
    return ForceField.from_dense(grid, sample(scene, frame, grid.to_m(index)))
