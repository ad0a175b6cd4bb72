"""Buttons and gripper for the caller of a player: attributes, and a callback that misses no press."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from player_makers import OMNI, RestingDevice, numbered_medium
from processes import no_leftovers

from touchfield.render.block import COLUMNS
from touchfield.render.player import ButtonEvent, Player, button_events
from touchfield.render.point_device import Point, Quaternion

__all__ = ["no_leftovers"]  # a fixture of all tests here


class Pen(RestingDevice):
    """Presses button 1 for a single tick every 200 ticks, and holds button 0 from tick 300 on."""

    def position_m(self) -> Point:
        super().position_m()
        return 0.001, 0.0, 0.0

    def buttons(self) -> int:
        ticks = len(self.forces)
        return (ticks >= 300) | (ticks % 200 == 100) << 1

    def gripper_m(self) -> float:
        return 0.012

    def orientation(self) -> Quaternion:
        return 0.0, 1.0, 0.0, 0.0


def rows_of(buttons: list[int]) -> np.ndarray:
    rows = np.zeros(len(buttons), COLUMNS)
    rows["buttons"], rows["time_s"] = buttons, 1e-3 * np.arange(len(buttons))
    rows["media_s"], rows["position_m"][:, 2], rows["gripper_m"] = 7.0, 0.25, 0.02
    return rows


def test_each_change_of_a_button_is_an_event() -> None:
    events = list(button_events(rows_of([0, 1, 1, 6, 6, 0]), 0))
    assert [(event.button, event.is_pressed, event.time_s) for event in events] == [
        (0, True, 0.001), (0, False, 0.003), (1, True, 0.003), (2, True, 0.003),
        (1, False, 0.005), (2, False, 0.005),
    ]  # fmt: skip
    assert events[0][3:] == (7.0, (0.0, 0.0, 0.25), 0.02)
    assert not list(button_events(rows_of([2, 2]), 2)) and not list(button_events(rows_of([]), 5))
    (released,) = button_events(rows_of([0, 0]), 8)
    assert released.button == 3 and not released.is_pressed and released.time_s == 0.0


def test_a_caller_sees_each_press_and_the_grip_of_the_latest_tick() -> None:
    events: list[ButtonEvent] = []
    player = Player(numbered_medium(40), OMNI, Pen, loop=True, is_realtime=False, on_button=events.append)
    with player:
        player.play()
        deadline_s = time.monotonic() + 20
        while not player.buttons & 1:
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        player.wait(0.3)
        grip = player.grip
        assert player.gripper_m == 0.012 and grip.gripper_m == 0.012
        assert grip.orientation == (0.0, 1.0, 0.0, 0.0) and grip.buttons & 1
    rows = player.log()
    expected = list(button_events(rows, 0))
    assert events == expected  # also of presses of one tick
    short = [event for event in events if event.button == 1]
    assert len(short) >= 4 and [event.is_pressed for event in short[:4]] == [True, False, True, False]
    assert [event.is_pressed for event in events if event.button == 0] == [True]
    assert events[0].position_m == (0.001, 0.0, 0.0)
    assert player.grip.buttons == 0  # closed


def test_a_press_can_give_an_order() -> None:
    paused = threading.Event()

    def pause(event: ButtonEvent) -> None:
        player.pause()
        paused.set()

    player = Player(numbered_medium(40), OMNI, Pen, loop=True, is_realtime=False, on_button=pause)
    with player:
        player.play()
        assert paused.wait(20)
        deadline_s = time.monotonic() + 20
        while player.media_s != (media_s := player.media_s) or player.wait(0.1) or player.media_s != media_s:
            assert time.monotonic() < deadline_s, "media time never stands still for 0.1 s"


def test_an_error_of_the_callback_stops_the_player() -> None:
    def fail(event: ButtonEvent) -> None:
        raise ValueError("from the caller")

    player = Player(numbered_medium(40), OMNI, Pen, loop=True, is_realtime=False, on_button=fail)
    with player:
        player.play()
        with pytest.raises(ValueError, match="from the caller"):
            player.wait(30)
    assert not player.log()["force_n"][-1].any()
