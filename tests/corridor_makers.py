"""A synthetic corridor, seen by a depth camera that a walking person wears, with its ground truth.

Walls, boxes, poles, people who stand or walk, raised floors and holes are axis-aligned boxes and upright
cylinders, which are intersected with the rays of the pixels. The noise is that of a Kinect: normal with the
deviation of Nguyen et al. 2012, quanta of 0.0029 1/m in the inverse depth, nothing nearer than 0.5 m or
farther than 5 m, no depth in patches, at grazing angles and in the shadow beside near edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from touchfield.sources.camera import Intrinsics

RATE_HZ = 30.0
REDUCED, VGA = (160, 120), (640, 480)
SHORTEST_M, LONGEST_M = 0.5, 5.0


def kinect(size_px: tuple[int, int] = REDUCED) -> Intrinsics:
    """The camera of a Kinect with pictures of this width and height."""
    focal = 525.0 * size_px[0] / 640
    return Intrinsics(focal, focal, (size_px[0] - 1) / 2, (size_px[1] - 1) / 2)


@dataclass(frozen=True)
class Body:
    """A box, or a cylinder if it has a radius; `speed_m_s` is its velocity along z (down the corridor)."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    kind: str
    radius: float = 0.0
    speed_m_s: float = 0.0

    def at(self, time_s: float) -> Body:
        if self.speed_m_s == 0.0:
            return self
        low, high = list(self.low), list(self.high)
        low[2] += self.speed_m_s * time_s
        high[2] += self.speed_m_s * time_s
        return Body(tuple(low), tuple(high), self.kind, self.radius)  # type: ignore[arg-type]

    @property
    def is_obstacle(self) -> bool:
        return self.kind not in ("floor", "wall")


def box(x: float, z: float, wide: float, high: float, kind: str, low: float = 0.0) -> Body:
    half = wide / 2
    return Body((x - half, low, z - half), (x + half, high, z + half), kind)


def cylinder(x: float, z: float, radius: float, high: float, kind: str, speed_m_s: float = 0.0) -> Body:
    low, top = (x - radius, 0.0, z - radius), (x + radius, high, z + radius)
    return Body(low, top, kind, radius, speed_m_s)


@dataclass
class Corridor:
    """A corridor along z with bodies, and the way of the wearer through it."""

    bodies: list[Body]
    half_width_m: float
    seconds: float
    speed_m_s: float = 0.9
    camera_height_m: float = 1.35
    pitch_deg: float = 20.0
    look_deg: float = 20.0
    dodges: list[tuple[float, float]] = field(default_factory=list)  # z, x of the way there

    def floor_m(self, x: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Height of the floor at points, metres; what is below all floors is 3 m deep."""
        height = np.full(np.broadcast(x, z).shape, -3.0)
        for body in self.bodies:
            if body.kind == "floor":
                is_in = (x >= body.low[0]) & (x <= body.high[0]) & (z >= body.low[2]) & (z <= body.high[2])
                height = np.where(is_in, np.maximum(height, body.high[1]), height)
        return height

    def path_x(self, z: float) -> float:
        shift = 0.0
        for middle, x in self.dodges:
            far = abs(z - middle)
            if far < 1.7:
                shift += x * 0.5 * (1 + math.cos(math.pi * min(1.0, max(0.0, (far - 0.4) / 1.3))))
        return shift

    def pose(self, time_s: float) -> np.ndarray:
        """World from camera, float64 [4, 4]; the world has x right, y up and z along the corridor.

        These axes are left-handed; `as_pose` mirrors them.
        """
        z = self.speed_m_s * time_s
        x, ahead = self.path_x(z), self.path_x(z + 0.3)
        stride = 2 * math.pi * 0.9 * time_s
        yaw = 0.5 * math.atan2(ahead - x, 0.3) + math.radians(4) * math.sin(stride)
        yaw += math.radians(self.look_deg) * math.sin(2 * math.pi * time_s / 7.0)
        pitch = math.radians(self.pitch_deg + 2.0 * math.sin(2 * stride + 0.5))
        roll = math.radians(2.0 * math.sin(stride + 1.0))
        steps = np.linspace(z - 0.15, z + 0.15, 7)
        standing = float(np.mean(np.maximum(self.floor_m(np.full(7, x), steps), -0.0)))
        y = standing + self.camera_height_m + 0.02 * math.sin(2 * stride)
        forward = np.array(
            [math.sin(yaw) * math.cos(pitch), -math.sin(pitch), math.cos(yaw) * math.cos(pitch)]
        )
        right = np.array([math.cos(yaw), 0.0, -math.sin(yaw)])
        down = np.cross(right, forward)
        right, down = (
            math.cos(roll) * right + math.sin(roll) * down,
            math.cos(roll) * down - math.sin(roll) * right,
        )
        pose = np.eye(4)
        pose[:3, :3] = np.stack([right, down, forward], axis=1)
        pose[:3, 3] = (x, y, z)
        return pose

    def near(self, time_s: float, range_m: float = 7.0) -> list[Body]:
        z = self.speed_m_s * time_s
        moved = (body.at(time_s) for body in self.bodies)
        return [body for body in moved if body.high[2] > z - range_m and body.low[2] < z + range_m]


def as_pose(pose: np.ndarray) -> np.ndarray:
    """A pose of the corridor in right-handed axes (x to the left), as trackers give it."""
    return np.diag([-1.0, 1.0, 1.0, 1.0]) @ pose


def small_turn(rng: np.random.Generator, deviation_deg: float) -> np.ndarray:
    """A random rotation [3, 3], as an error of a tracker."""
    x, y, z = np.radians(deviation_deg) * rng.normal(size=3)
    q, r = np.linalg.qr(np.eye(3) + np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]))
    return np.asarray(q * np.sign(np.diag(r)))


def corridor(seed: int, seconds: float, half_width_m: float | None = None) -> Corridor:
    """A random corridor: an obstacle, a raised floor or a hole every few metres."""
    rng = np.random.default_rng(seed)
    half = half_width_m or float(rng.choice([1.7, 2.6]))
    length = 0.9 * seconds + 10.0
    wall = [
        Body((-half - 0.2, -1.0, -5.0), (-half, 2.6, length), "wall"),
        Body((half, -1.0, -5.0), (half + 0.2, 2.6, length), "wall"),
        Body((-half, -1.0, length), (half, 2.6, length + 0.2), "wall"),
        Body((-half, 2.6, -5.0), (half, 2.8, length), "wall"),
    ]
    bodies, dodges, gaps, z = wall, [], [], 4.0
    floor_kinds = ("raised", "hole")
    while z < length - 8.0:
        kind = str(rng.choice(["box", "low box", "pole", "person", "walker", *floor_kinds]))
        if kind in floor_kinds:
            size = float(rng.uniform(0.9, 1.4))
            gaps.append((z, z + size, kind))
            z += size + float(rng.uniform(3.5, 4.5))
            continue
        x = float(rng.uniform(-0.6, 0.6))
        side = 1.0 if x < 0 else -1.0
        dodges.append((z, x + side * 0.95))
        bodies.append(_obstacle(kind, x, z, rng))
        z += float(rng.uniform(4.6, 6.0))
    bodies += _floors(gaps, half, length)
    return Corridor(bodies, half, seconds, dodges=dodges)


def _obstacle(kind: str, x: float, z: float, rng: np.random.Generator) -> Body:
    if kind == "box":
        return box(x, z, float(rng.uniform(0.3, 0.5)), float(rng.uniform(0.5, 1.2)), kind)
    if kind == "low box":
        return box(x, z, 0.45, 0.3, kind)
    if kind == "pole":
        return cylinder(x, z, 0.05, 2.2, kind)
    speed = -0.5 if kind == "walker" else 0.0
    # a walker meets the wearer at z
    return cylinder(x, z - speed * z / 0.9, 0.22, 1.7, kind, speed)


def _floors(gaps: list[tuple[float, float, str]], half: float, length: float) -> list[Body]:
    floors, start = [], -5.0
    for low, high, kind in gaps:
        floors.append(Body((-half, -0.3, start), (half, 0.0, low), "floor"))
        top = float({"raised": 0.15, "hole": -0.6}[kind])
        floors.append(Body((-half, -0.9, low), (half, top, high), "floor"))
        start = high
    return [*floors, Body((-half, -0.3, start), (half, 0.0, length), "floor")]


def cast(bodies: list[Body], origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The length of each ray [n, 3] to the first body, in units of its direction, and the index of that body.

    Rays that meet none have inf and -1.
    """
    with np.errstate(divide="ignore"):
        inverse = (1.0 / directions).astype(np.float32)
    nearest = np.full(len(directions), np.inf, np.float32)
    index = np.full(len(directions), -1, np.int16)
    origin = origin.astype(np.float32)
    for number, body in enumerate(bodies):
        with np.errstate(invalid="ignore"):
            a = (np.asarray(body.low, np.float32) - origin) * inverse
            b = (np.asarray(body.high, np.float32) - origin) * inverse
        enter = np.minimum(a, b).max(axis=1)
        leave = np.maximum(a, b).min(axis=1)
        hit = (enter <= leave) & (enter > 1e-3) & (enter < nearest)
        if body.radius and hit.any():
            enter = _cylinder(body, origin, directions, hit, enter)
            hit &= (enter > 1e-3) & (enter < nearest)
        nearest[hit], index[hit] = enter[hit], number
    return nearest, index


def _cylinder(
    body: Body, origin: np.ndarray, directions: np.ndarray, hit: np.ndarray, enter: np.ndarray
) -> np.ndarray:
    """The lengths of the rays `hit` to an upright cylinder; inf if they miss it."""
    d = directions[hit].astype(np.float64)
    ox, oz = (origin[i] - (body.low[i] + body.high[i]) / 2 for i in (0, 2))
    square = d[:, 0] ** 2 + d[:, 2] ** 2
    along = d[:, 0] * ox + d[:, 2] * oz
    root = along**2 - square * (ox**2 + oz**2 - body.radius**2)
    t = np.where(root > 0, (-along - np.sqrt(np.maximum(root, 0))) / np.maximum(square, 1e-12), np.inf)
    y = origin[1] + t * d[:, 1]
    out = enter.copy()
    out[hit] = np.where((y >= body.low[1]) & (y <= body.high[1]), t, np.inf)
    return out


def pixel_rays(camera: Intrinsics, size_px: tuple[int, int]) -> np.ndarray:
    u, v = np.meshgrid(np.arange(size_px[0]), np.arange(size_px[1]))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)
    return rays.reshape(-1, 3)


def exact_depth(
    bodies: list[Body], pose: np.ndarray, camera: Intrinsics, size_px: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """The exact depth, float32 [height, width], inf where there is nothing, and the index of the body."""
    directions = (pixel_rays(camera, size_px) @ pose[:3, :3].T).astype(np.float32)
    depth, index = cast(bodies, pose[:3, 3], directions)
    return depth.reshape(size_px[::-1]), index.reshape(size_px[::-1])


def with_noise(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The depth that a Kinect returns for an exact depth, float32; 0 is unknown."""
    depth = np.where(np.isfinite(depth_m), depth_m, 0).astype(np.float64)
    depth += rng.normal(size=depth.shape) * (0.0012 + 0.0019 * (depth - 0.4) ** 2)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = 1 / (np.rint(1 / depth / 0.0029) * 0.0029)
    depth[~((depth_m > SHORTEST_M) & (depth_m < LONGEST_M))] = 0
    depth[_shadows(depth_m) | _patches(depth.shape, rng) | _grazing(depth_m, rng)] = 0
    return np.nan_to_num(depth, nan=0.0, posinf=0.0).astype(np.float32)


def _shadows(depth_m: np.ndarray) -> np.ndarray:
    """Pixels to the left of a near edge, which the projector beside the camera does not light."""
    far = np.minimum(np.nan_to_num(depth_m, posinf=20.0), 20.0)
    width = depth_m.shape[1]
    focal_px = 525.0 * width / 640
    is_dark = np.zeros(depth_m.shape, bool)
    for shift in (1, 2, 4, 8):
        near = far[:, shift:]
        is_dark[:, :-shift] |= focal_px * 0.075 * (1 / near - 1 / far[:, :-shift]) > shift
    return is_dark


def _patches(shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Patches of an eightieth of the width, 2 % of the picture, and single pixels, 1 %."""
    side = max(1, shape[1] // 80)
    coarse = rng.random((-(-shape[0] // side), -(-shape[1] // side))) < 0.02
    patches = np.kron(coarse, np.ones((side, side), bool))[: shape[0], : shape[1]]
    return np.asarray(patches | (rng.random(shape) < 0.01))


def _grazing(depth_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Half of the pixels of surfaces that a ray meets at more than about 80 degrees."""
    width = depth_m.shape[1]
    finite = np.nan_to_num(depth_m, posinf=20.0)
    slope = np.maximum(np.abs(np.gradient(finite, axis=0)), np.abs(np.gradient(finite, axis=1)))
    is_steep = slope * 525.0 * width / 640 > 5.7 * np.maximum(finite, 0.1)
    return np.asarray(is_steep & (rng.random(depth_m.shape) < 0.5))


# -- ground truth ------------------------------------------------------------------------------------------
def heading(pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The wearer's forward and right, unit vectors [x, z]."""
    forward = pose[[0, 2], 2] / np.linalg.norm(pose[[0, 2], 2])
    return forward, np.array([forward[1], -forward[0]])


def plan_distances(bodies: list[Body], pose: np.ndarray, floor_m: float) -> np.ndarray:
    """The distance of the nearest surface in each degree around the wearer, metres, float64 [360].

    Surfaces are those between 0.2 and 2 m above the floor on which the wearer stands. Degree 0 is behind, and
    angles increase to the right.
    """
    forward, right = heading(pose)
    angles = np.radians(np.arange(360) + 0.5 - 180.0)
    plan = np.cos(angles)[:, None] * forward + np.sin(angles)[:, None] * right
    directions = np.stack([plan[:, 0], np.full(360, 1e-9), plan[:, 1]], axis=1)
    nearest = np.full(360, np.inf)
    for height in (0.22, 0.28, 0.6, 1.0, 1.4):
        solid = [body for body in bodies if body.low[1] < floor_m + height < body.high[1]]
        if solid:
            origin = np.array([pose[0, 3], floor_m + height, pose[2, 3]])
            nearest = np.minimum(nearest, cast(solid, origin, directions)[0])
    return nearest


def nearest_point(body: Body, pose: np.ndarray) -> tuple[float, float]:
    """The distance and direction, degrees, of the nearest point of a body seen from above."""
    place = pose[[0, 2], 3]
    if body.radius:
        centre = np.array([(body.low[i] + body.high[i]) / 2 for i in (0, 2)])
        offset = centre - place
        offset *= 1 - body.radius / max(float(np.linalg.norm(offset)), body.radius)
    else:
        offset = np.clip(place, [body.low[0], body.low[2]], [body.high[0], body.high[2]]) - place
    forward, right = heading(pose)
    return float(np.linalg.norm(offset)), math.degrees(math.atan2(offset @ right, offset @ forward))


def floor_ahead(scene: Corridor, pose: np.ndarray) -> tuple[float, float]:
    """The distances of the next step up and drop on the wearer's way, up to 3 m; inf if there is none."""
    forward, right = heading(pose)
    distances = np.arange(0.05, 3.0, 0.02)
    heights = []
    for across in (-0.2, 0.0, 0.2):
        points = pose[[0, 2], 3] + distances[:, None] * forward + across * right
        heights.append(scene.floor_m(points[:, 0], points[:, 1]))
    here = float(scene.floor_m(pose[0, 3], pose[2, 3]))
    change = np.stack(heights) - max(here, 0.0)
    is_up, is_down = (change > 0.08).all(axis=0), (change < -0.08).all(axis=0)
    up, down = (float(distances[np.argmax(a)]) if a.any() else math.inf for a in (is_up, is_down))
    return up, down


def is_flat_around(scene: Corridor, pose: np.ndarray) -> bool:
    """True if the floor has no step or drop from 0.8 m behind to 3.2 m ahead, 0.7 m to both sides."""
    forward, right = heading(pose)
    along, across = np.meshgrid(np.arange(-0.8, 3.2, 0.1), np.arange(-0.7, 0.71, 0.1))
    points = pose[[0, 2], 3] + along[..., None] * forward + across[..., None] * right
    return bool(np.ptp(scene.floor_m(points[..., 0], points[..., 1])) < 0.05)
