"""The vibration of an array of motors that stands for the sound of a movie.

Low frequencies vibrate on the chest: the upper three fifths of the rows, all columns. The drive is the
square root of their level over the loudest one of the movie: it doubles where the sound rises by 12 dB.
Levels more than 30 dB below the loudest do not vibrate. Drive and frequency change at most every `STEP_S`,
which small motors can follow, and by more than skin notices.

An onset vibrates on every motor for `PULSE_S`, at half to full drive by its flux over the greatest one. The
lower rows show onsets alone, where the chest vibrates already. All of this is our choice, felt by nobody yet.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Int32s
from touchfield.exchange.symbolic import DEFAULT_CARRIER_HZ
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.medium import VibrationFrame
from touchfield.sources.scene import UP_Y_AXES
from touchfield.sources.sound.analysis import HOP_S, SoundFeatures

RATE_HZ: Final = 1 / HOP_S
TAGS: Final = ("symbolic", "sound")
STEP_S: Final = 0.02
PULSE_S: Final = 0.025
CHEST: Final = 0.6  # fraction of the rows, from the top
MIN_REFERENCE: Final = 10 ** (-30 / 20)
"""Loudest level that is assumed at least, full scale 1: a movie that is quieter vibrates less."""

_MIN_DRIVE: Final = 10 ** (-15 / 20)  # of a level of -30 dB
_MIN_PULSE: Final = 0.5
_NOTICED: Final = 0.2
"""Relative change of an amplitude that skin notices; a frequency must change by more (human.toml)."""

_STEP, _PULSE = round(STEP_S / HOP_S), round(PULSE_S / HOP_S)


def low_drives(features: SoundFeatures) -> Float32s:
    """Drives of the low frequencies, 0 to 1, float32 [hops]."""
    levels = features.levels
    padded = np.pad(levels, (0, -len(levels) % _STEP)).reshape(-1, _STEP).max(axis=1)
    reference = max(float(levels.max(initial=0)), MIN_REFERENCE)
    drives = np.sqrt(padded / reference)
    drives[drives < _MIN_DRIVE] = 0
    return _held(drives)[: len(levels)]


def onset_drives(features: SoundFeatures) -> Float32s:
    """Drives of the onsets, 0 to 1, float32 [hops]: a pulse at each, which begins at the nearest hop."""
    drives = np.zeros(len(features.levels), np.float32)
    greatest = max((onset.flux for onset in features.onsets), default=1.0)
    for onset in features.onsets:
        start = round(onset.time_s / HOP_S)
        drives[start : start + _PULSE] = _MIN_PULSE + (1 - _MIN_PULSE) * onset.flux / greatest
    return drives


def chest_rows(rows: int) -> int:
    """Return the number of rows, from the top, that show low frequencies."""
    return math.ceil(CHEST * rows)


def sound_medium(features: SoundFeatures, grid: Grid, force_max_n: float) -> HapticMedium:
    """Return the vibration of a sound on (columns, rows, 1) samples, y up, at `RATE_HZ`; it has no forces."""
    make_vibration = _vibration_of(features, grid, force_max_n)
    nothing = ForceField.empty(grid)
    return HapticMedium(
        grid, RATE_HZ, len(features.levels), lambda i: nothing, axes=UP_Y_AXES, tags=TAGS,
        vibration=make_vibration,
    )  # fmt: skip


def _vibration_of(features: SoundFeatures, grid: Grid, force_max_n: float) -> Callable[[int], VibrationFrame]:
    columns, rows, _ = grid.shape
    everywhere = np.argwhere(np.ones((columns, rows, 1), bool)).astype(np.int32)
    chest = everywhere[everywhere[:, 1] >= rows - chest_rows(rows)]
    is_chest = everywhere[:, 1] >= rows - chest_rows(rows)
    low, pulses = low_drives(features), onset_drives(features)
    hertz = _held(np.rint(features.low_hz[::_STEP]))

    def frame(positions: Int32s, drives: Float32s, frequencies_hz: Float32s) -> VibrationFrame:
        return VibrationFrame(grid, positions, drives * np.float32(force_max_n), frequencies_hz)

    def vibration(i: int) -> VibrationFrame:
        if not pulses[i]:
            if not low[i]:
                return VibrationFrame.empty(grid)
            return frame(chest, np.full(len(chest), low[i]), np.full(len(chest), hertz[i]))
        is_low = is_chest & (low[i] > pulses[i])
        drives = np.where(is_low, low[i], pulses[i])
        return frame(everywhere, drives, np.where(is_low, hertz[i], np.float32(DEFAULT_CARRIER_HZ)))

    return vibration


def _held(steps: Float32s) -> Float32s:
    """Values of steps as values of hops; one stays until a later one differs noticeably."""
    held, latest = np.empty_like(steps), 0.0
    for n, value in enumerate(steps.tolist()):
        if value == 0 or abs(value - latest) > _NOTICED * latest:
            latest = value
        held[n] = latest
    return np.repeat(held, _STEP).astype(np.float32)
