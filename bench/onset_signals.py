"""Sounds whose onsets are known: clicks, drums, plucked notes and impacts in speech-like noise, at the levels
of movies. They are made from random numbers, so that no recording is needed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from scipy.signal import butter, sosfilt

from touchfield.arrays import Float64s

RATE_HZ: Final = 48000


class Signal(NamedTuple):
    """A sound, float64 [samples] at `RATE_HZ`, full scale 1, and the seconds of its onsets, ascending."""

    samples: Float64s
    onsets_s: Float64s


def amplitude(decibels: float) -> float:
    return float(10 ** (decibels / 20))


def pink_noise(rng: np.random.Generator, count: int) -> Float64s:
    """Noise whose power falls by 3 dB an octave, root mean square 1."""
    spectrum = np.fft.rfft(rng.normal(size=count))
    spectrum /= np.sqrt(np.maximum(np.arange(len(spectrum)), 1))
    noise: Float64s = np.fft.irfft(spectrum, count)
    return np.asarray(noise / noise.std())


def speech_noise(rng: np.random.Generator, count: int) -> Float64s:
    """Noise with the spectrum of speech and four syllables a second, that rise over 40 to 90 ms."""
    noise = sosfilt(butter(2, (150, 3500), "bandpass", fs=RATE_HZ, output="sos"), pink_noise(rng, count))
    envelope, position = np.zeros(count), 0
    while position < count:
        length = int(rng.uniform(0.15, 0.35) * RATE_HZ)
        rise = int(rng.uniform(0.04, 0.09) * RATE_HZ)
        shape = np.minimum(np.arange(length) / rise, np.linspace(1.5, 0, length)).clip(0, 1)
        shape *= rng.uniform(0.3, 1)
        part = slice(position, min(position + length, count))
        envelope[part] = shape[: part.stop - part.start]
        position += length + int(rng.uniform(0, 0.15) * RATE_HZ)
    speech = noise * envelope
    return np.asarray(speech / speech.std())


def _times(rng: np.random.Generator, seconds: float, low_s: float, high_s: float) -> Float64s:
    gaps = rng.uniform(low_s, high_s, int(seconds / low_s))
    times = 0.3 + np.cumsum(gaps)
    return times[times < seconds - 0.5]


def _placed(
    seconds: float, times_s: Float64s, sound: Callable[[int], Float64s], levels: Float64s
) -> tuple[Float64s, Float64s]:
    """Sounds at times, which are rounded to samples."""
    out = np.zeros(int(seconds * RATE_HZ))
    starts = np.rint(times_s * RATE_HZ).astype(int)
    for n, start in enumerate(starts):
        part = sound(n)[: len(out) - start]
        out[start : start + len(part)] += levels[n] * part
    return out, starts / RATE_HZ


def _decay(seconds: float, time_s: float) -> Float64s:
    t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    return np.exp(-t / time_s)


def clicks(rng: np.random.Generator, seconds: float) -> Signal:
    """Bursts of 1 ms, over pink noise at -46 dB."""
    times = _times(rng, seconds, 0.12, 0.6)
    levels = amplitude(-12) * 10 ** (-rng.uniform(0, 12, len(times)) / 20)
    out, onsets = _placed(seconds, times, lambda n: rng.normal(size=RATE_HZ // 1000) / 2, levels)
    return Signal(out + amplitude(-46) * pink_noise(rng, len(out)), onsets)


def _drum(rng: np.random.Generator) -> Float64s:
    kind, length = rng.integers(3), int(0.25 * RATE_HZ)
    t = np.arange(length) / RATE_HZ
    if kind == 0:  # kick
        return np.asarray(
            np.sin(2 * np.pi * (55 * t + 60 * 0.02 * (1 - np.exp(-t / 0.02)))) * np.exp(-t / 0.09)
        )
    noise = rng.normal(size=length) / 3
    if kind == 1:  # snare
        return np.asarray(0.5 * np.sin(2 * np.pi * 185 * t) * np.exp(-t / 0.05) + noise * np.exp(-t / 0.06))
    high = sosfilt(butter(2, 6000, "highpass", fs=RATE_HZ, output="sos"), noise)
    return np.asarray(high * np.exp(-t / 0.025))


def drums(rng: np.random.Generator, seconds: float) -> Signal:
    """Kick, snare and hi-hat in any order at 130 to 280 a minute; levels within 12 dB."""
    times = _times(rng, seconds, 0.21, 0.45)
    levels = amplitude(-9) * 10 ** (-rng.uniform(0, 12, len(times)) / 20)
    out, onsets = _placed(seconds, times, lambda n: _drum(rng), levels)
    return Signal(out + amplitude(-60) * pink_noise(rng, len(out)), onsets)


def music(rng: np.random.Generator, seconds: float) -> Signal:
    """Plucked notes, attack 3 ms, over a chord that swells by 6 dB every two seconds, 16 dB below them."""
    times = _times(rng, seconds, 0.18, 0.6)

    def note(n: int) -> Float64s:
        t = np.arange(int(0.8 * RATE_HZ)) / RATE_HZ
        pitch_hz = 82.4 * 2 ** (rng.integers(0, 36) / 12)
        tones = sum(np.sin(2 * np.pi * k * pitch_hz * t) / k * np.exp(-k * t / 0.5) for k in range(1, 9))
        return np.asarray(0.5 * tones * np.minimum(t / 0.003, 1))

    levels = amplitude(-12) * 10 ** (-rng.uniform(0, 10, len(times)) / 20)
    out, onsets = _placed(seconds, times, note, levels)
    t = np.arange(len(out)) / RATE_HZ
    pad = sum(np.sin(2 * np.pi * f * t + p) for f, p in ((110, 0), (164.8, 1), (220, 2), (277.2, 3)))
    swell = 10 ** (3 * np.sin(2 * np.pi * 0.5 * t) / 20)
    return Signal(out + amplitude(-28) * swell * pad / 2, onsets)


def scene(rng: np.random.Generator, seconds: float) -> Signal:
    """Impacts at -6 to -18 dB, in speech-like noise at -27 dB, a rumble at -34 dB and a room at -56 dB."""
    times = _times(rng, seconds, 0.5, 1.8)

    def impact(n: int) -> Float64s:
        cut_hz = rng.uniform(300, 4000)
        noise = sosfilt(butter(1, cut_hz, fs=RATE_HZ, output="sos"), rng.normal(size=int(0.5 * RATE_HZ)))
        t = np.arange(len(noise)) / RATE_HZ
        body = np.sin(2 * np.pi * rng.uniform(45, 140) * t)
        return np.asarray((noise / noise.std() / 3 + 0.5 * body) * np.exp(-t / rng.uniform(0.04, 0.15)))

    levels = amplitude(-6) * 10 ** (-rng.uniform(0, 12, len(times)) / 20)
    out, onsets = _placed(seconds, times, impact, levels)
    rumble = sosfilt(butter(2, 80, fs=RATE_HZ, output="sos"), pink_noise(rng, len(out)))
    out += amplitude(-27) * speech_noise(rng, len(out)) + amplitude(-34) * rumble / rumble.std()
    return Signal(out + amplitude(-56) * pink_noise(rng, len(out)), onsets)


SIGNALS: Final = {"clicks": clicks, "drums": drums, "music": music, "scene": scene}
"""Makers by name, called with a generator of random numbers and seconds."""


class Score(NamedTuple):
    """F-measure with a window of 50 ms, precision, recall, and the errors of the pairs in seconds."""

    f_measure: float
    precision: float
    recall: float
    errors_s: Float64s


def score(found_s: Float64s, true_s: Float64s, window_s: float = 0.05) -> Score:
    """Pair what was found with what is true, nearest pairs first, each used once."""
    distance = np.abs(found_s[:, None] - true_s[None, :])
    pairs = np.argwhere(distance <= window_s)
    order = np.argsort(distance[tuple(pairs.T)], kind="stable")
    used_found, used_true, errors = set[int](), set[int](), list[float]()
    for n, m in pairs[order].tolist():
        if n not in used_found and m not in used_true:
            used_found.add(n)
            used_true.add(m)
            errors.append(float(found_s[n] - true_s[m]))
    precision = len(errors) / max(1, len(found_s))
    recall = len(errors) / max(1, len(true_s))
    f_measure = 2 * precision * recall / max(1e-9, precision + recall)
    return Score(f_measure, precision, recall, np.array(errors))


def energy_onsets(samples: Float64s) -> Float64s:
    """The trivial baseline: seconds at which the energy of 10 ms exceeds twice its mean over a second."""
    size = RATE_HZ // 100
    energy = (samples[: len(samples) // size * size].reshape(-1, size) ** 2).mean(axis=1)
    mean = np.convolve(energy, np.ones(100) / 100, "same")
    is_loud = energy > 2 * mean
    starts = np.flatnonzero(is_loud & ~np.concatenate([[False], is_loud[:-1]]))
    return np.asarray(starts * size / RATE_HZ)
