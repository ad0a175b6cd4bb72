"""Plans a path along which a simulated hand touches a field, for a user who gives no path of their own.

The probe approaches a strong part of the field through free space, presses until the force is
`FORCE_FRACTION` of the largest on its way, slides along the surface at that force, and leaves: straight out
or, if another wall is there, back along its path. A plot then shows contact, friction and release separately.
The path is found as follows:

1. take some strong samples of the support, and two ways out of each, along the force and against it;
2. choose the best way. It is free outside the surface, starts on the user's side, and the field pushes back
   on it (a wall, a solid, a guide); a field that pulls has no such way, and a free one is chosen;
3. try eight directions along the surface. In each, follow the surface step by step: a point of it is where
   the force first reaches the level of the contact, on a line across the surface. Use the longest walk.

If an object moves, the path is that of its own frame of reference, and moves with it. Only the query of a
receiver is used, so that the method works for voxels and objects, and gives the same trace on every machine.
In an empty field the probe rests in the middle of the grid.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from touchfield.arrays import Float32s, Float64s
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.pose_track import rotation_matrices
from touchfield.medium.trace import HAPTIC_RATE_HZ, Trace
from touchfield.render.point_device import BOX_AXES, axes_matrix
from touchfield.sources.poses import interpolate_poses

Query = Callable[[Float64s], Float64s]


DURATION_S: Final = 3.0
FORCE_FRACTION: Final = 0.6
"""Fraction of the largest force on the way in to which the probe presses."""

_LEGS: Final = (("come", 0.2), ("press", 0.1), ("rest", 0.05), ("slide", 0.4), ("rest", 0.05), ("leave", 0.2))
"""Parts of the path, and the fraction of the time for each."""

_VIEWER_WEIGHT: Final = 1.8
"""Weight of the user's side, from -1 to 1; a little less than that of a field that pushes back."""

_CANDIDATES: Final = 24
_PATH_POINTS: Final = 4096  # points on a way out
_DIRECTIONS: Final = 8
_STEPS: Final = 32  # along the surface
_LINE_POINTS: Final = 65  # points of the line across the surface, on which it is searched
_LEAD, _SLIDE = 0.12, 0.2  # length of the approach and of the slide, over the diagonal


def touch_down(
    medium: HapticMedium | HapticScene,
    stiffness_n_per_m: float = math.inf,
    force_max_n: float = math.inf,
    start_s: float = 0.0,
    speed: float = 1.0,
) -> Trace:
    """Plan a trace that touches a field.

    The trace is at 1 kHz, from 0 s on, in the axes and metres of the field.

    Parameters
    ----------
    medium : HapticMedium or HapticScene
        The path is planned in the frame at which the probe arrives; if that frame is empty, in the first of
        some others that is not. A medium of several frames that is shorter than `DURATION_S` is touched
        within its own duration.
    stiffness_n_per_m : float
        Stiffness of the hand that will follow the trace. The trace is F / k deeper, so that a hand on a
        spring rests where a stiff one would.
    force_max_n : float
        Limit of the force, newtons. With the continuous force of a device, its thermal limit is not reached.
    start_s, speed : float
        Time of the medium at which the hand starts, and seconds of the medium for one second of the hand.
    """
    seconds = DURATION_S
    if len(medium) > 1:
        seconds = min(DURATION_S, max(0.1, (len(medium) / medium.rate_hz - start_s) / speed))
    grid, query, points, frame = _first_frame(medium, start_s + speed * seconds * _LEGS[0][1])
    count = max(2, round(seconds * HAPTIC_RATE_HZ) + 1)
    if not len(points):
        return Trace.regular(np.tile(np.mean(grid.box_m, axis=0), (count, 1)))
    legs = _path(grid, query, points, force_max_n, axes_matrix(BOX_AXES, medium.axes)[:, 2])
    positions, contact_point = _positions_over_time(legs, count), legs["slide"][0]
    if math.isfinite(stiffness_n_per_m):
        positions = positions - query(positions) / stiffness_n_per_m
    if isinstance(medium, HapticScene):
        times_s = start_s + speed * np.arange(len(positions)) / HAPTIC_RATE_HZ
        positions = _follow_object(
            medium, frame, contact_point, positions, np.asarray(times_s * medium.rate_hz, np.float64)
        )
    return Trace.regular(positions)


def _follow_object(
    scene: HapticScene, frame: int, contact_point: Float64s, positions: Float64s, frames: Float64s
) -> Float64s:
    """Move a path found in one frame with the object that it touches.

    `frames` are frame numbers, with fractions. The path is translated with the object from the start, and
    rotated with it from that frame on, so that the probe approaches from the side that was chosen.
    """
    forces = [body.field(frame).sample_n(body.track.to_body(contact_point, frame)) for body in scene.objects]
    track = scene.objects[int(np.argmax(np.linalg.norm(forces, axis=-1)))].track
    if track.is_constant:
        return positions
    frames = np.clip(frames, 0, len(track) - 1)
    _, shifts = interpolate_poses(track.quaternions, track.positions_m, frames)
    quaternions, _ = interpolate_poses(track.quaternions, track.positions_m, np.maximum(frames, frame))
    rotations = rotation_matrices(quaternions)
    moved: Float64s = (rotations @ track.to_body(positions, frame)[:, :, None])[:, :, 0] + shifts
    return moved


def _first_frame(medium: HapticMedium | HapticScene, at_s: float) -> tuple[Grid, Query, Float64s, int]:
    """Return grid, query, positions of strong samples, float64 [m, 3], and number of a frame."""
    count = len(medium)
    first = min(int(at_s * medium.rate_hz), count - 1)
    for frame in dict.fromkeys([first, *np.linspace(0, count - 1, min(count, 8)).astype(int).tolist()]):
        if isinstance(medium, HapticScene):
            query = _query(partial(medium.sample_n, frame))
            points = np.concatenate(
                [body.track.to_scene(_strong_samples(body.field(frame)), frame) for body in medium.objects]
            )
            sizes = _sizes(query(points))
            points = points[sizes > 0.5 * sizes.max(initial=0.0)]
        else:
            field = medium[frame]
            query, points = _query(field.sample_n), _strong_samples(field)
        if len(points):
            break
    return medium.grid, query, points, frame


def _query(sample_n: Callable[[Float64s], Float32s]) -> Query:
    return lambda points: sample_n(points).astype(np.float64)


def _strong_samples(field: ForceField) -> Float64s:
    """Return positions of samples with more than half of the largest force, float64 [m, 3].

    They are spread evenly over all such samples.
    """
    support = field.support()
    strong = np.flatnonzero(support.amplitudes_n > 0.5 * support.amplitudes_n.max(initial=0.0))
    selected = strong[np.linspace(0, len(strong) - 1, min(len(strong), _CANDIDATES)).astype(int)]
    return field.grid.to_m(support.positions[selected])


def _sizes(forces: Float64s) -> Float64s:
    sizes: Float64s = np.sqrt((forces * forces).sum(axis=-1))
    return sizes


def _diagonal(grid: Grid) -> float:
    low, high = grid.box_m
    return float(np.linalg.norm(high - low))


def _path(
    grid: Grid, query: Query, points: Float64s, force_max_n: float, viewer: Float64s
) -> dict[str, Float64s]:
    """Return the path of the probe: corners of "come", "press", "slide" and "leave", each [n, 3]."""
    diagonal, fine = _diagonal(grid), min(grid.spacing_m)
    start, out, depth, free = _way_out(query, points, diagonal, fine, viewer)
    inwards = np.linspace(0.0, depth, _PATH_POINTS)  # from the surface to the sample
    sizes = _sizes(query(start + out * (depth - inwards)[:, None]))
    pressed = float(inwards[np.argmax(sizes >= min(FORCE_FRACTION * sizes.max(), force_max_n))])
    surface = start + out * depth
    touched = surface - out * pressed
    slide = _slide(query, touched, out, _SLIDE * diagonal, 2 * max(grid.spacing_m))
    lead = max(min(_LEAD * diagonal, 0.9 * free), fine)
    before = surface + out * min(2 * fine, lead / 2)
    come, press = np.stack([surface + out * lead, before]), np.stack([before, touched])
    leave = slide[-1] + out * np.linspace(0.0, pressed + lead, _LINE_POINTS)[:, None]
    sizes = _sizes(query(leave))
    is_blocked = sizes[-1] > 1e-6 * sizes[0] or sizes.max() > 1.05 * sizes[0]
    if is_blocked:  # by another wall: go back the way it came, which is free
        leave = np.concatenate([come, press, slide])[::-1]
    return {"come": come, "press": press, "slide": slide, "leave": leave}


def _way_out(
    query: Query, points: Float64s, diagonal: float, fine: float, viewer: Float64s
) -> tuple[Float64s, Float64s, float, float]:
    """Return the best sample to touch: position, unit vector outwards, depth, and free distance."""
    forces = query(points)
    strengths = _sizes(forces)
    along = forces / strengths[:, None]
    step = max(fine / 2, diagonal / _PATH_POINTS)
    distances = step * np.arange(math.ceil(diagonal / step) + 1)
    gap = max(3, len(distances) // 32)
    centre = points.mean(axis=0)
    best, best_way = -math.inf, None
    for point, normal, strength in zip(points, along, strengths / strengths.max(), strict=True):
        for out in (normal, -normal):
            line = query(point + out * distances[:, None])
            sizes = _sizes(line)
            has_force = sizes > 1e-6 * sizes.max()
            # the way beyond the last point is free
            indices = np.append(np.flatnonzero(has_force), len(has_force) + gap)
            last = int(np.argmax(np.diff(indices) > gap))  # the first index that free space follows
            exit_, free_end = int(indices[last]) + 1, min(int(indices[last + 1]), len(has_force))
            outermost = slice(max(0, exit_ - 6), exit_)
            resisting = float((line[outermost] @ out).sum() / sizes[outermost].sum())
            free = step * (free_end - exit_)
            score = (
                2 * min(1.0, free / (_LEAD * diagonal))
                + 1.5 * (indices[last + 1] >= len(has_force))
                + 2 * resisting
                + strength
            )
            score += _VIEWER_WEIGHT * float(out @ viewer)
            score -= 0.5 * (step * exit_ + float(np.linalg.norm(point - centre))) / diagonal
            if score > best:
                best, best_way = score, (point, out, step * exit_, free)
    assert best_way is not None
    return best_way


def _slide(query: Query, touched: Float64s, out: Float64s, length: float, slack: float) -> Float64s:
    """Return the longest walk along the surface from a point on it, float64 [n, 3].

    n is at least 1.
    """
    across = np.eye(3)[np.argmin(np.abs(out))]
    across -= out * (across @ out)
    across /= np.linalg.norm(across)
    angles = 2 * np.pi * np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS
    directions = np.cos(angles) * across + np.sin(angles) * np.cross(out, across)
    level = float(_sizes(query(touched[None]))[0])
    step = length / _STEPS
    heights = np.linspace(1.0, -1.0, _LINE_POINTS) * (1.5 * step + slack)
    walks = [np.tile(touched, (_DIRECTIONS, 1))]
    counts, alive = np.zeros(_DIRECTIONS, int), np.ones(_DIRECTIONS, bool)
    for _ in range(_STEPS):
        lines = (walks[-1] + step * directions)[:, None, :] + heights[:, None] * out
        sizes = _sizes(query(lines.reshape(-1, 3))).reshape(_DIRECTIONS, _LINE_POINTS)
        first = np.argmax(sizes >= level, axis=1)
        alive &= (sizes.max(axis=1) >= level) & (first > 0)
        if not alive.any():
            break
        before = np.maximum(first - 1, 0)
        rows = np.arange(_DIRECTIONS)
        rise = sizes[rows, first] - sizes[rows, before]
        weight = np.where(rise > 0, (level - sizes[rows, before]) / np.where(rise > 0, rise, 1.0), 1.0)
        new = lines[rows, before] + weight[:, None] * (lines[rows, first] - lines[rows, before])
        walks.append(np.where(alive[:, None], new, walks[-1]))
        counts += alive
    longest = int(np.argmax(counts))
    return np.stack([step_[longest] for step_ in walks[: counts[longest] + 1]])


def _positions_over_time(legs: dict[str, Float64s], count: int) -> Float64s:
    """Return the position of the probe at `count` evenly spaced times, float64 [count, 3].

    Each leg starts and ends at rest.
    """
    positions = np.empty((count, 3))
    times = np.cumsum([0.0, *(fraction for _, fraction in _LEGS)])
    edges = np.rint(times / times[-1] * (count - 1)).astype(int)
    position = legs["come"][0]
    for (name, _), start, stop in zip(_LEGS, edges[:-1], edges[1:], strict=True):
        corners = legs.get(name, position[None])
        lengths = np.append(0.0, np.cumsum(_sizes(np.diff(corners, axis=0))))
        fraction = np.arange(stop - start + 1) / max(1, stop - start)
        distance = fraction**3 * (10 - 15 * fraction + 6 * fraction**2) * lengths[-1]
        positions[start : stop + 1] = np.stack([np.interp(distance, lengths, c) for c in corners.T], axis=1)
        position = corners[-1]
    return positions
