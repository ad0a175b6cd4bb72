"""An array of actuators as HJIF (ISO/IEC 23090-31); the resolution is that of `hjif_format`.

One perception of vibration with a channel for each actuator, and in it one VectorialWave: a sine of the frequency and
drive at each keyframe, both linear in between. A medium without a vibration band is told at `DEFAULT_CARRIER_HZ`.

What is longer than 65535 ticks goes into several effects, each of which begins where the one before it ended, with
the value and the phase that it had there. The reference decoder takes the latest effect that has begun, so that
nothing is heard twice; of a VectorialWave it takes one at any position, of a Curve only at 0.

Targets count columns from the left and rows from below (`Y` is "up" in the schema of vectors); the channels lie row
by row from the top.
"""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.adapters.hjif_format import (
    AMPLITUDE_DIGITS,
    AMPLITUDE_STEP,
    DEFAULT_TIMESCALE,
    MAX_CHANNELS,
    MAX_SPAN_TICKS,
    checked_timescale,
    thinned,
    write_document,
)
from touchfield.errors import InvalidArgument
from touchfield.medium.vibration import MAX_FREQUENCY_HZ

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from touchfield.adapters.symbolic import ArrayEffect

    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]
    Int64s = NDArray[np.int64]

__all__ = ["DEFAULT_CARRIER_HZ", "write_hjif_array"]

DEFAULT_CARRIER_HZ: Final = 150.0
"""Where the medium names no frequency: within the best of what skin feels, and of what small motors shake at."""

_PANELS: Final = {"front": ("Front", 0x10 | 0x20 | 0x40), "back": ("Back", 0x100 | 0x200)}
"""Body part, and its bits: chest right and left with abdomen, upper and lower back."""

_LARGEST_PHASE: Final = 6.28318
_LARGEST_TARGET: Final = 127


def write_hjif_array(
    path: str | Path,
    effect: ArrayEffect,
    device_name: str = "",
    *,
    panel: str = "front",
    carrier_hz: float = DEFAULT_CARRIER_HZ,
    timescale: int = DEFAULT_TIMESCALE,
    description: str = "",
    date: datetime | None = None,
) -> None:
    """Write the drives of an array as ``.hjif``.

    Parameters
    ----------
    path : Path
    effect : ArrayEffect
        An effect of one frame is held for the time of a frame.
    device_name : str
        Goes in as the reference device.
    panel : str
        "front" or "back" of the chest.
    carrier_hz : float
        Frequency where the effect tells none, Hz.
    timescale : int
        Ticks a second, 1 to 48000; a frame must take at least one tick, and at most 65535.
    description : str
    date : datetime, optional
        Of making; now, where it is not given.

    Raises
    ------
    InvalidArgument
        If an option is out of range, or the array has more than 127 columns or rows.
    SourceError
        If the system refuses to write.
    """
    columns, rows, _ = effect.lattice
    if max(columns, rows) > _LARGEST_TARGET or columns * rows > MAX_CHANNELS:
        raise InvalidArgument("array", f"{columns} x {rows} actuators", "at most 127 columns and rows in HJIF")
    if panel not in _PANELS:
        raise InvalidArgument("panel", repr(panel), " or ".join(_PANELS))
    if not 1 <= carrier_hz <= MAX_FREQUENCY_HZ:
        raise InvalidArgument("carrier_hz", repr(carrier_hz), f"1 to {MAX_FREQUENCY_HZ:g} Hz")
    ticks = _frame_ticks(len(effect), effect.rate_hz, timescale)
    side, mask = _PANELS[panel]

    def channels() -> Iterator[dict[str, Any]]:
        for row in range(rows):
            for column in range(columns):
                hertz = None if effect.frequencies_hz is None else effect.frequencies_hz[:, row, column]
                yield {
                    "description": f"row {row + 1} from the top, column {column + 1} from the left",
                    "gain": 1.0,
                    "mixing_coefficient": 1.0,
                    "body_part_mask": mask,
                    "actuator_resolution": {"X": columns, "Y": rows, "Z": 1},
                    "body_part_target": ["Chest", side],
                    "actuator_target": [{"X": column, "Y": rows - 1 - row, "Z": 0}],
                    "bands": [_wave(ticks, effect.drives[:, row, column], hertz, carrier_hz, timescale)],
                }

    write_document(
        Path(path),
        description=description or f"array of {columns} x {rows} actuators",
        date=date,
        timescale=timescale,
        perception={
            "perception_modality": "Vibrotactile",
            "description": f"{columns} x {rows} actuators, {panel} of the chest",
        },
        device_name=device_name,
        channels=channels(),
        channel_count=columns * rows,
    )


def _frame_ticks(frames: int, rate_hz: float, timescale: int) -> Int64s:
    """The tick of each frame, and one more behind the only one."""
    gap = checked_timescale(timescale) / rate_hz
    if not 1 <= gap <= MAX_SPAN_TICKS:
        found = f"{timescale} ticks a second for {rate_hz:g} frames a second"
        raise InvalidArgument("timescale", found, f"1 to {MAX_SPAN_TICKS} ticks to a frame")
    return np.round(np.arange(max(frames, 2)) * gap).astype(np.int64)


def _wave(
    ticks: Int64s, drives: Float32s, hertz: Float32s | None, carrier_hz: float, timescale: int
) -> dict[str, Any]:
    """The VectorialWave of one actuator."""
    amplitudes = np.round(drives.astype(np.float64), AMPLITUDE_DIGITS)
    values = np.stack([amplitudes, _whole_hertz(drives, hertz, carrier_hz)])
    low, high = int(values[1].min()), int(values[1].max())
    low = min(low, int(MAX_FREQUENCY_HZ) - 1)
    samples = np.broadcast_to(values.T, (len(ticks), 2)) if len(drives) == 1 else values.T
    return {
        "band_type": "VectorialWave",
        "lower_frequency_limit": low,
        "upper_frequency_limit": max(high, low + 1),
        "effects": list(_effects(ticks, samples, timescale)),
    }


def _whole_hertz(drives: Float32s, hertz: Float32s | None, carrier_hz: float) -> Float64s:
    """A frequency for every frame: where none is told, that of the last frame which tells one, else of the first."""
    known = np.zeros(0, np.int64) if hertz is None else np.flatnonzero((hertz > 0) & (drives > 0))
    if hertz is None or not len(known):
        return np.full(len(drives), np.round(carrier_hz), np.float64)
    place = np.maximum(np.searchsorted(known, np.arange(len(drives)), side="right") - 1, 0)
    return np.maximum(np.round(hertz[known[place]].astype(np.float64)), 1)


def _effects(ticks: Int64s, samples: Float64s, timescale: int) -> Iterator[dict[str, Any]]:
    """Effects end to end, none longer than 65535 ticks."""
    first, phase = 0, 0.0
    while first < len(ticks) - 1:
        last = int(np.searchsorted(ticks, ticks[first] + MAX_SPAN_TICKS, side="right")) - 1
        kept = first + thinned(ticks[first : last + 1], samples[first : last + 1], (AMPLITUDE_STEP / 2, 0.5))
        yield {
            "effect_type": "Basis",
            "position": int(ticks[first]),
            "phase": min(round(phase, AMPLITUDE_DIGITS), _LARGEST_PHASE),
            "base_signal": "Sine",
            "keyframes": [
                {"relative_position": tick, "amplitude_modulation": amplitude, "frequency_modulation": int(hertz)}
                for tick, (amplitude, hertz) in zip((ticks[kept] - ticks[first]).tolist(), samples[kept].tolist())
            ],
        }
        seconds, hertz = np.diff(ticks[kept]) / timescale, samples[kept, 1]
        cycles = float(seconds @ (hertz[1:] + hertz[:-1])) / 2
        first, phase = last, math.fmod(phase + 2 * math.pi * cycles, 2 * math.pi)
