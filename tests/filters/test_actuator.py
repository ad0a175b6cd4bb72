"""The low-pass of an actuator array, and its frequency response: the numbers of theory items 8 to 11."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import ArrayLike
from scipy import signal

from touchfield.errors import InvalidArgument
from touchfield.filters.fir import frequency_response
from touchfield.filters.registry import field_filters
from touchfield.filters.resample import LOW_PASSES
from touchfield.filters.smoothing import ActuatorLowPass, actuator_taps, cutoff_per_m
from touchfield.medium import ForceField, Grid

BOX3 = np.ones(3) / 3
HALF_POWER, HALF_AMPLITUDE = 10 * math.log10(2), 20 * math.log10(2)
CROSS = np.array([[0, -1, 0], [-1, 4, -1], [0, -1, 0]]) / 4  # 1 - (cos w1 + cos w2)/2


# -- equation 5 --------------------------------------------------------------------------------------------


def gain_db(taps: ArrayLike, omega: ArrayLike) -> Any:
    return 20 * np.log10(np.abs(frequency_response(taps, omega)))


def test_response_of_firwin_at_and_above_the_cut_off() -> None:
    found = gain_db(signal.firwin(31, 1 / 4), np.pi * np.array([0.25, 0.375]))
    assert found == pytest.approx([-6.010, -54.5], abs=0.05)
    assert found[0] == pytest.approx(-6.010, abs=5e-4)


def test_half_power_and_half_amplitude_of_known_filters() -> None:
    half_power = gain_db(BOX3, [0.9756, math.acos((3 / math.sqrt(2) - 1) / 2)])
    assert half_power == pytest.approx([-HALF_POWER] * 2, abs=5e-4)
    assert gain_db(BOX3, math.acos(0.25)) == pytest.approx(-HALF_AMPLITUDE, abs=1e-10)


def test_a_high_pass_has_no_gain_at_zero() -> None:
    low = actuator_taps(1.0, 4.0)
    high = -low
    high[len(low) // 2] += 1
    assert abs(frequency_response(high, 0.0)) < 1e-14
    assert frequency_response(CROSS, 0.0, 0.0) == 0


# -- the design --------------------------------------------------------------------------------------------


def test_the_cut_off_is_the_nyquist_rate_of_the_pitch() -> None:
    assert cutoff_per_m(0.035) == pytest.approx(1 / 0.07)
    assert cutoff_per_m(0.035, "literal") == pytest.approx(4 * cutoff_per_m(0.035))
    taps = actuator_taps(0.001, 0.004)  # pi delta/d = pi/4: the transition of firwin(31, 1/4)
    gains = gain_db(taps, np.pi * np.array([0.25, 0.375]))
    assert len(taps) == 33 and gains[0] == pytest.approx(-HALF_AMPLITUDE, abs=0.02) and gains[1] < -53


@given(st.sampled_from(sorted(LOW_PASSES)), st.floats(2.5, 30), st.sampled_from(["nyquist", "literal"]))
def test_every_kernel_is_centred_of_unit_sum_and_odd(kernel: str, pitch: float, cutoff: str) -> None:
    pitch = pitch * (4 if cutoff == "literal" else 1)
    taps = actuator_taps(1.0, pitch, cutoff, kernel)
    assert len(taps) % 2 == 1 and taps.sum() == pytest.approx(1, abs=1e-12)
    assert np.allclose(taps, taps[::-1], atol=1e-15)
    nyquist = np.pi / pitch * (4 if cutoff == "literal" else 1)
    before, after = gain_db(taps, nyquist * np.array([0.75, 1.3]))
    assert before > -HALF_AMPLITUDE > after


def wave_field(cycles_per_m: float) -> ForceField:
    """A wave along x of 400 samples with a spacing of 1 mm, and force along z."""
    grid = Grid((400, 1, 1), (0.001,) * 3, (0.0,) * 3)
    forces = np.zeros((400, 1, 1, 3))
    forces[:, 0, 0, 2] = np.cos(2 * np.pi * cycles_per_m * np.arange(400) * 0.001)
    return ForceField.from_dense(grid, forces)


def test_the_literal_cut_off_aliases_and_the_correct_one_does_not() -> None:
    """A wave of 0.8/d is below 2/d and aliases to 0.2/d when sampled at d; a cut-off of 1/(2d) removes it."""
    pitch, step = 0.010, 10
    field, alias = wave_field(0.8 / pitch), wave_field(0.2 / pitch)
    literal = ActuatorLowPass(pitch, "literal", "sinc")(field).to_dense()[::step, 0, 0, 2]
    correct = ActuatorLowPass(pitch, kernel="sinc")(field).to_dense()[::step, 0, 0, 2]
    inner = slice(5, -5)
    assert np.abs(literal - alias.to_dense()[::step, 0, 0, 2])[inner].max() < 0.01
    assert np.abs(correct[inner]).max() < 0.01
    passed = ActuatorLowPass(pitch, kernel="sinc")(alias).to_dense()[::step, 0, 0, 2]
    assert np.abs(passed - alias.to_dense()[::step, 0, 0, 2])[inner].max() < 0.01


def test_axes_and_claims() -> None:
    grid = Grid((40, 40, 9), (0.001,) * 3, (0.0,) * 3)
    spline, sinc = ActuatorLowPass.parse("pitch=4mm"), ActuatorLowPass.parse("pitch=4mm,kernel=sinc")
    assert spline.claims(grid).reach == (5, 5, 0) and spline.claims(grid).dc_gain == 1.0
    assert spline.claims(grid).max_principle and not sinc.claims(grid).max_principle
    assert sinc.claims(grid).reach == (16, 16, 0)
    assert sinc.claims(Grid((1, 40, 9), (0.001,) * 3, (0.0,) * 3)).reach == (0, 16, 0)
    impulse = ForceField.from_support(grid, [[20, 20, 4]], [[1.0, 2.0, 3.0]])
    filtered = sinc(impulse)
    assert set(filtered.positions()[:, 2].tolist()) == {4}
    taps = actuator_taps(0.001, 0.004)
    expected = np.multiply.outer(taps, taps)
    assert filtered.to_dense()[4:37, 4:37, 4, 2] == pytest.approx(3 * expected, abs=1e-6)
    assert ActuatorLowPass.parse(f"{sinc.text},axes=xy") == sinc  # the notation of older streams


def test_the_pitch_of_the_shirt_in_the_workspace_of_a_desktop_device() -> None:
    """A pitch of 35 mm needs 9 cm with the spline, and 28 cm with the steeper sinc."""
    small = Grid.over_box((0, 0, 0), (0.16, 0.16, 0.16), (128, 128, 128))
    assert ActuatorLowPass.parse("pitch=35mm").claims(small).reach == (35, 35, 0)
    with pytest.raises(
        InvalidArgument, match=r"--lowpass pitch 0.035 m along x: found 2\d\d taps along an axis of 128"
    ):
        ActuatorLowPass(0.035, kernel="sinc").claims(small)
    with pytest.raises(InvalidArgument, match="larger field"):
        ActuatorLowPass(0.1).claims(small)


def test_samples_at_the_actuator_pitch_are_unchanged() -> None:
    field = wave_field(100.0)
    assert ActuatorLowPass(0.001)(field) == field


@pytest.mark.parametrize(
    ("pitch", "cutoff", "message"),
    [
        (0.0009, "nyquist", r"cut-off is 555.556 cycles/m; expected a cut-off up to 500 cycles/m"),
        (0.0039, "literal", r"literal cut-off .* at least 0.004 m"),
    ],
)
def test_a_cut_off_above_the_nyquist_rate_is_refused(pitch: float, cutoff: str, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        ActuatorLowPass(pitch, cutoff)(wave_field(10.0))


@pytest.mark.parametrize(
    "text",
    ["", "0mm", "pitch=nan", "4mm,cutoff=half", "4mm,kernel=brick", "4mm,kernel=firwin", "4mm,axes=xyz"],
)
def test_invalid_low_pass_texts_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument, match=r"pitch|cutoff|kernel|axes"):
        ActuatorLowPass.parse(text)


def test_a_spacing_out_of_range_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="spacing_m"):
        actuator_taps(0.0, 0.01)
    with pytest.raises(InvalidArgument, match=r"low-pass: found .* source samples"):
        actuator_taps(1e-9, 1.0)


def test_modules_name_their_filter() -> None:
    assert field_filters()["lowpass"] is ActuatorLowPass
