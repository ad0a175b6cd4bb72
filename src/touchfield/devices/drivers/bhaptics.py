"""bHaptics vests through the bHaptics Player, by its WebSocket of version 2: no key, no licence, loopback.

Protocol: one JSON message a frame to ``/v2/feedbacks``, in which each panel is a submission of the type
"frame": its position (VestFront, VestBack), its dots (index and intensity 0 to 100) and how long they last. A
later submission of the same key takes the place of the one before. What the Player sends is its own state; it
is read and left aside.

The protocol speaks of 20 dots a side, 4 columns and 5 rows from the top left, whatever the vest: that is the
TactSuit X40. A vest with fewer rows is driven through all 20, so that no motor is missed whichever dots the
Player takes it from: of four rows (TactSuit Pro) the lowest is sent as the fourth and the fifth, of two (X16,
Air) the upper as the first two and the lower as the other three. The second is how the firmware SenseShift
groups the dots for an X16; the first is our choice. Intensities are rounded to the steps that the profile's
motors have.
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
_MEND: Final = "Start the bHaptics Player on that machine and pair the vest"

POSITIONS: Final = ("VestFront", "VestBack")
COLUMNS: Final = 4
ROWS_OF: Final = {5: (0, 1, 2, 3, 4), 4: (0, 1, 2, 3, 3), 2: (0, 0, 1, 1, 1)}
"""Rows of the vest -> the one that each row of dots shows."""

_FULL: Final = 100
_LASTS: Final = 1.5
"""Frames that a frame lasts if none follows: a little late must not be felt as a gap."""
_SHORTEST_MS, _LONGEST_MS = 50, 10000  # bHaptics tact-js, submitDot

_PATIENCE_S: Final = 2.0
_MOST_ANSWERS: Final = 64
"""Messages of the Player that are read and left aside in a frame."""
_MOST_WAITING: Final = 1024
"""Messages that may wait; a full queue of websockets 17 holds up for ever who then sends on a line just
closed.
"""


class BHaptics(ArrayDevice):
    """A vest behind a bHaptics Player.

    Parameters
    ----------
    profile : Device
        Of one or two panels with 4 columns and 2, 4 or 5 rows; else InvalidArgument.
    player : (str, int)
        Where the Player listens.
    """

    def __init__(self, profile: Device, player: Address = PLAYER) -> None:
        columns, rows, _ = profile.lattice
        if columns != COLUMNS or rows not in ROWS_OF or profile.panels > len(POSITIONS):
            found = f"{profile.name}, {profile.panels} panels of {columns} x {rows}"
            raise InvalidArgument("bhaptics", found, "one or two panels of 4 x 5, 4 x 4 or 4 x 2 motors")
        self.profile, self._player = profile, player
        self._rows = np.array(ROWS_OF[rows])

    def open(self) -> None:
        """See `ArrayDevice`."""
        path = "v2/feedbacks?app_id=touchfield&app_name=touchfield"
        self._line = web_socket(
            self._player, path, _NAME, _MEND, _PATIENCE_S, _PATIENCE_S,
            close_timeout=_PATIENCE_S / 2, max_queue=_MOST_WAITING,
        )  # fmt: skip

    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """See `ArrayDevice`; the motors have one frequency each, their own."""
        levels = min(self.profile.levels or _FULL + 1, _FULL + 1)
        steps = steps_of(self.profile, drives, levels)
        intensities = np.floor(steps * (_FULL / max(levels - 1, 1)) + 0.5).astype(np.int64)
        lasts = math.ceil(1000 * _LASTS * seconds) if math.isfinite(seconds) else _LONGEST_MS
        if self._line is None:
            raise DeviceError(_NAME, "no connection", "one that was opened")
        try:
            self._line.send(self._message(intensities, min(max(lasts, _SHORTEST_MS), _LONGEST_MS)))
            for _ in range(_MOST_ANSWERS):
                self._line.recv(timeout=0)
        except TimeoutError:
            return  # nothing more to read
        except Exception as error:  # closed, broken, or nobody reads what is sent
            raise DeviceError(_NAME, f"that it is gone ({reason(error)})", mend=_MEND) from error

    def _message(self, intensities: Int64s, lasts_ms: int) -> str:
        submissions = []
        for panel, position in zip(intensities, POSITIONS):
            dots = panel[self._rows].reshape(-1).tolist()
            frame = {
                "Position": position,
                "DotPoints": [{"Index": index, "Intensity": value} for index, value in enumerate(dots)],
                "PathPoints": [],
                "DurationMillis": lasts_ms,
            }
            submissions.append({"Type": "frame", "Key": f"touchfield-{position}", "Frame": frame})
        return json.dumps({"Submit": submissions}, separators=(",", ":"))


def _make(words: str, profile: Device) -> ArrayDevice:
    return BHaptics(profile, address(words, "bhaptics[:HOST:PORT]", PLAYER))


def checks() -> list[Check]:
    """The library, and whether a Player listens on this machine."""
    return [library_check("websockets", "devices"), service_check(_NAME, PLAYER, _MEND)]


KIND = DeviceKind(
    "bhaptics", "bhaptics[:HOST:PORT]", "bHaptics vests through the bHaptics Player "
                                        "(WebSocket)", "tactsuit-x40",
    _make, checks, is_array=True,
)  # fmt: skip
