"""ROS 2 bags in MCAP and SQLite: depth, camera_info and tf of a room."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import room_makers as room
from touchfield.errors import MissingExtra, SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.recorders import ros_messages as ros
from touchfield.sources.depth.recorders.ros_bag import read_bag
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import kinds, open_source

pytest.importorskip("mcap")
pytest.importorskip("mcap_ros2")
from mcap.writer import Writer

from bag_makers import (
    OPTICAL,
    PERIOD_NS,
    POSES,
    START_NS,
    camera_info,
    entries,
    image,
    png,
    write_db3,
    write_mcap,
    write_ros1,
)

IMAGES = ("16UC1", "big", "32FC1")
COMPRESSED = ("compressed", "quantised", "rvl", "quantised rvl")


@pytest.mark.parametrize("kind", [*IMAGES, *COMPRESSED])
@pytest.mark.parametrize("store", ["mcap", "db3", "bag"])
def test_the_room_of_a_bag_is_where_tf_says(tmp_path: Path, kind: str, store: str) -> None:
    topic = "/camera/depth/image_raw" + "/compressedDepth" * (kind in COMPRESSED)
    written = entries(topic, kind)
    if store == "bag":
        pytest.importorskip("rosbags")
        path = write_ros1(tmp_path / "a.bag", written)
    elif store == "mcap":
        path = write_mcap(tmp_path / "a.mcap", written)
    else:
        path = write_db3(tmp_path / "a", written)
    assert next(each for each in kinds() if each.recognise(path)).name == "ros-bag"
    sequence = read_bag(path, SourceOptions())
    room.assert_room(sequence)
    assert sequence.intrinsics == Intrinsics(*room.CAMERA) and sequence.rate_hz == pytest.approx(20, rel=1e-6)
    assert any("map <- base_link <- depth_optical" in note for note in sequence.notes), sequence.notes
    assert np.allclose(sequence.poses[2], OPTICAL @ POSES[2], atol=1e-6)
    assert open_source(path).frame_count == 4


def test_distortion_of_camera_info_is_undone_unless_the_topic_is_rectified(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    d = (-0.3, 0.1, 0.002, -0.001, -0.02)
    bent = read_bag(write_mcap(tmp_path / "raw.mcap", entries(d=d)), SourceOptions())
    room.assert_room(bent, known=0.9)
    assert any("is undone" in note for note in bent.notes)
    written = entries("/camera/depth/image_rect_raw")
    written[1] = (written[1][0], ros.CAMERA_INFO, START_NS, camera_info(d))
    flat = read_bag(write_mcap(tmp_path / "rect.mcap", written), SourceOptions())
    room.assert_room(flat)
    assert any("is rectified: P of" in note for note in flat.notes)


def test_images_outside_the_time_of_tf_are_left_out(tmp_path: Path) -> None:
    written = [
        entry for entry in entries() if entry[0] != "/tf" or entry[2] < START_NS + 2 * PERIOD_NS - 25_000_000
    ]
    written.append(("/camera/depth/image_raw", ros.IMAGE, START_NS + 10**9,
                    image(START_NS + 10**9, room.depths_mm()[3])))  # fmt: skip
    sequence = read_bag(write_mcap(tmp_path / "a.mcap", written), SourceOptions())
    assert sequence.frame_count < 5 and any(
        "left out: no transform within" in note for note in sequence.notes
    )


def test_a_bag_without_tf_has_a_static_camera(tmp_path: Path) -> None:
    written = [entry for entry in entries() if entry[0] != "/tf"]
    sequence = read_bag(write_mcap(tmp_path / "a.mcap", written), SourceOptions())
    assert sequence.poses is None and any(
        "tf has no motion of depth_optical" in note for note in sequence.notes
    )


def test_other_depth_topics_are_named_and_can_be_chosen(tmp_path: Path) -> None:
    extra = [
        ("/a/depth/raw", ros.IMAGE, START_NS + i, image(START_NS + i, room.depths_mm()[0])) for i in (0, 9)
    ]
    path = write_mcap(tmp_path / "a.mcap", [*entries(), *extra])
    sequence = read_bag(path, SourceOptions())
    assert sequence.frame_count == 4
    assert any("not read: /a/depth/raw (2 images) (--topic)" in note for note in sequence.notes)
    chosen = read_bag(path, SourceOptions(topic="/a/depth/raw", intrinsics=",".join(map(str, room.CAMERA))))
    assert chosen.frame_count == 2
    assert any("not read: /camera/depth/image_raw (4 images)" in note for note in chosen.notes)
    with pytest.raises(
        SourceError, match=r"a\.mcap, --topic: found no topic /b; expected one of /camera/depth/image_raw \(4"
    ):
        read_bag(path, SourceOptions(topic="/b"))
    with pytest.raises(SourceError, match="found no depth in the topic /camera/color/image_raw"):
        read_bag(path, SourceOptions(topic="/camera/color/image_raw"))


def test_a_bag_of_realsense_states_its_unit(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    sensor = "/device_0/sensor_0"
    topics = {
        "/camera/depth/image_raw": f"{sensor}/Depth_0/image/data",
        "/camera/depth/camera_info": f"{sensor}/Depth_0/info/camera_info",
    }
    written = [(topics[topic], *rest) for topic, *rest in entries() if topic in topics]
    for _, kind, _, message in written:
        if kind == ros.IMAGE:  # units of a quarter of a millimetre
            message["data"] = (4 * np.frombuffer(message["data"], "<u2")).astype("<u2").tobytes()
            message["encoding"] = "mono16"
    unit = (f"{sensor}/option/Depth_Units/value", ros.FLOAT, 1, {"data": 0.00025})
    path = write_ros1(tmp_path / "a.bag", [unit, *written])
    sequence = read_bag(path, SourceOptions())
    np.testing.assert_allclose(sequence.depth_m(0), room.depth_m(POSES[0]), atol=6e-4)
    assert any("The camera is that of" in note for note in sequence.notes)


def test_quantised_depth_is_that_of_the_definition() -> None:
    """As codec.cpp of image_transport_plugins: a = 100 * 101, b = 1 - a / 10, value = int(a / depth + b)."""
    head = struct.pack("<iff", 0, 10100.0, -1009.0)
    stored = np.array([[0, 1, 4041, 9091]], np.uint16)
    message = SimpleNamespace(format="32FC1; compressedDepth png", data=head + png(stored))
    depth = ros.depth_values(ros.COMPRESSED_IMAGE, message, "w")
    np.testing.assert_allclose(depth, [[0, 10, 2, 1]], rtol=1e-6)


def test_rvl_is_that_of_the_definition() -> None:
    """Two zeros, three samples 5, 6, 4, one zero: nibbles 2 3 | 10 = 2+8, 1 | 2 | 3 | 1 0."""
    data = struct.pack("<IIII", 3, 2, 0x23A12310, 0)
    np.testing.assert_array_equal(ros.decode_rvl(data, "w"), [[0, 0, 5], [6, 4, 0]])
    for bad in (b"", data[:8], struct.pack("<III", 3, 2, 0x2FA12310), struct.pack("<III", 9, 9, 0x23A12310)):
        with pytest.raises(SourceError, match="w: found"):
            ros.decode_rvl(bad, "w")


def test_faults_of_bags_are_one_line(tmp_path: Path) -> None:
    colour = [entry for entry in entries() if "depth" not in entry[0] or entry[1] != ros.IMAGE]
    with pytest.raises(SourceError, match=r"c\.mcap.*no depth image in .*/camera/color/image_raw"):
        open_source(write_mcap(tmp_path / "c.mcap", colour))
    written = entries()
    bad = {**written[-2][3], "step": 10}
    written[4] = (written[-2][0], ros.IMAGE, START_NS, bad)
    sequence = read_bag(write_mcap(tmp_path / "s.mcap", written), SourceOptions())
    with pytest.raises(SourceError, match=r"/camera/depth/image_raw, frame .*10 bytes a row"):
        list(map(sequence.depth_m, range(sequence.frame_count)))
    (tmp_path / "x.db3").write_bytes(b"no database" * 100)
    with pytest.raises(SourceError, match=r"x\.db3.*no sound bag"):
        open_source(tmp_path / "x.db3")
    (tmp_path / "r1.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(
        (SourceError, MissingExtra), match=r"r1\.bag.*(no sound bag of ROS 1|touchfield\[ros1\])"
    ):
        open_source(tmp_path / "r1.bag")
    with pytest.raises(SourceError, match=r"cannot be decoded"):
        ros.decode(ros.CAMERA_INFO, b"\0\1\0\0\1", "w")


def test_a_topic_with_messages_of_two_types_is_refused(tmp_path: Path) -> None:
    """The decoder of the listed type would read the other: an internal error before."""
    path = tmp_path / "two.mcap"
    with path.open("wb") as stream:
        bag = Writer(stream)
        bag.start(profile="ros2")
        for name in ("tf2_migs/msg/TFMessage", ros.TRANSFORMS):
            schema = bag.register_schema(name, "ros2msg", ros.DEFINITIONS[ros.TRANSFORMS].encode())
            channel = bag.register_channel("/tf", "cdr", schema)
            bag.add_message(channel, START_NS, b"\0\1\0\0\0\0\0\0", START_NS)
        bag.finish()
    found = "two.mcap, /tf: found messages of tf2_migs/msg/TFMessage, listed as tf2_msgs/msg/TFMessage"
    with pytest.raises(SourceError, match=found):
        read_bag(path, SourceOptions())
