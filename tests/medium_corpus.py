"""A small collection of haptic media of known kinds: shapes of several sizes and poses, and terrain."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from touchfield.medium import ForceField, Grid
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere

GRID = Grid.over_box((-0.08,) * 3, (0.08,) * 3, (32, 32, 32))
PROFILE = profile_of(LawSpec(stiffness_n_per_m=200.0), 0.01)
"""Walls of 10 mm, up to 2 N."""

ORIGIN = (0.0, 0.0, 0.0)
Float64s = NDArray[np.float64]


@dataclass(frozen=True)
class Torus(Shape):
    """A ring around the z axis: exact."""

    ring_m: float
    tube_m: float

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        out = np.hypot(points[:, 0], points[:, 1])
        across = np.divide(
            points[:, :2], out[:, None], out=np.zeros((len(points), 2)), where=out[:, None] > 0
        )
        local = np.column_stack([out - self.ring_m, points[:, 2]])
        radius_m = np.linalg.norm(local, axis=1)
        unit = local / np.maximum(radius_m, 1e-12)[:, None]
        return radius_m - self.tube_m, np.column_stack([across * unit[:, :1], unit[:, 1]])

    def box_m(self) -> Float64s:
        reach = np.array([self.ring_m + self.tube_m] * 2 + [self.tube_m])
        return np.stack([-reach, reach])


def shape(kind: str, r: float) -> Shape:
    """A body of about `r` metres in each direction."""
    return {
        "sphere": Sphere(ORIGIN, r),
        "box": Box(ORIGIN, (0.6 * r,) * 3),
        "plate": Box(ORIGIN, (0.75 * r, 0.65 * r, 0.2 * r)),
        "torus": Torus(0.7 * r, 0.28 * r),
        "rod": Capsule(ORIGIN, 0.3 * r, 0.7 * r),
        "can": Cylinder(ORIGIN, 0.45 * r, 0.85 * r),
        "lens": Ellipsoid(ORIGIN, (r, r, 0.4 * r)),
    }[kind]


KINDS = ("sphere", "box", "plate", "torus", "rod", "can", "lens")


def body(kind: str, r: float, turn: Float64s, shift_m: Float64s, grid: Grid = GRID) -> ForceField:
    """The field of a body after a rigid motion."""
    return AnalyticScene([shape(kind, r)]).moved(turn, shift_m).field(0, grid, PROFILE)


def terrain(seed: int) -> ForceField:
    """A wall over hills, touched from above."""
    rng = np.random.default_rng(seed)
    x, y, z = GRID.to_m(
        np.stack(np.meshgrid(*(np.arange(n) for n in GRID.shape), indexing="ij"), -1)
    ).transpose(3, 0, 1, 2)
    height, slope = np.zeros_like(x), np.zeros((2, *x.shape))
    for k, phase in zip(rng.normal(0, 40, (6, 2)), rng.uniform(0, 2 * np.pi, 6), strict=True):
        wave = k[0] * x + k[1] * y + phase
        height += 0.004 * np.sin(wave)
        slope += 0.004 * np.cos(wave) * k[:, None, None, None]
    normal = np.stack([-slope[0], -slope[1], np.ones_like(x)], axis=-1)
    depth = height - z
    amplitude = np.where((depth > 0) & (depth < 0.01), 200 * depth, 0)
    forces = amplitude[..., None] * normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return ForceField.from_dense(GRID, forces.astype(np.float32))


def corpus(each: int = 4, seed: int = 0) -> Iterator[tuple[str, str, ForceField]]:
    """Name, kind and field of `each` of every kind, at random sizes, poses and positions."""
    rng = np.random.default_rng(seed)
    for kind in KINDS:
        turns = Rotation.random(each, random_state=seed + 1).as_matrix()
        for n, (turn, r) in enumerate(zip(turns, rng.uniform(0.045, 0.06, each), strict=True)):
            yield f"{kind} {n}", kind, body(kind, r, turn, rng.uniform(-0.008, 0.008, 3))
    for n in range(each):
        yield f"terrain {n}", "terrain", terrain(seed + n)
