"""The simulated hand: it follows exactly, swings as the equation says, and gives the same numbers twice."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation, Slerp

from touchfield.devices.drivers.registry import point_device
from touchfield.devices.drivers.simulated import KIND, SimHand
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.medium.trace import Trace


def trace(*rows: tuple[float, float, float, float]) -> Trace:
    table = np.array(rows)
    return Trace(table[:, 0], table[:, 1:])


def opened(*arguments) -> SimHand:
    hand = SimHand(*arguments)
    hand.open()
    return hand


def on_spring(path: Trace, mass: float, stiffness: float, damping: float) -> SimHand:
    hand = SimHand(path, "spring")
    hand._constants = (mass, stiffness, damping)
    hand.open()
    return hand


def test_follow_is_on_the_trajectory_between_its_samples_and_rests_at_both_ends() -> None:
    hand = opened(trace((0.5, 1, 2, 3), (0.7, 2, 2, 3), (0.7, 5, 5, 5), (1.0, 5, 5, 8)))
    hand.put_force_n(100.0, 0.0, 0.0)
    seen = []
    for _ in range(12):
        seen.append(hand.position_m())
        hand.advance(0.1)
    assert seen[0] == seen[4] == (1, 2, 3)  # before the first sample
    assert seen[6] == pytest.approx((1.5, 2, 3))
    assert seen[8] == pytest.approx((5, 5, 6))  # after the jump at 0.7 s
    assert seen[11] == (5, 5, 8)


def test_without_a_trajectory_it_rests_at_the_origin() -> None:
    hand = opened()
    hand.advance(1.0)
    assert hand.position_m() == (0, 0, 0)


@given(
    st.lists(st.floats(0, 1e3), min_size=1, max_size=12),
    st.data(),
)
def test_follow_agrees_with_linear_interpolation(times, data) -> None:
    times = sorted(set(times))
    places = data.draw(st.lists(st.floats(-1e6, 1e6), min_size=len(times), max_size=len(times)))
    hand = opened(Trace(np.array(times), np.array([places] * 3).T))
    t = 0.0
    for _ in range(5):
        dt = data.draw(st.floats(0, 10))
        hand.advance(dt)
        t += dt
        wanted = np.interp(t, times, places)
        assert hand.position_m() == pytest.approx([wanted] * 3, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("kind", ["follow", "spring"])
@given(st.lists(st.sampled_from([-1.0, 1.0]), min_size=4, max_size=4), st.integers(0, 2**31))
def test_the_hand_turns_the_shorter_way_whatever_the_signs_of_its_quaternions(kind, signs, seed) -> None:
    """q and -q are one orientation: between samples too, where the hand turns at even speed within half a
    degree.
    """
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(4, 3))
    steps *= rng.uniform(0.1, 0.6, (4, 1)) / np.linalg.norm(steps, axis=1, keepdims=True)
    turns = [Rotation.random(random_state=seed)]
    for step in steps[1:]:
        turns.append(Rotation.from_rotvec(step) * turns[-1])
    quaternions = np.array([turn.as_quat()[[3, 0, 1, 2]] for turn in turns]) * np.array(signs)[:, None]
    hand = SimHand(Trace(np.arange(4) * 0.1, np.zeros((4, 3)), quaternions), kind)
    hand.open()
    expected = Slerp(np.arange(4) * 0.1, Rotation.concatenate(turns))
    for n in range(31):
        w, x, y, z = hand.orientation()
        assert math.hypot(w, x, y, z) == pytest.approx(1.0, abs=1e-12)
        apart = Rotation.from_quat([x, y, z, w]) * expected(min(n * 0.01, 0.3)).inv()
        assert apart.magnitude() < math.radians(0.5)
        hand.advance(0.01)


def test_the_spring_swings_as_the_equation_of_a_damped_oscillator() -> None:
    """An underdamped mass released at 1 cm: x = A e^(-ct) (cos wt + c/w sin wt) about its target."""
    mass, k, b = 0.2, 300.0, 2.0
    hand = on_spring(trace((0, 0.01, 0, 0), (0, 0, 0, 0)), mass, k, b)  # opens on the later: 0
    hand._state[1] = 0.01
    c = b / (2 * mass)
    w = math.sqrt(k / mass - c * c)
    for n in range(1, 400):
        hand.advance(0.001)
        t = n * 0.001
        exact = 0.01 * math.exp(-c * t) * (math.cos(w * t) + c / w * math.sin(w * t))
        assert hand.position_m()[0] == pytest.approx(exact, abs=4e-4)


def test_a_force_displaces_the_spring_by_f_over_k_and_release_brings_it_back() -> None:
    hand = opened(trace((0, 0.1, 0, 0)), "spring")
    hand.put_force_n(0.0, 2.0, -1.0)
    for _ in range(1000):
        hand.advance(0.001)
    assert hand.position_m() == pytest.approx((0.1, 2 / 500, -1 / 500), abs=1e-6)
    hand.put_force_n(0.0, 0.0, 0.0)
    for _ in range(1000):
        hand.advance(0.001)
    assert hand.position_m() == pytest.approx((0.1, 0, 0), abs=1e-6)


@given(st.floats(1e-3, 10), st.floats(0, 1e3), st.floats(1, 4e5), st.floats(1e-5, 0.1), st.floats(-20, 20))
def test_the_spring_is_stable_whatever_its_constants(mass, damping, stiffness, dt, force) -> None:
    hand = on_spring(trace((0, 0, 0, 0)), mass, stiffness, damping)
    hand.put_force_n(force, 0.0, 0.0)
    reach = 2.3 * abs(force) / stiffness + 1e-12  # an undamped one swings to twice its rest
    for _ in range(50):
        hand.advance(dt)
        assert abs(hand.position_m()[0]) <= reach


def test_two_runs_give_the_same_numbers_and_open_begins_again() -> None:
    path = Trace.regular(np.cumsum(np.random.default_rng(1).normal(0, 1e-4, (200, 3)), axis=0))
    runs = []
    hand = SimHand(path, "spring")
    for _ in range(2):
        hand.open()
        run = []
        for n in range(300):
            run.append(hand.position_m())
            hand.put_force_n(math.sin(n), 0.0, 1.0)
            hand.advance(0.001)
        hand.close()
        hand.close()
        runs.append(run)
    assert runs[0] == runs[1]


@pytest.mark.parametrize("dt", [-0.001, math.nan, math.inf, 11.0])
def test_time_that_cannot_pass_is_refused(dt) -> None:
    with pytest.raises(DeviceError, match="step"):
        opened().advance(dt)


def test_there_are_two_kinds_of_hand() -> None:
    with pytest.raises(InvalidArgument, match="follow or spring"):
        SimHand(kind="loose")  # type: ignore[arg-type]


def test_a_force_that_is_no_number_and_a_closed_hand_are_told() -> None:
    hand = opened()
    with pytest.raises(DeviceError, match="finite newtons"):
        hand.put_force_n(math.nan, 0.0, 0.0)
    hand.close()
    with pytest.raises(DeviceError, match="not open"):
        hand.position_m()
    with pytest.raises(DeviceError, match="after open"):
        hand.advance(0.001)


def test_the_registry_makes_a_hand_that_crosses_to_another_process() -> None:
    path = trace((0, 0.01, 0.02, 0.03))
    for words, kind in (("sim", "follow"), ("sim:follow", "follow"), (" SIM:spring", "spring")):
        choice = point_device(words, path)
        hand = pickle.loads(pickle.dumps(choice.opener))()
        hand.open()
        assert (hand.kind, choice.profile, choice.is_simulated) == (kind, None, True)
        assert hand.position_m() == (0.01, 0.02, 0.03)
        hand.advance(0.001)
        assert hand.position_m() == (0.01, 0.02, 0.03)
    with pytest.raises(InvalidArgument, match="sim:spring"):
        point_device("sim:loose")


def test_a_device_that_nobody_knows_gets_a_list_of_those_there_are() -> None:
    with pytest.raises(InvalidArgument, match=r"sim\[:spring\]"):
        point_device("simm")


def test_nothing_is_missing() -> None:
    assert [check.is_there for check in KIND.checks()] == [True]
