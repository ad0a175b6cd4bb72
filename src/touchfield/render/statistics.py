"""What the servo counts while it runs, and how the player tells it: rate, jitter, lateness, underruns, latency.

Times are counted in bins of 1 us, so that ten minutes cost no more room than one; the last bin holds all above.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.render.control import RATE_HZ
from touchfield.render.memory import COUNTS, Memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["LATENCY_BINS", "LATENCY_STEPS", "TIME_BINS", "statistics_of"]

TICKS: Final = COUNTS
LATE: Final = COUNTS + 1
"""Ticks that began more than half a period late."""
MISSED: Final = COUNTS + 2
"""Periods in which no tick began."""
UNDERRUNS: Final = COUNTS + 3
STALLED_TICKS: Final = COUNTS + 4
WAITS: Final = COUNTS + 5
WAITING_TICKS: Final = COUNTS + 6
SILENT_TICKS: Final = COUNTS + 7
FIRST_NS: Final = COUNTS + 8
LAST_NS: Final = COUNTS + 9
WORST_PERIOD_NS: Final = COUNTS + 10
WORST_LATENESS_NS: Final = COUNTS + 11
LEAST_LATENCY_NS: Final = COUNTS + 12
FRAMES_USED: Final = COUNTS + 13
PLAYED_TICKS: Final = COUNTS + 14
"""Ticks in which the medium was to be played."""

TIME_BINS: Final = 3000
PERIODS: Final = COUNTS + 64
LATENESSES: Final = PERIODS + TIME_BINS + 1
LATENCIES: Final = LATENESSES + TIME_BINS + 1
LATENCY_BINS: Final = 256
LATENCY_STEPS: Final = 8
"""Bins to a doubling of the latency, which reaches from microseconds to the seconds of a long look ahead."""


def statistics_of(memory: Memory) -> dict[str, Any]:
    """The counts so far as a dictionary with stable keys; times in seconds, those of jitter in microseconds."""
    i8 = memory.i8
    ticks = int(i8[TICKS])
    seconds = 1e-9 * float(i8[LAST_NS] - i8[FIRST_NS])
    told: dict[str, Any] = {
        "ticks": ticks,
        "seconds": seconds,
        "rate_hz": float(memory.f8[RATE_HZ]),
        "mean_rate_hz": (ticks - 1) / seconds if seconds > 0 else 0.0,
        "late_ticks": int(i8[LATE]),
        "missed_ticks": int(i8[MISSED]),
        "underruns": int(i8[UNDERRUNS]),
        "stalled_ticks": int(i8[STALLED_TICKS]),
        "stalled_share": float(i8[STALLED_TICKS] / max(i8[PLAYED_TICKS], 1)),
        "waits": int(i8[WAITS]),
        "waiting_ticks": int(i8[WAITING_TICKS]),
        "frames_used": int(i8[FRAMES_USED]),
    }
    for name, at, worst in (("jitter", PERIODS, WORST_PERIOD_NS), ("lateness", LATENESSES, WORST_LATENESS_NS)):
        counts = i8[at : at + TIME_BINS + 1].copy()
        for percent, share in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
            told[f"{name}_{percent}_us"] = _quantile_us(counts, share, 1e-3 * float(i8[worst]))
        told[f"{name}_worst_us"] = 1e-3 * float(i8[worst])
    latencies = i8[LATENCIES : LATENCIES + LATENCY_BINS].copy()
    if latencies.any():
        middle = int(np.searchsorted(np.cumsum(latencies), 0.5 * latencies.sum()))
        told["latency_min_s"] = 1e-9 * float(i8[LEAST_LATENCY_NS])
        told["latency_median_s"] = 1e-6 * (2.0 ** ((middle + 0.5) / LATENCY_STEPS) - 1)
    return told


def _quantile_us(counts: NDArray[np.int64], share: float, worst_us: float) -> float:
    """The upper edge of the bin in which the quantile lies; the worst where that is the open one."""
    total = int(counts.sum())
    if not total:
        return 0.0
    at = int(np.searchsorted(np.cumsum(counts), share * total))
    return min(float(at + 1), worst_us) if at < TIME_BINS else worst_us
