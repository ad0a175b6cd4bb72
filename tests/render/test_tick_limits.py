"""No force beyond the limit, no step beyond the slew, zero at the end, for any input.

The lengths are computed here without rounding, from the exact output.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, strategies as st
from tick_makers import OMNI, Bench, Vector, constant, limits, linear

from touchfield.compute.native import native
from touchfield.render.block import Memory, layout
from touchfield.render.spec import RenderSpec, write_parameters

BENCH = Bench(lambda p: 900.0 * p[..., ::-1] * np.array([1.0, -1.0, 3.0]), vibration=(0.7, 240.0))

odd = st.sampled_from([math.nan, math.inf, -math.inf, 1e300, -1e300, 5e-324, 1e12])
coordinates = st.floats(-0.1, 0.1) | odd
times = st.floats(1e-5, 0.01) | st.sampled_from(
    [0.001] * 4 + [0.0, -1.0, 1e-300, 1e-18, 0.5, 1e9, math.nan, math.inf]
)
ticks = st.tuples(st.booleans() | st.just(True), coordinates, coordinates, coordinates, times)
releases = st.tuples(st.just(None), times)
few = st.none() | st.floats(0.1, 1.0)
specs = st.builds(
    RenderSpec,
    rate_hz=st.sampled_from([1000.0, 4000.0, 60.0]),
    friction=st.sampled_from([None, 0.5, 1e300]),
    damping_n_s_per_m=st.sampled_from([None, 2.0, 1e300]),
    coupling_n_per_m=st.sampled_from([0.0, 300.0, 1e9, 1e-300]),
    passivity=st.booleans(),
    scale=st.sampled_from([1.0, 3.0, 1e-300, 1e300]),
    force_scale=st.sampled_from([1.0, 0.0, 7.0, 1e300]),
    gravity_n=st.tuples(*[st.sampled_from([0.0, -0.4, 50.0])] * 3),
    peak_n=st.none() | st.floats(0.5, 4.0),
    continuous_n=few,
    slew_n_per_s=st.sampled_from([None, 100.0, 1e5, 1e-6, 1e300]),
    thermal_s=st.sampled_from([1.0, 0.02, 1e-300, 1e300]),
    ramp_s=st.sampled_from([0.02, 1e-300, 1.0]),
    velocity_cutoff_hz=st.sampled_from([100.0, 1e-3, 1e300]),
)


def square(vector: Vector) -> Fraction:
    """Square of the length, without rounding."""
    return sum((Fraction(float(v)) ** 2 for v in vector), Fraction(0))


def check_step(before: Vector, after: Vector, peak: float, slew: float, dt: float) -> None:
    assert np.isfinite(after).all()
    assert square(after) <= Fraction(peak) ** 2
    step = sum(
        ((Fraction(float(a)) - Fraction(float(b))) ** 2 for a, b in zip(after, before, strict=True)),
        Fraction(0),
    )
    allowed = Fraction(slew) * Fraction(dt) if math.isfinite(dt) and dt > 0 else Fraction(0)
    assert step <= allowed**2


@given(spec=specs, steps=st.lists(ticks | releases, min_size=5, max_size=60))
def test_limits_hold_exactly_for_the_output(spec: RenderSpec, steps: list[tuple[object, ...]]) -> None:
    bench = BENCH
    bench.restart(spec)
    peak, slew = limits(bench)
    before = np.zeros(3)
    for is_there, *rest in steps:
        dt = float(rest[-1])  # type: ignore[arg-type]
        if is_there is None:
            force = bench.release(dt)
        else:
            force = bench.tick(rest[0], rest[1], rest[2], dt, bool(is_there))  # type: ignore[arg-type]
        check_step(before, force, peak, slew, dt)
        before = force
    dt = 1 / spec.rate_hz
    for _ in range(5000):
        force = bench.release()
        check_step(before, force, peak, slew, dt)
        assert square(force) <= square(before)
        before = force
        if not force.any():
            break
    if slew > 1:  # 4 N in 5000 ticks
        assert not force.any()
        for late in (dt, 0.0, 1e-18, 0.5, math.nan):
            assert bench.release(late).tolist() == [0, 0, 0]


forces = st.floats(-1e3, 1e3) | odd


@given(
    st.lists(st.tuples(forces, forces, forces, times), min_size=1, max_size=50),
    st.floats(0.01, 3.9),
    st.sampled_from([0.1, 1.0, 1e-3]),
)
def test_any_requested_force_stays_within_the_limits(
    wishes: list[tuple[float, float, float, float]], continuous: float, thermal_s: float
) -> None:
    memory = Memory.empty(layout.RECEIVER.itemsize)
    spec = RenderSpec(continuous_n=min(continuous, 1.0), thermal_s=thermal_s)
    write_parameters(memory, spec, OMNI, 0.0, 0.0, "")
    limits = memory.receiver["settings"]["force_limits"]
    peak, slew = limits["peak"], limits["slew_per_s"]
    before = np.zeros(3)
    for x, y, z, dt in wishes:
        force = np.array(native.limited(memory.bytes, x, y, z, dt))
        check_step(before, force, peak, slew, dt)
        assert np.linalg.norm(force) <= memory.receiver["state"]["force"]["limit"]
        before = force


def test_a_turning_force_with_a_falling_limit_keeps_the_slew() -> None:
    for turn in range(1, 40):
        memory, before = Memory.empty(layout.RECEIVER.itemsize), np.zeros(3)
        write_parameters(memory, RenderSpec(thermal_s=0.02, slew_n_per_s=1000.0), OMNI, 0.0, 0.0, "")
        limits = memory.receiver["settings"]["force_limits"]
        for tick in range(turn + 8):
            wish = (-3.0, 4.0, 0.0) if tick >= turn else (3.0, 4.0, 0.0)
            force = np.array(native.limited(memory.bytes, *wish, 0.001))
            check_step(before, force, limits["peak"], limits["slew_per_s"], 0.001)
            before = force


def test_no_direction_rounds_beyond_the_peak() -> None:
    memory = Memory.empty(layout.RECEIVER.itemsize)
    write_parameters(memory, RenderSpec(peak_n=0.7, slew_n_per_s=1e9, thermal_s=1e9), OMNI, 0.0, 0.0, "")
    for wish in np.random.default_rng(4).normal(0, 100, (1000, 3)):
        assert square(np.array(native.limited(memory.bytes, *wish, 0.001))) <= Fraction(0.7) ** 2


def test_a_late_tick_moves_the_force_by_at_most_two_ticks() -> None:
    memory = Memory.empty(layout.RECEIVER.itemsize)
    write_parameters(memory, RenderSpec(slew_n_per_s=100.0), OMNI, 0.0, 0.0, "")
    assert native.limited(memory.bytes, 3.0, 0.0, 0.0, 0.3)[0] == pytest.approx(0.2)
    assert native.limited(memory.bytes, 3.0, 0.0, 0.0, 0.0015)[0] == pytest.approx(0.35)


def test_the_peak_limit_preserves_the_direction() -> None:
    bench = Bench(constant(30.0, 0.0, -40.0), RenderSpec(thermal_s=100.0))
    force = bench.settled(0.0, 0.0, 0.0)
    assert force == pytest.approx([2.4, 0, -3.2], rel=1e-9)


def test_the_peak_is_allowed_until_the_heat_is_reached() -> None:
    bench = Bench(constant(0.0, 0.0, 30.0))  # peak 4 N, continuous 1 N, a time constant of 1 s
    forces = np.array([bench.tick(0, 0, 0)[2] for _ in range(4000)])
    full = np.flatnonzero(forces > 3.999)
    # L^2 = H + 24 (1 - H) is below 16 from a heat of 8 / 23 on: 16 (1 - exp(-t)) reaches it after 22 ms
    assert full.max() / 1000 == pytest.approx(0.022, abs=0.003)
    assert -np.diff(forces).min() < 0.05  # from the peak down, it starts at 45 mN in a tick
    assert forces[2000:] == pytest.approx(1.0, rel=1e-2)
    assert (np.diff(forces[full.max() :]) <= 1e-12).all()  # no buzz on the way down
    assert bench.value("state.force.heat") <= 1.0
    for _ in range(3000):
        bench.tick(0.2, 0, 0)  # where there is no force
    assert bench.value("state.force.heat") < 0.1
    assert max(bench.tick(0, 0, 0)[2] for _ in range(30)) > 3.999  # cold again


@given(st.lists(st.tuples(st.floats(-0.07, 0.07), st.integers(1, 300)), min_size=1, max_size=8))
def test_the_continuous_limit_holds_in_the_long_run(stays: list[tuple[float, int]]) -> None:
    bench = SPRING
    bench.restart(RenderSpec(thermal_s=0.3))
    heats, squares = [], []
    for coordinate, count in stays * 3:
        for _ in range(count):
            squares.append(float(np.square(bench.tick(coordinate, 0, 0)).sum()))
            heats.append(bench.value("state.force.heat"))
    assert max(heats) <= 1.01  # N^2: 1 N continuously
    seconds = len(squares) / 1000
    assert sum(squares) / 1000 <= 1.0 * (seconds + 0.3) + 0.01  # plus the initial thermal margin


SPRING = Bench(linear(-2000 * np.eye(3)))


def test_without_a_continuous_limit_the_peak_stays() -> None:
    bench = Bench(
        constant(0.0, 0.0, 30.0), device=OMNI.__class__(**{**vars(OMNI), "force_continuous_n": None})
    )
    assert bench.settled(0, 0, 0, 5000)[2] == pytest.approx(4.0, rel=1e-9)
