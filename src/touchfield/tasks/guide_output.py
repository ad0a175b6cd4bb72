"""The thread of the drives of command `guide`, what it shows, and what a run counts."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s
from touchfield.guidance.guide import Situation, State
from touchfield.guidance.pattern import Patterns
from touchfield.guidance.spec import GuideSpec
from touchfield.render.array_player import DEFAULT_RATE_HZ

if TYPE_CHECKING:
    from touchfield.render.array_player import ArrayDevice

MAX_DELAY_S: Final = 0.1
WARNING_S: Final = 0.3
MAX_PERIOD_S: Final = 0.05
_BIN_S, _BINS = 0.0005, 4000


class Shown(NamedTuple):
    """What the actuators show: reason of a warning or "", the situation, and its frame."""

    warning: str
    situation: Situation | None
    frame: int
    drives: Float32s


@dataclass
class Counts:
    """Counts of a run; `summary` has stable keys."""

    frames: int = 0
    dropped: int = 0
    unreadable: int = 0
    other_size: int = 0
    evaluated: int = 0
    late: int = 0
    blind: int = 0
    without_ground: int = 0
    timeouts: int = 0
    warning_s: float = 0.0
    pose_jumps: int = 0
    states: list[int] = field(default_factory=lambda: [0, 0, 0])
    steps: int = 0
    drops: int = 0
    max_delay_s: float = 0.0
    _delays: Any = field(default_factory=lambda: np.zeros(_BINS + 1, np.int64))

    def add(self, situation: Situation) -> None:
        """Count an evaluated frame."""
        self.evaluated += 1
        self.blind += situation.is_blind
        self.without_ground += not (situation.is_blind or situation.ground.is_seen)
        for state in situation.states:
            self.states[state] += 1
        self.steps += math.isfinite(situation.ahead.step_m)
        self.drops += math.isfinite(situation.ahead.drop_m)

    def add_delay(self, seconds: float) -> None:
        """Count the time from the arrival of a frame to the actuators."""
        self._delays[min(int(seconds / _BIN_S), _BINS)] += 1
        self.max_delay_s = max(self.max_delay_s, seconds)

    def delay_ms(self, percent: float) -> float | None:
        """Return a percentile of the delay, milliseconds, rounded up to 0.5; None without frames."""
        total = int(self._delays.sum())
        if not total:
            return None
        rank = int(np.searchsorted(np.cumsum(self._delays), math.ceil(total * percent / 100)))
        return 1e3 * min(_BIN_S * (rank + 1), self.max_delay_s)

    def summary(self) -> dict[str, Any]:
        """Return the counts as a dictionary."""
        directions = max(sum(self.states), 1)
        names = (
            "frames",
            "dropped",
            "unreadable",
            "other_size",
            "evaluated",
            "late",
            "blind",
            "without_ground",
            "timeouts",
        )
        return {
            **{name: getattr(self, name) for name in names},
            "warning_s": self.warning_s,
            "pose_jumps": self.pose_jumps,
            **{f"{state.name.lower()}_share": self.states[state] / directions for state in State},
            "frames_with_step": self.steps,
            "frames_with_drop": self.drops,
            "delay_p50_ms": self.delay_ms(50),
            "delay_p99_ms": self.delay_ms(99),
            "delay_max_ms": 1e3 * self.max_delay_s if self.max_delay_s else None,
        }


class Output:
    """The thread of the drives: shows the latest situation, or a warning, at the rate of the device."""

    def __init__(
        self,
        driver: ArrayDevice,
        patterns: Patterns,
        counts: Counts,
        spec: GuideSpec,
        show: Callable[[float, Shown], None],
    ) -> None:
        self._driver, self._patterns, self._counts, self._spec, self._show = (
            driver, patterns, counts, spec, show,
        )  # fmt: skip
        self._period_s = min(1 / (driver.profile.rate_hz or DEFAULT_RATE_HZ), MAX_PERIOD_S)
        self._changed = threading.Condition()
        self._posted: tuple[Situation, int, float] | None = None
        self._is_new, self._is_ending, self._is_stopped = False, False, False
        self._error: BaseException | None = None
        self._start_s = self._warned_s = time.monotonic()
        self._warning, self._warned_until_s, self._last_s = "", -math.inf, self._start_s
        self._thread = threading.Thread(target=self._run, name="touchfield-guide-drives", daemon=True)

    def start(self) -> None:
        """Start the thread; it warns until the first situation is posted."""
        self._start_s = self._last_s = time.monotonic()
        self._thread.start()

    def post(self, situation: Situation, frame: int, arrived_s: float) -> None:
        """Show the situation of a frame at once."""
        with self._changed:
            self._posted, self._is_new = (situation, frame, arrived_s), True
            self._changed.notify_all()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the device."""
        return self._driver.notes

    def raise_error(self) -> None:
        """Raise the error of the device, if it has failed."""
        if self._error is not None:
            raise self._error

    def stop_after(self, seconds: float) -> None:
        """Show the warning for a time."""
        with self._changed:
            self._is_ending = True
        time.sleep(seconds)

    def close(self) -> None:
        """End the thread."""
        with self._changed:
            self._is_stopped = True
            self._changed.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._is_new or self._is_stopped, self._period_s)
                    if self._is_stopped:
                        return
                    posted, is_new, self._is_new = self._posted, self._is_new, False
                self._put(posted, is_new)
        except BaseException as error:
            self._error = error

    def _put(self, posted: tuple[Situation, int, float] | None, is_new: bool) -> None:
        """Show a situation or a warning, and count."""
        now_s = time.monotonic()
        reason = self._reason(posted, now_s, is_new)
        was_warning = bool(self._warning)
        if reason:
            self._warning, self._warned_until_s = reason, now_s + WARNING_S
            self._warned_s = self._warned_s if was_warning else now_s
        elif now_s >= self._warned_until_s:
            self._warning = ""
        self._counts.warning_s += (now_s - self._last_s) if was_warning else 0.0
        self._last_s = now_s
        situation, frame, arrived_s = posted or (None, -1, now_s)
        if self._warning or situation is None:
            drives = self._patterns.warning(now_s - self._warned_s)
        else:
            drives = self._patterns.drives(situation, now_s - self._start_s)
        self._driver.put_drives(drives, None, self._period_s)
        if is_new:
            self._counts.add_delay(time.monotonic() - arrived_s)
        if is_new or (self._warning and not was_warning):
            self._show(now_s - self._start_s, Shown(self._warning, situation, frame, drives))

    def _reason(self, posted: tuple[Situation, int, float] | None, now_s: float, is_new: bool) -> str:
        """Return why nothing is known now; "" if the situation holds."""
        if self._is_ending:
            return "ended"
        if posted is None:
            return "no frame"
        situation, _, arrived_s = posted
        if is_new and now_s - arrived_s > MAX_DELAY_S:
            self._counts.late += 1
            return "late"
        if situation.is_blind:
            return "blind"
        if now_s - arrived_s > self._spec.timeout_s:
            self._counts.timeouts += self._warning != "no frame"
            return "no frame"
        return ""
