"""Clips of Meta's Haptics Studio, ``.haptic`` (JSON, version 1.0.0), and patterns of Apple, ``.ahap``, written.

A clip has one continuous signal: an envelope of amplitude, one of frequency (both 0 to 1, lines between points in
seconds), and at a point of amplitude an emphasis, a tap whose amplitude is no less than the point's. That is the
published data model of its open player; relations to newtons and hertz are not published, `OneTrack` tells ours.

A pattern has a continuous event for each 30 seconds, the longest that Apple allows, and curves of its intensity and
sharpness of at most 16 points each. Curves act on everything, so that taps lie in the curve; a pattern of nothing but
taps has transients and no curve.

Both hold one track, as a telephone or a controller can play it. Of several actuators the strongest is heard at each
frame, with its frequency. A drive that rises from nothing and is gone within `TRANSIENT_S` is a tap; the rest is an
envelope. Frequencies are shares of `SHARPNESS_HZ`.
"""

from __future__ import annotations

import json
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield._version import __version__
from touchfield.adapters.ahap import SHARPNESS_HZ
from touchfield.adapters.hjif_write import thinned
from touchfield.adapters.symbolic import TRANSIENT_S, filled_hz
from touchfield.medium.atomic import atomic_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.adapters.symbolic import ArrayEffect

    Points = tuple[tuple[float, float], ...]

__all__ = ["DIGITS", "OneTrack", "write_ahap", "write_haptic"]

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
        low, high = SHARPNESS_HZ
        notes: tuple[str, ...] = ()
        if actuators > 1:
            notes = (f"{actuators} actuators become one: the strongest at each moment is told.",)
        own = effect.frequencies_hz
        own = None if own is None else own.reshape(frames, -1)[np.arange(frames), strongest]
        hertz = filled_hz(drives.astype(np.float32), own).astype(np.float64)
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


_MOST_POINTS: Final = 16
_LONGEST_S: Final = 30.0


def write_haptic(path: str | Path, effect: ArrayEffect, name: str = "", description: str = "") -> tuple[str, ...]:
    """Write the drives of an array as ``.haptic``.

    Returns
    -------
    tuple of str
        What is lost on the way.

    Raises
    ------
    SourceError
        If the system refuses to write.
    """
    track = OneTrack.of(effect)
    times = [time for time, _ in track.amplitudes]
    points: dict[float, dict[str, Any]] = {
        time: {"time": time, "amplitude": amplitude} for time, amplitude in track.amplitudes
    }
    for at, amplitude, sharpness in track.taps:
        time = round(at, 6)
        if time not in points:
            after = min(max(bisect_left(times, time), 1), len(times) - 1)
            (t0, a0), (t1, a1) = track.amplitudes[after - 1], track.amplitudes[after]
            points[time] = {"time": time, "amplitude": round(a0 + (a1 - a0) * (time - t0) / (t1 - t0), DIGITS)}
        own = points[time]
        own["emphasis"] = {"amplitude": max(amplitude, own["amplitude"]), "frequency": sharpness}
    document = {
        "version": {"major": 1, "minor": 0, "patch": 0},
        "metadata": {
            "editor": f"touchfield {__version__}", "author": "", "source": name, "project": "", "tags": [],
            "description": description,
        },
        "signals": {
            "continuous": {
                "envelopes": {
                    "amplitude": [points[time] for time in sorted(points)],
                    "frequency": [{"time": time, "frequency": value} for time, value in track.sharpness],
                }
            }
        },
    }  # fmt: skip
    _write(path, document)
    return track.notes


def write_ahap(path: str | Path, effect: ArrayEffect, name: str = "", description: str = "") -> tuple[str, ...]:
    """Write the drives of an array as ``.ahap``; returns and errors as `write_haptic`."""
    track = OneTrack.of(effect)
    if any(amplitude > 0 for _, amplitude in track.amplitudes):
        track = OneTrack.of(effect, has_taps=False)
    pattern = [_event("HapticTransient", at, amplitude, sharpness) for at, amplitude, sharpness in track.taps]
    if not pattern:
        begin = 0.0
        while track.seconds - begin > 1e-6:
            length = min(_LONGEST_S, track.seconds - begin)
            pattern.append(_event("HapticContinuous", begin, 1.0, 0.0, length))
            begin += length
        for parameter, points in (("Intensity", track.amplitudes), ("Sharpness", track.sharpness)):
            pattern += _curves(f"Haptic{parameter}Control", points)
    told = {"Project": name, "Created": "", "Description": description}
    _write(path, {"Version": 1.0, "Metadata": told, "Pattern": pattern})
    return track.notes


def _event(
    kind: str, time_s: float, intensity: float, sharpness: float, length_s: float | None = None
) -> dict[str, Any]:
    duration = {} if length_s is None else {"EventDuration": round(length_s, 6)}
    values = (("HapticIntensity", intensity), ("HapticSharpness", sharpness))
    parameters = [{"ParameterID": name, "ParameterValue": value} for name, value in values]
    return {"Event": {"EventType": kind, "Time": round(time_s, 6), **duration, "EventParameters": parameters}}


def _curves(parameter: str, points: tuple[tuple[float, float], ...]) -> Iterator[dict[str, Any]]:
    """Curves end to end: the last point of one is the first of the next."""
    for first in range(0, max(1, len(points) - 1), _MOST_POINTS - 1):
        some = points[first : first + _MOST_POINTS]
        begin = some[0][0]
        told = [{"Time": round(time - begin, 6), "ParameterValue": value} for time, value in some]
        yield {"ParameterCurve": {"ParameterID": parameter, "Time": begin, "ParameterCurveControlPoints": told}}


def _write(path: str | Path, document: dict[str, Any]) -> None:
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
