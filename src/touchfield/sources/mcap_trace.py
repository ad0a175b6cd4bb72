"""Positions and forces from MCAP, the container of robotics recordings (extra: mcap).

Messages are JSON, or CDR of ROS 2 with the schemas of geometry_msgs for a stamped pose, point, transform and wrench.
The first channel that tells positions and the first that tells forces are taken, by the times of the log; the place
of a force is interpolated between its neighbours.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import MissingExtra, SourceError
from touchfield.files import require_plain
from touchfield.medium.trace import MAX_SAMPLES, ContactTrace

if TYPE_CHECKING:
    Triple = tuple[float, float, float]

__all__ = ["read_mcap"]

_POSITIONS: Final = ("pose.position", "position", "point", "transform.translation", "translation")
_FORCES: Final = ("wrench.force", "force")
_CDR: Final = {"PoseStamped": 0, "PointStamped": 0, "TransformStamped": 0, "WrenchStamped": 1}
"""Schemas of geometry_msgs -> 0 for a position, 1 for a force."""

_WHAT: Final = "an MCAP file of positions and forces"


def read_mcap(path: Path) -> ContactTrace:
    """The contacts in an ``.mcap`` file.

    Raises `MissingExtra` if the library mcap is not installed; `SourceError` if the file cannot be read, a message
    is damaged, or there are no positions or no forces.
    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
    except ImportError as error:
        raise MissingExtra(str(path), "mcap", "mcap") from error
    require_plain(path, _WHAT)
    told: tuple[dict[int, list[tuple[float, ...]]], ...] = ({}, {})
    names: dict[str, None] = {}
    count = 0
    try:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                name = schema.name if schema is not None else ""
                names[f"{channel.topic} ({name}, {channel.message_encoding})"] = None
                for kind, values in _told(name, channel.message_encoding, message.data, f"{path}: {channel.topic}"):
                    told[kind].setdefault(channel.id, []).append((message.log_time / 1e9, *values))
                    count += 1
                if count > 2 * MAX_SAMPLES:
                    raise SourceError(str(path), f"more than {2 * MAX_SAMPLES} messages", _WHAT, "Cut it in parts.")
    except OSError as error:
        raise SourceError(str(path), error.strerror or str(error), _WHAT, "Check path and rights.") from error
    except (McapError, struct.error, EOFError, KeyError, RuntimeError, ValueError) as error:
        raise SourceError(str(path), f"no sound MCAP ({error})", _WHAT) from error
    for rows, what in zip(told, ("positions", "forces")):
        if not rows:
            shown = ", ".join(list(names)[:6]) or "no message"
            expected = f"{what}: JSON, or CDR of geometry_msgs ({', '.join(_CDR)})"
            raise SourceError(str(path), f"no {what} in {shown}", expected)
    positions, forces = (np.array(next(iter(rows.values()))) for rows in told)
    positions, forces = (rows[np.argsort(rows[:, 0], kind="stable")] for rows in (positions, forces))
    if not (np.isfinite(positions).all() and np.isfinite(forces).all()):
        raise SourceError(str(path), "a number that is not finite", "finite metres and newtons")
    seen = (forces[:, 0] >= positions[0, 0]) & (forces[:, 0] <= positions[-1, 0])
    if not seen.any():
        raise SourceError(str(path), "forces at other times than positions", "both at the same times")
    forces = forces[seen]
    places = np.stack([np.interp(forces[:, 0], positions[:, 0], of) for of in positions[:, 1:].T], axis=1)
    return ContactTrace(places, forces[:, 1:])


def _told(name: str, encoding: str, data: bytes, where: str) -> list[tuple[int, Triple]]:
    """Contents of a message: 0 and a position, 1 and a force."""
    kind = name.rpartition("/")[2]
    if encoding == "cdr":
        return [(_CDR[kind], _cdr(data, kind, where))] if kind in _CDR else []
    if encoding != "json":
        return []
    try:
        value = json.loads(data)
    except ValueError as error:
        raise SourceError(where, f"no JSON ({error})", "a JSON message") from None
    found = []
    for nth, paths in enumerate((_POSITIONS, _FORCES)):
        triple = next((t for t in (_triple(value, keys) for keys in paths) if t is not None), None)
        if triple is not None:
            found.append((nth, triple))
    return found


def _triple(value: Any, keys: str) -> Triple | None:
    for key in keys.split("."):
        if not isinstance(value, dict) or key not in value:
            return None
        value = value[key]
    if not isinstance(value, dict) or not all(type(value.get(axis)) in (int, float) for axis in "xyz"):
        return None
    return float(value["x"]), float(value["y"]), float(value["z"])


def _cdr(data: bytes, kind: str, where: str) -> Triple:
    """Three doubles behind a header: stamp, name of the frame (of a transform, of both)."""
    order = "<" if data[1:2] == b"\x01" else ">"
    body, at = data[4:], 8
    for _ in range(2 if kind == "TransformStamped" else 1):
        at += -at % 4
        (length,) = struct.unpack_from(order + "I", body, at)
        at += 4 + length
    at += -at % 8
    if at + 24 > len(body):
        raise SourceError(where, f"a message of {len(data)} bytes", f"a {kind} of at least {at + 28}")
    x, y, z = struct.unpack_from(order + "3d", body, at)
    return x, y, z
