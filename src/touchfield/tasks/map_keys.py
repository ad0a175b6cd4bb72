"""`TerminalKeys`: what a person requests of a map by the keys of this terminal, while it plays."""

from __future__ import annotations

import os
import select
import sys
from types import TracebackType
from typing import IO, Any, Final

try:
    import termios
    import tty
except ImportError:  # Windows
    termios = None  # type: ignore[assignment]

QUIT: Final = "quit"
MOVES_OF_KEYS: Final = {
    "\x1b[A": "up", "\x1b[B": "down", "\x1b[C": "right", "\x1b[D": "left",
    "\x1bOA": "up", "\x1bOB": "down", "\x1bOC": "right", "\x1bOD": "left",
    "+": "in", "=": "in", "-": "out", "h": "home", "l": "legend", "q": QUIT,
}  # fmt: skip
"""Move of each key; the two rows of arrows are those of terminals in normal and in application mode."""
HELP: Final = "arrow keys pan, + and - zoom, h shows the whole map, l the legend, q ends"
_MAX_BYTES: Final = 256


class TerminalKeys:
    """Keys of a terminal, read without Enter; a context manager that restores the terminal.

    `stream` is standard input if not given. If it is no terminal, or the system has no `termios`, there are
    no keys, and `is_available` is False.
    """

    def __init__(self, stream: IO[Any] | None = None) -> None:
        self._stream, self._unread = sys.stdin if stream is None else stream, ""
        self._saved: list[Any] | None = None
        self.is_available = termios is not None and self._stream is not None and self._stream.isatty()

    def __enter__(self) -> TerminalKeys:
        if self.is_available:
            self._saved = termios.tcgetattr(self._stream.fileno())
            tty.setcbreak(self._stream.fileno())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._saved is not None:
            termios.tcsetattr(self._stream.fileno(), termios.TCSADRAIN, self._saved)

    def pressed(self) -> tuple[str, ...]:
        """Return the moves of the keys that were pressed since the last call; does not wait."""
        if not self.is_available:
            return ()
        descriptor = self._stream.fileno()
        if select.select([descriptor], [], [], 0)[0]:
            data = os.read(descriptor, _MAX_BYTES)
            self.is_available = bool(data)  # the terminal was closed
            self._unread += data.decode("ascii", "replace")
        moves, self._unread = moves_of(self._unread)
        return moves


def moves_of(text: str) -> tuple[tuple[str, ...], str]:
    """Return the moves of a text of keys, and the start of an arrow key at its end.

    >>> moves_of("+\\x1b[Cx\\x1b[")
    (('in', 'right'), '\\x1b[')
    """
    moves: list[str] = []
    index = 0
    while index < len(text):
        length = 3 if text[index] == "\x1b" else 1
        if index + length > len(text) and text[index:] in ("\x1b", "\x1b[", "\x1bO"):
            return tuple(moves), text[index:]
        move = MOVES_OF_KEYS.get(text[index : index + length])
        moves += [move] if move else []
        index += length if move or length == 1 else 1
    return tuple(moves), ""
