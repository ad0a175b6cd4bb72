"""Drives and forces as PCM in WAV: what game pads, OpenXR, web pages and sound cards take.

8000 samples a second of 16 bits, one channel an actuator (row by row from the top), or x, y and z of a force. An
actuator is a sine of its drive and frequency, both linear between frames and without a jump of phase; where none is
told it is `symbolic.DEFAULT_CARRIER_HZ`. A force is a share of its full scale: sound has no newtons.
"""

from __future__ import annotations

import wave
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.adapters.symbolic import filled_hz
from touchfield.errors import InvalidArgument
from touchfield.medium.atomic import atomic_path

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.adapters.symbolic import ArrayEffect

    Float64s = NDArray[np.float64]

__all__ = ["RATE_HZ", "write_wav", "write_wav_array"]

RATE_HZ: Final = 8000
MAX_HZ: Final = 0.45 * RATE_HZ
"""Of a sine; faster ones would be heard as slower."""

_MOST_BYTES: Final = 1 << 31
_MOST_CHANNELS: Final = 4096
_AT_ONCE: Final = 1 << 20
_FULL: Final = 32767


def write_wav(path: str | Path, samples: Iterable[Float64s], channels: int, count: int) -> None:
    """Write samples as ``.wav``, whole or not at all.

    Parameters
    ----------
    path : Path
    samples : iterable of float64 [n, channels]
        Parts in order, -1 to 1; what is beyond is cut.
    channels : int
    count : int
        Samples of a channel in all parts.

    Raises
    ------
    InvalidArgument
        If that makes no WAV: too many channels, or 2 GiB and more.
    SourceError
        If the system refuses to write.
    """
    if not 1 <= channels <= _MOST_CHANNELS or 2 * channels * count >= _MOST_BYTES:
        found = f"{channels} channels of {count} samples"
        expected = f"up to {_MOST_CHANNELS} channels, below 2 GiB"
        raise InvalidArgument("wav", found, expected, "Take fewer frames or a smaller array.")
    with atomic_path(Path(path)) as temporary, temporary.open("wb") as raw, wave.open(raw, "wb") as file:
        file.setnchannels(channels)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        for part in samples:
            file.writeframes(np.round(np.clip(part, -1, 1) * _FULL).astype("<i2").tobytes())


def write_wav_array(path: str | Path, effect: ArrayEffect) -> tuple[str, ...]:
    """Write the drives of an array as ``.wav``, one channel an actuator.

    Parameters
    ----------
    path : Path
    effect : ArrayEffect
        An only frame is held for the time of a frame.

    Returns
    -------
    tuple of str
        What is lost on the way.

    Raises
    ------
    InvalidArgument, SourceError
        As `write_wav`.
    """
    columns, rows, _ = effect.lattice
    count = max(1, round(max(1, len(effect) - 1) / effect.rate_hz * RATE_HZ) + 1)
    write_wav(path, _sines(effect, count), columns * rows, count)
    fast = effect.frequencies_hz is not None and float(effect.frequencies_hz.max()) > MAX_HZ
    return (f"Frequencies above {MAX_HZ:g} Hz are played at that.",) if fast else ()


def _sines(effect: ArrayEffect, count: int) -> Iterator[Float64s]:
    drives = effect.drives.reshape(len(effect), -1)
    hertz = None if effect.frequencies_hz is None else effect.frequencies_hz.reshape(len(effect), -1)
    known = np.minimum(filled_hz(drives, hertz), MAX_HZ)
    phase, step = np.zeros(drives.shape[1]), max(1, _AT_ONCE // drives.shape[1])
    for first in range(0, count, step):
        frames = np.arange(first, min(first + step, count)) / RATE_HZ * effect.rate_hz
        low = np.minimum(frames.astype(np.int64), len(effect) - 1)
        high, share = np.minimum(low + 1, len(effect) - 1), (frames - low)[:, None]
        amplitude = drives[low] + share * (drives[high] - drives[low])
        cycles = np.cumsum(known[low] + share * (known[high] - known[low]), axis=0) / RATE_HZ
        yield amplitude * np.sin(2 * np.pi * (phase + cycles))
        phase = (phase + cycles[-1]) % 1
