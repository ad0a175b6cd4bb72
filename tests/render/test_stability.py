"""Automatic damping and coupling: a held hand is at rest, and damping acts only where needed."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from tick_makers import GRID, OMNI, Bench, constant, points, wall

from touchfield.devices import Device
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.cells import CellPool
from touchfield.render.block import Memory, layout
from touchfield.render.player import Session
from touchfield.render.spec import RenderSpec, stability_of, stiffest_n_per_m

STRONG = replace(OMNI, force_max_n=12.0, force_continuous_n=None)
FINE = Grid((17, 17, 129), (0.01, 0.01, 0.0005), (-0.08, -0.08, -0.048))
DEVICE_KG = 0.045


def device_of(b: float, delay: int = 1, resolution_m: float = 0.0) -> Device:
    """A device with these parameters at a rate of 1 kHz."""
    figures: dict[str, Any] = {"inertia_kg": DEVICE_KG, "damping_n_s_per_m": b, "delay_ms": float(delay)}
    return replace(STRONG, **figures, resolution_mm=1e3 * resolution_m, friction_n=None)


def pressed(
    bench: Bench, b: float, delay: int, resolution_m: float, kg: float = 0.1, k: float = 100.0
) -> tuple[float, float]:
    """Deviation of the force, newtons, and its work about the mean, joules, in the fifth second of
    2 N pressing.
    """
    stiffness, mass = -float((bench.law(np.array([[0.0, 0, -1e-4]]))[0, 2]) / -1e-4), DEVICE_KG + kg
    depth = 2.0 * (1 / stiffness + 1 / k)
    step = expm(np.array([[0, 1, 0], [-k / mass, -b / mass, 1 / mass], [0, 0, 0]]) * 1e-3)
    x, v, late = 0.01, 0.0, deque([0.0] * (delay + 1), delay + 1)
    ways, forces = [], []
    for n in range(5300):
        target = 0.01 - (0.01 + depth) * min(n / 300, 1.0)
        measured = round(x / resolution_m) * resolution_m if resolution_m else x
        late.append(bench.tick(0.0, 0.0, measured)[2])
        moved, v, _ = step @ np.array([x, v, late[0] + k * target])
        ways.append(moved - x)
        forces.append(late[0])
        x = moved
    force, way = np.array(forces[-1000:]), np.array(ways[-1000:])
    return float(force.std()), float((force - force.mean()) @ way)


def with_automatic(bench: Bench, device: Device, stiffness: float, spec: RenderSpec | None = None) -> Bench:
    """The bench with automatic damping and coupling for a wall."""
    spec = RenderSpec() if spec is None else spec
    bench.device = device
    bench.restart(spec)
    found = stability_of(device, spec, 0.0, stiffness)
    bench.memory.receiver["settings"]["brake_n_s_per_m"] = found.brake_n_s_per_m
    bench.memory.receiver["settings"]["coupling_n_per_m"] = found.coupling_n_per_m
    return bench


# -- fixed faults ------------------------------------------------------------------------------------------


def test_a_coupling_on_a_soft_field_is_steady_with_quantised_positions() -> None:
    bench = Bench(wall(200.0, 12.0), RenderSpec(coupling_n_per_m=1000.0), device=device_of(2.0), grid=FINE)
    deviation, _ = pressed(bench, 2.0, 1, 1e-5)
    assert deviation < 0.01


@pytest.mark.parametrize("delay_ms", [0.0, 1.0, 1.5, 3.0])
def test_the_observer_uses_the_force_that_acted_during_the_motion(delay_ms: float) -> None:
    bench = Bench(wall(300.0), RenderSpec(), device=replace(STRONG, delay_ms=delay_ms))
    path = np.zeros((400, 3))
    path[:, 2] = -0.01 + 0.005 * np.sin(np.arange(400) / 17)
    forces = np.array([f[2] for _, f in bench.along(path)])
    acting = np.interp(np.arange(400) - delay_ms, np.arange(-9, 400), np.concatenate([np.zeros(9), forces]))
    work_j = float(acting[:-1] @ np.diff(path[:, 2]))
    assert abs(work_j) > 1e-3
    assert bench.value("state.energy_j") == pytest.approx(-work_j, abs=1e-9)


def test_passivity_with_a_sample_of_delay_removes_the_energy_of_a_wall() -> None:
    law = wall(500.0, 12.0)
    plain = Bench(law, RenderSpec(), device=device_of(0.5), grid=FINE)
    watched = Bench(law, RenderSpec(passivity=True), device=device_of(0.5), grid=FINE)
    blind = Bench(law, RenderSpec(passivity=True), device=replace(device_of(0.5), delay_ms=0.0), grid=FINE)
    free, observed, leaking = (pressed(bench, 0.5, 1, 0.0)[1] for bench in (plain, watched, blind))
    assert free > 1e-3
    assert observed < 0.1 * leaking


# -- automatic values --------------------------------------------------------------------------------------


@pytest.mark.parametrize("stiffness", [200.0, 2000.0])
@pytest.mark.parametrize(("b", "delay"), [(0.3, 0), (0.3, 2), (2.0, 1)])
@pytest.mark.parametrize("resolution_m", [0.0, 1e-5])
def test_a_hand_at_a_wall_comes_to_rest(stiffness: float, b: float, delay: int, resolution_m: float) -> None:
    device = device_of(b, delay, resolution_m)
    bench = with_automatic(Bench(wall(stiffness, 12.0), device=device, grid=FINE), device, stiffness)
    deviation, work = pressed(bench, b, delay, resolution_m)
    assert deviation < 0.02
    assert work < 1e-5


@pytest.mark.parametrize(("used_ms", "is_stable"), [(1, False), (3, True)])
def test_a_hand_is_at_rest_only_if_the_delay_used_is_that_of_the_loop(used_ms: int, is_stable: bool) -> None:
    """A loop of 3 ms whose profile states 1 ms: `Session.adapt_delay` uses the measured delay."""
    device = device_of(0.3, used_ms)
    bench = with_automatic(Bench(wall(500.0, 12.0), device=device, grid=FINE), device, 500.0)
    deviation, _ = pressed(bench, 0.3, 3, 0.0)
    assert (deviation < 0.02) == is_stable and (is_stable or deviation > 1.0)


def test_a_wall_within_the_device_s_limits_is_not_changed() -> None:
    found = stability_of(device_of(5.0, 0, 2e-5), RenderSpec(), 0.0, 2000.0)
    assert found.brake_n_s_per_m == found.coupling_n_per_m == 0
    allowed = stability_of(device_of(1.6, 0, 2e-5), RenderSpec(), 0.0, 2000.0)  # more than K T / 2 = 1
    rendered_n_per_m = (
        2000.0 if not allowed.coupling_n_per_m else 1 / (1 / 2000 + 1 / allowed.coupling_n_per_m)
    )
    assert rendered_n_per_m >= 0.9 * 2000


def test_missing_device_parameters_are_assumed_and_stated_ones_used() -> None:
    silent = replace(
        STRONG, inertia_kg=None, damping_n_s_per_m=None, delay_ms=None, friction_n=None, resolution_mm=0.1
    )

    def coupling(**stated: float | None) -> float:
        return stability_of(replace(silent, **stated), RenderSpec(), 0.0, 20_000.0).coupling_n_per_m  # type: ignore[arg-type]

    assert coupling(friction_n=0.2) > coupling() > 0
    smooth: dict[str, Any] = {"resolution_mm": None}
    assert coupling(**smooth, inertia_kg=0.2) > coupling(**smooth) > coupling(**smooth, delay_ms=2.0) > 0
    stated = coupling(**smooth, inertia_kg=0.045, damping_n_s_per_m=0.0, delay_ms=1.0)
    assert coupling(**smooth) == pytest.approx(stated)
    late = Bench(wall(300.0), device=replace(STRONG, delay_ms=30.0))
    assert late.value("settings.delay_ticks") == layout.MAX_DELAY


def test_requested_values_are_used_and_zero_disables() -> None:
    device = device_of(0.3, 2, 2e-5)
    free = stability_of(device, RenderSpec(), 0.0, 2000.0)
    assert free.brake_n_s_per_m > 0
    assert free.coupling_n_per_m > 0
    none = stability_of(device, RenderSpec(damping_n_s_per_m=0.0, coupling_n_per_m=0.0), 0.0, 2000.0)
    assert none.brake_n_s_per_m == none.coupling_n_per_m == 0
    coupled = stability_of(device, RenderSpec(coupling_n_per_m=700.0), 0.0, 2000.0)
    assert coupled.coupling_n_per_m == 700
    assert 0 < coupled.brake_n_s_per_m < free.brake_n_s_per_m + 5


def test_scaling_the_field_changes_nothing_at_the_device() -> None:
    device = device_of(0.3, 1, 1e-6)
    once = stability_of(device, RenderSpec(), 0.0, 900.0)
    scaled = stability_of(device, RenderSpec(scale=3.0, force_scale=0.5), 0.0, 600.0)
    assert scaled.brake_n_s_per_m * 1.5 == pytest.approx(once.brake_n_s_per_m)


# -- the damper in contact ---------------------------------------------------------------------------------


def test_the_damper_acts_along_the_force_and_never_exceeds_it() -> None:
    bench = Bench(constant(0.0, 0.0, 2.0), device=STRONG)
    bench.memory.receiver["settings"]["brake_n_s_per_m"] = 5.0
    slides = np.arange(100)[:, None] * np.array([1e-4, 0.0, 0.0])
    assert [f for _, f in bench.along(slides)][-1] == pytest.approx([0.0, 0.0, 2.0], abs=1e-6)
    leaves = slides[-1] + np.arange(100)[:, None] * np.array([0.0, 0.0, 1e-4])  # 0.1 m/s
    assert [f for _, f in bench.along(leaves)][-1] == pytest.approx([0.0, 0.0, 1.5], rel=1e-4)
    flees = leaves[-1] + np.arange(60)[:, None] * np.array([0.0, 0.0, 1e-3])  # 1 m/s
    assert [f for _, f in bench.along(flees)][-1] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("speed_m_s", [-1.0, -0.11, -0.04, 0.04, 0.09, 1.0])
@pytest.mark.parametrize("axis", [0, 2])
def test_the_damper_is_bounded_by_the_force_at_any_speed(axis: int, speed_m_s: float) -> None:
    """At 0.5 N and 5 N s/m the limit is 0.1 m/s: a faster hand feels 0 N on leaving and 1 N on entering."""
    direction = np.eye(3)[axis]
    bench = Bench(constant(*(0.5 * direction)), device=STRONG)
    bench.memory.receiver["settings"]["brake_n_s_per_m"] = 5.0
    bench.settled(*(-0.05 * np.sign(speed_m_s) * direction))
    path = (-0.05 * np.sign(speed_m_s) + 1e-3 * speed_m_s * np.arange(1, 100))[:, None] * direction
    forces = np.array([force for _, force in bench.along(path)]) @ direction
    assert forces.min() >= -1e-6 and forces.max() <= 2 * 0.5 + 1e-6
    assert forces[-1] == pytest.approx(0.5 - min(max(5.0 * speed_m_s, -0.5), 0.5), abs=1e-3)


def test_the_damper_follows_a_force_that_turns_without_a_step() -> None:
    """The force turns from y to z within 0.5 mm, a tick of a hand of 0.5 m/s, which B damps with 1 N."""

    def edge(p: Any) -> Any:
        is_below = p[..., 2:] < 0.0
        return np.where(is_below, [0.0, 0.0, 2.0], [0.0, 2.0, 0.0])

    path = np.array([[0.0, 0.0, 0.02 - 0.0005 * n] for n in range(80)])
    runs = []
    for brake_n_s_per_m in (0.0, 2.0):
        bench = Bench(edge, device=STRONG, grid=FINE)
        bench.memory.receiver["settings"]["brake_n_s_per_m"] = brake_n_s_per_m
        bench.settled(*path[0])
        runs.append(np.array([force for _, force in bench.along(path)]))
    added = runs[1] - runs[0]
    assert added[-1] == pytest.approx([0.0, 0.0, 1.0], abs=0.01)
    assert np.linalg.norm(np.diff(added, axis=0), axis=1).max() < 0.25


def test_in_free_space_nothing_is_damped() -> None:
    bench = Bench(wall(1000.0), device=STRONG)
    bench.memory.receiver["settings"]["brake_n_s_per_m"] = 20.0
    path = np.array([[0.0, 0.0, 0.06 - 0.0002 * n] for n in range(280)])
    assert not np.array([f for _, f in bench.along(path)]).any()


# -- the medium's stiffest slope ---------------------------------------------------------------------------


def field(stiffness: float, max_n: float = np.inf) -> ForceField:
    return ForceField.from_dense(GRID, wall(stiffness, max_n)(points(GRID)).astype(np.float32))


@pytest.mark.parametrize("stiffness", [50.0, 700.0, 8000.0])
def test_the_stiffest_slope_of_a_wall(stiffness: float) -> None:
    assert stiffest_n_per_m([CellPool.of(field(stiffness))]) == pytest.approx(stiffness, rel=0.04)


def test_damping_of_the_medium_is_subtracted() -> None:
    device, spec = device_of(0.3, 1), RenderSpec(coupling_n_per_m=0.0)
    brakes = [stability_of(device, spec, damping, 700.0).brake_n_s_per_m for damping in (0.0, 0.2, 50.0)]
    assert brakes == pytest.approx([2 * 700 * 0.0015 - 0.3, 2 * 700 * 0.0015 - 0.5, 0])
    options = RenderSpec(coupling_n_per_m=200.0, scale=2.0, force_scale=3.0)
    assert stability_of(device, options, 0.0, 700.0).coupling_n_per_m == pytest.approx(
        200
    )  # in units of the field


def test_a_field_without_force_has_no_slope() -> None:
    nothing = ForceField.from_dense(GRID, np.zeros((*GRID.shape, 3), np.float32))
    assert stiffest_n_per_m([CellPool.of(nothing)]) == 0


def test_a_stiffer_later_frame_is_damped_more_without_a_jump() -> None:
    medium = HapticMedium.from_frames([field(200.0), field(200.0), field(1500.0)], 10.0, OMNI.axes)
    device = device_of(0.3, 1)
    session = Session(medium, device, RenderSpec(render="field"))
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    feeder = session.feeder(memory, is_timed=False)
    feeder.fill_lookahead(1)
    first = memory.receiver["settings"]["brake_n_s_per_m"]
    assert first == pytest.approx(2 * 200 * 0.0015 - 0.3, rel=0.1)
    assert "stiffest slope" in session.notes[-1]
    feeder.fill_lookahead(3)
    assert memory.receiver["settings"]["brake_n_s_per_m"] == pytest.approx(2 * 1500 * 0.0015 - 0.3, rel=0.05)


@pytest.mark.parametrize("coupling", [0.0, 800.0])
def test_changes_of_damper_and_coupling_are_gradual(coupling: float) -> None:
    bench = Bench(wall(500.0, 12.0), RenderSpec(coupling_n_per_m=coupling), device=STRONG)
    way = np.array([[0.0, 0.0, -0.010 - 5e-6 * n] for n in range(300)])
    before = np.array([f[2] for _, f in bench.along(way[:150])])
    bench.memory.receiver["settings"]["brake_n_s_per_m"] = 5.0
    bench.memory.receiver["settings"]["coupling_n_per_m"] = 400.0
    after = np.array([f[2] for _, f in bench.along(way[150:])])
    steps = np.abs(np.diff(np.concatenate([before[-1:], after])))
    assert abs(after[-1] - before[-1]) > 0.3
    assert steps.max() < 0.15
