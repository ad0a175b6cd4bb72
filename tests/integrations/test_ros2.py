"""The node of `integrations/ros2`, with stubs of rclpy and geometry_msgs, sends the forces of the sampler."""

from __future__ import annotations

import configparser
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builders import GOLDEN, INTEGRATIONS

import touchfield as tf


class StubNode:
    """The parts of rclpy that the node uses, with a clock that the test sets."""

    parameters: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.name, self.now_ns, self.sent, self.values, self.warnings = name, 10**9, [], {}, []

    def declare_parameter(self, name: str, value: Any) -> None:
        self.values[name] = self.parameters.get(name, value)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.values[name])

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now_ns))

    def create_subscription(self, kind: type, topic: str, hear: Any, quality: object) -> None:
        self.hear = hear

    def create_publisher(self, kind: type, topic: str, quality: object) -> Any:
        return SimpleNamespace(publish=self.sent.append)

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=lambda message, **_: self.warnings.append(message))

    def create_timer(self, period_s: float, tick: Any) -> None:
        self.period_s, self.tick = period_s, tick

    def destroy_node(self) -> None:
        self.name = ""


def vector() -> Any:
    return SimpleNamespace(x=0.0, y=0.0, z=0.0)


class Wrench:
    """A stand-in of geometry_msgs.msg.WrenchStamped."""

    def __init__(self) -> None:
        self.header = SimpleNamespace(frame_id="", stamp=SimpleNamespace(sec=0, nanosec=0))
        self.wrench = SimpleNamespace(force=vector(), torque=vector())


def pose(x: float, y: float, z: float, frame_id: str = "") -> Any:
    position_only = SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=z))
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame_id), pose=position_only)


@pytest.fixture
def play(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The class of the node, imported with the stand-ins."""
    for name, content in {
        "rclpy": {},
        "rclpy.executors": {"ExternalShutdownException": RuntimeError},
        "rclpy.node": {"Node": StubNode},
        "rclpy.qos": {"qos_profile_sensor_data": object()},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": object, "WrenchStamped": Wrench},
    }.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(INTEGRATIONS / "ros2"))
    monkeypatch.delitem(sys.modules, "touchfield_ros.node", raising=False)
    from touchfield_ros.node import Play

    return Play


def force(node: Any) -> np.ndarray:
    node.tick()
    components = node.sent[-1].wrench.force
    return np.array([components.x, components.y, components.z])


@pytest.mark.parametrize("name", ["touch-block", "objects-touch"])
def test_wrenches_agree_with_the_sampler(name: str, play: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = GOLDEN / f"{name}.touch"
    monkeypatch.setattr(StubNode, "parameters", {"file": str(stream), "frame_id": "hand_base"})
    node = play()
    assert node.period_s == pytest.approx(0.001) and not force(node).any()  # no pose was received yet
    with tf.open_stream(stream) as opened:
        sampler, contacts = tf.FieldSampler(opened.scene or opened.medium), 0
        low, high = opened.grid.box_m
        for n in range(60):
            position_m = low + (high - low) * np.random.default_rng(n).uniform(0.1, 0.9, 3)
            node.hear(pose(*position_m, "hand_base"))
            expected_n = np.array(sampler.at((node.now_ns - node.began_ns) / 1e9 % node.seconds, *position_m))
            size = np.linalg.norm(expected_n)
            expected_n *= min(1.0, node.force_max_n / size) if size else 0.0
            np.testing.assert_allclose(force(node), expected_n, atol=1e-6)
            contacts += bool(size)
            node.now_ns += 7_000_000
    assert contacts
    assert node.sent[-1].header.frame_id == "hand_base" and node.sent[-1].header.stamp.sec == 1
    node.destroy_node()


def test_missing_or_invalid_poses_give_no_force(play: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = GOLDEN / "touch-block.touch"
    monkeypatch.setattr(StubNode, "parameters", {"file": str(stream), "force_max_n": 0.01})
    node = play()
    with tf.open_stream(stream) as opened:
        first = opened.medium[0]
        position_m = opened.grid.to_m(first.positions()[np.argmax(np.linalg.norm(first.vectors_n(), axis=1))])
    node.hear(pose(*position_m))
    assert np.linalg.norm(force(node)) == pytest.approx(0.01)  # the requested limit
    node.now_ns += 200_000_000
    assert not force(node).any()
    for invalid_pose in (pose(math.nan, 0.0, 0.0), pose(*position_m, "camera")):
        node.hear(pose(*position_m))
        assert force(node).any()
        node.hear(invalid_pose)
        assert not force(node).any()
    assert "'camera'" in node.warnings[0]
    node.destroy_node()


def test_the_package_builds(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")
    command = ["make", "-C", str(INTEGRATIONS / "ros2"), f"PYTHON={sys.executable}", f"BUILD={tmp_path}"]
    subprocess.run(command, check=True, capture_output=True)
    assert list(tmp_path.rglob("touchfield_ros/node.py"))


def test_programs_are_installed_where_ros_finds_them() -> None:
    settings = configparser.ConfigParser()
    settings.read(INTEGRATIONS / "ros2" / "setup.cfg")
    assert settings["install"]["install_scripts"] == "$base/lib/touchfield_ros"
