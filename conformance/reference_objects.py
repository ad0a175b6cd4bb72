"""The part of the second decoder for files of coder `objects`: poses, fields in motion, and their forces at points.

It follows docs/format.md as `reference_decoder` does, of which it takes the container and the coder `paper`.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from reference_decoder import (
    Array,
    Coder,
    Cursor,
    Models,
    decode_segment,
    laid_out,
    need,
    read_file,
)

__all__ = ["decode_poses", "decode_scene", "pose_numbers"]


@dataclass
class Body:
    """One object: its lattice, its fields, and its poses in all frames."""

    name: str
    shape: tuple[int, int, int]
    spacing_m: Array
    origin_m: Array
    is_deforming: bool
    field_parameters: bytes
    steps: tuple[float, float]
    forces_n: list[Array] = field(default_factory=list)
    """Dense float32 [nx, ny, nz, 3]: one, or one for each frame."""
    numbers: list[Array] = field(default_factory=list)
    """Poses in steps, int64 [7]: position x, y, z, quaternion w, x, y, z."""

    @property
    def positions_m(self) -> Array:
        """t of each frame, float64 [n, 3]."""
        return np.array(self.numbers)[:, :3] * self.steps[0]

    @property
    def quaternions(self) -> Array:
        """Unit quaternions of each frame, float64 [n, 4]."""
        turns = np.array(self.numbers)[:, 3:] * self.steps[1]
        unit: Array = turns / np.sqrt((turns * turns).sum(axis=1, keepdims=True))
        return unit


@dataclass
class Scene:
    """A decoded file."""

    head: dict[str, Any]
    surface_damping: float
    bodies: list[Body]

    def forces_n(self, frame: int, points_m: Array) -> Array:
        """Forces at points [n, 3], float64 [n, 3]."""
        total = np.zeros(points_m.shape)
        for body in self.bodies:
            rotation, position = rotation_of(body.quaternions[frame]), body.positions_m[frame]
            own = interpolated(body, frame, (points_m - position) @ rotation)
            total += own @ rotation.T
            if self.surface_damping > 0:
                velocity, spin = motion(body, frame, self.head["rate_hz"])
                length = np.sqrt((own * own).sum(axis=1, keepdims=True))
                felt = length > 1e-9 * self.head["force_max_n"]
                total += felt * self.surface_damping * (velocity + np.cross(spin, points_m - position))
        length = np.sqrt((total * total).sum(axis=1, keepdims=True))
        clipped: Array = total * np.minimum(1.0, self.head["force_max_n"] / np.where(length > 0, length, 1.0))
        return clipped

    def voxels(self) -> Array:
        """Forces at the points of the file's grid, float32 [frame, nx, ny, nz, 3]."""
        shape = self.head["shape"]
        index = np.moveaxis(np.indices(shape), 0, -1).reshape(-1, 3)
        points_m = np.array(self.head["origin_m"]) + index * np.array(self.head["spacing_m"])
        frames = [self.forces_n(i, points_m).astype(np.float32) for i in range(self.head["frame_count"])]
        return np.stack(frames).reshape(len(frames), *shape, 3)


# -- poses ------------------------------------------------------------------------------------------------

LARGEST = 1 << 50


def pose_numbers(data: bytes, count: int, one: int) -> Array:
    """Poses in steps, int64 [count, 7]; `one` is how many steps of a quaternion make 1."""
    coder = Coder(data)
    models = Models(coder)
    limits = [LARGEST] * 3 + [one] * 4

    def raw(bits: int) -> int:
        value = 0
        for _ in range(bits):
            value = value << 1 | coder.bit(32768)
        return value

    def first_value() -> int:
        if not raw(1):
            return 0
        below = raw(6)
        need(below <= 54, "a first value beyond its limit")
        size = 1 << below | raw(below)
        return -size if raw(1) else size

    def residual(a: int, b: int) -> int:
        def bit(node: int) -> int:
            return models.mixed(32 * a + node, 32 * b + node, node)

        if not bit(0):
            return 0
        negative = bit(1)
        length = 1
        while length <= 54 and bit(1 + min(length, 14)):
            length += 1
        need(length <= 54, "a residual beyond its limit")
        size = 1
        if length > 1:
            size = 2 | bit(16 + min(length, 15))
        if length > 2:
            size = size << (length - 2) | raw(length - 2)
        return -size if negative else size

    orders = [raw(2) for _ in range(7)]
    columns = [[first_value()] for _ in range(7)]
    need(all(abs(column[0]) <= limit for column, limit in zip(columns, limits)), "a first value beyond its limit")
    past = [[0, 0, 0] for _ in range(7)]
    for _ in range(1, count):
        for c, values in enumerate(columns):
            if orders[c] == 0:
                values.append(values[0])
                continue
            x1, x2, x3 = (values[max(len(values) - back, 0)] for back in (1, 2, 3))
            predicted = (x1, 2 * x1 - x2, 3 * (x1 - x2) + x3)[orders[c] - 1]
            r1, r2, r3 = past[c]
            near = 25 * (near_zero(r1) + 2) + 5 * (near_zero(r2) + 2) + near_zero(r3) + 2
            sizes = 7 * (21 * c + sized(r1, 10) + 10) + sized(r2, 3) + 3
            r = residual(125 * (c > 2) + near, sizes)
            values.append(predicted + r)
            need(abs(values[-1]) <= limits[c], "a number beyond its limit")
            past[c] = [r, r1, r2]
    need(data == data[: coder.used] + coder.ending(), "the end of the poses")
    return np.array(columns, np.int64).T


def near_zero(r: int) -> int:
    """A residual, but at most 2 and at least -2."""
    return min(max(r, -2), 2)


def sized(r: int, most: int) -> int:
    """The length of a residual in bits, `most` at most, with its sign."""
    bits = min(abs(r).bit_length(), most)
    return -bits if r < 0 else bits


def decode_poses(data: bytes, count: int, one: int) -> list[Array]:
    """The poses of a segment in steps, each int64 [7]."""
    numbers = pose_numbers(data, count, one)
    squares = (numbers[:, 3:] ** 2).sum(axis=1)
    need(((one - 1) ** 2 <= squares).all() and (squares <= (one + 1) ** 2).all(), "a quaternion that is not unit")
    return list(numbers)


# -- the file ---------------------------------------------------------------------------------------------


def read_object(payload: bytes) -> tuple[Body, bytes]:
    """An object without poses, and the bytes of its field."""
    c = Cursor(payload)
    name = c.text(256)
    shape, spacing_m, origin_m = c.numbers("3I"), c.numbers("3d"), c.numbers("3d")
    need(all(1 <= n <= 1 << 20 for n in shape) and all(h > 0 for h in spacing_m), "the grid of OBJT")
    is_deforming = c.number("B")
    coder, parameters, steps = c.text(32, 1), c.octets(1 << 16), c.octets(64)
    need(is_deforming <= 1 and coder == "paper" and len(steps) == 2, "the fields of OBJT")
    powers = struct.unpack("bb", steps)
    need(-40 <= powers[0] <= 0 and -30 <= powers[1] <= -2, "the steps of the poses")
    coded = payload[c.at :]
    need(not (is_deforming and coded), "a field of an object that deforms")
    field_parameters = parameters
    own_steps = (2.0 ** powers[0], 2.0 ** powers[1])
    body = Body(name, shape, np.array(spacing_m), np.array(origin_m), bool(is_deforming), field_parameters, own_steps)
    return body, coded


def decode_scene(data: bytes) -> Scene:
    """All objects of a file.

    Raises
    ------
    ValueError
        If the file is not what docs/format.md describes.
    """
    head, segments = read_file(data)
    need(head["coder"] == "objects" and len(head["parameters"]) == 12, "the parameters of the coder objects")
    count, damping = struct.unpack("<Id", head["parameters"])
    need(count == len(head["objects"]) and math.isfinite(damping) and damping >= 0, "the number of objects")
    need(count * head["frame_count"] <= 1 << 24, "too many poses")
    bodies = []
    for payload in head["objects"]:
        body, coded = read_object(payload)
        bodies.append(body)
        if not body.is_deforming:
            add_fields(body, coded, 1)
    for frame_count, segment in segments:
        c = Cursor(segment)
        for body in bodies:
            body.numbers += decode_poses(c.chunk(), frame_count, round(1 / body.steps[1]))
            if body.is_deforming:
                add_fields(body, c.chunk(), frame_count)
        c.end()
    return Scene(head, damping, bodies)


def add_fields(body: Body, coded: bytes, count: int) -> None:
    """The frames of a segment of the field coder, as dense arrays."""
    for bricks in decode_segment(coded, body.field_parameters, body.shape, count):
        body.forces_n.append(laid_out(bricks, body.shape))


# -- forces -----------------------------------------------------------------------------------------------


def rotation_of(quaternion: Array) -> Array:
    """R of a unit quaternion (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def interpolated(body: Body, frame: int, points_m: Array) -> Array:
    """The body's field at points of its own frame, float64 [n, 3]."""
    forces = body.forces_n[frame if body.is_deforming else 0]
    padded = np.pad(forces.astype(np.float64), [(1, 1), (1, 1), (1, 1), (0, 0)])
    index = (points_m - body.origin_m) / body.spacing_m + 1
    low = np.floor(index).astype(np.int64)
    inside = ((low >= 0) & (low + 1 < np.array(padded.shape[:3]))).all(axis=1)
    fraction = index[inside] - low[inside]
    total = np.zeros((len(fraction), 3))
    for corner in product((0, 1), repeat=3):
        weight = np.prod(np.where(corner, fraction, 1 - fraction), axis=1)
        i, j, k = (low[inside] + corner).T
        total += weight[:, None] * padded[i, j, k]
    out = np.zeros(points_m.shape)
    out[inside] = total
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
    sine = np.sqrt((u * u).sum())
    spin = u / sine * 2 * math.atan2(sine, w) / seconds if sine > 0 else np.zeros(3)
    return (positions[i1] - positions[i0]) / seconds, spin
