"""Measures the delay of the servo's loop: the time from the call that reads a position to the return of the
call that sets its force, and the period.

The delay decides which stiffness is stable (``c/touch_settings.h``). The measured one includes what the
vendor's library or service does in the two calls. It does not include what happens behind them: in the cable,
the controller and the motors of the device. Only a profile can state that (`delay_ms`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

_FIRST_TICKS: Final = 100
_TICKS: Final = 1000
"""Ticks of a report; the first one is short, so that it comes before a force is applied."""

_SLOWER: Final = 1.02

QUANTILE: Final = 0.9
"""Fraction of the ticks that are faster than the delay: a single late tick takes part in no oscillation."""


class LoopTimes(NamedTuple):
    """Times of some ticks, seconds."""

    median_s: float  # from position to force
    delay_s: float  # the same, of all but the slowest tenth of the ticks
    period_s: float  # mean

    def lag_s(self, rate_hz: float) -> float:
        """Return the delay in a loop that should run at `rate_hz`.

        A force that is held for longer than the nominal period lags by half of the difference.
        """
        return self.delay_s + 0.5 * max(self.period_s - 1.0 / rate_hz, 0.0)


class LoopMeter:
    """Collects the times of ticks; reports those of the first ticks, and of each second that is slower.

    A report is a message to another process, so that there must not be many.
    """

    def __init__(self, report: Callable[[LoopTimes], None], first_ticks: int = _FIRST_TICKS) -> None:
        self._report, self._count = report, first_ticks
        self._durations_s: list[float] = []
        self._start_s: float | None = None
        self._ticks, self._reported_s = 0, 0.0

    def add(self, duration_s: float, now_s: float, ticks: int = 1) -> None:
        """Add a tick that took `duration_s` seconds from position to force; it is the latest of `ticks`."""
        if self._start_s is None:  # its period is not known
            self._start_s = now_s
            return
        self._durations_s.append(duration_s)
        self._ticks += ticks
        if len(self._durations_s) < self._count:
            return
        durations_s, period_s = sorted(self._durations_s), (now_s - self._start_s) / max(self._ticks, 1)
        count = len(durations_s)
        times = LoopTimes(durations_s[count // 2], durations_s[int(QUANTILE * (count - 1))], period_s)
        if times.delay_s + period_s > _SLOWER * self._reported_s:
            self._reported_s = times.delay_s + period_s
            self._report(times)
        self._count, self._durations_s, self._start_s, self._ticks = _TICKS, [], now_s, 0
