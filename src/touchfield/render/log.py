"""The log of the ticks: a ring of rows that the servo writes and the player drains.

A row is written by every tick and never waits: where nobody drains, the oldest are lost, and the loss is counted.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.render.control import LOG, LOG_ROWS, LOG_WRITTEN
from touchfield.render.memory import WORD, Memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["COLUMNS", "FLAGS", "ROW_WORDS", "TickLog"]

_TRIPLES: Final = ("position_m", "velocity_m_s", "field_force_n", "friction_n", "force_n")

_TIMES: Final = ("time_s", "media_s")

COLUMNS: Final = np.dtype(
    [
        *((name, np.float64) for name in _TIMES),
        *((name, np.float64, (3,)) for name in _TRIPLES),
        ("flags", np.int64),
        ("orientation", np.float64, (4,)),
        ("field_torque_nm", np.float64, (3,)),
        ("torque_nm", np.float64, (3,)),
        ("buttons", np.int64),
        ("gripper_m", np.float64),
    ]
)
"""A row: time since the first tick; media time; position, velocity, field force and friction in the field's axes;
the force that the device got in its own; and `FLAGS`. Then how the grip is turned (w, x, y, z, the device's axes),
the torque of the field on the tool in the field's axes, the torque that the device got in its own, buttons (bit n is
button n), and how far the gripper is open."""

ROW_WORDS: Final = COLUMNS.itemsize // WORD

FLAGS: Final = {"running": 1, "waiting": 2, "stalled": 4, "ended": 8, "stopping": 16, "silent": 32, "paused": 64}
"""Bits of `flags`: the media clock runs; waits for first frames; underrun; over; on the way to zero after a stop; no
sign of life from the player; paused."""


class TickLog:
    """Rows taken out of the ring, at most `rows` of them kept, the oldest given up first.

    Attributes
    ----------
    lost : int
        Rows that were overwritten before they were taken, or given up since.
    """

    def __init__(self, memory: Memory, rows: int) -> None:
        self._memory: Memory | None = memory
        self._most = rows
        self._taken, self._kept = 0, 0
        self._blocks: deque[NDArray[Any]] = deque()
        self.lost = 0

    def drain(self) -> None:
        """Take what was written since."""
        if self._memory is None or not self._most:
            return
        i8 = self._memory.i8
        ring, at = int(i8[LOG_ROWS]), int(i8[LOG])
        written = int(i8[LOG_WRITTEN])
        begin = max(self._taken, written - ring)
        if begin >= written:
            return
        words = i8[at : at + ring * ROW_WORDS].reshape(ring, ROW_WORDS)
        rows = words[np.arange(begin, written) % ring]
        # what the servo has written meanwhile, and is writing now, may have gone over the oldest of them
        safe = max(begin, int(i8[LOG_WRITTEN]) + 1 - ring)
        rows = rows[min(safe, written) - begin :]
        self.lost += written - self._taken - len(rows)
        self._taken = written
        self._blocks.append(np.ascontiguousarray(rows).view(COLUMNS).reshape(-1))
        self._kept += len(rows)
        while self._kept > self._most and len(self._blocks) > 1:
            gone = self._blocks.popleft()
            self._kept -= len(gone)
            self.lost += len(gone)

    def rows(self) -> NDArray[Any]:
        """All rows that are kept, in order, as one structured array of `COLUMNS`."""
        if not self._blocks:
            return np.zeros(0, COLUMNS)
        joined = np.concatenate(list(self._blocks))
        self._blocks = deque([joined])
        return joined.copy()

    def let_go(self) -> None:
        """Take what there is, and hold on to the block no longer."""
        self.drain()
        self._memory = None
