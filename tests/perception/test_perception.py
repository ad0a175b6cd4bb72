"""The perceptual mask, eq. 6 as printed and corrected, and every variant of the deadband (section 4.2)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from touchfield.errors import InvalidArgument
from touchfield.perception.mask import mask_n, violations
from touchfield.perception.weber import (
    READINGS,
    WeberLadder,
    gate,
    gate_in_time,
    guaranteeing_fraction,
    jnd_gain,
    quantise_fixed_step,
    within_mask_from_n,
)

forces = st.floats(-3.5, 3.5, width=32)
scans = st.integers(0, 60).flatmap(lambda n: arrays(np.float32, (n, 3), elements=forces))
fractions = st.sampled_from([0.01, 0.05, 0.1, 0.25, 0.9])


def along_x(amplitudes):
    vectors = np.zeros((len(amplitudes), 3), np.float32)
    vectors[:, 0] = amplitudes
    return vectors


def decoder_output(sent, values):
    """Output of a decoder: the last sent value, and zero before the first."""
    latest = np.maximum.accumulate(np.where(sent, np.arange(len(sent)), -1))
    return np.where(latest[:, None] >= 0, values[latest], np.float32(0))


def relative_errors(x, y):
    x, y = x.astype(np.float64), y.astype(np.float64)
    size = np.linalg.norm(x, axis=1)
    return np.linalg.norm(x - y, axis=1)[size > 0] / size[size > 0]


# -- the mask ----------------------------------------------------------------------------------------------


def test_the_mask_is_the_larger_of_floor_and_fraction():
    np.testing.assert_array_equal(mask_n([0.0, 0.1, 2.0], 0.1, 0.05), [0.05, 0.05, 0.2])
    np.testing.assert_array_equal(mask_n([0.0, 2.0], 0.1, 0.05, masking_n=[0.25, 0.0]), [0.25, 0.2])


def test_violations_are_counted_where_the_error_exceeds_the_mask():
    original = along_x([1.0, 1.0, 0.1, 0.0])
    decoded = along_x([1.0625, 1.25, 0.125, 0.03125])
    found = violations(original, decoded, 0.1, 0.05)
    assert found == (1, 0.25, pytest.approx(2.5))
    assert violations(original, original, 0.0) == (0, 0.0, 0.0)
    assert violations(original[:0], decoded[:0], 0.1) == (0, 0.0, 0.0)


def test_an_error_with_a_zero_mask_has_an_infinite_ratio():
    original, decoded = along_x([0.0, 1.0]), along_x([1e-6, 1.0])
    assert violations(original, decoded, 0.1) == (1, 0.5, None)
    assert violations(original, decoded, 0.1, 1e-5).count == 0


@pytest.mark.parametrize("index", [0, -1])
def test_a_violation_in_the_first_or_last_chunk_is_found(index):
    original = along_x(np.ones(200_000))
    decoded = original.copy()
    decoded[index, 1] = 0.5
    assert violations(original, decoded, 0.1) == (1, 1 / 200_000, pytest.approx(5.0))
    original[index] = 0.0
    assert violations(original, decoded, 0.1) == (1, 1 / 200_000, None)


@pytest.mark.parametrize(("k", "f0"), [(-0.1, 0.0), (np.nan, 0.0), (0.1, -1.0), (0.1, np.inf)])
def test_the_mask_refuses_invalid_thresholds(k, f0):
    with pytest.raises(InvalidArgument):
        mask_n([1.0], k, f0)


def test_violations_refuse_other_shapes_and_nan():
    with pytest.raises(InvalidArgument, match=r"\[L, 3\]"):
        violations(along_x([1.0]), along_x([1.0, 2.0]), 0.1)
    with pytest.raises(InvalidArgument, match="finite"):
        violations(along_x([1.0]), along_x([np.nan]), 0.1)


# -- eq. 6 -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.25, 0.1, 0.05])
def test_eq_6_with_a_step_of_k_x_is_the_identity(k):
    assert jnd_gain(k) == pytest.approx(1, abs=1e-15)


def test_eq_6_with_a_step_of_k_x_is_a_gain_and_no_quantiser():
    assert jnd_gain(0.3) == pytest.approx(0.9)  # 0.3 floor(3.83)
    assert jnd_gain(0.4) == pytest.approx(1.2)  # 0.4 floor(3)


def test_a_fixed_step_keeps_the_mask_only_above_its_limit():
    step, k = 0.02, 0.1
    x = np.linspace(-3, 3, 100_001)
    error = np.abs(quantise_fixed_step(x, step) - x)
    assert error.max() <= step / 2 * (1 + 1e-12)
    is_violated = error > k * np.abs(x) * (1 + 1e-12)
    limit = within_mask_from_n(step, k)
    assert limit == pytest.approx(0.1)
    assert is_violated.any() and not is_violated[np.abs(x) >= limit].any()
    zero_bin = (np.abs(x) < step / 2) & (x != 0)
    assert is_violated[zero_bin].all()
    assert quantise_fixed_step(-0.011, step) == pytest.approx(
        -0.02
    )  # rounds half away from zero, keeps the sign


# -- the Weber ladder --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("k", "steps"), [(0.05, 47), (0.07, 34), (0.1, 24), (0.15, 16), (0.25, 10)])
def test_the_ladder_over_0_03_to_3_3_newtons_has_the_fewest_steps(k, steps):
    ladder = WeberLadder.spanning(k, 0.03, 3.3)
    assert ladder.steps == steps
    assert ladder.force_max_n >= 3.3 > WeberLadder(k, 0.03, steps - 1).force_max_n


def test_neighbouring_levels_within_the_mask_take_about_twice_the_steps():
    ladder = WeberLadder.spanning(0.1, 0.03, 3.3, "neighbours")
    assert ladder.steps == 50
    assert (np.diff(ladder.levels_n[1:]) <= 0.1 * ladder.levels_n[1:-1] * (1 + 1e-6)).all()


@pytest.mark.parametrize("criterion", ["error", "neighbours"])
@pytest.mark.parametrize("k", [0.01, 0.1, 0.25, 0.9])
def test_levels_lie_midway_between_thresholds_of_a_constant_ratio(k, criterion):
    ladder = WeberLadder(k, 0.03, 20, criterion)
    levels = ladder.levels_n.astype(float)
    np.testing.assert_allclose((levels[1:-1] + levels[2:]) / 2, ladder.thresholds_n[1:], rtol=2e-7)
    np.testing.assert_allclose(ladder.thresholds_n[1:] / ladder.thresholds_n[:-1], ladder.ratio, rtol=1e-14)
    if criterion == "error":
        assert ladder.ratio == pytest.approx((1 + k) / (1 - k), rel=1e-4)
    else:
        assert ladder.ratio == pytest.approx(1 + k, rel=1e-5)


def test_geometric_midpoints_would_break_the_mask():
    ladder = WeberLadder.spanning(0.1, 0.03, 3.3)
    levels = ladder.levels_n[1:].astype(float)
    at = np.sqrt(levels[1:] * levels[:-1])
    assert ((levels[1:] - at) / at).max() == pytest.approx(0.1055, abs=1e-4)


@pytest.mark.parametrize(
    "arguments",
    [(0.0, 0.03, 3), (1.0, 0.03, 3), (np.nan, 0.03, 3), (0.1, 0.0, 3), (0.1, 0.03, 0), (0.1, 0.03, 65536)],
)
def test_a_ladder_out_of_range_is_refused(arguments):
    with pytest.raises(InvalidArgument):
        WeberLadder(*arguments)


def test_an_endless_ladder_is_refused():
    with pytest.raises(InvalidArgument, match="1e30"):
        WeberLadder(0.9, 1.0, 1000)
    with pytest.raises(InvalidArgument, match="65535"):
        WeberLadder.spanning(1e-5, 1e-6, 1.0)
    with pytest.raises(InvalidArgument, match="force_max_n"):
        WeberLadder.spanning(0.1, 0.03, np.inf)
    with pytest.raises(InvalidArgument, match="criterion"):
        WeberLadder(0.1, 0.03, 3, "other")
    assert WeberLadder(1e-4, 0.03, 65535).force_max_n < 1e30


# -- the deadband ------------------------------------------------------------------------------------------


def reference_gate(reading, vectors, k, decoded):
    """Eq. 8 in each of its variants, literally."""
    x, y = vectors.astype(np.float64), decoded.astype(np.float64)
    size = np.sqrt((x * x).sum(axis=1))
    sent, written, last = [], [], 0
    for i in range(len(x)):
        if i == 0:
            hold = False
        elif reading == "closed":
            limit = guaranteeing_fraction(k) ** 2 * (y[last] ** 2).sum()
            hold = ((x[i] - y[last]) ** 2).sum() <= limit
        else:
            a = {"previous": size[i - 1], "zero": written[i - 1], "last-sent": size[last]}[reading]
            hold = a - k * a < size[i] < a + k * a
        sent.append(not hold)
        written.append(0.0 if hold else size[i])
        last = last if hold else i
    return np.array(sent, bool)


@given(scans, fractions, st.sampled_from(READINGS))
def test_every_reading_equals_its_literal_definition(vectors, k, reading):
    decoded = (vectors * np.float32(1.015)).astype(np.float32)
    np.testing.assert_array_equal(
        gate(vectors, k, reading, decoded), reference_gate(reading, vectors, k, decoded)
    )


def test_a_slow_ramp_drifts_with_the_previous_sample():
    ramp = along_x(1.005 ** np.arange(1000.0) * 0.01)
    assert np.flatnonzero(gate(ramp, 0.01, "previous")).tolist() == [0]
    decoded = decoder_output(gate(ramp, 0.01, "previous"), ramp)
    assert relative_errors(ramp, decoded).max() > 0.99  # the drift is unbounded
    for reading in ("last-sent", "closed"):
        assert gate(ramp, 0.01, reading).sum() > 300


@given(scans, fractions)
def test_a_zeroed_sample_is_followed_by_a_sent_one(vectors, k):
    sent = gate(vectors, k, "zero")
    assert not (~sent[1:] & ~sent[:-1]).any()
    assert 2 * sent.sum() >= len(sent)


def test_fraction_that_guarantees_an_error_of_a_tenth():
    assert guaranteeing_fraction(0.1) == pytest.approx(0.1 / 1.1)
    rng = np.random.default_rng(5)
    steps = rng.normal(size=(200_000, 3)) * 0.004
    vectors = (np.cumsum(steps, axis=0) + np.array([1, 0, 0])).astype(np.float32)
    sent = gate(vectors, 0.1, "closed")
    assert 0.09 < relative_errors(vectors, decoder_output(sent, vectors)).max() <= 0.1 * (1 + 1e-6)
    assert sent.mean() < 0.05
    fading = along_x(np.exp(-1e-5 * np.arange(200_000)))  # the worst case: a steady decay
    assert (
        0.09998 < relative_errors(fading, decoder_output(gate(fading, 0.1), fading)).max() <= 0.1 * (1 + 1e-6)
    )
    # with the k of the text instead of k', the error of a held sample may reach k / (1 - k)
    amplitudes = along_x(np.linalg.norm(vectors.astype(float), axis=1))
    worst = relative_errors(amplitudes, decoder_output(gate(amplitudes, 0.1, "last-sent"), amplitudes)).max()
    assert 0.105 < worst <= 0.1 / 0.9 * (1 + 1e-6)


@given(scans, fractions, st.floats(-0.25, 0.25, width=32))
def test_repeated_samples_stay_within_the_mask_for_any_quantiser(vectors, k, gain):
    decoded = (vectors * np.float32(1 + gain)).astype(np.float32)
    sent = gate(vectors, k, "closed", decoded)
    output = decoder_output(sent, decoded)
    errors = np.linalg.norm(vectors.astype(float) - output, axis=1)
    limit = k * (1 + 1e-6) * np.linalg.norm(vectors.astype(float), axis=1)
    assert (errors <= limit)[~sent].all()
    np.testing.assert_array_equal(output[sent], decoded[sent])


@given(arrays(np.float32, (40, 3), elements=forces), arrays(np.float32, (40, 3), elements=forces), fractions)
def test_samples_repeated_in_time_stay_within_the_mask(vectors, reference, k):
    reference[::3] = vectors[::3] * np.float32(1 + k / 2)
    sent = gate_in_time(vectors, reference, k)
    unsent = vectors[~sent].astype(float)
    errors = np.linalg.norm(unsent - reference[~sent], axis=1)
    assert (errors <= k * (1 + 1e-6) * np.linalg.norm(unsent, axis=1)).all()
    assert not sent[::3][np.abs(reference[::3]).max(axis=1) > 1e-30].any()  # k/2 is well within k'


def test_in_time_only_zero_repeats_zero():
    vectors, reference = along_x([0.0, 1e-38, 1.0]), np.zeros((3, 3), np.float32)
    assert gate_in_time(vectors, reference, 0.1).tolist() == [False, True, True]


def test_only_the_vector_reading_detects_a_turn_at_constant_amplitude():
    angle = np.linspace(0, np.pi, 100)
    turn = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1).astype(np.float32)
    assert gate(turn, 0.1, "last-sent").sum() == 1
    assert gate(turn, 0.1, "closed").sum() > 30


def test_after_a_zero_only_the_closed_loop_repeats_it():
    zeros = along_x([1.0, 0.0, 0.0, 0.0])
    assert gate(zeros, 0.1, "closed").tolist() == [True, True, False, False]
    for reading in ("previous", "zero", "last-sent"):
        assert gate(zeros, 0.1, reading).all()


def test_k_of_zero_repeats_equal_samples_only():
    vectors = along_x([1.0, 1.0, np.nextafter(np.float32(1), np.float32(2))])
    assert gate(vectors, 0.0, "closed").tolist() == [True, False, True]


def test_the_deadband_refuses_invalid_arguments():
    vectors = along_x([1.0, 2.0])
    with pytest.raises(InvalidArgument, match="reading"):
        gate(vectors, 0.1, "other")
    for k in (-0.1, 1.0, np.nan):
        with pytest.raises(InvalidArgument, match="k"):
            gate(vectors, k)
    with pytest.raises(InvalidArgument, match="float32"):
        gate(vectors.astype(np.float64), 0.1)
    for other in (vectors[:1], along_x([1.0, 2.0, 3.0])):
        with pytest.raises(InvalidArgument, match="decoded"):
            gate(vectors, 0.1, "closed", other)
        with pytest.raises(InvalidArgument, match="reference"):
            gate_in_time(vectors, other, 0.1)
