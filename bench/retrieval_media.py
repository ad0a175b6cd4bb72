"""Random solids of known identity, and what shifts, noise, rotation, scale, a sensor or a coder make of them.

A solid is the union of two to five boxes, ellipsoids, cylinders and rings of random size and pose within a
ball of 45 mm, with a random stiffness; its medium has 64^3 samples of 2.5 mm. A moved solid is computed anew,
and has other samples than the original.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.encoding import encode_prepared
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.source import decode
from touchfield.sources.clouds.cloud import Cloud
from touchfield.sources.clouds.cloud_scene import CloudScene
from touchfield.sources.clouds.surfels import surface_of
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Cylinder, Ellipsoid, Shape

Float64s = NDArray[np.float64]

GRID: Final = Grid.over_box((-0.08,) * 3, (0.08,) * 3, (64, 64, 64))
REACH_M: Final = 0.045
STIFFNESSES_N_PER_M: Final = (150.0, 1200.0)
SHIFT_M: Final = 0.015
NOISE_N: Final = 0.1
SCALES: Final = (0.7, 1.4)
VIEWS, PIXEL_M, DEPTH_NOISE_M = 14, 0.002, 0.0003
_AT_SURFACE_M: Final = 1e-5


@dataclass(frozen=True)
class Ring(Shape):
    """A torus: `ring_m` is the radius of its circle, `tube_m` that of its tube; exact."""

    center_m: tuple[float, float, float]
    ring_m: float
    tube_m: float
    rotation: tuple[tuple[float, ...], ...]

    def signed_distance_and_normal(self, points: Float64s) -> tuple[Float64s, Float64s]:
        """See `Shape.signed_distance_and_normal`."""
        axes = np.array(self.rotation)
        local = (points - np.array(self.center_m)) @ axes
        from_axis = np.hypot(local[:, 0], local[:, 1])
        across = local[:, :2] / np.maximum(from_axis, 1e-12)[:, None]
        section = np.column_stack([from_axis - self.ring_m, local[:, 2]])
        length = np.linalg.norm(section, axis=1)
        unit = section / np.maximum(length, 1e-12)[:, None]
        normal = np.column_stack([across * unit[:, :1], unit[:, 1]])
        return length - self.tube_m, normal @ axes.T

    def box_m(self) -> Float64s:
        """See `Shape.box_m`."""
        reach = self.ring_m + self.tube_m
        return np.asarray(np.array(self.center_m) + np.array([[-reach] * 3, [reach] * 3]))


@dataclass(frozen=True)
class Solid:
    """A random solid: its shapes for a scale of 1, and its force law."""

    seed: int
    profile: ForceProfile

    def scene(self, scale: float = 1.0) -> AnalyticScene:
        """Return the solid, `scale` times as large; the law stays, as it is that of the hand."""
        return AnalyticScene(_shapes(self.seed, scale), "union")


def solid(seed: int) -> Solid:
    """Return the solid of a seed."""
    low, high = np.log(STIFFNESSES_N_PER_M)
    stiffness = float(np.exp(np.random.default_rng([seed, 1]).uniform(low, high)))
    return Solid(seed, profile_of(LawSpec(stiffness_n_per_m=stiffness), np.inf))


def _shapes(seed: int, scale: float) -> list[Shape]:
    """Return two to five shapes around the origin, `scale` times as large."""
    rng = np.random.default_rng([seed, 0])
    shapes: list[Shape] = []
    for _ in range(rng.integers(2, 6)):
        centre = rng.normal(0, 0.4, 3)
        centre *= min(1.0, 0.6 / float(np.linalg.norm(centre))) * REACH_M * scale
        margin = REACH_M * scale - float(np.linalg.norm(centre))
        a, b, c = (rng.uniform(0.3, 1.0, 3) * margin).tolist()
        turn = Rotation.random(rng=rng)
        (x, y, z), (u, v, w) = centre.tolist(), turn.as_euler("xyz", degrees=True).tolist()
        middle, degrees = (x, y, z), (u, v, w)
        kind = rng.integers(4)
        if kind == 0:
            shapes.append(Box(middle, (0.75 * a, 0.75 * b, 0.75 * c), degrees))
        elif kind == 1:
            shapes.append(Ellipsoid(middle, (a, b, c), degrees))
        elif kind == 2:
            shapes.append(Cylinder(middle, 0.7 * a, 0.8 * b, degrees))
        else:
            tube = 0.2 * margin + 0.15 * a
            shapes.append(Ring(middle, margin - tube, tube, tuple(map(tuple, turn.as_matrix().tolist()))))
    return shapes


# -- what happens to a solid -------------------------------------------------------------------------------


def original(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid as it is stored in the index."""
    return item.scene().field(0, GRID, item.profile)


def shifted(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid elsewhere, also between samples."""
    return item.scene().moved(np.eye(3), _shift_m(rng)).field(0, GRID, item.profile)


def noisy(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid with noise on its forces."""
    return with_noise(original(item, rng), rng)


def rotated(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid after any rotation about its origin."""
    return item.scene().moved(_rotation(rng), np.zeros(3)).field(0, GRID, item.profile)


def scaled(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid at another size, with the same law of the hand."""
    return item.scene(_scale(rng)).field(0, GRID, item.profile)


def scanned(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid as a scanner sees it from all sides, a cloud with noise."""
    return scan(item.scene(), item.profile, rng)


def coded(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid after the coder, within its mask."""
    return through_coder(original(item, rng))


def combined(item: Solid, rng: np.random.Generator) -> ForceField:
    """Return the solid rotated, scaled, shifted, with noise and after the coder."""
    scene = item.scene(_scale(rng)).moved(_rotation(rng), _shift_m(rng))
    return through_coder(with_noise(scene.field(0, GRID, item.profile), rng))


Change = Callable[[Solid, np.random.Generator], ForceField]
SPLITS: Final[Mapping[str, Change]] = MappingProxyType(
    {
        "shift": shifted, "noise": noisy, "rotation": rotated, "scale": scaled, "sensor": scanned,
        "coder": coded, "all combined": combined,
    }
)  # fmt: skip
"""The changes by the name of their split; each gives another field of the same solid."""


def field_of(seed: int, split: str) -> ForceField:
    """Return the field of a solid in a split, or the original."""
    change = original if split == "original" else SPLITS[split]
    number = 0 if split == "original" else 1 + list(SPLITS).index(split)
    return change(solid(seed), np.random.default_rng([seed, 2, number]))


def _shift_m(rng: np.random.Generator) -> Float64s:
    return rng.uniform(-SHIFT_M, SHIFT_M, 3)


def _rotation(rng: np.random.Generator) -> Float64s:
    return np.asarray(Rotation.random(rng=rng).as_matrix())


def _scale(rng: np.random.Generator) -> float:
    low, high = np.log(SCALES)
    return float(np.exp(rng.uniform(low, high)))


def with_noise(field: ForceField, rng: np.random.Generator) -> ForceField:
    """Add normal noise to each component of every force."""
    vectors = field.vectors_n() + rng.normal(0, NOISE_N, (field.support_count, 3)).astype(np.float32)
    return ForceField.from_support(field.grid, field.positions(), vectors)


def through_coder(field: ForceField) -> ForceField:
    """Encode a field with the default coder, and decode it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.touch"
        encode_prepared(prepare(HapticMedium.from_frames([field], 30.0)), path, {})
        return decode(path)[0]


def scan(scene: AnalyticScene, profile: ForceProfile, rng: np.random.Generator) -> ForceField:
    """Return the field of a cloud seen by `VIEWS` parallel cameras around a scene."""
    points, scanners, start = [], [], 0
    for view in range(VIEWS):
        height = 1 - 2 * (view + 0.5) / VIEWS
        angle = view * np.pi * (3 - np.sqrt(5))
        across = np.sqrt(1 - height**2)
        towards = np.array([across * np.cos(angle), across * np.sin(angle), height])
        seen = _seen(scene, towards)
        seen += rng.normal(0, DEPTH_NOISE_M, (len(seen), 1)) * towards
        points.append(seen)
        scanners.append((start, start + len(seen), 10.0 * towards))
        start += len(seen)
    cloud = Cloud(np.concatenate(points), scanners=tuple(scanners))
    shell = profile if np.isfinite(profile.low_m) else _wall(profile)
    return CloudScene(surface_of(cloud, "scanner", "scan")).field(0, GRID, shell)


def _wall(profile: ForceProfile) -> ForceProfile:
    """Return the wall that a penalty law has by default: it ends where the force is largest."""
    return ForceProfile(profile.pieces[-1:], profile.surface_damping_n_s_per_m)


def _seen(scene: AnalyticScene, towards: Float64s) -> Float64s:
    """Return the first points of a scene along parallel rays of a camera, metres, float64 [n, 3]."""
    side = np.cross(towards, np.eye(3)[np.abs(towards).argmin()])
    side /= np.linalg.norm(side)
    up = np.cross(towards, side)
    steps = np.arange(-REACH_M, REACH_M, PIXEL_M)
    u, v = (axis.ravel() for axis in np.meshgrid(steps, steps))
    points = 2 * REACH_M * towards + u[:, None] * side + v[:, None] * up
    hits = []
    while len(points):  # sphere tracing: no surface is nearer than the distance
        distance = np.min([s.signed_distance_and_normal(points)[0] for s in scene.shapes], axis=0)
        hits.append(points[distance < _AT_SURFACE_M])
        points = points[distance >= _AT_SURFACE_M] - distance[distance >= _AT_SURFACE_M, None] * towards
        points = points[points @ towards > -2 * REACH_M]
    return np.concatenate(hits)
