"""Bands of HJIF at the frames of a medium: how strong each is, and at which frequency.

What counts is what an actuator is driven with, not the wave that it makes of it: of a VectorialWave the amplitude and
the frequency, whatever its base signal; of a Transient a burst that falls to nothing within `TRANSIENT_S`; of a block
of wavelets envelope and frequency (`wave_drive`), and so of a Curve that is a vibration drawn point by point, as the
reference encoder draws what lies below 72 Hz. Any other Curve is its magnitude, without a frequency. In a band the
latest effect that has begun is the one that is felt, as in the reference decoder. What is too short to meet a frame
is told at the nearest one.

**Waves told as samples.** Between two crossings lies half a wave. Its greatest value is told at its place, and lines
between these places are the envelope; the half waves that pass in a window are the frequency there. A signal of fewer
than two crossings, or one slower than `SLOWEST_HZ`, is no vibration: it has a magnitude and no frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.adapters.symbolic import TRANSIENT_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from touchfield.adapters.hjif_read import Band, Effect

    Float64s = NDArray[np.float64]

__all__ = ["SLOWEST_HZ", "Drive", "curve_at", "drive_of", "end_tick", "wave_drive"]

SLOWEST_HZ: Final = 1.0
_LEAST_WINDOW_S: Final = 0.02


def wave_drive(times_s: Float64s, values: Float64s, at_s: Float64s, window_s: float) -> tuple[Float64s, Float64s]:
    """Amplitudes and frequencies [m] at ascending seconds of a wave, lines between its samples [n], n at least 1.

    A frequency is counted over `window_s`, at least 0.02 s. It is 0 Hz where the signal is too slow for a vibration;
    the amplitude is then its magnitude.
    """
    slow = np.abs(np.interp(at_s, times_s, values)), np.zeros(len(at_s))
    held = np.flatnonzero(values)
    turns = np.flatnonzero(np.diff(np.sign(values[held])))
    if len(turns) < 2:
        return slow
    before, after = held[turns], held[turns + 1]
    share = values[before] / (values[before] - values[after])
    crossings_s = times_s[before] + share * (times_s[after] - times_s[before])
    bounds = np.concatenate([[0], after, [len(values)]])
    magnitudes = np.abs(values)
    peaks = np.maximum.reduceat(magnitudes, bounds[:-1])
    places = np.array([first + int(np.argmax(magnitudes[first:stop])) for first, stop in zip(bounds, bounds[1:])])
    half = max(window_s, _LEAST_WINDOW_S) / 2
    low, high = (np.clip(at_s + side, crossings_s[0], crossings_s[-1]) for side in (-half, half))
    passed = np.arange(len(crossings_s), dtype=np.float64)
    width = high - low
    counted = np.interp(high, crossings_s, passed) - np.interp(low, crossings_s, passed)
    nearest = np.clip(np.searchsorted(crossings_s, at_s), 1, len(crossings_s) - 1)
    own = 1 / (2 * np.maximum(np.diff(crossings_s)[nearest - 1], 1e-9))
    hertz = np.where(width > half / 4, counted / (2 * np.maximum(width, 1e-9)), own)
    is_wave = hertz >= SLOWEST_HZ
    amplitudes = np.where(is_wave, np.interp(at_s, times_s[places], peaks), slow[0])
    return amplitudes, np.where(is_wave, hertz, 0.0)


_DEFAULT_HZ: Final = 150.0
"""Of a wave without a frequency, as far as its limits allow."""

_SLACK: Final = 0.5
"""Ticks by which a frame may lie outside an effect: one between two ticks is told at the nearer one."""


@dataclass
class Drive:
    """Amplitudes and frequencies (0: none known) over the frames, float64 [frames] each."""

    amplitudes: Float64s
    frequencies_hz: Float64s

    @classmethod
    def silent(cls, frames: int) -> Drive:
        """Nothing to be felt."""
        return cls(np.zeros(frames), np.zeros(frames))

    def add(self, other: Drive) -> None:
        """Amplitudes add up; the frequency is that of the stronger."""
        stronger = other.amplitudes > self.amplitudes
        self.frequencies_hz[stronger] = other.frequencies_hz[stronger]
        self.amplitudes += other.amplitudes


def end_tick(band: Band, timescale: int) -> float:
    """The tick at which the last effect of a band is over; 0 for a band without any."""
    if band.kind == "WaveletWave":
        return max((one.position + _length(one) * timescale / band.upper_hz for one in band.effects), default=0)
    after = math.ceil(TRANSIENT_S * timescale) if band.kind == "Transient" else 0
    return max((one.position + int(one.ticks[-1]) + after for one in band.effects if len(one.ticks)), default=0)


def drive_of(bands: Iterable[Band], frames: int, ticks_per_frame: float, timescale: int) -> Drive:
    """The drive that all bands of a channel make together, before its gain."""
    total, places = Drive.silent(frames), np.arange(frames, dtype=np.float64) * ticks_per_frame
    for band in bands:
        if band.kind == "Transient":
            total.add(_transients(band, frames, ticks_per_frame, timescale))
        elif band.kind == "WaveletWave":
            total.add(_wavelets(band, places, timescale))
        else:
            total.add(_continuous(band, places, ticks_per_frame, timescale))
    return total


def curve_at(band: Band, ticks: Float64s) -> Float64s:
    """The signed value of a Curve, before the channel's gain, float64 [n]; `ticks` [n] ascend."""
    values = np.zeros(len(ticks))
    for effect, first, stop in _governed(band, ticks):
        values[first:stop] = _curve(band, effect, ticks[first:stop] - effect.position)
    return values


def _governed(band: Band, places: Float64s) -> Iterable[tuple[Effect, int, int]]:
    """Each effect with the places, from and to, at which it is felt."""
    held = [one for one in band.effects if len(one.ticks)]
    low, high = [one.position - _SLACK for one in held], [one.position + one.ticks[-1] + _SLACK for one in held]
    begins = np.searchsorted(places, low, side="left").tolist()
    ends = np.searchsorted(places, high, side="right").tolist()
    for effect, first, stop, following in zip(held, begins, ends, [*begins[1:], len(places)]):
        yield effect, first, max(first, min(stop, following))


def _length(block: Effect) -> int:
    return 0 if block.samples is None else len(block.samples)


def _wavelets(band: Band, places: Float64s, timescale: int) -> Drive:
    """Blocks end to end, each run of them that is not silent as one wave."""
    drive = Drive.silent(len(places))
    window_s = float(places[1] - places[0]) / timescale if len(places) > 1 else 0.0
    runs: list[tuple[float, list[Float64s]]] = []
    end = -math.inf
    for block in band.effects:
        if block.samples is None or not block.samples.any():
            continue
        if abs(block.position - end) > 1:
            runs.append((block.position, []))
        runs[-1][1].append(block.samples)
        end = block.position + len(block.samples) * timescale / band.upper_hz
    for position, blocks in runs:
        samples = np.concatenate(blocks)
        ticks = position + np.arange(len(samples)) * (timescale / band.upper_hz)
        first, stop = np.searchsorted(places, [ticks[0] - _SLACK, ticks[-1] + _SLACK]).tolist()
        if first == stop:
            first = min(first, len(places) - 1)
            stop = first + 1
        at = slice(first, stop)
        amplitudes, hertz = wave_drive(ticks / timescale, samples, places[at] / timescale, window_s)
        drive.amplitudes[at] = np.maximum(drive.amplitudes[at], amplitudes)
        drive.frequencies_hz[at] = np.where(hertz > 0, np.clip(hertz, band.lower_hz, band.upper_hz), 0)
    return drive


def _continuous(band: Band, places: Float64s, ticks_per_frame: float, timescale: int) -> Drive:
    """A Curve or a VectorialWave."""
    drive = Drive.silent(len(places))
    for effect, first, stop in _governed(band, places):
        where, at = slice(first, stop), places[first:stop] - effect.position
        if first == stop:  # between two frames
            middle = effect.position + int(effect.ticks[-1]) / 2
            frame = min(round(middle / ticks_per_frame), len(places) - 1)
            where, at = slice(frame, frame + 1), effect.ticks.astype(np.float64)
        if band.kind == "Curve":
            amplitudes, hertz = _drawn(band, effect, at, ticks_per_frame, timescale)
        else:
            amplitudes, hertz = np.abs(_amplitudes(effect, at, 1.0)), _frequencies(band, effect, at)
        if first == stop:
            strongest = int(np.argmax(amplitudes))
            if amplitudes[strongest] <= drive.amplitudes[where][0]:
                continue
            amplitudes, hertz = amplitudes[strongest], hertz[strongest]
        drive.amplitudes[where], drive.frequencies_hz[where] = amplitudes, hertz
    return drive


def _amplitudes(effect: Effect, at: Float64s, default: float) -> Float64s:
    held = ~np.isnan(effect.amplitudes)
    if not held.any():
        return np.full(len(at), default)
    return np.interp(at, effect.ticks[held], effect.amplitudes[held])


def _curve(band: Band, effect: Effect, at: Float64s) -> Float64s:
    if band.curve not in ("Cubic", "Akima"):
        return _amplitudes(effect, at, 0.0)
    held = ~np.isnan(effect.amplitudes)
    ticks, values = effect.ticks[held], effect.amplitudes[held]
    if len(ticks) < 2:
        return _amplitudes(effect, at, 0.0)
    if band.curve == "Akima":
        from scipy.interpolate import Akima1DInterpolator

        own = np.append(np.diff(ticks) > 0, True)  # of keyframes on one tick the last
        if own.sum() > 1:
            drawn = Akima1DInterpolator(ticks[own], values[own])(np.clip(at, ticks[own][0], ticks[-1]))
            return np.clip(np.asarray(drawn, np.float64), -1, 1)
    after = np.clip(np.searchsorted(ticks, at, side="right"), 1, len(ticks) - 1)
    width = np.maximum(ticks[after] - ticks[after - 1], 1)
    share = np.clip((at - ticks[after - 1]) / width, 0, 1)
    eased: Float64s = values[after - 1] + (values[after] - values[after - 1]) * share**2 * (3 - 2 * share)
    return eased


def _drawn(
    band: Band, effect: Effect, at: Float64s, ticks_per_frame: float, timescale: int
) -> tuple[Float64s, Float64s]:
    """A Curve: a wave where it swings about nothing, else its magnitude."""
    held = ~np.isnan(effect.amplitudes)
    magnitudes, none = np.abs(_curve(band, effect, at)), np.zeros(len(at))
    if not held.any():
        return magnitudes, none
    times_s = effect.ticks[held] / timescale
    amplitudes, hertz = wave_drive(times_s, effect.amplitudes[held], at / timescale, ticks_per_frame / timescale)
    is_wave = hertz > 0
    return (
        np.where(is_wave, amplitudes, magnitudes),
        np.where(is_wave, np.clip(hertz, max(band.lower_hz, 1), max(band.upper_hz, 1)), 0),
    )


def _frequencies(band: Band, effect: Effect, at: Float64s) -> Float64s:
    held = ~np.isnan(effect.frequencies_hz)
    if not held.any():
        return np.full(len(at), np.clip(_DEFAULT_HZ, band.lower_hz, band.upper_hz))
    told = np.interp(at, effect.ticks[held], effect.frequencies_hz[held])
    limited: Float64s = np.clip(told, band.lower_hz, band.upper_hz)
    return limited


def _transients(band: Band, frames: int, ticks_per_frame: float, timescale: int) -> Drive:
    drive = Drive.silent(frames)
    if not band.effects:
        return drive
    ticks = np.concatenate([one.position + one.ticks for one in band.effects])
    amplitudes = np.abs(np.concatenate([one.amplitudes for one in band.effects]))
    told = np.concatenate([one.frequencies_hz for one in band.effects])
    hertz = np.where(np.isnan(told), np.clip(_DEFAULT_HZ, band.lower_hz, band.upper_hz), told)
    begins = np.round(ticks / ticks_per_frame).astype(np.int64)
    length = TRANSIENT_S * timescale / ticks_per_frame
    for after in range(max(1, math.ceil(length))):
        at = begins + after
        there = (at < frames) & ~np.isnan(amplitudes)
        np.add.at(drive.amplitudes, at[there], amplitudes[there] * (1 - after / max(length, 1)))
        drive.frequencies_hz[at[there]] = hertz[there]
    return drive
