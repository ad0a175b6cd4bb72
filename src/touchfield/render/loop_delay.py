"""Measures the delay of the servo's loop: the time from the call that reads a position to the return of the
call that sets its force, and the period.

The delay decides which stiffness is stable (``c/touch_settings.h``). The measured one includes what the
vendor's library or service does in the two calls. It does not include what happens behind them: in the cable,
the controller and the motors of the device. Only a profile can state that (`delay_ms`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

_FIRST_S: Final = 0.1
_WINDOW_S: Final = 1.0
_MAX_TICKS: Final = 250
_MIN_TICKS: Final = 10
"""A window has so many ticks, or is so long; the first one is short, so that it ends before a force is
applied. The times of a window are sorted within one tick."""

_SLOWER: Final = 1.02

QUANTILE: Final = 0.9
"""Fraction of the ticks that are faster than the delay: a single late tick takes part in no oscillation."""


class LoopTimes(NamedTuple):
    """Times of the ticks of a window, seconds."""

    median_s: float  # from position to force
    delay_s: float  # the same, of all but the slowest tenth of the ticks
    period_s: float  # mean

    def lag_s(self, rate_hz: float) -> float:
        """Return the delay in a loop that should run at `rate_hz`.

        A force that is held for longer than the nominal period lags by half of the difference.
        """
        return self.delay_s + 0.5 * max(self.period_s - 1.0 / rate_hz, 0.0)


class LoopMeter:
    """Collects the times of ticks; reports those of the first window, and of each window that is slower.

    A report is a message to another process, so that there must not be many.
    """

    def __init__(self, report: Callable[[LoopTimes], None]) -> None:
        self._report, self._window_s, self._reported_s = report, _FIRST_S, 0.0
        self._durations_s: list[float] = []
        self._start_s: float | None = None
        self._ticks = 0

    def add(self, duration_s: float, now_s: float, ticks: int = 1) -> None:
        """Add a tick that took `duration_s` seconds from position to force; it is the latest of `ticks`."""
        if self._start_s is None:  # its period is not known
            self._start_s = now_s
            return
        durations_s, elapsed_s = self._durations_s, now_s - self._start_s
        durations_s.append(duration_s)
        self._ticks += ticks
        count = len(durations_s)
        if count < _MAX_TICKS and (count < _MIN_TICKS or elapsed_s < self._window_s):
            return
        durations_s.sort()
        slow_s = durations_s[int(QUANTILE * (count - 1))]
        times = LoopTimes(durations_s[count // 2], slow_s, elapsed_s / max(self._ticks, 1))
        if slow_s + times.period_s > _SLOWER * self._reported_s:
            self._reported_s = slow_s + times.period_s
            self._report(times)
        self._window_s, self._start_s, self._ticks = _WINDOW_S, now_s, 0
        durations_s.clear()
