"""Driver of bHaptics vests: sends the strength of each motor to the vendor's program, the bHaptics Player,
through its WebSocket (version 2).

It needs no key and no licence, and uses loopback. Protocol: one JSON message a frame to ``/v2/feedbacks``, in
which each panel is a submission of the type "frame": its position (VestFront, VestBack), its dots (index and
intensity 0 to 100) and their duration. A later submission with the same key replaces the one before. The
Player sends its own state, which is read and ignored.

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
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.devices.drivers.links import service_check, web_socket
from touchfield.devices.drivers.registry import Check, DeviceKind, library_check, steps_of
from touchfield.errors import DeviceError, InvalidArgument, reason
from touchfield.options import Address, address
from touchfield.render.array_player import ArrayDevice

if TYPE_CHECKING:
    from touchfield.devices import Device


PLAYER: Final[Address] = ("127.0.0.1", 15881)
_NAME: Final = "bHaptics Player"
_HINT: Final = "Start the bHaptics Player on that machine and pair the vest"

POSITIONS: Final = ("VestFront", "VestBack")
COLUMNS: Final = 4
VEST_ROWS: Final = {5: (0, 1, 2, 3, 4), 4: (0, 1, 2, 3, 3), 2: (0, 0, 1, 1, 1)}
"""Number of rows of a vest -> the row that each of the five rows of dots shows."""

_FULL: Final = 100
_DURATION_FRAMES: Final = 1.5
"""Duration of a message in frames, so that a slightly late frame leaves no gap."""
_SHORTEST_MS, _LONGEST_MS = 50, 10000  # bHaptics tact-js, submitDot

_TIMEOUT_S: Final = 2.0
_MAX_ANSWERS: Final = 64
"""Messages of the Player that are read and ignored in a frame."""
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

    def __init__(self, profile: Device, player: Address = PLAYER) -> None:
        columns, rows, _ = profile.lattice
        if columns != COLUMNS or rows not in VEST_ROWS or profile.panels > len(POSITIONS):
            found = f"{profile.name}, {profile.panels} panels of {columns} x {rows}"
            raise InvalidArgument("bhaptics", found, "one or two panels of 4 x 5, 4 x 4 or 4 x 2 motors")
        self.profile, self._player = profile, player
        self._rows = np.array(VEST_ROWS[rows])

    def open(self) -> None:
        """See `ArrayDevice`."""
        path = "v2/feedbacks?app_id=touchfield&app_name=touchfield"
        self._line = web_socket(
            self._player, path, _NAME, _HINT, _TIMEOUT_S, _TIMEOUT_S,
            close_timeout=_TIMEOUT_S / 2, max_queue=_MAX_QUEUE,
        )  # fmt: skip

    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """See `ArrayDevice`; each motor has one fixed frequency."""
        levels = min(self.profile.levels or _FULL + 1, _FULL + 1)
        steps = steps_of(self.profile, drives, levels)
        intensities = np.floor(steps * (_FULL / max(levels - 1, 1)) + 0.5).astype(np.int64)
        duration_ms = math.ceil(1000 * _DURATION_FRAMES * seconds) if math.isfinite(seconds) else _LONGEST_MS
        if self._line is None:
            raise DeviceError(_NAME, "no connection", "one that was opened")
        try:
            self._line.send(self._message(intensities, min(max(duration_ms, _SHORTEST_MS), _LONGEST_MS)))
            for _ in range(_MAX_ANSWERS):
                self._line.recv(timeout=0)
        except TimeoutError:
            return  # nothing more to read
        except Exception as error:  # closed, broken, or nobody reads what is sent
            raise DeviceError(_NAME, f"that it is gone ({reason(error)})", hint=_HINT) from error

    def _message(self, intensities: Int64s, duration_ms: int) -> str:
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


def _make(text: str, profile: Device) -> ArrayDevice:
    return BHaptics(profile, address(text, "bhaptics[:HOST:PORT]", PLAYER))


def checks() -> list[Check]:
    """Check the library, and whether a Player listens on this machine."""
    return [library_check("websockets", "devices"), service_check(_NAME, PLAYER, _HINT)]


KIND = DeviceKind(
    "bhaptics", "bhaptics[:HOST:PORT]", "bHaptics vests through the bHaptics Player "
                                        "(WebSocket)", "tactsuit-x40",
    _make, checks, is_array=True,
)  # fmt: skip
