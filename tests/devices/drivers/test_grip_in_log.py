"""Buttons and gripper of real drivers, from their fakes to the log and the caller."""

from __future__ import annotations

import csv
import ctypes
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_driver import FakeDriver
from fake_haply import FakeHaply, fake_haply
from tests.render.player_makers import OMNI, laid_out, numbered_medium

from touchfield import pipeline
from touchfield.cli.main import _exit_code
from touchfield.devices.drivers.forcedimension import ForceDimension
from touchfield.devices.drivers.registry import point_device
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.block import layout
from touchfield.render.player import ButtonEvent, Player
from touchfield.render.servo import VirtualClock, serve
from touchfield.sources.tiny_scenes import tiny_scenes

PRESSES = {40: {"a": True}, 60: {"a": True, "c": True}, 80: {"c": True}, 81: {}}
"""Buttons of the grip from these messages on."""


def message(n: int) -> dict[str, Any]:
    """A state with a grip that presses its buttons."""
    state = FakeHaply.state(n)
    state["inverse3"][0]["state"]["cursor_position"] = {"x": 0.0, "y": 0.0, "z": 0.0}
    pressed = next((PRESSES[start] for start in sorted(PRESSES, reverse=True) if n >= start), {})
    buttons = {name: pressed.get(name, False) for name in "abc"}
    grip = {"orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}, "buttons": buttons}
    return {**state, "wireless_verse_grip": [{"device_id": "0", "state": grip}]}


def test_a_caller_gets_the_buttons_of_a_verse_grip() -> None:
    events: list[ButtonEvent] = []
    with fake_haply(first=message(0), answer=lambda n, _: message(n)) as fake:
        opener = point_device(f"haply:127.0.0.1:{fake.port}").opener
        with Player(numbered_medium(20), OMNI, opener, is_realtime=False, on_button=events.append) as player:
            player.play()
            assert player.wait(20)
    assert [(event.button, event.is_pressed) for event in events] == [
        (0, True), (2, True), (0, False), (2, False)
    ]  # fmt: skip


def test_the_log_of_play_has_the_buttons_of_a_verse_grip(tmp_path: Path) -> None:
    path, log = tmp_path / "scene.touch", tmp_path / "log.csv"
    pipeline.encode(tiny_scenes()[0], path, EncodeSpec(nw=3))
    first: list[
        tuple[float, int]
    ] = []  # time of the first message, and number of that when the presses start

    def answer(n: int, _: object) -> dict[str, Any]:
        """It presses two seconds after the start, when it plays."""
        now_s = time.monotonic()
        if not first:
            first.append((now_s, 1 << 60))
        if first[0][1] > n and now_s > first[0][0] + 2.0:
            first[0] = (first[0][0], n)
        return message(max(n - first[0][1], 0))

    with fake_haply(first=message(0), answer=answer) as fake:
        arguments = ["play", str(path), "--device", f"haply:127.0.0.1:{fake.port}", "--log", str(log)]
        assert _exit_code([*arguments, "--loop", "--seconds", "4"]) == 0
    with log.open() as file:
        buttons = [int(row["buttons"]) for row in csv.DictReader(file)]
    changes = [value for value, before in zip(buttons[1:], buttons, strict=False) if value != before]
    assert changes == [1, 5, 4, 0]


def test_the_log_has_buttons_and_gripper_of_a_force_dimension_device(dhd: FakeDriver) -> None:
    dhd.library.fake_wrist(1)
    dhd.library.fake_grip.argtypes = (ctypes.c_int, ctypes.c_double)
    session, memory = laid_out(numbered_medium(1))
    feeder = session.feeder(memory, is_timed=False)
    feeder.fill_lookahead(5)
    session.order(memory, mode=layout.PLAYING)
    ticks = memory.receiver["counts"]

    def before_tick() -> bool:
        n = int(ticks["ticks"])
        dhd.library.fake_grip(1 if 100 <= n < 200 else 4, 0.001 * (n // 100))
        return n > 300

    serve(memory, ForceDimension(), VirtualClock(), before_tick)
    rows = memory.array(layout.LOG_ROW, session.layout.log, 300)
    n = np.arange(300)
    assert (rows["buttons"] == np.where((n >= 100) & (n < 200), 1, 4)).all()
    assert rows["gripper_m"] == pytest.approx(0.001 * (n // 100))
