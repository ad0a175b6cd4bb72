"""Writes the log of a playback as MCAP, the container of robotics recordings (extra: mcap), for Foxglove and
other programs that read it.

Messages are JSON with the schemas that Foxglove documents for a pose and for a scene, and one of our own for
what those do not hold. All vectors are in the axes of the field, frame "field"; forces and torques are those
on the hand. Times are those of the log: nanoseconds since the first tick.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield._version import __version__
from touchfield.arrays import Bools, Float64s
from touchfield.atomic import atomic_path
from touchfield.errors import import_extra, require_ending
from touchfield.tasks.mcap_schemas import ARROW_TOPIC, POSE_TOPIC, PRIMITIVES, SCHEMAS, TICK_TOPIC
from touchfield.tasks.play_log import ROWS_AT_ONCE, state_texts

FRAME: Final = "field"
ARROWS_HZ: Final = 60.0
"""Arrows of a second, at most: as many as a screen shows."""

ARROW_M_PER_N: Final = 0.01

_CHUNK_BYTES: Final = 1 << 20  # what a reader decompresses for one message, and what the writer keeps
_NS: Final = 1_000_000_000


def is_mcap(path: Path) -> bool:
    """Return True if a path names an MCAP file."""
    return path.suffix.lower() == ".mcap"


def require_log(path: Path) -> None:
    """Raise `InvalidArgument` if a path is neither CSV nor MCAP, `MissingExtra` if it needs the library."""
    require_ending(path, "LOG.csv", "LOG.mcap")
    if is_mcap(path):
        require_mcap(path)


def require_mcap(path: Path) -> Any:
    """Return the module that writes MCAP; raises `MissingExtra` if the library is not installed."""
    return import_extra("mcap.writer", str(path), "mcap", "mcap")


def write_mcap(path: Path, rows: NDArray[Any], device_to_field: Float64s) -> tuple[str, ...]:
    """Write ticks as an MCAP file, atomically; return a note if some are not in it.

    rows : `touchfield.render.block.COLUMNS` [n]
    device_to_field : float64 [3, 3]; a signed permutation, which may mirror

    Raises `MissingExtra` if the library mcap is not installed, `InvalidArgument` or `SourceError` if the file
    cannot be written.
    """
    library = require_mcap(path)
    omitted = 0
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        writer = library.Writer(file, chunk_size=_CHUNK_BYTES)
        writer.start(profile="", library=f"touchfield {__version__}")
        channels = _register_channels(writer)
        next_arrow_ns = 0
        for ticks in _chunks(rows, device_to_field):
            omitted += ticks.omitted
            for time_ns, pose, tick, arrow in zip(ticks.times_ns, ticks.poses, ticks.ticks, ticks.arrows):
                sec, nsec = divmod(time_ns, _NS)
                stamp = f'{{"timestamp":{{"sec":{sec},"nsec":{nsec}}}'
                _add(writer, channels[POSE_TOPIC], time_ns, stamp + _POSE % pose)
                _add(writer, channels[TICK_TOPIC], time_ns, stamp + _TICK % tick)
                if time_ns >= next_arrow_ns:
                    next_arrow_ns = time_ns + round(_NS / ARROWS_HZ)
                    _add(writer, channels[ARROW_TOPIC], time_ns, _arrow_message(stamp, arrow))
        writer.finish()
    if not omitted:
        return ()
    return (f"{omitted} ticks are not in {path}: the device reported a number that is not finite.",)


def _register_channels(writer: Any) -> dict[str, int]:
    """Return the number of the channel of each topic."""
    return {
        topic: writer.register_channel(
            topic,
            "json",
            writer.register_schema(schema["title"], "jsonschema", json.dumps(schema).encode()),
        )
        for topic, schema in SCHEMAS.items()
    }


def _add(writer: Any, channel: int, time_ns: int, message: str) -> None:
    writer.add_message(channel, time_ns, message.encode(), time_ns)


# -- ticks in the axes of the field ------------------------------------------------------------------------


class _Ticks(NamedTuple):
    """Some ticks as the values of their messages; `omitted` counts those of which a number is not finite."""

    times_ns: list[int]
    poses: list[tuple[float, ...]]
    ticks: list[tuple[Any, ...]]
    arrows: NDArray[Any]
    omitted: int


def _chunks(rows: NDArray[Any], device_to_field: Float64s) -> Iterator[_Ticks]:
    """Yield the values of all ticks, a limited number at a time."""
    rotation_axes = np.linalg.det(device_to_field) * device_to_field  # a mirror reverses them
    texts = state_texts(np.unique(rows["flags"]).tolist())
    for first in range(0, len(rows), ROWS_AT_ONCE):
        chunk = rows[first : first + ROWS_AT_ONCE]
        ticks = chunk[_is_finite(chunk)]
        force_n, torque_nm = ticks["force_n"] @ device_to_field.T, ticks["torque_nm"] @ rotation_axes.T
        axis, w = ticks["orientation"][:, 1:] @ rotation_axes.T, ticks["orientation"][:, :1]
        poses = np.column_stack([ticks["position_m"], axis, w]) + 0.0  # without -0
        field_torque_nm = ticks["field_torque_nm"] @ rotation_axes.T
        numbers = np.column_stack([
            ticks["field_force_n"], field_torque_nm, ticks["friction_n"], force_n, torque_nm,
            ticks["velocity_m_s"], ticks["gripper_m"], ticks["media_s"],
        ]) + 0.0  # fmt: skip
        states = [texts[flags] for flags in ticks["flags"].tolist()]
        yield _Ticks(
            np.rint(ticks["time_s"] * _NS).astype(np.int64).tolist(),
            [tuple(row) for row in poses.tolist()],
            [(*row, b, state) for row, b, state in zip(numbers.tolist(), ticks["buttons"].tolist(), states)],
            np.column_stack([ticks["position_m"], force_n]),
            len(chunk) - len(ticks),
        )


def _is_finite(rows: NDArray[Any]) -> Bools:
    """Return whether all numbers of each row are finite, bool [n]: JSON has no others."""
    names = [name for name in rows.dtype.names or () if rows.dtype[name].base.kind == "f"]
    numbers = np.column_stack([rows[name].reshape(len(rows), -1) for name in names])
    is_finite: Bools = np.isfinite(numbers).all(axis=1)
    return is_finite


# -- messages ----------------------------------------------------------------------------------------------

_VECTOR: Final = '{"x":%.9g,"y":%.9g,"z":%.9g}'
_POSE: Final = (
    f',"frame_id":"{FRAME}","pose":{{"position":{_VECTOR},'
    '"orientation":{"x":%.9g,"y":%.9g,"z":%.9g,"w":%.9g}}}'
)
_WRENCH: Final = f'{{"force":{_VECTOR},"torque":{_VECTOR}}}'
_TICK: Final = (
    f',"frame_id":"{FRAME}","field":{_WRENCH},"friction":{_VECTOR},"device":{_WRENCH},"velocity":{_VECTOR},'
    '"gripper_m":%.9g,"media_s":%.9g,"buttons":%d,"state":"%s"}'
)


def _arrow_message(stamp: str, arrow: NDArray[Any]) -> str:
    """Return the scene of a tick: the force that the device got, as an arrow from the hand.

    arrow : float64 [6]; position, metres, and force, newtons
    """
    force_n = float(np.linalg.norm(arrow[3:]))
    entity = {
        **json.loads(stamp + "}"),
        "frame_id": FRAME,
        "id": "force",
        "lifetime": {"sec": 0, "nsec": 0},  # until the next
        "frame_locked": True,
        "metadata": [],
        "arrows": [_arrow(arrow[:3], arrow[3:] / force_n, force_n)] if force_n else [],
        **{name: [] for name in PRIMITIVES},
    }
    return json.dumps({"deletions": [], "entities": [entity]})


def _arrow(tail_m: Float64s, direction: Float64s, force_n: float) -> dict[str, Any]:
    """Return an arrow, which points along x before it is rotated."""
    x, y, z = direction.tolist()
    w = math.sqrt((1 + x) / 2)
    quaternion = (0.0, -z / (2 * w), y / (2 * w), w) if w > 1e-6 else (0.0, 0.0, 1.0, 0.0)
    length_m = ARROW_M_PER_N * force_n
    return {
        "pose": {
            "position": dict(zip("xyz", tail_m.tolist())),
            "orientation": dict(zip("xyzw", quaternion)),
        },
        "shaft_length": 0.8 * length_m,
        "shaft_diameter": 0.0015,
        "head_length": 0.2 * length_m,
        "head_diameter": 0.003,
        "color": {"r": 0.85, "g": 0.3, "b": 0.1, "a": 1.0},
    }
