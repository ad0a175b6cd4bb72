"""Driver of bHaptics vests: sends the strength of each motor to the vendor's program, the bHaptics Player,
through its WebSocket (version 2).

It needs no key and no licence, and uses loopback. Protocol: one JSON message a frame to ``/v2/feedbacks``, in
which each panel is a submission of the type "frame": its position (VestFront, VestBack), its dots (index and
intensity 0 to 100) and their duration. A later submission with the same key replaces the one before. The
duration is at most 500 ms, then the Player switches the dots off: a program that was killed leaves none on.

The Player sends its own state; of that, ConnectedPositions and ConnectedDeviceCount tell whether a vest is
there. Port, path and these names are those of the maker's sources (bhaptics/haptic-library
``src/hapticsManager.h``, bhaptics/tact-js ``src/PlayerSocket.ts`` and ``src/models/Interfaces.ts``). Under
which name a vest is listed (Vest, VestFront, VestBack), and when the Player sends its state, is unverified:
every name that begins with Vest counts, and a Player that sends neither is taken to have a vest. A Player has
one vest.

The protocol has 20 dots a side, 4 columns and 5 rows from the top left, for every vest: these are the motors
of the TactSuit X40. A vest with fewer rows is driven through all 20, so that no motor is missed whichever
dots the Player uses for it: with four rows (TactSuit Pro) the lowest is sent as the fourth and the fifth,
with two (X16, Air) the upper as the first two and the lower as the other three. The second grouping is that
of the firmware SenseShift for an X16; the first is our choice. Intensities are rounded to the steps of the
profile's motors.
"""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.devices.drivers.links import service_check, web_socket
from touchfield.devices.drivers.registry import Check, DeviceKind, library_check, steps_of
from touchfield.devices.drivers.unit_lock import UnitLock
from touchfield.errors import DeviceError, InvalidArgument, reason
from touchfield.options import Address, address
from touchfield.render.array_player import ArrayDevice
from touchfield.render.readiness import Readiness

if TYPE_CHECKING:
    from touchfield.devices import Device


PLAYER: Final[Address] = ("127.0.0.1", 15881)
_NAME: Final = "bHaptics Player"
_TITLE: Final = "bHaptics vest"
_HINT: Final = "Start the bHaptics Player on that machine and pair the vest"
_VEST_HINT: Final = "Switch the vest on and pair it in the bHaptics Player."
_LOST: Final = "The bHaptics Player reports that the vest is no longer connected"

POSITIONS: Final = ("VestFront", "VestBack")
COLUMNS: Final = 4
VEST_ROWS: Final = {5: (0, 1, 2, 3, 4), 4: (0, 1, 2, 3, 3), 2: (0, 0, 1, 1, 1)}
"""Number of rows of a vest -> the row that each of the five rows of dots shows."""

_FULL: Final = 100
_DURATION_FRAMES: Final = 1.5
"""Duration of a message in frames, so that a slightly late frame leaves no gap."""
_SHORTEST_MS, _LONGEST_MS = 50, 500
"""Limits of that duration: the least that bHaptics tact-js (submitDot) takes, and how long a motor stays on
after this program was killed.
"""

_TIMEOUT_S: Final = 2.0
_STATE_S: Final = 0.5
"""Time for the first state of the Player."""

_MAX_ANSWERS: Final = 64
"""Messages of the Player that are read in a frame."""
_MAX_QUEUE: Final = 1024
"""Messages that may wait.

With a full queue, websockets 17 blocks a sender for ever if the connection has just been closed.
"""


class BHaptics(ArrayDevice):
    """A vest behind a bHaptics Player.

    Parameters
    ----------
    profile : Device
        Profile of one or two panels with 4 columns and 2, 4 or 5 rows; others raise InvalidArgument.
    player : (str, int)
        Address at which the Player listens.
    """

    title: ClassVar[str] = _TITLE
    keep_alive_s: ClassVar[float] = 0.3e-3 * _LONGEST_MS

    def __init__(self, profile: Device, player: Address = PLAYER) -> None:
        columns, rows, _ = profile.lattice
        if columns != COLUMNS or rows not in VEST_ROWS or profile.panels > len(POSITIONS):
            found = f"{profile.name}, {profile.panels} panels of {columns} x {rows}"
            raise InvalidArgument("bhaptics", found, "one or two panels of 4 x 5, 4 x 4 or 4 x 2 motors")
        self.profile, self._player = profile, player
        self._lock: UnitLock | None = None
        self._has_vest: bool | None = None
        self._rows = np.array(VEST_ROWS[rows])
        self._message = ""

    def open(self) -> None:
        """See `ArrayDevice`."""
        line = connected(self._player)
        host, port, *_ = line.remote_address
        try:
            self._lock = UnitLock(_TITLE, f"{host}:{port}")
        except DeviceError:
            line.close()
            raise
        self._line, self._has_vest, self._message, self.notes = line, None, "", ()

    def readiness(self) -> Readiness:
        """See `ArrayDevice.readiness`; waits for the Player's first state."""
        self._read(_STATE_S if self._has_vest is None else 0.0)
        return Readiness(is_connected=self._has_vest, hint=_VEST_HINT)

    def close(self) -> None:
        """See `ArrayDevice.close`."""
        super().close()
        lock, self._lock = self._lock, None
        if lock is not None:
            lock.release()

    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """See `ArrayDevice`; each motor has one fixed frequency."""
        levels = min(self.profile.levels or _FULL + 1, _FULL + 1)
        steps = steps_of(self.profile, drives, levels)
        intensities = np.floor(steps * (_FULL / max(levels - 1, 1)) + 0.5).astype(np.int64)
        duration_ms = math.ceil(1000 * _DURATION_FRAMES * seconds) if math.isfinite(seconds) else _LONGEST_MS
        self._message = self._submission(intensities, min(max(duration_ms, _SHORTEST_MS), _LONGEST_MS))
        self.keep_alive()

    def keep_alive(self) -> None:
        """See `ArrayDevice`: submit the latest frame again."""
        if self._line is None:
            raise DeviceError(_NAME, "no connection", "one that was opened")
        try:
            self._line.send(self._message)
        except Exception as error:  # closed, broken, or nobody reads what is sent
            raise DeviceError(_NAME, f"that it is gone ({reason(error)})", hint=_HINT) from error
        self._read(0.0)
        if self._has_vest is False:
            self.notes = (_LOST,)

    def _read(self, first_s: float) -> None:
        """Read the states that the Player has sent; waits up to `first_s` seconds for the first."""
        try:
            for number in range(_MAX_ANSWERS):
                has_vest = vest_in(self._line.recv(timeout=0.0 if number else first_s))
                self._has_vest = self._has_vest if has_vest is None else has_vest
        except TimeoutError:
            return  # nothing more to read
        except Exception as error:  # closed or broken
            raise DeviceError(_NAME, f"that it is gone ({reason(error)})", hint=_HINT) from error

    def _submission(self, intensities: Int64s, duration_ms: int) -> str:
        submissions = []
        for panel, position in zip(intensities, POSITIONS):
            dots = panel[self._rows].reshape(-1).tolist()
            frame = {
                "Position": position,
                "DotPoints": [{"Index": index, "Intensity": value} for index, value in enumerate(dots)],
                "PathPoints": [],
                "DurationMillis": duration_ms,
            }
            submissions.append({"Type": "frame", "Key": f"touchfield-{position}", "Frame": frame})
        return json.dumps({"Submit": submissions}, separators=(",", ":"))


def connected(player: Address) -> Any:
    """Connect to a Player; raises `DeviceError` if none answers, `MissingExtra` without the library."""
    path = "v2/feedbacks?app_id=touchfield&app_name=touchfield"
    return web_socket(
        player, path, _NAME, _HINT, _TIMEOUT_S, _TIMEOUT_S,
        close_timeout=_TIMEOUT_S / 2, max_queue=_MAX_QUEUE,
    )  # fmt: skip


def vest_in(text: str | bytes) -> bool | None:
    """Return whether a state of the Player lists a vest; None if it does not say."""
    try:
        state = json.loads(text)
    except (TypeError, ValueError, RecursionError):
        return None
    state = state if isinstance(state, dict) else {}
    positions, count = state.get("ConnectedPositions"), state.get("ConnectedDeviceCount")
    if isinstance(positions, list):
        return any(isinstance(name, str) and name.lower().startswith("vest") for name in positions)
    return False if type(count) is int and count == 0 else None


def find_units(rest: str = "") -> list[Readiness]:
    """Return the state of the vest of a Player; raises `DeviceError` if no Player answers."""
    line = connected(address(rest, "bhaptics[:HOST:PORT]", PLAYER))
    try:
        has_vest = vest_in(line.recv(timeout=_TIMEOUT_S))
    except Exception:  # silent or closed
        has_vest = None
    finally:
        line.close()
    return [Readiness(is_connected=has_vest, hint=_VEST_HINT)]


def _make(text: str, profile: Device) -> ArrayDevice:
    return BHaptics(profile, address(text, "bhaptics[:HOST:PORT]", PLAYER))


def checks() -> list[Check]:
    """Check the library, and whether a Player listens on this machine."""
    return [library_check("websockets", "devices"), service_check(_NAME, PLAYER, _HINT)]


KIND = DeviceKind(
    "bhaptics", "bhaptics[:HOST:PORT]", "bHaptics vests through the bHaptics Player "
                                        "(WebSocket)", "tactsuit-x40",
    _make, checks, is_array=True, find_units=find_units,
)  # fmt: skip
