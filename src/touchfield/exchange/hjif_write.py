"""Writes HJIF, the JSON format of MPEG haptics (ISO/IEC 23090-31).

It writes arrays and forces. The files are valid by the published schemas, and within what the public
reference decoder accepts: integers wherever it reads integers, keyframes within 65535 ticks of their effect,
and a Curve as one effect of three keyframes or more.

**Resolution.** Times are whole ticks, amplitudes multiples of 1e-5 of full scale, frequencies whole hertz.
Keyframes are left out where a straight line between others passes within half such a step, so that a sample
on a tick is restored to within one step of amplitude and one hertz. A sample between two ticks is placed at
the nearer one. A thousand ticks a second are usual, and are also read correctly by a decoder that supports
only milliseconds.

**An array** is a perception of vibration with a channel for each actuator, with one VectorialWave: a sine of
the frequency and drive at each keyframe, both linear in between. A wave longer than 65535 ticks is split into
several effects, each of which starts where the one before ended, with its value and phase there. The
reference decoder uses the latest effect that has started, so that nothing is played twice. Targets count
columns from the left and rows from below (`Y` is "up" in the schema of vectors); the channels are in order of
rows from the top.

**An array with parts**, a force and a vibration of its own, has two perceptions: the vibration as above, and
the force in newtons along the array's normal, with one Curve for each actuator and the force of a full drive
as gain. It may last up to 65535 ticks, since a Curve has one effect.

**A force** is a perception with three channels, along x, y and z, each with one Curve, linear between
keyframes. The gain of a channel is its largest force: F = amplitude * gain newtons. The binary form quantises
an amplitude in steps of 2/255, so that the error is relative to the largest force of the axis, and an axis
without force stays zero.
"""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.atomic import atomic_path
from touchfield.errors import InvalidArgument, require_one_of, require_up_to
from touchfield.exchange.hjif_read import DEFAULT_TIMESCALE, MAX_VECTOR
from touchfield.exchange.symbolic import filled_hz
from touchfield.medium.medium import MAX_FREQUENCY_HZ

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from touchfield.exchange.symbolic import ArrayEffect


AMPLITUDE_STEP: Final = 1e-5
"""Amplitude step, of full scale."""

MAX_SPAN_TICKS: Final = 65535
"""Limit from the start of an effect to its last keyframe."""

_DIGITS: Final = 5
_LEVEL_1_CHANNELS: Final = 127
_PANELS: Final = {"front": ("Front", 0x10 | 0x20 | 0x40), "back": ("Back", 0x100 | 0x200)}
"""Body part and its bits: chest right and left with abdomen; upper and lower back."""

_MAX_FORCE_N: Final = 1e6
_MAX_PHASE: Final = 6.28318


def write_hjif_array(
    path: str | Path,
    effect: ArrayEffect,
    device_name: str = "",
    *,
    panel: str = "front",
    description: str = "",
    force_max_n: float = 1.0,
) -> None:
    """Write the drives of an array as ``.hjif``.

    Raises InvalidArgument if the array has more than 127 columns or rows, there is no such panel, or a frame
    takes less than one tick of a millisecond or more than 65535, or an effect with parts takes more than
    65535; SourceError if the file cannot be written.

    Parameters
    ----------
    path : Path
    effect : ArrayEffect
        A single frame lasts one frame period. An effect without frequencies is written with
        `DEFAULT_CARRIER_HZ`.
    device_name : str
        Name of the reference device.
    panel : str
        "front" or "back" of the chest.
    description : str
    force_max_n : float
        Force of a full drive, newtons; used for an effect with parts.
    """
    columns, rows, _ = effect.lattice
    if max(columns, rows) > MAX_VECTOR:
        raise InvalidArgument(
            "array", f"{columns} x {rows} actuators", "at most 127 columns and rows in HJIF"
        )
    require_one_of("panel", panel, _PANELS)
    gap = DEFAULT_TIMESCALE / effect.rate_hz
    if not 1 <= gap <= MAX_SPAN_TICKS:
        found = f"{effect.rate_hz:g} frames a second, {gap:g} ticks to a frame"
        raise InvalidArgument(
            "array", found, f"1 to {MAX_SPAN_TICKS} ticks to a frame, of a millisecond each"
        )
    ticks = np.round(np.arange(max(len(effect), 2)) * gap).astype(np.int64)
    if effect.parts is not None and ticks[-1] > MAX_SPAN_TICKS:
        found = f"a force and a vibration of {ticks[-1] / DEFAULT_TIMESCALE:g} s"
        raise InvalidArgument("array", found, f"at most {MAX_SPAN_TICKS / DEFAULT_TIMESCALE:g} s")
    side, mask = _PANELS[panel]

    size = f"{columns} x {rows} actuators"

    def channels(is_force: bool) -> Iterator[dict[str, Any]]:
        force_part, vibration_part = effect.parts or (effect.drives, effect.drives)
        for row, column in np.ndindex(rows, columns):
            hertz = None if effect.frequencies_hz is None else effect.frequencies_hz[:, row, column]
            drives = (force_part if is_force else vibration_part)[:, row, column]
            normal = {"direction": {"X": 0, "Y": 0, "Z": MAX_VECTOR}} if is_force else {}
            yield {
                "description": f"row {row + 1} from the top, column {column + 1} from the left",
                "gain": force_max_n if is_force else 1.0,
                "mixing_coefficient": 1.0,
                "body_part_mask": mask,
                "actuator_resolution": {"X": columns, "Y": rows, "Z": 1},
                "body_part_target": ["Chest", side],
                "actuator_target": [{"X": column, "Y": rows - 1 - row, "Z": 0}],
                **normal,
                "bands": [
                    _force_curve(ticks, drives)
                    if is_force
                    else _wave(ticks, drives, filled_hz(drives, hertz))
                ],
            }

    perceptions = [("Vibrotactile", f"{size}, {panel} of the chest", channels(is_force=False))]
    if effect.parts is not None:
        require_up_to(_MAX_FORCE_N, force_max_n=force_max_n)
        text = f"force along the normal of {size}, {panel} of the chest, newtons"
        perceptions.append(("Force", text, channels(is_force=True)))
    _write(
        path, description or f"array of {size}", DEFAULT_TIMESCALE, perceptions, device_name, columns * rows
    )


def write_hjif_force(
    path: str | Path,
    forces_n: Float64s,
    timescale: int,
    *,
    device_name: str = "",
    full_scale_n: float = 1.0,
    description: str = "",
) -> None:
    """Write a force over time as ``.hjif``.

    Raises InvalidArgument if the full scale is out of range; SourceError if the file cannot be written.

    Parameters
    ----------
    path : Path
    forces_n : float64 [n, 3]
        Newtons along x, y, z, one sample a tick; at least 1 and at most 65536.
    timescale : int
        Ticks a second, 1 to 48000.
    device_name : str
        Name of the reference device.
    full_scale_n : float
        Newtons that are written as 1; with 1 the file is in newtons. Readers that play newtons as sound, such
        as the reference synthesiser, clip them at 1; with another value the file contains fractions of it.
    description : str
    """
    require_up_to(_MAX_FORCE_N, full_scale_n=full_scale_n)
    peaks_n = np.abs(forces_n).max(axis=0)
    amplitudes = np.clip(forces_n / np.where(peaks_n > 0, peaks_n, 1), -1, 1)
    channels = [
        {
            "description": f"force along {name.lower()}",
            "gain": float(peaks_n[axis]) / full_scale_n,
            "mixing_coefficient": 1.0,
            "body_part_mask": 0,
            "direction": {other: 127 * (other == name) for other in "XYZ"},
            "bands": [_curve(amplitudes[:, axis], timescale)],
        }
        for axis, name in enumerate("XYZ")
    ]
    perception = "Force", f"force at a point, in units of {full_scale_n:g} N", channels
    _write(path, description or "force over time", timescale, [perception], device_name, len(channels))


def _write(
    path: str | Path,
    description: str,
    timescale: int,
    perceptions: Sequence[tuple[str, str, Iterable[dict[str, Any]]]],
    device_name: str,
    channel_count: int,
) -> None:
    """Write perceptions (modality, description, channels), a channel at a time.

    An array may be too large to be in memory as JSON at once. `channel_count` is that of one perception.
    """
    root: dict[str, Any] = {
        "version": "2023",
        "profile": "Main",
        "level": 1 if channel_count <= _LEVEL_1_CHANNELS else 2,
        "date": datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "description": description,
        "timescale": timescale,
        "avatars": [],
        "syncs": [],
    }
    devices = {"reference_devices": [{"id": 1, "name": device_name}]} if device_name else {}
    device = {"reference_device_id": 1} if device_name else {}
    with atomic_path(Path(path)) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps(root)[:-1] + ', "perceptions": [')
        for index, (modality, text, channels) in enumerate(perceptions):
            fields = {
                "id": index, "avatar_id": 0, "unit_exponent": -3, "perception_unit_exponent": 0,
                "perception_modality": modality, "description": text, **devices, "effect_library": [],
            }  # fmt: skip
            file.write((",\n" if index else "") + json.dumps(fields)[:-1] + ', "channels": [')
            for n, channel in enumerate(channels):
                file.write(("" if n == 0 else ",") + "\n" + json.dumps({"id": n, **device, **channel}))
            file.write("]}")
        file.write("]}\n")


def _wave(ticks: Int64s, drives: Float32s, hertz: Float32s) -> dict[str, Any]:
    """Return the VectorialWave of one actuator."""
    amplitudes = np.round(drives.astype(np.float64), _DIGITS)
    samples = np.stack([amplitudes, np.maximum(np.round(hertz.astype(np.float64)), 1)], axis=1)
    low = min(int(samples[:, 1].min()), int(MAX_FREQUENCY_HZ) - 1)
    return {
        "band_type": "VectorialWave",
        "lower_frequency_limit": low,
        "upper_frequency_limit": max(int(samples[:, 1].max()), low + 1),
        "effects": list(_effects(ticks, np.broadcast_to(samples, (len(ticks), 2)))),
    }


def _effects(ticks: Int64s, samples: Float64s) -> Iterator[dict[str, Any]]:
    """Yield consecutive effects, none longer than 65535 ticks."""
    first, phase = 0, 0.0
    while first < len(ticks) - 1:
        last = int(np.searchsorted(ticks, ticks[first] + MAX_SPAN_TICKS, side="right")) - 1
        indices = first + keyframe_indices(
            ticks[first : last + 1], samples[first : last + 1], (AMPLITUDE_STEP / 2, 0.5)
        )
        keyframes = [
            {"relative_position": tick, "amplitude_modulation": amplitude, "frequency_modulation": int(hertz)}
            for tick, (amplitude, hertz) in zip(
                (ticks[indices] - ticks[first]).tolist(), samples[indices].tolist()
            )
        ]
        yield _effect(int(ticks[first]), min(round(phase, _DIGITS), _MAX_PHASE), keyframes)
        seconds, hertz = np.diff(ticks[indices]) / DEFAULT_TIMESCALE, samples[indices, 1]
        cycles = float(seconds @ (hertz[1:] + hertz[:-1])) / 2
        first, phase = last, math.fmod(phase + 2 * math.pi * cycles, 2 * math.pi)


def _effect(position: int, phase: float, keyframes: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "effect_type": "Basis",
        "position": position,
        "phase": phase,
        "base_signal": "Sine",
        "keyframes": keyframes,
    }


def _curve(values: Float64s, timescale: int) -> dict[str, Any]:
    """Return the Curve of one axis, from one value a tick."""
    effect = _curve_effect(np.arange(len(values)), np.round(values, _DIGITS))
    return _curve_band(effect, max(1, min(timescale // 2, int(MAX_FREQUENCY_HZ))))


def _force_curve(ticks: Int64s, drives: Float32s) -> dict[str, Any]:
    """Return the Curve of one actuator."""
    samples: Float64s = np.broadcast_to(np.round(drives.astype(np.float64), _DIGITS), len(ticks))
    return _curve_band(_curve_effect(ticks, samples), DEFAULT_TIMESCALE // 2)


def _curve_band(effect: dict[str, Any], limit_hz: int) -> dict[str, Any]:
    return {
        "band_type": "Curve",
        "curve_type": "Linear",
        "lower_frequency_limit": 0,
        "upper_frequency_limit": limit_hz,
        "effects": [effect],
    }


def _curve_effect(ticks: Int64s, amplitudes: Float64s) -> dict[str, Any]:
    """Return the effect of a Curve, of three keyframes or more, from rounded amplitudes at ticks."""
    indices = keyframe_indices(ticks, amplitudes[:, None], (AMPLITUDE_STEP / 2,))
    line = list(zip((ticks[indices] - ticks[0]).tolist(), amplitudes[indices].tolist()))
    if len(line) == 2 and line[1][0] > 1:
        # the reference decoder fails on a Curve of two keyframes: add one on the line, not rounded
        middle, rise = line[1][0] // 2, line[1][1] - line[0][1]
        line.insert(1, (middle, line[0][1] + rise * middle / line[1][0]))
    # too short to be divided: repeat the last keyframe
    line += [(line[-1][0] + n, line[-1][1]) for n in range(1, 4 - len(line))]
    keyframes = [{"relative_position": tick, "amplitude_modulation": value} for tick, value in line]
    return _effect(int(ticks[0]), 0.0, keyframes)


def keyframe_indices(ticks: Int64s, values: Float64s, tolerances: Sequence[float]) -> Int64s:
    """Select keyframes so that lines between them are within a tolerance of all samples.

    The first and the last sample are always keyframes. Each line extends as far as the tolerances allow (the
    cone of slopes that pass all samples on the way). The time is proportional to the number of samples.

    Returns int64 [k]: indices of the keyframes, ascending.

    Parameters
    ----------
    ticks : int64 [n]
        Ascending, n at least 1.
    values : float64 [n, m]
        Samples of m signals that share their keyframes.
    tolerances : m floats
        Largest distance of each signal from the lines.
    """
    inner = (values[1:-1] == values[:-2]).all(axis=1) & (values[1:-1] == values[2:]).all(axis=1)
    candidates = np.flatnonzero(np.concatenate([[True], ~inner, [True]])[: len(ticks)])
    if len(candidates) < 3:
        return candidates
    # a sample between two equal samples lies on any line within the tolerance of both
    times, points, selected = ticks[candidates].tolist(), values[candidates].tolist(), [0]
    signals = range(len(tolerances))
    low, high = [-np.inf] * len(tolerances), [np.inf] * len(tolerances)
    for i in range(1, len(times)):
        span = times[i] - times[selected[-1]]
        rises = [(points[i][s] - points[selected[-1]][s]) / span for s in signals]
        if not all(low[s] <= rises[s] <= high[s] for s in signals):
            selected.append(i - 1)
            span = times[i] - times[i - 1]
            rises = [(points[i][s] - points[i - 1][s]) / span for s in signals]
            low, high = [-np.inf] * len(tolerances), [np.inf] * len(tolerances)
        for s in signals:
            low[s] = max(low[s], rises[s] - tolerances[s] / span)
            high[s] = min(high[s], rises[s] + tolerances[s] / span)
    selected.append(len(times) - 1)
    return candidates[selected]
