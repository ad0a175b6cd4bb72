"""Bags of ROS 1, also those that RealSense's viewer records, read by rosbags (extra: ros1).

A message is converted to CDR, the encoding of ROS 2, so that `ros_messages` decodes both. Only the messages
of a depth camera are read, by definitions of our own: those in a bag are a stranger's, and rosbags makes code
of them. Their MD5 sums must agree.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Final

from touchfield.errors import SourceError, TouchfieldError, import_extra
from touchfield.sources.depth.recorders import ros_messages as messages

MAGIC: Final = b"#ROSBAG V"
_EXPECTED: Final = "a bag of ROS 1 with depth images, 16UC1 or 32FC1"
_OLD_TRANSFORMS: Final = "tf/msg/tfMessage"  # before tf2, with the same fields


def is_ros1_bag(path: Path) -> bool:
    """Return True if a file starts as a bag of ROS 1 does."""
    if path.suffix.lower() != ".bag" or not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def topics_of_ros1(path: Path) -> dict[str, str]:
    """Return the topics of a bag and the types of their messages, named as in ROS 2."""
    with _reader(path) as reader:
        return {each.topic: _kind(each.msgtype) for each in reader.connections}


def read_ros1(
    path: Path, topics: list[str], at_ns: int | None = None
) -> Iterator[tuple[str, str, int, bytes]]:
    """Yield topic, type, time in nanoseconds and CDR bytes of messages by time; only those `at_ns` if given.

    Raises `SourceError` for a message whose definition differs from that of ROS.
    """
    stop_ns = None if at_ns is None else at_ns + 1
    with _reader(path) as reader:
        wanted = [each for each in reader.connections if each.topic in topics]
        for connection in wanted:
            _require_definition(path, connection)
        if not wanted:  # none would stand for all
            return
        for connection, time_ns, data in reader.messages(wanted, start=at_ns, stop=stop_ns):
            kind = _kind(connection.msgtype)
            yield connection.topic, kind, time_ns, bytes(_types_of_ros2().ros1_to_cdr(data, kind))


def _kind(name: str) -> str:
    return messages.TRANSFORMS if name == _OLD_TRANSFORMS else name


@cache
def types_of_ros1() -> Any:
    """Return the messages of ROS 1 that are read, for their MD5 sums."""
    typesys = import_extra("rosbags.typesys", "a bag of ROS 1", "rosbags", "ros1")
    types = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    text = "geometry_msgs/TransformStamped[] transforms"
    types.register(typesys.get_types_from_msg(text, messages.TRANSFORMS))
    return types


@cache
def _types_of_ros2() -> Any:
    """Return the messages of ROS 2; those of ROS 1 differ by a counter in the header, which is left out."""
    typesys = import_extra("rosbags.typesys", "a bag of ROS 1", "rosbags", "ros1")
    return typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def _require_definition(path: Path, connection: Any) -> None:
    kind = _kind(connection.msgtype)
    _, expected = types_of_ros1().generate_msgdef(kind)
    if connection.digest not in (expected, "*"):
        where = f"{path}, {connection.topic}"
        found = f"{connection.msgtype} of MD5 sum {connection.digest}"
        raise SourceError(where, found, f"{expected}, as in ROS", "Record it with ROS's own message.")


@contextmanager
def _reader(path: Path) -> Iterator[Any]:
    """Open a bag; the errors of rosbags for damaged files, of any type, become `SourceError`."""
    rosbag1 = import_extra("rosbags.rosbag1", f"{path}, a bag of ROS 1", "rosbags", "ros1")
    try:
        with rosbag1.Reader(path) as reader:
            yield reader
    except (TouchfieldError, GeneratorExit):
        raise
    except Exception as error:
        found = f"no sound bag of ROS 1 ({error or type(error).__name__})"
        mend = "Copy it again; one that was cut off: rosbag reindex FILE.bag"
        raise SourceError(str(path), found, _EXPECTED, mend) from error
