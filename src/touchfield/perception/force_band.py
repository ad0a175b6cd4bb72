"""What of a force over time lies between 40 and 400 Hz, where a hand is most sensitive to vibration.

The band: Butterworth of order 4, run forwards and backwards, so without delay; what it would make of the ends is kept
out by `MARGIN_S` of the signal on either side, which is filtered and not counted. Thirds of an octave: the power of
a Hann window's spectrum, which leaks less than -90 dB from a slow change into the lowest third.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.perception.vibration_threshold import THIRDS_HZ

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["BAND_HZ", "LEAST_S", "MARGIN_S", "in_band", "third_octave_power"]

BAND_HZ: Final = (40.0, 400.0)

MARGIN_S: Final = 0.1
"""Filtered and not counted, on either side: the slowest pole has fallen to 1e-4."""

LEAST_S: Final = 0.25
"""A signal shorter than this, its margins beside, is not measured."""

_LEAST_RATE_HZ: Final = 1000.0


def in_band(signal: Float64s, rate_hz: float) -> Float64s:
    """The part of a signal from 40 to 400 Hz, without its margins.

    signal : float64 [samples, ...]
    rate_hz : float; samples a second, 1000 or more.
    Returns float64 [samples - 2 margin, ...].
    Raises `InvalidArgument` if the rate is too low or the signal too short.
    """
    from scipy.signal import butter, sosfiltfilt

    margin = round(MARGIN_S * rate_hz)
    _check(len(signal) - 2 * margin, rate_hz)
    sections = butter(4, BAND_HZ, "bandpass", fs=rate_hz, output="sos")
    filtered: Float64s = sosfiltfilt(sections, signal, axis=0)
    return filtered[margin : len(signal) - margin]


def third_octave_power(signal: Float64s, rate_hz: float) -> Float64s:
    """Mean square in each third of an octave of `THIRDS_HZ`, summed over the components, float64 [11].

    signal : float64 [samples, components]
    rate_hz : float; samples a second, 1000 or more.
    """
    n = len(signal)
    _check(n, rate_hz)
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(window[:, None] * (signal - signal.mean(axis=0)), axis=0)) ** 2
    power = 2 * power.sum(axis=1) / (n * (window**2).sum())
    frequency_hz = np.fft.rfftfreq(n, 1 / rate_hz)
    edges = np.searchsorted(frequency_hz, np.outer(THIRDS_HZ, [10**-0.05, 10**0.05]))
    return np.array([power[a:b].sum() for a, b in edges])


def _check(samples: int, rate_hz: float) -> None:
    if not rate_hz >= _LEAST_RATE_HZ:
        raise InvalidArgument("rate_hz", repr(rate_hz), f"{_LEAST_RATE_HZ:g} or more")
    if samples < LEAST_S * rate_hz:
        raise InvalidArgument("signal", f"{samples / rate_hz:.3g} s", f"{LEAST_S:g} s or more")
