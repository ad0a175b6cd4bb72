"""Friction, damping, coupling, passivity and vibration, with a simulated hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tick_makers import OMNI, Bench, Vector, constant, linear, wall

from touchfield.compute.native import native
from touchfield.medium import Grid
from touchfield.render.block import Memory, layout
from touchfield.render.block.frames import frame_bytes
from touchfield.render.spec import RenderSpec

STRONG = replace(OMNI, force_max_n=100.0, force_continuous_n=None)
QUICK = {"slew_n_per_s": 1e6, "ramp_s": 1e-3}


def circle(turns: float, per_turn: int, radius_m: float = 0.02) -> Vector:
    """Positions of a hand that moves in circles, anticlockwise."""
    angle = 2 * math.pi * np.arange(int(turns * per_turn)) / per_turn
    return radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)


def gained_j(bench: Bench, path: Vector) -> float:
    """The energy that a hand gains on a path; each force acts until the next position."""
    positions_m, forces = (np.array(a) for a in zip(*bench.along(path), strict=True))
    return float((forces[:-1] * np.diff(positions_m, axis=0)).sum())


def released_m(
    bench: Bench, hand_kg: float, damping_n_s_per_m: float, start_m: Vector, seconds: float
) -> Vector:
    """Positions of a free hand that the ticks push, float64 [n, 3]."""
    position, velocity, path = np.array(start_m, np.float64), np.zeros(3), []
    for _ in range(int(seconds / bench.dt)):
        force = bench.tick(*position)
        for _ in range(4):
            velocity += (force - damping_n_s_per_m * velocity) * bench.dt / 4 / hand_kg
            position = position + velocity * bench.dt / 4
        path.append(position)
    return np.array(path)


# -- friction, damping -------------------------------------------------------------------------------------


def test_friction_and_damping_of_a_hand_that_slides() -> None:
    bench = Bench(constant(0.0, 0.0, 2.0), friction=0.3, damping=1.5)
    path = np.arange(200)[:, None] * 0.0001 * np.array([0.6, 0.8, 0.0])  # 0.1 m/s
    force = [f for _, f in bench.along(path)][-1]
    assert bench.value("state.velocity_m_s") == pytest.approx([0.06, 0.08, 0.0], rel=1e-6)
    assert bench.value("state.friction_n") == pytest.approx([-0.36, -0.48, 0], rel=1e-6)
    assert force == pytest.approx([-0.36 - 0.09, -0.48 - 0.12, 2.0], rel=1e-6)
    bench.restart(
        RenderSpec(friction=0.0, damping_n_s_per_m=0.0)
    )  # the option of the receiver, not the value of the medium
    assert [f for _, f in bench.along(path)][-1] == pytest.approx([0, 0, 2.0], rel=1e-6)


@given(
    st.lists(st.tuples(*[st.floats(-0.09, 0.09)] * 3, st.floats(1e-5, 0.01)), min_size=2, max_size=30),
    st.floats(0, 3),
    st.floats(0, 5),
)
def test_friction_and_damping_only_dissipate(way: list[tuple[float, ...]], mu: float, b: float) -> None:
    """Damping acts against the velocity. Friction stays in its cone, and gives back what its spring stored.

    The spring is constant within a step dx, and may so give k dx^2 / 2 more.
    """
    FIELD.restart(RenderSpec(friction=mu, damping_n_s_per_m=b, coupling_n_per_m=200.0 * (mu > 1)))
    FIELD.memory.receiver["settings"]["stick_n_s_per_m"] = 0.0
    k = FIELD.value("settings.stick_n_per_m")
    friction, before, gained_j, allowed_j = np.zeros(3), np.zeros(3), 0.0, 0.0
    for x, y, z, dt in way:
        FIELD.tick(x, y, z, dt)
        v, f, t = (FIELD.value(f"state.{name}") for name in ("velocity_m_s", "field_force_n", "friction_n"))
        size = math.hypot(*t)
        assert size <= mu * math.hypot(*f)
        assert abs(math.fsum(t * f)) <= 1e-9 * (size + 1e-3) * math.hypot(*f)
        step = FIELD.value("state.proxy.position_m" if mu > 1 else "state.position_m") - before
        gained_j, allowed_j = gained_j + float(friction @ step), allowed_j + 0.5 * k * float(step @ step)
        assert gained_j + size * size / (2 * k) <= allowed_j * (1 + 1e-9) + 1e-12
        friction, before = t, before + step
        added = FIELD.value("state.force.desired") - f - t
        assert added @ v <= 1e-9 * (1 + np.abs(f).sum()) * (1 + b * (v @ v))


FIELD = Bench(lambda p: 90.0 * p[..., ::-1] * np.array([1.0, -1.0, 3.0]), device=STRONG)


def test_the_velocity_follows_true_times() -> None:
    bench = Bench(constant(0.0, 0.0, 0.0))
    rng, x = np.random.default_rng(3), 0.0
    for dt in rng.uniform(0.0002, 0.003, 300):
        x += 0.05 * dt
        bench.tick(x, 0, 0, dt)
    assert bench.value("state.velocity_m_s") == pytest.approx([0.05, 0, 0], rel=1e-6)
    for _ in range(20):  # time passes while the device is silent
        bench.tick(math.nan, 0, 0, 0.001)
    bench.tick(x + 21 * 0.05 * 0.001, 0, 0, 0.001)
    assert bench.value("state.velocity_m_s") == pytest.approx([0.05, 0, 0], rel=1e-6)
    bench.restart(RenderSpec(velocity_cutoff_hz=20.0))
    for n in range(9):  # a step of the velocity, through the low-pass
        bench.tick(0.05 * 0.001 * n, 0, 0, 0.001)
    assert bench.value("state.velocity_m_s")[0] == pytest.approx(
        0.05 * (1 - math.exp(-2 * math.pi * 20 * 0.008))
    )


# -- coupling ----------------------------------------------------------------------------------------------


def test_a_coupling_gives_the_force_of_the_field_in_steady_contact() -> None:
    for law in (wall(400.0), wall(1e5, 3.0)):
        bench = Bench(law, RenderSpec(coupling_n_per_m=300.0), device=STRONG)
        force = bench.settled(0.01, 0.0, -0.005, 300)
        proxy = bench.value("state.proxy.position_m")
        at_proxy = Bench(law, RenderSpec(), device=STRONG).settled(*proxy)
        assert force == pytest.approx(at_proxy, rel=1e-6, abs=1e-6)
        assert force == pytest.approx(300 * (proxy - [0.01, 0, -0.005]), rel=1e-6, abs=1e-9)
    assert not Bench(law, RenderSpec(coupling_n_per_m=300.0)).settled(0.01, 0, 0.02).any()


def test_coupling_and_field_are_two_springs_in_series() -> None:
    bench = Bench(wall(400.0), RenderSpec(coupling_n_per_m=300.0), device=STRONG)
    assert bench.settled(0, 0, -0.007)[2] == pytest.approx(0.007 / (1 / 400 + 1 / 300), rel=1e-6)


@pytest.mark.parametrize("law", [wall(10_000.0), wall(10_000.0, 20.0)])
def test_a_stiff_field_that_buzzes_is_steady_with_a_coupling(law: object) -> None:
    weight = [0.0, 0.0, -1.0]  # a hand of 50 g, pressed down by 1 N

    def rest_of(spec: RenderSpec) -> float:
        bench = Bench(law, spec, device=STRONG)  # type: ignore[arg-type]
        position, velocity, heights = np.array([0.0, 0.0, 0.002]), np.zeros(3), []
        for _ in range(3000):
            force = bench.tick(*position) + weight
            for _ in range(4):
                velocity += (force - 1.0 * velocity) * bench.dt / 4 / 0.05
                position = position + velocity * bench.dt / 4
            heights.append(position[2])
        return float(np.ptp(heights[-500:]))

    assert rest_of(RenderSpec(**QUICK)) > 1e-4
    assert rest_of(RenderSpec(coupling_n_per_m=500.0, **QUICK)) < 1e-6


@pytest.mark.parametrize("depth_m", [0.0001, 0.0003, 0.0007, 0.0011, 0.0015])
@pytest.mark.parametrize("k", [300.0, 1000.0, 4000.0])
def test_a_proxy_at_a_step_of_the_force_does_not_oscillate(depth_m: float, k: float) -> None:
    fine = Grid(
        (33, 33, 33), (0.0001,) * 3, (-0.0016,) * 3
    )  # 1 N from one sample to the next: 10 N/mm, then level
    bench = Bench(wall(1e9, 1.0), RenderSpec(coupling_n_per_m=k, **QUICK), device=STRONG, grid=fine)
    bench.settled(0.0, 0.0, -depth_m, 150)
    forces = [bench.tick(0.0, 0.0, -depth_m)[2] for _ in range(100)]
    assert np.ptp(forces) < 1e-6
    assert forces[0] == pytest.approx(min(1.0, depth_m / (1 / k + 1 / 10_000)), rel=1e-5)


@given(
    st.floats(10.0, 1e6),
    st.floats(-1e4, 1e4),
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.floats(10.0, 3000.0),
    st.tuples(*[st.floats(-0.02, 0.02)] * 3),
)
def test_the_proxy_comes_to_rest_in_any_stable_linear_field(
    stiffness: float, curl: float, normal: tuple[float, ...], coupling: float, hand: tuple[float, ...]
) -> None:
    n = np.array([normal[0], normal[1], normal[2] + 1e-3])
    n /= np.linalg.norm(n)
    matrix = -stiffness * np.outer(n, n) + curl * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]])
    bench = Bench(linear(matrix), RenderSpec(coupling_n_per_m=coupling, **QUICK), device=STRONG)
    bench.settled(*hand)
    expected = np.linalg.solve(coupling * np.eye(3) - matrix, coupling * np.array(hand))
    # in float32, forces at the edge of the field are exact to one part in 2^24
    assert bench.value("state.proxy.position_m") == pytest.approx(
        expected, abs=1e-6 + 0.2 * (stiffness + abs(curl)) * 2**-24 / coupling
    )


def test_an_unstable_field_drives_the_proxy_away_monotonically() -> None:
    for growth in (100.0, 499.0, 500.0, 501.0, 5000.0):  # the pull of the coupling grows by 500 N/m
        bench = Bench(linear(growth * np.eye(3)), RenderSpec(coupling_n_per_m=500.0), device=STRONG)
        for _ in range(200):
            bench.tick(0.001, 0.0, 0.0)
            proxy = bench.value("state.proxy")
            step, pull = proxy["coupling_step_m"], proxy["coupling_pull_n"]
            if np.linalg.norm(proxy["position_m"]) < 0.07:
                assert 0 <= step @ pull <= pull @ pull / 499
        if growth < 400:
            assert proxy["position_m"][0] == pytest.approx(0.001 / (1 - growth / 500), rel=1e-6)


def test_a_coupling_does_not_drag_in_free_space() -> None:
    bench = Bench(wall(1000.0), RenderSpec(coupling_n_per_m=1000.0))
    path = np.array([[0.1 * t / 1000, 0, 0.03] for t in range(300)])  # 0.1 m/s
    assert np.abs([f for _, f in bench.along(path)]).max() < 1e-12


# -- passivity ---------------------------------------------------------------------------------------------

CURL = 40.0 * np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 0]])  # 0.8 N along the way at 20 mm


def test_a_field_with_curl_adds_energy_unless_it_is_observed() -> None:
    path = circle(5, 500)
    bench = Bench(linear(CURL))
    free = gained_j(bench, path)
    assert free == pytest.approx(5 * 0.8 * 2 * math.pi * 0.02, rel=0.02)
    assert bench.value("state.energy_j") == pytest.approx(-free, rel=1e-9)
    bench.restart(RenderSpec(passivity=True))
    watched = gained_j(bench, path)
    assert watched < 1e-3 * free
    assert bench.value("state.energy_j") == pytest.approx(-watched, abs=1e-12)


def test_stored_energy_may_return() -> None:
    press = 0.02 * np.sin(np.linspace(0, 2 * np.pi, 2000))
    path = np.stack([0 * press, 0 * press, -np.abs(press)], axis=-1)
    free, watched = (
        np.array([f for _, f in Bench(wall(60.0), RenderSpec(passivity=p)).along(path)])
        for p in (False, True)
    )
    # a spring returns its energy; the surplus due to sampling is braked at the end of the path
    difference = np.abs(free - watched).max(axis=1)
    assert difference.max() < 0.15
    assert (difference > 1e-9).mean() < 0.05
    assert free.max() > 0.9


@given(st.lists(st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)), min_size=2, max_size=6))
def test_observed_energy_is_bounded_by_one_step(corners: list[tuple[float, float]]) -> None:
    bench = WATCHED
    bench.restart(RenderSpec(passivity=True))
    knots = np.array([*corners, corners[0]])
    at = np.linspace(0, len(knots) - 1, 1500)
    path = np.stack([np.interp(at, np.arange(len(knots)), knots[:, n]) for n in (0, 1)] + [0 * at], axis=-1)
    fastest = float(np.abs(np.diff(path, axis=0)).max())
    low, gained = 0.0, 0.0
    before, force = path[0], bench.tick(*path[0])
    for position in path[1:]:
        gained += float(force @ (position - before))
        low = min(low, bench.value("state.energy_j"))
        before, force = position, bench.tick(*position)
    assert bench.value("state.energy_j") == pytest.approx(-gained, abs=1e-9)
    # the error of the low-passed velocity at corners, and a creep too slow to be damped
    assert low >= -20 * 4.0 * fastest - 1e-8


WATCHED = Bench(linear(CURL))


def test_an_energy_debt_is_paid_by_a_gentle_damper() -> None:
    bench = Bench(constant(0.0, 0.0, 0.0), RenderSpec(passivity=True))
    bench.settled(0, 0, 0)
    bench.memory.receiver["state"]["energy_j"] = -0.01
    path = np.array([[0.00002 * n, 0, 0] for n in range(3000)])  # 0.02 m/s
    forces = np.array([f[0] for _, f in bench.along(path)])
    assert forces.min() == pytest.approx(-0.5 * 0.05 / 0.001 * 0.02, rel=1e-6)
    assert bench.value("state.energy_j") == pytest.approx(0, abs=1e-5)
    assert abs(forces[-1]) < 1e-3


def test_the_weight_of_the_handle_adds_no_energy() -> None:
    bench = Bench(constant(0.0, 0.0, 0.0), RenderSpec(passivity=True, gravity_n=(0.0, 0.5, 0.0)))
    bench.settled(0, 0, 0)
    path = np.array([[0, 0.0001 * n, 0] for n in range(500)])  # the force lifts all the way
    forces = np.array([f for _, f in bench.along(path)])
    assert forces == pytest.approx(np.broadcast_to([0, 0.5, 0], forces.shape))


# -- vibration ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("force", "axis"), [((0.0, 0.0, 0.0), 2), ((1.5, 0.0, 0.0), 0)])
def test_a_vibration_adds_a_sine_to_the_force(force: tuple[float, float, float], axis: int) -> None:
    bench = Bench(constant(*force), RenderSpec(slew_n_per_s=1e5), device=STRONG, vibration=(0.4, 80.0))
    bench.settled(0.01, 0.01, 0.01)
    forces = np.array([bench.tick(0.01, 0.01, 0.01) for _ in range(1000)])
    spectrum = np.abs(np.fft.rfft(forces[:, axis])) / 500
    assert spectrum[80] == pytest.approx(0.4, rel=1e-6)
    assert spectrum[0] / 2 == pytest.approx(force[axis], abs=1e-6)
    assert np.delete(spectrum, [0, 80]).max() < 1e-6
    assert np.abs(np.delete(forces, axis, axis=1)).max() < 1e-9


def test_its_phase_is_continuous_for_uneven_ticks() -> None:
    bench = Bench(constant(0.0, 0.0, 0.0), RenderSpec(slew_n_per_s=1e6), device=STRONG, vibration=(0.4, 80.0))
    bench.settled(0, 0, 0)
    rng, t, start = np.random.default_rng(5), 0.0, bench.value("state.vibration_phase")
    for dt in rng.uniform(0.0001, 0.0019, 300):
        t += dt
        assert bench.tick(0, 0, 0, dt)[2] == pytest.approx(
            0.4 * math.sin(start + 2 * math.pi * 80 * t), abs=1e-6
        )


def test_amplitudes_are_blended_between_frames() -> None:
    spec = RenderSpec(slew_n_per_s=1e5)
    bench = Bench(constant(0.0, 0.0, 0.0), spec, device=STRONG, vibration=(0.4, 80.0))
    silent = bench.memory.size_bytes
    memory = Memory.empty(silent + frame_bytes(1))
    memory.bytes[:silent] = bench.memory.bytes
    memory.bytes[silent:] = memory.bytes[bench.frame : bench.frame + frame_bytes(1)]
    memory.view(layout.FRAME_HEADER, silent)["vibration_offset"] = 0
    hand = (0.01, 0.01, 0.01)
    for first, second, blend in ((bench.frame, silent, 0.25), (silent, bench.frame, 0.75)):
        forces = [native.tick(memory.bytes, first, second, blend, *hand, 0.001)[2] for _ in range(200)]
        assert max(forces[100:]) == pytest.approx(0.3, rel=1e-2)


def test_frequencies_above_nyquist_are_omitted() -> None:
    for frequency, rate in ((500.0, 1000.0), (600.0, 1000.0), (60.0, 100.0)):
        bench = Bench(constant(0.0, 0.0, 1.0), RenderSpec(rate_hz=rate), vibration=(0.4, frequency))
        assert bench.settled(0, 0, 0, 300) == pytest.approx([0, 0, 1.0])
