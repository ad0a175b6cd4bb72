"""ROS 2 bags in MCAP and SQLite: depth, camera_info and tf of the room of `room_makers`."""

from __future__ import annotations

import sqlite3
import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2 import _dynamic as dynamic, writer
from PIL import Image

import room_makers as room
from touchfield.sources.depth.recorders import ros1_bag, ros_messages as ros

POSES = room.poses()
FX, FY, CX, CY = room.CAMERA
START_NS, PERIOD_NS = 1_700_000_000_000_000_000, 50_000_000
OPTICAL = np.array([[0.0, 0, 1, 0.1], [-1, 0, 0, 0.02], [0, -1, 0, 0.3], [0, 0, 0, 1]])  # base from optical
Entry = tuple[str, str, int, dict[str, Any]]


def header(time_ns: int, frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": time_ns // 10**9, "nanosec": time_ns % 10**9}, "frame_id": frame}


def transform(time_ns: int, parent: str, child: str, matrix: np.ndarray) -> dict[str, Any]:
    x, y, z, w = room.quaternions(matrix[None])[0].tolist()
    return {
        "header": header(time_ns, parent), "child_frame_id": child,
        "transform": {
            "translation": dict(zip("xyz", matrix[:3, 3].tolist())),
            "rotation": {"x": x, "y": y, "z": z, "w": w},
        },
    }  # fmt: skip


def image(time_ns: int, values: np.ndarray, big: bool = False, padding: int = 0) -> dict[str, Any]:
    encoding = "32FC1" if values.dtype == np.float32 else "16UC1"
    rows = values.astype(values.dtype.newbyteorder(">" if big else "<")).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    height, width = values.shape
    return {"header": header(time_ns, "depth_optical"), "height": height, "width": width,
            "encoding": encoding, "is_bigendian": int(big), "step": rows.shape[1],
            "data": rows.tobytes()}  # fmt: skip


DEPTH_QUANTISATION, DEPTH_MAX_M = 100.0, 10.0  # defaults of compressed_depth_image_transport
RVL_WORD = struct.Struct("<I")


def compressed(time_ns: int, depth_m: np.ndarray, encoding: str, form: str = "png") -> dict[str, Any]:
    """An image as `encodeCompressedDepthImage` of ROS's image_transport_plugins defines it."""
    z0 = np.float32(DEPTH_QUANTISATION)
    a = z0 * (z0 + np.float32(1))
    b = np.float32(1) - a / np.float32(DEPTH_MAX_M)
    if encoding == "16UC1":
        stored, a, b = np.rint(1000 * depth_m).astype(np.uint16), np.float32(0), np.float32(0)
    else:
        is_near = depth_m < DEPTH_MAX_M
        stored = np.where(is_near, a / depth_m.astype(np.float32) + b, 0).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + (png(stored) if form == "png" else rvl(stored))
    return {
        "header": header(time_ns, "depth_optical"),
        "format": f"{encoding}; compressedDepth {form}",
        "data": data,
    }


def png(stored: np.ndarray) -> bytes:
    stream = BytesIO()
    Image.fromarray(stored).save(stream, "PNG")
    return stream.getvalue()


def rvl(stored: np.ndarray) -> bytes:
    """RVL: width and height, then nibbles of variable-length numbers, eight in a word of 32 bits."""
    nibbles: list[int] = []

    def add(number: int) -> None:
        while number >= 8:
            nibbles.append(number & 7 | 8)
            number >>= 3
        nibbles.append(number)

    samples, at, previous = stored.ravel().tolist(), 0, 0
    while at < len(samples):
        start = at
        while at < len(samples) and samples[at] == 0:
            at += 1
        add(at - start)
        start = at
        while at < len(samples) and samples[at] != 0:
            at += 1
        add(at - start)
        for sample in samples[start:at]:
            difference = sample - previous
            add(2 * difference if difference >= 0 else -2 * difference - 1)
            previous = sample
    nibbles += [0] * (-len(nibbles) % 8)
    words = [int("".join(f"{n:x}" for n in nibbles[i : i + 8]), 16) for i in range(0, len(nibbles), 8)]
    return struct.pack("<II", *stored.shape[::-1]) + b"".join(map(RVL_WORD.pack, words))


def camera_info(d: tuple[float, ...] = (0, 0, 0, 0, 0), model: str = "plumb_bob") -> dict[str, Any]:
    roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
    return {"header": header(START_NS, "depth_optical"), "height": room.HEIGHT, "width": room.WIDTH,
            "distortion_model": model, "d": list(d), "k": [FX, 0, CX, 0, FY, CY, 0, 0, 1],
            "r": np.eye(3).ravel().tolist(), "p": [FX, 0, CX, 0, 0, FY, CY, 0, 0, 0, 1, 0],
            "binning_x": 0, "binning_y": 0, "roi": roi}  # fmt: skip


def entries(topic: str = "/camera/depth/image_raw", kind: str = "16UC1", **info: Any) -> list[Entry]:
    """Depth at four times; tf of the base 20 ms before and after each, so that it has to be interpolated."""
    distort = room.brown(*info["d"]) if "d" in info else None
    namespace = topic.removesuffix("/compressedDepth").rpartition("/")[0]
    written: list[Entry] = [
        ("/tf_static", ros.TRANSFORMS, START_NS,
         {"transforms": [transform(START_NS, "base_link", "depth_optical", OPTICAL)]}),
        (f"{namespace}/camera_info", ros.CAMERA_INFO, START_NS, camera_info(**info)),
    ]  # fmt: skip
    for i, pose in enumerate(POSES):
        time_ns = START_NS + PERIOD_NS * i
        base = OPTICAL @ pose @ np.linalg.inv(OPTICAL)  # map from base; the map is the first base
        for shift, sign in ((-20_000_000, -1), (20_000_000, 1)):
            moved = base.copy()
            moved[:3, 3] += sign * np.array([0.01, 0.02, -0.01])
            tf = transform(time_ns + shift, "map", "base_link", moved)
            written.append(("/tf", ros.TRANSFORMS, time_ns + shift, {"transforms": [tf]}))
        depth = room.depth_m(pose, distort=distort)
        millimetres = np.rint(1000 * depth).astype(np.uint16)
        message: tuple[str, dict[str, Any]] = {
            "16UC1": lambda t=time_ns, v=millimetres: (ros.IMAGE, image(t, v)),
            "big": lambda t=time_ns, v=millimetres: (ros.IMAGE, image(t, v, True, 8)),
            "32FC1": lambda t=time_ns, v=depth: (ros.IMAGE, image(t, v.astype(np.float32))),
            "compressed": lambda t=time_ns, v=depth: (ros.COMPRESSED_IMAGE, compressed(t, v, "16UC1")),
            "quantised": lambda t=time_ns, v=depth: (ros.COMPRESSED_IMAGE, compressed(t, v, "32FC1")),
            "rvl": lambda t=time_ns, v=depth: (ros.COMPRESSED_IMAGE, compressed(t, v, "16UC1", "rvl")),
            "quantised rvl": lambda t=time_ns, v=depth: (
                ros.COMPRESSED_IMAGE,
                compressed(t, v, "32FC1", "rvl"),
            ),
        }[kind]()
        written.append((topic, message[0], time_ns, message[1]))
        colour = {"header": header(time_ns, "colour"), "height": 1, "width": 1, "encoding": "rgb8",
                  "is_bigendian": 0, "step": 3, "data": b"abc"}  # fmt: skip
        written.append(("/camera/color/image_raw", ros.IMAGE, time_ns, colour))
    return written


def write_mcap(path: Path, written: list[Entry]) -> Path:
    with path.open("wb") as stream:
        bag = writer.Writer(stream)
        schemas = {kind: bag.register_msgdef(kind, text) for kind, text in ros.DEFINITIONS.items()}
        for topic, kind, time_ns, message in written:
            bag.write_message(topic, schemas[kind], message, log_time=time_ns + 3_000_000)
        bag.finish()
    return path


def write_db3(folder: Path, written: list[Entry]) -> Path:
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
    database = sqlite3.connect(folder / "bag_0.db3")
    database.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT)"
    )
    database.execute(
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)"
    )
    names = list(dict.fromkeys((topic, kind) for topic, kind, _, _ in written))
    for i, (topic, kind) in enumerate(names):
        database.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr')", (i + 1, topic, kind))
    for topic, kind, time_ns, message in written:
        data = dynamic.serialize_dynamic(kind, ros.DEFINITIONS[kind])[kind](message)
        values = (names.index((topic, kind)) + 1, time_ns, bytes(data))
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", values)
    database.commit()
    database.close()
    return folder


def write_ros1(path: Path, written: list[Entry]) -> Path:
    """Write a bag of ROS 1 by rosbags; its writer makes the bytes of ROS 1 from those of ROS 2."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    types, to_ros1 = ros1_bag.types_of_ros1(), get_typestore(Stores.ROS2_HUMBLE)
    bag = Writer(path)
    bag.set_compression(Writer.CompressionFormat.LZ4)
    with bag:
        topics: dict[str, Any] = {}
        for topic, kind, time_ns, message in written:
            if topic not in topics:
                topics[topic] = bag.add_connection(topic, kind, typestore=types)
            data = bytes(dynamic.serialize_dynamic(kind, ros.DEFINITIONS[kind])[kind](message))
            bag.write(topics[topic], time_ns, to_ros1.cdr_to_ros1(data, kind))
    return path
