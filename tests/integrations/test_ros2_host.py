"""The node of `integrations/ros2` in real ROS 2: `rclpy`, messages and transport. See `ros2_host.py`."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from builders import (
    ATOL_N,
    ENGINE,
    INTEGRATIONS,
    ROOT,
    TICKS,
    make_plate,
    player_forces,
    press_plate,
    slow_way,
    stream_of,
)

ABSENT = [name for name in ("rclpy", "geometry_msgs", "rosgraph_msgs") if not importlib.util.find_spec(name)]
pytestmark = pytest.mark.skipif(bool(ABSENT), reason=f"this Python has no {' and no '.join(ABSENT)} of ROS 2")
HOST = Path(__file__).with_name("ros2_host.py")
TIMEOUT_S = 60


def environment() -> dict[str, str]:
    """ROS that meets no other node of this network, and the sources of the node."""
    paths = [str(INTEGRATIONS / "ros2"), str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


def start(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, *map(str, arguments)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )


def start_node(name: str, **parameters: object) -> subprocess.Popen[str]:
    """Start an entry point of the package."""
    options = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
    return start(
        "-c", f"import sys; from touchfield_ros.{name} import main; sys.exit(main())", "--ros-args", *options
    )


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[str]]]:
    """Processes that end with the test."""
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        process.kill()
        process.communicate()


def stepped_forces(path: Path, positions_m: np.ndarray, **parameters: object) -> np.ndarray:
    """Forces of the wrenches that arrive after each pose and tick, newtons, float64 [count, 3]."""
    options = [word for key, value in parameters.items() for word in ("-p", f"{key}:={value}")]
    command = [sys.executable, HOST, "step", "--ros-args", "-p", "use_sim_time:=true", "-p", f"file:={path}"]
    lines = "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in positions_m.tolist())
    done = subprocess.run(
        [*map(str, command), *options], input=lines, capture_output=True, text=True, env=environment()
    )
    assert done.returncode == 0, done.stderr
    return np.array([line.split() for line in done.stdout.splitlines()], np.float64)


@pytest.mark.parametrize("name", ["touch-block", "objects-touch-deforming"])
def test_wrenches_agree_with_the_player(name: str) -> None:
    options = {key: value for key, value in ENGINE.items() if key in ("loop", "wall_n_per_m")}
    points, expected_n = player_forces(stream_of(name), slow_way(name, TICKS), **options)
    forces_n = stepped_forces(stream_of(name), points, wall_n_per_m=800.0)
    assert np.abs(forces_n).max() > 0.05
    np.testing.assert_allclose(forces_n, expected_n, atol=ATOL_N, rtol=0)


def test_wrong_parameter_is_refused_with_a_message(processes: list[subprocess.Popen[str]]) -> None:
    processes.append(start_node("node", file="none.touch", friction="high"))
    _, log = processes[0].communicate(timeout=TIMEOUT_S)
    assert processes[0].returncode == 2
    assert "the parameter friction: found 'high'; expected a finite number" in log
    assert "Traceback" not in log


def read_sizes(recorder: subprocess.Popen[str], is_enough: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Sizes of forces until there are enough, newtons, float64 [n]."""
    assert recorder.stdout is not None
    watchdog = threading.Timer(TIMEOUT_S, recorder.kill)
    watchdog.start()
    sizes_n: list[float] = []
    while not sizes_n or not is_enough(np.array(sizes_n)):
        line = recorder.stdout.readline()
        assert line, "the forces end too early"
        sizes_n.append(float(np.linalg.norm([float(word) for word in line.split()])))
    watchdog.cancel()
    return np.array(sizes_n)


def test_plate_resists_in_real_time_until_a_signal(
    processes: list[subprocess.Popen[str]], tmp_path: Path
) -> None:
    plate, hand = make_plate(tmp_path / "plate.touch"), tmp_path / "press.txt"
    np.savetxt(hand, press_plate(), fmt="%.17g")
    recorder, play = start(HOST, "record"), start_node("node", file=plate, force_max_n=3.3)
    processes += [recorder, play, start_node("press", hand=hand)]
    pressed_n = read_sizes(recorder, lambda sizes_n: len(sizes_n) > 100 and (sizes_n[-100:] > 0.5).all())
    play.send_signal(signal.SIGTERM)
    released_n = read_sizes(recorder, lambda sizes_n: sizes_n[-1] == 0.0)
    _, log = play.communicate(timeout=TIMEOUT_S)
    assert play.returncode == 0, log
    assert pressed_n.max() <= 3.3
    ramp_n = released_n[np.flatnonzero(released_n == released_n.max())[-1] :]
    assert ramp_n[0] > 0.5 and len(ramp_n) > 5 and (np.diff(ramp_n) < 0).all()
