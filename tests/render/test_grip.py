"""A rotating hand: orientation in and torque out at every tick; both are released like a force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from player_makers import AXES, GRID, RestingDevice, numbered_field

from touchfield.devices import device
from touchfield.devices.drivers.simulated import SimHand
from touchfield.errors import DeviceError
from touchfield.medium import HapticMedium
from touchfield.medium.trace import Trace
from touchfield.render.block import FLAGS
from touchfield.render.offline import run_offline
from touchfield.render.player import Player
from touchfield.render.point_device import Quaternion
from touchfield.render.spec import RenderSpec
from touchfield.render.tool import Tool

SIGMA = replace(device("sigma.7"), axes=AXES, torque_continuous_nm=None)
STICK = Tool(np.array([[0.02, 0.0, 0.0]]), np.array([[0.0, 0.0, -1.0]]), "stick")
SPEC = RenderSpec(tool=STICK)


class Wrist(RestingDevice):
    """Rotates by a tenth of a radian a tick about z, with a button and a gripper; records its torques."""

    def __init__(self) -> None:
        super().__init__()
        self.torques: list[tuple[float, float, float]] = []

    def orientation(self) -> Quaternion:
        half = 0.05 * len(self.forces)
        return math.cos(half), 0.0, 0.0, math.sin(half)

    def buttons(self) -> int:
        return 5 if len(self.forces) > 50 else 0

    def gripper_m(self) -> float:
        return 0.001 * len(self.forces)

    def put_wrench(self, fx: float, fy: float, fz: float, tx: float, ty: float, tz: float) -> None:
        self.put_force_n(fx, fy, fz)
        self.torques.append((tx, ty, tz))

    def advance(self, dt_s: float) -> None:
        return


class Breaking(Wrist):
    """Fails after some ticks."""

    def position_m(self) -> tuple[float, float, float]:
        if len(self.forces) == 100:
            raise DeviceError("fake device", "no answer")
        return super().position_m()


def medium(frames: int = 20) -> HapticMedium:
    return HapticMedium(GRID, 50.0, frames, numbered_field, AXES)


def test_device_state_is_logged_and_the_torque_is_that_of_the_lever() -> None:
    devices: list[Wrist] = []

    def opener() -> Wrist:
        devices.append(Wrist())
        return devices[0]

    rows = run_offline(medium(), SIGMA, opener, SPEC, seconds=0.3).log
    torques = np.array(devices[0].torques)
    assert torques[: len(rows)] == pytest.approx(rows["torque_nm"]) and not torques[-1].any()
    n = np.arange(len(rows))
    assert rows["orientation"][:, 0] == pytest.approx(np.cos(0.05 * n))
    assert rows["buttons"][[10, 60]].tolist() == [0, 5] and rows["gripper_m"][60] == pytest.approx(0.06)
    lever = 0.02 * np.stack([np.cos(0.1 * n), np.sin(0.1 * n), 0 * n], axis=1)
    expected = np.cross(lever, rows["field_force_n"])
    assert rows["field_torque_nm"][:300] == pytest.approx(expected[:300], rel=1e-5, abs=1e-9)
    assert (np.linalg.norm(rows["field_torque_nm"][:300], axis=1) > 0.03).all()


def test_the_torque_of_a_failing_device_goes_to_zero() -> None:
    devices: list[Breaking] = []

    def opener() -> Breaking:
        devices.append(Breaking())
        return devices[0]

    with pytest.raises(DeviceError, match="no answer"):
        run_offline(medium(), SIGMA, opener, SPEC, seconds=0.3)
    sizes = np.linalg.norm(devices[0].torques, axis=1)
    assert sizes[99] > 0.01 and sizes[-1] == 0
    assert (np.abs(np.diff(devices[0].torques, axis=0)) <= 0.2 / 0.005 * 0.001 * 1.001).all()


def test_a_trajectory_rotates_the_simulated_hand() -> None:
    half = math.sqrt(0.5)
    trace = Trace(np.array([0.0, 0.2]), np.zeros((2, 3)), np.array([[1, 0, 0, 0], [half, 0, 0, -half]]))
    rows = run_offline(medium(), SIGMA, lambda: SimHand(trace), SPEC, seconds=0.3).log
    assert rows["orientation"][0] == pytest.approx([1, 0, 0, 0])
    assert rows["orientation"][100] == pytest.approx([np.cos(np.pi / 8), 0, 0, -np.sin(np.pi / 8)], abs=1e-6)
    assert rows["orientation"][290] == pytest.approx([half, 0, 0, -half])
    assert rows["field_torque_nm"][290, 0] < -0.03 and abs(rows["field_torque_nm"][290, 1]) < 1e-9


class Low(RestingDevice):
    """Pushes from below, as a second hand."""

    def position_m(self) -> tuple[float, float, float]:
        super().position_m()
        return 0.0, 0.0, -0.02


def test_two_hands_play_one_medium_independently() -> None:
    shared = medium(200)
    profile = replace(SIGMA, axes=AXES)
    with (
        Player(shared, profile, RestingDevice, log_rows=10_000, is_realtime=False) as upper,
        Player(shared, profile, Low, SPEC, log_rows=10_000, is_realtime=False) as lower,
    ):
        upper.play()
        lower.play()
        upper.wait(0.5)
    for player in (upper, lower):
        assert player.error is None
        rows = player.log()
        assert not (rows["flags"] & FLAGS["silent"]).any()  # each has reported all the time
        touching = rows[rows["field_force_n"][:, 2] > 0]
        assert len(touching) > 100
        frames = 64 * (touching["field_force_n"][:, 2] / (4 if player is lower else 1) - 0.5)
        assert np.abs(frames - 50 * touching["media_s"]).max() < 1e-3 * (1 + frames.max())
    assert (upper.log()["position_m"][:, 2] == 0).all() and (lower.log()["position_m"][-1, 2]) == -0.02
