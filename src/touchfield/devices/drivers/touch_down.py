"""A probe for a field that nobody has touched yet: what a simulated hand does when it is told nothing.

It comes from outside, through free space, to a strong part of the field, presses in until the force is
`SHARE` of the greatest on its way, slides along the surface at that force, and leaves, straight out or, where
another wall lies there, the way it came: contact, friction and release, each to be seen in a plot. It finds
that by looking:

1. some strong samples of the support, and two ways out of each, along the force and against it;
2. the best way: one that is free from the surface on, on which the field pushes back (a wall, a solid, a
   guide; a field that pulls has no such way, and takes the free one), and that begins on the side where the
   user sits;
3. eight directions along the surface; in each the surface is followed step by step, as the line across it on
   which the force first reaches that share; the longest walk is taken.

An object that moves is met: the way is that of its own frame, which goes with it. All is done with the
receiver's own query, so that it works for voxels and for objects, and gives the same trace on every machine.
In an empty field it rests in the middle.
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
from touchfield.sources.poses import poses_between

Query = Callable[[Float64s], Float64s]


SECONDS: Final = 3.0
SHARE: Final = 0.6
"""Of the greatest force on the way in, that the probe goes in to."""

_LEGS: Final = (("come", 0.2), ("press", 0.1), ("rest", 0.05), ("slide", 0.4), ("rest", 0.05), ("leave", 0.2))
"""Steps of the work, and each one's share of the time."""

_VIEWER_WEIGHT: Final = 1.8
"""Of the side where the user sits, which goes from -1 to 1: a little less than that of a field that pushes
back.
"""

_CANDIDATES: Final = 24
_POINTS: Final = 4096  # of one way out
_DIRECTIONS: Final = 8
_STEPS: Final = 32  # along the surface
_ACROSS: Final = 65  # points of the line on which it is found again
_LEAD, _SLIDE = 0.12, 0.2  # of the diagonal: how far outside the probe comes from, and how far it slides


def touch_down(
    touched: HapticMedium | HapticScene,
    stiffness_n_per_m: float = math.inf,
    force_max_n: float = math.inf,
    start_s: float = 0.0,
    speed: float = 1.0,
) -> Trace:
    """A trace that touches a field.

    The trace is at 1 kHz, from 0 s on, in the axes and metres of the field.

    Parameters
    ----------
    touched : HapticMedium or HapticScene
        The frame of the moment at which the probe arrives is looked at; where that is empty, the first that
        is not, of some. What has several frames and is shorter than `SECONDS` is touched within its own time.
    stiffness_n_per_m : float
        That of the hand which will follow the trace; with it the trace runs F / k deeper, so that a hand on a
        spring comes to rest where a stiff one would be.
    force_max_n : float
        The field is pressed no harder than this, newtons; with what a device can hold for long, its thermal
        limit does not come between.
    start_s, speed : float
        The moment of the medium at which the hand begins, and its seconds in one of the hand's.
    """
    seconds = SECONDS
    if len(touched) > 1:
        seconds = min(SECONDS, max(0.1, (len(touched) / touched.rate_hz - start_s) / speed))
    grid, query, points, frame = _frame(touched, start_s + speed * seconds * _LEGS[0][1])
    count = max(2, round(seconds * HAPTIC_RATE_HZ) + 1)
    if not len(points):
        return Trace.regular(np.tile(np.mean(grid.box_m, axis=0), (count, 1)))
    legs = _touch(grid, query, points, force_max_n, axes_matrix(BOX_AXES, touched.axes)[:, 2])
    places, met = _timed(legs, count), legs["slide"][0]
    if math.isfinite(stiffness_n_per_m):
        places = places - query(places) / stiffness_n_per_m
    if isinstance(touched, HapticScene):
        times_s = start_s + speed * np.arange(len(places)) / HAPTIC_RATE_HZ
        places = _following(touched, frame, met, places, np.asarray(times_s * touched.rate_hz, np.float64))
    return Trace.regular(places)


def _following(scene: HapticScene, frame: int, met: Float64s, places: Float64s, at: Float64s) -> Float64s:
    """A way that was found in one frame, going with the object that is met there; `at` are frames, with
    fractions.

    It goes along from the begin on, and turns with it from that frame on, so that it comes from the side it
    chose.
    """
    felt = [one.field(frame).sample_n(one.track.to_body(met, frame)) for one in scene.objects]
    track = scene.objects[int(np.argmax(np.linalg.norm(felt, axis=-1)))].track
    if track.is_still:
        return places
    at = np.clip(at, 0, len(track) - 1)
    _, shifts = poses_between(track.quaternions, track.positions_m, at)
    quaternions, _ = poses_between(track.quaternions, track.positions_m, np.maximum(at, frame))
    turns = rotation_matrices(quaternions)
    moved: Float64s = (turns @ track.to_body(places, frame)[:, :, None])[:, :, 0] + shifts
    return moved


def _frame(touched: HapticMedium | HapticScene, at_s: float) -> tuple[Grid, Query, Float64s, int]:
    """The lattice, the query and the places of some strong samples, float64 [m, 3], of one frame, and its
    number.
    """
    count = len(touched)
    first = min(int(at_s * touched.rate_hz), count - 1)
    for frame in dict.fromkeys([first, *np.linspace(0, count - 1, min(count, 8)).astype(int).tolist()]):
        if isinstance(touched, HapticScene):
            query = _query(partial(touched.sample_n, frame))
            points = np.concatenate(
                [one.track.to_scene(_strong(one.field(frame)), frame) for one in touched.objects]
            )
            sizes = _sizes(query(points))
            points = points[sizes > 0.5 * sizes.max(initial=0.0)]
        else:
            field = touched[frame]
            query, points = _query(field.sample_n), _strong(field)
        if len(points):
            break
    return touched.grid, query, points, frame


def _query(sample_n: Callable[[Float64s], Float32s]) -> Query:
    return lambda points: sample_n(points).astype(np.float64)


def _strong(field: ForceField) -> Float64s:
    """Places of samples with more than half of the greatest force, spread evenly over them, float64 [m, 3]."""
    support = field.support()
    near = np.flatnonzero(support.amplitudes_n > 0.5 * support.amplitudes_n.max(initial=0.0))
    chosen = near[np.linspace(0, len(near) - 1, min(len(near), _CANDIDATES)).astype(int)]
    return field.grid.to_m(support.positions[chosen])


def _sizes(forces: Float64s) -> Float64s:
    sizes: Float64s = np.sqrt((forces * forces).sum(axis=-1))
    return sizes


def _diagonal(grid: Grid) -> float:
    low, high = grid.box_m
    return float(np.linalg.norm(high - low))


def _touch(
    grid: Grid, query: Query, points: Float64s, force_max_n: float, viewer: Float64s
) -> dict[str, Float64s]:
    """The way of the probe: the corners of "come", "press", "slide" and "leave", each float64 [n, 3]."""
    diagonal, fine = _diagonal(grid), min(grid.spacing_m)
    place, out, depth, free = _way_out(query, points, diagonal, fine, viewer)
    inwards = np.linspace(0.0, depth, _POINTS)  # from the surface to the sample
    sizes = _sizes(query(place + out * (depth - inwards)[:, None]))
    pressed = float(inwards[np.argmax(sizes >= min(SHARE * sizes.max(), force_max_n))])
    surface = place + out * depth
    touched = surface - out * pressed
    slide = _slide(query, touched, out, _SLIDE * diagonal, 2 * max(grid.spacing_m))
    lead = max(min(_LEAD * diagonal, 0.9 * free), fine)
    before = surface + out * min(2 * fine, lead / 2)
    come, press = np.stack([surface + out * lead, before]), np.stack([before, touched])
    leave = slide[-1] + out * np.linspace(0.0, pressed + lead, _ACROSS)[:, None]
    sizes = _sizes(query(leave))
    if (
        sizes[-1] > 1e-6 * sizes[0] or sizes.max() > 1.05 * sizes[0]
    ):  # another wall: back as it came, which is free
        leave = np.concatenate([come, press, slide])[::-1]
    return {"come": come, "press": press, "slide": slide, "leave": leave}


def _way_out(
    query: Query, points: Float64s, diagonal: float, fine: float, viewer: Float64s
) -> tuple[Float64s, Float64s, float, float]:
    """The best sample to touch, the unit vector out of it, how deep it lies, and how far the way is free
    beyond.
    """
    forces = query(points)
    strengths = _sizes(forces)
    along = forces / strengths[:, None]
    step = max(fine / 2, diagonal / _POINTS)
    distances = step * np.arange(math.ceil(diagonal / step) + 1)
    gap = max(3, len(distances) // 32)
    centre = points.mean(axis=0)
    best, way = -math.inf, None
    for point, normal, strength in zip(points, along, strengths / strengths.max(), strict=True):
        for out in (normal, -normal):
            line = query(point + out * distances[:, None])
            sizes = _sizes(line)
            felt = sizes > 1e-6 * sizes.max()
            ends = np.append(np.flatnonzero(felt), len(felt) + gap)  # the way beyond the last point is free
            last = int(np.argmax(np.diff(ends) > gap))  # the first of them that free space follows
            exit_, beyond = int(ends[last]) + 1, min(int(ends[last + 1]), len(felt))
            near = slice(max(0, exit_ - 6), exit_)
            resisting = float((line[near] @ out).sum() / sizes[near].sum())
            free = step * (beyond - exit_)
            score = (
                2 * min(1.0, free / (_LEAD * diagonal))
                + 1.5 * (ends[last + 1] >= len(felt))
                + 2 * resisting
                + strength
            )
            score += _VIEWER_WEIGHT * float(out @ viewer)
            score -= 0.5 * (step * exit_ + float(np.linalg.norm(point - centre))) / diagonal
            if score > best:
                best, way = score, (point, out, step * exit_, free)
    assert way is not None
    return way


def _slide(query: Query, touched: Float64s, out: Float64s, length: float, slack: float) -> Float64s:
    """The longest walk along the surface from a point on it, float64 [n, 3], n at least 1."""
    across = np.eye(3)[np.argmin(np.abs(out))]
    across -= out * (across @ out)
    across /= np.linalg.norm(across)
    turns = 2 * np.pi * np.arange(_DIRECTIONS)[:, None] / _DIRECTIONS
    ways = np.cos(turns) * across + np.sin(turns) * np.cross(out, across)
    level = float(_sizes(query(touched[None]))[0])
    step = length / _STEPS
    heights = np.linspace(1.0, -1.0, _ACROSS) * (1.5 * step + slack)
    walks = [np.tile(touched, (_DIRECTIONS, 1))]
    counts, alive = np.zeros(_DIRECTIONS, int), np.ones(_DIRECTIONS, bool)
    for _ in range(_STEPS):
        lines = (walks[-1] + step * ways)[:, None, :] + heights[:, None] * out
        sizes = _sizes(query(lines.reshape(-1, 3))).reshape(_DIRECTIONS, _ACROSS)
        first = np.argmax(sizes >= level, axis=1)
        alive &= (sizes.max(axis=1) >= level) & (first > 0)
        if not alive.any():
            break
        before = np.maximum(first - 1, 0)
        rows = np.arange(_DIRECTIONS)
        rise = sizes[rows, first] - sizes[rows, before]
        share = np.where(rise > 0, (level - sizes[rows, before]) / np.where(rise > 0, rise, 1.0), 1.0)
        new = lines[rows, before] + share[:, None] * (lines[rows, first] - lines[rows, before])
        walks.append(np.where(alive[:, None], new, walks[-1]))
        counts += alive
    longest = int(np.argmax(counts))
    return np.stack([step_[longest] for step_ in walks[: counts[longest] + 1]])


def _timed(legs: dict[str, Float64s], count: int) -> Float64s:
    """Where the probe is at `count` equal times, float64 [count, 3]: each leg begins and ends at rest."""
    places = np.empty((count, 3))
    shares = np.cumsum([0.0, *(share for _, share in _LEGS)])
    edges = np.rint(shares / shares[-1] * (count - 1)).astype(int)
    here = legs["come"][0]
    for (name, _), begin, end in zip(_LEGS, edges[:-1], edges[1:], strict=True):
        corners = legs.get(name, here[None])
        lengths = np.append(0.0, np.cumsum(_sizes(np.diff(corners, axis=0))))
        share = np.arange(end - begin + 1) / max(1, end - begin)
        gone = share**3 * (10 - 15 * share + 6 * share**2) * lengths[-1]
        places[begin : end + 1] = np.stack([np.interp(gone, lengths, c) for c in corners.T], axis=1)
        here = corners[-1]
    return places
