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

import math
from pathlib import Path

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from touchfield.errors import SourceError, TouchfieldError
from touchfield_ros.parameters import read_parameters

NAME = "touchfield_press"
PARAMETERS = {"hand": "press.txt", "rate_hz": 1000.0}


def read_positions(path: Path) -> list[tuple[float, float, float]]:
    """Read a line `x y z`, metres, for each tick.

    Raises SourceError if there is no such file, or a line is none of three numbers.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(str(path), str(error), "a text file with a line `x y z` for each tick") from None
    positions_m = []
    for number, line in enumerate(lines, start=1):
        try:
            x, y, z = map(float, line.split())
        except ValueError:
            x = y = z = math.nan
        if not all(map(math.isfinite, (x, y, z))):
            raise SourceError(
                f"{path}, line {number}", repr(line[:80]), "three finite numbers `x y z`, metres"
            )
        positions_m.append((x, y, z))
    if not positions_m:
        raise SourceError(str(path), "no line", "a line `x y z` for each tick")
    return positions_m


class Press(Node):
    """Moves along the positions of a file.

    Parameters (ROS): hand (the file), rate_hz.
    """

    def __init__(self) -> None:
        super().__init__(NAME)
        values = read_parameters(self, PARAMETERS)
        self._positions_m = read_positions(Path(values["hand"]))
        self._sent = 0
        self.create_subscription(WrenchStamped, "wrench", self._receive, qos_profile_sensor_data)
        self._publisher = self.create_publisher(PoseStamped, "hand", qos_profile_sensor_data)
        self.create_timer(1.0 / values["rate_hz"], self._send)

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
        x, y, z = (round(n, 3) + 0.0 for n in (force.x, force.y, force.z))  # + 0.0: no "-0.000"
        message = f"force {x:.3f} {y:.3f} {z:.3f} N"
        self.get_logger().info(message, throttle_duration_sec=0.5)


def main() -> int:
    """The entry point; returns the exit status."""
    rclpy.init()
    try:
        node = Press()
        rclpy.spin(node)
        node.destroy_node()
    except TouchfieldError as error:
        get_logger(NAME).fatal(str(error))
        return error.exit_code
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()
    return 0
