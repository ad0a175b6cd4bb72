"""An array of actuators in this terminal, for ``touchfield play FILE --device osc:127.0.0.1:9000``.

    python integrations/osc_array.py [PORT]

It follows the protocol of `touchfield.devices.drivers.osc` with the standard library alone: a pattern for the
program of a real array. Each frame is a line: its number, and the greatest drive of each panel.
"""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Callable, Iterator
from time import monotonic

Message = tuple[str, list[float]]
Drives = list[list[float]]
MAX_BYTES = 1 << 16
PANELS = ("front", "back")


def text_at(data: bytes, at: int) -> tuple[str, int]:
    """Return a text, and where it ends: after its zero, at a multiple of four bytes."""
    end = data.index(b"\0", at)
    return data[at:end].decode("ascii"), at + (end - at + 4) // 4 * 4


def messages(bundle: bytes) -> Iterator[Message]:
    """Yield address and numbers of each message of a bundle; ValueError or struct.error if it is none."""
    if bundle[:8] != b"#bundle\0":
        raise ValueError("no bundle")
    at = 16
    while at < len(bundle):
        (size,) = struct.unpack_from(">i", bundle, at)
        message, at = bundle[at + 4 : at + 4 + size], at + 4 + size
        address, values_at = text_at(message, 0)
        types, values_at = text_at(message, values_at)
        yield address, list(struct.unpack_from(">" + types[1:], message, values_at))


class Array:
    """Drives of an array, and the protocol; `show` gets the number of a frame and a list for each panel."""

    def __init__(self, show: Callable[[int, Drives], None]) -> None:
        self._show = show
        self.timeout_s = 1.0
        self.drives: Drives = []
        self._number, self._parts, self._next = -1, 0, []  # of the frame that arrives

    def rest(self) -> None:
        """Switch all actuators off, after the time-out."""
        if any(map(any, self.drives)):
            self.drives = [[0.0] * len(panel) for panel in self.drives]
            self._show(self._number, self.drives)

    def take(self, datagram: bytes) -> bool:
        """Take a datagram; returns whether it completes a frame."""
        try:
            (address, head), *rest = messages(datagram)
            if address != "/touchfield/frame":
                return False
            number, _, part, parts, panels, rows, columns, timeout_ms = head
            if part == 0:
                self._number, self._parts = int(number), 0
                self._next = [[0.0] * int(rows * columns) for _ in range(int(panels))]
            if (number, part) != (self._number, self._parts):
                return False  # a part was lost, and with it this frame
            for address, (first, *values) in rest:
                _, _, quantity, panel = address.split("/")
                index = PANELS.index(panel) if panel in PANELS else int(panel)
                if quantity == "drives":
                    self._next[index][int(first) : int(first) + len(values)] = values
        except (ValueError, IndexError, struct.error):
            return False
        self._parts += 1
        if self._parts < parts:
            return False
        self.drives, self.timeout_s = self._next, timeout_ms / 1000
        self._show(self._number, self.drives)
        return True


def serve(array: Array, line: socket.socket, must_stop: Callable[[], bool] = lambda: False) -> None:
    """Serve datagrams; the array rests if no complete frame arrives for the time-out."""
    rest_s = monotonic() + array.timeout_s
    while not must_stop():
        line.settimeout(max(1e-3, rest_s - monotonic()))
        try:
            is_complete = array.take(line.recv(MAX_BYTES))
        except TimeoutError:
            is_complete = False
        if is_complete:
            rest_s = monotonic() + array.timeout_s
        elif monotonic() >= rest_s:
            array.rest()
            rest_s = monotonic() + array.timeout_s


def draw(number: int, drives: Drives) -> None:
    """Write a line."""
    print(number, *(f"{max(panel, default=0.0):.2f}" for panel in drives), flush=True)


def main() -> None:
    port = int(sys.argv[1]) if len(sys.argv) > 1 else 9000
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", port))
        print(f"osc:127.0.0.1:{port}", flush=True)
        serve(Array(draw), line)


if __name__ == "__main__":
    main()
