"""A .touch file as a ROS 2 node: poses of a hand in, wrenches out.

    ros2 run touchfield_ros play --ros-args -p file:=room.touch -p rate_hz:=1000.0

Subscribes to `hand` (geometry_msgs/PoseStamped, metres in the medium's frame), publishes `wrench`
(geometry_msgs/WrenchStamped) at `rate_hz`. The force is that of touchfield's player: a proxy at walls,
friction, limits, and a ramp to zero when no valid pose has arrived for `silence_s`, and at the end.
"""

from __future__ import annotations

import math
import signal
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, WrenchStamped
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions

import touchfield as tf
from touchfield.errors import InvalidArgument, TouchfieldError
from touchfield.render.spec import RenderSpec
from touchfield_ros.parameters import read_parameters

NAME = "touchfield_play"
SIGNALS = (signal.SIGINT, signal.SIGTERM)
LAST_ZEROS = 20
"""Wrenches of no force at the end."""
PARAMETERS = {
    "file": "",
    "frame_id": "touchfield",
    "rate_hz": 1000.0,
    "silence_s": 0.1,
    "loop": True,
    "speed": 1.0,
    "force_max_n": 0.0,
    "friction": -1.0,
    "wall_n_per_m": 0.0,
}


class Play(Node):
    """Plays a file at its own rate, from the first valid pose on.

    Parameters (ROS): file, frame_id, rate_hz, silence_s, loop, speed, force_max_n (0: that of the medium),
    friction (below 0: that of the medium), wall_n_per_m (0: measured in the medium). With use_sim_time, each
    tick waits for its frames.
    """

    def __init__(self) -> None:
        super().__init__(NAME)
        values = read_parameters(self, PARAMETERS)
        if not values["file"]:
            raise InvalidArgument(
                "the parameter file", "nothing", "a .touch file", "Add -p file:=NAME.touch."
            )
        self._is_simulated = bool(self.get_parameter("use_sim_time").value)
        self._silence_ns = round(1e9 * values["silence_s"])
        self.frame_id = values["frame_id"]
        self._stream = tf.open_stream(values["file"])
        self.player = self._open_player(self._stream.__enter__(), values)
        self._period_s = 1.0 / values["rate_hz"]
        self.player.__enter__()
        for note in self.player.notes:
            self.get_logger().info(note)
        self._position_m: tuple[float, float, float] | None = None
        self._received_ns = self._ticked_ns = self._now_ns()
        self._is_playing = self._has_failed = False
        self.create_subscription(PoseStamped, "hand", self._receive, qos_profile_sensor_data)
        self._publisher = self.create_publisher(WrenchStamped, "wrench", qos_profile_sensor_data)
        self.create_timer(self._period_s, self._tick)

    def _open_player(self, opened: Any, values: dict[str, Any]) -> tf.TickedPlayer:
        force_max_n, friction = values["force_max_n"], values["friction"]
        allowed_n = opened.declared_device.force_max_n
        spec = RenderSpec(
            rate_hz=values["rate_hz"],
            peak_n=min(force_max_n, allowed_n) if force_max_n > 0 else None,
            friction=friction if friction >= 0 else None,
            wall_n_per_m=values["wall_n_per_m"] or None,
            up="lattice",
        )
        return tf.TickedPlayer(
            opened.scene or opened.medium,
            opened.declared_device,
            spec,
            loop=values["loop"],
            speed=values["speed"],
            is_simulated=self._is_simulated,
        )

    def _now_ns(self) -> int:
        """Return the time of the ticks: simulated time, or a clock that no one sets."""
        return int(self.get_clock().now().nanoseconds) if self._is_simulated else time.monotonic_ns()

    def _receive(self, pose: PoseStamped) -> None:
        """Take a pose; one that is not finite or in another frame counts as none."""
        if pose.header.frame_id not in ("", self.frame_id):
            message = (
                f"a hand in frame '{pose.header.frame_id}' has no force; the medium is in '{self.frame_id}'"
            )
            self.get_logger().warning(message, throttle_duration_sec=5.0)
            self._position_m = None
            return
        position_m = (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z)
        self._position_m = position_m if all(map(math.isfinite, position_m)) else None
        self._received_ns = self._now_ns()
        if self._position_m is not None and not self._is_playing:
            self._is_playing = True
            self.player.play()

    def _tick(self) -> None:
        self._ticked_ns = now_ns = self._now_ns()
        is_silent = now_ns - self._received_ns > self._silence_ns
        self._publish(self.player.tick(None if is_silent else self._position_m, now_ns))
        if self.player.error is not None and not self._has_failed:
            self._has_failed = True
            self.get_logger().error(f"the file cannot be played further: {self.player.error}")

    def _publish(self, force_n: tuple[float, float, float]) -> None:
        out = WrenchStamped()
        out.header.frame_id = self.frame_id
        out.header.stamp = self.get_clock().now().to_msg()
        out.wrench.force.x, out.wrench.force.y, out.wrench.force.z = force_n
        self._publisher.publish(out)

    def release(self) -> None:
        """Publish forces on the way to zero, at the node's rate, after its executor has ended.

        Zero is sent several times: the transport may lose a message, and a device would keep the last force.
        """
        self.player.stop()
        zeros = 0
        while rclpy.ok() and zeros < LAST_ZEROS:
            zeros += self.player.is_released
            time.sleep(self._period_s)
            self._ticked_ns += round(1e9 * self._period_s)  # simulated time stands without an executor
            self._publish(self.player.tick(self._position_m, self._ticked_ns))

    def destroy_node(self) -> None:
        """Close the file, too."""
        self.player.close()
        self._stream.__exit__(None, None, None)
        super().destroy_node()


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _play() -> None:
    node = None
    try:
        node = Play()
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)  # a second one would cut the ramp off
        if node is not None:
            node.release()
    finally:
        if node is not None:
            node.destroy_node()


def main() -> int:
    """The entry point: plays until a signal, then brings the force to zero; returns the exit status."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # theirs end publishing before the ramp
    for number in SIGNALS:
        signal.signal(number, _interrupt)
    try:
        _play()
    except TouchfieldError as error:
        get_logger(NAME).fatal(str(error))
        return error.exit_code
    finally:
        rclpy.try_shutdown()
    return 0
