"""Vibration beside force (section 6.4): crossover, DFT321, spectra, and the parts that must be sent."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from signal_makers import RATE_HZ, Float64s, db, noise
from touchfield.errors import InvalidArgument, TouchfieldError
from touchfield.perception.hand_motion import third_octave_power
from touchfield.perception.human import THIRDS_HZ, vibration_threshold
from touchfield.perception.vibrotactile import (
    BANDS_HZ,
    Crossover,
    Stft,
    band_rms,
    dft321,
    handle_force_n,
    reduce_vibration,
)
from touchfield.sources.recordings.recording import Recording
from touchfield.tasks.texture import texture_of

# -- crossover ----------------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 700), st.floats(5, 400), st.floats(1000, 8000))
def test_the_parts_of_a_crossover_add_up_to_the_signal(seed: int, n: int, cutoff: float, rate: float) -> None:
    crossover = Crossover(rate, cutoff)
    signal = 10 * noise(n, 3, seed=seed).cumsum(axis=0)
    low, high = crossover.split(signal)
    assert np.abs(low + high - signal).max() <= 1e-12 * np.abs(signal).max()


def test_a_crossover_is_of_linear_phase_without_delay_and_6_db_down() -> None:
    crossover = Crossover(2000.0)
    assert crossover.cutoff_hz == 30.0  # of perception/human.toml
    h = crossover.low_taps
    np.testing.assert_array_equal(h, h[::-1])
    impulse = np.zeros(len(h))
    impulse[len(h) // 2] = 1
    tall = np.zeros(4 * len(h))
    tall[2 * len(h)] = 1
    np.testing.assert_allclose(
        crossover.split(tall)[1][2 * len(h) - len(h) // 2 :][: len(h)], impulse - h, atol=1e-12
    )
    f = np.array([0.0, 10.0, 30.0, 60.0, 500.0])
    gains = [abs((taps * np.exp(-2j * np.pi * f[:, None] * np.arange(len(h)) / 2000)).sum(1)) for taps in
             (h, impulse - h)]  # fmt: skip
    np.testing.assert_allclose(gains[0][[0, 2]], [1, 0.5], atol=0.01)
    np.testing.assert_allclose(gains[1][[2, 4]], [0.5, 1], atol=0.01)
    assert gains[0][3:].max() < 0.01 and gains[1][:2].max() < 0.02
    t = np.arange(8000) / 2000
    slow, fast = np.sin(2 * np.pi * 4 * t), 0.1 * np.sin(2 * np.pi * 200 * t)
    low, high = crossover.split(slow + fast)
    inner = slice(400, -400)
    assert np.abs(low - slow)[inner].max() < 0.003 and np.abs(high - fast)[inner].max() < 0.003
    short = noise(300).cumsum()
    longer = crossover.split(np.pad(short, 400, "edge"))[0]
    np.testing.assert_allclose(crossover.split(short)[0], longer[400:-400], atol=1e-12)


# -- DFT321 and spectra ------------------------------------------------------------------------------------


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 600))
def test_dft321_keeps_the_energy_of_each_bin(seed: int, n: int) -> None:
    signal = noise(n, 3, seed=seed)
    combined = dft321(signal)
    assert combined.shape == (n,)
    expected = (np.abs(np.fft.rfft(signal, axis=0)) ** 2).sum(axis=1)
    np.testing.assert_allclose(
        np.abs(np.fft.rfft(combined)) ** 2, expected, rtol=1e-12, atol=1e-12 * expected.max()
    )


def test_dft321_takes_the_phase_of_the_sum_and_survives_axes_that_cancel() -> None:
    signal = noise(512, 3)
    phase = np.angle(np.fft.rfft(dft321(signal))[1:-1] / np.fft.rfft(signal.sum(axis=1))[1:-1])
    assert np.abs(phase).max() < 1e-9
    alone = np.zeros((512, 3))
    alone[:, 1] = signal[:, 1]
    np.testing.assert_allclose(dft321(alone), alone[:, 1], atol=1e-12)
    against = signal[:, :1] * [1, -1, 0]
    assert np.linalg.norm(dft321(against)) == pytest.approx(np.linalg.norm(against), rel=1e-12)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 900), st.sampled_from([4, 16, 64, 128, 500]))
def test_spectra_give_the_signal_back_and_keep_its_energy(seed: int, n: int, length: int) -> None:
    stft, signal = Stft(length), noise(n, seed=seed)
    spectra = stft.spectra(signal)
    twice = np.r_[1, np.full(length // 2 - 1, 2), 1]
    assert (twice * np.abs(spectra) ** 2).sum() == pytest.approx((signal**2).sum(), rel=1e-12)
    real = stft.real_spectra(signal)
    assert real.size <= n + 3 * length and (real**2).sum() == pytest.approx((signal**2).sum(), rel=1e-12)
    np.testing.assert_allclose(stft.signal_from(real, n), signal, atol=1e-12)
    assert db(np.linalg.norm(signal) / max(np.linalg.norm(stft.signal_from(real, n) - signal), 1e-300)) > 100
    assert np.abs(stft.window**2 + np.roll(stft.window**2, length // 2) - 1).max() < 1e-14


def test_a_level_counts_its_band_alone() -> None:
    t = np.arange(5000) / RATE_HZ
    levels = band_rms(0.3 * np.sin(2 * np.pi * BANDS_HZ[8] * t), RATE_HZ)
    assert levels[8] == pytest.approx(0.3 / np.sqrt(2), rel=1e-3) and np.delete(levels, 8).max() < 1e-3
    white = np.mean([band_rms(noise(100_000, seed=s), RATE_HZ) ** 2 for s in range(4)], axis=0)
    fraction = np.array(BANDS_HZ) * (10**0.05 - 10**-0.05) / (RATE_HZ / 2)
    assert np.abs(10 * np.log10(white / fraction)).max() < 0.6
    assert band_rms(noise(2000), 1000.0)[12:].max() == 0  # 501 Hz and above do not fit into 1 kHz
    at_once = band_rms(
        np.cos(np.pi * np.arange(4500)), 2000 * 10**0.05
    )  # the last band ends at half the sampling rate
    assert at_once[15] == pytest.approx(1.0, rel=1e-3) and at_once[:15].max() < 1e-3
    assert not band_rms(np.zeros(1000), 2000.0).any()  # half a second is enough


def test_a_handle_moves_with_the_recorded_force() -> None:
    hand, w = vibration_threshold(), 2 * np.pi * 200
    t = np.arange(4000) / 2000
    force = handle_force_n(7 * np.cos(w * t), 2000.0)
    kg = hand.mass_kg + hand.damping_n_s_per_m / (1j * w) - hand.stiffness_n_per_m / w**2
    np.testing.assert_allclose(force, (7 * kg * np.exp(1j * w * t)).real, atol=1e-9)
    slow, audible = (np.abs(handle_force_n(np.cos(2 * np.pi * hz * t), 2000.0)).max() for hz in (28.0, 28.5))
    assert slow < 1e-9 < audible  # the lowest band begins at 28.2 Hz


# -- what must be sent -------------------------------------------------------------------------------------


def worst_margin_db(error: Float64s, rate_hz: float) -> float:
    """By an independent measure of thirds, over windows of half a second."""
    step = int(rate_hz / 4)
    rows = [
        third_octave_power(np.stack([error[a : a + 2 * step], *np.zeros((2, 2 * step))], axis=1), rate_hz)
        for a in range(0, len(error) - 2 * step + 1, step)
    ]
    limit = vibration_threshold().force_rms_mn()
    with np.errstate(divide="ignore"):
        return float(np.min(db(limit / (1e3 * np.sqrt(np.max(rows, axis=0))))))


@pytest.mark.parametrize("kind", ["white", "tap", "tone", "speech"])
@pytest.mark.parametrize("newtons", [0.001, 0.02, 1.0])
def test_losses_stay_below_the_threshold_in_every_third(kind: str, newtons: float) -> None:
    t = np.arange(6000) / 2000
    signal = (
        newtons
        * {
            "white": noise(6000),
            "tap": np.exp(-((t - 1.3) % 1.0) * 60) * np.sin(2 * np.pi * 180 * t),
            "tone": np.sin(2 * np.pi * 97 * t),
            "speech": noise(6000) * np.maximum(0, np.sin(2 * np.pi * 2 * t)) ** 4,
        }[kind]
    )
    sent = reduce_vibration(signal, 2000.0)
    error = signal - sent.decoded()
    assert worst_margin_db(error, 2000.0) > 2.0  # 3 dB requested; windows of another shape
    assert 0 < sent.bits < 16 * len(signal)
    if newtons == 1.0:
        assert sent.symbols.any() and np.abs(error).max() > 0


@pytest.mark.parametrize("margin_db", [0.0, 3.0, 6.0, 12.0])
@pytest.mark.parametrize("kind", ["white", "tone"])
def test_losses_are_below_the_threshold_by_the_requested_margin(kind: str, margin_db: float) -> None:
    signal = 0.1 * (noise(6000) if kind == "white" else np.sin(2 * np.pi * 97 * np.arange(6000) / 2000))
    sent = reduce_vibration(signal, 2000.0, margin_db=margin_db)
    assert (
        -1.0 < worst_margin_db(signal - sent.decoded(), 2000.0) - margin_db < 1.5
    )  # windows of another shape
    if margin_db == 3.0:  # the default
        np.testing.assert_array_equal(reduce_vibration(signal, 2000.0).symbols, sent.symbols)


def test_vibration_below_the_threshold_is_not_sent_and_a_margin_costs_bits() -> None:
    assert not reduce_vibration(1e-5 * noise(4000), 2000.0).symbols.any()
    costs = [reduce_vibration(0.1 * noise(4000), 2000.0, margin_db=m).bits for m in (0.0, 3.0, 12.0)]
    assert costs == sorted(costs) and costs[2] > 1.2 * costs[0]
    tone = 0.05 * np.sin(2 * np.pi * 200 * np.arange(8000) / 2000)
    assert reduce_vibration(tone, 2000.0).bits_per_s < 0.05 * 16 * 2000
    probe = reduce_vibration(0.1 * noise(4000), 2000.0, vibration_threshold("probe"))
    assert probe.bits < costs[1]  # a less sensitive skin


def test_bits_are_those_of_an_adaptive_code() -> None:
    sent = reduce_vibration(0.05 * noise(4000), 2000.0)
    edges = 1000 * 10 ** (0.1 * (np.arange(-15, 1) - 0.5))
    band = np.searchsorted(edges, (np.arange(sent.length // 2) + 0.5) * 2000 / sent.length, side="right")
    total = 16.0 * len(sent.exponents)
    for b in np.flatnonzero(sent.exponents > -32768):
        values = sent.symbols[:, band == b].ravel()
        if not len(values):  # a band may have no bin in so short a frame
            continue
        counts: dict[int, int] = {}
        wide = int(values.max() - values.min()) + 1
        total += 32
        for n, value in enumerate(values.tolist()):  # symbol by symbol, as in a coder
            total -= np.log2((counts.get(value, 0) + 0.5) / (n + wide / 2))
            counts[value] = counts.get(value, 0) + 1
    assert sent.bits == pytest.approx(total, rel=1e-9)


# -- bad input ---------------------------------------------------------------------------------------------

NAN = np.full((8, 3), np.nan)

CALLS = {
    "crossover rate": (lambda: Crossover(0.0), "rate_hz: found 0.0"),
    "crossover cutoff": (
        lambda: Crossover(100.0, 50.0),
        "cutoff_hz: found 50 Hz; expected below half of 100 Hz",
    ),
    "crossover long": (lambda: Crossover(1e9, 1.0), "expected a higher one"),
    "split nan": (lambda: Crossover(1000.0).split(NAN), "signal: found nan at sample 0"),
    "split shape": (lambda: Crossover(1000.0).split(np.zeros((3, 4))), r"expected \[n\] or \[n, 3\]"),
    "split empty": (lambda: Crossover(1000.0).split(np.zeros((0, 3))), r"shape \(0, 3\)"),
    "dft321 shape": (lambda: dft321(np.zeros(5)), r"shape \(5,\); expected \[n, 3\]"),
    "dft321 nan": (lambda: dft321(NAN), "found nan"),
    "dft321 words": (lambda: dft321([["a"] * 3]), "no array of numbers"),  # type: ignore[list-item]
    "stft without samples": (lambda: Stft(0), "length: found 0"),
    "stft length": (lambda: Stft(6), "length: found 6; expected samples, a multiple of 4"),
    "reduced shape": (lambda: reduce_vibration(np.zeros((9, 3)), 2000.0), "dft321 makes one axis of three"),
    "reduced nan": (lambda: reduce_vibration(NAN[:, 0], 2000.0), "vibration_n: found nan"),
    "reduced rate": (lambda: reduce_vibration(np.zeros(9), 50.0), "100 Hz or more"),
    "reduced margin": (lambda: reduce_vibration(np.zeros(9), 500.0, margin_db=-1.0), "margin_db: found -1.0"),
    "reduced unit": (lambda: reduce_vibration(1e12 * noise(900), 2000.0), "Check its unit"),
    "levels short": (lambda: band_rms(np.zeros(9), 2000.0), "Record longer"),
    "recording": (lambda: Recording(1000.0, NAN), "acceleration_m_s2: found nan at sample 0"),
    "no recording": (lambda: texture_of([], [], []), "0 recordings"),
}


@pytest.mark.parametrize("name", CALLS)
def test_invalid_signals_are_refused_in_one_line(name: str) -> None:
    call, message = CALLS[name]
    with pytest.raises(InvalidArgument, match=message) as caught:
        call()
    assert "\n" not in str(caught.value) and "expected" in str(caught.value)
    assert isinstance(caught.value, TouchfieldError)


@pytest.mark.parametrize("n", [1, 2, 15, 16, 17, 129])
def test_short_signals_are_accepted(n: int) -> None:
    signal = noise(n)
    assert reduce_vibration(signal, 500.0).decoded().shape == (n,)
    assert len(THIRDS_HZ) == 11 and set(np.round(THIRDS_HZ, 6)) <= set(np.round(BANDS_HZ, 6))
