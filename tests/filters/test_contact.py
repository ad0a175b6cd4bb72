"""The force of a field at a contact: its direction is the normal of the surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from touchfield.medium import Grid
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere

GRID = Grid((51, 51, 51), (0.002,) * 3, (-0.05,) * 3)
CENTRE = np.array([0.0003, 0.0001, -0.0002])
BALL = AnalyticScene([Sphere(tuple(CENTRE), 0.04)]).field(0, GRID, profile_of(LawSpec("penalty"), 0.008))


def angles_deg(at: NDArray[np.float64], force: NDArray[np.float64]) -> NDArray[np.float64]:
    out = at - CENTRE
    sine = np.linalg.norm(np.cross(out, force), axis=1)
    return np.degrees(np.arctan2(sine, (out * force).sum(1)))


def test_field_direction_is_the_normal_of_a_sphere() -> None:
    assert angles_deg(GRID.to_m(BALL.positions()), BALL.vectors_n().astype(float)).max() < 1e-5
    rng = np.random.default_rng(4)
    out = rng.normal(size=(50_000, 3))
    out /= np.linalg.norm(out, axis=1)[:, None]
    depth = rng.uniform(-0.0035, 0.006, 50_000)
    at = CENTRE + out * (0.04 - depth)[:, None]
    force = BALL.sample_n(at).astype(float)
    nonzero = force.any(axis=1)
    angle, depth = angles_deg(at[nonzero], force[nonzero]), depth[nonzero]
    deep, shallow, rim = depth > 0.002, (depth > 0) & (depth < 0.002), depth < 0
    assert np.median(angle[deep]) < 0.1 and angle[deep].max() < 0.8
    assert np.median(angle[shallow]) < 0.25 and angle[shallow].max() < 2.3
    assert rim.sum() > 1000 and angle[rim].max() < 4
    size = np.linalg.norm(force[nonzero], axis=1)
    assert size[rim].mean() < 0.02 * size.max()
