"""Patterns of an array of actuators for a situation: they differ by where and how the actuators vibrate.

surface     The column of the direction, all rows but the lowest, without a pause: from 0.25 at the distance
            of `GuideSpec.warn_m` to 0.5 at 0.5 m, and with the time to contact up to 1.
drop        The lowest row in front, 5 pulses a second.
step up     The lowest row in front, 2 pulses a second.
unknown     The column of the direction, one row above the lowest, a weak tick every 2 s; if no ground is
            found, the lowest row in front as well.
warning     The whole top row and the whole lowest row, at the same time, twice a second; nothing else. Frames
            are missing, late or blind: nothing is known.

A free direction is off. Rates up to 5 Hz are told apart without effort, and motors of a vest follow them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument
from touchfield.guidance.guide import Situation, State
from touchfield.guidance.spec import GuideSpec

if TYPE_CHECKING:
    from touchfield.devices import Device

FRONT: Final = (2, 3, 4, 5)  # directions from the wearer's left to the right, columns of the front panel
BACK: Final = (1, 0, 7, 6)

_NEAR_DRIVE, _CLOSE_DRIVE, _CLOSE_M = 0.25, 0.5, 0.5
_FULL_CONTACT_S: Final = 1.0
_DROP_HZ, _STEP_HZ, _WARNING_HZ = 5.0, 2.0, 2.0
_DROP_DRIVE, _STEP_DRIVE, _WARNING_DRIVE, _TICK_DRIVE = 1.0, 0.7, 0.8, 0.15
_TICK_EVERY_S, _TICK_S = 2.0, 0.1


class Patterns:
    """The patterns of an array of the profile `device`.

    Of an array with one panel, the four directions behind the wearer are not shown (`notes`). Raises
    `InvalidArgument` for a device that is no array, or whose actuators do not vibrate.
    """

    def __init__(self, device: Device, spec: GuideSpec | None = None) -> None:
        if not device.is_array or device.shows != "force":
            found = "a point" if not device.is_array else "pins, which show heights"
            expected = "an array of actuators that vibrate, such as tactsuit-x40"
            raise InvalidArgument("device", f"{device.name}, {found}", expected)
        self.spec, self.device = spec or GuideSpec(), device
        columns, rows, _ = device.lattice
        self.shape = (device.panels, rows, columns)
        front = FRONT if self.spec.first_column == "left" else FRONT[::-1]
        self._columns = [(0, c, d) for c, d in _columns_of(columns, front)]
        if device.panels > 1:
            self._columns += [(1, c, d) for c, d in _columns_of(columns, BACK)]
        self.notes = (
            *(("It has one panel: the four directions behind are not shown.",) if device.panels == 1 else ()),
            *(("It has one row: only the rhythm tells steps from surfaces.",) if rows == 1 else ()),
        )

    def drives(self, situation: Situation, now_s: float) -> Float32s:
        """Return the drives of a situation at a time, float32 [panels, rows, columns], 0 to 1."""
        if situation.is_blind:
            return self.warning(now_s)
        drives = np.zeros(self.shape, np.float32)
        upper = max(1, self.shape[1] - 1)
        has_tick = now_s % _TICK_EVERY_S < _TICK_S
        for panel, column, direction in self._columns:
            state = situation.states[direction]
            if state == State.NEAR:
                near = drives[panel, :upper, column]
                strength = self.strength(
                    float(situation.distances_m[direction]), float(situation.contact_s[direction])
                )
                np.maximum(near, strength, out=near)
            elif state == State.UNKNOWN and has_tick:
                tick = drives[panel, upper - 1 : upper, column]
                np.maximum(tick, _TICK_DRIVE, out=tick)
        low = drives[0, -1]
        np.maximum(low, self._ground_drive(situation, now_s, has_tick), out=low)
        return drives

    def warning(self, now_s: float) -> Float32s:
        """Return the drives of the warning pattern, float32 [panels, rows, columns]."""
        drives = np.zeros(self.shape, np.float32)
        drives[:, (0, -1)] = _WARNING_DRIVE if _is_on(now_s, _WARNING_HZ) else 0.0
        return drives

    def strength(self, distance_m: float, contact_s: float) -> float:
        """Return the drive of a surface at a distance and time to contact, 0.25 to 1."""
        limit_m, limit_s = self.spec.warn_m, max(self.spec.contact_s, _FULL_CONTACT_S + 0.1)
        nearness = np.clip((limit_m - distance_m) / max(limit_m - _CLOSE_M, 0.1), 0.0, 1.0)
        urgency = np.clip((limit_s - contact_s) / (limit_s - _FULL_CONTACT_S), 0.0, 1.0)
        by_distance = _NEAR_DRIVE + (_CLOSE_DRIVE - _NEAR_DRIVE) * nearness
        return float(max(by_distance, _NEAR_DRIVE + (1.0 - _NEAR_DRIVE) * urgency))

    def _ground_drive(self, situation: Situation, now_s: float, has_tick: bool) -> float:
        """Return the drive of the lowest row in front."""
        limit_m = max(self.spec.warn_m, 2.0)
        if situation.ahead.drop_m < limit_m:
            return _DROP_DRIVE if _is_on(now_s, _DROP_HZ) else 0.0
        if situation.ahead.step_m < limit_m:
            return _STEP_DRIVE if _is_on(now_s, _STEP_HZ) else 0.0
        return _TICK_DRIVE if has_tick and not situation.ground.is_seen else 0.0


def _is_on(now_s: float, rate_hz: float) -> bool:
    return now_s * rate_hz % 1.0 < 0.5


def _columns_of(columns: int, directions: tuple[int, ...]) -> list[tuple[int, int]]:
    """Return pairs of column and direction: directions share columns, or columns a direction."""
    if columns >= len(directions):
        return [(c, directions[c * len(directions) // columns]) for c in range(columns)]
    return [(i * columns // len(directions), d) for i, d in enumerate(directions)]
