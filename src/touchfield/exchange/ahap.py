"""Reads AHAP, Apple's JSON format of haptic patterns, as the drive of a single actuator over time.

The keys are those of Apple's "Representing haptic patterns in AHAP files". As specified there, missing values
take their defaults, values out of range are clamped, and unknown keys are ignored; so are events of sound.

**Intensity** is the drive. Apple publishes no relation of intensity to a physical amplitude.

**Sharpness** 0 to 1 is mapped linearly to 65 to 300 Hz, as in the public reference encoder of ISO/IEC
23090-31; Apple documents only that it ranges from dull to sharp.

**Transients** are bursts that decay to zero within `TRANSIENT_S`, placed at the nearest frame.

**Continuous** events last for their duration. With an attack the drive rises linearly over it. An event that
is not sustained decays linearly to zero over its duration; a sustained one decays over its release after the
end. Parameters and parameter curves act on all events from their time on: the control of intensity
multiplies, the control of sharpness adds; a curve is linear between its points and keeps its last value.
Where events overlap, drives add up to at most 1, and the frequency is that of the strongest.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.exchange.symbolic import (
    DEFAULT_RATE_HZ,
    MAX_SECONDS,
    TRANSIENT_S,
    ArrayEffect,
    Drive,
    ImportedEffect,
    check_rate,
    checked_frames,
)
from touchfield.json_values import JsonValue, read_json

SHARPNESS_HZ: Final = (65.0, 300.0)
"""Frequencies of sharpness 0 and 1."""

_MAX_BYTES: Final = 1 << 23
_MAX_WORK: Final = 1 << 28
_DEFAULTS: Final = {
    "HapticIntensity": 1.0, "HapticSharpness": 0.5, "AttackTime": 0.0, "DecayTime": 0.0, "ReleaseTime": 0.0,
    "Sustained": 1.0,
}  # fmt: skip
_NEUTRAL: Final = {"HapticIntensityControl": 1.0, "HapticSharpnessControl": 0.0}
_SOUNDS: Final = ("AudioContinuous", "AudioCustom")


@dataclass(frozen=True)
class _Event:
    is_transient: bool
    start_s: float
    length_s: float
    values: dict[str, float]  # of `_DEFAULTS`

    @property
    def end_s(self) -> float:
        if self.is_transient:
            return self.start_s + TRANSIENT_S
        return (
            self.start_s
            + self.length_s
            + (self.values["ReleaseTime"] if self.values["Sustained"] > 0 else 0.0)
        )

    def envelope(self, after_s: Float64s) -> Float64s:
        """Return the fraction of the intensity at times after the start, seconds."""
        if self.is_transient:
            return np.clip(1 - after_s / TRANSIENT_S, 0, 1)
        attack_s, release_s = self.values["AttackTime"], self.values["ReleaseTime"]
        fraction, past_end_s = np.ones(len(after_s)), after_s - self.length_s
        if attack_s > 0:
            fraction = np.minimum(fraction, after_s / attack_s)
        if self.values["Sustained"] > 0:
            fraction = np.minimum(fraction, 1 - past_end_s / release_s) if release_s > 0 else fraction
        elif self.length_s > 0:
            fraction = np.minimum(fraction, -past_end_s / self.length_s)
        return np.clip(fraction, 0, 1)


@dataclass(frozen=True)
class _Curve:
    parameter: str
    times_s: tuple[float, ...]
    values: tuple[float, ...]


def read_ahap(path: str | Path, rate_hz: float = DEFAULT_RATE_HZ) -> ImportedEffect:
    """Read an ``.ahap`` file as the drive of one actuator, sampled at `rate_hz`.

    Raises SourceError if the file cannot be read, is longer than 8 MiB, is not JSON, or has a value of the
    wrong type; and if it has no haptic event or is longer than an hour. Raises InvalidArgument if the rate is
    out of range, or there would be too many drives.
    """
    check_rate(rate_hz)
    root = read_json(path, _MAX_BYTES, "an AHAP file")
    pattern = root.at("Pattern")
    events: list[_Event] = []
    curves: list[_Curve] = []
    sounds = 0
    for entry in pattern.elements():
        event, parameter, curve = (entry.get(key) for key in ("Event", "Parameter", "ParameterCurve"))
        if event is not None:
            haptic_event = _parse_event(event)
            if haptic_event is None:
                sounds += 1
            else:
                events.append(haptic_event)
        if parameter is not None:  # a step
            curves += _parse_curve(parameter, 0.0, [parameter])
        if curve is not None:
            curves += _parse_curve(
                curve, _seconds(curve, "Time"), curve.at("ParameterCurveControlPoints").elements()
            )
    if not events:
        raise pattern.wrong(
            f"{sounds} events of sound and no other" if sounds else "no event", "haptic events"
        )
    notes = (f"Left out: {sounds} events of sound.",) if sounds else ()
    return ImportedEffect(_sample_pattern(pattern, events, curves, rate_hz), notes=notes)


def _sample_pattern(
    pattern: JsonValue, events: list[_Event], curves: list[_Curve], rate_hz: float
) -> ArrayEffect:
    # a transient starts at the nearest frame; other events keep their times
    events = [
        replace(event, start_s=round(event.start_s * rate_hz) / rate_hz) if event.is_transient else event
        for event in events
    ]
    seconds = max(event.end_s for event in events)
    if seconds > MAX_SECONDS:
        raise pattern.wrong(f"a pattern of {seconds:g} s", f"at most {MAX_SECONDS:g} s")
    spans = [
        (first := round(event.start_s * rate_hz), max(first, math.floor(event.end_s * rate_hz + 1e-6)) + 1)
        for event in events
    ]
    frames = checked_frames(pattern.file, max(stop for _, stop in spans) + 1, 1)  # the last one is silent
    times = np.arange(frames) / rate_hz
    event_frames = sum(event.end_s - event.start_s for event in events) * rate_hz
    if (len(curves) + 1) * frames > _MAX_WORK or event_frames > _MAX_WORK:
        raise pattern.wrong(
            f"{len(events)} events and {len(curves)} curves over {seconds:g} s", "fewer of them"
        )
    controls = {name: np.full(frames, neutral) for name, neutral in _NEUTRAL.items()}
    for curve in sorted(curves, key=lambda event: event.times_s[0]):
        start = int(np.searchsorted(times, curve.times_s[0] - 1e-9))
        controls[curve.parameter][start:] = np.interp(times[start:], curve.times_s, curve.values)
    total, (low, high) = Drive.silent(frames), SHARPNESS_HZ
    for event, (first, stop) in zip(events, spans):
        frames_of_event = slice(first, stop)
        envelope = event.envelope(np.maximum(times[frames_of_event] - event.start_s, 0))
        sharpness = np.clip(
            event.values["HapticSharpness"] + controls["HapticSharpnessControl"][frames_of_event], 0, 1
        )
        total.add(
            Drive(envelope * event.values["HapticIntensity"], low + (high - low) * sharpness), frames_of_event
        )
    drives = np.clip(total.amplitudes * controls["HapticIntensityControl"], 0, 1).astype(np.float32)
    hertz = np.where(drives > 0, total.frequencies_hz, 0).astype(np.float32)
    return ArrayEffect(float(rate_hz), drives.reshape(-1, 1, 1), hertz.reshape(-1, 1, 1))


def _parse_event(entry: JsonValue) -> _Event | None:
    """Parse an event; None for an event of sound."""
    kind = entry.at("EventType").text(("HapticTransient", "HapticContinuous", *_SOUNDS))
    if kind in _SOUNDS:
        return None
    values = dict(_DEFAULTS)
    for parameter in entry.at("EventParameters", []).elements():
        name, value = parameter.at("ParameterID").text(), parameter.at("ParameterValue")
        if name in values:
            values[name] = (
                float(value.value) if isinstance(value.value, bool) else min(max(value.number(), 0), 1)
            )
    return _Event(
        kind == "HapticTransient", _seconds(entry, "Time"), _seconds(entry, "EventDuration"), values
    )


def _seconds(entry: JsonValue, key: str) -> float:
    return max(0.0, entry.at(key, 0.0).number(high=MAX_SECONDS))


def _parse_curve(entry: JsonValue, start_s: float, points: Iterable[JsonValue]) -> list[_Curve]:
    """Return the curve through points, in a list; empty if the parameter is not haptic."""
    name = entry.at("ParameterID").text()
    low = 0.0 if name == "HapticIntensityControl" else -1.0
    vertices = [
        (start_s + _seconds(point, "Time"), min(max(point.at("ParameterValue").number(), low), 1.0))
        for point in points
    ]
    if name not in _NEUTRAL or not vertices:
        return []
    times_s, values = zip(*sorted(vertices, key=lambda point: point[0]))
    return [_Curve(name, times_s, values)]
