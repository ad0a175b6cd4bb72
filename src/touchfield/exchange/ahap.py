"""Reads AHAP, Apple's JSON format of haptic patterns, as the drive of a single actuator over time.

The keys are those of Apple's "Representing haptic patterns in AHAP files". As specified there, missing values
take their defaults, values out of range are clamped, and unknown keys are ignored; so are events of sound. A
note names what is not used.

**Intensity** is the drive. Apple publishes no relation of intensity to a physical amplitude.

**Sharpness** 0 to 1 is mapped linearly to 65 to 300 Hz, as in the public reference encoder of ISO/IEC
23090-31; Apple documents only that it ranges from dull to sharp.

**Transients** are bursts that decay to zero within `TRANSIENT_S`, placed at the nearest frame.

**Continuous** events last for their duration. With an attack the drive rises linearly over it. An event that
is not sustained decays linearly to zero over its duration; a sustained one decays over its release after the
end. An event that ends where another one starts is silent there.

**Parameters and parameter curves** act on all events from their time on, within the limits of each event: the
control of intensity multiplies, the control of sharpness adds (Apple, "CHHapticDynamicParameter"). A curve is
linear between its points and keeps its last value.

**Overlapping events** are mixed (Apple, WWDC 2019, session 520, "Introducing Core Haptics"): their drives add
up. The sum is limited to a full drive, and the frequency is that of the strongest event, since a medium has
one frequency at a place; a note states how often either happens. How Apple's engine limits a sum is not
published.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Bools, Float64s
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
from touchfield.exchange.unused_keys import UnusedKeys
from touchfield.json_values import JsonValue, read_json

SHARPNESS_HZ: Final = (65.0, 300.0)
"""Frequencies of sharpness 0 and 1."""

_MAX_BYTES: Final = 1 << 23
_MAX_WORK: Final = 1 << 28
_DEFAULTS: Final = {
    "HapticIntensity": 1.0, "HapticSharpness": 0.5, "AttackTime": 0.0, "DecayTime": 0.0, "ReleaseTime": 0.0,
    "Sustained": 1.0,
}  # fmt: skip
_ROUNDING_S: Final = 1e-6
"""Times are usually written with six digits: a frame may be later than an end by that."""
_EVENT_KEYS: Final = ("Time", "EventType", "EventDuration", "EventParameters")
_NEUTRAL: Final = {"HapticIntensityControl": 1.0, "HapticSharpnessControl": 0.0}
_SAME_HZ: Final = 1.0
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
    unused = UnusedKeys()
    unused.check(root, "Version", "Metadata", "Pattern")
    events: list[_Event] = []
    curves: list[_Curve] = []
    sounds = 0
    for entry in pattern.elements():
        unused.check(entry, "Event", "Parameter", "ParameterCurve")
        event, parameter, curve = (entry.get(key) for key in ("Event", "Parameter", "ParameterCurve"))
        if event is not None:
            haptic_event = _parse_event(event, unused)
            if haptic_event is None:
                sounds += 1
            else:
                events.append(haptic_event)
        if parameter is not None:  # a step
            curves += _parse_curve(parameter, 0.0, [parameter], unused)
        if curve is not None:
            points = curve.at("ParameterCurveControlPoints").elements()
            curves += _parse_curve(curve, _seconds(curve, "Time"), points, unused)
    if not events:
        raise pattern.wrong(
            f"{sounds} events of sound and no other" if sounds else "no event", "haptic events"
        )
    effect, notes = _sample_pattern(pattern, events, curves, rate_hz)
    left_out = (f"Left out: {sounds} events of sound.",) if sounds else ()
    return ImportedEffect(effect, notes=(*left_out, *notes, *unused.notes()))


def _sample_pattern(
    pattern: JsonValue, events: list[_Event], curves: list[_Curve], rate_hz: float
) -> tuple[ArrayEffect, tuple[str, ...]]:
    # a transient starts at the nearest frame; other events keep their times
    events = [
        replace(event, start_s=round(event.start_s * rate_hz) / rate_hz) if event.is_transient else event
        for event in events
    ]
    seconds = max(event.end_s for event in events)
    if seconds > MAX_SECONDS:
        raise pattern.wrong(f"a pattern of {seconds:g} s", f"at most {MAX_SECONDS:g} s")
    spans = _spans(events, rate_hz)
    frames = checked_frames(pattern.file, max(stop for _, stop in spans) + 1, 1)  # the last one is silent
    times = np.arange(frames) / rate_hz
    event_frames = sum(event.end_s - event.start_s for event in events) * rate_hz
    if (len(curves) + 1) * frames > _MAX_WORK or event_frames > _MAX_WORK:
        raise pattern.wrong(
            f"{len(events)} events and {len(curves)} curves over {seconds:g} s", "fewer of them"
        )
    controls = {name: np.full(frames, neutral) for name, neutral in _NEUTRAL.items()}
    for curve in sorted(curves, key=lambda event: event.times_s[0]):
        start = int(np.searchsorted(times, curve.times_s[0] - _ROUNDING_S))
        controls[curve.parameter][start:] = np.interp(times[start:], curve.times_s, curve.values)
    total, (low, high) = Drive.silent(frames), SHARPNESS_HZ
    lowest_hz, highest_hz = np.full(frames, np.inf), np.zeros(frames)
    for event, (first, stop) in zip(events, spans):
        at = slice(first, stop)
        envelope = event.envelope(np.maximum(times[at] - event.start_s, 0))
        control = controls["HapticSharpnessControl"][at]
        hertz = low + (high - low) * np.clip(event.values["HapticSharpness"] + control, 0, 1)
        total.add(Drive(envelope * event.values["HapticIntensity"], hertz), at)
        lowest_hz[at] = np.minimum(lowest_hz[at], np.where(envelope > 0, hertz, np.inf))
        highest_hz[at] = np.maximum(highest_hz[at], np.where(envelope > 0, hertz, 0))
    sums = total.amplitudes * controls["HapticIntensityControl"]
    drives = np.clip(sums, 0, 1).astype(np.float32)
    hertz_of_drives = np.where(drives > 0, total.frequencies_hz, 0).astype(np.float32)
    effect = ArrayEffect(float(rate_hz), drives.reshape(-1, 1, 1), hertz_of_drives.reshape(-1, 1, 1))
    return effect, _overlap_notes(sums, highest_hz - lowest_hz > _SAME_HZ)


def _spans(events: list[_Event], rate_hz: float) -> list[tuple[int, int]]:
    """Return the first frame of each event, and the frame after its last one."""
    starts_s = np.sort([event.start_s for event in events if not event.is_transient])
    spans = []
    for event in events:
        first = round(event.start_s * rate_hz)
        stop = max(first, math.floor((event.end_s + _ROUNDING_S) * rate_hz)) + 1
        following = np.searchsorted(starts_s, event.end_s - 2 * _ROUNDING_S)
        meets_next = following < len(starts_s) and starts_s[following] <= event.end_s + 2 * _ROUNDING_S
        if meets_next and not event.is_transient and stop > first + 1:
            stop = min(stop, max(first + 1, math.ceil((event.end_s - 2 * _ROUNDING_S) * rate_hz)))
        spans.append((first, stop))
    return spans


def _overlap_notes(sums: Float64s, has_several_hz: Bools) -> tuple[str, ...]:
    """Return notes on what a medium does not have of overlapping events."""
    driven = sums > 0
    notes: tuple[str, ...] = ()
    for lost, text in (
        (sums > 1 + 1e-9, "the drives of overlapping events add up to more than 1, and are limited to it"),
        (has_several_hz, "overlapping events differ in sharpness, and that of the strongest is used"),
    ):
        if (lost & driven).any():
            notes += (f"In {100 * float((lost & driven).sum() / driven.sum()):.3g} % of the pattern {text}.",)
    return notes


def _parse_event(entry: JsonValue, unused: UnusedKeys) -> _Event | None:
    """Parse an event; None for an event of sound."""
    kind = entry.at("EventType").text(("HapticTransient", "HapticContinuous", *_SOUNDS))
    if kind in _SOUNDS:
        return None
    unused.check(entry, *_EVENT_KEYS)
    is_transient = kind == "HapticTransient"
    values = dict(_DEFAULTS)
    for parameter in entry.at("EventParameters", []).elements():
        name, value = parameter.at("ParameterID").text(), parameter.at("ParameterValue")
        if name in values:
            values[name] = (
                float(value.value) if isinstance(value.value, bool) else min(max(value.number(), 0), 1)
            )
        is_envelope = name in ("AttackTime", "ReleaseTime", "DecayTime") and values[name] > 0
        if name not in values or (is_envelope and (is_transient or name == "DecayTime")):
            unused.add(f"{name} of {kind}")
    return _Event(is_transient, _seconds(entry, "Time"), _seconds(entry, "EventDuration"), values)


def _seconds(entry: JsonValue, key: str) -> float:
    return max(0.0, entry.at(key, 0.0).number(high=MAX_SECONDS))


def _parse_curve(
    entry: JsonValue, start_s: float, points: Iterable[JsonValue], unused: UnusedKeys
) -> list[_Curve]:
    """Return the curve through points, in a list; empty if the parameter is not haptic."""
    name = entry.at("ParameterID").text()
    low = 0.0 if name == "HapticIntensityControl" else -1.0
    vertices = [
        (start_s + _seconds(point, "Time"), min(max(point.at("ParameterValue").number(), low), 1.0))
        for point in points
    ]
    if name not in _NEUTRAL:
        unused.add(name)
    if name not in _NEUTRAL or not vertices:
        return []
    times_s, values = zip(*sorted(vertices, key=lambda point: point[0]))
    return [_Curve(name, times_s, values)]
