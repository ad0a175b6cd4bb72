"""The part of the second decoder for coder `objects`: docs/format/objects.md, step by step, in Python and numpy."""

import math
import struct
from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import decode_paper
import decode_touch
import numpy as np
from reading import Array, Cursor, UnsupportedVersion, laid_out, need
from support import numbers
from touch_bits import Bits

CODERS: dict[str, Any] = {"paper": decode_paper.decode_segment, "touch": decode_touch.decode_segment}


class Body(NamedTuple):
    """A body: its OBJT, the steps of its poses, its fields, float32 [nx, ny, nz, 3], and poses, int64 [7]."""

    told: dict[str, Any]
    position_step_m: float
    turns_of_1: int
    fields_n: list[Array]
    poses: list[Array]

    def add_fields(self, coded: bytes, count: int) -> None:
        """The frames of a segment of the field coder."""
        shape, coder = self.told["grid_shape"], self.told["field_coder"]
        need(coder in CODERS, f"the coder of fields {coder!r}", UnsupportedVersion)
        frames = CODERS[coder](coded, self.told["field_parameters"], shape, count)
        self.fields_n.extend(laid_out(bricks, shape) for bricks in frames)

    def pose(self, frame: int) -> tuple[Array, Array]:
        """Its position in metres and its unit quaternion."""
        return self.poses[frame][:3] * self.position_step_m, decode_paper.unit(self.poses[frame][3:])


def decode_forces(file: Any) -> Iterator[Array]:
    """Forces at the points of the file's grid, float32 [nx, ny, nz, 3] a frame."""
    head, parameters = file.head, file.head["coder_parameters"]
    need(len(parameters) == 20, "the parameters of the coder objects")
    count, damping, tolerance_m = struct.unpack("<Idd", parameters)
    need(count == len(file.objects), f"{len(file.objects)} OBJT where {count} are told")
    need(0 <= damping < math.inf and 0 <= tolerance_m < math.inf, "the parameters of the coder objects")
    need(count * head["frame_count"] <= 1 << 24, "too many poses")
    bodies, most = decode_bodies(file), head["force_max_n"]
    index = np.moveaxis(np.indices(head["grid_shape"]), 0, -1).reshape(-1, 3)
    points_m = np.array(head["origin_m"]) + index * np.array(head["spacing_m"])
    for i in range(head["frame_count"]):
        total = np.zeros(points_m.shape)
        for body in bodies:
            position_m, quaternion = body.pose(i)
            rotation = rotation_of(quaternion)
            own = interpolated(body, i, (points_m - position_m) @ rotation)
            velocity, spin = motion(body, i, head["rate_hz"])
            felt = np.linalg.norm(own, axis=1, keepdims=True) > 1e-9 * most
            total += own @ rotation.T + felt * damping * (velocity + np.cross(spin, points_m - position_m))
        total *= most / np.maximum(most, np.linalg.norm(total, axis=1, keepdims=True))
        yield total.astype(np.float32).reshape(*head["grid_shape"], 3)


def decode_bodies(file: Any) -> list[Body]:
    """All bodies of a file, with all their frames."""
    bodies = []
    for told in file.objects:
        need(len(told["pose_steps"]) == 2, "the steps of the poses")
        position, turn = struct.unpack("bb", told["pose_steps"])
        need(-40 <= position <= 0 and -30 <= turn <= -2, "the steps of the poses")
        need(not (told["is_deforming"] and told["field"]), "a field of a body that deforms")
        bodies.append(body := Body(told, 2.0**position, 1 << -turn, [], []))
        if not told["is_deforming"]:
            body.add_fields(told["field"], 1)
    for segment in file.segments:
        c = Cursor(segment.body)
        if c.varint(65537):  # the worst voxel
            for limit in (segment.frame_count, 1 << 20, 1 << 20, 1 << 20):
                c.varint(limit)
        for body in bodies:
            body.poses.extend(pose_numbers(c.chunk(), segment.frame_count, body.turns_of_1))
            if body.told["is_deforming"]:
                body.add_fields(c.chunk(), segment.frame_count)
        c.end()
    return bodies


def pose_numbers(data: bytes, count: int, one: int) -> Array:
    """Poses in steps, int64 [count, 7]; `one` is how many steps of a quaternion make 1."""
    bits = Bits(data)
    head = numbers(bits, 14)
    need(all(0 <= order <= 3 for order in head[:7]), "a predictor that there is not")
    poses = np.zeros((count, 7), object)  # of any size
    for c, order in enumerate(head[:7]):
        if order:
            poses[1:, c] = numbers(bits, count - 1, str(c))
        for _ in range(order):
            poses[:, c] = np.cumsum(poses[:, c])
        poses[:, c] += head[7 + c]
    bits.end(0)
    need((abs(poses[:, :3]) <= 1 << 50).all() and (abs(poses[:, 3:]) <= one).all(), "a number beyond its limit")
    squares = (poses[:, 3:] ** 2).sum(axis=1)
    need(((one - 1) ** 2 <= squares).all() and (squares <= (one + 1) ** 2).all(), "a quaternion that is not unit")
    return poses.astype(np.int64)


def rotation_of(quaternion: Array) -> Array:
    """R of a unit quaternion (w, x, y, z)."""
    w, cross = quaternion[0], np.cross(np.eye(3), quaternion[1:])
    return np.asarray(np.eye(3) + 2 * (w * cross + cross @ cross))


def interpolated(body: Body, frame: int, points_m: Array) -> Array:
    """The body's field at points of its own frame, float64 [n, 3]."""
    forces = body.fields_n[frame if body.told["is_deforming"] else 0]
    padded = np.pad(forces.astype(np.float64), [(1, 1), (1, 1), (1, 1), (0, 0)])
    index = (points_m - body.told["origin_m"]) / body.told["spacing_m"] + 1
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
    i1, i0 = min(frame + 1, len(body.poses) - 1), max(frame - 1, 0)
    if i1 == i0:
        return np.zeros(3), np.zeros(3)
    seconds = (i1 - i0) / rate_hz
    (place_1, (aw, *a)), (place_0, (bw, *b)) = body.pose(i1), body.pose(i0)
    w, u = aw * bw + np.dot(a, b), bw * np.array(a) - aw * np.array(b) - np.cross(a, b)
    w, u = (-w, -u) if w < 0 else (w, u)
    sine = float(np.linalg.norm(u))
    spin = u / sine * 2 * math.atan2(sine, w) / seconds if sine > 0 else np.zeros(3)
    return (place_1 - place_0) / seconds, spin
