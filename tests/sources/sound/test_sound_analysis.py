"""Onsets and low frequencies of sounds whose content is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from soundtrack_makers import strokes
from touchfield.sources.sound.analysis import HOP_S, LOW_HZ, RATE_HZ, SoundFeatures, sound_features

TIMES_S = (0.5, 0.8123, 1.2501, 1.9007, 2.4)
SECONDS = 3.0


def features(samples: NDArray[np.float32]) -> SoundFeatures:
    return sound_features([samples])


def sine(frequency_hz: float, amplitude: float = 0.1, seconds: float = SECONDS) -> NDArray[np.float32]:
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return (amplitude * np.sin(2 * np.pi * frequency_hz * t)).astype(np.float32)


@pytest.mark.parametrize("gain", [1.0, 0.05])
def test_each_stroke_is_an_onset_at_its_time(gain: float) -> None:
    """Also at -26 dB: the rule has no absolute level but that of silence."""
    found = features(gain * strokes(TIMES_S, SECONDS, RATE_HZ)[0]).onsets
    assert np.array([onset.time_s for onset in found]) == pytest.approx(TIMES_S, abs=0.003)


def test_length_of_the_blocks_does_not_matter() -> None:
    """Blocks shorter than a hop and such that end within one."""
    samples = strokes(TIMES_S, SECONDS, RATE_HZ)[0] + sine(70)
    whole = features(samples)
    for size in (47, 1000, 24001):
        parts = sound_features(samples[n : n + size] for n in range(0, len(samples), size))
        assert np.array(parts.onsets) == pytest.approx(np.array(whole.onsets)) and len(whole.onsets) >= 4
        assert parts.levels == pytest.approx(whole.levels, rel=1e-5, abs=1e-9)
        assert (parts.low_hz == whole.low_hz).all()


def test_silence_and_nothing_have_no_onset() -> None:
    rng = np.random.default_rng(0)
    quiet = features((1e-5 * rng.normal(size=RATE_HZ)).astype(np.float32))
    assert quiet.onsets == () and quiet.silent_fraction == 1 and len(quiet.levels) == 200
    nothing = sound_features([])
    assert nothing.onsets == () and nothing.silent_fraction == 1 and nothing.duration_s == 0


def test_slow_swell_is_no_onset() -> None:
    rng = np.random.default_rng(0)
    swell = np.linspace(0, 1, 2 * RATE_HZ) ** 2 * rng.normal(size=2 * RATE_HZ)
    assert features((0.05 * swell).astype(np.float32)).onsets == ()


@pytest.mark.parametrize("frequency_hz", [40, 70, 140])
def test_low_tone_has_its_level_and_frequency(frequency_hz: float) -> None:
    found = features(sine(frequency_hz))
    steady = slice(round(0.5 / HOP_S), None)
    assert found.levels[steady] == pytest.approx(0.1, rel=0.15)
    assert np.median(found.low_hz[steady]) == pytest.approx(frequency_hz, rel=0.1)
    assert found.low_hz.min() >= LOW_HZ[0] and found.low_hz.max() <= LOW_HZ[1]


@pytest.mark.parametrize("frequency_hz", [5, 1500])
def test_tone_outside_the_band_is_no_low_frequency(frequency_hz: float) -> None:
    assert features(sine(frequency_hz)).levels[200:].max() < 0.01


def test_level_rises_at_once_and_decays() -> None:
    burst = sine(80)
    burst[RATE_HZ:] = 0
    burst[: RATE_HZ // 2] = 0
    levels = features(burst).levels
    assert levels[95] < 0.001 and levels[104] > 0.05
    end = levels[200]
    assert levels[210] < end and levels[240] < end * np.exp(-2.5)
