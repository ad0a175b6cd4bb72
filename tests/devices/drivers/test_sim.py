"""The simulated hand: exact interpolation, the oscillator's equation, and reproducibility."""

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


def open_hand(*arguments) -> SimHand:
    hand = SimHand(*arguments)
    hand.open()
    return hand


def on_spring(path: Trace, mass: float, stiffness: float, damping: float) -> SimHand:
    hand = SimHand(path, "spring")
    hand._constants = (mass, stiffness, damping)
    hand.open()
    return hand


def test_follow_interpolates_the_trajectory_and_rests_at_both_ends() -> None:
    hand = open_hand(trace((0.5, 1, 2, 3), (0.7, 2, 2, 3), (0.7, 5, 5, 5), (1.0, 5, 5, 8)))
    hand.put_force_n(100.0, 0.0, 0.0)
    positions_m = []
    for _ in range(12):
        positions_m.append(hand.position_m())
        hand.advance(0.1)
    assert positions_m[0] == positions_m[4] == (1, 2, 3)  # before the first sample
    assert positions_m[6] == pytest.approx((1.5, 2, 3))
    assert positions_m[8] == pytest.approx((5, 5, 6))  # after the jump at 0.7 s
    assert positions_m[11] == (5, 5, 8)


def test_hand_without_a_trajectory_rests_at_the_origin() -> None:
    hand = open_hand()
    hand.advance(1.0)
    assert hand.position_m() == (0, 0, 0)


@given(
    st.lists(st.floats(0, 1e3), min_size=1, max_size=12),
    st.data(),
)
def test_follow_agrees_with_linear_interpolation(times, data) -> None:
    times = sorted(set(times))
    coordinates = data.draw(st.lists(st.floats(-1e6, 1e6), min_size=len(times), max_size=len(times)))
    hand = open_hand(Trace(np.array(times), np.array([coordinates] * 3).T))
    t = 0.0
    for _ in range(5):
        dt = data.draw(st.floats(0, 10))
        hand.advance(dt)
        t += dt
        expected = np.interp(t, times, coordinates)
        assert hand.position_m() == pytest.approx([expected] * 3, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("kind", ["follow", "spring"])
@given(st.lists(st.sampled_from([-1.0, 1.0]), min_size=4, max_size=4), st.integers(0, 2**31))
def test_hand_rotates_the_shorter_way_for_any_quaternion_signs(kind, signs, seed) -> None:
    """q and -q are one orientation, also between samples: the hand rotates evenly within 0.5 degrees."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(4, 3))
    steps *= rng.uniform(0.1, 0.6, (4, 1)) / np.linalg.norm(steps, axis=1, keepdims=True)
    rotations = [Rotation.random(random_state=seed)]
    for step in steps[1:]:
        rotations.append(Rotation.from_rotvec(step) * rotations[-1])
    quaternions = (
        np.array([rotation.as_quat()[[3, 0, 1, 2]] for rotation in rotations]) * np.array(signs)[:, None]
    )
    hand = SimHand(Trace(np.arange(4) * 0.1, np.zeros((4, 3)), quaternions), kind)
    hand.open()
    expected = Slerp(np.arange(4) * 0.1, Rotation.concatenate(rotations))
    for n in range(31):
        w, x, y, z = hand.orientation()
        assert math.hypot(w, x, y, z) == pytest.approx(1.0, abs=1e-12)
        difference = Rotation.from_quat([x, y, z, w]) * expected(min(n * 0.01, 0.3)).inv()
        assert difference.magnitude() < math.radians(0.5)
        hand.advance(0.01)


def test_spring_agrees_with_the_damped_oscillator() -> None:
    """An underdamped mass released at 1 cm: x = A e^(-ct) (cos wt + c/w sin wt) about its target."""
    mass, k, b = 0.2, 300.0, 2.0
    hand = on_spring(trace((0, 0.01, 0, 0), (0, 0, 0, 0)), mass, k, b)  # opens on the later sample: 0
    hand._state[1] = 0.01
    c = b / (2 * mass)
    w = math.sqrt(k / mass - c * c)
    for n in range(1, 400):
        hand.advance(0.001)
        t = n * 0.001
        exact = 0.01 * math.exp(-c * t) * (math.cos(w * t) + c / w * math.sin(w * t))
        assert hand.position_m()[0] == pytest.approx(exact, abs=4e-4)


def test_force_displaces_the_spring_by_f_over_k() -> None:
    hand = open_hand(trace((0, 0.1, 0, 0)), "spring")
    hand.put_force_n(0.0, 2.0, -1.0)
    for _ in range(1000):
        hand.advance(0.001)
    assert hand.position_m() == pytest.approx((0.1, 2 / 500, -1 / 500), abs=1e-6)
    hand.put_force_n(0.0, 0.0, 0.0)
    for _ in range(1000):
        hand.advance(0.001)
    assert hand.position_m() == pytest.approx((0.1, 0, 0), abs=1e-6)


@given(st.floats(1e-3, 10), st.floats(0, 1e3), st.floats(1, 4e5), st.floats(1e-5, 0.1), st.floats(-20, 20))
def test_spring_is_stable_for_any_constants(mass, damping, stiffness, dt, force) -> None:
    hand = on_spring(trace((0, 0, 0, 0)), mass, stiffness, damping)
    hand.put_force_n(force, 0.0, 0.0)
    reach = 2.3 * abs(force) / stiffness + 1e-12  # an undamped spring swings to twice its rest position
    for _ in range(50):
        hand.advance(dt)
        assert abs(hand.position_m()[0]) <= reach


def test_runs_are_reproducible_and_open_restarts() -> None:
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
def test_invalid_time_steps_are_refused(dt) -> None:
    with pytest.raises(DeviceError, match="step"):
        open_hand().advance(dt)


def test_unknown_kinds_of_hand_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="follow or spring"):
        SimHand(kind="loose")  # type: ignore[arg-type]


def test_invalid_forces_and_closed_hands_are_errors() -> None:
    hand = open_hand()
    with pytest.raises(DeviceError, match="finite newtons"):
        hand.put_force_n(math.nan, 0.0, 0.0)
    hand.close()
    with pytest.raises(DeviceError, match="not open"):
        hand.position_m()
    with pytest.raises(DeviceError, match="after open"):
        hand.advance(0.001)


def test_registry_returns_a_picklable_hand() -> None:
    path = trace((0, 0.01, 0.02, 0.03))
    for text, kind in (("sim", "follow"), ("sim:follow", "follow"), (" SIM:spring", "spring")):
        choice = point_device(text, path)
        hand = pickle.loads(pickle.dumps(choice.opener))()
        hand.open()
        assert (hand.kind, choice.profile, choice.is_simulated) == (kind, None, True)
        assert hand.position_m() == (0.01, 0.02, 0.03)
        hand.advance(0.001)
        assert hand.position_m() == (0.01, 0.02, 0.03)
    with pytest.raises(InvalidArgument, match="sim:spring"):
        point_device("sim:loose")


def test_error_of_an_unknown_device_lists_the_devices() -> None:
    with pytest.raises(InvalidArgument, match=r"sim\[:spring\]"):
        point_device("simm")


def test_checks_find_nothing_missing() -> None:
    assert [check.is_there for check in KIND.checks()] == [True]
