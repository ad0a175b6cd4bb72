"""As geometry_msgs.msg: fields of other names are refused, and numbers are floats, as in ROS."""

from __future__ import annotations

from std_msgs.msg import Header


class Point:
    """As geometry_msgs/Point; Vector3 likewise."""

    __slots__ = ("x", "y", "z")

    def __init__(self) -> None:
        self.x = self.y = self.z = 0.0

    def __setattr__(self, name: str, value: float) -> None:
        if type(value) is not float:
            raise TypeError(f"{name}: found {type(value).__name__}, expected float")
        super().__setattr__(name, value)


class Vector3(Point):
    """As geometry_msgs/Vector3."""

    __slots__ = ()


class Pose:
    """As geometry_msgs/Pose, without its orientation."""

    __slots__ = ("position",)

    def __init__(self) -> None:
        self.position = Point()


class PoseStamped:
    """As geometry_msgs/PoseStamped."""

    __slots__ = ("header", "pose")

    def __init__(self) -> None:
        self.header, self.pose = Header(), Pose()


class Wrench:
    """As geometry_msgs/Wrench."""

    __slots__ = ("force", "torque")

    def __init__(self) -> None:
        self.force, self.torque = Vector3(), Vector3()


class WrenchStamped:
    """As geometry_msgs/WrenchStamped."""

    __slots__ = ("header", "wrench")

    def __init__(self) -> None:
        self.header, self.wrench = Header(), Wrench()
