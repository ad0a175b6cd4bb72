"""Waits until a device can be driven: it is connected, powered and calibrated, nobody else uses it, and its
position is live.

Every driver reports its state as a `Readiness`, and `open_when_ready` polls it, for the servo and for arrays.
No force is applied meanwhile. While the device is driven, `ReadinessWatch` checks its state at a low rate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol

from touchfield.errors import DeviceAbsent, DeviceError, require_between

DEFAULT_WAIT_S: Final = 30.0
MAX_WAIT_S: Final = 3600.0

_POLL_S: Final = 0.05
_WATCH_S: Final = 0.25
"""Time between two checks of a device that is driven and ready."""

_TEXTS: Final = {
    "is_connected": ("connected", "not connected"),
    "is_powered": ("powered", "without power"),
    "is_calibrated": ("calibrated", "not calibrated"),
    "is_started": ("started", "not started"),
    "is_free": ("free", "in use by another program"),
    "has_moved": ("moved", "still at its first position"),
}
"""Text for a state that is True, and for one that is False."""


@dataclass(frozen=True)
class Readiness:
    """The state of one unit of a device, as its driver reports it.

    A state is None if the driver does not report it; it is then taken as fulfilled. `has_moved` is reported
    by devices whose position stays at a constant until they are calibrated. `unit` is the id by which the
    unit can be named (`play --device`), or "". `hint` is one sentence on how to make the unit ready.
    `settings` are texts such as "right-handed", for the user.
    """

    unit: str = ""
    is_connected: bool | None = None
    is_powered: bool | None = None
    is_calibrated: bool | None = None
    is_started: bool | None = None
    is_free: bool | None = None
    has_moved: bool | None = None
    hint: str = ""
    settings: tuple[str, ...] = ()

    @property
    def is_ready(self) -> bool:
        """True if no state is False."""
        return not self.missing

    @property
    def missing(self) -> tuple[str, ...]:
        """Texts of the states that are False, such as "not calibrated"."""
        return tuple(text for name, (_, text) in _TEXTS.items() if getattr(self, name) is False)

    @property
    def text(self) -> str:
        """All states that the driver reports: what is missing, or else what is fulfilled."""
        fulfilled = (text for name, (text, _) in _TEXTS.items() if getattr(self, name))
        return ", ".join(self.missing or fulfilled) or "its driver reports no state"

    @property
    def details(self) -> str:
        """The states as in `text`, and the settings of the unit."""
        return "; ".join((self.text, *self.settings))


class Unit(Protocol):
    """A device that `open_when_ready` opens: a `PointDevice` or an `ArrayDevice`."""

    title: ClassVar[str]
    """Name of the kind of device in messages."""

    def open(self) -> None:
        """Open the device; raises `DeviceAbsent` if it is missing."""
        ...

    def readiness(self) -> Readiness:
        """Return the state of the open device."""
        ...

    def close(self) -> None:
        """Close the device."""
        ...


def open_when_ready(
    device: Unit,
    wait_s: float,
    must_stop: Callable[[], bool] = lambda: False,
    on_note: Callable[[str], None] = lambda note: None,
) -> bool:
    """Open a device and wait until it is ready; returns False if `must_stop` ended the wait.

    `on_note` gets one note for each state that lasts for more than one poll. Raises `DeviceError` if the
    device is not ready after `wait_s` seconds, or cannot be opened; the caller closes it.
    """
    require_between(0, MAX_WAIT_S, wait=wait_s)
    deadline_s = time.monotonic() + wait_s
    is_open, latest, noted = False, "", ""
    while not must_stop():
        try:
            if not is_open:
                device.open()
                is_open = True
            state = device.readiness()
            if state.is_ready:
                return True
            subject = f"{device.title} {state.unit}".strip()
            error = DeviceError(subject, f"a device that is {state.text}", "a ready one", state.hint)
            note = f"{subject} is {state.text}: waiting for it. {state.hint}"
        except DeviceAbsent as absent:
            device.close()
            is_open, error, note = False, absent, f"waiting for {absent}"
        if time.monotonic() >= deadline_s:
            raise error
        if note == latest != noted:
            noted = note
            on_note(note.strip())
        latest = note
        time.sleep(min(_POLL_S, max(deadline_s - time.monotonic(), 0.0)))
    return False


class ReadinessWatch:
    """Checks a device that is driven a few times a second: it may lose its calibration or its power.

    `state` returns the present state of the device, `on_note` gets a note for each change. Time is in
    seconds, of any clock.
    """

    def __init__(
        self, title: str, state: Callable[[], Readiness], wait_s: float, on_note: Callable[[str], None]
    ) -> None:
        self._title, self._state, self._wait_s, self._on_note = title, state, wait_s, on_note
        self._next_s, self._lost_s, self._noted = -math.inf, 0.0, ""

    def is_ready(self, now_s: float) -> bool:
        """Return whether the device may have a force.

        Raises `DeviceError` if it has not been ready for `wait_s` seconds, or is gone.
        """
        if now_s < self._next_s:
            return not self._noted
        state = self._state()
        subject = f"{self._title} {state.unit}".strip()
        if state.is_ready:
            if self._noted:
                self._on_note(f"{subject} is ready again: its force returns")
            self._next_s, self._noted = now_s + _WATCH_S, ""
            return True
        if not self._noted:
            self._lost_s = now_s
        if now_s - self._lost_s >= self._wait_s:
            raise DeviceError(subject, f"a device that is {state.text}", "a ready one", state.hint)
        note = f"{subject} is {state.text}: its force is zero until it is ready. {state.hint}".strip()
        if note != self._noted:
            self._on_note(note)
        self._next_s, self._noted = now_s + _POLL_S, note
        return False
