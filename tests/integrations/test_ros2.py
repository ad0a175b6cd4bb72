"""The node of ROS 2, against stand-ins of rclpy and of its messages: what it hears, what it tells, and when."""

from __future__ import annotations

import importlib
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from builders import ATOL_N, INTEGRATIONS, frame_count, python_forces, run, some_points, stream_of

import touchfield as tf

ROS2 = INTEGRATIONS / "ros2"
STOOD_IN = ("rclpy", "geometry_msgs", "std_msgs", "touchfield_ros2")


class Ros:
    """The stand-ins, as this test imported them."""

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = importlib.import_module("rclpy.node").PARAMETERS
        self.messages = importlib.import_module("geometry_msgs.msg")
        self.module = importlib.import_module("touchfield_ros2.player_node")

    def node(self, name: str, **parameters: Any) -> Any:
        self.parameters.clear()
        self.parameters.update(file=str(stream_of(name)), **parameters)
        return self.module.PlayerNode()

    def hand(self, place: Any, frame_id: str = "touchfield") -> Any:
        message = self.messages.PoseStamped()
        message.header.frame_id = frame_id
        position = message.pose.position
        position.x, position.y, position.z = map(float, place)
        return message


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ros]:
    monkeypatch.syspath_prepend(str(ROS2 / "stub"))
    monkeypatch.syspath_prepend(str(ROS2))
    yield Ros()
    for name in [n for n in sys.modules if n.partition(".")[0] in STOOD_IN]:
        del sys.modules[name]


def forces_of(node: Any) -> np.ndarray:
    sent = [message.wrench.force for message in node.publishers["wrench"].sent]
    return np.array([(f.x, f.y, f.z) for f in sent])


@pytest.mark.parametrize("name", ["touch-block", "objects-touch-deforming"])
def test_wrenches_are_the_forces_of_the_medium_where_and_when_the_hand_is(ros: Ros, name: str) -> None:
    node = ros.node(name)
    with tf.open_stream(stream_of(name)) as stream:
        rate_hz = stream.reader.head.rate_hz
    points = some_points(name, 150)
    for point in points:
        node.give("hand", ros.hand(point))
        node.turn(0.001)
    found = forces_of(node)
    frames = np.minimum(1e-3 * np.arange(1, 151) * rate_hz, frame_count(name) - 1)
    assert found.shape == (150, 3) and np.abs(found).max() > 0.05
    np.testing.assert_allclose(found, python_forces(name, frames, points), atol=ATOL_N, rtol=0)
    last = node.publishers["wrench"].sent[-1]
    assert last.header.frame_id == "touchfield" and last.header.stamp == (1, 150_000_000)
    assert (last.wrench.torque.x, last.wrench.torque.y, last.wrench.torque.z) == (0.0, 0.0, 0.0)
    node.destroy_node()
    assert node.is_destroyed


def test_there_is_no_force_without_a_hand_nor_for_one_elsewhere(ros: Ros) -> None:
    node = ros.node("touch-block", frame_id="base_link", rate=500.0)
    place = (0.0, -0.001, -0.003)
    node.turn(0.1)
    node.give("hand", ros.hand(place, "camera"))
    node.turn(0.1)
    assert len(forces_of(node)) == 100 and not forces_of(node).any()
    assert "'camera'" in node.logger.lines[-1] and "'base_link'" in node.logger.lines[-1]
    node.give("hand", ros.hand(place, "base_link"))
    node.turn(0.3)
    told = forces_of(node)[100:].any(axis=-1)
    assert told[0] and not told[50:].any()  # the hand is forgotten after 0.1 s
    expected = python_forces("touch-block", np.array([0.002 * 30]), np.array([place]))
    np.testing.assert_allclose(forces_of(node)[100], expected[0], atol=ATOL_N)
    node.destroy_node()


@pytest.mark.parametrize(("given", "words"), [({"rate": 0.0}, "rate"), ({"rate": 1e6}, "rate")])
def test_parameters_out_of_range_are_refused(ros: Ros, given: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ros.node("touch-block", **given)


def test_the_program_runs_to_its_end(ros: Ros) -> None:
    ros.parameters.clear()
    ros.parameters["file"] = str(stream_of("touch-block"))
    ros.module.main()
    assert not importlib.import_module("rclpy").ok()


def test_it_runs_without_ros_by_one_command() -> None:
    done = run(sys.executable, ROS2 / "try_node.py", stream_of("touch-block"), 0, -0.001, -0.003)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "1000 wrenches in a second"


def test_the_package_names_what_it_is_and_needs() -> None:
    package = ElementTree.parse(ROS2 / "package.xml").getroot()
    name = package.findtext("name")
    assert name == "touchfield_ros2" and (ROS2 / "resource" / name).is_file()
    assert {n.text for n in package.iter("exec_depend")} == {"rclpy", "geometry_msgs", "std_msgs"}
    setup = (ROS2 / "setup.py").read_text()
    assert f'version="{package.findtext("version")}"' in setup and "player = {NAME}.player_node:main" in setup
