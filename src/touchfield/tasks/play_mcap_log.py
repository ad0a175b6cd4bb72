"""Reads the log of a playback that `touchfield.tasks.play_mcap` wrote (extra: mcap)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError, import_extra
from touchfield.files import library_faults, readable, require_plain
from touchfield.sources.recordings.mcap_chunks import require_distinct_chunks
from touchfield.tasks.mcap_schemas import POSE_TOPIC, TICK_TOPIC
from touchfield.tasks.play_log import MAX_ROWS

_EXPECTED: Final = "a log of `touchfield play --log OUT.mcap`"


def read_mcap_log(path: Path) -> Float64s:
    """Read a log of ``play``, float64 [n, 7], with the columns of `touchfield.tasks.play_log.read_log`.

    The pose and the tick of the same time make a row. Raises `MissingExtra` if the library mcap is not
    installed; `SourceError` if the file is no such log, or has more than `MAX_ROWS` ticks.
    """
    reader = import_extra("mcap.reader", str(path), "mcap", "mcap")
    require_plain(path, _EXPECTED)
    poses: dict[int, list[float]] = {}
    ticks: dict[int, list[float]] = {}
    with (
        readable(path, _EXPECTED),
        path.open("rb") as file,
        library_faults(path, "no sound MCAP", _EXPECTED, "Copy it again."),
    ):
        messages = reader.make_reader(file)
        require_distinct_chunks(messages.get_summary(), str(path))
        for _, channel, message in messages.iter_messages(topics=[POSE_TOPIC, TICK_TOPIC]):
            is_pose = channel.topic == POSE_TOPIC
            rows, values_of = (poses, _position) if is_pose else (ticks, _tick)
            rows[message.log_time] = _values(message.data, values_of, f"{path}: {channel.topic}")
            if len(rows) > MAX_ROWS:
                raise SourceError(str(path), f"more than {MAX_ROWS:,} ticks", "at most that")
    times = sorted(poses.keys() & ticks.keys())
    found = np.array([[ticks[t][0], *poses[t], *ticks[t][1:]] for t in times], np.float64)
    found = found[np.isfinite(found).all(axis=1)] if len(found) else found
    if not len(found):
        raise SourceError(str(path), f"no tick with {POSE_TOPIC} and {TICK_TOPIC}", _EXPECTED)
    return found


def _values(data: bytes, values_of: Any, where: str) -> list[float]:
    try:
        return [float(value) for value in values_of(json.loads(data))]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise SourceError(where, f"a message that is no tick ({error!r:.80})", _EXPECTED) from None


def _position(message: Any) -> list[Any]:
    position = message["pose"]["position"]
    return [position[axis] for axis in "xyz"]


def _tick(message: Any) -> list[Any]:
    """Return the time of the medium, and the force of the field with friction."""
    force, friction = message["field"]["force"], message["friction"]
    return [message["media_s"], *(force[axis] + friction[axis] for axis in "xyz")]
