"""Waves that are told as samples: how strong they are and how fast, from their zero crossings.

Between two crossings lies half a wave. Its greatest value is told at its place, and lines between these places are
the envelope; the half waves that pass in a window are the frequency there. A signal of fewer than two crossings, or
one slower than `SLOWEST_HZ`, is no vibration: it has a magnitude and no frequency.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["SLOWEST_HZ", "wave_drive"]

SLOWEST_HZ: Final = 1.0
_LEAST_WINDOW_S: Final = 0.02


def wave_drive(times_s: Float64s, values: Float64s, at_s: Float64s, window_s: float) -> tuple[Float64s, Float64s]:
    """Amplitudes and frequencies of a wave.

    Parameters
    ----------
    times_s, values : float64 [n]
        Samples of the wave, n at least 1, times ascending; lines in between.
    at_s : float64 [m]
        Where they are wanted, ascending.
    window_s : float
        Over which a frequency is counted, at least 0.02 s.

    Returns
    -------
    amplitudes, frequencies_hz : float64 [m]
        0 Hz where the signal is too slow for a vibration; the amplitude is then its magnitude.
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
