"""The node of `integrations/ros2` in real ROS 2, for `test_ros2_host.py`.

    python ros2_host.py step --ros-args -p use_sim_time:=true -p file:=FILE < positions
    python ros2_host.py record

`step` sends a line `x y z`, metres, as a pose before each tick of 1 ms of simulated time. `record` listens.
Both print the force of each wrench that arrives, newtons.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from touchfield_ros.node import Play

TICK_NS = 1_000_000
TIMEOUT_S = 20.0


class CountedPlay(Play):
    """The node, which counts the poses that arrive."""

    received = 0

    def _receive(self, pose: PoseStamped) -> None:
        super()._receive(pose)
        self.received += 1


class Recorder(Node):
    """Prints each force."""

    def __init__(self) -> None:
        super().__init__("recorder")
        self.received = 0
        every = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)  # also if it reads late
        self.create_subscription(WrenchStamped, "wrench", self._receive, every)

    def _receive(self, wrench: WrenchStamped) -> None:
        force = wrench.wrench.force
        print(f"{force.x!r} {force.y!r} {force.z!r}", flush=True)
        self.received += 1


class Hand(Recorder):
    """Publishes poses and simulated time."""

    def __init__(self) -> None:
        super().__init__()
        self.poses = self.create_publisher(PoseStamped, "hand", qos_profile_sensor_data)
        self.clocks = self.create_publisher(Clock, "/clock", QoSProfile(depth=1))

    def move(self, line: str) -> None:
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = map(float, line.split())
        self.poses.publish(pose)

    def set_time(self, now_ns: int) -> None:
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(now_ns, 10**9)
        self.clocks.publish(clock)


def step() -> None:
    """Send poses and ticks in turn; each waits for the one before."""
    hand, play, executor = Hand(), CountedPlay(), SingleThreadedExecutor()
    executor.add_node(hand)
    executor.add_node(play)

    def wait(is_done: Callable[[], bool]) -> None:
        stop_s = time.monotonic() + TIMEOUT_S
        while not is_done():
            assert time.monotonic() < stop_s, "no message has arrived"
            executor.spin_once(timeout_sec=0.001)

    publishers = hand.poses, hand.clocks
    wait(lambda: all(publisher.get_subscription_count() for publisher in publishers))
    wait(lambda: bool(hand.count_publishers("wrench")))
    hand.set_time(1)  # before the first tick
    wait(lambda: play.get_clock().now().nanoseconds == 1)
    for n, line in enumerate(sys.stdin, start=1):
        hand.move(line)
        wait(lambda n=n: play.received == n)
        hand.set_time(n * TICK_NS)
        wait(lambda n=n: hand.received == n)
    play.destroy_node()


def main() -> None:
    """The entry point."""
    rclpy.init()
    if sys.argv[1] == "step":
        step()
        return
    with contextlib.suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Recorder())


if __name__ == "__main__":
    main()
