"""A .touch file as a ROS 2 node: poses of a hand in, wrenches out.

    ros2 run touchfield_ros play --ros-args -p file:=room.touch -p rate_hz:=1000.0

Subscribes to `hand` (geometry_msgs/PoseStamped, metres in the medium's frame), publishes `wrench`
(geometry_msgs/WrenchStamped) at `rate_hz`. A hand in another frame than
`frame_id`, or one that was not heard of for `silence_s`, gets no force.
"""

from __future__ import annotations

import math

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

import touchfield as tf

PARAMETERS = {
    "file": "",
    "frame_id": "touchfield",
    "rate_hz": 1000.0,
    "silence_s": 0.1,
    "loop": True,
    "force_max_n": 0.0,
}


class Play(Node):
    """Plays a file at its own rate, from the first heard pose on.

    Parameters (ROS): file, frame_id, rate_hz, silence_s, loop, force_max_n (0: what the file allows).
    """

    def __init__(self) -> None:
        super().__init__("touchfield_play")
        for name, value in PARAMETERS.items():
            self.declare_parameter(name, value)
        self._stream = tf.open_stream(self._told("file"))
        opened = self._stream.__enter__()
        medium = opened.scene or opened.medium
        allowed = self._told("force_max_n")
        self.force_max_n = (
            min(allowed, opened.declared_device.force_max_n)
            if allowed > 0
            else opened.declared_device.force_max_n
        )
        self.seconds = len(opened.medium) / opened.medium.rate_hz
        self.sampler = tf.FieldSampler(medium)
        self.frame_id, self.is_loop = self._told("frame_id"), self._told("loop")
        self.hand: tuple[float, float, float] | None = None
        self.heard_ns = self.began_ns = 0
        self.create_subscription(PoseStamped, "hand", self._hear, qos_profile_sensor_data)
        self.wrench = self.create_publisher(WrenchStamped, "wrench", qos_profile_sensor_data)
        self.timer = self.create_timer(1 / self._told("rate_hz"), self._tick)

    def _told(self, name: str):  # type: ignore[no-untyped-def]
        return self.get_parameter(name).value

    def _now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _hear(self, pose: PoseStamped) -> None:
        """A place of the hand; one that is no number, or told in another frame, is as good as none."""
        if pose.header.frame_id not in ("", self.frame_id):
            words = (
                f"a hand in frame '{pose.header.frame_id}' feels nothing; the medium lies in "
                f"'{self.frame_id}'"
            )
            self.get_logger().warning(words, throttle_duration_sec=5.0)
            self.hand = None
            return
        place = (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z)
        self.hand = place if all(math.isfinite(n) for n in place) else None
        self.heard_ns = self._now_ns()
        self.began_ns = self.began_ns or self.heard_ns

    def force_n(self, now_ns: int) -> tuple[float, float, float]:
        """Newtons at the hand now: none while nothing is heard of it, and never more than is allowed."""
        if self.hand is None or now_ns - self.heard_ns > 1e9 * self._told("silence_s"):
            return 0.0, 0.0, 0.0
        time_s = (now_ns - self.began_ns) / 1e9
        x, y, z = self.sampler.at(time_s % self.seconds if self.is_loop else time_s, *self.hand)
        size = math.sqrt(x * x + y * y + z * z)
        share = min(1.0, self.force_max_n / size) if size else 0.0
        return x * share, y * share, z * share

    def _tick(self) -> None:
        now_ns = self._now_ns()
        out = WrenchStamped()
        out.header.frame_id = self.frame_id
        out.header.stamp.sec, out.header.stamp.nanosec = divmod(now_ns, 10**9)
        out.wrench.force.x, out.wrench.force.y, out.wrench.force.z = self.force_n(now_ns)
        self.wrench.publish(out)

    def destroy_node(self) -> None:
        """Closes the file, too."""
        self._stream.__exit__(None, None, None)
        super().destroy_node()


def main() -> None:
    """The entry point."""
    rclpy.init()
    node = Play()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
