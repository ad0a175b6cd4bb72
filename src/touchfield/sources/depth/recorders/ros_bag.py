"""ROS bags and MCAP files with a depth camera (extra: mcap; of ROS 1: ros1).

A bag is a folder with ``metadata.yaml`` and ``*.mcap`` or ``*.db3`` (SQLite), one such file, or a ``.bag`` of
ROS 1. Read are:

depth         the topic of ``--topic``, else that with the most images, one named *depth* first; a note names
              the others
camera_info   that beside it (RealSense: ``.../info/camera_info`` beside ``.../image/data``), else the one of
              the same frame: K and D; P of a topic named *rect*
/tf           from the camera's frame up to the root of the tree; interpolated to the time of each image. The
/tf_static    camera's frame is an optical one (REP 103): x right, y down, z forward
Depth_Units   RealSense: the metres of a stored unit
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s
from touchfield.errors import MissingExtra, SourceError, as_source_error, import_extra
from touchfield.files import library_faults
from touchfield.sources.camera import CodedSequence, DepthCode, DepthSequence, Intrinsics, require_frame
from touchfield.sources.depth.frame_poses import PosedFrames, drop_unposed, find_poses
from touchfield.sources.depth.intrinsics_file import CameraFile, camera_of, scaled_camera
from touchfield.sources.depth.layouts import depth_kind, source_rate
from touchfield.sources.depth.lens import distortion_of, rectified
from touchfield.sources.depth.recorders import ros_messages as messages
from touchfield.sources.depth.recorders.ros1_bag import is_ros1_bag, read_ros1, topics_of_ros1
from touchfield.sources.images.pictures import list_files, require_size
from touchfield.sources.options import SourceOptions
from touchfield.sources.poses import interpolate_poses, poses_of_quaternions
from touchfield.sources.recordings.mcap_chunks import require_distinct_chunks

_FILES: Final = r".+\.(mcap|db3)"
_IMAGES: Final = (messages.IMAGE, messages.COMPRESSED_IMAGE)
_MAX_MESSAGES: Final = 1 << 22
_TF_TOLERANCE_S: Final = 0.1  # between an image and the first or last transform
_EXPECTED: Final = "a ROS bag with depth images, 16UC1 or 32FC1"
_REALSENSE_IMAGES: Final = "/image/data"
_UNITS: Final = "/option/Depth_Units/value"  # of a RealSense's sensor
_LISTED: Final = 6  # topics in a message


class Message(NamedTuple):
    """A message of a bag: topic, name of its type, its place (a file and a key in it), and its bytes."""

    topic: str
    kind: str
    place: tuple[Path, int]
    data: bytes


# -- files -------------------------------------------------------------------------------------------------
@contextmanager
def _faults(path: Path) -> Iterator[None]:
    """Convert the errors of SQLite, MCAP and what decompresses it to `SourceError`."""
    kind = "MCAP" if path.suffix.lower() == ".mcap" else "bag"
    with library_faults(path, f"no sound {kind}", _EXPECTED, "Copy it again."):
        yield


def _files(path: Path) -> tuple[Path, ...]:
    return list_files(path, _FILES) if path.is_dir() else (path,)


def topics_of(path: Path) -> dict[str, str]:
    """Return the topics of a bag and the types of their messages."""
    topics: dict[str, str] = {}
    for file in _files(path):
        with _faults(file):
            if is_ros1_bag(file):
                topics |= topics_of_ros1(file)
                continue
            if file.suffix.lower() == ".db3":
                with closing(_connect(file)) as database:
                    rows = database.execute("SELECT name, type FROM topics")
                    topics |= {str(name): str(kind) for name, kind in rows}  # SQLite stores any type anywhere
                continue
            reader = import_extra("mcap.reader", str(path), "mcap", "mcap")
            with file.open("rb") as stream:
                summary = reader.make_reader(stream).get_summary()
                require_distinct_chunks(summary, str(file))
                if summary is not None:
                    for channel in summary.channels.values():
                        schema = summary.schemas.get(channel.schema_id)
                        topics[channel.topic] = schema.name if schema is not None else ""
                    continue
                for schema, channel, _ in reader.make_reader(stream).iter_messages():
                    topics[channel.topic] = schema.name if schema is not None else ""
    return topics


def _connect(file: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro", uri=True)


def _blob(data: object) -> bytes:
    """Check a message of a database; ValueError if it is no bytes, as SQLite stores any type anywhere."""
    if not isinstance(data, bytes):
        raise ValueError(f"a message of type {type(data).__name__}")
    return data


def _read(path: Path, topics: list[str]) -> Iterator[Message]:
    """Yield the messages of these topics, by time within a file."""
    for file in _files(path):
        with _faults(file):
            if is_ros1_bag(file):
                for topic, kind, time_ns, data in read_ros1(file, topics):
                    yield Message(topic, kind, (file, time_ns), data)
                continue
            if file.suffix.lower() == ".db3":
                with closing(_connect(file)) as database:
                    marks = ",".join("?" * len(topics))
                    query = (
                        "SELECT topics.name, topics.type, messages.id, messages.data FROM messages "
                        f"JOIN topics ON messages.topic_id = topics.id WHERE topics.name IN ({marks}) "
                        "ORDER BY messages.timestamp"
                    )
                    for topic, kind, key, data in database.execute(query, topics):
                        yield Message(topic, kind, (file, int(key)), _blob(data))
                continue
            reader = import_extra("mcap.reader", str(path), "mcap", "mcap")
            with file.open("rb") as stream:
                for schema, channel, message in reader.make_reader(stream).iter_messages(topics=topics):
                    kind = schema.name if schema is not None else ""
                    if channel.message_encoding == "cdr":
                        yield Message(channel.topic, kind, (file, int(message.log_time)), message.data)


def _read_one(place: tuple[Path, int], topic: str) -> bytes:
    """Read one message again."""
    file, key = place
    with _faults(file):
        if is_ros1_bag(file):
            for _, _, _, data in read_ros1(file, [topic], key):
                return data
        elif file.suffix.lower() == ".db3":
            with closing(_connect(file)) as database:
                row = database.execute("SELECT data FROM messages WHERE id = ?", (key,)).fetchone()
            if row is not None:
                return _blob(row[0])
        else:
            reader = import_extra("mcap.reader", str(file), "mcap", "mcap")
            with file.open("rb") as stream:
                found = reader.make_reader(stream).iter_messages(
                    topics=[topic], starting_at=key, ending_at=key
                )
                for _, _, message in found:
                    return bytes(message.data)
    raise SourceError(str(file), f"no message of {topic} where it was", "the same file as before")


# -- contents ----------------------------------------------------------------------------------------------
class BagFrames:
    """Depth images of a bag, read on demand (`camera.Frames`)."""

    def __init__(self, topic: str, kind: str, places: list[tuple[Path, int]]) -> None:
        self.topic, self.kind, self.places, self.frame_count = topic, kind, places, len(places)
        self.size = (0, 0)
        first = self.values(0)
        self.size = (first.shape[1], first.shape[0])

    def values(self, frame: int) -> NDArray[Any]:
        """See ``camera.Frames``."""
        require_frame(frame, self.frame_count)
        where = f"{self.places[frame][0]}, {self.topic}, frame {frame}"
        message = messages.decode(self.kind, _read_one(self.places[frame], self.topic), where)
        values = messages.depth_values(self.kind, message, where)
        if self.size != (0, 0):
            require_size(where, values.shape[::-1], self.size, "as the first image has")
        return values


class _Recording(NamedTuple):
    """The depth images of a bag, with what belongs to them."""

    topic: str
    kind: str
    encoding: str
    frame_id: str
    places: list[tuple[Path, int]]
    times_s: Float64s
    camera_infos: dict[str, Any]
    transforms: dict[str, Any]
    units_m: dict[str, float]
    notes: tuple[str, ...]


def _read_recording(path: Path, requested: str | None) -> _Recording:
    topics = topics_of(path)
    images = [name for name, kind in topics.items() if kind in _IMAGES]
    others = [name for name, kind in topics.items() if kind in (messages.CAMERA_INFO, messages.TRANSFORMS)]
    others += [name for name, kind in topics.items() if kind == messages.FLOAT and name.endswith(_UNITS)]
    depth: dict[str, list[Any]] = {}
    is_depth: dict[str, bool] = {}
    infos: dict[str, Any] = {}
    transforms: dict[str, Any] = {}
    units_m: dict[str, float] = {}
    count = 0
    for topic, kind, place, data in _read(path, [*images, *others]):
        count += 1
        if count > _MAX_MESSAGES:
            raise SourceError(str(path), f"more than {_MAX_MESSAGES} messages", "fewer", "Cut it in parts.")
        if kind != topics[topic]:  # the summary of an MCAP file and its chunks may name different schemas
            found = f"messages of {kind}, listed as {topics[topic]}"
            raise SourceError(f"{place[0]}, {topic}", found, "messages of one type", "Copy the bag again.")
        if (kind in _IMAGES and not is_depth.get(topic, True)) or (
            kind == messages.CAMERA_INFO and topic in infos
        ):
            continue
        message = messages.decode(kind, data, f"{place[0]}, {topic}")
        if kind == messages.CAMERA_INFO:
            infos[topic] = message
        elif kind == messages.FLOAT:
            units_m[topic.removesuffix(_UNITS)] = float(message.data)
        elif kind == messages.TRANSFORMS:
            _add_transforms(transforms, message, topic.endswith("_static"))
        else:
            encoding = messages.encoding_of(kind, message)
            is_depth.setdefault(topic, bool(encoding))
            if encoding:
                entry = (messages.stamp_s(message.header), place, encoding, message.header.frame_id)
                depth.setdefault(topic, []).append(entry)
    if not depth:
        kinds = [f"{name} ({kind.rpartition('/')[2]})" for name, kind in topics.items()]
        found = f"no depth image in {_listed(kinds)}"
        raise SourceError(str(path), found, _EXPECTED)
    topic, notes = _choose(path, {name: len(entries) for name, entries in depth.items()}, topics, requested)
    entries = sorted(depth[topic], key=lambda entry: entry[0])
    times_s = np.array([entry[0] for entry in entries])
    places = [entry[1] for entry in entries]
    return _Recording(
        topic, topics[topic], entries[0][2], entries[0][3], places, times_s, infos, transforms, units_m, notes
    )


def _choose(
    path: Path, counts: dict[str, int], topics: dict[str, str], requested: str | None
) -> tuple[str, tuple[str, ...]]:
    """Return the topic of depth that is read, and notes on it and on the others.

    `counts` has the images of each topic with depth. Raises `SourceError` if the requested one is none.
    """
    ranked = sorted(
        counts,
        key=lambda name: ("depth" not in name.lower(), topics[name] != messages.IMAGE, -counts[name], name),
    )
    listed = [f"{name} ({counts[name]} images)" for name in ranked]
    if requested is not None and requested not in counts:
        found = f"{'no depth in the' if requested in topics else 'no'} topic {requested}"
        raise SourceError(f"{path}, --topic", found, f"one of {_listed(listed)}")
    topic = requested or ranked[0]
    others = [text for name, text in zip(ranked, listed, strict=True) if name != topic]
    notes: tuple[str, ...] = (f"Depth of the topic {topic}, {counts[topic]} images.",)
    if others:
        notes += (f"Depth of other topics is not read: {_listed(others)} (--topic).",)
    return topic, notes


def _listed(names: Sequence[str]) -> str:
    left = len(names) - _LISTED
    return (", ".join(names[:_LISTED]) or "no topic") + f" and {left} more" * (left > 0)


def _camera(path: Path, recording: _Recording, size: tuple[int, int], options: SourceOptions) -> CameraFile:
    """Return the camera of the options, or that of the camera_info of the depth images."""
    infos, topic = recording.camera_infos, recording.topic
    base = topic.removesuffix("/compressedDepth").rpartition("/")[0]
    if topic.endswith(_REALSENSE_IMAGES):
        base = f"{topic.removesuffix(_REALSENSE_IMAGES)}/info"
    of_frame = [name for name, info in infos.items() if info.header.frame_id == recording.frame_id]
    name = f"{base}/camera_info" if f"{base}/camera_info" in infos else next(iter(sorted(of_frame)), None)
    if options.intrinsics is not None or name is None:
        return camera_of(str(path), options.intrinsics, (path.absolute().parent,), size)
    info, where = infos[name], f"{path}, {name}"
    is_rectified = "rect" in topic.rpartition("/")[2] or "rect" in topic.removesuffix("/compressedDepth")
    matrix = [info.p[0], info.p[5], info.p[2], info.p[6]]
    notes: tuple[str, ...] = (f"The camera is that of {name}.",)
    distortion = None
    if not (is_rectified and matrix[0] > 0):
        matrix = [info.k[0], info.k[4], info.k[2], info.k[5]]
        distortion = distortion_of(list(info.d), name, info.distortion_model)
    elif any(info.d):
        notes += (f"{topic} is rectified: P of {name} is used, and no distortion is undone.",)
    with as_source_error(f"{where}: "):
        k = Intrinsics(*(float(value) for value in matrix))
    stated = (int(info.width), int(info.height))
    if stated != size:  # pixel centres are whole numbers in ROS, and one half there
        scaled = scaled_camera(Intrinsics(k.fx, k.fy, k.cx + 0.5, k.cy + 0.5), stated, where, size)
        k, notes = scaled.intrinsics, (*notes, *scaled.notes)
    return CameraFile(k, None, notes, False, distortion)


# -- transforms --------------------------------------------------------------------------------------------
def _add_transforms(transforms: dict[str, Any], message: Any, is_static: bool) -> None:
    """Add the transforms of a message: child -> (parent, is static, rows of time, position and x y z w)."""
    for stamped in message.transforms:
        t, q = stamped.transform.translation, stamped.transform.rotation
        row = (messages.stamp_s(stamped.header), t.x, t.y, t.z, q.x, q.y, q.z, q.w)
        child, parent = stamped.child_frame_id.lstrip("/"), stamped.header.frame_id.lstrip("/")
        known = transforms.setdefault(child, (parent, is_static, []))
        if known[0] == parent:
            known[2].append(row)


def _poses(path: Path, recording: _Recording) -> PosedFrames:
    """Return the poses of the camera in the root of the tree of transforms, at the times of the images."""
    times_s, count = recording.times_s, len(recording.times_s)
    poses = np.tile(np.eye(4), (count, 1, 1))
    is_known = np.ones(count, bool)
    frame, chain, moves = recording.frame_id.lstrip("/"), [recording.frame_id.lstrip("/")], False
    while frame in recording.transforms and len(chain) < 100:
        parent, is_static, rows = recording.transforms[frame]
        link, is_within = _link(np.array(rows, np.float64), is_static, times_s, f"{path}, tf of {frame}")
        poses, is_known = link @ poses, is_known & is_within
        moves = moves or not is_static
        frame = parent
        chain.append(frame)
    if not moves:
        named = f"tf has no motion of {recording.frame_id or 'the camera'}"
        return PosedFrames(tuple(range(count)), None, (f"{named}: the camera is assumed to be static.",))
    listed = [pose if known else None for pose, known in zip(poses, is_known)]
    posed = drop_unposed(str(path), listed, f"no transform within {_TF_TOLERANCE_S:g} s")
    note = f"Poses of tf: {' <- '.join(reversed(chain))}, interpolated to the times of the images."
    return posed._replace(notes=(*posed.notes, note))


def _link(rows: Float64s, is_static: bool, times_s: Float64s, where: str) -> tuple[Float64s, NDArray[Any]]:
    """Return one transform at the given times, float64 [n, 4, 4], and whether it is known at each."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    if is_static or len(rows) == 1:
        rows = rows[-1:]
    poses_of_quaternions(rows[:, 4:], rows[:, 1:4], where)  # raises for an invalid one
    indices = np.interp(times_s, rows[:, 0], np.arange(len(rows)))
    quaternions, positions_m = interpolate_poses(np.roll(rows[:, 4:], 1, axis=1), rows[:, 1:4], indices)
    poses = poses_of_quaternions(np.roll(quaternions, -1, axis=1), positions_m, where)
    low, high = rows[0, 0] - _TF_TOLERANCE_S, rows[-1, 0] + _TF_TOLERANCE_S
    return poses, np.full(len(times_s), True) if is_static else (times_s >= low) & (times_s <= high)


def _depth_scale(recording: _Recording) -> float:
    """Return the stored units in a metre: those of a RealSense's sensor, else millimetres or metres."""
    if messages.DEPTH_ENCODINGS[recording.encoding] == "f4":
        return 1.0
    sensors = [name for name in recording.units_m if recording.topic.startswith(f"{name}/")]
    unit_m = recording.units_m[sensors[0]] if sensors else 0.0
    return 1 / unit_m if 0 < unit_m < 1 else 1000.0


# -- the kind ----------------------------------------------------------------------------------------------
def read_bag(path: Path, options: SourceOptions) -> DepthSequence:
    """Read the depth images of a bag, with their camera and poses.

    Raises `SourceError` if there is no depth, or the bag is damaged; `MissingExtra` without the libraries.
    """
    recording = _read_recording(path, options.topic)
    frames = BagFrames(recording.topic, recording.kind, recording.places)
    if options.frame == "world" and options.poses is None:
        posed = _poses(path, recording)
    else:
        posed = find_poses(str(path), frames.frame_count, options, (), recording.times_s)
    camera = _camera(path, recording, frames.size, options)
    scale = options.depth_scale or _depth_scale(recording)
    gaps = np.diff(recording.times_s)
    gaps = gaps[gaps > 1e-6]
    rate_hz = float(1 / np.median(gaps)) if len(gaps) else source_rate(options)
    if len(posed.indices) < frames.frame_count:
        frames = BagFrames(recording.topic, recording.kind, [recording.places[i] for i in posed.indices])
    notes = (*posed.notes, *recording.notes, *camera.notes)
    sequence = CodedSequence(str(path), frames, DepthCode(scale), camera.intrinsics, rate_hz, notes)
    sequence.poses = posed.poses
    if sequence.poses is not None:
        sequence.poses.flags.writeable = False
    return rectified(sequence, (camera.lens,))


def _recognise(path: Path) -> bool:
    suffix = path.suffix.lower()
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and bool(_files(path))
    if is_ros1_bag(path):
        return True
    if suffix == ".db3":
        return path.is_file()
    if suffix != ".mcap" or not path.is_file():
        return False
    try:
        return any(kind in _IMAGES for kind in topics_of(path).values())
    except MissingExtra:
        return False  # opened as a recording of contacts, it reports the missing library


KIND: Final = depth_kind(
    "ros-bag",
    "ROS bag with depth, camera_info and tf: a folder with metadata.yaml, .mcap or .db3 (extra: mcap), or a "
    ".bag of ROS 1 or RealSense (extra: ros1)",
    _recognise,
    read_bag,
)
