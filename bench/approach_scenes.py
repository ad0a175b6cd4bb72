"""Depth over time with a known truth: what approaches, where and when, and what must not be felt.

A scene is a room of random walls, floor and furniture, with the noise, steps, holes and flying pixels of a
Kinect in 160 x 120 pixels. In the scenes of one kind something approaches, and in the others nothing does.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s

SIZE: Final = (160, 120)
RATE_HZ: Final = 25.0
FRAMES: Final = 100
FOCAL_PX: Final = 140.0
REGIONS: Final = (4, 4)  # rows, columns
FELT_FROM_S: Final = 4.0  # time to contact from which an approach is to be felt
_STEP_PER_M: Final = 0.0029  # of a Kinect's inverse depth


class Scene(NamedTuple):
    """A scene.

    kind : str
        "approach", or that of a scene in which nothing approaches.
    depths_m : list of float32 [height, width]
        0 where unknown.
    regions : bool [rows, columns] or None
        Where the thing that approaches is, in the last second before the end.
    first_frame : int
        From which it is to be felt; the number of frames if nothing is.
    """

    kind: str
    depths_m: list[Float32s]
    regions: Bools | None
    first_frame: int


def _room(rng: np.random.Generator, width: int = SIZE[0]) -> Float64s:
    """Return a wall, a floor and pieces of furniture, metres [height, width]."""
    height = SIZE[1]
    depth = np.full((height, width), rng.uniform(3.5, 5.5))
    horizon = rng.uniform(50, 70)
    rows = np.arange(height)
    below = rows > horizon + 5
    floor = rng.uniform(1.0, 1.6) * FOCAL_PX / np.maximum(rows - horizon, 1)
    depth[below] = np.minimum(depth[below], floor[below, None])
    for _ in range(rng.integers(1, 4) * width // SIZE[0]):
        left, top = rng.integers(0, width - 20), rng.integers(10, 70)
        part = depth[top : top + rng.integers(15, 45), left : left + rng.integers(8, 30)]
        np.minimum(part, rng.uniform(1.5, 3.5), out=part)
    return depth


def _ball(depth: Float64s, centre_px: tuple[float, float], distance_m: float, radius_m: float) -> Float64s:
    v, u = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    radius_px = radius_m * FOCAL_PX / distance_m
    square = ((u - centre_px[0]) ** 2 + (v - centre_px[1]) ** 2) / radius_px**2
    front = distance_m - radius_m * np.sqrt(np.maximum(1 - square, 0))
    return np.where(square <= 1, np.minimum(depth, front), depth)


def _noisy(depth: Float64s, rng: np.random.Generator) -> Float32s:
    inverse = 1 / depth + rng.normal(size=depth.shape) * 0.4 * _STEP_PER_M
    out = 1 / np.maximum(np.round(inverse / _STEP_PER_M) * _STEP_PER_M, 0.05)
    steps = (np.abs(np.diff(depth, axis=a, prepend=depth.take([0], a))) > 0.1 for a in (0, 1))
    is_edge = np.logical_or(*steps)
    out *= np.where(is_edge & (rng.random(depth.shape) < 0.3), rng.uniform(0.7, 1.2, depth.shape), 1)
    out[(is_edge & (rng.random(depth.shape) < 0.5)) | (rng.random(depth.shape) < 0.03)] = 0
    for _ in range(4):
        top, left = rng.integers(0, SIZE[1] - 12), rng.integers(0, SIZE[0] - 12)
        out[top : top + rng.integers(3, 12), left : left + rng.integers(3, 12)] = 0
    out[out < 0.45] = 0  # too near for the sensor
    return out.astype(np.float32)


def _regions(centre_px: tuple[float, float], radius_px: float) -> Bools:
    """Return the regions of which a disc covers at least a twentieth, bool [rows, columns]."""
    v, u = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    inside = (u - centre_px[0]) ** 2 + (v - centre_px[1]) ** 2 <= radius_px**2
    rows, columns = REGIONS
    parts = inside.reshape(rows, SIZE[1] // rows, columns, SIZE[0] // columns)
    return np.asarray(parts.mean(axis=(1, 3)) >= 0.05)


def approach(rng: np.random.Generator) -> Scene:
    """A ball that flies or walks towards the camera, with constant speed, and somewhat sideways."""
    room, speed = _room(rng), rng.uniform(0.6, 2.5)
    radius, last = rng.uniform(0.12, 0.35), rng.uniform(0.7, 1.0)
    moving = int(min(FRAMES - 10, (3.2 - last) / speed * RATE_HZ))
    start = FRAMES - moving
    centre = np.array([rng.uniform(20, SIZE[0] - 20), rng.uniform(15, SIZE[1] - 45)])
    sideways = rng.normal(size=2) * 4.0 / RATE_HZ  # pixels a frame
    depths, places = list[Float32s](), list[tuple[tuple[float, float], float]]()
    for n in range(FRAMES):
        ahead = max(n - start, 0)
        place = centre + sideways * (ahead - moving)
        distance = last + speed * (moving - ahead) / RATE_HZ
        places.append(((float(place[0]), float(place[1])), distance))
        depths.append(_noisy(_ball(room, places[-1][0], distance, radius), rng))
    end = [_regions(place, radius * FOCAL_PX / distance) for place, distance in places[-round(RATE_HZ) :]]
    contact_s = np.array([distance for _, distance in places]) / speed
    first = max(start, int(np.argmax(contact_s <= FELT_FROM_S)))
    return Scene("approach", depths, np.any(end, axis=0), first)


def standing(rng: np.random.Generator) -> Scene:
    """A camera that stands before a scene that stands, with something near."""
    room = _ball(_room(rng), (rng.uniform(20, 140), rng.uniform(20, 80)), rng.uniform(0.8, 1.5), 0.2)
    return Scene("standing", [_noisy(room, rng) for _ in range(FRAMES)], None, FRAMES)


def passing(rng: np.random.Generator) -> Scene:
    """A ball that crosses the picture at one distance."""
    room, distance, radius = _room(rng), rng.uniform(1.0, 3.0), rng.uniform(0.12, 0.3)
    frames, height = rng.uniform(20, 90), rng.uniform(20, 80)
    depths = [
        _noisy(_ball(room, (-40 + 240 * n / frames, height), distance, radius), rng) for n in range(FRAMES)
    ]
    return Scene("passing", depths, None, FRAMES)


def turning(rng: np.random.Generator) -> Scene:
    """A camera that turns."""
    wide, speed = _room(rng, 4 * SIZE[0]), rng.uniform(0.3, 4.0)
    lefts = np.minimum(np.arange(FRAMES) * speed, 3 * SIZE[0]).astype(int)
    return Scene("turning", [_noisy(wide[:, n : n + SIZE[0]], rng) for n in lefts], None, FRAMES)


def leaving(rng: np.random.Generator) -> Scene:
    """The opposite of an approach."""
    return Scene("leaving", approach(rng).depths_m[::-1], None, FRAMES)


MAKERS: Final[dict[str, Callable[[np.random.Generator], Scene]]] = {
    "approach": approach,
    "standing": standing,
    "passing": passing,
    "turning": turning,
    "leaving": leaving,
}
