"""Small haptic scenes for tests of the object representation, in integer arithmetic, equal on every
machine.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.objects.encoder import ObjectsEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.container import Head
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack

__all__ = ["F0_N", "ball", "head_of", "moving_scene", "tumbling"]

F0_N = 0.05


def ball(grid: Grid, radius_m: float, strength_n: float = 1.0) -> ForceField:
    """A shell that pushes outwards, strongest at half its radius."""
    points = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1))
    r = np.sqrt((points**2).sum(axis=-1, keepdims=True))
    amplitude = np.clip(1 - np.abs(2 * r / radius_m - 1), 0, None) * strength_n
    return ForceField.from_dense(grid, (amplitude * points / np.where(r > 0, r, 1.0)).astype(np.float32))


def tumbling(frame_count: int, start_m: float, turn_rad: float) -> PoseTrack:
    """A body that falls and rotates about an oblique axis."""
    t = np.arange(frame_count) / 1000.0
    position = np.stack([0.01 * t + start_m, 0.0 * t, 0.02 - 4.9 * t * t], axis=1)
    half = turn_rad * np.arange(frame_count) / 2
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    return PoseTrack(np.column_stack([np.cos(half), np.sin(half)[:, None] * axis]), position)


def moving_scene(frame_count: int = 7, deforming: bool = True, surface_damping: float = 0.0) -> HapticScene:
    """A tumbling body, a resting one, and a deforming one on request."""
    grid = Grid((11, 10, 9), (0.001, 0.001, 0.001), (-0.005, -0.0045, -0.004))
    world = Grid((20, 18, 16), (0.002, 0.002, 0.0025), (-0.019, -0.017, 0.0))
    objects = [
        HapticObject(
            "tumbler",
            HapticMedium.from_frames([ball(grid, 0.0045)], 1000.0),
            tumbling(frame_count, 0.003, 0.02),
        ),
        HapticObject(
            "stand",
            HapticMedium.from_frames([ball(world, 0.012, 0.5)], 1000.0),
            PoseTrack.constant(frame_count),
        ),
    ]
    if deforming:
        breathing = [ball(grid, 0.003 + 0.0002 * i, 1.0 + 0.1 * i) for i in range(frame_count)]
        objects.append(
            HapticObject(
                "balloon", HapticMedium.from_frames(breathing, 1000.0), tumbling(frame_count, -0.008, -0.01)
            )
        )
    return HapticScene(
        world, 1000.0, tuple(objects), 1.25, surface_damping, "x east, y north, z up", 0.2, 0.1
    )


def head_of(scene: HapticScene, encoder: ObjectsEncoder, spec: PaperSpec | None = None) -> Head:
    """The head of a file of a scene."""
    return Head(
        grid_shape=scene.grid.shape,
        spacing_m=scene.grid.spacing_m,
        origin_m=scene.grid.origin_m,
        rate_hz=scene.rate_hz,
        frame_count=scene.frame_count,
        axes=scene.axes,
        device_name="made up",
        device_type=1,
        force_max_n=scene.force_max_n,
        mapping_scale=1.0,
        mapping_offset_m=(0.0, 0.0, 0.0),
        weber_fraction=(spec or PaperSpec()).k,
        force_threshold_n=F0_N,
        friction=scene.friction,
        damping_n_s_per_m=scene.damping_n_s_per_m,
        tags=scene.tags,
        coder=encoder.name,
        coder_parameters=encoder.parameters,
    )
