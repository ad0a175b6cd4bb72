"""The log of an interaction as a table for people and programs: one line a tick.

Its first columns are those of a trace (`touchfield.measure.trace`): a log can be played again as a trajectory.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.medium.atomic import atomic_path
from touchfield.render.log import FLAGS

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["COLUMNS", "write_log"]

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


def write_log(path: Path, rows: NDArray[Any]) -> None:
    """Write rows of `touchfield.render.log.COLUMNS` as comma-separated text, whole or not at all."""
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
