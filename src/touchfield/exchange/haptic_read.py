"""Reads ``.haptic``, the clips of Meta's Haptics Studio (version 1), as the drive of a single actuator.

The keys and rules are those of "Haptic Data Model, version 1.0.0", published with the open player of the
format (NiceVibrations, ``core/datamodel/README.md``). A clip has one continuous signal: an envelope of
amplitude, and perhaps one of frequency, both 0 to 1 and linear between their points in seconds. Other keys
are reported as not used.

**Amplitude** is the drive. It is zero before the first point and after the last one.

**Frequency** 0 to 1 is mapped linearly to `SHARPNESS_HZ`, as the export does; the vendor publishes no hertz.
Before the first and after the last point it keeps that point's value. A clip without this envelope has no
frequency.

**Emphasis** at a point of amplitude is a tap: a burst that decays to zero within `TRANSIENT_S`, placed at the
nearest frame. It replaces the envelope where it is stronger, since the player lowers the envelope around an
emphasis instead of adding both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.exchange.ahap import SHARPNESS_HZ
from touchfield.exchange.symbolic import (
    DEFAULT_RATE_HZ,
    MAX_SECONDS,
    TRANSIENT_S,
    ArrayEffect,
    ImportedEffect,
    check_rate,
    checked_frames,
)
from touchfield.exchange.unused_keys import UnusedKeys
from touchfield.json_values import JsonValue, read_json

_MAX_BYTES: Final = 1 << 23
_ROUNDING_S: Final = 1e-6
"""Times are written with six digits: a frame may be later than the last point by that."""
_METADATA: Final = ("editor", "author", "source", "project", "tags", "description")


@dataclass(frozen=True)
class _Point:
    seconds: float
    value: float
    emphasis: tuple[float, float] | None = None  # amplitude and frequency, 0 to 1


def read_haptic(path: str | Path, rate_hz: float = DEFAULT_RATE_HZ) -> ImportedEffect:
    """Read a ``.haptic`` file as the drive of one actuator, sampled at `rate_hz`.

    Raises SourceError if the file cannot be read, is longer than 8 MiB, is not JSON, is of another version,
    or breaks a rule of its format; and if it is longer than an hour. Raises InvalidArgument if the rate is
    out of range, or there would be too many drives.
    """
    check_rate(rate_hz)
    root, unused = read_json(path, _MAX_BYTES, "a .haptic file"), UnusedKeys()
    unused.check(root, "version", "metadata", "signals")
    _check_version(root.at("version"))
    if (metadata := root.get("metadata")) is not None and metadata.value is not None:
        unused.check(metadata, *_METADATA)
    signals = root.at("signals")
    unused.check(signals, "continuous")
    continuous = signals.at("continuous")
    unused.check(continuous, "envelopes")
    envelopes = continuous.at("envelopes")
    unused.check(envelopes, "amplitude", "frequency")
    amplitudes = _points(envelopes.at("amplitude"), "amplitude", unused)
    if not amplitudes:
        raise envelopes.at("amplitude").wrong("no point", "at least one point of amplitude")
    frequencies = _points(envelopes.at("frequency", None), "frequency", unused)
    return ImportedEffect(_sample(root, amplitudes, frequencies, rate_hz), notes=unused.notes())


def _check_version(version: JsonValue) -> None:
    major = version.at("major")
    if major.bounded_integer(0, 1 << 31) != 1:
        raise major.wrong(f"version {major.value}", "version 1", "Export it again with Haptics Studio.")


def _points(envelope: JsonValue, name: str, unused: UnusedKeys) -> list[_Point]:
    """Parse an envelope; its times must ascend. An envelope that is null or missing has no points."""
    if envelope.value is None:
        return []
    points: list[_Point] = []
    for entry in envelope.elements():
        emphasis = entry.get("emphasis") if name == "amplitude" else None
        unused.check(entry, "time", name, *(["emphasis"] if name == "amplitude" else []))
        tap = None
        if emphasis is not None and emphasis.value is not None:
            unused.check(emphasis, "amplitude", "frequency")
            tap = emphasis.at("amplitude").number(0, 1), emphasis.at("frequency").number(0, 1)
        point = _Point(entry.at("time").number(0, MAX_SECONDS), entry.at(name).number(0, 1), tap)
        if points and point.seconds < points[-1].seconds:
            found = f"{point.seconds:g} s after {points[-1].seconds:g} s"
            raise entry.at("time").wrong(found, "points in the order of time")
        points.append(point)
    return points


def _sample(
    root: JsonValue, amplitudes: list[_Point], frequencies: list[_Point], rate_hz: float
) -> ArrayEffect:
    taps = [(point.seconds, *point.emphasis) for point in amplitudes if point.emphasis is not None]
    last_s = amplitudes[-1].seconds
    frames = math.floor((last_s + _ROUNDING_S) * rate_hz) + 1
    starts = [round(seconds * rate_hz) for seconds, _, _ in taps]
    burst_frames = math.floor(TRANSIENT_S * rate_hz + 1e-6) + 1
    if starts:  # and a silent frame after the last burst
        frames = max(frames, starts[-1] + burst_frames + 1)
    checked_frames(root.file, frames, 1)
    times = np.arange(frames) / rate_hz
    drives = np.interp(times, *_line(amplitudes), left=0.0, right=0.0)
    # the last point counts although its time is rounded
    drives[(times > last_s) & (times <= last_s + _ROUNDING_S)] = amplitudes[-1].value
    low, high = SHARPNESS_HZ
    fractions = np.interp(times, *_line(frequencies)) if frequencies else None
    hertz = np.zeros(frames) if fractions is None else low + (high - low) * fractions
    for first, (_, amplitude, fraction) in zip(starts, taps):
        after_s = np.arange(min(burst_frames, frames - first)) / rate_hz
        at = slice(first, first + len(after_s))
        burst = amplitude * np.clip(1 - after_s / TRANSIENT_S, 0, 1)
        hertz[at] = np.where(burst > drives[at], low + (high - low) * fraction, hertz[at])
        drives[at] = np.maximum(drives[at], burst)
    known = np.where(drives > 0, hertz, 0).astype(np.float32).reshape(-1, 1, 1)
    amplitude_frames = drives.astype(np.float32).reshape(-1, 1, 1)
    return ArrayEffect(float(rate_hz), amplitude_frames, known if known.any() else None)


def _line(points: list[_Point]) -> tuple[list[float], list[float]]:
    return [point.seconds for point in points], [point.value for point in points]
