"""Writes the drives of actuators over time as ``.tact`` (bHaptics), ``.wav``, ``.haptic`` (Meta) or ``.ahap``
(Apple).

**.tact** (JSON, dot mode). No specification is published. The form follows what the vendor's open SDKs parse
(project with layout and tracks, a track's effects, their modes by position, dot mode with its feedback) and
projects of its designer that others have published: times in milliseconds from the start of the effect,
intensities 0 to 1, `VestFront` and `VestBack` with four columns and five rows each, index = 4 * row + column
from the top left, `Tactot` as the type of the layout.

A project is written as one effect on one track: its feedback is a list of spans, each with its active dots.

A vest with fewer rows is written to all 20 dots, as `touchfield.devices.drivers.bhaptics` drives it.

**Resolution.** Intensities are whole hundredths. A span is at least `MIN_SPAN_MS` long, the designer's
interval; each dot takes its largest drive of the frames in a span, so that no tap is lost. Times are whole
milliseconds. The format has no frequencies: a vest vibrates at its own.

**.wav**, PCM, is read by game pads, OpenXR, web pages and sound cards: 8000 samples a second of 16 bits, one
channel for each actuator (row by row from the top), or x, y and z of a force. An actuator is a sine of its
drive and frequency, both linear between frames and with continuous phase; without a frequency it is
`symbolic.DEFAULT_CARRIER_HZ`. A force is a fraction of its full scale, since sound has no newtons.

**.haptic** (JSON, version 1.0.0, of Haptics Studio). A clip has one continuous signal: an envelope of
amplitude, one of frequency (both 0 to 1, linear between points in seconds), and at a point of amplitude an
emphasis, a tap whose amplitude is at least the point's. That is the published data model of its open player;
relations to newtons and hertz are not published; `SingleTrack` defines those used here.

**.ahap**. A pattern has a continuous event for each 30 seconds, Apple's maximum, and curves of intensity and
sharpness of at most 16 points each. Curves act on all events, so that taps are part of the curve; a pattern
that consists of taps has transients and no curve.

``.haptic`` and ``.ahap`` contain one track, since a telephone or a controller has one actuator. With several
actuators, each frame has the drive and the frequency of the strongest one. A drive that rises from zero and
is back at zero within `TRANSIENT_S` is a tap; the rest is an envelope. Frequencies are fractions of
`SHARPNESS_HZ`.
"""

from __future__ import annotations

import json
import math
import wave
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield._version import __version__
from touchfield.arrays import Float64s, Int64s
from touchfield.atomic import atomic_path
from touchfield.devices.drivers.bhaptics import COLUMNS, POSITIONS, VEST_ROWS
from touchfield.errors import InvalidArgument, require_one_of
from touchfield.exchange.ahap import SHARPNESS_HZ
from touchfield.exchange.hjif_write import keyframe_indices
from touchfield.exchange.symbolic import TRANSIENT_S, filled_hz

if TYPE_CHECKING:
    from touchfield.exchange.symbolic import ArrayEffect
Points = tuple[tuple[float, float], ...]


ROWS: Final = 5
MIN_SPAN_MS: Final = 20
_PANELS: Final = ("front", "back")
_STEPS: Final = 100


def fits_vest(lattice: tuple[int, int, int]) -> bool:
    """Return True if the dots of a vest can show the columns and rows of an array."""
    columns, rows, depth = lattice
    return columns == COLUMNS and rows in VEST_ROWS and depth == 1


def write_tact(path: str | Path, effect: ArrayEffect, *, panel: str = "front") -> None:
    """Write the drives of a vest, four columns and five, four or two rows, as ``.tact``.

    `panel` is "front" or "back". Raises InvalidArgument if the array has other dimensions or there is no such
    panel; SourceError if the file cannot be written.
    """
    columns, rows, _ = effect.lattice
    if not fits_vest(effect.lattice):
        found, expected = f"{columns} columns, {rows} rows", f"{COLUMNS} columns, and 5, 4 or 2 rows"
        raise InvalidArgument("array", found, expected, "Take --device tactsuit-x40.")
    require_one_of("panel", panel, _PANELS)
    length_ms = max(1, round(1000 * len(effect) / effect.rate_hz))
    silence = [(0, length_ms, np.zeros((ROWS, COLUMNS), np.int64))]
    spans = list(_spans(effect)) or silence
    modes = {
        position: _dot_mode(spans if panel == side else silence) for side, position in zip(_PANELS, POSITIONS)
    }
    name = Path(path).stem
    layout = [
        {
            "index": COLUMNS * row + column,
            "x": round(column / (COLUMNS - 1), 3),
            "y": round(row / (ROWS - 1), 3),
        }
        for row in range(ROWS)
        for column in range(COLUMNS)
    ]
    effects = [{"name": name, "startTime": 0, "offsetTime": length_ms, "modes": modes}]
    project = {
        "name": name, "id": name, "description": "", "createdAt": 0, "updatedAt": 0,
        "mediaFileDuration": math.ceil(length_ms / 1000),
        "layout": {"name": "Tactot", "type": "Tactot", "layouts": dict.fromkeys(POSITIONS, layout)},
        "tracks": [{"enable": True, "effects": effects}],
    }  # fmt: skip
    size = {"durationMillis": length_ms, "intervalMillis": MIN_SPAN_MS, "size": COLUMNS * ROWS}
    _write(path, {"project": project, **size})


def _spans(effect: ArrayEffect) -> Iterator[tuple[int, int, Int64s]]:
    """Yield spans of equal drives: start and stop in ms, and hundredths, int64 [5, 4].

    Silent spans are left out.
    """
    frame_ms = 1000 / effect.rate_hz
    stride = max(1, math.ceil(MIN_SPAN_MS / frame_ms - 1e-9))
    firsts = np.arange(0, len(effect), stride)
    steps = np.round(np.maximum.reduceat(effect.drives, firsts, axis=0) * _STEPS).astype(np.int64)
    steps = steps[:, VEST_ROWS[effect.drives.shape[1]]]
    times = np.round(np.append(firsts, len(effect)) * frame_ms).astype(np.int64).tolist()
    changes = np.flatnonzero((steps[1:] != steps[:-1]).any(axis=(1, 2))) + 1
    for first, stop in zip([0, *changes.tolist()], [*changes.tolist(), len(steps)]):
        if steps[first].any():
            yield times[first], max(times[stop], times[first] + 1), steps[first]


def _dot_mode(spans: list[tuple[int, int, Int64s]]) -> dict[str, Any]:
    feedback = [
        {
            "startTime": start,
            "endTime": end,
            "playbackType": "NONE",
            "pointList": [
                {"index": COLUMNS * int(row) + int(column), "intensity": int(steps[row, column]) / _STEPS}
                for row, column in np.argwhere(steps)
            ],
        }
        for start, end, steps in spans
    ]
    path = {"movingPattern": "CONST_SPEED", "playbackType": "NONE", "visible": True, "pointList": []}
    return {
        "mode": "DOT_MODE",
        "dotMode": {"dotConnected": False, "feedback": feedback},
        "pathMode": {"feedback": [path]},
    }


# -- sound -------------------------------------------------------------------------------------------------

RATE_HZ: Final = 8000
MAX_HZ: Final = 0.45 * RATE_HZ
"""Highest frequency of a sine; higher ones would alias."""

_MAX_BYTES: Final = 1 << 31
_MAX_CHANNELS: Final = 4096
_CHUNK_SAMPLES: Final = 1 << 20
_FULL: Final = 32767


def write_wav(path: str | Path, samples: Iterable[Float64s], channels: int, count: int) -> None:
    """Write samples as ``.wav``, atomically.

    The samples come in parts, float64 [n, channels] from -1 to 1, and are clipped; `count` is the total
    number of samples of a channel. Raises InvalidArgument for too many channels, or 2 GiB and more;
    SourceError if the file cannot be written.
    """
    if not 1 <= channels <= _MAX_CHANNELS or 2 * channels * count >= _MAX_BYTES:
        found = f"{channels} channels of {count} samples"
        expected = f"up to {_MAX_CHANNELS} channels, below 2 GiB"
        raise InvalidArgument("wav", found, expected, "Take fewer frames or a smaller array.")
    with atomic_path(Path(path)) as temporary, temporary.open("wb") as raw, wave.open(raw, "wb") as file:
        file.setnchannels(channels)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        for part in samples:
            file.writeframes(np.round(np.clip(part, -1, 1) * _FULL).astype("<i2").tobytes())


def write_wav_array(path: str | Path, effect: ArrayEffect) -> tuple[str, ...]:
    """Write the drives of an array as ``.wav``; returns notes on what is lost.

    There is one channel for each actuator. A single frame lasts one frame period. Errors are those of
    `write_wav`.
    """
    columns, rows, _ = effect.lattice
    count = max(1, round(max(1, len(effect) - 1) / effect.rate_hz * RATE_HZ) + 1)
    write_wav(path, _sines(effect, count), columns * rows, count)
    is_too_fast = effect.frequencies_hz is not None and float(effect.frequencies_hz.max()) > MAX_HZ
    return (f"Frequencies above {MAX_HZ:g} Hz are played at that.",) if is_too_fast else ()


def _sines(effect: ArrayEffect, count: int) -> Iterator[Float64s]:
    drives = effect.drives.reshape(len(effect), -1)
    hertz = None if effect.frequencies_hz is None else effect.frequencies_hz.reshape(len(effect), -1)
    frequencies = np.minimum(filled_hz(drives, hertz), MAX_HZ)
    phase, step = np.zeros(drives.shape[1]), max(1, _CHUNK_SAMPLES // drives.shape[1])
    for first in range(0, count, step):
        frames = np.arange(first, min(first + step, count)) / RATE_HZ * effect.rate_hz
        low = np.minimum(frames.astype(np.int64), len(effect) - 1)
        high, weight = np.minimum(low + 1, len(effect) - 1), (frames - low)[:, None]
        amplitude = drives[low] + weight * (drives[high] - drives[low])
        cycles = (
            np.cumsum(frequencies[low] + weight * (frequencies[high] - frequencies[low]), axis=0) / RATE_HZ
        )
        yield amplitude * np.sin(2 * np.pi * (phase + cycles))
        phase = (phase + cycles[-1]) % 1


# -- clips -------------------------------------------------------------------------------------------------

DIGITS: Final = 4
_HALF_STEP: Final = 0.5 * 10.0**-DIGITS


@dataclass(frozen=True)
class SingleTrack:
    """Envelopes and taps of one actuator; amplitudes and sharpness are 0 to 1."""

    seconds: float
    amplitudes: Points  # (seconds, amplitude) of a polyline, at least two points, the first at 0
    sharpness: Points  # the same for sharpness
    taps: tuple[tuple[float, float, float], ...]  # (seconds, amplitude, sharpness), ascending
    notes: tuple[str, ...]  # on what is lost

    @classmethod
    def from_effect(cls, effect: ArrayEffect, has_taps: bool = True) -> SingleTrack:
        """Convert an effect to a track.

        A single frame lasts one frame period. Without `has_taps`, taps stay in the envelope.
        """
        frames, actuators = len(effect), effect.drives[0].size
        all_drives, frequencies = effect.drives.reshape(frames, -1), effect.frequencies_hz
        strongest = np.arange(frames), np.argmax(all_drives, axis=1)
        selected_hz = None if frequencies is None else frequencies.reshape(frames, -1)[strongest]
        hertz = filled_hz(all_drives[strongest], selected_hz).astype(np.float64)
        drives = all_drives[strongest].astype(np.float64)
        low, high = SHARPNESS_HZ
        notes: tuple[str, ...] = ()
        if actuators > 1:
            notes = (f"{actuators} actuators become one: the strongest at each moment is used.",)
        if hertz.min() < low or hertz.max() > high:
            notes += (f"Frequencies outside {low:g} to {high:g} Hz are written as the nearer limit.",)
        sharpness = np.clip((hertz - low) / (high - low), 0, 1)
        if frames == 1:
            drives, sharpness = np.repeat(drives, 2), np.repeat(sharpness, 2)
        drives, taps = _split_taps(drives, sharpness, effect.rate_hz) if has_taps else (drives, ())
        return cls(
            (len(drives) - 1) / effect.rate_hz, _points(drives, effect.rate_hz),
            _points(sharpness, effect.rate_hz), taps, notes,
        )  # fmt: skip


def _split_taps(
    drives: Float64s, sharpness: Float64s, rate_hz: float
) -> tuple[Float64s, tuple[tuple[float, float, float], ...]]:
    """Return the drives without taps, and the taps."""
    max_frames = int(TRANSIENT_S * rate_hz)  # longest tap, in frames
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (drives > 0).astype(np.int8), [0]])))
    envelope, taps = drives.copy(), []
    for first, stop in edges.reshape(-1, 2).tolist():
        if stop - first <= max_frames and stop < len(drives):
            peak = first + int(np.argmax(drives[first:stop]))
            taps.append(
                (peak / rate_hz, round(float(drives[peak]), DIGITS), round(float(sharpness[peak]), DIGITS))
            )
            envelope[first:stop] = 0
    return envelope, tuple(taps)


def _points(values: Float64s, rate_hz: float) -> Points:
    indices = keyframe_indices(np.arange(len(values)), np.round(values, DIGITS)[:, None], (_HALF_STEP,))
    return tuple((round(n / rate_hz, 6), round(float(values[n]), DIGITS)) for n in indices.tolist())


_MAX_CURVE_POINTS: Final = 16
_MAX_EVENT_S: Final = 30.0


def write_haptic(
    path: str | Path, effect: ArrayEffect, name: str = "", description: str = ""
) -> tuple[str, ...]:
    """Write the drives of an array as ``.haptic``; returns notes on what is lost.

    Raises SourceError if the file cannot be written.
    """
    track = SingleTrack.from_effect(effect)
    points: dict[float, dict[str, Any]] = {
        time: {"time": time, "amplitude": amplitude} for time, amplitude in track.amplitudes
    }
    for tap_s, amplitude, sharpness in track.taps:
        time = round(tap_s, 6)
        point = points.setdefault(time, {"time": time, "amplitude": 0.0})  # the envelope is zero there
        point["emphasis"] = {"amplitude": amplitude, "frequency": sharpness}
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
    _write(path, document, indent=1)
    return track.notes


def write_ahap(
    path: str | Path, effect: ArrayEffect, name: str = "", description: str = ""
) -> tuple[str, ...]:
    """Write the drives of an array as ``.ahap``; returns and raises as `write_haptic`."""
    track = SingleTrack.from_effect(effect)
    if any(amplitude > 0 for _, amplitude in track.amplitudes):
        track = SingleTrack.from_effect(effect, has_taps=False)
    pattern = [_event("HapticTransient", at, amplitude, sharpness) for at, amplitude, sharpness in track.taps]
    if not pattern:
        for start_s in np.arange(0.0, track.seconds - 1e-6, _MAX_EVENT_S).tolist():
            length = min(_MAX_EVENT_S, track.seconds - start_s)
            pattern.append(_event("HapticContinuous", start_s, 1.0, 0.0, length))
        for parameter, points in (("Intensity", track.amplitudes), ("Sharpness", track.sharpness)):
            pattern += _curves(f"Haptic{parameter}Control", points)
    metadata = {"Project": name, "Created": "", "Description": description}
    _write(path, {"Version": 1.0, "Metadata": metadata, "Pattern": pattern}, indent=1)
    return track.notes


def _event(
    kind: str, time_s: float, intensity: float, sharpness: float, length_s: float | None = None
) -> dict[str, Any]:
    duration = {} if length_s is None else {"EventDuration": round(length_s, 6)}
    values = (("HapticIntensity", intensity), ("HapticSharpness", sharpness))
    parameters = [{"ParameterID": name, "ParameterValue": value} for name, value in values]
    return {"Event": {"EventType": kind, "Time": round(time_s, 6), **duration, "EventParameters": parameters}}


def _curves(parameter: str, points: Points) -> Iterator[dict[str, Any]]:
    """Yield consecutive curves: the last point of one is the first of the next."""
    for first in range(0, max(1, len(points) - 1), _MAX_CURVE_POINTS - 1):
        chunk = points[first : first + _MAX_CURVE_POINTS]
        start_s = chunk[0][0]
        controls = [{"Time": round(time - start_s, 6), "ParameterValue": value} for time, value in chunk]
        yield {
            "ParameterCurve": {
                "ParameterID": parameter,
                "Time": start_s,
                "ParameterCurveControlPoints": controls,
            }
        }


def _write(path: str | Path, document: dict[str, Any], indent: int | None = None) -> None:
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(json.dumps(document, indent=indent) + "\n", encoding="utf-8")
