"""Time for the servo: the monotonic clock, and one that is whatever is asked for."""

from __future__ import annotations

import time
from typing import Protocol

__all__ = ["Clock", "VirtualClock", "WallClock"]


class Clock(Protocol):
    """What the loop of the servo asks of time."""

    def now_ns(self) -> int:
        """Nanoseconds since some beginning."""

    def sleep_until(self, deadline_ns: int) -> int:
        """Wait for a deadline; the time then."""


class WallClock:
    """The machine's clock that never goes back, the same for all its processes, in its finest steps."""

    def now_ns(self) -> int:
        """Nanoseconds."""
        return time.perf_counter_ns()

    def sleep_until(self, deadline_ns: int) -> int:
        """Wait for a deadline, so that what was slept too long is not added up; the time then."""
        now = time.perf_counter_ns()
        while now < deadline_ns:
            time.sleep(1e-9 * (deadline_ns - now))
            now = time.perf_counter_ns()
        return now


class VirtualClock:
    """Time that passes only where it is waited for."""

    def __init__(self) -> None:
        self._now = 0

    def now_ns(self) -> int:
        """Nanoseconds."""
        return self._now

    def sleep_until(self, deadline_ns: int) -> int:
        """It is the deadline now."""
        self._now = max(self._now, deadline_ns)
        return self._now
