"""A ROS 2 node that plays a ``.touch`` file: poses of a hand come in, the wrench that it feels goes out.

Topics: ``hand`` (geometry_msgs/PoseStamped), ``wrench`` (geometry_msgs/WrenchStamped). Parameters: ``file``;
``frame_id``, the frame that the medium lies in, in which hands and wrenches are told; ``rate``, wrenches a second.
"""

from __future__ import annotations

import math
from contextlib import ExitStack
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

import touchfield as tf

__all__ = ["PlayerNode", "main"]

HAND_LASTS_NS = 100_000_000
"""A hand that was not heard of for so long feels nothing."""


class PlayerNode(Node):
    """Plays a file once, from the first hand on; then its last frame stays.

    A force is no longer than the medium's F_max. There is no force without a hand, and none for a hand in another
    frame than the medium's: put a transformer before the node where they differ.
    """

    def __init__(self) -> None:
        super().__init__("touchfield_player")
        path = str(self.declare_parameter("file", "").value)
        self._frame_id = str(self.declare_parameter("frame_id", "touchfield").value)
        rate_hz = float(self.declare_parameter("rate", 1000.0).value)
        if not 1.0 <= rate_hz <= 10000.0:
            raise ValueError(f"parameter rate: found {rate_hz:g}, expected 1 to 10000 wrenches a second")
        self._open = ExitStack()
        stream = self._open.enter_context(tf.open_stream(path))
        if stream.told_device.is_array:
            raise ValueError(f"{path}: made for an array of actuators, expected a medium that a point feels")
        self._force_max_n = stream.told_device.force_max_n
        self._sampler = tf.FieldSampler(stream.scene or stream.medium)
        low, high = stream.grid.box_m
        self._sampler.at(0.0, *(0.5 * (low + high)).tolist())  # compiles, and decodes the first frames
        self._hand_m: tuple[float, float, float] | None = None
        self._heard_ns, self._begun_ns = 0, -1
        self._publisher = self.create_publisher(WrenchStamped, "wrench", qos_profile_sensor_data)
        self._subscription = self.create_subscription(PoseStamped, "hand", self._hear, qos_profile_sensor_data)
        self._timer = self.create_timer(1.0 / rate_hz, self._tell)
        self.get_logger().info(f"{path}: {stream.medium.frame_count} frames at {stream.medium.rate_hz:g} Hz")

    def _hear(self, message: Any) -> None:
        """A pose of the hand; its place counts, its orientation does not."""
        if message.header.frame_id != self._frame_id:
            found = f"a hand in frame '{message.header.frame_id}' is not heard; expected '{self._frame_id}'"
            self.get_logger().warning(found, throttle_duration_sec=5.0)
            return
        place = message.pose.position
        self._heard_ns = self.get_clock().now().nanoseconds
        if self._begun_ns < 0:
            self._begun_ns = self._heard_ns
        self._hand_m = place.x, place.y, place.z

    def _tell(self) -> None:
        """The wrench of this tick."""
        now = self.get_clock().now()
        message = WrenchStamped()
        message.header.stamp, message.header.frame_id = now.to_msg(), self._frame_id
        if self._hand_m is not None and now.nanoseconds - self._heard_ns <= HAND_LASTS_NS:
            seconds = 1e-9 * (now.nanoseconds - self._begun_ns)
            x, y, z = self._sampler.at(seconds, *self._hand_m)
            size = math.sqrt(x * x + y * y + z * z)
            share = min(1.0, self._force_max_n / size) if size > 0.0 else 0.0
            force = message.wrench.force
            force.x, force.y, force.z = share * x, share * y, share * z
        self._publisher.publish(message)

    def destroy_node(self) -> None:
        """Ends the node and closes the file."""
        super().destroy_node()
        self._open.close()


def main(args: list[str] | None = None) -> None:
    """Run the node until it is told to end."""
    rclpy.init(args=args)
    node = PlayerNode()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
