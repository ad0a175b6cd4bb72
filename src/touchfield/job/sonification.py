"""A play as sound: what the device was told, in two channels.

Left is a tone of `TONE_HZ` as loud as |F|, so that a force that rests is heard. Right is what the force does faster
than `BAND_HZ` begins, texture, friction and contacts, which is near to what one would hear of the device itself: the
force along its principal direction, band-passed. Each has its own full scale.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.adapters.wav import RATE_HZ, write_wav
from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["BAND_HZ", "TONE_HZ", "sound_of", "write_sound"]

TONE_HZ: Final = 220.0
BAND_HZ: Final = (30.0, 3000.0)
_ORDER: Final = 2


def sound_of(
    times_s: NDArray[np.float64], forces_n: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """The sound of forces over time.

    Parameters
    ----------
    times_s : float64 [n]
        Ascending, n at least 2.
    forces_n : float64 [n, 3]

    Returns
    -------
    samples : float64 [m, 2]
        -1 to 1, `RATE_HZ` a second.
    full_scale_n : (float, float)
        Newtons at 1 in each channel.
    """
    from scipy.signal import butter, sosfilt

    at = np.arange(int((times_s[-1] - times_s[0]) * RATE_HZ) + 1) / RATE_HZ
    forces = np.stack([np.interp(at, times_s - times_s[0], of) for of in forces_n.T], axis=1)
    magnitude = np.linalg.norm(forces, axis=1)
    principal = np.linalg.eigh(forces.T @ forces)[1][:, -1]
    fast = sosfilt(butter(_ORDER, BAND_HZ, "bandpass", fs=RATE_HZ, output="sos"), forces @ principal)
    both = np.stack([magnitude * np.sin(2 * np.pi * TONE_HZ * at), fast], axis=1)
    scales = float(magnitude.max()), float(np.abs(fast).max())
    return both / [scale or 1.0 for scale in scales], scales


def write_sound(path: Path, rows: NDArray[Any]) -> str:
    """Write rows of `touchfield.render.log.COLUMNS` as ``.wav``; a note on what it holds.

    Raises
    ------
    InvalidArgument
        If there are fewer than two rows, or too many for a WAV.
    SourceError
        If the system refuses to write.
    """
    if len(rows) < 2:
        raise InvalidArgument("--wav", f"a play of {len(rows)} ticks", "at least 2", "Play longer.")
    samples, (full_n, fast_n) = sound_of(rows["time_s"].astype(np.float64), rows["force_n"].astype(np.float64))
    write_wav(path, [samples], 2, len(samples))
    return (
        f"the sound is {path}: left a tone as loud as |F| (1 is {full_n:.3g} N), right the force from {BAND_HZ[0]:g} "
        f"Hz on (1 is {fast_n:.3g} N)"
    )
