"""A pin display in this terminal, for ``touchfield play FILE --device pins:127.0.0.1:7000``.

    python integrations/pin_display.py [PORT]

Type a key and Enter while it shows a map: left, right, up, down, in, out, home or legend.

It follows the protocol of `touchfield.devices.drivers.pins` with the standard library alone: a pattern for
the program or board of a real display. A pin that is up is drawn as its height, one that is down as a point.
"""

from __future__ import annotations

import binascii
import socket
import sys
import threading
from collections.abc import Callable

DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"
MAX_LINE_BYTES = 1 << 15
START_S = 10.0
"""Time for the first line, which states the time-out."""


class Display:
    """Pins and the protocol; `show` gets the heights, a digit for each pin, each time that they change."""

    def __init__(self, show: Callable[[str, int], None]) -> None:
        self._show = show
        self.timeout_s = START_S
        self.pins, self.columns, self.levels = 0, 0, 0
        self.heights = ""
        self.is_resting = True
        self.keys: list[str] = []  # pressed, and not reported yet

    def rest(self) -> None:
        """Lower all pins: after the time-out, and when the connection is closed."""
        if not self.is_resting:
            self._set("0" * self.pins)
        self.is_resting = True

    def answer(self, line: bytes) -> str:
        """Take a line without its end; returns the answer."""
        content, star, code = line.rpartition(b" *")
        if not star or code != b"%04x" % binascii.crc_hqx(content, 0xFFFF):
            return "err checksum"
        try:
            word, *values = content.decode("ascii").split(" ")
            if word == "size":
                return self._size(*map(int, values))
            number, *heights = values
            if word == "pins":
                return self._pins(int(number), *heights)
            if word == "keep" and not heights:
                return f"{'rest' if self.is_resting else 'ok'} {int(number)}"
            if word == "keys" and not heights:
                keys, self.keys = self.keys, []
                return " ".join(["ok", str(int(number)), *keys])
        except (ValueError, TypeError):
            pass
        return "err unknown line"

    def _size(self, rows: int, columns: int, levels: int, timeout_ms: int) -> str:
        self.pins, self.columns, self.levels = rows * columns, columns, levels
        self.timeout_s = timeout_ms / 1000
        self._set("0" * self.pins)
        return "ok 0"

    def _pins(self, number: int, heights: str) -> str:
        if len(heights) != self.pins or not set(heights) <= set(DIGITS[: self.levels]):
            return f"err {self.pins} heights below {self.levels}"
        self._set(heights)
        self.is_resting = False
        return f"ok {number}"

    def _set(self, heights: str) -> None:
        self.heights = heights
        self._show(heights, self.columns)


def serve(display: Display, line: socket.socket) -> None:
    """Serve one connection until it is closed or silent before its first line."""
    received = b""
    try:
        while True:
            line.settimeout(display.timeout_s)
            try:
                data = line.recv(4096)
            except TimeoutError:
                if not display.pins:
                    return
                display.rest()
                continue
            if not data:
                return
            *lines, received = (received + data).split(b"\n")
            if len(received) > MAX_LINE_BYTES:
                return
            for text in lines:
                line.sendall(display.answer(text).encode() + b"\n")
    except OSError:
        return  # the other side is gone
    finally:
        display.rest()


def draw(heights: str, columns: int) -> None:
    """Draw the pins, row by row."""
    rows = [heights[first : first + columns] for first in range(0, len(heights), columns)]
    print("\n".join(row.replace("0", ".") for row in rows), end="\n\n", flush=True)


KEYS = ("left", "right", "up", "down", "in", "out", "home", "legend")


def read_keys(display: Display) -> None:
    """Take keys from standard input, a word a line."""
    for line in sys.stdin:
        if (key := line.strip()) in KEYS:
            display.keys.append(key)
        elif key:
            print(f"keys: {', '.join(KEYS)}", flush=True)


def main() -> None:
    port = int(sys.argv[1]) if len(sys.argv) > 1 else 7000
    with socket.create_server(("127.0.0.1", port)) as server:
        print(f"pins:127.0.0.1:{port}", flush=True)
        display = Display(draw)
        threading.Thread(target=read_keys, args=(display,), daemon=True).start()
        while True:
            line, _ = server.accept()
            with line:
                serve(display, line)


if __name__ == "__main__":
    main()
