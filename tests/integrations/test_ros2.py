"""The node of `integrations/ros2`, with stubs of rclpy and geometry_msgs, sends the forces of the player."""

from __future__ import annotations

import configparser
import math
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builders import (
    ATOL_N,
    ENGINE,
    GOLDEN,
    INTEGRATIONS,
    TICKS,
    assert_has_friction,
    assert_is_released,
    assert_resists,
    player_forces,
    press_plate,
    slide_on_plate,
    slow_way,
    stream_of,
)

from touchfield.errors import SourceError

TICK_NS = 1_000_000


class StubNode:
    """The parts of rclpy that the node uses, with a clock that the test sets."""

    parameters: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.name, self.now_ns, self.sent = name, 10**9, []
        self.values: dict[str, Any] = {"use_sim_time": self.parameters.get("use_sim_time", True)}
        self.messages: list[str] = []
        self.subscriptions = 1

    def declare_parameter(self, name: str, value: Any, descriptor: Any) -> None:
        assert descriptor.dynamic_typing
        self.values[name] = self.parameters.get(name, value)

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.values[name])

    def get_clock(self) -> Any:
        stamp = SimpleNamespace(sec=self.now_ns // 10**9, nanosec=self.now_ns % 10**9)
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.now_ns, to_msg=lambda: stamp))

    def create_subscription(self, kind: type, topic: str, receive: Any, quality: object) -> None:
        self.receive = receive

    def create_publisher(self, kind: type, topic: str, quality: object) -> Any:
        return SimpleNamespace(publish=self.sent.append, get_subscription_count=lambda: self.subscriptions)

    def get_logger(self) -> Any:
        def log(message: str, **_: Any) -> None:
            self.messages.append(message)

        return SimpleNamespace(info=log, warning=log, error=log)

    def create_timer(self, period_s: float, tick: Any) -> None:
        self.period_s, self.tick = period_s, tick

    def destroy_node(self) -> None:
        self.name = ""


class StubRclpy(ModuleType):
    """Functions of rclpy; `spin` is what the test sets."""

    def __init__(self) -> None:
        super().__init__("rclpy")
        self.is_running = False
        self.spin: Any = None
        self.errors: list[str] = []

    def init(self, signal_handler_options: str) -> None:
        assert signal_handler_options == "no handlers"
        self.is_running = True

    def ok(self) -> bool:
        return self.is_running

    def try_shutdown(self) -> None:
        self.is_running = False


def vector() -> Any:
    return SimpleNamespace(x=0.0, y=0.0, z=0.0)


class Pose:
    """A stand-in of geometry_msgs.msg.PoseStamped."""

    def __init__(self) -> None:
        self.header = SimpleNamespace(frame_id="", stamp=None)
        self.pose = SimpleNamespace(position=vector())


class Wrench:
    """A stand-in of geometry_msgs.msg.WrenchStamped."""

    def __init__(self) -> None:
        self.header = SimpleNamespace(frame_id="", stamp=None)
        self.wrench = SimpleNamespace(force=vector(), torque=vector())


def pose(x: float, y: float, z: float, frame_id: str = "") -> Any:
    position_only = SimpleNamespace(position=SimpleNamespace(x=x, y=y, z=z))
    return SimpleNamespace(header=SimpleNamespace(frame_id=frame_id), pose=position_only)


@pytest.fixture
def rclpy(monkeypatch: pytest.MonkeyPatch) -> StubRclpy:
    """The stand-ins of the modules of ROS."""
    rclpy = StubRclpy()
    for name, content in {
        "rcl_interfaces": {},
        "rcl_interfaces.msg": {"ParameterDescriptor": SimpleNamespace},
        "rclpy.logging": {"get_logger": lambda _: SimpleNamespace(fatal=rclpy.errors.append)},
        "rclpy.executors": {"ExternalShutdownException": RuntimeError},
        "rclpy.node": {"Node": StubNode},
        "rclpy.qos": {"qos_profile_sensor_data": object()},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="no handlers")},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"PoseStamped": Pose, "WrenchStamped": Wrench},
    }.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.syspath_prepend(str(INTEGRATIONS / "ros2"))
    for module in ("node", "press", "parameters"):
        monkeypatch.delitem(sys.modules, f"touchfield_ros.{module}", raising=False)
    return rclpy


@pytest.fixture
def play(rclpy: StubRclpy, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Make the node with the given parameters; it is destroyed at the end."""
    from touchfield_ros.node import Play

    nodes = []

    def make(path: Path, **parameters: Any) -> Any:
        monkeypatch.setattr(StubNode, "parameters", {"file": str(path), **parameters})
        rclpy.is_running = True
        nodes.append(Play())
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def force(node: Any) -> np.ndarray:
    """The force of the next tick, 1 ms later, float64 [3]."""
    node.tick()
    node.now_ns += TICK_NS
    return sent_forces(node)[-1]


def sent_forces(node: Any) -> np.ndarray:
    """All forces so far, newtons, float64 [n, 3]."""
    forces = [message.wrench.force for message in node.sent]
    return np.array([[f.x, f.y, f.z] for f in forces])


def move(node: Any, positions_m: np.ndarray, frame_id: str = "") -> np.ndarray:
    """Forces on a hand whose pose arrives before each tick, float64 [n, 3]."""
    rows = []
    for position_m in positions_m.tolist():
        node.receive(pose(*position_m, frame_id))
        rows.append(force(node))
    return np.array(rows)


@pytest.mark.parametrize("name", ["touch-block", "objects-touch"])
def test_wrenches_agree_with_the_player(name: str, play: Any) -> None:
    options = {key: value for key, value in ENGINE.items() if key in ("loop", "wall_n_per_m")}
    points, expected_n = player_forces(stream_of(name), slow_way(name, TICKS), **options)
    node = play(stream_of(name), frame_id="hand_base", wall_n_per_m=800.0)
    assert node.period_s == pytest.approx(0.001)
    forces_n = move(node, points, "hand_base")
    assert np.abs(forces_n).max() > 0.05
    np.testing.assert_allclose(forces_n, expected_n, atol=ATOL_N, rtol=0)
    assert node.sent[-1].header.frame_id == "hand_base" and node.sent[-1].header.stamp.sec == 1


def test_medium_plays_from_the_first_pose_on(play: Any) -> None:
    node = play(GOLDEN / "touch-block.touch")
    for _ in range(20):
        assert not force(node).any()
    assert node.player.media_s == 0.0
    move(node, np.zeros((11, 3)))
    assert node.player.media_s == pytest.approx(0.010)


def test_thin_plate_resists_the_hand_until_the_end(play: Any, plate: Path) -> None:
    node = play(plate, force_max_n=3.3)
    peak_n = node.player.force_max_n
    assert peak_n <= 3.3
    forces_n = move(node, press_plate())
    assert_resists(forces_n, peak_n)
    node.release()
    assert not sent_forces(node)[-20:].any()  # if the last ones are lost
    assert_is_released(sent_forces(node)[len(forces_n) :], forces_n[-1], peak_n)


def test_force_is_limited_as_requested(play: Any, plate: Path) -> None:
    forces_n = move(play(plate, force_max_n=0.4), press_plate())
    assert np.linalg.norm(forces_n, axis=1).max() == pytest.approx(0.4)


def test_friction_resists_the_hand_on_the_plate(play: Any, plate: Path) -> None:
    assert_has_friction(move(play(plate, friction=0.3), slide_on_plate()), 0.3)


def test_silent_hand_loses_the_force_within_a_ramp(play: Any, plate: Path) -> None:
    node = play(plate, silence_s=0.05)
    last_n = move(node, press_plate())[-1]
    silent_n = np.array([force(node) for _ in range(100)])
    sizes_n = np.linalg.norm(silent_n, axis=1)
    np.testing.assert_allclose(sizes_n[:49], np.linalg.norm(last_n), rtol=0.05)  # not silent for long enough
    assert_is_released(silent_n[49:], silent_n[48], node.player.force_max_n)
    assert len(np.unique(sizes_n[49:75])) > 10  # a ramp, and no step
    assert move(node, np.tile(press_plate()[:1], (5, 1))).shape == (5, 3)  # the hand may return


@pytest.mark.parametrize("invalid", [(math.nan, 0.0, 0.0, ""), (0.004, 0.003, -0.001, "camera")])
def test_invalid_pose_ramps_the_force_to_zero(play: Any, plate: Path, invalid: tuple[Any, ...]) -> None:
    node = play(plate)
    last_n = move(node, press_plate())[-1]
    ramp_n = []
    for _ in range(40):
        node.receive(pose(*invalid))
        ramp_n.append(force(node))
    assert_is_released(np.array(ramp_n), last_n, node.player.force_max_n)
    assert any("'camera'" in message for message in node.messages) == (invalid[3] == "camera")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_brings_the_force_to_zero(
    rclpy: StubRclpy, play: Any, plate: Path, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """`main` in real time, with a spin that ends by a signal while the hand presses, and a second signal."""
    import touchfield_ros.node as module

    seen: list[Any] = []
    lengths: list[int] = []

    def spin(node: Any) -> None:
        seen.append(node)
        for position_m in press_plate().tolist()[::4]:
            node.receive(pose(*position_m))
            node.tick()
            time.sleep(0.001)
        lengths.append(len(node.sent))
        signal.raise_signal(number)

    rclpy.spin = spin
    monkeypatch.setattr(StubNode, "parameters", {"file": str(plate), "use_sim_time": False})
    release = module.Play.release
    monkeypatch.setattr(module.Play, "release", lambda node: (signal.raise_signal(number), release(node)))
    handlers = {n: signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        module.main()
    finally:
        for n, handler in handlers.items():
            signal.signal(n, handler)
    forces_n = sent_forces(seen[0])
    assert forces_n[lengths[0] - 1].any()
    assert len(forces_n) > lengths[0] + 5 and not forces_n[-1].any()
    assert not rclpy.is_running


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({}, "the parameter file: found nothing"),
        ({"file": "/nowhere.touch"}, "/nowhere.touch: found no such file"),
        ({"friction": "high"}, "the parameter friction: found 'high'; expected a finite number"),
        ({"loop": 1}, "the parameter loop: found 1; expected true or false"),
        ({"silence_s": math.inf}, "the parameter silence_s: found inf"),
        ({"rate_hz": 0}, "the parameter rate_hz: found 0.0; expected at least 1"),
    ],
)
def test_wrong_parameters_are_refused_with_a_message(
    rclpy: StubRclpy, monkeypatch: pytest.MonkeyPatch, parameters: dict[str, Any], message: str
) -> None:
    import touchfield_ros.node as module

    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(StubNode, "parameters", parameters)
    assert module.main() != 0
    assert len(rclpy.errors) == 1 and rclpy.errors[0].startswith(message)


def test_numbers_need_no_point(play: Any, plate: Path) -> None:
    assert play(plate, force_max_n=2).player.force_max_n == 2.0


@pytest.mark.parametrize("content", ["", "1 2\n", "0 0 0\n1 2 x\n", "nan 0 0\n"])
def test_hand_of_wrong_lines_is_refused(rclpy: StubRclpy, tmp_path: Path, content: str) -> None:
    from touchfield_ros.press import read_positions

    (tmp_path / "hand.txt").write_text(content)
    with pytest.raises(SourceError, match="hand"):
        read_positions(tmp_path / "hand.txt")


def test_simulated_hand_presses_on_the_plate(
    play: Any, plate: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from touchfield_ros.press import Press

    np.savetxt(tmp_path / "press.txt", press_plate(), fmt="%.17g")
    node = play(plate)
    monkeypatch.setattr(StubNode, "parameters", {"hand": str(tmp_path / "press.txt")})
    hand = Press()
    hand.subscriptions = 0
    hand.tick()
    assert not hand.sent and hand.messages == ["no node subscribes to 'hand' yet"]
    hand.subscriptions = 1
    for _ in range(1100):
        hand.tick()
        node.receive(hand.sent[-1])
        force(node)
        hand.receive(node.sent[-1])
    assert hand.sent[-1].pose.position.z == -0.001
    assert_resists(sent_forces(node), node.player.force_max_n)
    assert hand.messages[-1] == f"force 0.000 0.000 {sent_forces(node)[-1][2]:.3f} N"


def test_the_package_builds(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")
    command = ["make", "-C", str(INTEGRATIONS / "ros2"), f"PYTHON={sys.executable}", f"BUILD={tmp_path}"]
    subprocess.run(command, check=True, capture_output=True)
    assert list(tmp_path.rglob("touchfield_ros/node.py"))


def test_programs_are_installed_where_ros_finds_them() -> None:
    settings = configparser.ConfigParser()
    settings.read(INTEGRATIONS / "ros2" / "setup.cfg")
    assert settings["install"]["install_scripts"] == "$base/lib/touchfield_ros"
