"""The drives of an array as the one track that a telephone or a controller can play.

Of several actuators the strongest is heard at each frame, with its frequency. A drive that rises from nothing and is
gone within `TRANSIENT_S` is a tap; the rest is an envelope. Frequencies are shares of `SHARPNESS_HZ`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.adapters.ahap import SHARPNESS_HZ
from touchfield.adapters.hjif_array import DEFAULT_CARRIER_HZ
from touchfield.adapters.keyframes import thinned
from touchfield.adapters.symbolic import TRANSIENT_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.adapters.symbolic import ArrayEffect

    Points = tuple[tuple[float, float], ...]

__all__ = ["DIGITS", "OneTrack"]

DIGITS: Final = 4
_STEP: Final = 0.5 * 10.0**-DIGITS


@dataclass(frozen=True)
class OneTrack:
    """Envelopes and taps.

    Attributes
    ----------
    seconds : float
    amplitudes, sharpness : tuple of (seconds, share)
        Points of lines, at least two, the first at 0; shares 0 to 1.
    taps : tuple of (seconds, amplitude, sharpness)
        Ascending.
    notes : tuple of str
        What is lost on the way.
    """

    seconds: float
    amplitudes: Points
    sharpness: Points
    taps: tuple[tuple[float, float, float], ...]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, effect: ArrayEffect, has_taps: bool = True) -> OneTrack:
        """The track of an effect; an only frame is held for the time of a frame, taps may stay in the envelope."""
        frames, actuators = len(effect), effect.drives[0].size
        every = effect.drives.reshape(frames, -1)
        strongest = np.argmax(every, axis=1)
        drives = every[np.arange(frames), strongest].astype(np.float64)
        hertz = np.full(frames, DEFAULT_CARRIER_HZ)
        low, high = SHARPNESS_HZ
        notes: tuple[str, ...] = ()
        if actuators > 1:
            notes = (f"{actuators} actuators become one: the strongest at each moment is told.",)
        if effect.frequencies_hz is not None:
            told = effect.frequencies_hz.reshape(frames, -1)[np.arange(frames), strongest].astype(np.float64)
            known = np.flatnonzero((told > 0) & (drives > 0))
            if len(known):
                place = np.maximum(np.searchsorted(known, np.arange(frames), side="right") - 1, 0)
                hertz = told[known[place]]
                if hertz.min() < low or hertz.max() > high:
                    notes += (f"Frequencies beyond {low:g} to {high:g} Hz are told as the nearer of these.",)
        sharp = np.clip((hertz - low) / (high - low), 0, 1)
        if frames == 1:
            drives, sharp = np.repeat(drives, 2), np.repeat(sharp, 2)
        drives, taps = _without_taps(drives, sharp, effect.rate_hz) if has_taps else (drives, ())
        return cls(
            (len(drives) - 1) / effect.rate_hz, _points(drives, effect.rate_hz), _points(sharp, effect.rate_hz),
            taps, notes,
        )  # fmt: skip


def _without_taps(
    drives: NDArray[np.float64], sharp: NDArray[np.float64], rate_hz: float
) -> tuple[NDArray[np.float64], tuple[tuple[float, float, float], ...]]:
    longest = int(TRANSIENT_S * rate_hz)  # frames between nothing and nothing
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (drives > 0).astype(np.int8), [0]])))
    left, taps = drives.copy(), []
    for first, stop in edges.reshape(-1, 2).tolist():
        if stop - first <= longest and stop < len(drives):
            top = first + int(np.argmax(drives[first:stop]))
            taps.append((top / rate_hz, round(float(drives[top]), DIGITS), round(float(sharp[top]), DIGITS)))
            left[first:stop] = 0
    return left, tuple(taps)


def _points(values: NDArray[np.float64], rate_hz: float) -> tuple[tuple[float, float], ...]:
    kept = thinned(np.arange(len(values)), np.round(values, DIGITS)[:, None], (_STEP,))
    return tuple((round(n / rate_hz, 6), round(float(values[n]), DIGITS)) for n in kept.tolist())
