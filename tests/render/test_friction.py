"""Dry friction with an anchor (``c/touch_friction.h``): cone, sliding, rest, energy, and bodies that move."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from proxy_makers import STRONG, Held, Vector, field_of
from scipy.interpolate import CubicSpline
from seam_makers import DAMPING_N_S_PER_M, HAND_KG, SPRING_N_PER_M, Played
from tick_makers import Bench, constant

import touchfield as tf
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.deformation import Deformation
from touchfield.perception.hand_motion import surface_walks
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import Tool
from touchfield.sources.shapes.shapes import Box, Sphere

BLOCK = field_of(Box((0.0, 0.0, 0.0), (0.03, 0.02, 0.015)))
TOP_M, RADIUS_M, DT_S, TICK_NS = 0.015, 0.005, 1e-3, 1_000_000
KINDS = ("proxy", "field", "tool", "deformed")
BEND_BOX_M = (-0.03, -0.02, -0.01), (0.03, 0.02, 0.025)
BENDS = {
    "deformed": Deformation.at_rest(*BEND_BOX_M),
    "yielding": Deformation.at_rest(*BEND_BOX_M, compliance_m_per_n=1e-4, relax_s=0.1),
}
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def player_of(kind: str, mu: float) -> tf.TickedPlayer:
    """A player of the block: by proxy, by the stored field, with a ball as the tool, or deformed."""
    medium = HapticMedium(BLOCK.grid, 30.0, 1, lambda i: BLOCK, axes=STRONG.axes)
    tool = Tool.sphere(RADIUS_M) if kind == "tool" else None
    render = "proxy" if kind == "proxy" else "field"
    spec = RenderSpec(friction=mu, render=render, tool=tool, deformation=BENDS.get(kind))
    return tf.TickedPlayer(medium, STRONG, spec, is_simulated=True)


def surface_m(kind: str) -> float:
    """Height of the hand at which it, or its tool, meets the block."""
    return TOP_M + RADIUS_M * (kind == "tool")


def pressed_and_dragged(kind: str, mu: float, depth_m: float, way_m: Vector) -> Vector:
    """Forces on a hand that is pressed into the block and dragged along a way [n, 2], float64 [n, 3]."""
    heights_m = surface_m(kind) + np.r_[np.linspace(0.002, -depth_m, 150), np.full(50, -depth_m)]
    path = [(*way_m[0], z) for z in heights_m] + [(*point, heights_m[-1]) for point in way_m]
    with player_of(kind, mu) as player:
        player.play()
        forces_n = [player.tick(point, n * TICK_NS) for n, point in enumerate(path)]
    return np.array(forces_n)[len(heights_m) :]


# -- sliding -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed_m_s", [0.005, 0.05, 0.2])
@pytest.mark.parametrize("mu", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("kind", KINDS)
def test_drag_of_a_sliding_hand_is_mu_times_the_normal_force(kind: str, mu: float, speed_m_s: float) -> None:
    unit = np.array([0.8, -0.6])
    for depth_m in (0.0005, 0.002, 0.008):
        way_m = np.arange(-0.006, 0.006, speed_m_s * DT_S)[:, None] * unit
        forces_n = pressed_and_dragged(kind, mu, depth_m, way_m)
        drag_n, normal_n = np.linalg.norm(forces_n[:, :2], axis=1), forces_n[:, 2]
        assert (drag_n <= mu * normal_n * (1 + 1e-6)).all()
        is_sliding = np.arange(len(way_m)) * speed_m_s * DT_S > 0.006  # a spring of 1000 N/m: up to 4 mm
        assert is_sliding.sum() > 20 and normal_n[-1] > 0.02
        assert drag_n[is_sliding] == pytest.approx(mu * normal_n[is_sliding], rel=0.02)
        against = -(forces_n[is_sliding, :2] @ unit) / drag_n[is_sliding]
        assert against.min() > 0.999


def ball_way(speed_m_s: float) -> tuple[ForceField, Vector, Vector]:
    """A ball, and points and normals of an arc of 16 mm, float64 [n, 3] each."""
    angle = np.arange(0.0, 0.016, speed_m_s * DT_S)[:, None] / 0.025
    normals = np.cos(angle) * [0.6, 0.0, 0.8] + np.sin(angle) * [-0.48, 0.8, 0.36]
    return field_of(Sphere((0.0, 0.0, 0.0), 0.025), nw=6), 0.025 * normals, normals


def terrain_way(speed_m_s: float) -> tuple[ForceField, Vector, Vector]:
    """A terrain, and points and normals of a way of 16 mm over it, float64 [n, 3] each."""
    terrain = prepare("sample:terrain", EncodeSpec(nw=6)).medium[0]
    walks = surface_walks(terrain, 0.016, 1, np.random.default_rng(6))
    knots_m = walks.step_m * np.arange(walks.steps[0])
    points_m = CubicSpline(knots_m, walks.points_m[:, 0])(np.arange(0.0, 0.016, speed_m_s * DT_S))
    normals = terrain.sample_n(points_m).astype(np.float64)
    return terrain, points_m, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def dragged(played: Played, goals_m: Vector, is_spring: bool) -> tuple[Vector, Vector, Vector]:
    """Forces of the field and of friction, and motions, float64 [n, 3] each, of a hand that is at the goals,
    or on a spring to them.
    """
    position, velocity, rows = goals_m[0].copy(), np.zeros(3), []
    for goal_m in goals_m:
        force_n = played.tick(position if is_spring else goal_m)
        names = ("field_force_n", "friction_n", "position_m")
        rows.append([played.value(f"state.{name}") for name in names])
        for _ in range(4):
            pull_n = SPRING_N_PER_M * (goal_m - position) - DAMPING_N_S_PER_M * velocity + force_n
            velocity = velocity + pull_n / HAND_KG * DT_S / 4
            position = position + velocity * DT_S / 4
    field_n, friction_n, points_m = np.array(rows).swapaxes(0, 1)
    return field_n, friction_n, np.diff(points_m, axis=0, prepend=points_m[:1])


def slid_m(friction_n: Vector, moved_m: Vector) -> Vector:
    """The ways along which friction has opposed the motion without a break, metres, float64 [n]."""
    steps_m, ways_m = np.linalg.norm(moved_m, axis=1), np.zeros(len(moved_m))
    opposing_j = -(friction_n * moved_m).sum(axis=1)
    opposes = (opposing_j > 0.5 * np.linalg.norm(friction_n, axis=1) * steps_m) & (steps_m > 1e-7)
    for n in range(1, len(ways_m)):
        ways_m[n] = (ways_m[n - 1] + steps_m[n]) * opposes[n]
    return ways_m


@pytest.mark.parametrize("is_spring", [False, True])
@pytest.mark.parametrize("kind", ["auto", "field", "tool"])
@pytest.mark.parametrize("way_of", [ball_way, terrain_way])
def test_drag_along_a_curved_surface_is_mu_times_the_normal_force(
    way_of: Callable[[float], tuple[ForceField, Vector, Vector]], kind: str, is_spring: bool
) -> None:
    field, points_m, normals = way_of(0.05)
    medium = HapticMedium.from_frames([field], 30.0)
    tool = Tool.sphere(RADIUS_M, 100) if kind == "tool" else None
    for mu, depth_m in ((0.1, 0.002), (0.3, 0.0005), (0.3, 0.008)):
        out_m = RADIUS_M * (kind == "tool")
        down_m = out_m + np.r_[np.linspace(0.002, -depth_m, 100), np.full(30, -depth_m)]
        goals_m = np.concatenate(
            [points_m[0] + down_m[:, None] * normals[0], points_m + (out_m - depth_m) * normals]
        )
        spec = RenderSpec(friction=mu, render="auto" if kind == "auto" else "field", tool=tool, up="lattice")
        played = Played(medium, device=STRONG, spec=spec)
        field_n, friction_n, moved_m = dragged(played, goals_m, is_spring)
        normal_n, drag_n = np.linalg.norm(field_n, axis=1), np.linalg.norm(friction_n, axis=1)
        assert (drag_n <= mu * normal_n).all()
        assert np.abs((friction_n * field_n).sum(axis=1)).max() < 1e-9
        stretch_m = mu * normal_n / played.value("settings.stick_n_per_m")
        slides = slid_m(friction_n, moved_m) > 1.2 * stretch_m + 0.0005
        slides[: len(down_m)] = False
        assert slides.sum() > 50 and normal_n[slides].min() > 0.01
        assert drag_n[slides] == pytest.approx(mu * normal_n[slides], rel=0.02)


def test_a_hand_sticks_until_the_spring_of_the_anchor_reaches_the_cone() -> None:
    for mu, is_proxy in ((0.3, True), (0.7, True), (0.3, False), (0.7, False)):
        rendered = Held(BLOCK, is_proxy, mu=mu)
        k, c = (rendered.value(f"settings.stick_n{unit}_per_m") for unit in ("", "_s"))
        for z in np.linspace(0.02, 0.013, 60):
            rendered.tick(np.array([0.0, 0.0, z]))
        drags_n, sticking = [], 0
        for x in np.linspace(0.0, 0.002, 400):
            rendered.tick(np.array([x, 0.5 * x, 0.013]))
            pressure_n = np.linalg.norm(rendered.value("state.field_force_n"))
            speed_m_s = np.linalg.norm(rendered.value("state.velocity_m_s")[:2])
            pull_n = k * math.hypot(x, 0.5 * x) + c * speed_m_s
            sticking += pull_n < mu * pressure_n
            drags_n.append(np.linalg.norm(rendered.value("state.friction_n")))
            assert drags_n[-1] == pytest.approx(min(pull_n, mu * pressure_n), rel=0.01, abs=0.002)
        assert 20 < sticking < 380 and k == 1000.0


def test_friction_needs_pressure_and_a_coefficient() -> None:
    for kind in KINDS:
        way_m = np.arange(0.0, 0.01, 2e-4)[:, None] * [1.0, 0.0]
        assert not pressed_and_dragged(kind, 0.8, -0.002, way_m).any()
        assert np.abs(pressed_and_dragged(kind, 0.0, 0.004, way_m)[:, :2]).max() < 1e-6


# -- the cone ----------------------------------------------------------------------------------------------

any_size = st.sampled_from([0.0, 5e-324, 1e-310, 1e-160, 1.0, 1e160, 1e300]) | st.floats(0.0, 1e300)
steps_m = st.floats(-0.03, 0.03) | st.sampled_from([0.0, 5e-324, -1e-310, 1e-160])
SMALL = Grid((9, 9, 9), (0.04,) * 3, (-0.16,) * 3)
BENCHES = {
    size_n: Bench(constant(*(size_n * np.array([0.48, -0.6, 0.64]))), device=STRONG, grid=SMALL)
    for size_n in (1e-44, 1e-30, 1.0, 1e30)
}


def rubbed(bench: Bench, mu: float, k: float, c: float, steps: list[tuple[float, ...]]) -> Iterator[Vector]:
    """Forces of the field and of friction, float64 [2, 3], on a hand that moves by steps from the middle."""
    bench.restart(RenderSpec(coupling_n_per_m=0.0))
    settings, state = (bench.memory.receiver[name] for name in ("settings", "state"))
    settings["friction"], state["friction"] = mu, mu
    settings["stick_n_per_m"], settings["stick_n_s_per_m"] = k, c
    position = np.zeros(3)
    for x, y, z, dt_s in steps:
        position = np.clip(position + np.array([x, y, z]), -0.15, 0.15)
        bench.tick(*position, dt_s)
        yield np.array([bench.value("state.field_force_n"), bench.value("state.friction_n")])


@given(
    st.sampled_from(list(BENCHES)),
    any_size,
    any_size,
    any_size,
    st.lists(st.tuples(steps_m, steps_m, steps_m, st.floats(1e-5, 0.01)), min_size=1, max_size=12),
)
@example(1.0, 5e-324, 1e300, 1e300, [(0.01, 0.02, 0.0, 1e-3)] * 3)
@example(1e30, 1e300, 1e300, 1e300, [(0.03, -0.03, 0.01, 1e-5)] * 3)
@example(1e-44, 1.0, 1e300, 0.0, [(0.01, 0.0, 0.0, 1e-3), (-0.02, 0.0, 0.0, 1e-3)])
@example(1e-44, 1e-280, 1e3, 1.0, [(0.01, 0.0, 0.0, 1e-3)] * 4)
@example(1.0, 0.5, 5e-324, 5e-324, [(0.01, 0.0, 0.0, 1e-3)] * 2)
def test_friction_never_leaves_its_cone_and_stays_along_the_surface(
    size_n: float, mu: float, k: float, c: float, steps: list[tuple[float, ...]]
) -> None:
    smallest_n = 1e-322 + 5e-324 * (k + 3e3 * c)  # where a factor or a force is among the smallest numbers
    rounding_n = 1e-322 + 1e-16 * k + 1e-12 * c  # of 0.3 m and 3000 m/s
    for force_n, friction_n in rubbed(BENCHES[size_n], mu, k, c, steps):
        assert np.isfinite(friction_n).all()
        normal = force_n / math.hypot(*force_n)
        pressure_n, size = math.hypot(*force_n), math.hypot(*friction_n)
        assert size <= mu * pressure_n + smallest_n
        assert abs(math.fsum(friction_n * normal)) <= 1e-9 * size + rounding_n


def test_friction_stays_in_its_cone_where_the_pressure_changes() -> None:
    """A hand that is lifted while it sticks slides before it is free."""
    for is_proxy in (True, False):
        rendered, ratios = Held(BLOCK, is_proxy, mu=0.5), []
        for n in range(400):
            depth_m = 0.004 * math.sin(math.pi * n / 400)
            rendered.tick(np.array([2e-5 * n, 0.0, TOP_M - depth_m]))
            pressure_n = np.linalg.norm(rendered.value("state.field_force_n"))
            drag_n = np.linalg.norm(rendered.value("state.friction_n"))
            assert drag_n <= 0.5 * pressure_n
            ratios.append(drag_n / pressure_n)
        assert max(ratios[200:]) > 0.49


# -- rest --------------------------------------------------------------------------------------------------


def band_n(forces_n: Vector) -> float:
    """The largest content of a force between 40 and 400 Hz, newtons rms of an axis, float64 [n, 3]."""
    window = np.hanning(len(forces_n))[:, None]
    spectrum = np.fft.rfft((forces_n - forces_n.mean(axis=0)) * window, axis=0)
    hz = np.fft.rfftfreq(len(forces_n), DT_S)
    power = (np.abs(spectrum[(hz >= 40) & (hz <= 400)]) ** 2).sum(axis=0)
    return float(np.sqrt(2 * power.max() / (window**2).sum() / len(forces_n)))


@pytest.mark.parametrize("hand_kg", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("mu", [0.1, 0.4])
@pytest.mark.parametrize("kind", [*KINDS, "yielding"])
def test_a_hand_at_rest_feels_a_constant_force(kind: str, mu: float, hand_kg: float) -> None:
    """A hand on a spring of 200 N/m and 2 N s/m, pulled 3 mm along the surface, comes to rest.

    The proxy follows the hand in steps of 0.1 um, which are 0.1 mN of the spring.
    """
    goal = np.array([0.0, 0.0, surface_m(kind) - 0.012])
    position, velocity, forces_n = goal + np.array([0.0, 0.0, 0.013]), np.zeros(3), []
    with player_of(kind, mu) as player:
        player.play()
        for n in range(9000 if hand_kg == 1 else 4000):  # a heavy hand swings for longer
            goal[0] = 0.003 * min(1.0, max(0.0, (n - 500) / 200))
            force_n = np.array(player.tick(tuple(position.tolist()), n * TICK_NS))
            forces_n.append(force_n)
            for _ in range(4):
                spring_n = 200 * (goal - position) - 2 * velocity
                velocity = velocity + (spring_n + force_n) / hand_kg * DT_S / 4
                position = position + velocity * DT_S / 4
    rest_n = np.array(forces_n[-1000:])
    assert np.hypot(*rest_n[-1, :2]) > 0.015 and rest_n[-1, 2] > 1.0  # it sticks, and presses
    assert band_n(rest_n) < (5e-5 if kind == "proxy" else 2e-6)
    assert np.abs(np.diff(rest_n, axis=0)).max() < (2e-4 if kind == "proxy" else 2e-6)


def test_a_hand_that_stops_is_held_by_what_the_spring_holds() -> None:
    """A scripted hand that stops feels the same force for ever: nothing depends on a measured speed."""
    for kind in KINDS:
        way_m = np.r_[np.linspace(0.0, 4e-4, 20), np.full(3000, 4e-4)][:, None] * [1.0, 0.0]
        forces_n = pressed_and_dragged(kind, 0.8, 0.004, way_m)
        assert -forces_n[-1, 0] > 0.2
        assert np.abs(forces_n[300:] - forces_n[-1]).max() < 1e-9


# -- energy ------------------------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(*[st.floats(-0.004, 0.004)] * 3), min_size=2, max_size=60),
    st.floats(0.0, 2.0),
    st.floats(10.0, 3000.0),
)
def test_friction_never_gives_more_than_its_spring_stored(
    steps: list[tuple[float, ...]], mu: float, k: float
) -> None:
    """Work and stored energy stay below what a spring gives that is constant within each step, k dx^2 / 2."""
    gained_j = allowed_j = 0.0
    friction_n = np.zeros(3)
    path = [(*step, DT_S) for step in steps]
    position = np.zeros(3)
    bench = BENCHES[1.0]
    for _, force_n in rubbed(bench, mu, k, 0.0, path):
        step_m = bench.value("state.position_m") - position
        position = position + step_m
        gained_j += float(friction_n @ step_m)
        allowed_j += 0.5 * k * float(step_m @ step_m)
        friction_n = force_n
        assert gained_j + float(friction_n @ friction_n) / (2 * k) <= allowed_j * (1 + 1e-9) + 1e-15


@pytest.mark.parametrize("kind", KINDS)
def test_a_closed_way_costs_what_slid(kind: str) -> None:
    """Over a cycle the energy that leaves is mu F times the way, less what sticks at each turn."""
    mu, depth_m, turns = 0.4, 0.004, 3
    angle = np.linspace(0.0, 2 * np.pi * turns, 900)
    for way_m in (
        0.006 * np.stack([np.cos(angle), np.sin(angle)], axis=1),
        0.008 * np.stack([np.sin(angle), 0.5 * np.sin(angle)], axis=1),
    ):
        forces_n = pressed_and_dragged(kind, mu, depth_m, way_m)
        steps_m, normal_n = np.diff(way_m, axis=0), forces_n[:, 2].mean()
        power_j = (forces_n[:-1, :2] * steps_m).sum(axis=1)
        length_m = np.linalg.norm(steps_m, axis=1).sum()
        reversals = 2 * turns if np.allclose(way_m[:, 1], 0.5 * way_m[:, 0]) else 0
        stuck_m = (2 * reversals + 1) * mu * normal_n / 1000
        sliding_n = mu * normal_n
        assert -1.001 * sliding_n * length_m <= power_j.sum() <= -0.98 * sliding_n * (length_m - stuck_m)


def test_a_small_closed_way_gives_nothing() -> None:
    """A hand that trembles without sliding loses energy to the damper alone, and never gains any."""
    for kind in KINDS:
        for hz in (2.0, 20.0):
            way_m = 2e-4 * np.sin(2 * np.pi * hz * np.arange(0.0, 1.0 + DT_S / 2, DT_S))[:, None] * [0.6, 0.8]
            forces_n = pressed_and_dragged(kind, 0.8, 0.004, way_m)
            gained_j = (forces_n[:-1, :2] * np.diff(way_m, axis=0)).sum()
            assert -2e-3 < gained_j < 0.0


# -- bodies that move --------------------------------------------------------------------------------------


@pytest.mark.parametrize("is_proxy", [True, False])
def test_a_body_that_moves_carries_a_free_hand(is_proxy: bool) -> None:
    """A hand of 0.1 kg, pressed on with 2 N, goes along with a block that moves by 9 mm in 0.3 s."""
    poses = [(UPRIGHT, (0.003 * n, 0.0, 0.0)) for n in range(4)]
    for mu in (0.5, 0.0):
        rendered = Held(BLOCK, is_proxy, mu=mu, poses=poses)
        position, velocity = np.array([-0.005, 0.0, 0.0155]), np.zeros(3)
        for n in range(1200):
            rendered.at = min(3.0, max(0.0, (n - 500) / 100))
            force_n = rendered.tick(position)
            for _ in range(4):
                push_n = np.array([0.0, 0.0, -2.0]) - 3 * velocity * [0.0, 0.0, 1.0] - 0.2 * velocity
                velocity = velocity + (push_n + force_n) / 0.1 * DT_S / 4
                position = position + velocity * DT_S / 4
        moved_m = position[0] + 0.005
        assert moved_m == pytest.approx(0.009 if mu else 0.0, abs=0.0005)
        anchor_m = rendered.value("state.anchor.position_m")
        assert mu == 0 or anchor_m[0] == pytest.approx(position[0], abs=0.0005)


def test_a_body_that_is_hit_does_not_jerk_the_hand_on_it() -> None:
    """Its velocity jumps, and the damper of the anchor took all of that in one tick."""
    speed_m_s = 0.1
    poses = [(UPRIGHT, (speed_m_s * 0.01 * max(0, n - 5), 0.0, 0.0)) for n in range(8)]
    rendered, hand_m = Held(BLOCK, mu=1.0, poses=poses), np.array([-0.005, 0.0, 0.013])
    for z in np.linspace(0.02, hand_m[2], 100):
        rendered.tick(np.array([hand_m[0], 0.0, z]))
    drags_n = []
    for at in np.arange(0.0, 5.5, 0.1):  # 1 ms
        rendered.at = at
        rendered.tick(hand_m)
        drags_n.append(rendered.value("state.friction_n"))
    k, c = (rendered.value(f"settings.stick_n{unit}_per_m") for unit in ("", "_s"))
    steps_n = np.linalg.norm(np.diff(drags_n, axis=0), axis=1)
    assert np.linalg.norm(drags_n[-1]) < 0.9 * np.linalg.norm(rendered.value("state.field_force_n"))
    assert steps_n.max() < k * speed_m_s * DT_S + 0.15 * c * speed_m_s and c * speed_m_s > 0.2


def test_a_ball_that_turns_drags_a_hand_that_stays() -> None:
    """The spring of the anchor stretches by the way of the surface, up to the cone."""
    halves = np.radians(90 + 3.0 * np.arange(5)) / 2
    poses = [((math.cos(a), 0.0, 0.0, math.sin(a)), (0.0, 0.0, 0.0)) for a in halves]
    for is_proxy in (True, False):
        rendered = Held(field_of(Sphere((0.0, 0.0, 0.0), 0.025)), is_proxy, mu=0.7, poses=poses)
        k, c = (rendered.value(f"settings.stick_n{unit}_per_m") for unit in ("", "_s"))
        hand_m, sticking = np.array([0.022, 0.0, 0.0]), 0
        for x in np.linspace(0.03, 0.022, 60):
            rendered.tick(np.array([x, 0.0, 0.0]))
        arm_m = hand_m[0]  # friction acts at the hand
        for n, at in enumerate(np.linspace(0, 4, 401)):
            rendered.at = at
            rendered.tick(hand_m)
            if n < 40:
                continue  # the ball starts at once, and the damper takes its velocity low-passed
            slip_m, speed_m_s = arm_m * math.radians(3 * at), arm_m * math.radians(3) * 10
            pressure_n = np.linalg.norm(rendered.value("state.field_force_n"))
            pull_n = k * slip_m + c * speed_m_s
            sticking += pull_n < 0.7 * pressure_n
            drag_n = rendered.value("state.friction_n")
            assert drag_n[1] == pytest.approx(min(pull_n, 0.7 * pressure_n), rel=0.05, abs=0.02)
            assert abs(drag_n[2]) < 0.02 and abs(drag_n[0]) < 0.05
        assert 10 < sticking < 330
