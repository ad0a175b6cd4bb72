"""Friction at the receiver: closed forms, dissipation over the range of float64, the normal of a field."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from numpy.typing import ArrayLike, NDArray

from touchfield.compute.native import native
from touchfield.medium import ForceField, Grid
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere

any_number = (
    st.floats(-1e300, 1e300) | st.floats(-10, 10) | st.sampled_from([0.0, 5e-324, -5e-324, 1e-310, 1e-160])
)
vectors = st.tuples(any_number, any_number, any_number)
slip_speeds = st.floats(1e-300, 1e300) | st.just(0.001) | st.just(5e-324)

GRID = Grid((51, 51, 51), (0.002,) * 3, (-0.05,) * 3)
CENTRE = np.array([0.0003, 0.0001, -0.0002])
BALL = AnalyticScene([Sphere(tuple(CENTRE), 0.04)]).field(0, GRID, profile_of(LawSpec("penalty"), 0.008))


def friction_n(
    force_n: ArrayLike, velocity_m_s: ArrayLike, mu: float, slip_speed_m_s: float = 0.001
) -> NDArray[np.float64]:
    """Friction of the renderer's loop at many contacts."""
    force, velocity = np.broadcast_arrays(np.asarray(force_n, float), np.asarray(velocity_m_s, float))
    rows = zip(force.reshape(-1, 3), velocity.reshape(-1, 3), strict=True)
    frictions = [native.friction(*f, *v, float(mu), float(slip_speed_m_s)) for f, v in rows]
    return np.reshape(np.array(frictions, float), force.shape)


def power(force: NDArray[np.float64], velocity: tuple[float, ...]) -> tuple[float, float]:
    """F . v and its rounding error, with F and v scaled to about 1."""
    f, v = (np.asarray(a) / max(float(np.abs(a).max()), 1e-300) for a in (force, velocity))
    return math.fsum(f * v), 2 * np.finfo(float).eps * float((np.abs(f) * np.abs(v)).sum())


# -- friction ----------------------------------------------------------------------------------------------


def test_friction_slides_and_sticks() -> None:
    force = np.array([0.0, 0.0, 2.0])
    assert friction_n(force, [0.3, -0.4, 5.0], 0.5) == pytest.approx([-0.6, 0.8, 0.0], rel=1e-12)
    assert friction_n(-force, [0.3, -0.4, 5.0], 0.5) == pytest.approx([-0.6, 0.8, 0.0], rel=1e-12)
    # half of v_s
    assert friction_n(force, [3e-4, -4e-4, 1.0], 0.5) == pytest.approx([-0.3, 0.4, 0.0], rel=1e-12)
    assert friction_n(force, [3e-4, -4e-4, 1.0], 0.5, 5e-4) == pytest.approx([-0.6, 0.8, 0.0], rel=1e-12)
    for zero_friction in (
        friction_n(force, [0, 0, 7.0], 0.5),
        friction_n(force, [0, 0, 0], 0.5),
        friction_n(force, [1, 1, 0], 0),
    ):
        assert not zero_friction.any()
    assert not friction_n([0, 0, 0], [1, 2, 3], 0.5).any()


def test_friction_of_random_contacts_is_the_formula() -> None:
    rng = np.random.default_rng(1)
    force, velocity = rng.normal(size=(2, 40, 25, 3))
    velocity *= 10.0 ** rng.uniform(-5, 1, (40, 25, 1))
    size = np.linalg.norm(force, axis=-1, keepdims=True)
    n = force / size
    tangential = velocity - (velocity * n).sum(-1, keepdims=True) * n
    speed = np.linalg.norm(tangential, axis=-1, keepdims=True)
    assert (speed < 0.001).any() and (speed > 0.001).any()
    expected = -0.3 * size * tangential / np.maximum(speed, 0.001)
    assert friction_n(force, velocity, 0.3) == pytest.approx(expected, rel=1e-11, abs=1e-14)


@given(vectors, vectors, st.floats(0, 1e5), slip_speeds)
@example((5e-324, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0, 0.001)
@example((1.0, 1.0, 1.0), (1.0, 1.0, 1.0 + 2e-16), 1.0, 1e-300)
@example((1.0, 1e-8, 0.0), (1e300, 1e292, 0.0), 1.0, 5e-324)
@example((1e-160, 1e-160, 0.0), (5e-324, 0.0, 0.0), 3.0, 5e-324)
def test_friction_dissipates_and_stays_in_its_cone(
    force: tuple[float, ...], velocity: tuple[float, ...], mu: float, slip_speed: float
) -> None:
    friction_force = friction_n(force, velocity, mu, slip_speed)
    assert np.isfinite(friction_force).all()
    work, rounding = power(friction_force, velocity)
    assert work <= rounding
    assert math.hypot(*friction_force) <= mu * math.hypot(*force)
    normal = np.asarray(force) / max(math.hypot(*force), 5e-324)
    assert abs(math.fsum(friction_force * normal)) <= 1e-12 * max(mu * math.hypot(*force), 1e-290)


def work(force: NDArray[np.float64], velocity: NDArray[np.float64]) -> Fraction:
    """F . v, exactly."""
    return sum(
        (Fraction(f) * Fraction(v) for f, v in zip(force.tolist(), velocity.tolist(), strict=True)),
        Fraction(),
    )


def test_friction_does_no_positive_work_at_extreme_values() -> None:
    """With v_s far above v, v_t / v_s underflows float64, and mu |F| may raise it above zero again."""
    force = np.array([-9.81873571e-50, 3.03680916e223, 3.17329621e211])
    velocity = np.array([-3.98974474e-289, -1.84147596e-122, -2.55233951e-145])
    friction_force = friction_n(force, velocity, 12.26205930484656, 4.06969854674083e180)
    assert work(friction_force, velocity) <= 0
    rng = np.random.default_rng(6)
    forces, velocities = rng.choice([-1, 1], (2, 4000, 3)) * 10.0 ** rng.uniform(-300, 290, (2, 4000, 3))
    for slip_speed in 10.0 ** rng.uniform(-300, 300, 10):
        friction_force = friction_n(forces, velocities, 10.0 ** rng.uniform(-8, 8), slip_speed)
        assert friction_force.any()
        for f, v in zip(friction_force, velocities, strict=True):
            assert work(f, v) <= 0
        size = np.array([math.hypot(*f) for f in friction_force])
        assert ((size == 0) | (size >= 0.9e-290)).all()


@given(vectors, vectors, st.floats(0, 1e5), slip_speeds)
@example((5e-324, 5e-324, 5e-324), (1.0, 0.0, 0.0), 1e5, 5e-324)
def test_friction_never_adds_energy(
    force: tuple[float, ...], velocity: tuple[float, ...], mu: float, slip_speed: float
) -> None:
    assert work(friction_n(force, velocity, mu, slip_speed), np.asarray(velocity)) <= 0


def test_friction_cone_of_the_smallest_forces() -> None:
    smallest = np.full(3, 5e-324)  # its length, 1.73 of the smallest number, would be rounded to 2
    friction_force = friction_n(smallest, [1.0, 0.0, 0.0], 1e40)
    assert math.hypot(*(friction_force * 1e200)) <= 5e-324 * 1e200 * 1e40 * math.sqrt(3)


@given(vectors, vectors)
def test_friction_is_odd_in_the_velocity_and_even_in_the_force(
    force: tuple[float, ...], velocity: tuple[float, ...]
) -> None:
    friction_force = friction_n(force, velocity, 0.7)
    assert np.array_equal(friction_n(force, np.negative(velocity), 0.7), -friction_force)
    assert np.array_equal(friction_n(np.negative(force), velocity, 0.7), friction_force)


# -- a field that is touched -------------------------------------------------------------------------------


def test_sliding_point_stops_without_gaining_energy() -> None:
    """A point of 0.1 kg on a floor that supports it, at 1 kHz: the stopping distance is v^2 / (2 mu g)."""
    grid = Grid((9, 9, 9), (1.0, 1.0, 0.01), (-4.0, -4.0, -0.04))
    weight_n = 0.1 * 9.81
    floor = ForceField.from_dense(grid, np.broadcast_to(np.float32([0, 0, weight_n]), (9, 9, 9, 3)))
    slip_speed_m_s = 0.5 * weight_n * 1e-3 / 0.1  # the smallest stable value
    at, velocity, energy = np.zeros(3), np.array([0.6, 0.8, 0.0]), [0.05]
    for _ in range(500):
        support_n = floor.sample_n(at).astype(float)
        force = support_n + friction_n(support_n, velocity, 0.5, slip_speed_m_s) - (0, 0, weight_n)
        velocity = velocity + force / 0.1 * 1e-3
        at = at + velocity * 1e-3
        energy.append(0.05 * float(velocity @ velocity))
    assert (np.diff(energy) <= 1e-12).all()
    assert energy[-1] < 1e-7 * energy[0]
    assert np.linalg.norm(at) == pytest.approx(1 / (2 * 0.5 * 9.81), rel=0.01)
    assert at[:2] / np.linalg.norm(at) == pytest.approx([0.6, 0.8], abs=1e-9)


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
