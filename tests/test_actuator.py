"""The low-pass of an actuator array, and the frequency response: the numbers of theory items 8 to 11."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.filters.registry import field_filters
from touchfield.filters.response import FrequencyResponse
from touchfield.filters.smoothing import KERNELS, ActuatorLowPass, actuator_taps, cutoff_per_m
from touchfield.medium import ForceField, Grid

BOX3 = np.ones(3) / 3
CROSS = np.array([[0, -1, 0], [-1, 4, -1], [0, -1, 0]]) / 4  # 1 - (cos w1 + cos w2)/2


# -- equation 5 -------------------------------------------------------------------------------------------------


def test_the_response_of_firwin_at_the_cut_off_and_beyond() -> None:
    found = FrequencyResponse(signal.firwin(31, 1 / 4)).gain_db(np.pi * np.array([0.25, 0.375]))
    assert found == pytest.approx([-6.010, -54.5], abs=0.05)
    assert found[0] == pytest.approx(-6.010, abs=5e-4)


def test_half_power_and_half_amplitude_of_known_filters() -> None:
    box = FrequencyResponse(BOX3)
    assert box.minus_3_db_rad() == pytest.approx(0.9756, abs=5e-5)
    assert box.minus_3_db_rad() == pytest.approx(math.acos((3 / math.sqrt(2) - 1) / 2), abs=1e-10)
    assert box.minus_6_db_rad() == pytest.approx(math.acos(0.25), abs=1e-10)
    assert math.isnan(FrequencyResponse(np.array([1.0])).minus_3_db_rad())
    assert math.isnan(FrequencyResponse(np.array([-1.0, 2.0, -1.0])).minus_3_db_rad())  # a high-pass


@pytest.mark.parametrize(
    ("taps", "bits", "tolerance"),
    [
        (np.array([1, 2, 1]) / 4, -2.0, 1e-6),
        (BOX3, -math.log2(3), 1e-12),
        (np.multiply.outer(BOX3, [0.25, 0.5, 0.25]), -2 - math.log2(3), 1e-6),
        (CROSS, -0.317466, 1e-6),
        (np.array([2.0, 1.0]), 1.0, 1e-12),
        (np.array([1.0, 2.0]), 1.0, 1e-12),
        (np.array([0.0, 1.0, 0.0]), 0.0, 1e-12),
    ],
)
def test_the_entropy_rate_change_of_a_gaussian_process(taps: np.ndarray, bits: float, tolerance: float) -> None:
    assert FrequencyResponse(taps).entropy_rate_change_bits() == pytest.approx(bits, abs=tolerance)


def test_the_entropy_rate_change_in_three_dimensions() -> None:
    laplace = np.zeros((3, 3, 3))
    laplace[1, 1, 1] = 1
    for axis, end in itertools.product(range(3), (0, 2)):
        laplace[tuple(end if a == axis else 1 for a in range(3))] = -1 / 6
    trees = 1.6733893029  # nats a site: the spanning trees of the cubic lattice
    expected = (trees - math.log(6)) / math.log(2)
    assert FrequencyResponse(laplace).entropy_rate_change_bits() == pytest.approx(expected, abs=1e-4)


@given(st.lists(st.floats(-3, 3), min_size=1, max_size=7).filter(lambda h: max(map(abs, h)) > 0.1))
def test_jensens_formula_agrees_with_a_mean_over_frequencies(h: list[float]) -> None:
    taps = np.array(h) + 0.0
    omega = (np.arange(1 << 14) + 0.5) * 2 * np.pi / (1 << 14)
    gain = np.abs(FrequencyResponse(taps)(omega))
    if gain.min() > 1e-3:
        mean = np.log2(gain).mean()
        assert FrequencyResponse(taps).entropy_rate_change_bits() == pytest.approx(mean, abs=2e-4)


def test_a_gaussian_process_gains_what_the_response_says() -> None:
    """The determinant of a circulant filter is the product of its gains: exact for a finite periodic process."""
    taps, count = np.array([0.2, 1.0, 0.3]), 256
    circulant = sum(h * np.roll(np.eye(count), k, axis=0) for k, h in enumerate(taps))
    per_sample = np.linalg.slogdet(circulant)[1] / count / math.log(2)
    assert FrequencyResponse(taps).entropy_rate_change_bits() == pytest.approx(per_sample, abs=1e-9)


def test_directions_of_a_response() -> None:
    found = FrequencyResponse(np.multiply.outer(BOX3, np.ones(5) / 5))
    w = np.linspace(0.1, 1.0, 5)
    assert np.array_equal(found.gain_db(w), found.gain_db(w, "x"))
    assert found.gain_db(w, "y") == pytest.approx(found.gain_db(w, (0.0, 1.0)))
    assert found.gain_db(w, "diagonal") == pytest.approx(found.gain_db(w, "x") + found.gain_db(w, "y"))
    assert found.minus_3_db_rad("y") < found.minus_3_db_rad("x")
    with pytest.raises(InvalidArgument, match="one of x, y, diagonal"):
        found.gain_db(w, "z")
    with pytest.raises(InvalidArgument, match="2 numbers"):
        found.gain_db(w, (1.0,))


def test_a_high_pass_has_no_gain_at_zero() -> None:
    low = actuator_taps(1.0, 4.0)
    high = -low
    high[len(low) // 2] += 1
    assert abs(FrequencyResponse(high).dc_gain) < 1e-15
    assert FrequencyResponse(high).gain_db(0.0) < -280
    assert FrequencyResponse(CROSS).dc_gain == 0


def test_the_plot_is_a_picture(tmp_path: Path) -> None:
    found = FrequencyResponse(np.multiply.outer(BOX3, np.ones(5) / 5), (0.001, 0.001))
    for name in ("a.png", "a.svg"):
        found.plot(tmp_path / name, "a title")
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    svg = (tmp_path / "a.svg").read_text()
    assert svg.count("cycles per millimetre") == 1 and "radians per sample" in svg and "gain |H|, dB" in svg
    with pytest.raises(InvalidArgument, match="ending"):
        found.plot(tmp_path / "a.xyz")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "a.svg"]


def test_a_plot_without_matplotlib_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    with pytest.raises(MissingExtra, match=r"touchfield\[report\]"):
        FrequencyResponse(BOX3).plot(tmp_path / "a.png")


@pytest.mark.parametrize("taps", [[], [math.nan], [0.0, 0.0]])
def test_taps_without_a_response(taps: list[float]) -> None:
    with pytest.raises(InvalidArgument, match="taps"):
        FrequencyResponse(np.array(taps))


def test_other_bad_arguments_of_a_response() -> None:
    with pytest.raises(InvalidArgument, match="spacing_m"):
        FrequencyResponse(BOX3, (0.001, 0.001))
    with pytest.raises(InvalidArgument, match="drop_db"):
        FrequencyResponse(BOX3).crossing_rad(-3)


# -- the design -------------------------------------------------------------------------------------------------


def test_the_cut_off_is_the_nyquist_rate_of_the_pitch() -> None:
    assert cutoff_per_m(0.035) == pytest.approx(1 / 0.07)
    assert cutoff_per_m(0.035, "literal") == pytest.approx(4 * cutoff_per_m(0.035))
    taps = actuator_taps(0.001, 0.004)  # pi delta/d = pi/4
    assert np.allclose(taps, signal.firwin(31, 1 / 4), atol=1e-15)
    assert FrequencyResponse(taps).minus_6_db_rad() == pytest.approx(np.pi / 4, rel=1e-3)


@given(st.sampled_from(KERNELS), st.floats(2.5, 30), st.sampled_from(["nyquist", "literal"]))
def test_every_kernel_is_centred_of_unit_sum_and_odd(kernel: str, pitch: float, cutoff: str) -> None:
    pitch = pitch * (4 if cutoff == "literal" else 1)
    taps = actuator_taps(1.0, pitch, cutoff, kernel)
    assert len(taps) % 2 == 1 and taps.sum() == pytest.approx(1, abs=1e-12)
    assert np.allclose(taps, taps[::-1], atol=1e-15)
    nyquist = np.pi / pitch * (4 if cutoff == "literal" else 1)
    assert FrequencyResponse(taps).minus_6_db_rad() == pytest.approx(nyquist, rel=0.25)


def wave_field(cycles_per_m: float) -> ForceField:
    """A wave along x of 400 samples a millimetre apart, force along z."""
    grid = Grid((400, 1, 1), (0.001,) * 3, (0.0,) * 3)
    forces = np.zeros((400, 1, 1, 3))
    forces[:, 0, 0, 2] = np.cos(2 * np.pi * cycles_per_m * np.arange(400) * 0.001)
    return ForceField.from_dense(grid, forces)


def test_the_literal_cut_off_aliases_and_the_correct_one_does_not() -> None:
    """A wave of 0.8/d passes 2/d and, sampled at d, is one of 0.2/d; 1/(2d) takes it away."""
    pitch, step = 0.010, 10
    field, alias = wave_field(0.8 / pitch), wave_field(0.2 / pitch)
    literal = ActuatorLowPass(pitch, "literal")(field).to_dense()[::step, 0, 0, 2]
    correct = ActuatorLowPass(pitch)(field).to_dense()[::step, 0, 0, 2]
    inner = slice(5, -5)
    assert np.abs(literal - alias.to_dense()[::step, 0, 0, 2])[inner].max() < 0.01
    assert np.abs(correct[inner]).max() < 0.01
    passed = ActuatorLowPass(pitch)(alias).to_dense()[::step, 0, 0, 2]
    assert np.abs(passed - alias.to_dense()[::step, 0, 0, 2])[inner].max() < 0.01


def test_axes_and_claims() -> None:
    grid = Grid((40, 40, 9), (0.001,) * 3, (0.0,) * 3)
    flat = ActuatorLowPass.parse("pitch=4mm")
    assert flat.claims(grid).reach == (15, 15, 0) and not flat.claims(grid).max_principle
    spline = ActuatorLowPass.parse("4mm,kernel=spline,axes=xy")
    assert spline.claims(grid).max_principle and spline.claims(grid).dc_gain == 1.0
    with pytest.raises(InvalidArgument, match="along z: found 31 taps along an axis of 9"):
        ActuatorLowPass.parse("4mm,kernel=firwin,axes=xyz")(ForceField.from_support(grid, [[3, 3, 3]], [[1, 0, 0]]))
    one = ForceField.from_support(grid, [[20, 20, 4]], [[1.0, 2.0, 3.0]])
    made = flat(one)
    assert set(made.positions()[:, 2].tolist()) == {4}
    taps = actuator_taps(0.001, 0.004)
    expected = np.multiply.outer(taps, taps)
    assert made.to_dense()[5:36, 5:36, 4, 2] == pytest.approx(3 * expected, abs=1e-6)
    assert ActuatorLowPass.parse(flat.words) == flat


def test_the_pitch_of_the_shirt_in_the_workspace_of_a_desktop_device() -> None:
    """firwin needs 26 cm for 35 mm: by default the kernel is the spline where that does not fit, and firwin where."""
    small = Grid.over_box((0, 0, 0), (0.16, 0.16, 0.16), (128, 128, 128))
    large = Grid.over_box((0, 0, 0), (0.40, 0.40, 0.16), (64, 64, 32))
    asked = ActuatorLowPass.parse("pitch=35mm")
    assert asked.kernel == "auto" and "kernel=auto" in asked.words and ActuatorLowPass.parse(asked.words) == asked
    spline, firwin = ActuatorLowPass(0.035, kernel="spline"), ActuatorLowPass(0.035, kernel="firwin")
    assert asked.claims(small) == spline.claims(small) and asked.claims(small).max_principle
    one = ForceField.from_support(small, [[64, 64, 64]], [[1.0, 0.0, 0.0]])
    assert asked(one) == spline(one)
    flat = ActuatorLowPass.parse("pitch=35mm,axes=xy")
    assert flat.claims(large) == ActuatorLowPass(0.035, kernel="firwin", axes="xy").claims(large)
    assert not flat.claims(large).max_principle
    needed = len(actuator_taps(small.spacing_m[0], 0.035, kernel="spline"))
    said = rf"along x: found 2\d\d taps along an axis of 128 .* kernel=spline needs only {needed} taps"
    with pytest.raises(InvalidArgument, match=said):
        firwin.claims(small)
    with pytest.raises(InvalidArgument, match="smaller pitch or a larger field"):
        ActuatorLowPass(0.1).claims(small)


def test_samples_as_far_apart_as_the_actuators_pass_unchanged() -> None:
    field = wave_field(100.0)
    assert ActuatorLowPass(0.001)(field) == field


@pytest.mark.parametrize(
    ("pitch", "cutoff", "said"),
    [
        (0.0009, "nyquist", r"cut-off is 555.556 cycles/m; expected a cut-off up to 500 cycles/m"),
        (0.0039, "literal", r"literal cut-off .* at least 0.004 m"),
    ],
)
def test_a_cut_off_above_the_nyquist_rate_is_refused(pitch: float, cutoff: str, said: str) -> None:
    with pytest.raises(InvalidArgument, match=said):
        ActuatorLowPass(pitch, cutoff)(wave_field(10.0))


@pytest.mark.parametrize(
    "text", ["", "0mm", "pitch=nan", "4mm,cutoff=half", "4mm,kernel=brick", "4mm,axes=xx", "4mm,axes=w"]
)
def test_words_that_make_no_low_pass(text: str) -> None:
    with pytest.raises(InvalidArgument, match=r"pitch|cutoff|kernel|axes"):
        ActuatorLowPass.parse(text)


def test_a_spacing_out_of_range_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="spacing_m"):
        actuator_taps(0.0, 0.01)
    with pytest.raises(InvalidArgument, match="pitch_m"):
        actuator_taps(1e-9, 1.0)


def test_modules_name_their_filter() -> None:
    assert field_filters()["lowpass"] is ActuatorLowPass
