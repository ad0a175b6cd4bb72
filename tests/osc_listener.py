"""A listener for Open Sound Control in the tests: decodes with another library and checks each message."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from pythonosc.osc_bundle import OscBundle

from touchfield.devices import Device
from touchfield.devices.drivers.osc import MAX_BYTES


class Listener:
    """Reassembles frames from datagrams, and checks each message against the scheme."""

    def __init__(self, profile: Device) -> None:
        columns, rows, _ = profile.lattice
        self.shape = (profile.panels, rows, columns)
        self.frames: list[dict[str, np.ndarray]] = []
        self.seconds: list[float] = []
        self.sizes: list[int] = []
        self._parts = 0

    def take(self, datagram: bytes) -> None:
        assert len(datagram) <= MAX_BYTES and OscBundle.dgram_is_bundle(datagram)
        self.sizes.append(len(datagram))
        head, *rest = list(OscBundle(datagram))
        assert head.address == "/touchfield/frame" and rest
        number, seconds, part, parts, *shape, timeout_ms = head.params
        assert tuple(shape) == self.shape and 0 <= part < parts and seconds >= 0
        assert timeout_ms == 500 and type(timeout_ms) is int
        if part == 0:
            assert self._parts == 0
            self.frames.append({"number": np.array(number)})
            self.seconds.append(seconds)
        frame = self.frames[-1]
        assert frame["number"] == number and part == self._parts
        self._parts = (part + 1) % parts
        for message in rest:
            root, kind, panel = message.address.removeprefix("/").split("/")
            assert root == "touchfield" and kind in ("drives", "frequencies")
            first, *values = message.params
            assert type(first) is int and values and all(type(v) is float for v in values)
            levels = frame.setdefault(kind, np.full(self.shape, np.nan))
            flat = levels[("front", "back", "2").index(panel)].reshape(-1)
            assert np.isnan(flat[first : first + len(values)]).all()
            flat[first : first + len(values)] = values
        if not self._parts:
            assert not any(np.isnan(v).any() for v in frame.values())


@contextmanager
def listening() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        line.bind(("127.0.0.1", 0))
        line.settimeout(10)
        yield line
