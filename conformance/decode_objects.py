"""Decodes coder `objects` (moving bodies) for the conformance decoder, step by step as docs/format/objects.md
says, in Python and numpy. `decoder.py` calls it.
"""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import decode_paper
import decode_touch
import numpy as np
from reading import Array, Cursor, UnsupportedVersion, laid_out, need
from support import numbers
from touch_bits import Bits

CHECKS: dict[str, Any] = {"paper": decode_paper.check_parameters, "touch": decode_touch.is_exact}
CODERS: dict[str, Any] = {"paper": decode_paper.decode_segment, "touch": decode_touch.decode_segment}


@dataclass
class Body:
    """One body: its OBJT, its fields, dense float32 [nx, ny, nz, 3], and its poses in steps, int64 [7] a
    frame.
    """

    record: dict[str, Any]
    position_step_m: float
    turns_of_1: int
    forces_n: list[Array] = field(default_factory=list)
    numbers: list[Array] = field(default_factory=list)

    @property
    def positions_m(self) -> Array:
        """t of each frame, float64 [n, 3]."""
        return np.array(self.numbers)[:, :3] * self.position_step_m

    @property
    def quaternions(self) -> Array:
        """Unit quaternions of each frame, float64 [n, 4]."""
        return decode_paper.unit(np.array(self.numbers)[:, 3:])

    def add_fields(self, coded: bytes, count: int) -> None:
        """The frames of a segment of the field coder."""
        shape, coder = self.record["grid_shape"], self.record["field_coder"]
        frames = CODERS[coder](coded, self.record["field_parameters"], shape, count)
        self.forces_n += [laid_out(bricks, shape) for bricks in frames]


@dataclass
class Scene:
    """A decoded file; `max_errors` has (ratio, frame in the segment, voxel) of each segment, or None."""

    head: dict[str, Any]
    surface_damping: float
    place_tolerance_m: float
    bodies: list[Body]
    max_errors: list[tuple[float, int, tuple[int, ...]] | None] = field(default_factory=list)

    def forces_n(self, frame: int, points_m: Array) -> Array:
        """Forces at points [n, 3], float64 [n, 3]."""
        total, most = np.zeros(points_m.shape), self.head["force_max_n"]
        for body in self.bodies:
            rotation, position = rotation_of(body.quaternions[frame]), body.positions_m[frame]
            own = interpolated(body, frame, (points_m - position) @ rotation)
            total += own @ rotation.T
            if self.surface_damping > 0:
                velocity, spin = motion(body, frame, self.head["rate_hz"])
                felt = np.linalg.norm(own, axis=1, keepdims=True) > 1e-9 * most
                total += felt * self.surface_damping * (velocity + np.cross(spin, points_m - position))
        return np.asarray(total * most / np.maximum(most, np.linalg.norm(total, axis=1, keepdims=True)))


def decode_forces(file: Any) -> Iterator[Array]:
    """Forces at the points of the file's grid, float32 [nx, ny, nz, 3] a frame."""
    scene, head = decode_scene(file.head, file.objects, file.segments), file.head
    index = np.moveaxis(np.indices(head["grid_shape"]), 0, -1).reshape(-1, 3)
    points_m = np.array(head["origin_m"]) + index * np.array(head["spacing_m"])
    for i in range(head["frame_count"]):
        yield scene.forces_n(i, points_m).astype(np.float32).reshape(*head["grid_shape"], 3)


def decode_scene(head: dict[str, Any], objects: list[dict[str, Any]], segments: list[Any]) -> Scene:
    """All bodies of a file, of its HEAD and each OBJT as dicts of their fields."""
    need(len(head["coder_parameters"]) == 20, "the parameters of the coder objects")
    count, damping, tolerance_m = struct.unpack("<Idd", head["coder_parameters"])
    need(count == len(objects), f"{len(objects)} OBJT where {count} are stated")
    need(0 <= damping < math.inf and 0 <= tolerance_m < math.inf, "the parameters of the coder objects")
    need(count * head["frame_count"] <= 1 << 24, "too many poses")
    scene = Scene(head, damping, tolerance_m, [])
    for record in objects:
        need(
            record["field_coder"] in CODERS,
            f"the coder of fields {record['field_coder']!r}",
            UnsupportedVersion,
        )
        CHECKS[record["field_coder"]](record["field_parameters"])
        need(len(record["pose_steps"]) == 2, "the steps of the poses")
        position, turn = struct.unpack("bb", record["pose_steps"])
        need(-40 <= position <= 0 and -30 <= turn <= -2, "the steps of the poses")
        scene.bodies.append(body := Body(record, 2.0**position, 1 << -turn))
        need(not (record["is_deforming"] and record["field"]), "a field of a body that deforms")
        if not record["is_deforming"]:
            body.add_fields(record["field"], 1)
    for segment in segments:
        c = Cursor(segment.body)
        scene.max_errors.append(max_error_of(c, segment.frame_count))
        chunks = [(c.chunk(), c.chunk() if body.record["is_deforming"] else b"") for body in scene.bodies]
        c.end()
        for body, (poses, _) in zip(scene.bodies, chunks):
            body.numbers += list(pose_numbers(poses, segment.frame_count, body.turns_of_1))
        for body, (_, fields) in zip(scene.bodies, chunks):
            if body.record["is_deforming"]:
                body.add_fields(fields, segment.frame_count)
    return scene


def max_error_of(c: Cursor, frame_count: int) -> tuple[float, int, tuple[int, ...]] | None:
    """The largest error of a segment."""
    ratio = c.varint(65537)
    return (
        ((ratio - 1) / 65535, c.varint(frame_count), tuple(c.varint(1 << 20) for _ in range(3)))
        if ratio
        else None
    )


def pose_numbers(data: bytes, count: int, one: int) -> Array:
    """Poses in steps, int64 [count, 7]; `one` is how many steps of a quaternion make 1."""
    bits = Bits(data)
    head = numbers(bits, 14)
    bits.need(all(0 <= order <= 3 for order in head[:7]), "a predictor that there is not")
    poses = np.zeros((count, 7), object)  # of any size
    for c, order in enumerate(head[:7]):
        if order:
            poses[1:, c] = numbers(bits, count - 1, str(c))
        for _ in range(order):
            poses[:, c] = np.cumsum(poses[:, c])
        poses[:, c] += head[7 + c]
    bits.end(0)
    need(
        (abs(poses[:, :3]) <= 1 << 50).all() and (abs(poses[:, 3:]) <= one).all(), "a number beyond its limit"
    )
    squares = (poses[:, 3:] ** 2).sum(axis=1)
    need(
        ((one - 1) ** 2 <= squares).all() and (squares <= (one + 1) ** 2).all(),
        "a quaternion that is not unit",
    )
    return poses.astype(np.int64)


def rotation_of(quaternion: Array) -> Array:
    """R of a unit quaternion (w, x, y, z)."""
    w, cross = quaternion[0], np.cross(np.eye(3), quaternion[1:])
    return np.asarray(np.eye(3) + 2 * (w * cross + cross @ cross))


def interpolated(body: Body, frame: int, points_m: Array) -> Array:
    """The body's field at points of its own frame, float64 [n, 3]."""
    forces = body.forces_n[frame if body.record["is_deforming"] else 0]
    padded = np.pad(forces.astype(np.float64), [(1, 1), (1, 1), (1, 1), (0, 0)])
    index = (points_m - body.record["origin_m"]) / body.record["spacing_m"] + 1
    low = np.floor(index).astype(np.int64)
    inside = ((low >= 0) & (low + 1 < np.array(padded.shape[:3]))).all(axis=1)
    out, low, fraction = np.zeros(points_m.shape), low[inside], (index - low)[inside]
    for corner in product((0, 1), repeat=3):
        weight = np.prod(np.where(corner, fraction, 1 - fraction), axis=1)
        i, j, k = (low + corner).T
        out[inside] += weight[:, None] * padded[i, j, k]
    return out


def motion(body: Body, frame: int, rate_hz: float) -> tuple[Array, Array]:
    """Velocity of the body's origin, m/s, and angular velocity, rad/s."""
    positions, quaternions = body.positions_m, body.quaternions
    i1, i0 = min(frame + 1, len(positions) - 1), max(frame - 1, 0)
    if i1 == i0:
        return np.zeros(3), np.zeros(3)
    seconds = (i1 - i0) / rate_hz
    (aw, *a), (bw, *b) = quaternions[i1].tolist(), quaternions[i0].tolist()
    w, u = aw * bw + np.dot(a, b), bw * np.array(a) - aw * np.array(b) - np.cross(a, b)
    w, u = (-w, -u) if w < 0 else (w, u)
    sine = float(np.linalg.norm(u))
    spin = u / sine * 2 * math.atan2(sine, w) / seconds if sine > 0 else np.zeros(3)
    return (positions[i1] - positions[i0]) / seconds, spin
