"""As std_msgs.msg: fields of other names are refused, as in ROS."""


class Header:
    """As std_msgs/Header."""

    __slots__ = ("frame_id", "stamp")

    def __init__(self) -> None:
        self.stamp, self.frame_id = (0, 0), ""
