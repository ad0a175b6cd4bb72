"""Writes and reads the log of a playback as comma-separated text, a row for each tick."""

from __future__ import annotations

import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.atomic import atomic_path
from touchfield.errors import SourceError
from touchfield.files import readable, require_plain
from touchfield.render.block import FLAGS

MAX_ROWS: Final = 1 << 22  # 70 minutes at 1 kHz, 1 GB
ROWS_AT_ONCE: Final = 1 << 14
"""Rows that are converted to text at the same time, which bounds memory."""

COLUMNS: Final = (
    "t_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s",
    "field_x_n", "field_y_n", "field_z_n", "friction_x_n", "friction_y_n", "friction_z_n",
    "force_x_n", "force_y_n", "force_z_n",
    "qw", "qx", "qy", "qz", "field_torque_x_nm", "field_torque_y_nm", "field_torque_z_nm",
    "torque_x_nm", "torque_y_nm", "torque_z_nm", "gripper_m", "media_s", "buttons", "state",
)  # fmt: skip
"""Columns of the text.

They are: seconds since the first tick; position and velocity of the hand, force of the field and friction, in
the field's axes; the force sent to the device, in the device's axes; orientation of the grip, torque of the
field and torque sent to the device, in the device's axes; opening of the gripper; time of the medium; buttons
(bit n is button n); and the state, as words joined by +.
"""

_LOGGED: Final = (
    "time_s", "position_m", "velocity_m_s", "field_force_n", "friction_n", "force_n", "orientation",
    "field_torque_nm", "torque_nm", "gripper_m", "media_s",
)  # fmt: skip
_READ_COLUMNS: Final = (
    *("media_s", "x_m", "y_m", "z_m", "field_x_n", "field_y_n", "field_z_n"),
    *("friction_x_n", "friction_y_n", "friction_z_n"),
)
_MAX_ROW_BYTES: Final = 640
_EXPECTED: Final = "a log of `touchfield play --log OUT.csv`"


def state_texts(flags: Iterable[int]) -> dict[int, str]:
    """Return the state that each value of the flags of a tick stands for, as words joined by +."""
    return {
        value: "+".join(name for name, bit in FLAGS.items() if value & bit) or "idle" for value in set(flags)
    }


def write_log(path: Path, rows: NDArray[Any]) -> None:
    """Write ticks as `COLUMNS`, atomically.

    rows : `touchfield.render.block.COLUMNS` [n]

    Raises InvalidArgument or SourceError if the file cannot be written.
    """
    states = state_texts(np.unique(rows["flags"]).tolist())
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(",".join(COLUMNS) + "\n")
        for first in range(0, len(rows), ROWS_AT_ONCE):
            some = rows[first : first + ROWS_AT_ONCE]
            numbers = np.column_stack([some[name] for name in _LOGGED]) + 0.0
            for row, buttons, flags in zip(
                numbers.tolist(), some["buttons"].tolist(), some["flags"].tolist()
            ):
                file.write(",".join(f"{value:.9g}" for value in row) + f",{buttons},{states[flags]}\n")


def read_log(path: Path) -> Float64s:
    """Read a log of ``play``, float64 [n, 7].

    Columns are the time of the medium, the position of the hand, metres, and the force of the field with
    friction, newtons. Raises SourceError if the file is none, or too large.
    """
    require_plain(path, _EXPECTED)
    with readable(path, _EXPECTED):
        if path.stat().st_size > MAX_ROWS * _MAX_ROW_BYTES:
            found = f"{path.stat().st_size:,} bytes"
            raise SourceError(str(path), found, f"at most {MAX_ROWS * _MAX_ROW_BYTES:,} bytes")
        with path.open(encoding="utf-8", errors="replace") as file:
            names = file.readline(1 << 12).strip().split(",")
            if missing := [name for name in _READ_COLUMNS if name not in names]:
                raise SourceError(str(path), f"no column {missing[0]}", _EXPECTED)
            columns = [names.index(name) for name in _READ_COLUMNS]
            try:
                with warnings.catch_warnings(action="ignore"):  # of a file without a row
                    rows = np.loadtxt(file, delimiter=",", usecols=columns, ndmin=2, max_rows=MAX_ROWS)
            except ValueError as error:
                raise SourceError(str(path), f"a row that is no tick ({error})", _EXPECTED) from None
    rows = rows[np.isfinite(rows).all(axis=1)]
    if not len(rows):
        raise SourceError(str(path), "no tick", _EXPECTED)
    return np.column_stack([rows[:, :4], rows[:, 4:7] + rows[:, 7:]])
