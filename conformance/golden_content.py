"""Makes the force fields of the golden files (the stored files that every decoder must decode alike). They
are computed from whole numbers, so that they are the same on every machine."""

from __future__ import annotations

from typing import Any

import numpy as np

from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.medium import VibrationFrame

__all__ = ["LARGE", "apart", "block", "bodies", "hum", "nothing", "quarters", "solid", "wave"]

WALL = Grid((20, 17, 19), (0.00125, 0.001, 0.0005), (-0.01, -0.008, -0.004))
THIN = Grid((16, 16, 3), WALL.spacing_m, WALL.origin_m)
LARGE = Grid((4096, 2048, 4093), (0.0001, 0.0001, 0.0001), (-0.2, -0.1, 0.0))


def samples(grid: Grid) -> Any:
    """Indices along x, y, z, each int64 [nx, ny, nz]."""
    return np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")


def sloped(grid: Grid, amplitude: Any, *slope: Any) -> ForceField:
    """Forces of an amplitude along a slope, which need not be a unit."""
    along = np.stack([np.broadcast_to(s, grid.shape) for s in slope], axis=-1)
    return ForceField.from_dense(grid, (amplitude[..., None] * along).astype(np.float32))


def wave(t: int, grid: Grid = WALL) -> ForceField:
    """A wall that moves a little."""
    i, j, k = samples(grid)
    depth = 8 * k - 40 - ((3 * i + 2 * t) % 17) - ((5 * j) % 11)
    amplitude = np.where((depth > 0) & (depth < 40), depth, 0) / 128
    return sloped(grid, amplitude, (i * 7 + t) % 5 - 2, (j * 3) % 5 - 2, -8)


def quarters(t: int) -> ForceField:
    """A wall of whole quarters of a newton."""
    return ForceField.from_dense(WALL, np.rint(wave(t).to_dense() * 4) / np.float32(4))


def solid(t: int) -> ForceField:
    """All that is behind a surface with a step, saturated deep inside."""
    i, j, k = samples(WALL)
    depth = 4 * k - 15 - (i * i + 2 * t) % 7 - 12 * (j > 9)
    return sloped(WALL, np.clip(depth, 0, 16) / 64, i % 4, 1, -12)


def block(t: int, grid: Grid = WALL) -> ForceField:
    """A block that pushes outward along x and up, and grows with t; nothing in frame 3."""
    i, j, k = samples(grid)
    inside = (abs(2 * i - 10) <= 7 + t) & (abs(2 * j - 8) <= 6) & (k >= 2) & (k <= 8) & (t != 3)
    return sloped(grid, inside * (8 + t) / 32, i - 5, j - 4, 3)


def nothing(t: int) -> ForceField:
    """No force."""
    return ForceField.empty(THIN)


def apart(t: int) -> ForceField:
    """Five bricks far from each other in a large grid, two of them full."""
    bricks = np.array([[0, 0, 3], [0, 0, 4], [7, 30, 2 + t], [511, 255, 510], [511, 255, 511]])
    forces = np.zeros((5, 8, 8, 8, 3), np.float32)
    forces[..., 2] = (np.indices((5, 8, 8, 8)).sum(axis=0) % 5 + t) / 4
    forces[[1, 3]] = (0.0, -0.25, 1 + t)
    forces[4, :, :, 5:] = 0
    return ForceField.from_bricks(LARGE, bricks, forces)


def hum(t: int) -> VibrationFrame:
    """Samples that vibrate, others in every frame, and nothing in frame 4."""
    i, j, k = samples(WALL)
    vibrates = ((i + 2 * j + 3 * k + t // 2) % 3 == 0) & (i < 14) & (j > 3) & (k > 6 + t) & (t != 4)
    amplitudes = ((1 + (3 * i + 5 * j + k + t) % 61) / 64)[vibrates]
    frequencies = (40 + 10 * (k + t) + (i * j) % 7)[vibrates]
    places = np.argwhere(vibrates).astype(np.int32)
    return VibrationFrame(WALL, places, amplitudes.astype(np.float32), frequencies.astype(np.float32))


def tumbling(frames: int, side: int) -> PoseTrack:
    """Quaternions and positions of whole numbers, made unit."""
    t = np.arange(frames)
    turns = np.stack([np.full(frames, 40), 3 * t, side * 2 * t - 1, -t], axis=1)
    turns = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    return PoseTrack(turns, np.stack([side * (7 + t), t - 3, 16 - t * t // 4], axis=1) / 1024)


def bodies(frames: int, rate_hz: float, is_deforming: bool, surface_damping: float) -> HapticScene:
    """Bodies that meet at their edges; one stays where it is."""
    own = Grid((11, 9, 10), (0.00125, 0.001, 0.0015), (-0.00625, -0.004, -0.007))
    world = Grid((20, 17, 18), (0.0025, 0.0025, 0.002), (-0.024, -0.02, -0.004))
    ground = Grid((20, 17, 6), world.spacing_m, world.origin_m)
    i, j, k = samples(ground)
    floor = HapticMedium.from_frames([sloped(ground, (6 - k) / 64, i % 3 - 1, j % 5 - 2, 8)], rate_hz)
    rigid = HapticMedium.from_frames([block(0, own)], rate_hz)
    other = (
        HapticMedium.from_frames([block(t, own) for t in range(frames)], rate_hz) if is_deforming else rigid
    )
    objects = (
        HapticObject("first block", rigid, tumbling(frames, 1)),
        HapticObject("floor", floor, PoseTrack.constant(frames)),
        HapticObject("second block", other, tumbling(frames, -1)),
    )
    return HapticScene(world, rate_hz, objects, 1.25, surface_damping, "x east, y north, z up", 0.25, 0.5)
