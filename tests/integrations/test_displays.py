"""Displays of the line protocols fall to rest within the stated time-out of a killed or stopped sender."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

from touchfield.devices.drivers import osc, pins

FOLDER = Path(__file__).resolve().parents[2] / "integrations"
SLACK_S = 0.25  # of threads and timers, on a busy machine
SENDER = """
import sys, time
import numpy as np
from touchfield.devices.drivers.registry import array_device
from touchfield.render.array_player import ArrayPlayer

class Frames:
    frame_count, rate_hz = 1, 1.0
    def drives(self, frame):
        columns, rows, _ = device.profile.lattice
        return np.full((device.profile.panels, rows, columns), 1.0, np.float32)
    def frequencies(self, frame):
        return None

device = array_device(sys.argv[1])
with ArrayPlayer(Frames(), device, rate_hz=0.1) as player:
    player.wait()
"""


def script(name: str) -> Any:
    """A script of `integrations` as a module."""
    spec = spec_from_file_location(name, FOLDER / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


pin_display, osc_array = script("pin_display"), script("osc_array")


@dataclass
class Shown:
    """Times at which a display came on, and at which it fell to rest."""

    device: str = ""
    changes: list[tuple[float, bool]] = field(default_factory=list)

    def add(self, is_on: bool) -> None:
        if not self.changes or self.changes[-1][1] != is_on:
            self.changes.append((time.monotonic(), is_on))

    def wait(self, is_on: bool, timeout_s: float) -> float:
        """The time of the latest change, which must be to `is_on`."""
        deadline_s = time.monotonic() + timeout_s
        while not self.changes or self.changes[-1][1] != is_on:
            assert time.monotonic() < deadline_s, f"not {'on' if is_on else 'at rest'} after {timeout_s} s"
            time.sleep(0.002)
        return self.changes[-1][0]


@contextmanager
def pin_side() -> Iterator[Shown]:
    shown = Shown()
    display = pin_display.Display(lambda heights, columns: shown.add(set(heights) != {"0"}))
    with socket.create_server(("127.0.0.1", 0)) as server:

        def run() -> None:
            line, _ = server.accept()
            with line:
                pin_display.serve(display, line)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        shown.device = f"pins:127.0.0.1:{server.getsockname()[1]}"
        yield shown
        thread.join(10)
        assert not thread.is_alive()


@contextmanager
def osc_side() -> Iterator[Shown]:
    shown, is_done = Shown(), threading.Event()
    array = osc_array.Array(lambda number, drives: shown.add(any(map(any, drives))))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        thread = threading.Thread(target=osc_array.serve, args=(array, line, is_done.is_set), daemon=True)
        thread.start()
        shown.device = f"osc:127.0.0.1:{line.getsockname()[1]}"
        yield shown
        is_done.set()
        thread.join(10)
        assert not thread.is_alive()


@contextmanager
def sender(device: str) -> Iterator[subprocess.Popen[bytes]]:
    """A program that shows one frame, all on, every ten seconds."""
    with subprocess.Popen([sys.executable, "-c", SENDER, device]) as program:
        try:
            yield program
        finally:
            program.kill()


SIDES = {"pins": (pin_side, pins.REST_S), "osc": (osc_side, osc.REST_S)}


@pytest.mark.parametrize("name", SIDES)
def test_a_display_rests_within_the_time_out_of_a_killed_sender(name: str) -> None:
    side, rest_s = SIDES[name]
    with side() as shown, sender(shown.device) as program:
        shown.wait(True, 60.0)
        time.sleep(2.2 * rest_s)
        assert [is_on for _, is_on in shown.changes][-1], "a frame that does not change stays"
        assert sum(is_on for _, is_on in shown.changes) == 1
        killed_s = time.monotonic()
        program.kill()
        assert shown.wait(False, 5.0) - killed_s < rest_s + SLACK_S


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="no SIGSTOP on this system")
@pytest.mark.parametrize("name", SIDES)
def test_a_stopped_sender_is_noticed_and_shows_again_when_it_goes_on(name: str) -> None:
    side, rest_s = SIDES[name]
    with side() as shown, sender(shown.device) as program:
        shown.wait(True, 60.0)
        time.sleep(0.5 * rest_s)
        stopped_s = time.monotonic()
        os.kill(program.pid, signal.SIGSTOP)
        assert 0.5 * rest_s < shown.wait(False, 5.0) - stopped_s < rest_s + SLACK_S
        os.kill(program.pid, signal.SIGCONT)
        shown.wait(True, 5.0)


def checked(content: str) -> bytes:
    return pins.checked_line(content.encode())[:-1]


def test_the_sample_display_answers_by_the_protocol() -> None:
    display = pin_display.Display(lambda heights, columns: None)
    for line, answer in (
        (b"size 2 2 2 1000", "err checksum"),
        (checked("size 2 2 2"), "err unknown line"),
        (checked("size 2 2 2 1000"), "ok 0"),
        (checked("keep 1"), "rest 1"),
        (checked("pins 2 0110"), "ok 2"),
        (checked("keep 3"), "ok 3"),
        (checked("pins 4 0120"), "err 4 heights below 2"),
        (checked("pins 4 011"), "err 4 heights below 2"),
        (checked("keep 4 0110"), "err unknown line"),
    ):
        assert display.answer(line) == answer
    assert display.heights == "0110" and display.timeout_s == 1.0
    display.keys += ["left", "in"]
    assert display.answer(checked("keys 5")) == "ok 5 left in"
    assert display.answer(checked("keys 6")) == "ok 6"
    display.rest()
    assert display.heights == "0000" and display.answer(checked("keep 5")) == "rest 5"


@pytest.mark.parametrize("change", [lambda d: d[:-1], lambda d: b"x" + d, lambda d: b"", lambda d: d[:20]])
def test_the_sample_array_ignores_damaged_datagrams(change: Callable[[bytes], bytes]) -> None:
    import numpy as np

    from touchfield.devices import device

    sent: list[bytes] = []

    class Line:
        send, close = staticmethod(sent.append), staticmethod(lambda: None)

    driver = osc.Osc(device("tactsuit-x40"), ("127.0.0.1", 9))
    driver._line = Line()
    driver.put_drives(np.full((2, 5, 4), 0.5, np.float32), None, 0.1)
    array = osc_array.Array(lambda number, drives: None)
    assert not array.take(change(sent[0])) and not array.drives
    assert array.take(sent[0]) and array.drives == [[0.5] * 20] * 2 and array.timeout_s == 0.5
