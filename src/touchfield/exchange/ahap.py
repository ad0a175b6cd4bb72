"""AHAP, Apple's haptic and audio patterns (JSON), read as the drive of one actuator: a symbolic medium of 1
x 1.

The keys are those of Apple's "Representing haptic patterns in AHAP files". As there, what is missing takes
its default, what is out of range is clamped, and keys that are not known are passed over; so are the events
of sound.

**Intensity** is the drive. Apple publishes no relation of intensity to a physical amplitude.

**Sharpness** 0 to 1 is mapped linearly to 65 to 300 Hz, as in the public reference encoder of ISO/IEC
23090-31; Apple says only that it runs from dull to sharp.

**Transients** are bursts that fall to nothing within `TRANSIENT_S`, and are told at the frame nearest to
them.

**Continuous** events last for their duration. With an attack the drive rises linearly over it; one that is
not sustained falls linearly to nothing over its duration, one that is falls over its release behind the end.
Parameters and parameter curves act on all events from their time on: the control of intensity multiplies, the
control of sharpness adds; a curve is linear between its points and holds its last. Where events meet, drives
add up to 1 at most, and the frequency is that of the strongest.
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
_MOST_WORK: Final = 1 << 28
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
        """The share of its intensity, so many seconds after its start."""
        if self.is_transient:
            return np.clip(1 - after_s / TRANSIENT_S, 0, 1)
        attack_s, release_s = self.values["AttackTime"], self.values["ReleaseTime"]
        share, behind = np.ones(len(after_s)), after_s - self.length_s
        if attack_s > 0:
            share = np.minimum(share, after_s / attack_s)
        if self.values["Sustained"] > 0:
            share = np.minimum(share, 1 - behind / release_s) if release_s > 0 else share
        elif self.length_s > 0:
            share = np.minimum(share, -behind / self.length_s)
        return np.clip(share, 0, 1)


@dataclass(frozen=True)
class _Curve:
    parameter: str
    times_s: tuple[float, ...]
    values: tuple[float, ...]


def read_ahap(path: str | Path, rate_hz: float = DEFAULT_RATE_HZ) -> ImportedEffect:
    """An ``.ahap`` file as the drive of one actuator, so many frames a second.

    Raises SourceError if the file cannot be read, is longer than 8 MiB, is no JSON, or a value is of the
    wrong type; if no event can be felt, or it is longer than an hour. InvalidArgument if the rate is out of
    range, or there would be too many drives.
    """
    check_rate(rate_hz)
    root = read_json(path, _MAX_BYTES, "an AHAP file")
    pattern = root.at("Pattern")
    events: list[_Event] = []
    curves: list[_Curve] = []
    sounds = 0
    for entry in pattern.each():
        event, parameter, curve = (entry.get(key) for key in ("Event", "Parameter", "ParameterCurve"))
        if event is not None:
            own = _event(event)
            sounds += own is None
            events += [] if own is None else [own]
        if parameter is not None:  # it jumps
            curves += _curve(parameter, 0.0, [parameter])
        if curve is not None:
            curves += _curve(curve, _seconds(curve, "Time"), curve.at("ParameterCurveControlPoints").each())
    if not events:
        raise pattern.wrong(
            f"{sounds} events of sound and none to feel" if sounds else "no event", "haptic events"
        )
    notes = (f"Left out: {sounds} events of sound.",) if sounds else ()
    return ImportedEffect(_sampled(pattern, events, curves, rate_hz), notes=notes)


def _sampled(pattern: JsonValue, events: list[_Event], curves: list[_Curve], rate_hz: float) -> ArrayEffect:
    # a transient is felt from the frame that it is told at; any other where it is
    events = [
        replace(one, start_s=round(one.start_s * rate_hz) / rate_hz) if one.is_transient else one
        for one in events
    ]
    seconds = max(one.end_s for one in events)
    if seconds > MAX_SECONDS:
        raise pattern.wrong(f"a pattern of {seconds:g} s", f"at most {MAX_SECONDS:g} s")
    spans = [
        (first := round(one.start_s * rate_hz), max(first, math.floor(one.end_s * rate_hz + 1e-6)) + 1)
        for one in events
    ]
    frames = checked_frames(pattern.file, max(stop for _, stop in spans) + 1, 1)  # the last one is silent
    times = np.arange(frames) / rate_hz
    if (len(curves) + 1) * frames > _MOST_WORK or sum(
        one.end_s - one.start_s for one in events
    ) * rate_hz > _MOST_WORK:
        raise pattern.wrong(
            f"{len(events)} events and {len(curves)} curves over {seconds:g} s", "fewer of them"
        )
    controls = {name: np.full(frames, neutral) for name, neutral in _NEUTRAL.items()}
    for curve in sorted(curves, key=lambda one: one.times_s[0]):
        begin = int(np.searchsorted(times, curve.times_s[0] - 1e-9))
        controls[curve.parameter][begin:] = np.interp(times[begin:], curve.times_s, curve.values)
    total, (low, high) = Drive.silent(frames), SHARPNESS_HZ
    for one, (first, stop) in zip(events, spans):
        where = slice(first, stop)
        share = one.envelope(np.maximum(times[where] - one.start_s, 0))
        sharpness = np.clip(one.values["HapticSharpness"] + controls["HapticSharpnessControl"][where], 0, 1)
        total.add(Drive(share * one.values["HapticIntensity"], low + (high - low) * sharpness), where)
    drives = np.clip(total.amplitudes * controls["HapticIntensityControl"], 0, 1).astype(np.float32)
    hertz = np.where(drives > 0, total.frequencies_hz, 0).astype(np.float32)
    return ArrayEffect(float(rate_hz), drives.reshape(-1, 1, 1), hertz.reshape(-1, 1, 1))


def _event(one: JsonValue) -> _Event | None:
    """An event; None for one of sound."""
    kind = one.at("EventType").text(("HapticTransient", "HapticContinuous", *_SOUNDS))
    if kind in _SOUNDS:
        return None
    values = dict(_DEFAULTS)
    for entry in one.at("EventParameters", []).each():
        name, value = entry.at("ParameterID").text(), entry.at("ParameterValue")
        if name in values:
            values[name] = (
                float(value.value) if isinstance(value.value, bool) else min(max(value.number(), 0), 1)
            )
    return _Event(kind == "HapticTransient", _seconds(one, "Time"), _seconds(one, "EventDuration"), values)


def _seconds(one: JsonValue, key: str) -> float:
    return max(0.0, one.at(key, 0.0).number(high=MAX_SECONDS))


def _curve(one: JsonValue, begin_s: float, points: Iterable[JsonValue]) -> list[_Curve]:
    """A curve of a parameter through points, if it is one of touch."""
    name = one.at("ParameterID").text()
    low = 0.0 if name == "HapticIntensityControl" else -1.0
    drawn = [
        (begin_s + _seconds(point, "Time"), min(max(point.at("ParameterValue").number(), low), 1.0))
        for point in points
    ]
    if name not in _NEUTRAL or not drawn:
        return []
    times_s, values = zip(*sorted(drawn, key=lambda point: point[0]))
    return [_Curve(name, times_s, values)]
