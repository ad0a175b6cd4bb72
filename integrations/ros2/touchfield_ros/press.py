"""A simulated hand as a ROS 2 node, to try `play` without a device.

    python integrations/plate.py FOLDER
    ros2 run touchfield_ros play --ros-args -p file:=FOLDER/plate.touch
    ros2 run touchfield_ros press --ros-args -p hand:=FOLDER/press.txt

Publishes the lines `x y z` of a file, metres, as poses on `hand` (geometry_msgs/PoseStamped), one every
millisecond, and then the last one again and again. It starts when `hand` has a subscriber: the first poses
would be lost while the nodes find each other. Logs the force that arrives on `wrench`
(geometry_msgs/WrenchStamped) twice a second.
"""

from __future__ import annotations

from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data


class Press(Node):
    """Moves along the positions of a file.

    Parameters (ROS): hand (the file), rate_hz.
    """

    def __init__(self) -> None:
        super().__init__("touchfield_press")
        self.declare_parameter("hand", "press.txt")
        self.declare_parameter("rate_hz", 1000.0)
        text = Path(self.get_parameter("hand").value).read_text()
        self._positions_m = [tuple(map(float, line.split())) for line in text.splitlines()]
        self._sent = 0
        self.create_subscription(WrenchStamped, "wrench", self._receive, qos_profile_sensor_data)
        self._publisher = self.create_publisher(PoseStamped, "hand", qos_profile_sensor_data)
        self.create_timer(1.0 / self.get_parameter("rate_hz").value, self._send)

    def _send(self) -> None:
        if not self._sent and not self._publisher.get_subscription_count():
            self.get_logger().info("no node subscribes to 'hand' yet", throttle_duration_sec=5.0)
            return
        position_m = self._positions_m[min(self._sent, len(self._positions_m) - 1)]
        self._sent += 1
        out = PoseStamped()
        out.header.stamp = self.get_clock().now().to_msg()
        out.pose.position.x, out.pose.position.y, out.pose.position.z = position_m
        self._publisher.publish(out)

    def _receive(self, wrench: WrenchStamped) -> None:
        force = wrench.wrench.force
        message = f"force {force.x:.3f} {force.y:.3f} {force.z:.3f} N"
        self.get_logger().info(message, throttle_duration_sec=0.5)


def main() -> None:
    """The entry point."""
    rclpy.init()
    node = Press()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
