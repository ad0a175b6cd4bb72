"""The record of a run: the log of the ticks, a ring of rows that the servo writes and the player drains, and counts.

A row is written by every tick and never waits: where nobody drains, the oldest are lost, and the loss is counted.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int64s
from touchfield.render.block import words as W

if TYPE_CHECKING:
    from touchfield.render.block.memory import Memory

COLUMNS: Final = np.dtype(
    [
        *((name, np.float64) for name in ("time_s", "media_s")),
        *((n, np.float64, (3,)) for n in ("position_m", "velocity_m_s", "field_force_n", "friction_n", "force_n")),
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

FLAGS: Final = {"running": 1, "waiting": 2, "stalled": 4, "ended": 8, "stopping": 16, "silent": 32, "paused": 64}
"""Bits of `flags`: the media clock runs; waits for first frames; underrun; over; on the way to zero after a stop; no
sign of life from the player; paused."""


class TickLog:
    """Rows taken out of the ring, at most `rows` of them kept, the oldest given up first.

    `lost` are those that were overwritten before they were taken, or given up since.
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
        ring, at = int(i8[W.LOG_ROWS]), int(i8[W.LOG])
        written = int(i8[W.LOG_WRITTEN])
        begin = max(self._taken, written - ring)
        if begin >= written:
            return
        words = i8[at : at + ring * W.ROW_WORDS].reshape(ring, W.ROW_WORDS)
        rows = words[np.arange(begin, written) % ring]
        # what the servo has written meanwhile, and is writing now, may have gone over the oldest of them
        safe = max(begin, int(i8[W.LOG_WRITTEN]) + 1 - ring)
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


_COUNTS: Final = {
    "late_ticks": W.LATE,
    "missed_ticks": W.MISSED,
    "underruns": W.UNDERRUNS,
    "stalled_ticks": W.STALLED_TICKS,
    "waits": W.WAITS,
    "waiting_ticks": W.WAITING_TICKS,
    "frames_used": W.FRAMES_USED,
}


def statistics_of(memory: Memory) -> dict[str, Any]:
    """The counts so far as a dictionary with stable keys; times in seconds, those of jitter in microseconds."""
    i8 = memory.i8
    ticks = int(i8[W.TICKS])
    seconds = 1e-9 * float(i8[W.LAST_NS] - i8[W.FIRST_NS])
    counts: dict[str, Any] = {
        "ticks": ticks,
        "seconds": seconds,
        "rate_hz": float(memory.f8[W.RATE_HZ]),
        "mean_rate_hz": (ticks - 1) / seconds if seconds > 0 else 0.0,
        **{name: int(i8[place]) for name, place in _COUNTS.items()},
        "stalled_share": float(i8[W.STALLED_TICKS] / max(i8[W.PLAYED_TICKS], 1)),
    }
    for name, at, worst in (
        ("jitter", W.PERIODS, W.WORST_PERIOD_NS),
        ("lateness", W.LATENESSES, W.WORST_LATENESS_NS),
    ):
        bins = i8[at : at + W.TIME_BINS + 1].copy()
        for percent, share in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
            counts[f"{name}_{percent}_us"] = _quantile_us(bins, share, 1e-3 * float(i8[worst]))
        counts[f"{name}_worst_us"] = 1e-3 * float(i8[worst])
    latencies = i8[W.LATENCIES : W.LATENCIES + W.LATENCY_BINS].copy()
    if latencies.any():
        middle = int(np.searchsorted(np.cumsum(latencies), 0.5 * latencies.sum()))
        counts["latency_min_s"] = 1e-9 * float(i8[W.LEAST_LATENCY_NS])
        counts["latency_median_s"] = 1e-6 * (2.0 ** ((middle + 0.5) / W.LATENCY_STEPS) - 1)
    return counts


def _quantile_us(counts: Int64s, share: float, worst_us: float) -> float:
    """The upper edge of the bin in which the quantile lies; the worst where that is the open one."""
    total = int(counts.sum())
    if not total:
        return 0.0
    at = int(np.searchsorted(np.cumsum(counts), share * total))
    return min(float(at + 1), worst_us) if at < W.TIME_BINS else worst_us
