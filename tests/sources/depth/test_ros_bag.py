"""ROS 2 bags in MCAP and SQLite: depth, camera_info and tf of a room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import room_makers as room
from touchfield.errors import SourceError
from touchfield.sources.camera import Intrinsics
from touchfield.sources.depth.recorders import ros_messages as ros
from touchfield.sources.depth.recorders.ros_bag import read_bag
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import kinds, open_source

pytest.importorskip("mcap")
pytest.importorskip("mcap_ros2")
from bag_makers import (
    OPTICAL,
    PERIOD_NS,
    POSES,
    START_NS,
    camera_info,
    entries,
    image,
    write_db3,
    write_mcap,
)


@pytest.mark.parametrize("kind", ["16UC1", "big", "32FC1", "compressed", "quantised"])
@pytest.mark.parametrize("store", ["mcap", "db3"])
def test_the_room_of_a_bag_is_where_tf_says(tmp_path: Path, kind: str, store: str) -> None:
    is_compressed = kind in ("compressed", "quantised")
    topic = "/camera/depth/image_raw" + "/compressedDepth" * is_compressed
    written = entries(topic, kind)
    path = write_mcap(tmp_path / "a.mcap", written) if store == "mcap" else write_db3(tmp_path / "a", written)
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


def test_other_depth_topics_are_named(tmp_path: Path) -> None:
    extra = ("/a/depth/raw", ros.IMAGE, START_NS, image(START_NS, room.depths_mm()[0]))
    sequence = read_bag(write_mcap(tmp_path / "a.mcap", [*entries(), extra]), SourceOptions())
    assert any("not read: /a/depth/raw" in note for note in sequence.notes) and sequence.frame_count == 4


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
    with pytest.raises(SourceError, match=r"r1\.bag.*ROS 1.*rosbags-convert --src"):
        open_source(tmp_path / "r1.bag")
    with pytest.raises(SourceError, match=r"cannot be decoded"):
        ros.decode(ros.CAMERA_INFO, b"\0\1\0\0\1", "w")
