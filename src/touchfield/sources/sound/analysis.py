"""Where a sound starts (*onsets*) and how strong its low frequencies are, for vibration.

Both come in *hops* of `HOP_S`, so that memory is a few bytes a hop, whatever the rate of the sound.

Onsets are peaks of the *spectral flux* (Bello et al., A tutorial on onset detection in music signals, IEEE
TSAP 2005): the sum over bands, spaced evenly in the logarithm of the frequency, of what the logarithm of the
amplitude gained within `_LAG` hops. A peak is an onset if it is the largest within `_PEAK_HOPS` and exceeds
the mean around it by `_THRESHOLD` (the rule is that of Böck, Krebs & Schedl, ISMIR 2012). A window of 20 ms
does not tell when within it the sound rose. Our addition is that an onset is moved to the steepest rise of
the energy near the peak, found to 1 ms, and left out if that is below 10 dB: syllables rise more slowly than
what can be felt as a stroke. The numbers were chosen on the signals of `bench/onset_signals.py`, with other
seeds than those that `bench/bench_watch.py` measures.

Low frequencies are those of `LOW_HZ`, which skin feels and loudspeakers play (perception/human.toml). Their
level follows the peaks of the filtered sound: it rises at once and decays over `_RELEASE_S`. Their frequency
is half the rate of the zero crossings.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s

RATE_HZ: Final = 24000
"""Samples a second that are analysed: up to 12 kHz, above which no onset of a movie stands alone."""

HOP_S: Final = 0.005
_HOP: Final = round(HOP_S * RATE_HZ)
LOW_HZ: Final = (20.0, 200.0)
_WINDOW: Final = 4 * _HOP
_SPECTRUM: Final = 512
_BANDS: Final = 36
_BANDS_HZ: Final = (40.0, 11000.0)
_QUIET: Final = 1e-3
"""Amplitude below which a band counts as silent, full scale 1: -60 dB. So does a whole sound."""

_LAG: Final = 2
_PEAK_HOPS: Final = 6
_MEAN_HOPS: Final = (20, 14)  # before and after
_THRESHOLD: Final = 0.3
_MIN_RISE: Final = math.log(10)  # 10 dB

_SLICE: Final = 24  # samples: 1 ms
_SLICES: Final = _HOP // _SLICE
_AFTER, _BEFORE = 3, 10  # slices whose energies are compared
_SEARCHED: Final = (4, 1)  # hops before, as many as a window of the spectrum has, and after a peak
_RELEASE_S: Final = 0.05
_CROSSING_HOPS: Final = 20


class Onset(NamedTuple):
    """When a sound starts, seconds after its first sample, and how much its spectrum rises (the flux)."""

    time_s: float
    flux: float


@dataclass(frozen=True)
class SoundFeatures:
    """A sound in hops of `HOP_S`.

    flux : float32 [hops]
        Mean gain of the bands, natural logarithms.
    levels : float32 [hops]
        Peak of the low frequencies, full scale 1.
    low_hz : float32 [hops]
        Their frequency, within `LOW_HZ`.
    onsets : tuple of Onset
        In the order of time.
    silent_fraction : float
        Fraction of the hops whose peak is below -60 dB; 1 if there is none.
    """

    flux: Float32s
    levels: Float32s
    low_hz: Float32s
    onsets: tuple[Onset, ...]
    silent_fraction: float

    @property
    def duration_s(self) -> float:
        """Seconds of the sound, rounded up to a hop."""
        return len(self.flux) * HOP_S


class _Block(NamedTuple):
    """Features of some hops: see `SoundFeatures`; `rises` is the steepest rise, `rise_slices` its slice."""

    flux: Float32s
    levels: Float32s
    crossings: Float32s
    peaks: Float32s
    rises: Float32s
    rise_slices: Float32s


def sound_features(blocks: Iterable[Float32s]) -> SoundFeatures:
    """Analyse a sound, float32 [samples] a block at `RATE_HZ`, full scale 1; blocks may have any length."""
    analyser, found, rest = _Analyser(), list[_Block](), np.zeros(0, np.float32)
    for block in blocks:
        samples = np.concatenate([rest, block])
        whole = len(samples) // _HOP * _HOP
        if whole:
            found.append(analyser.block(samples[:whole]))
        rest = samples[whole:]
    if len(rest):
        found.append(analyser.block(np.pad(rest, (0, _HOP - len(rest)))))
    if not found:
        nothing = np.zeros(0, np.float32)
        return SoundFeatures(nothing, nothing, nothing, (), 1.0)
    joined = _Block(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
    counts = np.convolve(joined.crossings, np.ones(_CROSSING_HOPS))[: len(joined.crossings)]
    low_hz = np.clip(counts / (2 * _CROSSING_HOPS * HOP_S), *LOW_HZ).astype(np.float32)
    is_silent = joined.peaks < _QUIET
    onsets = tuple(_onsets(joined))
    return SoundFeatures(joined.flux, joined.levels, low_hz, onsets, float(is_silent.mean()))


class _Analyser:
    """The state between blocks: the samples of the last windows, filters and levels."""

    def __init__(self) -> None:
        from scipy.signal import butter

        self._sections = butter(2, LOW_HZ, "bandpass", fs=RATE_HZ, output="sos")
        self._filter_state = np.zeros((len(self._sections), 2))
        self._window = np.hanning(_WINDOW).astype(np.float32)
        self._bands = _band_matrix()
        self._past = np.zeros(_WINDOW, np.float32)
        self._past_bands = np.full((_LAG, _BANDS), math.log(_QUIET), np.float32)
        self._past_low, self._level = 0.0, 0.0

    def block(self, samples: Float32s) -> _Block:
        """Features of a whole number of hops."""
        low = self._low_pass(samples)
        hops = low.reshape(-1, _HOP)
        is_positive = np.concatenate([[self._past_low], low]) >= 0
        crossings = (is_positive[1:] != is_positive[:-1]).reshape(-1, _HOP).sum(axis=1)
        self._past_low = float(low[-1])
        with_past = np.concatenate([self._past, samples])
        self._past = with_past[-_WINDOW:]
        rises, slices = _rises(with_past)
        peaks = np.abs(samples).reshape(-1, _HOP).max(axis=1)
        levels = self._levels(np.abs(hops).max(axis=1))
        flux = self._flux(with_past)
        return _Block(
            *(np.asarray(part, np.float32) for part in (flux, levels, crossings, peaks, rises, slices))
        )

    def _low_pass(self, samples: Float32s) -> Float64s:
        from scipy.signal import sosfilt

        low, self._filter_state = sosfilt(self._sections, samples, zi=self._filter_state)
        return np.asarray(low)

    def _levels(self, peaks: Float64s) -> Float64s:
        """Levels that rise at once and decay."""
        decay = math.exp(-HOP_S / _RELEASE_S)
        levels = np.empty_like(peaks)
        for n, peak in enumerate(peaks.tolist()):
            self._level = max(peak, decay * self._level)
            levels[n] = self._level
        return levels

    def _flux(self, samples: Float32s) -> Float64s:
        windows = np.lib.stride_tricks.sliding_window_view(samples, _WINDOW)[_HOP::_HOP]
        spectra = np.abs(np.fft.rfft(windows * self._window, _SPECTRUM)).astype(np.float32)
        bands = np.log(spectra @ self._bands + _QUIET)
        with_past = np.concatenate([self._past_bands, bands])
        self._past_bands = with_past[-_LAG:]
        gains: Float64s = np.maximum(with_past[_LAG:] - with_past[:-_LAG], 0).mean(axis=1)
        return gains


def _band_matrix() -> Float32s:
    """Weights of the bins of a spectrum in each band, [bins, bands]; a sine of amplitude 1 gives about 1."""
    bins_hz = np.fft.rfftfreq(_SPECTRUM, 1 / RATE_HZ)
    edges_hz = np.geomspace(*_BANDS_HZ, _BANDS + 2)
    weights = np.zeros((len(bins_hz), _BANDS), np.float32)
    for n, (low, middle, high) in enumerate(zip(edges_hz, edges_hz[1:], edges_hz[2:])):
        triangle = np.minimum((bins_hz - low) / (middle - low), (high - bins_hz) / (high - middle))
        weights[:, n] = np.maximum(triangle, 0)
        weights[np.argmin(np.abs(bins_hz - middle)), n] = 1  # narrow bands may lie between two bins
    scale = 4 / _WINDOW  # of a Hann window, and of half a spectrum
    return weights * np.float32(scale)


def _rises(samples: Float32s) -> tuple[Float64s, Int64s]:
    """The steepest rise of the energy in each hop, natural logarithms, and the slice at which it begins.

    `samples` begin with a window of the past, which is as long as what the last slice is compared with, so
    the rises are those of hops that end one hop before the samples do.
    """
    slope = np.diff(samples, prepend=samples[:1])  # high frequencies, which a loud bass would hide
    steepest = None
    for signal in (samples, slope):
        energy = (signal.reshape(-1, _SLICE) ** 2).mean(axis=1) + _QUIET**2
        total = np.concatenate([[0.0], np.cumsum(energy, dtype=np.float64)])
        start = np.arange(_WINDOW // _SLICE - _SLICES, len(energy) - _SLICES)
        after = (total[start + _AFTER] - total[start]) / _AFTER
        before = (total[start] - total[start - _BEFORE]) / _BEFORE
        rise = np.log(after / before)
        steepest = rise if steepest is None else np.maximum(steepest, rise)
    assert steepest is not None
    hops = steepest.reshape(-1, _SLICES)
    return hops.max(axis=1), hops.argmax(axis=1)


def _onsets(block: _Block) -> list[Onset]:
    """Peaks of the flux above its mean, each at the steepest rise near it."""
    from scipy.ndimage import maximum_filter1d

    flux = block.flux
    before, after = _MEAN_HOPS
    total = np.concatenate([[0.0], np.cumsum(flux, dtype=np.float64)])
    hops = np.arange(len(flux))
    first, stop = np.maximum(hops - before, 0), np.minimum(hops + after + 1, len(flux))
    mean = (total[stop] - total[first]) / (stop - first)
    is_peak = flux >= maximum_filter1d(flux, 2 * _PEAK_HOPS + 1, mode="constant")
    loudest = maximum_filter1d(block.peaks, 2 * _LAG + 1, mode="constant")
    is_onset = is_peak & (flux > mean + _THRESHOLD) & (loudest >= _QUIET)
    onsets = list[Onset]()
    for hop in np.flatnonzero(is_onset):
        time_s, rise = _steepest_rise(block, int(hop))
        is_apart = not onsets or time_s - onsets[-1].time_s >= _PEAK_HOPS * HOP_S
        if rise >= _MIN_RISE and is_apart:
            onsets.append(Onset(time_s, float(flux[hop])))
    return onsets


def _steepest_rise(block: _Block, hop: int) -> tuple[float, float]:
    """When the energy rises most near a peak of the flux, seconds, and by how much, natural logarithm."""
    before, after = _SEARCHED
    # the rise of hop n is that of the samples one hop earlier
    first = max(0, hop + 1 - before)
    best = first + int(block.rises[first : hop + 2 + after].argmax())
    return float((best - 1) * HOP_S + block.rise_slices[best] / 1000), float(block.rises[best])
