"""A play as files: its log, a table of one line a tick, and its sound.

The first columns of the log are those of a trace (`touchfield.medium.trace`): it is a trajectory to play again.

Of the sound left is a tone of `TONE_HZ` as loud as |F|, so that a force that rests is heard. Right is what the force
does faster than `BAND_HZ` begins, texture, friction and contacts, which is near to what one would hear of the device
itself: the force along its principal direction, band-passed. Each has its own full scale.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.adapters.effect_files import RATE_HZ, write_wav
from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument
from touchfield.medium.atomic import atomic_path
from touchfield.render.block import FLAGS

if TYPE_CHECKING:
    from pathlib import Path


COLUMNS: Final = (
    "t_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s",
    "field_x_n", "field_y_n", "field_z_n", "friction_x_n", "friction_y_n", "friction_z_n",
    "force_x_n", "force_y_n", "force_z_n",
    "qw", "qx", "qy", "qz", "field_torque_x_nm", "field_torque_y_nm", "field_torque_z_nm",
    "torque_x_nm", "torque_y_nm", "torque_z_nm", "gripper_m", "media_s", "buttons", "state",
)  # fmt: skip
"""Seconds since the first tick; the hand, the field's force and friction in the field's axes; the force that the
device got, in its own; how the grip was turned, in the device's axes; the torque of the field and that which the
device got, likewise; how far the gripper was open; the time of the medium; the buttons (bit n is button n); and what
was going on, words joined by +."""

_ROWS_AT_ONCE: Final = 1 << 14

TONE_HZ: Final = 220.0
BAND_HZ: Final = (30.0, 3000.0)
_ORDER: Final = 2


def write_log(path: Path, rows: NDArray[Any]) -> None:
    """Write rows of `touchfield.render.block.COLUMNS` as comma-separated text, whole or not at all."""
    words = {flags: _words(flags) for flags in np.unique(rows["flags"]).tolist()}
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(",".join(COLUMNS) + "\n")
        for first in range(0, len(rows), _ROWS_AT_ONCE):
            some = rows[first : first + _ROWS_AT_ONCE]
            numbers = np.column_stack(
                [some["time_s"], some["position_m"], some["velocity_m_s"], some["field_force_n"],
                 some["friction_n"], some["force_n"], some["orientation"], some["field_torque_nm"], some["torque_nm"],
                 some["gripper_m"], some["media_s"]]
            )  # fmt: skip
            for row, buttons, flags in zip(
                (numbers + 0.0).tolist(), some["buttons"].tolist(), some["flags"].tolist()
            ):
                file.write(",".join(f"{value:.9g}" for value in row) + f",{buttons},{words[flags]}\n")


def _words(flags: int) -> str:
    return "+".join(name for name, bit in FLAGS.items() if flags & bit) or "idle"


def sound_of(times_s: Float64s, forces_n: Float64s) -> tuple[Float64s, tuple[float, float]]:
    """The sound of forces over time, float64 [m, 2] from -1 to 1 at `RATE_HZ`, and the newtons at 1 in each channel.

    times_s : float64 [n], ascending, n at least 2. forces_n : float64 [n, 3].
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
    """Write rows of `touchfield.render.block.COLUMNS` as ``.wav``; a note on what it holds.

    InvalidArgument if there are fewer than two rows, or too many for a WAV; SourceError if the system refuses.
    """
    if len(rows) < 2:
        raise InvalidArgument("--wav", f"a play of {len(rows)} ticks", "at least 2", "Play longer.")
    samples, (full_n, fast_n) = sound_of(rows["time_s"].astype(np.float64), rows["force_n"].astype(np.float64))
    write_wav(path, [samples], 2, len(samples))
    return (
        f"the sound is {path}: left a tone as loud as |F| (1 is {full_n:.3g} N), right the force from {BAND_HZ[0]:g} "
        f"Hz on (1 is {fast_n:.3g} N)"
    )
