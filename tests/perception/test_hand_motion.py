"""A sliding hand: sines within the band, walks along a ball, and errors of known vibration."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.perception import hand_motion
from touchfield.perception.hand_motion import (
    MARGIN_S,
    BandSums,
    HandMotion,
    Hold,
    Slide,
    SlideMeter,
    SlideSpec,
    SurfaceWalks,
    in_band,
    level_of,
    margin_of,
    points_on_surface,
    slide_m,
    slides,
    surface_walks,
    third_octave_power,
)
from touchfield.perception.human import THIRDS_HZ, vibration_threshold, vibration_thresholds

RATE_HZ = 1000.0
RADIUS_M, STIFFNESS = 0.02, 500.0
GRID = Grid((64, 64, 64), (0.001,) * 3, (-0.0315,) * 3)
QUICK = SlideSpec(paths=4, duration_s=0.25)


def sine(frequency_hz, seconds=0.7, rate_hz=RATE_HZ):
    """0.01 N along x and y each, out of phase."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    turn = 2 * np.pi * frequency_hz * t
    return 0.01 * np.stack([np.sin(turn), np.cos(turn), 0 * t], axis=1)


def ball(error=None):
    """A ball of 20 mm, 500 N/m; `error(points_m) -> newtons` is added within it."""
    points = GRID.to_m(np.moveaxis(np.indices(GRID.shape), 0, -1))
    r = np.linalg.norm(points, axis=-1, keepdims=True)
    forces = STIFFNESS * np.maximum(RADIUS_M - r, 0) * points / np.maximum(r, 1e-9)
    if error is not None:
        forces = forces + np.where(r < RADIUS_M, error(points), 0)
    return ForceField.from_dense(GRID, forces)


def rms(signal):
    return np.sqrt((signal**2).sum(axis=1).mean())


def test_a_batch_of_signals_counts_as_single_ones():
    signals = np.random.default_rng(1).normal(0, 0.01, (700, 3, 3))
    together, separate = BandSums(1), BandSums(1)
    together.add(0, signals, RATE_HZ, 700)
    for n in (2, 0, 1):  # the signal with the greatest peak first
        separate.add(0, signals[:, n : n + 1], RATE_HZ, 700)
    assert together.samples == separate.samples == [3 * (700 - 2 * round(MARGIN_S * RATE_HZ))]
    assert together.mn(0) == pytest.approx(separate.mn(0))
    np.testing.assert_allclose(together.thirds_mn(), separate.thirds_mn())


def test_slides_are_independent_of_the_batch_size(monkeypatch):
    """The figures of all paths are the same if each is filtered on its own."""
    batched = slides(ball(), ball(lambda p: 0.01 * np.sin(1500 * p)), QUICK)
    monkeypatch.setattr(hand_motion, "_AT_ONCE", 1)
    for expected, actual in zip(
        batched, slides(ball(), ball(lambda p: 0.01 * np.sin(1500 * p)), QUICK), strict=True
    ):
        assert expected.paths == actual.paths == QUICK.paths
        assert expected.error_mn == pytest.approx(actual.error_mn)


@pytest.mark.parametrize("frequency_hz", [63.1, 100.0, 250.0])
def test_a_sine_within_the_band_passes_and_lies_in_its_third(frequency_hz):
    signal = sine(frequency_hz)
    assert rms(in_band(signal, RATE_HZ)) == pytest.approx(0.01, rel=0.03)
    power = third_octave_power(signal, RATE_HZ)
    assert np.argmax(power) == np.argmin(np.abs(np.log(np.divide(THIRDS_HZ, frequency_hz))))
    assert np.sqrt(power.max()) == pytest.approx(0.01, rel=0.02)
    assert np.sqrt(power.sum()) == pytest.approx(0.01, rel=0.02)


@pytest.mark.parametrize("frequency_hz", [1.0, 5.0, 10.0])
def test_slow_signals_are_rejected_up_to_both_ends(frequency_hz):
    signal = 100 * sine(frequency_hz) + np.linspace(0, 3, 700)[:, None]  # newtons, as of a pressing hand
    assert np.abs(in_band(signal, RATE_HZ)).max() < 2e-4
    assert np.sqrt(third_octave_power(signal, RATE_HZ)).max() < 2e-4


def test_in_band_omits_the_margins_and_preserves_the_phase():
    signal = sine(100.0)
    filtered = in_band(signal, RATE_HZ)
    margin = round(MARGIN_S * RATE_HZ)
    assert len(filtered) == len(signal) - 2 * margin
    np.testing.assert_allclose(filtered, signal[margin:-margin], atol=5e-4)


def test_a_signal_too_short_or_too_slow_is_refused():
    with pytest.raises(InvalidArgument, match="signal"):
        in_band(sine(100.0, 0.4), RATE_HZ)
    with pytest.raises(InvalidArgument, match="rate_hz"):
        third_octave_power(sine(100.0), 500.0)


def test_thresholds_follow_the_points_and_the_model():
    stylus = vibration_threshold()
    np.testing.assert_allclose(stylus.displacement_peak_um([10, 20, 320]), [26.0, 8.5, 0.06])
    per_octave_db = 20 * np.log10(stylus.displacement_peak_um(10) / stylus.displacement_peak_um(160)) / 4
    assert per_octave_db == pytest.approx(13, abs=0.1)  # as in the source
    w = 2 * np.pi * 20
    n_per_m = abs(500 - 0.055 * w**2 + 4j * w)
    assert stylus.force_rms_mn(20.0) == pytest.approx(1e3 * 8.5e-6 / np.sqrt(2) * n_per_m)
    for profile in vibration_thresholds().values():
        assert (
            len(profile.frequency_hz) == len(profile.displacement_um)
            and profile.source
            and profile.conditions
        )
    with pytest.raises(InvalidArgument, match="stylus"):
        vibration_threshold("elbow")


def test_margin_names_the_worst_third():
    levels = vibration_threshold().force_rms_mn() / 10
    levels[4] *= 5
    assert (
        margin_of(levels).db == pytest.approx(20 * np.log10(2)) and margin_of(levels).third_hz == THIRDS_HZ[4]
    )
    assert margin_of(np.zeros(11)).db == np.inf
    summary = HandMotion(
        (Slide(50.0, 1, 1.0, 1, 1, 1, 1, None, levels),), None, vibration_threshold()
    ).summary()
    assert summary["threshold_margin_third_hz"] == THIRDS_HZ[4]


def test_points_and_walks_lie_on_the_surface_of_one_newton():
    field = ball()
    points = points_on_surface(field, 20, np.random.default_rng(1))
    assert len(points) == 20 and level_of(field) == 1.0
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), RADIUS_M - 1 / STIFFNESS, atol=1e-4)
    walks = surface_walks(field, 0.06, 5, np.random.default_rng(1))
    assert (walks.steps == 61).all()
    np.testing.assert_allclose(np.linalg.norm(walks.points_m, axis=-1), RADIUS_M - 1 / STIFFNESS, atol=1e-4)
    (paths,) = slide_m(walks, 0.1, 0.55, RATE_HZ)
    assert paths.shape == (550, 5, 3)
    speed = RATE_HZ * np.linalg.norm(np.diff(paths, axis=0), axis=2)
    np.testing.assert_allclose(speed, 0.1, rtol=0.05)


def test_paths_of_equal_length_are_batched():
    ways = np.eye(3)
    points = np.arange(101)[:, None, None] * 0.001 * ways
    points[41:, 0] = points[40, 0]  # the first path stops early and stays there
    walks = SurfaceWalks(points, np.array([41, 101, 101]), 0.001)
    short, long = slide_m(walks, 0.1, 5.0, RATE_HZ)
    for paths, directions in ((short, ways[:1]), (long, ways[1:])):
        at = 0.1 * np.arange(len(paths))[:, None, None] / RATE_HZ
        np.testing.assert_allclose(paths, at * directions, atol=1e-12)
    assert (len(short), len(long)) == (400, 1000)
    fewest = SurfaceWalks(points, np.array([15, 16, 15]), 0.001)  # one of them has four knots
    assert [paths.shape[1] for paths in slide_m(fewest, 0.1, 5.0, RATE_HZ)] == [1]


def test_half_of_the_largest_force_is_the_level_of_a_weak_field():
    largest = np.linalg.norm(ball().scaled(0.1).forces_n, axis=-1).max()
    assert level_of(ball().scaled(0.1)) == pytest.approx(largest / 2)


def test_a_grating_is_heard_at_the_speed_over_its_wavelength():
    wavelength_m, size_n = 0.0016, 0.02
    turn = 2 * np.pi / wavelength_m
    found = slides(ball(), ball(lambda p: size_n * np.sin(turn * p[..., :1]) * [0, 0, 1.0]), QUICK)
    slow, _, fast = found
    assert [s.paths for s in found] == [4, 4, 4]
    # at most v / wavelength, on a path along x, and mostly near it
    assert THIRDS_HZ[int(np.argmax(fast.error_thirds_mn))] <= 200 / 1.6 * 10**0.05
    assert fast.error_thirds_mn[7:].max() < 0.2 * fast.error_thirds_mn.max()
    assert 0 < fast.error_mn < 1e3 * size_n
    assert slow.error_thirds_mn[0] < fast.error_thirds_mn.max()


def test_the_same_field_has_no_error_and_a_constant_one_no_vibration():
    same = slides(ball(), ball(), QUICK)
    assert all(s.error_mn == 0 and s.source_mn > 0 for s in same)
    shifted = slides(ball(), ball(lambda p: np.broadcast_to([0.0, 0.0, 0.05], p.shape)), QUICK)
    assert all(s.error_mn < 0.1 for s in shifted)


def test_the_lattice_error_is_reported_for_a_known_field():
    def exact(points):
        r = np.linalg.norm(points, axis=1, keepdims=True)
        return STIFFNESS * np.maximum(RADIUS_M - r, 0) * points / r

    with_exact = slides(ball(), ball(), QUICK, exact)
    assert all(0 < s.lattice_mn < 5 and not s.error_thirds_mn.any() for s in with_exact)
    assert all(s.lattice_mn is None for s in slides(ball(), ball(), QUICK))
    itself = slides(ball(), ball(), QUICK, lambda points: ball().sample_n(points).astype(float))
    assert all(s.lattice_mn == 0 for s in itself)


def test_the_same_seed_gives_the_same_figures_and_frames_add_up():
    single = slides(ball(), ball().scaled(1.01), QUICK)
    again = slides(ball(), ball().scaled(1.01), QUICK)
    np.testing.assert_array_equal(single[0].error_thirds_mn, again[0].error_thirds_mn)
    meter = SlideMeter(QUICK)
    for _ in range(2):
        meter.add(ball(), ball().sample_n, ball().scaled(1.01).sample_n)
    assert [s.paths for s in meter.slides()] == [8, 8, 8]
    twice = slides(ball(), ball().scaled(1.01), replace(QUICK, rate_hz=2000.0))
    for slide in (*single, *twice):  # from knot to knot, less 0.2 s of margins
        assert slide.seconds == pytest.approx(4 * 0.3)


def test_an_empty_field_gives_no_measurement():
    empty = ForceField.empty(GRID)
    assert [s.paths for s in slides(empty, empty, QUICK)] == [0, 0, 0]
    single = ForceField.from_support(GRID, [[9, 9, 9]], [[0.0, 0.0, 1e-30]])
    assert [s.paths for s in slides(single, empty, QUICK)] == [0, 0, 0]
    assert (
        HandMotion(slides(empty, empty, QUICK), None, vibration_threshold()).summary()["hand_vibration_mn"]
        is None
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"paths": 0},
        {"duration_s": 0.1},
        {"rate_hz": 500.0},
        {"paths": 1025},
        {"duration_s": 61.0},
        {"rate_hz": 1.1e5},
    ],
)
def test_a_wrong_spec_is_refused(wrong):
    assert SlideSpec(1024, 60.0, 1e5) and SlideSpec(1, 0.25, 1000.0)
    with pytest.raises(InvalidArgument, match=next(iter(wrong))):
        SlideSpec(**wrong)


@settings(max_examples=25)
@given(
    st.tuples(st.integers(1, 12), st.integers(1, 12), st.integers(1, 40)),
    st.integers(0, 99),
    st.sampled_from([1e-38, 1e-3, 1.0, 1e6]),
    st.sampled_from([0.02, 0.5, 1.0]),
)
def test_any_field_can_be_measured(shape, seed, size_n, density):
    rng = np.random.default_rng(seed)
    grid = Grid(shape, (0.001, 0.002, 0.0015), (0.0, 0.1, -0.2))
    forces = size_n * rng.normal(size=(*shape, 3)) * (rng.random((*shape, 1)) < density)
    field = ForceField.from_dense(grid, forces)
    found = slides(field, field.scaled(0.95), QUICK)
    assert len(found) == len(slides(field, field, QUICK))
    for slide in found:
        assert np.isfinite([slide.error_mn, slide.error_peak_mn, slide.source_mn]).all()
        assert slide.error_mn == pytest.approx(0.05 * slide.source_mn, rel=1e-3)
        assert 0 <= slide.paths <= QUICK.paths


def test_rms_and_peak_of_each_kind_are_those_of_its_lengths():
    rng = np.random.default_rng(6)
    signals = [scale * rng.normal(0, 1, (700, 2, 3)) for scale in (0.01, 0.03)]
    sums = BandSums(3)
    for kind, signal in enumerate(signals):
        sums.add(kind, signal, RATE_HZ)
        lengths_mn = 1e3 * np.linalg.norm(in_band(signal, RATE_HZ), axis=2)
        assert sums.mn(kind) == pytest.approx((np.sqrt((lengths_mn**2).mean()), lengths_mn.max()))
    assert sums.mn(2) == (0, 0) and not sums.thirds_mn().any()
    assert sums.samples.tolist() == [1000, 1000, 0]


def test_peaks_are_of_the_same_signals_as_the_rms():
    for slide in slides(ball(), ball().scaled(0.95), QUICK):
        assert slide.error_mn == pytest.approx(0.05 * slide.source_mn, rel=1e-3)
        assert slide.error_peak_mn == pytest.approx(0.05 * slide.source_peak_mn, rel=1e-3)
        assert slide.source_peak_mn > 1.5 * slide.source_mn


def test_seed_and_duration_change_the_paths():
    noisy = ball(lambda p: 0.02 * np.sin(1500 * p))
    first, second = (slides(ball(), noisy, replace(QUICK, seed=seed)) for seed in (0, 1))
    assert all(a.error_mn != b.error_mn for a, b in zip(first, second, strict=True))
    longer = slides(ball(), noisy, replace(QUICK, duration_s=0.6, paths=3))
    assert [(s.paths, s.seconds) for s in longer] == [(3, pytest.approx(3 * 0.65, rel=5e-3))] * 3
    assert [s.speed_mm_s for s in longer] == [50.0, 100.0, 200.0]


def hand_of(hold_mn, slide_mn, paths=(2, 2)):
    """Slides at two speeds and a hold of given rms; each third octave has its own margin."""
    limit = vibration_threshold().force_rms_mn()

    def thirds(level_mn, at):
        return np.where(np.arange(11) == at, limit * level_mn / 100, limit / 1e6)

    moved = tuple(
        Slide(speed, n, 1.0, mn, 2 * mn, 3 * mn, 4 * mn, 5 * mn, thirds(mn, at))
        for speed, n, mn, at in zip((50.0, 100.0), paths, slide_mn, (2, 3))
    )
    band = (None, None, None) if hold_mn is None else (hold_mn, 2 * hold_mn, 3 * hold_mn)
    hold = Hold(8, 80, *(0.0,) * 8, *band, thirds(hold_mn or 0.0, 7))
    return HandMotion(moved, hold, vibration_threshold())


@pytest.mark.parametrize(
    ("hold_mn", "slide_mn", "paths", "loudest_mn", "third"),
    [
        (1.0, (2.0, 3.0), (2, 2), 3.0, 3),
        (1.0, (4.0, 3.0), (2, 2), 4.0, 2),
        (5.0, (4.0, 3.0), (2, 2), 5.0, 7),
        (1.0, (2.0, 3.0), (2, 0), 2.0, 2),  # a speed without paths is not the loudest
        (None, (2.0, 3.0), (2, 2), 3.0, 3),
        (5.0, (2.0, 3.0), (0, 0), 5.0, 7),
    ],
)
def test_summary_states_the_loudest_of_slides_and_hold(hold_mn, slide_mn, paths, loudest_mn, third):
    hand = hand_of(hold_mn, slide_mn, paths)
    summary = hand.summary()
    assert summary["hand_vibration_mn"] == loudest_mn
    assert summary["hand_vibration_peak_mn"] == 2 * loudest_mn
    assert summary["hand_vibration_source_mn"] == 3 * loudest_mn
    is_slide = isinstance(hand.loudest, Slide)
    assert summary["hand_vibration_lattice_mn"] == (5 * loudest_mn if is_slide else None)
    assert summary["threshold_margin_db"] == pytest.approx(20 * np.log10(100 / loudest_mn))
    assert summary["threshold_margin_third_hz"] == THIRDS_HZ[third]
    assert len(summary["slides"]) == 2 and summary["hold"]["error_mn"] == hold_mn


def test_summary_of_no_measurement_has_no_figures():
    hand = hand_of(None, (2.0, 3.0), (0, 0))
    summary = hand.summary()
    assert hand.measured == [] and hand.loudest is None
    assert {summary[f"hand_vibration{end}_mn"] for end in ("", "_peak", "_source", "_lattice")} == {None}
    assert summary["threshold_margin_db"] is summary["threshold_margin_third_hz"] is None
