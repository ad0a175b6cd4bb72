"""A hand at rest: steps and vibrations added to the decoded frames of a ball that rests or moves."""

import numpy as np
import pytest

from touchfield.medium import ForceField, Grid
from touchfield.perception import hand_motion
from touchfield.perception.hand_motion import HoldMeter

GRID = Grid((32, 32, 32), (0.0015,) * 3, (-0.02325,) * 3)
STIFFNESS, K, F0_N = 300.0, 0.1, 0.05


def ball(shift_m=0.0):
    points = GRID.to_m(np.moveaxis(np.indices(GRID.shape), 0, -1)) - [shift_m, 0, 0]
    r = np.linalg.norm(points, axis=-1, keepdims=True)
    return ForceField.from_dense(GRID, STIFFNESS * np.maximum(0.02 - r, 0) * points / np.maximum(r, 1e-9))


REST = ball()


def measured_hold(errors_n, rate_hz=1000.0, starts=(0,), source=None):
    """The hold over frames of a ball at rest whose decoded force is off by `errors_n` [frames, 3]."""
    meter = HoldMeter(len(errors_n), rate_hz, K, F0_N, points=8)
    for frame, error in enumerate(errors_n):
        surface = REST if source is None else source(frame)
        meter.add(surface, surface.sample_n, lambda p, e=error, s=surface: s.sample_n(p) + e, frame in starts)
    return meter.hold()


def along_z(values):
    return np.outer(values, [0.0, 0.0, 1.0])


def test_a_lossless_decode_adds_no_step():
    hold = measured_hold(np.zeros((40, 3)))
    assert hold.points == 8 and hold.steps == 8 * 39
    assert hold.step_mn == hold.still_step_mn == hold.still_step_ratio == hold.start_error_mn == 0
    assert hold.error_mn is None  # 40 ms are too short for 40 Hz


@pytest.mark.parametrize("at_once", [1, 3 * 500, 1 << 17])
def test_hold_is_independent_of_the_batch_size(monkeypatch, at_once):
    monkeypatch.setattr(hand_motion, "_AT_ONCE", at_once)
    meter, weight = HoldMeter(1000, 1000.0, K, F0_N, points=8), np.linspace(0, 1, 8)
    for frame in range(1000):
        error = 0.02 * np.sin(0.2 * np.pi * frame) * along_z(weight)  # 100 Hz
        meter.add(REST, REST.sample_n, lambda p, e=error: REST.sample_n(p) + e[: len(p)], frame == 0)
    assert meter.hold().error_mn == pytest.approx(20 * np.sqrt((weight**2).mean() / 2), rel=0.03)


@pytest.mark.parametrize("at", [1, 499, 500, 501, 502, 1003, 1999])
def test_a_single_step_is_found_at_any_frame(at):
    errors = along_z(np.where(np.arange(2000) < at, 0.0, 0.12))
    hold = measured_hold(errors, starts=(0, at))
    assert hold.step_mn == hold.start_step_mn == pytest.approx(120, rel=1e-4)
    assert hold.step_source_mn == 0 and hold.error_step_mn == 0
    assert hold.start_error_mn == pytest.approx(120, rel=1e-4)
    assert hold.still_step_mn == pytest.approx(120, rel=1e-4)
    # the mask at the level of 1 N is 0.1 N
    assert hold.still_step_ratio == pytest.approx(1.2, rel=0.03)


def test_steps_at_segment_starts_are_reported_separately():
    frames = np.arange(64)
    errors = along_z(0.01 * (frames // 8 % 2) + 0.001 * (frames % 2))
    hold = measured_hold(errors, starts=range(0, 64, 8))
    assert hold.start_step_mn == hold.step_mn == pytest.approx(11, rel=0.02)
    assert hold.error_step_mn == pytest.approx(1, rel=1e-3)


def test_a_sine_of_the_error_has_its_rms_and_its_third():
    t = np.arange(600) / 1000
    hold = measured_hold(along_z(0.01 * np.sin(2 * np.pi * 100 * t)))
    assert hold.error_mn == pytest.approx(10 / np.sqrt(2), rel=0.05)
    assert np.argmax(hold.error_thirds_mn) == 4 and hold.source_mn < 1e-3
    assert hold.error_peak_mn == pytest.approx(10, rel=0.2)


def test_slow_frames_are_blended_as_by_the_receiver():
    # +-5 mN at 30 Hz is a triangle of 15 Hz; its third harmonic, 45 Hz, has 8 / 9 / pi^2 of 5 mN
    hold = measured_hold(along_z(0.01 * (np.arange(60) % 2)), rate_hz=30.0)
    third_harmonic_mn = 5 * 8 / 9 / np.pi**2 / np.sqrt(2)
    assert hold.error_mn == pytest.approx(third_harmonic_mn, rel=0.25)
    assert hold.step_mn == pytest.approx(10, rel=1e-4)


def test_steps_of_the_source_are_reported_separately():
    hold = measured_hold(np.zeros((30, 3)), source=lambda frame: ball(0.0003 * (frame // 10)))
    assert hold.step_mn == hold.step_source_mn > 50 and hold.still_step_mn <= 1
    assert hold.start_error_mn == hold.error_step_mn == 0


def test_points_wait_for_the_first_frame_with_a_surface():
    empty = ForceField.empty(GRID)
    hold = measured_hold(np.zeros((20, 3)), source=lambda frame: REST if frame > 4 else empty)
    assert hold.points == 8 and hold.steps == 8 * 14
    assert measured_hold(np.zeros((20, 3)), source=lambda frame: empty).points == 0


@pytest.mark.parametrize(("frames", "parts"), [(500, 1), (1250, 2), (1251, 3), (2000, 4)])
def test_each_part_has_new_points_and_a_short_rest_has_none(frames, parts):
    hold = measured_hold(np.zeros((frames, 3)))
    assert (hold.points, hold.steps) == (8 * parts, 8 * (frames - 1))


def test_below_the_floor_a_step_is_relative_to_the_floor():
    weak = REST.scaled(0.02)
    hold = measured_hold(along_z(0.06 * (np.arange(20) >= 10)), source=lambda frame: weak)
    assert hold.still_step_ratio == pytest.approx(0.06 / F0_N, rel=1e-4)


def test_start_steps_have_the_source_step_of_the_same_frame():
    shifts = np.array([0.0, 0.0002, 0.0006])
    hold = measured_hold(np.zeros((30, 3)), starts=(0, 10), source=lambda frame: ball(shifts[frame // 10]))
    assert 0 < hold.start_step_mn == hold.start_step_source_mn < 0.7 * hold.step_mn
    assert hold.step_mn == hold.step_source_mn
    error = along_z(0.02 * (np.arange(30) >= 20))
    louder = measured_hold(error, starts=(0, 20), source=lambda frame: ball(shifts[frame // 10]))
    assert louder.start_step_source_mn == pytest.approx(hold.step_source_mn)
    assert louder.start_step_mn != louder.start_step_source_mn
    assert louder.start_error_mn == pytest.approx(20, rel=1e-3) and louder.error_step_mn < 1e-3


def test_vibration_of_the_source_is_reported_separately():
    t = np.arange(600) / 1000
    scale = 1 + 0.01 * np.sin(2 * np.pi * 100 * t)
    hold = measured_hold(np.zeros((600, 3)), source=lambda frame: REST.scaled(scale[frame]))
    assert hold.source_mn == pytest.approx(10 / np.sqrt(2), rel=0.05)  # a hundredth of 1 N
    assert hold.error_mn == hold.error_peak_mn == 0 and not hold.error_thirds_mn.any()


def test_frames_faster_than_the_servo_keep_their_rate():
    t = np.arange(1200) / 2000
    hold = measured_hold(along_z(0.01 * np.sin(2 * np.pi * 100 * t)), rate_hz=2000.0)
    assert hold.error_mn == pytest.approx(10 / np.sqrt(2), rel=0.05)
    assert np.argmax(hold.error_thirds_mn) == 4
    beyond = measured_hold(along_z(0.01 * np.sin(2 * np.pi * 900 * t)), rate_hz=2000.0)
    assert beyond.error_mn < 0.1  # every other frame would alias it to 100 Hz
