"""Runs the node for a second without ROS, against the stand-ins of ``stub/``: python try_node.py FILE.touch [X Y Z]."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE / "stub")]


def main(path: str, *place: str) -> None:
    """Hold a hand still for a second and print a wrench for each tenth of it."""
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from rclpy.node import PARAMETERS
    from touchfield_ros2.player_node import PlayerNode

    PARAMETERS["file"] = path
    rclpy.init()
    node = PlayerNode()
    hand = PoseStamped()
    hand.header.frame_id = "touchfield"
    hand.pose.position.x, hand.pose.position.y, hand.pose.position.z = map(float, place or (0.0, 0.0, 0.0))
    for _ in range(10):
        node.give("hand", hand)
        node.turn(0.1)
    sent = node.publishers["wrench"].sent
    for message in sent[99::100]:
        force = message.wrench.force
        print(f"{force.x:.6f} {force.y:.6f} {force.z:.6f} N")
    node.destroy_node()
    rclpy.try_shutdown()
    print(f"{len(sent)} wrenches in a second")


if __name__ == "__main__":
    main(*sys.argv[1:])
