"""`play_map`: pans and zooms a tactile map on a display, by the keys of the terminal, the display's own keys,
or a list of moves.

A move shows another view of the map (`touchfield.pipeline.stored_map`), drawn when the map was made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic, sleep
from typing import Any, Final

import numpy as np

from touchfield.arrays import Bools, Float32s
from touchfield.devices import Device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.pipeline.array_medium import PANELS
from touchfield.pipeline.stored_map import MOVES, StoredMap
from touchfield.render.array_player import ArrayDevice
from touchfield.render.readiness import open_when_ready
from touchfield.tasks.map_keys import HELP, QUIT, TerminalKeys

ALL_MOVES: Final = (*MOVES, "in", "out", "home", "legend")
MAX_MOVES: Final = 10_000
_POLL_S: Final = 0.02
_MAX_MATCHES: Final = 8


class SimulatedDisplay(ArrayDevice):
    """A display without hardware: `heights` are the drives that it shows, float32 [panels, rows, columns]."""

    def __init__(self, profile: Device) -> None:
        self.profile = profile
        columns, rows, _ = profile.lattice
        self.heights = np.zeros((profile.panels, rows, columns), np.float32)

    def open(self) -> None:
        """See `ArrayDevice`."""

    def put_drives(self, drives: Float32s, frequencies_hz: Float32s | None, seconds: float) -> None:
        """See `ArrayDevice`."""
        self.heights = drives

    def close(self) -> None:
        """See `ArrayDevice`; the latest heights can still be read."""


@dataclass
class MapWalk:
    """Where a reader is in a map: the view, and the page of its legend if that is shown."""

    stored: StoredMap

    def __post_init__(self) -> None:
        self.position = self.stored.start
        self.page: int | None = None

    def do(self, move: str) -> str:
        """Do one of `ALL_MOVES`; returns what is shown then, for people.

        "legend" shows the first page of the view's legend, then the next ones, then the map again.
        """
        if move == "legend":
            pages = self.stored.legend(self.position)
            if not pages:
                return "the map has no Braille, and no legend"
            self.page = 0 if self.page is None else self.page + 1
            if self.page < len(pages):
                return f"legend, page {self.page + 1} of {len(pages)}"
            self.page = None
        else:
            before, self.page = self.position, None
            self.position = self.stored.moved(before, move)
            if self.position == before:
                return f"{move}: the map ends here"
        return self.stored.describe(self.position)

    def pins(self) -> Bools:
        """Return the pins to show, bool [rows, columns]."""
        if self.page is not None:
            return self.stored.legend(self.position)[self.page]
        return self.stored.view(self.position).raised


def moves_in(text: str) -> tuple[str, ...]:
    """Return the moves of an option, such as "in,right,right".

    Raises `InvalidArgument` that lists the moves if one is unknown.
    """
    moves = tuple(word.strip().lower() for word in text.split(",")) if text.strip() else ()
    if len(moves) > MAX_MOVES:
        raise InvalidArgument("--pans", f"{len(moves)} moves", f"at most {MAX_MOVES}")
    for move in moves:
        if move not in ALL_MOVES:
            raise InvalidArgument("--pans", repr(move[:40]), f"moves by commas: {', '.join(ALL_MOVES)}")
    return moves


def go_to(walk: MapWalk, name: str) -> tuple[str, ...]:
    """Show the place of a name; returns what was found, for people.

    Raises `InvalidArgument` with similar names if no place has the name.
    """
    found = walk.stored.find(name)
    if not found.places:
        hint = f"Similar names: {', '.join(found.near)}." if found.near else ""
        raise InvalidArgument("--find", f"no place named {name[:80]!r}", "a name of the map", hint)
    walk.position, walk.page = walk.stored.position_of(found.places[0]), None
    others = [walk.stored.describe_place(place) for place in found.places[1 : 1 + _MAX_MATCHES]]
    omitted = len(found.places) - 1 - len(others)
    lines = [f"found: {walk.stored.describe_place(found.places[0])}"]
    if others:
        more = f", and {omitted} more" if omitted else ""
        lines.append(f"also found: {', '.join(others)}{more}")
    return tuple(lines)


def play_map(
    walk: MapWalk,
    driver: ArrayDevice,
    moves: Iterable[str],
    *,
    panel: str = PANELS[0],
    seconds: float | None,
    wait_s: float,
    on_note: Callable[[str], None],
) -> dict[str, Any]:
    """Show a map, do `moves`, then those of the keys for `seconds`; returns figures with stable keys.

    None is until the key q or an interrupt, 0 ends after the moves. The display is off afterwards. Raises
    `DeviceError` if it is missing or gone.
    """
    record = walk.stored.record
    columns, rows, _ = driver.profile.lattice
    if (rows, columns) != (record.rows, record.columns):
        found = f"{driver.profile.name} of {columns} x {rows} pins"
        raise InvalidArgument("device", found, f"a display of {record.columns} x {record.rows}, as the map")
    display = _DisplayedMap(walk, driver, panel, on_note)
    try:
        open_when_ready(driver, wait_s, on_note=on_note)
        display.put()
        on_note(walk.stored.describe(walk.position))
        with suppress(KeyboardInterrupt):
            for move in moves:
                display.do(move)
            if seconds != 0:
                with TerminalKeys() as keys:
                    _follow_keys(display, keys, seconds)
    finally:
        driver.close()
    return display.figures() | {"device_notes": list(driver.notes)}


@dataclass
class _DisplayedMap:
    """A map on a display, and how long its updates took."""

    walk: MapWalk
    driver: ArrayDevice
    panel: str
    on_note: Callable[[str], None]

    def __post_init__(self) -> None:
        self.steps: list[dict[str, Any]] = []
        self.longest_s = 0.0
        self.updates = 0

    def put(self) -> None:
        """Show the pins."""
        columns, rows, _ = self.driver.profile.lattice
        panels = PANELS[: self.driver.profile.panels]
        if self.panel not in panels:
            raise InvalidArgument(
                "panel", f"{self.panel!r} of {self.driver.profile.name}", " or ".join(panels)
            )
        drives = np.zeros((self.driver.profile.panels, rows, columns), np.float32)
        drives[panels.index(self.panel)] = self.walk.pins()
        self.driver.put_drives(drives, None, self.driver.keep_alive_s)
        self.updates += 1

    def do(self, move: str) -> None:
        """Do a move and show what comes of it."""
        start_s = monotonic()
        text = self.walk.do(move)
        self.put()
        self.longest_s = max(self.longest_s, monotonic() - start_s)
        self.on_note(text)
        position = self.walk.position
        self.steps = [
            *self.steps[-MAX_MOVES:],
            {"move": move, "level": position.level + 1, "row": position.row + 1}
            | {"column": position.column + 1, "page": 0 if self.walk.page is None else self.walk.page + 1},
        ]

    def figures(self) -> dict[str, Any]:
        """Return the figures of the playback."""
        position = self.walk.position
        return {
            "updates": self.updates,
            "longest_update_s": self.longest_s,
            "level": position.level + 1,
            "row": position.row + 1,
            "column": position.column + 1,
            "moves": self.steps,
        }


def _follow_keys(display: _DisplayedMap, keys: TerminalKeys, seconds: float | None) -> None:
    """Do what the keys of the terminal and of the display request, until the end of the time or q."""
    if keys.is_available:
        display.on_note(HELP)
    start_s = alive_s = monotonic()
    limit_s = math.inf if seconds is None else seconds
    while (now_s := monotonic()) - start_s < limit_s:
        for move in (*keys.pressed(), *display.driver.pressed_keys()):
            if move == QUIT:
                return
            if move in ALL_MOVES:
                display.do(move)
                alive_s = monotonic()
            else:
                raise DeviceError(display.driver.title, f"the key {move!r}", f"one of {', '.join(ALL_MOVES)}")
        if now_s - alive_s >= display.driver.keep_alive_s:
            display.driver.keep_alive()
            alive_s = monotonic()
        sleep(_POLL_S)
