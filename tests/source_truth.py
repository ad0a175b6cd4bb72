"""What a decoded `.touch` file must contain: contacts along rays, forces at points, driven actuators.

Each truth is known by the construction of the input. A check returns its largest error as a multiple of what
the lattice allows (at most 1 is right), and text that says what was compared.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import room_makers as room
import touchfield as tf

CONTACT_N = 0.1
"""Force from which a hand is in contact: twice the F_0 of the error bound."""
ALLOWED_SPACINGS = 1.5
"""Distance of a contact from its true place, in spacings of the lattice along the ray."""
ALLOWED_FORCE = 0.3
"""Median error of forces that were recorded, as a fraction of the largest."""


@dataclass(frozen=True)
class Truth:
    """A check of a file: `measure(stream)` returns error and text; `frame_count` may be any if None."""

    measure: Callable[[Any], tuple[float, str]]
    frame_count: int | None = None

    def __call__(self, path: Path) -> tuple[float, str]:
        """Return the largest error over the allowed one, infinite for a wrong number of frames, and text."""
        with tf.open_stream(str(path)) as stream:
            count = len(stream.medium)
            if self.frame_count is not None and count != self.frame_count:
                return float("inf"), f"{count} frames, not {self.frame_count}"
            return self.measure(stream)


@dataclass(frozen=True)
class Ray:
    """A hand that moves from a free place into a surface: scene metres, and the true distance to it.

    `normal` is that of the surface; None if the ray is along it.
    """

    start_m: Any
    direction: Any
    distance_m: float
    frame: int = 0
    normal: Any = None


def contacts(rays: list[Ray], frame_count: int | None = None) -> Truth:
    """Return the truth that each ray meets its surface at its distance, with a force against it."""

    def measure(stream: Any) -> tuple[float, str]:
        errors = [contact_error(stream, ray) for ray in rays]
        return max(errors) / ALLOWED_SPACINGS, f"{len(rays)} contacts within {max(errors):.2f} spacings"

    return Truth(measure, frame_count)


def contact_error(stream: Any, ray: Ray) -> float:
    """Return the distance of the first contact from the true surface, in spacings along its normal.

    Infinite if there is no contact, or the force there does not push back.
    """
    direction = np.asarray(ray.direction, float) / np.linalg.norm(ray.direction)
    field, scale = stream.medium[ray.frame], stream.placement.scale
    normal = direction if ray.normal is None else np.asarray(ray.normal, float)
    spacing_m = float(np.linalg.norm(normal * np.asarray(field.grid.spacing_m)))
    true_m = ray.distance_m * scale
    reach_m = np.arange(0.3 * true_m, 1.3 * true_m + 4 * spacing_m, 0.05 * spacing_m)
    points = np.asarray(stream.placement.to_hand(ray.start_m)) + reach_m[:, None] * direction
    forces = field.sample_n(points)
    felt = np.flatnonzero(np.linalg.norm(forces, axis=1) > CONTACT_N)
    if not len(felt) or forces[felt[0]] @ direction >= 0:
        return float("inf")
    return float(abs((reach_m[felt[0]] - true_m) * (normal @ direction)) / spacing_m)


def seen_by_cameras(frames: tuple[int, ...] = (0, 3), frame_count: int = 4) -> Truth:
    """Return the truth of the room: what nine pixels of each camera see, in the axes of the first one."""
    fx, fy, cx, cy = room.CAMERA
    rays, poses = [], room.poses()
    for frame in frames:
        for u in (room.WIDTH * f for f in (0.3, 0.5, 0.7)):
            for v in (room.HEIGHT * f for f in (0.3, 0.5, 0.7)):
                ray = poses[frame, :3, :3] @ np.array([(u - cx) / fx, (v - cy) / fy, 1.0])
                length = room.along_rays_m(ray, poses[frame, :3, 3]) * np.linalg.norm(ray)
                rays.append(Ray(poses[frame, :3, 3], ray, float(length), 0, wall_normal(poses[frame], ray)))
    return contacts(rays, frame_count)


def wall_normal(pose: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Return the normal of the wall that a ray meets, outwards."""
    reached = pose[:3, 3] + room.along_rays_m(ray, pose[:3, 3]) * ray
    sides = np.concatenate([np.abs(reached - room.LOW), np.abs(reached - room.HIGH)])
    normal = np.zeros(3)
    normal[sides.argmin() % 3] = 1 if sides.argmin() >= 3 else -1
    return normal


def heights(
    height_m: Callable[[float, float], float], size_m: tuple[float, float], low_m: float, frame_count: int = 1
) -> Truth:
    """Return the truth of a map: `height_m(east, north)` from the south-west corner, felt from above."""
    rays = []
    for x in (0.2 * size_m[0], 0.5 * size_m[0], 0.8 * size_m[0]):
        for y in (0.2 * size_m[1], 0.5 * size_m[1], 0.8 * size_m[1]):
            height = height_m(x, y)
            above = max(height - low_m, 1e-3 * max(size_m))
            rays.append(Ray((x, y, height + above), (0, 0, -1), above))
    return contacts(rays, frame_count)


def box(low_m: Any, high_m: Any, frame: int = 0, frame_count: int | None = None) -> Truth:
    """Return the truth of a closed box: a hand meets each of its six sides."""
    return contacts(box_rays(low_m, high_m, frame), frame_count)


def box_rays(low_m: Any, high_m: Any, frame: int = 0) -> list[Ray]:
    """Return rays into the six sides, each from 40 % of the box's size outside."""
    low, high = np.asarray(low_m, float), np.asarray(high_m, float)
    rays = []
    for axis in range(3):
        for sign, side in ((1, high), (-1, low)):
            direction = np.zeros(3)
            direction[axis] = -sign
            start = (low + high) / 2
            outside = 0.4 * (high - low)[axis]
            start[axis] = side[axis] + sign * outside
            rays.append(Ray(start, direction, float(outside), frame))
    return rays


def sphere(radius_m: float, centre_m: Any = (0, 0, 0), frame_count: int | None = None) -> Truth:
    """Return the truth of a ball that is met along all axes."""
    centre = np.asarray(centre_m, float)
    return contacts(box_rays(centre - radius_m, centre + radius_m), frame_count)


def forces(positions_m: np.ndarray, forces_n: np.ndarray) -> Truth:
    """Return the truth of forces [n, 3] at points [n, 3] of the scene."""

    def measure(stream: Any) -> tuple[float, str]:
        points = np.asarray([stream.placement.to_hand(point) for point in positions_m])
        errors = np.linalg.norm(stream.medium[0].sample_n(points) - forces_n, axis=1)
        error = float(np.median(errors) / np.linalg.norm(forces_n, axis=1).max())
        return error / ALLOWED_FORCE, f"forces at {len(points)} points within {100 * error:.0f} % (median)"

    return Truth(measure)


def driven(time_s: float, index: tuple[int, int], silent_s: float, seconds: float) -> Truth:
    """Return the truth of an array: `index` is the strongest at one time, all rest at another.

    `seconds` is the duration of the medium, within a tenth.
    """

    def measure(stream: Any) -> tuple[float, str]:
        medium = stream.medium
        duration_s = len(medium) / medium.rate_hz
        if abs(duration_s - seconds) > 0.1 * seconds:
            return float("inf"), f"{duration_s:.3g} s, not {seconds:g} s"
        amplitude = drives(medium, round(time_s * medium.rate_hz))
        strongest = tuple(map(int, np.unravel_index(int(amplitude.argmax()), amplitude.shape)[:2]))
        is_silent = not drives(medium, round(silent_s * medium.rate_hz)).any()
        text = f"actuator {strongest} driven after {time_s:g} s"
        return (0.0 if strongest == index and is_silent and amplitude.any() else float("inf")), text

    return Truth(measure)


def drives(medium: Any, frame: int) -> np.ndarray:
    """Return the largest of force and vibration of each actuator, float [columns, rows, 1]."""
    amplitude = np.linalg.norm(medium[frame].to_dense(), axis=-1)
    if medium.vibration is not None:
        vibration = medium.vibration(frame)
        np.maximum.at(amplitude, tuple(vibration.positions.T), vibration.amplitudes_n)
    return amplitude
