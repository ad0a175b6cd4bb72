"""bHaptics vests through the bHaptics Player, by its WebSocket of version 2: no key, no licence, loopback.

Protocol: one JSON message a frame to ``/v2/feedbacks``, in which each panel is a submission of the type "frame": its
position (VestFront, VestBack), its dots (index and intensity 0 to 100) and how long they last. A later submission of
the same key takes the place of the one before. What the Player sends is its own state; it is read and left aside.

The protocol speaks of 20 dots a side, 4 columns and 5 rows from the top left, whatever the vest: that is the TactSuit
X40. A vest with fewer rows is driven through all 20, so that no motor is missed whichever dots the Player takes it
from: of four rows (TactSuit Pro) the lowest is sent as the fourth and the fifth, of two (X16, Air) the upper as the
first two and the lower as the other three. The second is how the firmware SenseShift groups the dots for an X16; the
first is our choice.

Intensities are rounded to the steps that the profile's motors have.
"""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.adapters.array_registry import ArrayKind, steps_of
from touchfield.adapters.check import Check, library_check
from touchfield.adapters.lines import Address, address, connected, reason
from touchfield.errors import DeviceError, InvalidArgument, MissingExtra
from touchfield.render.array_device import ArrayDevice

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.devices import Device

__all__ = ["KIND", "BHaptics"]

PLAYER: Final[Address] = ("127.0.0.1", 15881)
_NAME: Final = "bHaptics Player"
_MEND: Final = "Start the bHaptics Player on that machine and pair the vest"

_POSITIONS: Final = ("VestFront", "VestBack")
_COLUMNS: Final = 4
_ROWS_OF: Final = {5: (0, 1, 2, 3, 4), 4: (0, 1, 2, 3, 3), 2: (0, 0, 1, 1, 1)}
"""Rows of the vest -> the one that each row of the protocol shows."""

_FULL: Final = 100
_USUAL_LEVELS: Final = _FULL + 1
_LASTS: Final = 1.5
"""Frames that a frame lasts if none follows: a little late must not be felt as a gap."""
_SHORTEST_MS, _LONGEST_MS = 50, 10000  # bHaptics tact-js, submitDot

_PATIENCE_S: Final = 2.0
_MOST_BYTES: Final = 1 << 16
_MOST_ANSWERS: Final = 64
"""Messages of the Player that are read and left aside in a frame."""
_MOST_WAITING: Final = 1024
"""Messages that may wait; a full queue of websockets 17 holds up for ever who then sends on a line just closed."""


class BHaptics(ArrayDevice):
    """A vest behind a bHaptics Player.

    Parameters
    ----------
    profile : Device
        Of one or two panels with 4 columns and 2, 4 or 5 rows.
    player : (str, int)
        Where the Player listens.

    Raises
    ------
    InvalidArgument
        If the protocol knows no such vest.
    """

    def __init__(self, profile: Device, player: Address = PLAYER) -> None:
        columns, rows, _ = profile.lattice
        if columns != _COLUMNS or rows not in _ROWS_OF or profile.panels > len(_POSITIONS):
            found = f"{profile.name}, {profile.panels} panels of {columns} x {rows}"
            raise InvalidArgument("bhaptics", found, "one or two panels of 4 x 5, 4 x 4 or 4 x 2 motors")
        self.profile, self._player = profile, player
        self._rows = np.array(_ROWS_OF[rows])
        self._socket: Any = None

    def open(self) -> None:
        """See `ArrayDevice`."""
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        except ImportError:
            raise MissingExtra("the bHaptics Player", "websockets", "devices") from None
        host, port = self._player
        name = f"[{host}]" if ":" in host else host
        line = connected(self._player, _NAME, _PATIENCE_S, _MEND)
        try:
            making: Any = connect(
                f"ws://{name}:{port}/v2/feedbacks?app_id=touchfield&app_name=touchfield",
                sock=line, compression=None, open_timeout=_PATIENCE_S, close_timeout=_PATIENCE_S / 2,
                max_size=_MOST_BYTES, max_queue=_MOST_WAITING,
            )  # fmt: skip
            self._socket = making.__enter__()  # as of release 17 the connection is made only here
        except (OSError, WebSocketException, EOFError) as error:
            line.close()
            raise DeviceError(_NAME, f"no WebSocket at {host}:{port} ({reason(error)})", mend=_MEND) from error

    def put_drives(
        self, drives: NDArray[np.float32], frequencies_hz: NDArray[np.float32] | None, seconds: float
    ) -> None:
        """See `ArrayDevice`; the motors have one frequency each, their own."""
        levels = min(self.profile.levels or _USUAL_LEVELS, _USUAL_LEVELS)
        steps = steps_of(self.profile, drives, levels)
        intensities = np.floor(steps * (_FULL / max(levels - 1, 1)) + 0.5).astype(np.int64)
        lasts = math.ceil(1000 * _LASTS * seconds) if math.isfinite(seconds) else _LONGEST_MS
        self._send(intensities, min(max(lasts, _SHORTEST_MS), _LONGEST_MS))

    def close(self) -> None:
        """See `ArrayDevice`."""
        line, self._socket = self._socket, None
        if line is None:
            return
        with suppress(Exception):
            columns, rows, _ = self.profile.lattice
            line.send(self._message(np.zeros((self.profile.panels, rows, columns), np.int64), _SHORTEST_MS))
        with suppress(Exception):
            line.close()

    def _send(self, intensities: NDArray[np.int64], lasts_ms: int) -> None:
        from websockets.exceptions import WebSocketException

        if self._socket is None:
            raise DeviceError(_NAME, "no connection", "one that was opened")
        try:
            self._socket.send(self._message(intensities, lasts_ms))
            for _ in range(_MOST_ANSWERS):
                self._socket.recv(timeout=0)
        except TimeoutError:
            return  # nothing more to read
        except (OSError, WebSocketException, EOFError) as error:
            raise DeviceError(_NAME, f"that it is gone ({reason(error)})", mend=_MEND) from error

    def _message(self, intensities: NDArray[np.int64], lasts_ms: int) -> str:
        submissions = []
        for panel, position in zip(intensities, _POSITIONS):
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
    found = [library_check("websockets", "devices")]
    what = f"{_NAME} on port {PLAYER[1]}"
    try:
        connected(PLAYER, _NAME, 0.3, "").close()
    except DeviceError as error:
        found.append(Check(what, False, error.found, _MEND))
    else:
        found.append(Check(what, True, "it listens"))
    return found


KIND = ArrayKind(
    "bhaptics",
    "bhaptics[:HOST:PORT]",
    "bHaptics vests through the bHaptics Player (WebSocket)",
    "tactsuit-x40",
    _make,
    checks,
)
